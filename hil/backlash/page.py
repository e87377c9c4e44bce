"""Page of lost motion by torque (system B): start, both measured values, the graph, the mean, write, restore the
original, off and on.
"""

from __future__ import annotations

from functools import partial

from nicegui import ui

from drivers.errors import StateError
from hil.axis.backlash import BacklashConfig
from hil.backlash import job as backlash
from hil.backlash.job import CompensationState
from hil.backlash.page_data import backlash_screen, kept_backlash
from hil.ui.screen.pieces import FolderContents, StartCondition, draw_ready, draw_where, lead
from hil.ui.screen.plots import JobPlot
from hil.ui.screen.view import Refresh, View


def draw(view: View) -> None:
    messages = view.messages("backlash.messages")
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            parts = [
                _draw_measured(view),
                draw_where(view, "backlash", lambda: view.desk.last(backlash.MEASURE)),
                _draw_buttons(view),
            ]
        with ui.element("div").classes("hil-main"):
            with view.card("backlash.graph"):
                x, y = view.t("backlash.plot_x"), view.t("backlash.plot_y")
                plot = JobPlot(view, backlash.MEASURE, x, y, name="backlash.plot")
            view.how("backlash.instructions", "backlash.steps")

    def refresh() -> None:
        shown = backlash_screen(view.desk)
        messages.show(shown.measurement, shown.warning)
        for part in parts:
            part()
        plot.refresh()
        mean_um = shown.mean_um
        plot.mark(mean_um, "" if mean_um is None else view.t("backlash.breaks_away", um=view.t.number(mean_um, 2)))

    view.every(refresh)


def _draw_measured(view: View) -> Refresh:
    """Both directions and the mean; the drive's present value and its original one."""
    t = view.t
    with view.card("backlash.measured"):
        mean = view.value("backlash.mean", "µm")
        with ui.element("div").classes("hil-lines"):
            plus_minus = view.value("backlash.plus_minus", "µm", small=True)
            minus_plus = view.value("backlash.minus_plus", "µm", small=True)
            present = view.value("backlash.present", small=True)
            original = view.value("backlash.original", small=True)
            switched = view.value("backlash.function", small=True)
        before = view.named(ui.label().classes("hil-name"), "backlash.kept")
    kept = FolderContents(view, partial(kept_backlash, view.desk.axis))

    def refresh() -> None:
        shown = backlash_screen(view.desk)
        earlier = kept.value if shown.measurement is None else None  # of a server before this one
        by_direction = shown.by_direction_um if earlier is None else earlier.found.by_direction_um
        plus_minus.set_text(t.number(by_direction.get(-1), 2))
        minus_plus.set_text(t.number(by_direction.get(1), 2))
        mean.set_text(t.number(shown.mean_um if earlier is None else earlier.found.lost_motion_um, 2))
        before.set_text("" if earlier is None else t("backlash.kept", date=earlier.at.strftime("%Y-%m-%d %H:%M")))
        seen = shown.parameter
        if seen is not None:
            present.set_text(f"{t.number(seen.amount, 2)} ({t.number(seen.amount * seen.amount_um, 2)} µm)")
            original.set_text(t.number(seen.original, 2))
            switched.set_text(t("backlash.on" if seen.on else "backlash.off"))

    return refresh


async def _read_now(view: View, how: BacklashConfig) -> CompensationState | None:
    """The parameter as the drive holds it now, read before each question; None where it could not be read, which is shown."""
    read = await view.finished(backlash.look_job(view.desk.axis, how))
    if read is None:
        return None
    if not isinstance(read.result, CompensationState):
        raise StateError(read.error or view.t("why.not_read"))
    return read.result


def _change(view: View, seen: CompensationState, new: float | None) -> str:
    """Old and new value of the parameter, in its own unit and in µm."""

    def both(amount: float | None) -> str:
        um = None if amount is None else amount * seen.amount_um
        return f"{view.t.significant(amount, 6)} ({view.t.number(um, 2)} µm)"

    return view.change(seen.name, both(seen.amount), both(new))


def _draw_buttons(view: View) -> Refresh:
    t, desk = view.t, view.desk
    how = backlash.backlash_config(desk.axis)
    fastest = desk.axis.limits.max_velocity_mm_s
    with ui.row().classes("items-end no-wrap full-width"):
        speed = ui.number(t("backlash.speed"), value=how.velocity_mm_s, min=0.01, max=fastest)
        runs = ui.number(t("backlash.runs"), value=how.runs, min=1, max=100, precision=0)
        view.named(speed, "backlash.speed")
        view.named(runs, "backlash.runs")

    async def start() -> None:
        velocity_mm_s, times = view.number_of(speed), int(view.number_of(runs))
        wanted = backlash.backlash_config(desk.axis, velocity_mm_s=velocity_mm_s, runs=times)
        await view.ask_and_run(backlash.measuring_job(desk.axis, wanted))

    async def write() -> None:
        mean_um, seen = backlash_screen(desk).mean_um, await _read_now(view, how)
        if mean_um is not None and seen is not None:
            change = _change(view, seen, seen.amount_of(mean_um))
            await view.ask_and_run(backlash.write_job(desk.axis, how, mean_um), changes=[change])

    async def restore() -> None:
        seen = await _read_now(view, how)
        if seen is not None:
            job = backlash.restore_job(desk.axis, how)
            await view.ask_and_run(job, changes=[_change(view, seen, seen.to_restore)])

    async def switch() -> None:
        seen = await _read_now(view, how)
        if seen is not None:
            job = backlash.switch_job(desk.axis, how, on=not seen.on)
            await view.ask_and_run(job, changes=[_change(view, seen, 0.0 if seen.on else seen.written)])

    homing = StartCondition("homing", lambda: desk.live.homed is not False, done_by_itself=True)
    ready = draw_ready(view, "backlash", homing)
    with ui.element("div").classes("hil-buttons"):
        start_button = view.button("backlash.start", start).classes("hil-go")
        write_button = view.button("backlash.write", write)
        restore_button = view.button("backlash.restore", restore)
        switch_button = view.button("backlash.switch", switch)
        look_button = view.button("backlash.look", lambda: desk.run(view.token, backlash.look_job(desk.axis, how)))

    def refresh() -> None:
        shown = backlash_screen(desk)
        ready()
        start_button.allow(view.why_not())
        of_builder = view.why_not(builder=True)
        lead(write_button if shown.to_write else start_button, [start_button, write_button])
        write_button.allow(of_builder or ("" if shown.mean_um is not None else t("why.measured_before")))
        switch_button.allow(of_builder or ("" if shown.parameter is not None else t("why.not_read")))
        restore_button.allow(view.why_not() if shown.interrupted else of_builder)
        look_button.allow(view.why_not())

    return refresh
