"""The loop, a part of the page of the diagnosis: calibrate, explore, diagnose, extend, measure again."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from hil.app.panel.pieces import Latest, Reading, Table
from hil.app.panel.plots import JobPlot
from hil.app.panel.view import View
from hil.app.panel.zero_switches import ZeroSwitches
from hil.axis.axis_file import AxisConfig
from hil.calibration.explore import Exploration
from hil.diagnosis.loop.jobs.plan import CLOSE_LOOP, feeds_of, passes_at
from hil.diagnosis.page_data import DiagnosisScreen
from hil.diagnosis.stored import measurement_of

Refresh = Callable[[], None]
FIGURES = ("rms_um", "peak_um", "A_um", "R_um", "B_um", "M_um")


def draw_loop(view: View, axis: AxisConfig, kept: Reading[DiagnosisScreen]) -> Refresh:
    """Draws settings, start, live plot and the figures of each stage; returns their refresh."""
    with view.card("loop.title", name="loop").classes("w-full"):
        ui.markdown(view.t("loop.steps"))
        messages = view.messages("loop.messages")
        buttons = _draw_buttons(view, axis, kept)
        step = view.value("loop.step", small=True)
        with ui.element("div").classes("hil-grid wide"):
            x, y = view.t("calibrate.plot_x"), view.t("calibrate.plot_y")
            live = JobPlot(view, CLOSE_LOOP, x, y, name="loop.live", dots=True, as_one=_as_one)
            stages = _draw_stages(view, kept)

    measured = [""]

    def refresh() -> None:
        job = view.desk.last(CLOSE_LOOP)
        now = "" if job is None or not job.running else measurement_of(job.stage.partition(" ")[0])
        if now != measured[0]:  # one more stage is on disk
            measured[0] = now
            kept.again()
        messages.show(job)
        step.set_text(view.stage(job))
        buttons()
        stages()
        live.refresh()

    return refresh


def _as_one(series: str) -> str:
    """Series name under which all passes of one exploring campaign are drawn."""
    name, comma, way = series.partition(",")
    return f"{measurement_of(name)}{comma}{way}"


def _draw_buttons(view: View, axis: AxisConfig, kept: Reading[DiagnosisScreen]) -> Refresh:
    t, desk, usual = view.t, view.desk, Exploration()
    with ui.row().classes("items-end"):
        runs = ui.number(t("loop.runs"), value=usual.runs, min=2, max=100, precision=0).style("width: 12rem")
        rows = ui.number(t("loop.rows"), value=usual.rows, min=8, max=1000, precision=0).style("width: 12rem")
        warm = ui.number(t("loop.warm_up"), value=usual.warm_up_s, min=0, max=86_400).style("width: 14rem")
        feeds = ui.input(t("loop.feeds"), placeholder=t("loop.at_rest")).style("width: 24rem")
        for field, name in ((runs, "runs"), (rows, "rows"), (warm, "warm_up"), (feeds, "feeds")):
            view.named(field, f"loop.{name}")
        start_button = view.button("loop.start", lambda: start(False))
        resume_button = view.button("loop.resume", lambda: start(True))
        zero = ZeroSwitches(view, "loop")

    async def start(resume: bool) -> None:
        from hil.diagnosis.loop.job import loop_job  # noqa: PLC0415  (the diagnosis is slow to load)
        from hil.diagnosis.loop.procedure import Turning  # noqa: PLC0415

        how = Exploration(int(view.number_of(runs)), int(view.number_of(rows)), view.number_of(warm))
        asked = str(feeds.value or "").strip()
        in_motion = passes_at(axis, feeds_of(asked)) if asked else None
        unfinished = None if kept.value is None else kept.value.unfinished
        if resume and unfinished is not None:
            how, in_motion = unfinished
        job = loop_job(axis, Turning(how, in_motion=in_motion), resume=resume, zero=zero.said())
        await zero.run(view.ask_and_run, job)

    def refresh() -> None:
        store = desk.rights.store
        can = view.can_start and view.is_builder and store is not None and store.builder_key is not None
        start_button.set_enabled(can)
        zero.refresh()
        resume_button.set_enabled(can)
        resume_button.set_visibility(kept.value is not None and kept.value.unfinished is not None)

    return refresh


def _draw_stages(view: View, kept: Reading[DiagnosisScreen]) -> Refresh:
    """Figures of the axis after each stage of the last loop, from its files."""
    t = view.t
    with ui.element("div"):
        verdict = view.value("loop.verdict", small=True)
        of = view.named(ui.label().classes("hil-name"), "loop.of")
        table = Table(view, "loop.stages", ["loop.head.stage", *(f"loop.head.{name}" for name in FIGURES)])
    latest = Latest()

    def refresh() -> None:
        loop = None if kept.value is None else kept.value.loop
        if loop is None or not latest.is_new(loop):
            return
        outcome = "loop.not_ended" if loop.good is None else "loop.good" if loop.good else "loop.not_good"
        verdict.set_text(t(outcome))
        of.set_text(loop.place)
        table.show(
            [
                [
                    t(f"loop.stage.{name.replace(', ', '_').replace(' ', '_')}"),
                    *(t.number(figures.get(one), 2) for one in FIGURES),
                ]
                for name, figures in loop.stages.items()
            ]
        )

    return refresh
