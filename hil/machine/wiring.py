"""Builds the session of one axis from its axis file, on hardware or on the bench. Only the wiring modules name concrete drives.

All other modules of `hil` work against `ServoDrive` and `DistanceInstrument`, so that the same code runs on hardware and in tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from drivers.clock import Clock, Waiting, WallClock
from drivers.correction_table import RawTable, TableDescription
from drivers.drive import ServoDrive
from drivers.errors import CapabilityError
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.machine.axis_lock import held_axis, modbus_endpoint
from hil.machine.conditions import Conditions
from hil.machine.instruments import build_instrument
from hil.machine.interrupts import ending_by_signals
from hil.machine.links import Links
from hil.machine.machine import Machine, session_of

if TYPE_CHECKING:  # a verb loads the wire that its axis file names
    import canopen

    from drivers.modbus.raw_parameters import ModbusRawParameters
    from hil.machine.bench_wiring import RunningBench


@contextmanager
def connected(
    axis: AxisConfig,
    bench: RunningBench | None = None,
    conditions: Conditions | None = None,
    waiting: Waiting | None = None,
    network: canopen.Network | None = None,
) -> Iterator[Machine]:
    """Connect the axis of an axis file. On leaving it is stopped after an error, disabled unless it was enabled, and disconnected.

    bench: for backend "bench", the simulated machine that runs; None: the one that the axis file names is switched on
    conditions: sets load and the like on a real machine; the bench has its own
    waiting: the waits of the axis's clock go through it, so that another thread can end a wait
    network: a user's connected canopen.Network in place of the CAN bus that the axis file names; what would move the axis beside us is
    refused there (`drivers.canopen.beside`)
    Raises InputError for a bench whose travel or scaling is not the axis file's, and while another process has connected this axis
    file or its drive. Raises what connecting raises.
    """
    with ExitStack() as stack:
        stack.enter_context(ending_by_signals())
        stack.enter_context(held_axis(axis))
        if axis.drive.backend == "bench":
            from hil.machine.bench_wiring import running_bench  # noqa: PLC0415  (a verb loads the wire its axis file names)

            bench = bench or stack.enter_context(running_bench([axis], waiting=waiting))
            (machine,) = bench.machines([axis], stack)
        else:
            machine = _on_hardware(axis, conditions, stack, WallClock(waiting), Links(network=network))
        stack.enter_context(machine.session)
        yield machine


def _on_hardware(
    axis: AxisConfig, conditions: Conditions | None, stack: ExitStack, clock: Clock, links: Links
) -> Machine:
    drive = hardware_drive(axis, clock, stack, links)
    instrument = build_instrument(axis.instrument, axis.instrument.port, clock)
    return Machine(axis, session_of(axis, drive, instrument, conditions))


# -- drives ------------------------------------------------------------------------------------------------------------
@contextmanager
def connected_drive(
    axis: DriveAxis,
    bench: RunningBench | None = None,
    waiting: Waiting | None = None,
    network: canopen.Network | None = None,
) -> Iterator[ServoDrive]:
    """The drive alone, open, without an instrument; it is not enabled. bench, waiting, network, errors: as for `connected`."""
    with ExitStack() as stack:
        stack.enter_context(ending_by_signals())
        stack.enter_context(held_axis(axis))
        yield stack.enter_context(_drive_alone(axis, stack, bench, waiting, network))


@contextmanager
def connected_registers(axis: AxisConfig) -> Iterator[ModbusRawParameters]:
    """A Modbus drive's registers by name. No sample is taken, so that it works with a wrong register map too.

    Raises CapabilityError for a drive that is not on Modbus, and as `connected`.
    """
    with ExitStack() as stack:
        stack.enter_context(held_axis(axis))
        from drivers.modbus.drive import ModbusDrive  # noqa: PLC0415  (a verb loads the wire its axis file names)

        drive = _drive_alone(axis, stack)
        if not isinstance(drive, ModbusDrive):
            raise CapabilityError(f"axis {axis.name} has no registers: its drive is not on Modbus")
        drive.link.open()
        stack.callback(drive.link.close)
        yield drive.raw


def _drive_alone(
    axis: DriveAxis,
    stack: ExitStack,
    bench: RunningBench | None = None,
    waiting: Waiting | None = None,
    network: canopen.Network | None = None,
) -> ServoDrive:
    if axis.drive.backend == "bench":
        from hil.machine.bench_wiring import running_bench  # noqa: PLC0415  (a verb loads the wire its axis file names)

        bench = bench or stack.enter_context(running_bench([axis], waiting=waiting))
        return bench.drives([axis], stack)[0]
    return hardware_drive(axis, WallClock(waiting), stack, Links(network=network))


def described_table(axis: DriveAxis) -> TableDescription | None:
    """The correction table that the axis's drive can hold, as its map describes it; None where the map has none."""
    config = axis.drive
    if config.register_map:
        from drivers.modbus.map_loader import load_drive_map  # noqa: PLC0415  (a verb loads the wire its axis file names)

        table = load_drive_map(config.register_map).table
        return None if table is None else table.description
    if not config.correction_table:
        return None
    from drivers.canopen.table_map import load_table_map  # noqa: PLC0415  (a verb loads the wire its axis file names)

    return load_table_map(config.correction_table).description


def predicted_table_s(axis: DriveAxis, table: RawTable) -> float | None:
    """Most bus time for writing a table and reading it back on a free CAN bus, s; None on another wire."""
    config = axis.drive
    if not config.correction_table or config.face == "virtual":
        return None
    from drivers.canopen.table_map import load_table_map  # noqa: PLC0415  (as above)
    from drivers.canopen.wire_time import table_s  # noqa: PLC0415  (a verb loads the wire its axis file names)

    return table_s(load_table_map(config.correction_table), table, config.bitrate)


def hardware_drive(axis: DriveAxis, clock: Clock, stack: ExitStack, links: Links | None = None) -> ServoDrive:
    """The hardware drive of an axis file, not opened. links: of the machine's other drives."""
    if axis.drive.backend == "canopen":
        from hil.machine.canopen_wiring import canopen_drive  # noqa: PLC0415  (a verb loads the wire its axis file names)

        return canopen_drive(axis, clock, (axis.drive.interface, axis.drive.channel), stack, links=links)
    from hil.machine.modbus_wiring import modbus_drive  # noqa: PLC0415  (a verb loads the wire its axis file names)

    return modbus_drive(axis, clock, modbus_endpoint(axis), axis.drive.unit, links)
