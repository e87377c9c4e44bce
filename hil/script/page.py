"""Page of a user's own procedure: its parameters, start, zero and resume, and the error of each row as it is measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig
from hil.script.procedure import Procedure, naming_the_line
from hil.script.procedure_file import parameters_of
from hil.script.procedure_job import procedure_job, resuming_job
from hil.ui.screen.pieces import draw_ready, draw_where, lead, measured_checks, tables_check
from hil.ui.screen.plots import JobPlot
from hil.ui.screen.unfinished import GoOn, draw_unfinished
from hil.ui.screen.view import View
from hil.ui.screen.zero_switches import ZeroSwitches


def draw(view: View, procedure: type[Procedure]) -> None:
    """Draws the page."""
    axis = view.desk.axis
    if not isinstance(axis, AxisConfig):
        view.named(ui.label(view.t("procedure.no_instrument")).classes("hil-note"), "procedure.no_instrument")
        return
    messages = view.messages("procedure.messages")
    ways: dict[str, GoOn] = {}
    interrupted = draw_unfinished(view, "procedure", ways)
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            where = draw_where(view, "procedure", lambda: view.desk.last(procedure.kind))
            buttons = _draw_buttons(view, axis, procedure, ways, interrupted)
        with ui.element("div").classes("hil-main"), view.card("procedure.rows"):
            x, y = view.t("procedure.plot_x"), view.t("procedure.plot_y")
            plot = JobPlot(view, procedure.kind, x, y, name="procedure.plot", dots=True)

    view.every(lambda: messages.show(view.desk.last(procedure.kind)), where, buttons, plot.refresh)


def _draw_buttons(
    view: View, axis: AxisConfig, procedure: type[Procedure], ways: dict[str, GoOn], interrupted: Callable[[], bool]
) -> Callable[[], None]:
    """A field for each parameter, start, and the way to go on with an interrupted run."""
    fields = {}
    with view.card("procedure.parameters"):
        view.named(ui.label(procedure.__name__), "procedure.name")
        for one in parameters_of(procedure):
            is_switch = bool in one.kind.types
            field: Any = (
                ui.switch(one.name, value=one.usual is True) if is_switch else ui.input(one.name, value=one.shown)
            )
            fields[one] = view.named(field, f"procedure.{one.name}")
        corrected = view.named(ui.switch(view.t("calibrate.correction"), value=False), "procedure.correction")

    def given() -> Procedure:
        values = {}
        for one, field in fields.items():
            try:
                values[one.name] = field.value if bool in one.kind.types else one.kind.read(str(field.value))
            except ValueError as error:
                raise InputError(f"{one.name} is {field.value!r}, expected {one.kind.said}") from error
        with naming_the_line(procedure, "__init__"):
            return procedure(**values)

    async def start() -> None:
        job = procedure_job(axis, given(), corrected=bool(corrected.value), zero=zero.said())
        await zero.run(view.ask_and_run, job)

    async def resume() -> None:
        await zero.run(view.ask_and_run, resuming_job(axis, procedure, zero=zero.said()))

    tables = tables_check(view, lambda: bool(corrected.value))
    ready = draw_ready(view, "procedure", tables, *measured_checks(view))
    with ui.element("div").classes("hil-buttons"):
        begin = view.button("procedure.start", start)
        zero = ZeroSwitches(view, "procedure", anew=True)

    ways[procedure.kind] = GoOn("procedure.resume", resume, view.why_not)

    def refresh() -> None:
        ready()
        begin.allow(view.why_not() or ("" if tables.met() else view.t("why.tables_read")))
        zero.refresh()
        lead(None if interrupted() else begin, [begin])

    return refresh
