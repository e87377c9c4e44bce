"""Connecting several axes of one machine, each with its own axis file. They share a clock and, where they have the same, a bus or
line.

What concerns a single axis is in `hil.machine.wiring`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from drivers.clock import Waiting, WallClock
from drivers.drive import ServoDrive
from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, DriveAxis, load_drive_axis
from hil.axis.zero import zero_keeper
from hil.correction.bound import CAREFUL
from hil.machine.axis_lock import held_axis
from hil.machine.conditions import Conditions
from hil.machine.cross_axis import CrossAxisDrive
from hil.machine.instruments import build_instrument
from hil.machine.interrupts import ending_by_signals
from hil.machine.links import Links
from hil.machine.machine import Machine, session_of
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import hardware_drive

if TYPE_CHECKING:
    from hil.machine.bench_wiring import RunningBench

RUN_IN_MM = 1.0
"""By which an axis without [measurement] comes to its place from below: the usual overrun_mm."""


@contextmanager
def connected_axes(
    axes: Sequence[AxisConfig], bench: RunningBench | None = None, waiting: Waiting | None = None
) -> Iterator[tuple[Machine, ...]]:
    """Connect the axes. Each session watches the other axes too, and an error stops all of them. On leaving all are disconnected.

    bench, waiting: as for `connected`.
    Raises InputError for two axes of one name or file, or where some are on the bench and some are not, and as `connected`.
    """
    if len({axis.name for axis in axes}) < len(axes) or len({axis.path.resolve() for axis in axes}) < len(axes):
        raise InputError(f"axes {', '.join(axis.name for axis in axes)}: expected a file and a name for each")
    if len({(axis.drive.backend == "bench", axis.drive.face) for axis in axes}) > 1:
        raise InputError("one axis is on the bench and another is not, or behind another face: expected all alike")
    with ExitStack() as stack:
        stack.enter_context(ending_by_signals())
        for axis in axes:
            stack.enter_context(held_axis(axis))
        if axes[0].drive.backend == "bench":
            from hil.machine.bench_wiring import running_bench  # noqa: PLC0415  (a verb loads the wire its axis file names)

            bench = bench or stack.enter_context(running_bench(axes, waiting=waiting))
            machines = bench.machines(axes, stack)
        else:
            machines = _on_hardware(axes, stack, waiting)
        for one in machines:
            one.session.supervisor.beside = tuple(other.session.axis for other in machines if other is not one)
        for one in machines:
            stack.callback(_left, one.session.axis, [other.session.supervisor for other in machines])
            stack.enter_context(one.session)
        yield machines


def _left(axis: WatchedAxis, supervisors: Sequence[Supervisor]) -> None:
    """An axis that was stopped, disabled and closed is not stopped again with those that are left after it."""
    for supervisor in supervisors:
        supervisor.beside = tuple(other for other in supervisor.beside if other is not axis)


@contextmanager
def connected_across(
    axis: AxisConfig, conditions: Conditions | None = None, waiting: Waiting | None = None
) -> Iterator[Machine]:
    """Connect an axis with the one that its straightness moves, as its [straightness] names it: `session.cross` of the machine.

    That axis needs no instrument; it is homed where its own file has [measurement] home. Each watches the other, an error stops both.
    conditions, waiting: as for `connected`. Raises InputError for an axis file without [straightness], one that names itself, or an
    axis on another kind of backend, and as `connected`.
    """
    config = axis.across()
    other = load_drive_axis(config.axis_file)
    if other.name == axis.name or other.path.resolve() == axis.path.resolve():
        raise InputError("[straightness] axis_file names this axis itself, expected another", path=axis.path)
    if (other.drive.backend == "bench", other.drive.face) != (axis.drive.backend == "bench", axis.drive.face):
        raise InputError("one axis is on the bench and another is not, or behind another face: expected all alike")
    with ExitStack() as stack:
        stack.enter_context(ending_by_signals())
        stack.enter_context(held_axis(axis))
        stack.enter_context(held_axis(other))
        if axis.drive.backend == "bench":
            from hil.machine.bench_wiring import running_bench  # noqa: PLC0415  (a verb loads the wire its axis file names)

            bench = stack.enter_context(running_bench([axis, other], waiting=waiting))
            own, drive = bench.drives([axis, other], stack)
            machine = bench.machine(axis, bench.benches[0], own)
        else:
            wall, links = WallClock(waiting), Links()
            own, drive = (hardware_drive(one, wall, stack, links) for one in (axis, other))
            instrument = build_instrument(axis.instrument, axis.instrument.port, wall)
            machine = Machine(axis, session_of(axis, own, instrument, conditions))
        session = machine.session
        session.cross = _cross_axis(other, drive, config.at_mm)
        session.supervisor.beside = (session.cross.axis,)
        session.cross.supervisor.beside = (session.axis,)
        stack.enter_context(session.cross)
        stack.callback(_left, session.axis, [session.cross.supervisor])
        stack.enter_context(session)
        yield machine


def _cross_axis(other: DriveAxis, drive: ServoDrive, at_mm: float) -> CrossAxisDrive:
    measured = other if isinstance(other, AxisConfig) else None
    cross = CrossAxisDrive(
        drive,
        at_mm,
        velocity_mm_s=other.limits.max_velocity_mm_s / 5.0 if measured is None else measured.measurement.velocity_mm_s,
        run_in_mm=RUN_IN_MM if measured is None else measured.measurement.overrun_mm,
        homes=measured is not None and measured.measurement.home,
        zero=zero_keeper(other),
        bound=CAREFUL if measured is None else measured.correction.bound,
    )
    if cross.zero is not None:
        cross.zero.guard(drive)
    return cross


def _on_hardware(axes: Sequence[AxisConfig], stack: ExitStack, waiting: Waiting | None) -> tuple[Machine, ...]:
    clock, links = WallClock(waiting), Links()
    drives = [hardware_drive(axis, clock, stack, links) for axis in axes]
    instruments = [build_instrument(axis.instrument, axis.instrument.port, clock) for axis in axes]
    return tuple(
        Machine(axis, session_of(axis, drive, instrument, None))
        for axis, drive, instrument in zip(axes, drives, instruments, strict=True)
    )
