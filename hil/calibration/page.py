"""Page of calibration and verification (system A): the plan in words, the errors while measured, figures before and
after, the band.
"""

from __future__ import annotations

from functools import partial

from nicegui import ui

from hil.axis.axis_file import AxisConfig
from hil.calibration import job as calibrate
from hil.calibration.job import CALIBRATE, ENTER, MANUAL, STRAIGHTNESS, UNCORRECTED, VERIFY, WITHDRAW, with_signs
from hil.calibration.page_data import CalibrationScreen, Resumable, calibration_screen
from hil.calibration.pages.result import Kept, draw_accuracy, draw_band, draw_curves, draw_figures
from hil.calibration.pages.typed_tables import TypedTables, across_axis, across_of, asking
from hil.desk.progress import Progress
from hil.figures.verdict import Decision
from hil.ui.screen.pieces import FolderContents, Steps, draw_ready, draw_where, lead, measured_checks, tables_check
from hil.ui.screen.plan_question import plan_question
from hil.ui.screen.plots import JobPlot
from hil.ui.screen.unfinished import GoOn, draw_unfinished
from hil.ui.screen.view import Refresh, View
from hil.ui.screen.zero_switches import ZeroSwitches

NEXT = ("reports", "diagnosis")
"""Pages that follow a verification: one that passed, or one that failed."""
KINDS = (CALIBRATE, VERIFY, UNCORRECTED)
SHOWN_KINDS = (*KINDS, STRAIGHTNESS, MANUAL, ENTER, WITHDRAW)
"""Colour of each stage's curves."""


def draw(view: View) -> None:
    axis = view.desk.axis
    if not isinstance(axis, AxisConfig):
        view.named(ui.label(view.t("calibrate.no_instrument")).classes("hil-note"), "calibrate.no_instrument")
        return
    kept: Kept = FolderContents(view, partial(calibration_screen, axis))
    messages = view.messages("calibrate.messages")
    typed = TypedTables(view, axis)
    ways: dict[str, GoOn] = {}
    draw_unfinished(view, "calibrate", ways)
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            parts = [
                draw_accuracy(view, kept),
                draw_where(view, "calibrate", lambda: view.desk.last_of(KINDS), progress=True),
                _draw_buttons(view, axis, kept, typed, ways),
            ]
        with ui.element("div").classes("hil-main"):
            steps = Steps(view, "calibrate", ("found", "tables", "verified"))
            with view.card("calibrate.live", name="calibrate.live.card") as live_card:
                x, y = view.t("calibrate.plot_x"), view.t("calibrate.plot_y")
                live = JobPlot(view, KINDS, x, y, name="calibrate.live", dots=True)
            curves_card, curves_refresh = draw_curves(view, axis, kept)
            view.how("calibrate.plan", "calibrate.steps")
    parts += [live.refresh, curves_refresh, draw_band(view, axis, kept, typed), draw_figures(view, axis, kept)]
    parts += [_draw_plan(view, axis), typed.draw()]

    def refresh() -> None:
        job = view.desk.last_of(KINDS)
        running = job is not None and job.running
        messages.show(view.desk.last_of(SHOWN_KINDS))
        steps.show(_steps(kept.value, job))
        live_card.set_visibility(running)
        curves_card.set_visibility(not running)
        for part in parts:
            part()

    view.every(refresh)


def _steps(screen: CalibrationScreen | None, job: Progress | None) -> list[str]:
    """The state of each step: what runs by the job, the others by what is on disk."""
    stages = {} if screen is None else screen.stages
    verified = screen is not None and screen.verified is not None
    states = ["done" if known else "" for known in ("before" in stages, "after" in stages, verified)]
    if job is None or job.carried_out or job.kind == UNCORRECTED:
        return states
    at = (2 if job.kind == VERIFY else 0) if job.step is None else job.step[0] - 1
    return [*states[:at], "now" if job.running else "broken", *[""] * (2 - at)]


def _draw_plan(view: View, axis: AxisConfig) -> Refresh:
    """The moves and writes of a calibration, in words, and whether the tables can be read and written."""
    t, rights = view.t, view.desk.rights
    with view.fold("calibrate.would"):
        lines = plan_question(calibrate.calibration_plan(axis), t)
        view.named(ui.label("\n".join(lines)).classes("hil-note"), "calibrate.plan.lines")
        opened = view.named(ui.label().classes("hil-name"), "calibrate.opened")

    def refresh() -> None:
        store = rights.store if view.in_control else None
        state = "not_opened" if store is None else "readable" if store.builder_key is None else "writable"
        opened.set_text(t(f"calibrate.{state}"))

    return refresh


def _draw_buttons(view: View, axis: AxisConfig, kept: Kept, typed: TypedTables, ways: dict[str, GoOn]) -> Refresh:
    """Start, verify, the next step, the straightness by the instrument; and the ways to go on with interrupted work."""
    t, desk = view.t, view.desk
    zero: ZeroSwitches

    async def start_new() -> None:
        signed, straightness, backlash = with_signs(axis, typed.signs()), typed.straightness(), typed.backlash()
        job = calibrate.calibration_job(signed, straightness=straightness, backlash=backlash, zero=zero.said())
        await zero.run(view.ask_and_run, job)

    async def verify() -> None:
        corrects, of_targets, said = bool(corrected.value), int(view.number_of(seed)), zero.said(anew=False)
        across = await across_of(view, axis) if corrects else None
        signed = with_signs(axis, typed.signs())
        job = calibrate.verification_job(signed, corrected=corrects, seed=of_targets, zero=said, across=across)
        await zero.run(asking(view, across), job)

    async def measure_straightness() -> None:
        across = across_axis(view, axis)
        job = calibrate.straightness_job(axis, across, seed=int(view.number_of(seed)), zero=zero.said(anew=False))
        await zero.run(asking(view, across), job)

    async def resume(kind: str) -> None:
        await _resume(view, axis, kept, kind, zero, typed=typed)

    ready = draw_ready(view, "calibrate", tables_check(view), *measured_checks(view), builder=True)
    with ui.element("div").classes("hil-buttons"):
        start = view.button("calibrate.start", start_new).classes("hil-go")
        verifying = view.button("calibrate.verify", verify)
        following = {page: view.button(f"calibrate.next.{page}", partial(_turn_to, view, page)) for page in NEXT}
    with view.fold("calibrate.more"):
        straightening = view.button("calibrate.straighten", measure_straightness)
        straightening.set_visibility(axis.straightness is not None)
        corrected, show_correction = _draw_correction_switch(view)
        seed = view.named(
            ui.number(t("calibrate.seed"), value=1, min=0, max=10_000, precision=0), "calibrate.seed"
        ).style("width: 14rem")
        zero = ZeroSwitches(view, "calibrate", anew=True)

    def of_builder() -> str:
        store = desk.rights.store if view.in_control else None
        writable = store is not None and store.builder_key is not None
        return view.why_not(builder=True) or ("" if writable else t("why.tables"))

    def of_reader() -> str:
        readable = view.in_control and desk.rights.store is not None
        return view.why_not() or ("" if readable else t("why.tables_read"))

    hindered = {CALIBRATE: of_builder, VERIFY: of_reader, UNCORRECTED: view.why_not}
    ways |= {kind: GoOn(f"calibrate.resume.{kind}", partial(resume, kind), why) for kind, why in hindered.items()}

    def refresh() -> None:
        for button in (start, straightening):
            button.allow(of_builder())
        verifying.allow(of_reader() if corrected.value else view.why_not())
        job = desk.job()
        main = "" if job is not None and job.running else _next_step(kept.value)
        lead({"calibrate": start, "verify": verifying, **following}.get(main), [start, verifying, *following.values()])
        for page, button in following.items():
            button.set_visibility(page == main)
        ready()
        show_correction()
        zero.refresh()

    return refresh


def _next_step(screen: CalibrationScreen | None) -> str:
    """What comes next by what is on disk: "calibrate", "verify", or a page of `NEXT`; "" where interrupted work is gone on with."""
    if screen is None or screen.unfinished:
        return ""
    if screen.verified is None:
        return "verify" if screen.tables or "after" in screen.stages else "calibrate"
    found = screen.verified.accuracy
    if found is not None and found.A_um is None:
        return "verify"
    return "diagnosis" if found is not None and found.decision is Decision.FAIL else "reports"


def _turn_to(view: View, page: str) -> None:
    ui.navigate.to(f"/axis/{view.desk.name}/{page}")


def _draw_correction_switch(view: View) -> tuple[ui.switch, Refresh]:
    """Whether a verification corrects. While one runs the switch says how it runs, whoever started it."""
    desk, kinds = view.desk, (VERIFY, UNCORRECTED)
    last = desk.last_of(kinds)
    with_it = last is None or not last.running or last.kind == VERIFY
    switch = view.named(ui.switch(view.t("calibrate.correction"), value=with_it), "calibrate.correction")

    def refresh() -> None:
        job = desk.job()
        under_way = job is not None and job.running and job.kind in kinds
        switch.set_enabled(not under_way)
        if under_way and job is not None:
            switch.set_value(job.kind == VERIFY)

    return switch, refresh


async def _resume(
    view: View, axis: AxisConfig, kept: Kept, kind: str, zero: ZeroSwitches, *, typed: TypedTables
) -> None:
    """Go on with the campaign that was broken off, with the targets, signs and backlash it was begun with."""
    begun = (kept.value.unfinished if kept.value is not None else {}).get(kind, Resumable("", 1))
    across, as_begun = None, with_signs(axis, begun.signs)
    if kind == CALIBRATE:
        straightness, backlash = typed.straightness(), begun.backlash
        job = calibrate.calibration_job(
            as_begun, straightness=straightness, backlash=backlash, resume=True, zero=zero.said()
        )
    else:
        said, across = zero.said(anew=False), await across_of(view, axis) if kind == VERIFY else None
        how = {"corrected": kind == VERIFY, "resume": True}
        job = calibrate.verification_job(as_begun, seed=begun.seed, zero=said, across=across, **how)
    await zero.run(asking(view, across), job)
