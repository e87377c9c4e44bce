"""The circle test, a part of the page of lost motion; shown where the server has a second axis."""

from __future__ import annotations

from collections.abc import Sequence

from nicegui import ui

from hil.axis.axis_file import AxisConfig
from hil.desk.desk import Desk
from hil.lost_motion.circle import job as circle
from hil.lost_motion.circle.figures import QUADRANTS_DEG, Circle
from hil.lost_motion.page_data import CircleCurves, circle_curves, driven_circle
from hil.ui.screen.drawings import Options, RedrawnChart, angle_axis, short
from hil.ui.screen.pieces import Latest, ScreenTable
from hil.ui.screen.plots import FONT, PALETTES, inks, number_format, one_line_legend
from hil.ui.screen.view import Refresh, View

RADIUS_MM, FEED_MM_MIN, S_PER_MIN = 10.0, 100.0, 60.0
RINGS = 4
"""Number of rings on each side of the commanded circle."""
_INSIDE = 8
"""Distance from the centre to the innermost ring, in widths of a ring."""


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
        drawing = RedrawnChart(view, "circle.polar", "round")
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
        table = ScreenTable(view, "circle.bumps", names)
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


def around_a_circle(view: View, shown: CircleCurves, names: Sequence[str], commanded: str) -> Options:
    """Deviations around the circle, magnified; names: of its curves, in their order."""
    ink, grid = inks(view)
    palette = PALETTES[view.browser.dark]
    ring, reach = shown.ring_um, RINGS * shown.ring_um
    shown_every = f"Math.abs(value) < {reach * 1.01} && Math.round(value / {ring}) % 2 === 0"
    label = f"value => {shown_every} ? ({number_format(view)})(Number(value.toPrecision(6))) : ''"
    looks = [
        (1, {"width": 2, "type": "dashed"}),
        (3, {"width": 2, "type": "dotted"}),
        (5, {"width": 3, "type": "solid"}),
    ]
    if len(shown.traces) < len(looks):
        del looks[1]  # of tables alone, beside the lost motion
    zero = {
        "name": commanded,
        "type": "line",
        "coordinateSystem": "polar",
        "showSymbol": False,
        "silent": True,
        "data": [[0, angle] for angle in range(0, 361, 3)],
        "lineStyle": {"color": ink, "width": 2},
        "itemStyle": {"color": ink},
    }
    traces = [
        {
            "name": name,
            "type": "line",
            "coordinateSystem": "polar",
            "showSymbol": False,
            "connectNulls": False,
            "data": [[None, None] if point is None else list(short([point])[0]) for point in shown.traces[key]],
            "lineStyle": {"color": palette[colour], **width},
            "itemStyle": {"color": palette[colour]},
        }
        for key, name, (colour, width) in zip(shown.traces, names, looks, strict=False)
    ]
    return {
        "animation": False,
        "textStyle": {"fontFamily": FONT},
        "legend": one_line_legend(ink),
        "polar": {"center": ["50%", "54%"], "radius": "78%"},
        "angleAxis": angle_axis(ink, grid),
        "radiusAxis": {
            "type": "value",
            "min": -(RINGS + _INSIDE) * ring,
            "max": reach,
            "interval": ring,
            "axisLabel": {"color": ink, "fontSize": 13, "margin": 4, ":formatter": label},
            "axisTick": {"show": False},
            "axisLine": {"show": False},
            "splitLine": {"lineStyle": {"color": grid}},
        },
        "series": [zero, *traces],
    }
