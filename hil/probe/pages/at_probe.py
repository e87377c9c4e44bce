"""State shared by the parts of the probe's page: the machine, its store as far as this browser opened it, how a job
starts.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.desk.desk import Desk
from hil.desk.job import Job
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.page_data import last_at, lent, store_at
from hil.probe.store import RunOutStore
from hil.ui.screen.view import View


@dataclass(frozen=True)
class ProbePage:
    """The probe's page in one browser."""

    view: View
    config: ProbeMachineConfig

    @property
    def store(self) -> RunOutStore | None:
        """The store as far as it is open to this browser; None for a sealed one that is not."""
        config, view = self.config, self.view
        return store_at(config, view.desk) if view.in_control or not config.store.sealed else None

    @property
    def lent(self) -> list[Desk]:
        """The desks of other axes of this server that belong to the machine."""
        return lent(self.config, self.view.desks, self.view.desk)

    @property
    def not_controlled(self) -> list[Desk]:
        """Those of them that this browser does not control."""
        tokens = self.view.browser.tokens
        return [desk for desk in self.lent if not desk.control.holds(tokens.get(desk.name))]

    @property
    def can_start(self) -> bool:
        """This browser controls every axis that has to be released, each is connected, and no job of the probe runs."""
        job = last_at(self.view.desks)
        idle = job is None or not job.running
        return self.view.can_start and idle and not self.not_controlled and all(one.live.connected for one in self.lent)

    def why_not(self) -> str:
        """Why no job of the probe can be started here, "" where it can."""
        why, t = self.view.why_not(), self.view.t
        return why or ("" if self.can_start else t("why.other_axes"))

    async def ask_and_run(self, job: Job) -> None:
        """Asks and runs as the view does, with the axes that have to be released."""
        await self.view.ask_and_run(job, self.lent)
