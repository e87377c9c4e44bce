"""The frame of every page: stop button, status bar, pages, lost data, alarms, and the question of a job."""

from __future__ import annotations

import json
from collections.abc import Sequence

from nicegui import ui

from hil.app.panel.bar import Page, draw_bar, draw_rail
from hil.app.panel.events import draw_alarm
from hil.app.panel.job_question import draw_question
from hil.app.panel.no_live_data import draw_no_live_data
from hil.ui.screen.view import View


def draw_page(view: View, page: Page, pages: Sequence[Page]) -> None:
    ui.dark_mode(view.browser.dark)
    view.client.run_javascript(f"document.documentElement.lang = {json.dumps(view.t.language)}")
    ui.page_title(f"{view.desk.name} · {view.t(f'page.{page.name}')}")
    _draw_lost(view)
    _draw_stop(view)
    draw_bar(view, page)
    draw_rail(view, page, pages)
    _draw_no_font(view)
    draw_no_live_data(view)
    draw_alarm(view)
    draw_question(view)
    page.draw(view)


def _draw_lost(view: View) -> None:
    """A warning that the page's own script shows when a stop did not reach the server."""
    lost = view.named(ui.element("div").classes("hil-lost").props("hidden role=alert"), "stop-lost")
    with lost:
        ui.label(view.t("stop.lost"))


def _draw_no_font(view: View) -> None:
    """Say that Chinese was asked for, which this browser's computer cannot draw."""
    if view.browser.undrawn:
        view.named(ui.label(view.t("language.undrawn")).classes("hil-note w-full"), "no-font")


def _draw_stop(view: View) -> None:
    with view.named(ui.element("button").props(f'aria-label="{view.t("stop.hint")}"'), "stop"):
        ui.label(view.t("stop.stop"))
        keys = ui.label(view.t("stop.keys")).classes("hil-stop-keys")
        keys.props["data-stale"] = view.t("stop.may_not_arrive")
