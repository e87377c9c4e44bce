"""Page with all axes of the server: state, position and following error of each, live."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter

from nicegui import ui

from hil.desk.desk import Desk
from hil.ui.screen.plots import Channel, LiveChart
from hil.ui.screen.view import View


def draw(view: View) -> None:
    with ui.element("div").classes("hil-grid"):
        parts = [_draw_axis(view, desk) for desk in view.desks]

    view.every(*parts)


def _draw_axis(view: View, desk: Desk) -> Callable[[], None]:
    t = view.t
    card = view.live(ui.element("section").classes("hil-card"), "drive", desk)
    with view.named(card, f"axes.{desk.name}"):
        ui.link(t("header.axis", name=desk.name), f"/axis/{desk.name}/overview").classes("hil-name")
        state = ui.label().classes("hil-name")
        position = view.value("overview.position", "mm", name=f"axes.{desk.name}.position")
        channel = Channel("overview.following_error", "µm", attrgetter("following_error_um"))
        plot = LiveChart(view, f"plot.axes.{desk.name}", [channel], desk)

    def refresh() -> None:
        live = desk.live
        state.set_text(t("header.lost", why=live.trouble) if live.trouble else t(f"state.{live.state.name}"))
        position.set_text(t.number(live.position_load_mm))
        plot.refresh()

    return refresh
