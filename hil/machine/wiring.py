"""Builds the session of one axis from its axis file, on hardware or on the bench. Only the wiring modules name concrete drives.

All other modules of `hil` work against `ServoDrive` and `DistanceInstrument`, so that the same code runs on hardware and in tests.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.canopen.eds import load_eds
from drivers.canopen.sdo_cost import table_bits
from drivers.canopen.table_map import load_table_map
from drivers.clock import Clock, Waiting, WallClock
from drivers.correction_table import RawTable, TableDescription
from drivers.drive import DriveLimits, ServoDrive
from drivers.errors import CapabilityError, InputError
from drivers.instrument import DistanceInstrument
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.drive_values import DriveValues
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_facts import FactLedger
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.parameters import ModbusParameters
from drivers.modbus.register_map import find_map
from drivers.modbus.wear import WearLedger
from drivers.modbus.wire import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.scaling import AxisScaling
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.axis.zero import made_with_keeper, zero_keeper
from hil.machine.axis_lock import held_axis, modbus_endpoint
from hil.machine.bench_conditions import BenchConditions
from hil.machine.conditions import Conditions
from hil.machine.instruments import build_instrument, with_instrument
from hil.machine.interrupts import ending_by_signals, stopped_by_signals
from hil.machine.session import AxisSession
from sim_backends.bench import Bench, BenchParameters, known_bench
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.canopen_in_turn import DrivesInTurn, drives_in_turn
from sim_backends.canopen_quirks import ProfiledSlave, machine_objects, profile_counts
from sim_backends.clock import SimClock
from sim_backends.drive_profiles import load_profile
from sim_backends.machine import modbus_face
from sim_backends.modbus_drive import rtu_slave, tcp_server
from sim_backends.own_table import TableForm, known_table
from sim_backends.virtual_drive import VirtualDrive, VirtualDriveSettings

Drive = TypeVar("Drive", bound=ServoDrive)

BENCH_TIMEOUT_S = 10.0
"""Time-out for an answer of the bench's drive, s of real time: it answers in a thread of its own, which a busy host may delay."""


@dataclass(frozen=True)
class Machine:
    """A connected axis. bench: the simulated machine, None on hardware."""

    axis: AxisConfig
    session: AxisSession
    bench: Bench | None = None

    @property
    def clock(self) -> Clock:
        """The session's clock."""
        return self.session.clock


@contextmanager
def connected(
    axis: AxisConfig,
    bench: BenchParameters | None = None,
    conditions: Conditions | None = None,
    waiting: Waiting | None = None,
) -> Iterator[Machine]:
    """Connect the axis of an axis file. On leaving it is stopped after an error, disabled unless it was enabled, and disconnected.

    bench: for backend "bench", the simulated machine to build instead of the one that the axis file names
    conditions: sets load and the like on a real machine; the bench has its own
    waiting: the waits of the axis's clock go through it, so that another thread can end a wait
    Raises InputError for a bench whose travel or scaling is not the axis file's, and while another process has connected this axis
    file or its drive. Raises what connecting raises.
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
    """The simulated machine that an axis file with backend "bench" names."""
    return known_bench(axis.drive.machine, axis.drive.seed)


def _on_bench(axis: AxisConfig, parameters: BenchParameters, stack: ExitStack, waiting: Waiting | None) -> Machine:
    bench = _bench(axis, with_instrument(parameters, axis.instrument), stack, waiting)
    drive = _bench_drive(axis, bench, stack)
    instrument = build_instrument(axis.instrument, bench.laser_path, bench.clock)
    return Machine(
        axis, session_of(axis, drive, instrument, BenchConditions(bench.plant, axis.conditions.levels)), bench
    )


def _bench(axis: DriveAxis, parameters: BenchParameters, stack: ExitStack, waiting: Waiting | None = None) -> Bench:
    check_bench(axis, parameters)
    clock = None if waiting is None else SimClock(parameters.step_s, waiting)
    return stack.enter_context(Bench(parameters) if clock is None else Bench(parameters, clock=clock))


def _on_hardware(axis: AxisConfig, conditions: Conditions | None, stack: ExitStack, waiting: Waiting | None) -> Machine:
    clock = WallClock(waiting)
    drive = hardware_drive(axis, clock, stack)
    return Machine(
        axis, session_of(axis, drive, build_instrument(axis.instrument, axis.instrument.port, clock), conditions)
    )


# -- drives ------------------------------------------------------------------------------------------------------------
@contextmanager
def connected_drive(
    axis: DriveAxis, bench: BenchParameters | None = None, waiting: Waiting | None = None
) -> Iterator[ServoDrive]:
    """The drive alone, open, without an instrument; it is not enabled. bench, waiting, errors: as for `connected`."""
    with ExitStack() as stack:
        stack.enter_context(ending_by_signals())
        stack.enter_context(held_axis(axis))
        yield stack.enter_context(_drive_alone(axis, stack, bench, waiting))


@contextmanager
def connected_registers(axis: AxisConfig) -> Iterator[ModbusParameters]:
    """A Modbus drive's registers by name. No sample is taken, so that it works with a wrong register map too.

    Raises CapabilityError for a drive that is not on Modbus, and as `connected`.
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
    """The correction table that the axis's drive can hold, as its map describes it; None where the map has none."""
    config = axis.drive
    if config.register_map:
        table = load_drive_map(config.register_map).table
        return None if table is None else table.description
    return load_table_map(config.correction_table).description if config.correction_table else None


def predicted_table_s(axis: DriveAxis, table: RawTable) -> tuple[float, float] | None:
    """Bus time for writing a table and reading it back on a free CAN bus, least and most, s; None on another wire."""
    config = axis.drive
    if not config.correction_table or config.face == "virtual":
        return None
    bits = table_bits(load_table_map(config.correction_table), table)
    return bits.least / config.bitrate, bits.most / config.bitrate


@dataclass
class Links:
    """Links shared by the drives of one machine: one for each CAN bus (interface, channel), one for each Modbus endpoint."""

    can: dict[tuple[str, str], CanLink] = field(default_factory=dict)
    modbus: dict[Endpoint, ModbusLink] = field(default_factory=dict)


def hardware_drive(axis: DriveAxis, clock: Clock, stack: ExitStack, links: Links | None = None) -> ServoDrive:
    """The hardware drive of an axis file, not opened. links: of the machine's other drives."""
    if axis.drive.backend == "canopen":
        return canopen_drive(axis, clock, (axis.drive.interface, axis.drive.channel), stack, links=links)
    return modbus_drive(axis, clock, modbus_endpoint(axis), axis.drive.unit, links)


def _bench_drive(axis: DriveAxis, bench: Bench, stack: ExitStack) -> ServoDrive:
    """A drive for the simulated servo on the wire that the axis file names."""
    face, clock = axis.drive.face, bench.clock
    if face == "virtual":
        return virtual_drive(axis, bench)
    if face == "canopen":
        channel = f"bench-{uuid.uuid4().hex}"
        bus = stack.enter_context(drives_in_turn(clock, channel))
        add_bench_node(bus, axis, bench, axis.drive.node_id)
        links = Links({("virtual", channel): stack.enter_context(CanLink(bus.master(), clock))})
        return canopen_drive(axis, clock, ("virtual", channel), stack, links=links)
    endpoint = bench_modbus({axis.drive.unit: (axis, bench)}, clock, stack)
    return modbus_drive(axis, clock, endpoint, axis.drive.unit)


def bench_node(axis: DriveAxis, bench: Bench) -> tuple[Mapping[tuple[int, int], int], Callable[..., CanOpenSlave]]:
    """Factory settings of the bench's CANopen drive, and what makes it: the documented drive that the axis file names, else the
    standard's."""
    if not axis.drive.profile:
        return bench.parameters.objects, CanOpenSlave
    profile = load_profile(axis.drive.profile)
    lead_m = bench.parameters.plant.screw.lead_mm / 1000.0
    return machine_objects(profile, bench.parameters), partial(ProfiledSlave, profile=profile, lead_m=lead_m)


def add_bench_node(bus: DrivesInTurn, axis: DriveAxis, bench: Bench, node_id: int) -> None:
    """Put the bench's servo on a bus."""
    parameters, make = bench_node(axis, bench)
    bus.add(bench.servo, node_id, parameters=parameters, table=bench_table(axis, bench), make=make)


def bench_modbus(units: Mapping[int, tuple[DriveAxis, Bench]], clock: SimClock, stack: ExitStack) -> Endpoint:
    """Serve benches as units of one Modbus TCP server or RTU line, as their axis files name it; returns its endpoint."""
    faces = {
        unit: modbus_face(bench, "vendor" if axis.drive.register_map == "vendor_style" else "cia402")
        for unit, (axis, bench) in units.items()
    }
    if next(iter(units.values()))[0].drive.face == "modbus-tcp":
        _, port = stack.enter_context(tcp_server(faces, clock))
        return TcpEndpoint("127.0.0.1", port, timeout_s=BENCH_TIMEOUT_S)
    _, path = stack.enter_context(rtu_slave(faces, clock))
    return RtuEndpoint(path, baud=115_200, parity="N", timeout_s=BENCH_TIMEOUT_S)


def canopen_drive(
    axis: DriveAxis,
    clock: Clock,
    bus: tuple[str, str],
    stack: ExitStack,
    *,
    links: Links | None = None,
) -> CanOpenDrive:
    """The CANopen drive of an axis file, not opened. bus: python-can's interface and channel."""
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
        velocity_unit=config.velocity_unit,
        acceleration_unit=config.acceleration_unit,
        modes=config.modes,
        axis=config.axis,
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
            eds=None if config.eds is None else load_eds(config.eds, config.node_id),
            table=load_table_map(config.correction_table) if config.correction_table else None,
        )
    )
    return _guarded(axis, drive)


def modbus_drive(
    axis: DriveAxis, clock: Clock, endpoint: Endpoint, unit: int, links: Links | None = None
) -> ModbusDrive:
    """The Modbus drive of an axis file, not opened. Writes to its EEPROM are counted in the axis's store."""
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
            ledger=FactLedger(
                axis.store.directory / "drive-facts.json", f"{endpoint} unit {unit}", find_map(axis.drive.register_map)
            ),
        )
    )
    return _guarded(axis, drive)


def check_registers(axis: DriveAxis) -> None:
    """Raise InputError for a travel that the registers of a Modbus drive do not hold. Nothing is connected."""
    if axis.drive.backend == "modbus":
        DriveValues(axis.name, load_drive_map(axis.drive.register_map), axis.scaling).check_held(axis.limits.ends_mm)


def virtual_drive(axis: DriveAxis, bench: Bench) -> VirtualDrive:
    """A drive that calls the bench's servo directly, without a wire."""
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
    return _guarded(axis, drive)


def _guarded(axis: DriveAxis, drive: Drive) -> Drive:
    """The drive with the axis file's remaining settings, its homings recorded by the axis's zero keeper."""
    drive.falls_without_power = axis.falls_without_power
    zero_keeper(axis).guard(drive)
    return drive


def bench_table(axis: DriveAxis, bench: Bench) -> TableForm | None:
    """The correction table in the bench's drive, None where the axis file names none."""
    return known_table(axis.drive.correction_table, bench.parameters.scaling.counts_per_load_mm / 1000.0)


# -- session -------------------------------------------------------------------------------------------
def session_of(
    axis: AxisConfig, drive: ServoDrive, instrument: DistanceInstrument, conditions: Conditions | None
) -> AxisSession:
    """A session with the settings of an axis file, not entered."""
    stale_after_s = axis.instrument.stale_after_s
    session = AxisSession(
        drive,
        instrument,
        axis.measurement,
        stale_after_s=stale_after_s,
        agreement=axis.agreement,
        conditions=conditions,
    )
    session.resume_within_s = axis.instrument.resume_within_s
    session.material = axis.instrument.material
    session.command_state.bound = axis.correction.bound
    session.made_with = made_with_keeper(axis)
    session.command_state.by_estimate = axis.lost_motion is not None and axis.lost_motion.travel_by == "estimate"
    session.zero = zero_keeper(axis)
    session.zero.guard(drive)
    return session


def check_bench(axis: DriveAxis, parameters: BenchParameters) -> None:
    """Raises InputError for an axis file whose scaling or travel is not the bench's."""
    found: tuple[AxisScaling, DriveLimits] = (parameters.scaling, parameters.limits)
    if axis.drive.profile:
        counts = profile_counts(load_profile(axis.drive.profile), parameters)
        found = (replace(found[0], encoder_counts_per_motor_rev=counts), found[1])
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
