"""What the parts of the probe's page have in common: the machine, its store as far as this browser opened it, how a job starts."""

from __future__ import annotations

from dataclasses import dataclass

from hil.app.desk.desk import Desk
from hil.app.jobs.job import Job
from hil.app.panel.view import View
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.screen import last_at, lent, store_at
from hil.probe.store import RunOutStore


@dataclass(frozen=True)
class AtProbe:
    """One page of the probe."""

    view: View
    config: ProbeMachineConfig

    @property
    def store(self) -> RunOutStore | None:
        """As far as it is open to this browser; None for a sealed one that is not."""
        config, view = self.config, self.view
        return store_at(config, view.desk) if view.in_control or not config.store.sealed else None

    @property
    def lent(self) -> list[Desk]:
        """Of the other axes that this server has, those that are the machine's."""
        return lent(self.config, self.view.desks, self.view.desk)

    @property
    def not_controlled(self) -> list[Desk]:
        """Those of them that this browser does not control."""
        tokens = self.view.browser.tokens
        return [desk for desk in self.lent if not desk.control.holds(tokens.get(desk.name))]

    @property
    def can_start(self) -> bool:
        """This browser controls every axis that has to be let go, each is there, and no job of the probe runs."""
        job = last_at(self.view.desks)
        idle = job is None or not job.running
        return self.view.can_start and idle and not self.not_controlled and all(one.live.connected for one in self.lent)

    async def ask_and_run(self, job: Job) -> None:
        """As the view's, with the axes that have to be lent."""
        await self.view.ask_and_run(job, self.lent)
