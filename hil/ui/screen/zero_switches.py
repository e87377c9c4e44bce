"""Switches beside the buttons of a job for a person's statement about the axis's zero, for that job alone."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui

from hil.desk.job import Job
from hil.desk.zero_statement import ZeroStatement
from hil.ui.screen.view import View


class ZeroSwitches:
    """The switches, off by default and off again once the job was started. name: of the page.

    anew: with the switch for a new zero, which needs the builder's role.
    """

    def __init__(self, view: View, name: str, *, anew: bool = False) -> None:
        t = view.t
        self._view = view
        self._zeroed = view.named(ui.switch(t("zero.instrument_zeroed"), value=False), f"{name}.instrument_zeroed")
        self._anew = view.named(ui.switch(t("zero.anew"), value=False), f"{name}.new_zero") if anew else None

    def refresh(self) -> None:
        """Enable the switches while this browser may start the job."""
        self._zeroed.set_enabled(self._view.can_start)
        if self._anew is not None:
            self._anew.set_enabled(self._view.can_start and self._view.is_builder)

    def said(self, *, anew: bool = True) -> ZeroStatement:
        """The statement of the switches. anew: whether the job can take the zero anew."""
        wanted = anew and self._anew is not None and bool(self._anew.value)
        return ZeroStatement(anew=wanted, instrument_zeroed=bool(self._zeroed.value))

    async def run(self, ask_and_run: Callable[[Job], Awaitable[bool]], job: Job) -> None:
        """Ask and run a job with this statement; switch off once it was started."""
        if await ask_and_run(job):
            self._zeroed.set_value(False)
            if self._anew is not None:
                self._anew.set_value(False)
