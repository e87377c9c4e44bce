"""A job as the operator's desk runs it: what it is called, what it would do, and the work itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.clock import Waiting
from drivers.drive import ServoDrive
from drivers.errors import CapabilityError
from hil.app.jobs.plan import Plan
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.correction.store import SealedStore
from hil.machine.events import Event, Listener
from hil.machine.session import AxisSession
from hil.machine.wiring import Machine
from hil.records.journal import Campaign

Tell = Callable[[str], None]
Watch = Callable[[str, ServoDrive, AxisSession | None], None]


@dataclass(frozen=True)
class Question:
    """What somebody at the machine is asked while a job waits, to be answered by yes or no.

    kind: says what, such as "run" or "condition"; figures: what it is about, as procedures say it; within_s: how long the job waits
    """

    kind: str
    figures: Mapping[str, str]
    within_s: float


Ask = Callable[[Question], bool | None]
"""Asks, and waits with the axis watched: the answer, None where nobody gave one in time. A stop ends it."""


def tell_unchecked(campaign: Campaign, listener: Listener) -> None:
    """Say what could not be checked of a resumed campaign's rows, before any are added to them."""
    if campaign.warning:
        listener(Event("rows", f"{campaign.directory}: {campaign.warning}", warning=True))


def nobody(_question: Question) -> bool | None:
    """For where nobody can be asked."""
    return None


@dataclass(frozen=True)
class Workplace:
    """A connected axis as a job finds it; session: None for an axis without an instrument, or where the job connects by itself.

    store: with the builder's key while a builder is at the desk, without it where only the reading password was given, else None.
    waiting: for a job that connects by itself: its clock has to wait through this, so that it can be stopped.
    watch: for the same: watch(axis name, drive, session or None) shows the looks at that axis on its desk.
    ask: somebody at the machine.
    """

    axis: DriveAxis
    connected: ServoDrive | None
    session: AxisSession | None
    listener: Listener
    tell: Tell
    store: SealedStore | None
    waiting: Waiting
    watch: Watch
    ask: Ask = nobody

    @property
    def drive(self) -> ServoDrive:
        """The axis's drive, open. Raises CapabilityError where the job connects by itself."""
        if self.connected is None:
            raise CapabilityError(f"axis {self.axis.name} was let go for this job")
        return self.connected

    def machine(self) -> Machine:
        """The axis with its instrument. Raises CapabilityError where it has none."""
        if self.session is None or not isinstance(self.axis, AxisConfig):
            raise CapabilityError(f"axis {self.axis.name} has no instrument: its file ends with the drive")
        return Machine(self.axis, self.session)

    def opened_store(self) -> SealedStore:
        """The axis's store. Raises CapabilityError while nobody has given its password."""
        if self.store is None:
            raise CapabilityError(f"the tables of axis {self.axis.name} are sealed: give the reading password first")
        return self.store


@dataclass(frozen=True)
class Job:
    """kind: "backlash", "calibrate" …, of which one desk remembers the last; work: runs in the thread that owns the axis.

    connects: the job connects what it needs by itself (several axes, a machine with a probe); the desk lets go of its axis meanwhile.
    """

    kind: str
    plan: Plan
    work: Callable[[Workplace], object]
    connects: bool = False
