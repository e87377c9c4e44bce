"""The one place that knows concrete drives: from an axis file to a session on a machine, or on the bench.

Everything else of `hil` works against `ServoDrive` and `DistanceInstrument`, so that the same code runs on real hardware and in tests.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import TypeVar

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.canopen.sdo_cost import table_bits
from drivers.canopen.table_map import load_table_map
from drivers.clock import Clock, Waiting, WallClock
from drivers.correction_table import RawTable, TableDescription
from drivers.drive import DriveLimits, ServoDrive
from drivers.errors import CapabilityError, InputError
from drivers.instrument import DistanceInstrument
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.parameters import ModbusParameters
from drivers.modbus.wear import WearLedger
from drivers.modbus.wire import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.scaling import AxisScaling
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.axis.zero import zero_keeper
from hil.machine.axis_place import held_axis, modbus_endpoint
from hil.machine.bench_conditions import BenchConditions
from hil.machine.conditions import Conditions
from hil.machine.instruments import instrument, with_instrument
from hil.machine.session import AxisSession
from hil.machine.signals import ending_by_signals, stopped_by_signals
from sim_backends.bench import Bench, BenchParameters, known_bench
from sim_backends.canopen_in_turn import drives_in_turn
from sim_backends.clock import SimClock
from sim_backends.machine import modbus_face
from sim_backends.modbus_drive import rtu_slave, tcp_server
from sim_backends.own_table import TableForm, known_table
from sim_backends.virtual_drive import VirtualDrive, VirtualDriveSettings

Drive = TypeVar("Drive", bound=ServoDrive)

BENCH_PATIENCE_S = 10.0
"""The bench's drive answers in a thread of its own, as soon as the host lets it: its silence is judged in real time."""


@dataclass(frozen=True)
class Machine:
    """A connected axis; `bench` is the simulated machine behind it, None on a real one."""

    axis: AxisConfig
    session: AxisSession
    bench: Bench | None = None

    @property
    def clock(self) -> Clock:
        return self.session.clock


@contextmanager
def connected(
    axis: AxisConfig,
    bench: BenchParameters | None = None,
    conditions: Conditions | None = None,
    waiting: Waiting | None = None,
) -> Iterator[Machine]:
    """Connect the axis of an axis file; on leaving it is stopped, restored and let go.

    bench: for backend "bench", the simulated machine to build instead of the one the axis file names.
    conditions: who brings about the load and the like on a real machine; the bench does so itself.
    waiting: through whom the axis's clock waits, so that somebody else can end a wait.
    Raises InputError for a bench whose travel or scaling is not the axis file's, or while another process has connected this axis
    file or another one of its drive, and whatever connecting raises.
    """
    with ExitStack() as stack:
        stack.enter_context(ending_by_signals())
        stack.enter_context(held_axis(axis))
        if axis.drive.backend == "bench":
            machine = _on_bench(axis, bench or bench_parameters(axis), stack, waiting)
        else:
            machine = _on_hardware(axis, conditions, stack, waiting)
        stack.enter_context(machine.session)
        yield machine


def bench_parameters(axis: DriveAxis) -> BenchParameters:
    """The simulated machine that an axis file with backend "bench" asks for."""
    return known_bench(axis.drive.machine, axis.drive.seed)


def _on_bench(axis: AxisConfig, parameters: BenchParameters, stack: ExitStack, waiting: Waiting | None) -> Machine:
    bench = _bench(axis, with_instrument(parameters, axis.instrument), stack, waiting)
    drive = _bench_drive(axis, bench, stack)
    looking = instrument(axis.instrument, bench.laser_path, bench.clock)
    return Machine(axis, session_of(axis, drive, looking, BenchConditions(bench.plant, axis.conditions.levels)), bench)


def _bench(axis: DriveAxis, parameters: BenchParameters, stack: ExitStack, waiting: Waiting | None = None) -> Bench:
    check_bench(axis, parameters)
    clock = None if waiting is None else SimClock(parameters.step_s, waiting)
    return stack.enter_context(Bench(parameters) if clock is None else Bench(parameters, clock=clock))


def _on_hardware(axis: AxisConfig, conditions: Conditions | None, stack: ExitStack, waiting: Waiting | None) -> Machine:
    clock = WallClock(waiting)
    drive = hardware_drive(axis, clock, stack)
    return Machine(axis, session_of(axis, drive, instrument(axis.instrument, axis.instrument.port, clock), conditions))


# -- drives ------------------------------------------------------------------------------------------------------------
@contextmanager
def connected_drive(
    axis: DriveAxis, bench: BenchParameters | None = None, waiting: Waiting | None = None
) -> Iterator[ServoDrive]:
    """The drive alone, open, without an instrument. Nothing is enabled or moved. bench, waiting: as for `connected`."""
    with ExitStack() as stack:
        stack.enter_context(ending_by_signals())
        stack.enter_context(held_axis(axis))
        yield stack.enter_context(_drive_alone(axis, stack, bench, waiting))


@contextmanager
def connected_registers(axis: AxisConfig) -> Iterator[ModbusParameters]:
    """A Modbus drive's registers by their names, however wrong its register map may be: not even a sample is taken.

    Raises CapabilityError for an axis without registers.
    """
    with ExitStack() as stack:
        stack.enter_context(held_axis(axis))
        drive = _drive_alone(axis, stack)
        if not isinstance(drive, ModbusDrive):
            raise CapabilityError(f"axis {axis.name} has no registers: its drive is not on Modbus")
        drive.link.open()
        stack.callback(drive.link.close)
        yield drive.parameters


def _drive_alone(
    axis: DriveAxis, stack: ExitStack, bench: BenchParameters | None = None, waiting: Waiting | None = None
) -> ServoDrive:
    if axis.drive.backend == "bench":
        return _bench_drive(axis, _bench(axis, bench or bench_parameters(axis), stack, waiting), stack)
    return hardware_drive(axis, WallClock(waiting), stack)


def described_table(axis: DriveAxis) -> TableDescription | None:
    """What the axis's drive can hold as a correction table of its own, by its map alone; None where no map tells of one."""
    config = axis.drive
    if config.register_map:
        table = load_drive_map(config.register_map).table
        return None if table is None else table.description
    return load_table_map(config.correction_table).description if config.correction_table else None


def predicted_table_s(axis: DriveAxis, table: RawTable) -> tuple[float, float] | None:
    """How long writing a table and reading it back keeps a free CAN bus busy, at least and at most; None on another wire."""
    config = axis.drive
    if not config.correction_table or config.face == "virtual":
        return None
    bits = table_bits(load_table_map(config.correction_table), table)
    return bits.least / config.bitrate, bits.most / config.bitrate


@dataclass
class Links:
    """What the drives of one machine share: a link for each CAN bus, by interface and channel, and for each Modbus line."""

    can: dict[tuple[str, str], CanLink] = field(default_factory=dict)
    modbus: dict[Endpoint, ModbusLink] = field(default_factory=dict)


def hardware_drive(axis: DriveAxis, clock: Clock, stack: ExitStack, links: Links | None = None) -> ServoDrive:
    """The real drive of an axis file, not opened; links: of the machine's other drives."""
    if axis.drive.backend == "canopen":
        return canopen_drive(axis, clock, (axis.drive.interface, axis.drive.channel), stack, links=links)
    return modbus_drive(axis, clock, modbus_endpoint(axis), axis.drive.unit, links)


def _bench_drive(axis: DriveAxis, bench: Bench, stack: ExitStack) -> ServoDrive:
    """The bench's servo behind the wire that the axis file asks for."""
    face, clock = axis.drive.face, bench.clock
    if face == "virtual":
        return virtual_drive(axis, bench)
    if face == "canopen":
        channel = f"bench-{uuid.uuid4().hex}"
        bus = stack.enter_context(drives_in_turn(clock, channel))
        bus.add(
            bench.servo,
            axis.drive.node_id,
            parameters=bench.parameters.objects,
            table=bench_table(axis, bench),
        )
        links = Links({("virtual", channel): stack.enter_context(CanLink(bus.master(), clock))})
        return canopen_drive(axis, clock, ("virtual", channel), stack, links=links)
    endpoint = bench_modbus({axis.drive.unit: (axis, bench)}, clock, stack)
    return modbus_drive(axis, clock, endpoint, axis.drive.unit)


def bench_modbus(units: Mapping[int, tuple[DriveAxis, Bench]], clock: SimClock, stack: ExitStack) -> Endpoint:
    """Serve benches as units of one line, of the kind that their axis files ask for; where the line is."""
    faces = {
        unit: modbus_face(bench, "vendor" if axis.drive.register_map == "vendor_style" else "cia402")
        for unit, (axis, bench) in units.items()
    }
    if next(iter(units.values()))[0].drive.face == "modbus-tcp":
        _, port = stack.enter_context(tcp_server(faces, clock))
        return TcpEndpoint("127.0.0.1", port, timeout_s=BENCH_PATIENCE_S)
    _, path = stack.enter_context(rtu_slave(faces, clock))
    return RtuEndpoint(path, baud=115_200, parity="N", timeout_s=BENCH_PATIENCE_S)


def canopen_drive(
    axis: DriveAxis,
    clock: Clock,
    bus: tuple[str, str],
    stack: ExitStack,
    *,
    links: Links | None = None,
) -> CanOpenDrive:
    """bus: python-can's interface and channel."""
    config, homing, (interface, channel) = axis.drive, axis.drive.homing, bus
    bitrate = None if interface == "virtual" else config.bitrate
    shared = Links() if links is None else links
    if bus not in shared.can:
        shared.can[bus] = stack.enter_context(
            CanLink.open(clock, interface=interface, channel=channel, bitrate=bitrate)
        )
    settings = CanOpenSettings(
        sdo_timeout_s=config.sdo_timeout_s,
        sample_timeout_s=config.sample_timeout_s,
        heartbeat_s=config.heartbeat_s,
        guard_s=config.guard_s,
        homing=HomingSettings(homing.method, homing.speed_switch_mm_s, homing.speed_zero_mm_s, homing.home_position_mm),
    )
    drive = stopped_by_signals(
        CanOpenDrive(
            axis.name,
            axis.scaling,
            axis.limits,
            clock,
            link=shared.can[bus],
            node_id=config.node_id,
            settings=settings,
            table=load_table_map(config.correction_table) if config.correction_table else None,
        )
    )
    return _of_axis(axis, drive)


def modbus_drive(
    axis: DriveAxis, clock: Clock, endpoint: Endpoint, unit: int, links: Links | None = None
) -> ModbusDrive:
    """The register map decides what the drive is; writes to its EEPROM are counted beside the axis's campaigns."""
    shared = Links() if links is None else links
    drive = stopped_by_signals(
        ModbusDrive(
            axis.name,
            axis.scaling,
            axis.limits,
            clock,
            link=shared.modbus.setdefault(endpoint, ModbusLink(endpoint, clock)),
            unit=unit,
            drive_map=load_drive_map(axis.drive.register_map),
            wear=WearLedger(axis.store.directory / "eeprom-writes.json"),
        )
    )
    return _of_axis(axis, drive)


def virtual_drive(axis: DriveAxis, bench: Bench) -> VirtualDrive:
    asked = axis.drive.homing
    settings = VirtualDriveSettings(acceleration_mm_s2=axis.limits.max_acceleration_mm_s2)
    given = {
        "homing_method": asked.method,
        "homing_speed_switch_mm_s": asked.speed_switch_mm_s,
        "homing_speed_zero_mm_s": asked.speed_zero_mm_s,
        "home_position_mm": asked.home_position_mm,
    }
    settings = replace(settings, **{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]
    drive = stopped_by_signals(
        VirtualDrive(
            bench.servo,
            axis.scaling,
            axis.limits,
            bench.clock,
            name=axis.name,
            settings=settings,
            table=bench_table(axis, bench),
        )
    )
    return _of_axis(axis, drive)


def _of_axis(axis: DriveAxis, drive: Drive) -> Drive:
    """What the axis file says beside the wire; the axis's zero is looked after whoever moves the drive."""
    drive.falls_without_power = axis.falls_without_power
    zero_keeper(axis).guard(drive)
    return drive


def bench_table(axis: DriveAxis, bench: Bench) -> TableForm | None:
    """The correction table that the bench's drive holds itself."""
    return known_table(axis.drive.correction_table, bench.parameters.scaling.counts_per_load_mm / 1000.0)


# -- session -------------------------------------------------------------------------------------------
def session_of(
    axis: AxisConfig, drive: ServoDrive, looking: DistanceInstrument, conditions: Conditions | None
) -> AxisSession:
    stale_after_s = axis.instrument.stale_after_s
    session = AxisSession(
        drive,
        looking,
        axis.measurement,
        stale_after_s=stale_after_s,
        agreement=axis.agreement,
        conditions=conditions,
    )
    session.resume_within_s = axis.instrument.resume_within_s
    session.material = axis.instrument.material
    session.steering.bound = axis.correction.bound
    session.zero = zero_keeper(axis)
    session.zero.guard(drive)
    return session


def check_bench(axis: DriveAxis, parameters: BenchParameters) -> None:
    """The bench is a machine like any other: an axis file that does not describe it is refused before anything moves."""
    found: tuple[AxisScaling, DriveLimits] = (parameters.scaling, parameters.limits)
    if axis.scaling != found[0]:
        raise InputError(
            f"[scaling] does not describe the bench: expected encoder_counts_per_motor_rev ="
            f" {found[0].encoder_counts_per_motor_rev}, feed_mm_per_shaft_rev = {found[0].feed_mm_per_shaft_rev:g}",
            path=axis.path,
        )
    limits = axis.limits
    if limits.travel_min_mm < found[1].travel_min_mm or limits.travel_max_mm > found[1].travel_max_mm:
        raise InputError(
            f"[axis] travel {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm exceeds the bench's"
            f" {found[1].travel_min_mm:g} to {found[1].travel_max_mm:g} mm",
            path=axis.path,
        )
