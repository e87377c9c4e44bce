"""Page of the touch probe (system D): M90 from start to the run-out in force, contacts and drawing, history,
corrections and a bore.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from nicegui import ui

from hil.probe import MODES
from hil.probe import job as probe
from hil.probe.job import MeasuredRunOut
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.page_data import (
    STORED,
    BallPositions,
    HistoryCurves,
    HistoryEntry,
    ProbeRecord,
    angle_deg,
    ball_positions,
    contacts,
    history_curves,
    last_at,
    open_store_at,
    probe_record,
    result_at,
    std_um,
    worst_closure_um,
)
from hil.probe.pages.correct import Kept, ProbePage, draw_corrections
from hil.probe.runout import RunOut
from hil.records.rows import UM_PER_MM
from hil.ui.screen.drawings import Curve, Options, RedrawnChart, angle_axis, curves
from hil.ui.screen.pieces import FolderContents, Latest, ScreenTable, StartCondition, draw_ready, draw_where
from hil.ui.screen.plots import FONT, PALETTES, inks, number_format, one_line_legend
from hil.ui.screen.view import Refresh, View


def draw(view: View, machine: ProbeMachineConfig | None) -> None:
    """Draws the page. machine: with the touch probe, None for none."""
    if machine is None:
        view.named(ui.label(view.t("probe.none")).classes("hil-note"), "probe.none")
        return
    at = ProbePage(view, machine)
    messages = view.messages("probe.messages")
    kept: Kept = FolderContents(view, lambda: probe_record(at.config, at.store))
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            parts = [_draw_run_out(at), draw_where(view, "probe", lambda: last_at(view.desks))]
            mode, settings = _draw_settings(at)
        with ui.element("div").classes("hil-main"):
            parts += [settings, _draw_drawing(at)]
            view.how("probe.instructions", "probe.steps")
    with ui.element("div").classes("hil-grid wide"):
        parts += [_draw_contacts(at), _draw_in_force(at, kept)]
    parts += [draw_corrections(at, kept, mode), draw_history(view, kept)]
    seen: list[object] = []

    def refresh() -> None:
        job = last_at(view.desks)
        result = None if job is None else job.result
        refusal = result.refusal if isinstance(result, MeasuredRunOut) else None
        messages.show(job, refusal or ("" if kept.value is None else kept.value.trouble))
        now = [None if job is None else (job.number, job.phase), at.store]
        if now != seen:
            seen[:] = now
            kept.again()
        for part in parts:
            part()

    view.every(refresh)


# -- what it takes ---------------------------------------------------------------------------------------------------------
def _draw_settings(at: ProbePage) -> tuple[ui.select, Refresh]:
    """Mode, what is missing for a start, start, and the button that opens the store."""
    view, t = at.view, at.view.t
    modes = {mode: t(f"probe.modes.{mode}") for mode in MODES}

    async def start() -> None:
        store = at.store
        if store is not None:
            await at.ask_and_run(probe.measuring_job(at.config, store, str(mode.value)))

    with ui.element("div").classes("hil-buttons"):
        select = ui.select(modes, label=t("probe.mode"), value=at.config.probe.mode).props("dense options-dense")
        mode = view.named(select, "probe.mode")
    missing = (
        StartCondition(
            "other_axes",
            lambda: not view.in_control or not at.not_controlled,
            figures=lambda: {"axes": ", ".join(desk.name for desk in at.not_controlled)},
        ),
        StartCondition("run_out_store", lambda: not view.in_control or (at.store is not None and at.store.writable)),
    )
    ready = draw_ready(view, "probe", *missing)
    with ui.element("div").classes("hil-buttons"):
        start_button = view.button("probe.start", start).classes("hil-go")
        opening = view.button("probe.open", partial(_ask_passwords, at))
    opening.set_visibility(at.config.store.sealed)

    def refresh() -> None:
        ready()
        store = at.store
        start_button.allow(at.why_not() or ("" if store is not None and store.writable else t("why.run_out_store")))
        opening.allow("" if view.in_control else t("why.control"))

    return mode, refresh


async def _ask_passwords(at: ProbePage) -> None:
    """Asks for the reading password of the sealed run-out, and that of its builder's key for measuring."""
    view = at.view
    fields = ("probe.reading_password", "probe.key_password")
    given = await view.ask_passwords(*fields, yes="probe.open.yes", go="go.store", why="probe.open_why")
    if given is not None:
        token = view.token
        await view.attempt(lambda: view.in_worker_thread(lambda: open_store_at(view.desk, token, at.config, *given)))


# -- M90 -------------------------------------------------------------------------------------------------------------------
def _draw_contacts(at: ProbePage) -> Refresh:
    """The contacts as they are measured."""
    view, t = at.view, at.view.t
    with view.card("probe.contacts", name="probe.contacts.card"):
        heads = [f"probe.head.{name}" for name in ("turn", "angle", "feed", "pulses")]
        table = ScreenTable(view, "probe.contacts", heads, words=0)
    shown: list[object] = [None]

    def refresh() -> None:
        found = contacts(at.config, last_at(view.desks, [probe.MEASURE]))
        if shown != [found]:
            shown[:] = [found]
            rows = [
                [str(one.turn), f"{one.angle_deg}°", t.number(one.feed_mm, 4), t.number(one.pulses, 0)] for one in found
            ]
            table.show(rows)

    return refresh


def _draw_run_out(at: ProbePage) -> Refresh:
    """The result of the last measurement: whether it is in force, the figures, and the closure that decides it."""
    view, t = at.view, at.view.t
    with view.card("probe.run_out"):
        size = view.value("probe.size", "µm")
        with ui.element("div").classes("hil-lines"):
            verdict = view.value("probe.verdict", small=True)
            fill = draw_values(view, "probe")
            std = view.value("probe.std", "µm", small=True)
            closure = view.value("probe.closure", "µm", small=True)
        limit = t("probe.limit", limit=t.number(at.config.block.closure_limit_um, 1))
        view.named(ui.label(limit).classes("hil-name"), "probe.limit")

    def refresh() -> None:
        measured = result_at(view.desks, probe.MEASURE, MeasuredRunOut)
        found = None if measured is None else measured.measurement.run_out
        size.set_text(t.number(None if found is None else found.size_um, 2))
        fill(found)
        known_um = None if measured is None else std_um(at.config, measured.measurement)
        std.set_text("–" if known_um is None else t.number(known_um, 2))
        closure.set_text(t.number(None if measured is None else worst_closure_um(measured.measurement), 2, sign=True))
        said = "refused" if measured is not None and measured.refusal is not None else "stored"
        verdict.set_text("–" if measured is None else t(f"probe.verdicts.{said}"))

    return refresh


def draw_values(view: View, name: str) -> Callable[[RunOut | None], None]:
    """Δx, Δy, the angle and the radius, with element names that begin with `name`; returns the function that fills
    them.
    """
    t = view.t
    x = view.value("probe.x", "µm", small=True, name=f"{name}.x")
    y = view.value("probe.y", "µm", small=True, name=f"{name}.y")
    angle = view.value("probe.angle", "°", small=True, name=f"{name}.angle")
    radius = view.value("probe.radius", "mm", small=True, name=f"{name}.radius")

    def fill(found: RunOut | None) -> None:
        x.set_text(t.number(None if found is None else UM_PER_MM * found.x_mm, 2, sign=True))
        y.set_text(t.number(None if found is None else UM_PER_MM * found.y_mm, 2, sign=True))
        angle.set_text(t.number(None if found is None else angle_deg(found), 1))
        radius.set_text(t.number(None if found is None else found.tip_radius_mm, 4))

    return fill


def _draw_drawing(at: ProbePage) -> Refresh:
    """The ball about the spindle axis at the four angles."""
    view, t = at.view, at.view.t
    with view.card("probe.drawing", name="probe.drawing.card"):
        ui.label(t("probe.drawing_note")).classes("hil-name")
        drawing = RedrawnChart(view, "probe.drawing", "round")
    names = {name: t(f"probe.drawn.{name}") for name in ("run_out", "circle", "contacts")}

    def refresh() -> None:
        measured = result_at(view.desks, probe.MEASURE, MeasuredRunOut)
        if measured is not None:
            shown = ball_positions(at.config, measured.measurement)
            drawing.show(measured, lambda: around_the_spindle(view, shown, names))

    return refresh


# -- in force --------------------------------------------------------------------------------------------------------------
def _draw_in_force(at: ProbePage, kept: Kept) -> Refresh:
    """The run-out in force, and since when; the machine, and the state of the store."""
    view, t, sealed = at.view, at.view.t, at.config.store.sealed
    names = ", ".join(axis.name for axis in at.config.axes.values())
    with view.card("probe.in_force"):
        with ui.element("div").classes("hil-lines"):
            since = view.value("probe.since", small=True)
            fill = draw_values(view, "probe.in_force")
        machine = t("probe.machine", name=at.config.name, axes=names)
        view.named(ui.label(machine).classes("hil-name"), "probe.machine")
        state = view.named(ui.label().classes("hil-name"), "probe.store")
    latest = Latest()

    def refresh() -> None:
        store = at.store
        open_to = "not_opened" if store is None else "writable" if store.writable else "readable"
        state.set_text(t(f"probe.stores.{open_to if sealed else 'plain'}"))
        if kept.value is None or not latest.is_new(kept.value):
            return
        fill(kept.value.in_force)
        when = kept.value.since
        closed = "sealed" if at.store is None else "nothing"
        since.set_text(t(f"probe.no_{closed}") if when is None else when.astimezone().strftime("%Y-%m-%d %H:%M:%S"))

    return refresh


WORDS = ("when", "mode", "verdict")
FIGURES = ("x", "y", "radius", "closure")


def draw_history(view: View, kept: FolderContents[ProbeRecord]) -> Callable[[], None]:
    """A plot and a table of the measurements, the latest first; returns the refresh."""
    with view.card("probe.history", name="probe.history.card"):
        drawing = RedrawnChart(view, "probe.history")
    with view.card("probe.measurements", name="probe.measurements.card"):
        heads = {name: f"probe.past.{name}" for name in (*WORDS[:2], *FIGURES, WORDS[2])}
        figures = [heads[name] for name in FIGURES]
        table = ScreenTable(view, "probe.measurements", list(heads.values()), figures=figures, tall=True)
    latest = Latest()

    def refresh() -> None:
        record = kept.value
        if record is None or not latest.is_new(record):
            return
        shown = history_curves(record.history)
        if shown is not None:
            drawing.show(record, lambda: _options(view, shown))
        table.show([_row(view, one) for one in reversed(record.history)])

    return refresh


def _options(view: View, shown: HistoryCurves) -> Options:
    t = view.t
    drawn = [
        Curve(t("probe.x"), shown.x, 0, "circle"),
        Curve(t("probe.y"), shown.y, 1, "diamond"),
        Curve(t("probe.left_out"), shown.left_out, 6, "triangle", turned=True),
    ]
    x = t(f"probe.history_x.{shown.unit}", begun=shown.begun.astimezone().strftime("%Y-%m-%d %H:%M"))
    return curves(view, x, t("probe.history_y"), drawn)


def _row(view: View, one: HistoryEntry) -> list[str]:
    t = view.t
    verdict = t.known("probe.verdicts", one.verdict.replace(" ", "_"))
    return [
        one.when.astimezone().strftime("%Y-%m-%d %H:%M:%S"),
        t.known("probe.modes", one.mode),
        t.number(one.x_um, 2, sign=True),
        t.number(one.y_um, 2, sign=True),
        t.number(one.tip_radius_mm, 4),
        t.number(one.closure_um, 2, sign=True),
        verdict if one.verdict == STORED else f"{verdict}: {t.said(one.why)}",
    ]


REACH = 1.25
"""Radius of the plot, as a multiple of the outermost position."""


def around_the_spindle(view: View, shown: BallPositions, names: Mapping[str, str]) -> Options:
    """Chart options of the positions seen along the spindle axis, in µm. names: of "run_out", "circle" and
    "contacts".
    """
    ink, grid = inks(view)
    size_um, bearing_deg = shown.run_out
    places = [[_short(far), _short(at)] for far, at in shown.at.values()]
    circle = {
        "name": names["circle"],
        "type": "line",
        "showSymbol": False,
        "silent": True,
        "data": [[_short(size_um), angle] for angle in range(0, 361, 3)],
        "lineStyle": {"color": ink, "width": 2, "type": "dashed"},
        "itemStyle": {"color": ink},
    }
    arrow = {
        "name": names["run_out"],
        "type": "line",
        "data": [[0, _short(bearing_deg)], [_short(size_um), _short(bearing_deg)]],
        "symbol": ["none", "circle"],
        "showSymbol": False,
        "lineStyle": {"color": PALETTES[view.browser.dark][1], "width": 5},
        "itemStyle": {"color": PALETTES[view.browser.dark][1]},
    }
    contacts = {
        "name": names["contacts"],
        "type": "scatter",
        "symbolSize": 16,
        "z": 3,
        "data": [
            {
                "value": place,
                "label": {"formatter": f"{angle}°", "position": "left" if 90 < place[1] < 270 else "right"},
            }
            for angle, place in zip(shown.at, places, strict=True)
        ],
        "label": {"show": True, "color": ink, "fontSize": 16},
        "itemStyle": {"color": PALETTES[view.browser.dark][5]},
    }
    series: list[dict[str, Any]] = [{**one, "coordinateSystem": "polar"} for one in (circle, arrow, contacts)]
    label = f"value => ({number_format(view)})(Number(value.toPrecision(3)))"
    return {
        "animation": False,
        "textStyle": {"fontFamily": FONT},
        "legend": one_line_legend(ink),
        "polar": {"center": ["50%", "54%"], "radius": "76%"},
        "angleAxis": angle_axis(ink, grid),
        "radiusAxis": {
            "type": "value",
            "min": 0,
            "max": _short(REACH * max(size_um, 0.5, *(far for far, _ in shown.at.values()))),
            "splitNumber": 4,
            "axisLabel": {"color": ink, "fontSize": 13, "margin": 4, "showMaxLabel": False, ":formatter": label},
            "axisTick": {"show": False},
            "axisLine": {"show": False},
            "splitLine": {"lineStyle": {"color": grid}},
        },
        "series": series,
    }


def _short(value: float) -> float:
    return float(f"{value:.5g}")
