"""The loop, a part of the page of the diagnosis: calibrate, explore, diagnose, extend, measure again."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from hil.axis.axis_file import AxisConfig
from hil.calibration.explore import Exploration
from hil.diagnosis.loop.jobs.plan import CLOSE_LOOP, passes_at
from hil.diagnosis.page_data import DiagnosisScreen
from hil.machine.in_motion_settings import feeds_of
from hil.records.journal import measurement_of
from hil.ui.screen.pieces import (
    FolderContents,
    Latest,
    ScreenTable,
    Steps,
    draw_ready,
    draw_where,
    lead,
    measured_checks,
)
from hil.ui.screen.plots import JobPlot
from hil.ui.screen.unfinished import GoOn, draw_unfinished
from hil.ui.screen.view import Refresh, View
from hil.ui.screen.zero_switches import ZeroSwitches

IN_MOTION = ("motion_before", "motion_diagnose", "motion_after")
STEPS = ("measure", "round", "before", "diagnose", "after", *IN_MOTION)
"""Those in motion are shown of a job that has them."""
FIGURES = ("rms_um", "peak_um", "A_um", "R_um", "B_um", "M_um")


def draw_loop(view: View, axis: AxisConfig, kept: FolderContents[DiagnosisScreen]) -> Refresh:
    """Draws verdict, step, settings, start, live plot and the figures of each stage; returns their refresh."""
    t = view.t
    messages = view.messages("loop.messages")
    ways: dict[str, GoOn] = {}
    interrupted = draw_unfinished(view, "loop", ways)
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            parts = [
                _draw_verdict(view, kept),
                draw_where(view, "loop", lambda: view.desk.last(CLOSE_LOOP), progress=True),
                _draw_buttons(view, axis, kept, ways, interrupted),
            ]
        with ui.element("div").classes("hil-main"):
            steps = Steps(view, "loop", STEPS, usual=len(STEPS) - len(IN_MOTION))
            with view.card("loop.rows_live", name="loop.live.card"):
                x, y = t("calibrate.plot_x"), t("calibrate.plot_y")
                live = JobPlot(view, CLOSE_LOOP, x, y, name="loop.live", dots=True, as_one=_as_one)
            parts += [_draw_stages(view, kept), live.refresh]
            view.how("loop.title", "loop.steps")
    measured = [""]

    def refresh() -> None:
        job = view.desk.last(CLOSE_LOOP)
        now = "" if job is None or not job.running else measurement_of(job.stage.partition(" ")[0])
        if now != measured[0]:  # one more stage is on disk
            measured[0] = now
            kept.again()
        messages.show(job)
        steps.follow(job)
        for part in parts:
            part()

    return refresh


def _as_one(series: str) -> str:
    """Series name under which all passes of one exploring campaign are drawn."""
    name, comma, way = series.partition(",")
    return f"{measurement_of(name)}{comma}{way}"


def _draw_buttons(
    view: View,
    axis: AxisConfig,
    kept: FolderContents[DiagnosisScreen],
    ways: dict[str, GoOn],
    interrupted: Callable[[], bool],
) -> Refresh:
    """Start and settings; and the way to go on with an interrupted loop."""
    t, desk, usual = view.t, view.desk, Exploration()
    ready = draw_ready(view, "loop", *measured_checks(view), builder=True)
    with ui.element("div").classes("hil-buttons"):
        start_button = view.button("loop.start", lambda: start(False)).classes("hil-go")
    with view.fold("loop.more"):
        runs = ui.number(t("loop.runs"), value=usual.runs, min=2, max=100, precision=0)
        rows = ui.number(t("loop.rows"), value=usual.rows, min=8, max=1000, precision=0)
        warm = ui.number(t("loop.warm_up"), value=usual.warm_up_s, min=0, max=86_400)
        feeds = ui.input(t("loop.feeds"), placeholder=t("loop.at_rest"))
        for field, name in ((runs, "runs"), (rows, "rows"), (warm, "warm_up"), (feeds, "feeds")):
            view.named(field, f"loop.{name}")
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

    def why_not() -> str:
        store = desk.rights.store
        writable = store is not None and store.builder_key is not None
        return view.why_not(builder=True) or ("" if writable else t("why.tables"))

    ways[CLOSE_LOOP] = GoOn("loop.resume", lambda: start(True), why_not)

    def refresh() -> None:
        start_button.allow(why_not())
        lead(None if interrupted() else start_button, [start_button])
        ready()
        zero.refresh()

    return refresh


def _draw_verdict(view: View, kept: FolderContents[DiagnosisScreen]) -> Refresh:
    """How the last loop ended, what is left after its last stage, and of when it is."""
    t = view.t
    with view.card("loop.verdict", name="loop.verdict.card"):
        verdict = view.named(ui.label("–").classes("hil-headline"), "loop.verdict")
        with ui.element("div").classes("hil-lines"):
            before = view.value("loop.before", "µm", small=True)
            after = view.value("loop.after", "µm", small=True)
        of = view.named(ui.label().classes("hil-name"), "loop.of")
    latest = Latest()

    def refresh() -> None:
        screen = kept.value
        loop = None if screen is None else screen.loop
        if screen is None or loop is None or not latest.is_new(loop):
            return
        outcome = "not_ended" if loop.good is None else "good" if loop.good else "not_good"
        verdict.set_text(t(f"loop.{outcome}"))
        verdict.classes(replace=f"hil-headline {'hil-good' if loop.good else '' if loop.good is None else 'hil-bad'}")
        rms_um = [figures.get("rms_um") for figures in loop.stages.values()]
        before.set_text(t.number(rms_um[0], 2))
        after.set_text(t.number(rms_um[-1] if len(rms_um) > 1 else None, 2))
        begun = [one.begun for one in screen.choices if one.key.startswith(f"{loop.place}/")]
        of.set_text(t("loop.of", date=min(begun).strftime("%Y-%m-%d %H:%M")) if begun else "")

    return refresh


def _draw_stages(view: View, kept: FolderContents[DiagnosisScreen]) -> Refresh:
    """Figures of the axis after each stage of the last loop, from its files; hidden before the first."""
    t = view.t
    with view.card("loop.figures", name="loop.stages.card").classes("hil-small") as card:
        table = ScreenTable(view, "loop.stages", ["loop.head.stage", *(f"loop.head.{name}" for name in FIGURES)])
    card.set_visibility(False)
    latest = Latest()

    def refresh() -> None:
        loop = None if kept.value is None else kept.value.loop
        if loop is None or not latest.is_new(loop):
            return
        card.set_visibility(True)
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
