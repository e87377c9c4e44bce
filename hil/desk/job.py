"""A job as the operator's desk runs it: its kind, its plan and its work, and the workplace that the work is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.clock import Waiting
from drivers.drive import ServoDrive
from drivers.errors import CapabilityError
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.correction.store import SealedStore
from hil.desk.plan import Plan
from hil.machine.computing import Computing, at_once
from hil.machine.events import Event, Listener
from hil.machine.machine import Machine
from hil.machine.session import AxisSession
from hil.records.journal import Campaign

if TYPE_CHECKING:  # a verb loads the simulation where its axis file names it
    from hil.machine.bench_wiring import RunningBench

Tell = Callable[[str], None]
Watch = Callable[[str, ServoDrive, AxisSession | None], None]


@dataclass(frozen=True)
class Question:
    """A question to the operator, to be answered by one of two buttons.

    kind: such as "run" or "condition"; figures: name -> text, the subject of the question; within_s: time limit for the answer.
    """

    kind: str
    figures: Mapping[str, str]
    within_s: float


Ask = Callable[[Question], bool | None]
"""Asks and waits for the answer with the axis watched; None for no answer in time. A stop ends the wait."""


def tell_unchecked(campaign: Campaign, listener: Listener) -> None:
    """Warn of what could not be checked of a resumed campaign's rows, before any are added."""
    if campaign.warning:
        listener(Event("rows", f"{campaign.directory}: {campaign.warning}", warning=True))


def no_answer(_question: Question) -> bool | None:
    """No operator can be asked."""
    return None


@dataclass(frozen=True)
class Workplace:
    """What a job's work is given.

    connected: the open drive, None where the job connects by itself; session: None then too, and for an axis without an instrument
    store: with the builder's key in the builder's role, without it where only the reading password was given, else None
    waiting: for a job that connects by itself: its clocks must wait through this, so that it can be stopped
    watch: for such a job: watch(axis name, drive, session or None) shows the samples of that axis on its desk
    ask: asks the operator
    computing: how long computations are run
    bench: a simulated machine that runs, for a job that connects by itself; None: it makes one
    """

    axis: DriveAxis
    connected: ServoDrive | None
    session: AxisSession | None
    listener: Listener
    tell: Tell
    store: SealedStore | None
    waiting: Waiting
    watch: Watch
    ask: Ask = no_answer
    computing: Computing = at_once
    bench: RunningBench | None = None

    @property
    def drive(self) -> ServoDrive:
        """The axis's drive, open. Raises CapabilityError where the job connects by itself."""
        if self.connected is None:
            raise CapabilityError(f"axis {self.axis.name} was disconnected for this job")
        return self.connected

    def machine(self) -> Machine:
        """The axis with its instrument. Raises CapabilityError where it has none."""
        if self.session is None or not isinstance(self.axis, AxisConfig):
            raise CapabilityError(f"axis {self.axis.name} has no instrument: its file ends with the drive")
        return Machine(self.axis, self.session)

    def opened_store(self) -> SealedStore:
        """The axis's store. Raises CapabilityError until its password was given."""
        if self.store is None:
            raise CapabilityError(f"the tables of axis {self.axis.name} are sealed: give the reading password first")
        return self.store


def _always(_result: object) -> bool:
    return True


@dataclass(frozen=True)
class Job:
    """A job. kind: "backlash", "calibrate" …, a desk keeps the last of each; work: runs in the thread that owns the axis.

    connects: the job connects what it needs itself (several axes, a machine with a probe); the desk disconnects its axis meanwhile.
    reached: whether a result of its work is what the job was for: a job without is over, and not done.
    """

    kind: str
    plan: Plan
    work: Callable[[Workplace], object]
    connects: bool = False
    reached: Callable[[Any], bool] = _always
