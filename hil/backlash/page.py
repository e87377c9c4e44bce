"""Page of lost motion by torque (system B): start, both measured values, the graph, the mean, write, restore the
original, off and on.
"""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from hil.app.panel.pieces import draw_where
from hil.app.panel.plots import JobPlot
from hil.app.panel.view import View
from hil.backlash import job as backlash
from hil.backlash.page_data import backlash_screen

Refresh = Callable[[], None]


def draw(view: View) -> None:
    """Draws the page."""
    with view.card("backlash.instructions"):
        ui.markdown(view.t("backlash.steps"))
    messages = view.messages("backlash.messages")
    with ui.element("div").classes("hil-grid"):
        parts = [_draw_where(view), _draw_measured(view), _draw_parameter(view)]
    plot = JobPlot(view, backlash.MEASURE, view.t("backlash.plot_x"), view.t("backlash.plot_y"), name="backlash.plot")
    parts.append(_draw_buttons(view))

    def refresh() -> None:
        shown = backlash_screen(view.desk)
        messages.show(shown.measurement, shown.warning)
        for part in parts:
            part()
        plot.refresh()

    view.every(refresh)


def _draw_where(view: View) -> Refresh:
    """Position of the axis, remaining distance, and the present step."""
    with view.card("backlash.where"):
        return draw_where(view, "backlash", lambda: view.desk.last(backlash.MEASURE))


def _draw_measured(view: View) -> Refresh:
    """Both directions and the mean."""
    t = view.t
    with view.card("backlash.measured"):
        plus_minus = view.value("backlash.plus_minus", "µm", small=True)
        minus_plus = view.value("backlash.minus_plus", "µm", small=True)
        mean = view.value("backlash.mean", "µm")

    def refresh() -> None:
        shown = backlash_screen(view.desk)
        plus_minus.set_text(t.number(shown.by_direction_um[-1], 2))
        minus_plus.set_text(t.number(shown.by_direction_um[1], 2))
        mean.set_text(t.number(shown.mean_um, 2))

    return refresh


def _draw_parameter(view: View) -> Refresh:
    """The drive's present value and its original one."""
    t = view.t
    with view.card("backlash.parameter"):
        present = view.value("backlash.present", small=True)
        original = view.value("backlash.original", small=True)
        switched = view.value("backlash.function", small=True)

    def refresh() -> None:
        seen = backlash_screen(view.desk).parameter
        if seen is None:
            return
        present.set_text(f"{t.number(seen.amount, 2)} ({t.number(seen.amount * seen.amount_um, 2)} µm)")
        original.set_text(t.number(seen.original, 2))
        switched.set_text(t("backlash.on" if seen.on else "backlash.off"))

    return refresh


def _draw_buttons(view: View) -> Refresh:
    """Inputs and buttons."""
    t, desk = view.t, view.desk
    how = backlash.backlash_config(desk.axis)
    fastest = desk.axis.limits.max_velocity_mm_s
    with ui.row().classes("items-end"):
        speed = ui.number(t("backlash.speed"), value=how.velocity_mm_s, min=0.01, max=fastest)
        runs = ui.number(t("backlash.runs"), value=how.runs, min=1, max=100, precision=0)
        view.named(speed, "backlash.speed")
        view.named(runs, "backlash.runs")

    async def start() -> None:
        velocity_mm_s, times = view.number_of(speed), int(view.number_of(runs))
        wanted = backlash.backlash_config(desk.axis, velocity_mm_s=velocity_mm_s, runs=times)
        await view.ask_and_run(backlash.measuring_job(desk.axis, wanted))

    async def write() -> None:
        mean_um = backlash_screen(desk).mean_um
        if mean_um is not None:
            await view.ask_and_run(backlash.write_job(desk.axis, how, mean_um))

    async def switch() -> None:
        seen = backlash_screen(desk).parameter
        if seen is not None:
            await view.ask_and_run(backlash.switch_job(desk.axis, how, on=not seen.on))

    with ui.row():
        start_button = view.button("backlash.start", start)
        write_button = view.button("backlash.write", write)
        view.button("backlash.restore", lambda: view.ask_and_run(backlash.restore_job(desk.axis, how)))
        switch_button = view.button("backlash.switch", switch)
        view.button("backlash.look", lambda: desk.run(view.token, backlash.look_job(desk.axis, how)))

    def refresh() -> None:
        shown = backlash_screen(desk)
        start_button.set_enabled(view.can_start)
        write_button.set_enabled(view.can_start and view.is_builder and shown.mean_um is not None)
        switch_button.set_enabled(view.can_start and view.is_builder and shown.parameter is not None)

    return refresh
