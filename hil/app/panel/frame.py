"""The frame of every page: stop button, status bar, pages, lost data, alarms, and the question of a job."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence

from nicegui import ui

from drivers.instrument import ReadingStatus
from hil.app.panel.bar import Page, draw_bar, draw_rail
from hil.app.panel.events import draw_alarm
from hil.axis.axis_file import AxisConfig
from hil.desk.asking import Pending
from hil.desk.desk import Desk
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
        view.named(ui.label(view.t("language.undrawn")).classes("hil-note full-width"), "no-font")


def _draw_stop(view: View) -> None:
    with view.named(ui.element("button").props(f'aria-label="{view.t("stop.hint")}"'), "stop"):
        ui.label(view.t("stop.stop"))
        keys = ui.label(view.t("stop.keys")).classes("hil-stop-keys")
        keys.props["data-stale"] = view.t("stop.may_not_arrive")


S_PER_MIN = 60.0


def draw_question(view: View) -> None:
    """Draw the question below the header; hidden while there is none."""
    t, desk = view.t, view.desk
    shown: list[Pending | None] = [None]

    def answer(*, yes: bool) -> None:
        if shown[0] is not None:
            desk.answer(view.token, shown[0].number, yes=yes)

    with view.named(ui.element("section").classes("hil-card hil-ask full-width"), "ask") as card:
        words = view.named(ui.label().style("font-size: 1.4rem"), "ask.words")
        wait = view.named(ui.label(), "ask.wait")
        elsewhere = view.named(ui.label(t("ask.elsewhere")), "ask.elsewhere")
        with ui.row() as buttons:
            done = view.button("ask.yes.run", lambda: answer(yes=True), name="ask.yes").classes("hil-go")
            not_done = view.button("ask.no.run", lambda: answer(yes=False), name="ask.no")

    def refresh() -> None:
        pending = desk.question
        card.set_visibility(pending is not None)
        buttons.set_visibility(view.in_control)
        elsewhere.set_visibility(not view.in_control)
        if pending is None or shown == [pending]:
            return
        shown[:] = [pending]
        question = pending.question
        words.set_text(t(f"ask.{question.kind}", **{name: t.said(text) for name, text in question.figures.items()}))
        done.say(t(f"ask.yes.{question.kind}"))
        not_done.say(t(f"ask.no.{question.kind}"))
        minutes = t.number(question.within_s / S_PER_MIN, 0)
        wait.set_text(f"{t(f'ask.power.{question.kind}')} {t('ask.wait', minutes=minutes)}")

    view.every(refresh)


BEAT_S = 0.1
"""Interval between two messages from which a page knows that the server is there, s: a seventh of what the page's script waits."""
UNUSED = "backlash"
"""First word of the kinds of jobs that do not read the instrument."""
REASONS = ("server", "drive", "unread", "connecting", "job", "instrument", "signal", "signal_back")
"""Why there is no live data: a line each under `no_data` in the texts."""


def draw_no_live_data(view: View) -> None:
    """The banner of lost data. The page's script shows it, as the server may be what is lost; the server only says what it hears."""
    t = view.t
    banner = ui.element("section").classes("hil-gone").props(f'hidden role=alert data-axis="{view.desk.name}"')
    with view.named(banner, "no-data"):
        since = view.named(ui.label().classes("hil-gone-title"), "no-data.since")
        since.props["data-text"] = t("no_data.since", time="{time}", seconds="{seconds}")
        for reason in REASONS:
            ui.label(t(f"no_data.{reason}", axis=view.desk.name)).props(f"hidden data-why={reason}")
        trouble = view.named(ui.label(), "no-data.trouble")

    def beat() -> None:
        heard = {desk.name: _heard(desk) for desk in view.desks}
        view.client.run_javascript(f"hilBeat({json.dumps(heard)}, {1e3 * time.monotonic():.1f})")

    def refresh() -> None:
        trouble.set_text(t.said(view.desk.live.trouble))

    view.every(refresh)
    view.every(beat, seconds=BEAT_S)


def _heard(desk: Desk) -> dict[str, object]:
    """How long ago the sources of a desk were heard and were live, s, why they are not, and whether its axis moves or may move."""
    silence, live, job = desk.silence, desk.live, desk.job()
    running = job is not None and job.running
    why = {"drive": "unread" if live.connected and running else ""}  # where it is silent nevertheless
    if not live.connected and not live.trouble:
        why["drive"] = "job" if running else "connecting"
    lost = {"drive": silence.drive_lost_s, "instrument": silence.instrument_lost_s}
    heard: dict[str, object] = {"drive": silence.drive_s, "busy": running or live.moving, "why": why, "lost": lost}
    if isinstance(desk.axis, AxisConfig):
        heard["instrument"] = silence.instrument_s if silence.good else None
        if silence.instrument_s is not None and not silence.good:
            back = live.instrument_status is ReadingStatus.LOST_BEFORE and not running
            why["instrument"] = "signal_back" if back else "signal"
        if job is not None and running and job.kind.startswith(UNUSED):
            why["instrument"] = "unused"  # its figures are old, which is no alarm
    return heard
