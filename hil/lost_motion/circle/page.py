"""The circle test, a part of the page of lost motion; shown where the server has a second axis."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from hil.axis.axis_file import AxisConfig
from hil.desk.desk import Desk
from hil.lost_motion.circle import job as circle
from hil.lost_motion.circle.figures import QUADRANTS_DEG, Circle
from hil.lost_motion.page_data import circle_curves, driven_circle
from hil.ui.screen.drawings import Drawing, around_a_circle
from hil.ui.screen.pieces import Latest, Table
from hil.ui.screen.view import View

Refresh = Callable[[], None]
RADIUS_MM, FEED_MM_MIN, S_PER_MIN = 10.0, 100.0, 60.0


def draw_circle(view: View, axis: AxisConfig) -> Refresh:
    """Draws settings, start, plot and figures; returns their refresh."""
    others = {desk.name: desk for desk in view.desks if desk is not view.desk and isinstance(desk.axis, AxisConfig)}
    with view.card("circle.title"):
        if not others:
            view.named(ui.label(view.t("circle.alone")).classes("hil-note"), "circle.alone")
            return lambda: None
        parts = [_draw_settings(view, axis, others)]
        with ui.element("div").classes("hil-grid wide"):
            parts += [_draw_polar(view), _draw_figures(view)]

    def refresh() -> None:
        for part in parts:
            part()

    return refresh


def _draw_settings(view: View, axis: AxisConfig, others: dict[str, Desk]) -> Refresh:
    """Second axis, radius, feed, and sense."""
    t = view.t
    messages = view.messages("circle.messages")
    with ui.row().classes("items-end hil-fields"):
        other = view.named(ui.select(list(others), label=t("circle.other"), value=next(iter(others))), "circle.other")
        radius = view.named(ui.number(t("circle.radius"), value=RADIUS_MM, min=0.1, max=500.0), "circle.radius")
        feed = view.named(ui.number(t("circle.feed"), value=FEED_MM_MIN, min=1.0, max=10000.0), "circle.feed")
        clockwise = view.named(ui.checkbox(t("circle.clockwise")), "circle.clockwise")

    async def start() -> None:
        second = others[other.value]
        if not isinstance(second.axis, AxisConfig):
            return
        axes, sense = (axis, second.axis), -1 if clockwise.value else 1
        wanted = Circle(circle.middle_of(axes), view.number_of(radius), view.number_of(feed) / S_PER_MIN, sense)
        stores = [view.desk.rights.store, second.rights.store]
        await view.ask_and_run(circle.circle_job(axes, wanted, stores), lent=[second])

    with ui.row().classes("items-center"):
        start_button = view.button("circle.start", start)
        step = view.named(ui.label().classes("hil-name"), "circle.step")

    def refresh() -> None:
        job = view.desk.last(circle.CIRCLE)
        start_button.allow(view.why_not())
        step.set_text("" if job is None else view.stage(job))
        driven = driven_circle(view.desk)
        messages.show(job, "" if driven is None or driven.good else circle.VERDICT)

    return refresh


def _draw_polar(view: View) -> Refresh:
    with ui.element("div") as box:
        drawing = Drawing(view, "circle.polar", "round")
        ring = view.named(ui.label().classes("hil-name"), "circle.ring")
    box.set_visibility(False)
    latest = Latest()

    def refresh() -> None:
        driven = driven_circle(view.desk)
        if driven is None or not latest.is_new(driven):
            return
        shown, t = circle_curves(driven), view.t
        box.set_visibility(True)
        names = [t(f"circle.{name}") for name in shown.traces]
        drawing.show(driven, lambda: around_a_circle(view, shown, names, t("circle.commanded")))
        ring.set_text(t("circle.ring", ring=t.number(shown.ring_um, 2)))

    return refresh


def _draw_figures(view: View) -> Refresh:
    """The bumps after the quadrants."""
    t = view.t
    with ui.element("div"):
        fallen = view.value("circle.fallen", "%")
        places = [f"after_{at:.0f}" for at in QUADRANTS_DEG]
        names = [f"circle.head.{name}" for name in ("trace", *places, "mean", "floor", "roundness")]
        table = Table(view, "circle.bumps", names)
    latest = Latest()

    def refresh() -> None:
        driven = driven_circle(view.desk)
        if driven is None or not latest.is_new(driven):
            return
        fallen.set_text(t.number(driven.fallen_percent, 1))
        table.show(
            [
                [
                    t(f"circle.{name}"),
                    *(
                        t.number(value, 2)
                        for value in (*one.bumps_um, one.bump_mean_um, one.floor_um, one.roundness_um)
                    ),
                ]
                for name, one in driven.traces.items()
            ]
        )

    return refresh
