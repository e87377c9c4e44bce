"""How a desk comes by its axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from drivers.clock import Waiting
from drivers.drive import ServoDrive
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.machine.session import AxisSession
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import connected, connected_drive


@dataclass(frozen=True)
class Connection:
    """A connected axis; session: None for an axis without an instrument."""

    drive: ServoDrive
    session: AxisSession | None

    def one_job(self) -> AbstractContextManager[object]:
        """Around a job: whatever goes wrong stops the axis, and afterwards it is as it was found."""
        if self.session is None:
            return Supervisor([WatchedAxis(self.drive)])
        return self.session.one_job()


Connect = Callable[[Waiting], AbstractContextManager[Connection]]


def to_axis(axis: DriveAxis) -> Connect:
    """The axis of an axis file, with its instrument where it has one."""

    @contextmanager
    def connect(waiting: Waiting) -> Iterator[Connection]:
        if isinstance(axis, AxisConfig):
            with connected(axis, waiting=waiting) as machine:
                yield Connection(machine.session.drive, machine.session)
        else:
            with connected_drive(axis, waiting=waiting) as drive:
                yield Connection(drive, None)

    return connect
