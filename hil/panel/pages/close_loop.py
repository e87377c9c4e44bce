"""The loop, a part of the page of the diagnosis: calibrate, explore, diagnose, extend, measure again, on this axis."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from hil.axis import AxisConfig
from hil.desk.diagnosis import DiagnosisScreen
from hil.desk.progress import Progress
from hil.jobs.loop_plan import CLOSE_LOOP, Looped
from hil.jobs.stored_diagnosis import measurement_of
from hil.panel.plots import JobPlot
from hil.panel.reading import Reading
from hil.panel.tables import Table
from hil.panel.view import View
from hil.procedures.explore import Exploration

Refresh = Callable[[], None]
FIGURES = ("rms_um", "peak_um", "A_um", "R_um", "B_um", "M_um")


def draw_loop(view: View, axis: AxisConfig, kept: Reading[DiagnosisScreen]) -> Refresh:
    """Settings, start, what is measured, and the figures of each stage; the refresh of it all."""
    with view.card("loop.title", name="loop").classes("w-full"):
        ui.markdown(view.t("loop.steps"))
        messages = view.messages("loop.messages")
        buttons = _draw_buttons(view, axis, kept)
        step = view.value("loop.step", small=True)
        with ui.element("div").classes("hil-grid wide"):
            x, y = view.t("calibrate.plot_x"), view.t("calibrate.plot_y")
            live = JobPlot(view, CLOSE_LOOP, x, y, name="loop.live", dots=True, as_one=_as_one)
            stages = _draw_stages(view)

    def refresh() -> None:
        job = view.desk.last(CLOSE_LOOP)
        messages.show(job)
        step.set_text(view.stage(job))
        buttons()
        stages()
        live.refresh()

    return refresh


def _as_one(series: str) -> str:
    """Passes of one exploring campaign are drawn as one."""
    name, comma, way = series.partition(",")
    return f"{measurement_of(name)}{comma}{way}"


def _draw_buttons(view: View, axis: AxisConfig, kept: Reading[DiagnosisScreen]) -> Refresh:
    t, desk, usual = view.t, view.desk, Exploration()
    with ui.row().classes("items-end"):
        runs = ui.number(t("loop.runs"), value=usual.runs, min=2, max=100, precision=0).style("width: 12rem")
        rows = ui.number(t("loop.rows"), value=usual.rows, min=8, max=1000, precision=0).style("width: 12rem")
        warm = ui.number(t("loop.warm_up"), value=usual.warm_up_s, min=0, max=86_400).style("width: 14rem")
        for field, name in ((runs, "runs"), (rows, "rows"), (warm, "warm_up")):
            view.named(field, f"loop.{name}")
        start_button = view.button("loop.start", lambda: start(False))
        resume_button = view.button("loop.resume", lambda: start(True))

    async def start(resume: bool) -> None:
        from hil.jobs.close_loop import loop_job  # noqa: PLC0415  (the diagnosis is slow to load)
        from hil.procedures.close_loop import Turning  # noqa: PLC0415

        how = Exploration(int(runs.value), int(rows.value), float(warm.value))
        unfinished = None if kept.value is None else kept.value.unfinished
        if resume and unfinished is not None:
            how = unfinished
        await view.ask_and_run(loop_job(axis, Turning(how), resume=resume))

    def refresh() -> None:
        store = desk.rights.store
        can = view.can_start and view.is_builder and store is not None and store.builder_key is not None
        start_button.set_enabled(can)
        resume_button.set_enabled(can)
        resume_button.set_visibility(kept.value is not None and kept.value.unfinished is not None)

    return refresh


def _draw_stages(view: View) -> Refresh:
    """The axis after each stage."""
    t = view.t
    with ui.element("div"):
        verdict = view.value("loop.verdict", small=True)
        table = Table(view, "loop.stages", ["loop.head.stage", *(f"loop.head.{name}" for name in FIGURES)])
    drawn: list[Progress] = []

    def refresh() -> None:
        job = view.desk.last(CLOSE_LOOP)
        if job is None or not isinstance(job.result, Looped) or drawn == [job]:
            return
        drawn[:] = [job]
        verdict.set_text(t("loop.good" if job.result.good else "loop.not_good"))
        table.show(
            [
                [
                    t(f"loop.stage.{name.replace(', ', '_').replace(' ', '_')}"),
                    *(t.number(figures.get(one), 2) for one in FIGURES),
                ]
                for name, figures in job.result.stages.items()
            ]
        )

    return refresh
