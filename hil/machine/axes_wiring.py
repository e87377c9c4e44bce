"""Connecting several axes of one machine, each with its own axis file. They share a clock and, where they have the same, a bus or
line.

What concerns a single axis is in `hil.machine.wiring`.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from drivers.canopen.bus import CanLink
from drivers.clock import Waiting, WallClock
from drivers.drive import ServoDrive
from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig
from hil.machine.axis_lock import held_axis
from hil.machine.bench_conditions import BenchConditions
from hil.machine.instruments import build_instrument, with_instrument
from hil.machine.signals import ending_by_signals
from hil.machine.wiring import (
    Links,
    Machine,
    bench_modbus,
    bench_parameters,
    bench_table,
    canopen_drive,
    check_bench,
    hardware_drive,
    modbus_drive,
    session_of,
    virtual_drive,
)
from sim_backends.bench import Bench, BenchParameters
from sim_backends.canopen_in_turn import drives_in_turn
from sim_backends.clock import SimClock


@contextmanager
def connected_axes(
    axes: Sequence[AxisConfig], benches: Sequence[BenchParameters] | None = None, waiting: Waiting | None = None
) -> Iterator[tuple[Machine, ...]]:
    """Connect the axes. Each session watches the other axes too, and an error stops all of them. On leaving all are disconnected.

    benches: the simulated machines, one for each axis, instead of those that the axis files name. waiting: as for `connected`.
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
            machines = _on_bench(axes, benches or [bench_parameters(axis) for axis in axes], stack, waiting)
        else:
            machines = _on_hardware(axes, stack, waiting)
        for one in machines:
            one.session.supervisor.beside = tuple(other.session.axis for other in machines if other is not one)
        for one in machines:
            stack.enter_context(one.session)
        yield machines


def _on_hardware(axes: Sequence[AxisConfig], stack: ExitStack, waiting: Waiting | None) -> tuple[Machine, ...]:
    clock, links = WallClock(waiting), Links()
    drives = [hardware_drive(axis, clock, stack, links) for axis in axes]
    instruments = [build_instrument(axis.instrument, axis.instrument.port, clock) for axis in axes]
    return tuple(
        Machine(axis, session_of(axis, drive, instrument, None))
        for axis, drive, instrument in zip(axes, drives, instruments, strict=True)
    )


def _on_bench(
    axes: Sequence[AxisConfig], parameters: Sequence[BenchParameters], stack: ExitStack, waiting: Waiting | None
) -> tuple[Machine, ...]:
    clock = SimClock(waiting=waiting)
    benches = []
    for axis, wanted in zip(axes, parameters, strict=True):
        check_bench(axis, wanted)
        benches.append(stack.enter_context(Bench(with_instrument(wanted, axis.instrument), clock=clock)))
    drives = _bench_drives(axes, benches, clock, stack)
    return tuple(
        Machine(
            axis,
            session_of(
                axis,
                drive,
                build_instrument(axis.instrument, bench.laser_path, clock),
                BenchConditions(bench.plant, axis.conditions.levels),
            ),
            bench,
        )
        for axis, bench, drive in zip(axes, benches, drives, strict=True)
    )


def _bench_drives(
    axes: Sequence[AxisConfig], benches: Sequence[Bench], clock: SimClock, stack: ExitStack
) -> list[ServoDrive]:
    """Drives for the simulated servos on the wire that the axis files name: nodes 1, 2 … of one bus, units 1, 2 … of one line."""
    pairs = list(zip(axes, benches, strict=True))
    face = axes[0].drive.face
    if face == "virtual":
        return [virtual_drive(axis, bench) for axis, bench in pairs]
    if face == "canopen":
        place = ("virtual", f"bench-{uuid.uuid4().hex}")
        bus = stack.enter_context(drives_in_turn(clock, place[1]))
        for number, (axis, bench) in enumerate(pairs, start=1):
            bus.add(bench.servo, number, parameters=bench.parameters.objects, table=bench_table(axis, bench))
        links = Links({place: stack.enter_context(CanLink(bus.master(), clock))})
        nodes = [replace(axis, drive=replace(axis.drive, node_id=n)) for n, axis in enumerate(axes, start=1)]
        return [canopen_drive(axis, clock, place, stack, links=links) for axis in nodes]
    endpoint = bench_modbus(dict(enumerate(pairs, start=1)), clock, stack)
    shared = Links()
    return [modbus_drive(axis, clock, endpoint, unit, shared) for unit, axis in enumerate(axes, start=1)]
