"""Page of calibration and verification (system A): the plan in words, the errors while measured, figures before and
after, the band.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import ui

from hil.app.panel.drawings import Curve, Drawing, Options, curves
from hil.app.panel.pieces import Reading, Table, draw_where
from hil.app.panel.plots import JobPlot
from hil.app.panel.view import View
from hil.app.panel.zero_switches import ZeroSwitches
from hil.axis.axis_file import AxisConfig
from hil.calibration import job as calibrate
from hil.calibration.job import CALIBRATE, UNCORRECTED, VERIFY
from hil.calibration.page_data import SHOWN, STAGES, CalibrationScreen, MeasuredStage, calibration_screen

Refresh = Callable[[], None]
Kept = Reading[CalibrationScreen]
KINDS = (CALIBRATE, VERIFY, UNCORRECTED)
COLOUR = {"before": 1, "after": 0, "verified": 2, "uncorrected": 4}
"""Colour of each stage's curves."""


def draw(view: View) -> None:
    """Draws the page."""
    axis = view.desk.axis
    if not isinstance(axis, AxisConfig):
        view.named(ui.label(view.t("calibrate.no_instrument")).classes("hil-note"), "calibrate.no_instrument")
        return
    kept: Kept = Reading(view, partial(calibration_screen, axis))
    messages = view.messages("calibrate.messages")
    parts = [_draw_plan(view, axis), _draw_buttons(view, axis, kept)]
    with ui.element("div").classes("hil-grid"):
        parts += [_draw_where(view), _draw_accuracy(view, kept), _draw_band(view, axis, kept)]
    with ui.element("div").classes("hil-grid wide"):
        with view.card("calibrate.live", name="calibrate.live.card"):
            x, y = view.t("calibrate.plot_x"), view.t("calibrate.plot_y")
            live = JobPlot(view, KINDS, x, y, name="calibrate.live", dots=True)
        parts.append(_draw_curves(view, axis, kept))
    parts.append(_draw_figures(view, axis, kept))

    def refresh() -> None:
        messages.show(view.desk.last_of(KINDS))
        for part in parts:
            part()
        live.refresh()

    view.every(refresh)


def _draw_plan(view: View, axis: AxisConfig) -> Refresh:
    """The moves and writes of a calibration, in words, and whether the tables can be read and written."""
    t, rights = view.t, view.desk.rights
    with ui.element("div").classes("hil-grid wide"):
        with view.card("calibrate.plan"):
            ui.markdown(t("calibrate.steps"))
        with view.card("calibrate.would"):
            lines = view.question(calibrate.calibration_plan(axis))[:-1]
            view.named(ui.label("\n".join(lines)).classes("hil-note"), "calibrate.plan.lines")
            opened = view.named(ui.label().classes("hil-name"), "calibrate.opened")

    def refresh() -> None:
        store = rights.store if view.in_control else None
        state = "not_opened" if store is None else "readable" if store.builder_key is None else "writable"
        opened.set_text(t(f"calibrate.{state}"))

    return refresh


def _draw_buttons(view: View, axis: AxisConfig, kept: Kept) -> Refresh:
    """Start, verify, resume."""
    t, desk = view.t, view.desk

    async def start_new() -> None:
        await zero.run(view.ask_and_run, calibrate.calibration_job(axis, zero=zero.said()))

    async def verify() -> None:
        corrects, of_targets, said = bool(corrected.value), int(view.number_of(seed)), zero.said(anew=False)
        job = calibrate.verification_job(axis, corrected=corrects, seed=of_targets, zero=said)
        await zero.run(view.ask_and_run, job)

    with ui.row().classes("items-center"):
        start = view.button("calibrate.start", start_new)
        verifying = view.button("calibrate.verify", verify)
        corrected = view.named(ui.switch(t("calibrate.correction"), value=True), "calibrate.correction")
        seed = view.named(
            ui.number(t("calibrate.seed"), value=1, min=0, max=10_000, precision=0), "calibrate.seed"
        ).style("width: 14rem")
        zero = ZeroSwitches(view, "calibrate", anew=True)
        tables = view.button("calibrate.open", lambda: _ask_password(view)).props("outline")
    resuming = {
        kind: view.button(f"calibrate.resume.{kind}", partial(_resume, view, axis, kept, kind, zero)) for kind in KINDS
    }

    def refresh() -> None:
        store = desk.rights.store if view.in_control else None
        writable = store is not None and store.builder_key is not None
        start.set_enabled(view.can_start and view.is_builder and writable)
        verifying.set_enabled(view.can_start and (store is not None or not corrected.value))
        tables.set_enabled(view.in_control and store is None)
        zero.refresh()
        unfinished = {} if kept.value is None else kept.value.unfinished
        allowed = {CALIBRATE: view.is_builder and writable, VERIFY: store is not None, UNCORRECTED: True}
        for kind, button in resuming.items():
            button.set_visibility(kind in unfinished)
            button.set_enabled(view.can_start and allowed[kind])

    return refresh


async def _resume(view: View, axis: AxisConfig, kept: Kept, kind: str, zero: ZeroSwitches) -> None:
    """Go on with the campaign that was broken off, with the targets it was begun with."""
    _, seed = (kept.value.unfinished if kept.value is not None else {}).get(kind, ("", 1))
    if kind == CALIBRATE:
        job = calibrate.calibration_job(axis, resume=True, zero=zero.said())
    else:
        said = zero.said(anew=False)
        job = calibrate.verification_job(axis, corrected=kind == VERIFY, seed=seed, resume=True, zero=said)
    await zero.run(view.ask_and_run, job)


async def _ask_password(view: View) -> None:
    """Asks for the reading password of the tables; it is not kept."""
    given = await view.ask_passwords("calibrate.password", yes="calibrate.password.yes")
    if given is not None:
        token = view.token
        await view.attempt(lambda: view.in_worker_thread(lambda: view.desk.read_tables(token, *given)))


def _draw_where(view: View) -> Refresh:
    """Position of the axis, and the present step."""
    with view.card("calibrate.where"):
        where = draw_where(view, "calibrate", lambda: view.desk.last_of(KINDS))
        bar = view.named(ui.linear_progress(0.0, show_value=False, size="12px"), "calibrate.progress")

    def refresh() -> None:
        where()
        job = view.desk.last_of(KINDS)
        bar.set_value(0.0 if job is None or not job.total else job.done / job.total)

    return refresh


def _draw_accuracy(view: View, kept: Kept) -> Refresh:
    """The accuracy A of ISO 230-2, now and before."""
    with view.card("calibrate.accuracy"):
        now = view.value("calibrate.now", "µm")
        before = view.value("calibrate.before", "µm", small=True)
        verified = view.value("calibrate.verified", "µm", small=True)

    def refresh() -> None:
        stages = {} if kept.value is None else kept.value.stages
        for figure, name in ((now, "after"), (before, "before"), (verified, "verified")):
            figure.set_text(_figure(view, stages.get(name), "A"))

    return refresh


def _figure(view: View, stage: MeasuredStage | None, name: str) -> str:
    """A figure with its expanded uncertainty, where that is known."""
    if stage is None or name not in stage.figures_um:
        return "–"
    known = stage.u95_um.get(name)
    text = view.t.number(stage.figures_um[name], 2)
    return text if known is None else f"{text} ± {view.t.number(known, 2)}"


def _draw_band(view: View, axis: AxisConfig, kept: Kept) -> Refresh:
    """Whether every section is inside the band, and which are not; the same at other targets."""
    t, band = view.t, axis.correction.band
    with view.card("calibrate.band"):
        verdict = view.value("calibrate.verdict", small=band is None)
        asked = view.value("calibrate.asked", small=True)
        outside = view.named(ui.label().classes("hil-name"), "calibrate.outside")
        verified = view.value("calibrate.verified_band", small=True)
    asked.set_text(
        t("calibrate.no_band") if band is None else f"{t.number(band.low_um, 1)} … {t.number(band.high_um, 1)} µm"
    )

    def refresh() -> None:
        stages = {} if kept.value is None else kept.value.stages
        for figure, size, stage in ((verdict, "", stages.get("after")), (verified, " small", stages.get("verified"))):
            if stage is not None and stage.outside is not None:
                figure.set_text(t("calibrate.outside_is" if stage.outside else "calibrate.inside_is"))
                figure.classes(replace=f"hil-value{size} hil-{'bad' if stage.outside else 'good'}")
        last = stages.get("after")
        if last is not None and last.outside is not None:
            places = [f" · {t.number(one.target_mm, 1)} mm {'+' if one.direction > 0 else '−'}" for one in last.outside]
            inside = t("calibrate.sections", inside=last.sections - len(last.outside), total=last.sections)
            outside.set_text(inside + "".join(places))

    return refresh


def _draw_curves(view: View, axis: AxisConfig, kept: Kept) -> Refresh:
    with view.card("calibrate.curves", name="calibrate.curves.card"):
        drawing = Drawing(view, "calibrate.curves")

    def refresh() -> None:
        screen = kept.value
        if screen is not None and screen.stages:
            drawing.show(screen, lambda: _curves(view, axis, screen))

    return refresh


def _curves(view: View, axis: AxisConfig, screen: CalibrationScreen) -> Options:
    """Mean errors along the axis: + as triangles, − as inverted triangles, a colour for each stage, the band behind."""
    t = view.t
    drawn = [
        Curve(
            f"{t(f'calibrate.stage.{name}')} {'+' if sign > 0 else '−'}",
            points,
            COLOUR[name],
            "triangle",
            turned=sign < 0,
        )
        for name, stage in screen.stages.items()
        for sign, points in stage.means_um.items()
        if points
    ]
    options = curves(view, t("calibrate.plot_x"), t("calibrate.plot_y"), drawn)
    for series in options["series"]:
        series |= {"type": "line", "showSymbol": True, "lineStyle": {"width": 1.5}}
    band = axis.correction.band
    if band is not None and options["series"]:
        area = [[{"yAxis": band.low_um}, {"yAxis": band.high_um}]]
        options["series"][0]["markArea"] = {"silent": True, "itemStyle": {"color": "#009e7333"}, "data": area}
    return options


def _draw_figures(view: View, axis: AxisConfig, kept: Kept) -> Refresh:
    """The figures of ISO 230-2, each with its uncertainty where known."""
    t = view.t
    with view.card("calibrate.figures", name="calibrate.figures.card").classes("w-full"):
        columns = ["calibrate.head.figure", *(f"calibrate.stage.{name}" for name in STAGES)]
        table = Table(view, "calibrate.figures", columns)
        known = "calibrate.uncertain" if axis.uncertainty is not None else "calibrate.not_uncertain"
        view.named(ui.label(t(known)).classes("hil-name"), "calibrate.uncertainty")
    shown: list[CalibrationScreen] = []

    def refresh() -> None:
        screen = kept.value
        if screen is None or shown == [screen]:
            return
        shown[:] = [screen]
        figures = [
            [t(f"calibrate.figure.{name}"), *(_figure(view, screen.stages.get(one), name) for one in STAGES)]
            for name in SHOWN
        ]
        begun = [
            screen.stages[name].begun.strftime("%Y-%m-%d %H:%M") if name in screen.stages else "–" for name in STAGES
        ]
        table.show([*figures, [t("calibrate.begun"), *begun]])

    return refresh
