"""What a person knows of the axis's zero and nothing else can tell, beside the buttons of a job: for that job alone."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui

from hil.app.jobs.job import Job
from hil.app.jobs.of_zero import OfZero
from hil.app.panel.view import View


class ZeroSwitches:
    """Off until somebody sets them, and off again once the job has begun: they are said of one moment. name: of the page.

    anew: also the switch that has the zero taken anew, which only the builder may set.
    """

    def __init__(self, view: View, name: str, *, anew: bool = False) -> None:
        t = view.t
        self._view = view
        self._zeroed = view.named(ui.switch(t("zero.instrument_zeroed"), value=False), f"{name}.instrument_zeroed")
        self._anew = view.named(ui.switch(t("zero.anew"), value=False), f"{name}.new_zero") if anew else None

    def refresh(self) -> None:
        """Enabled while the person here may start what they belong to."""
        self._zeroed.set_enabled(self._view.can_start)
        if self._anew is not None:
            self._anew.set_enabled(self._view.can_start and self._view.is_builder)

    def said(self, *, anew: bool = True) -> OfZero:
        """anew: whether the job takes a zero anew at all."""
        wanted = anew and self._anew is not None and bool(self._anew.value)
        return OfZero(anew=wanted, instrument_zeroed=bool(self._zeroed.value))

    async def run(self, ask_and_run: Callable[[Job], Awaitable[bool]], job: Job) -> None:
        """Ask and run a job that was told what they say."""
        if await ask_and_run(job):
            self._zeroed.set_value(False)
            if self._anew is not None:
                self._anew.set_value(False)
