"""From a machine file to a session with its probe: the concrete drives, and where each shows the probe's signal.

On the bench the same drives are simulated, with a probe, a block and a bore near the positions of the machine file.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from drivers.canopen import objects
from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.clock import Waiting, WallClock
from drivers.drive import ServoDrive
from drivers.errors import AbortError, CapabilityError
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.wire import Endpoint, RtuEndpoint, TcpEndpoint
from hil.axis.axis_file import DriveAxis
from hil.machine.axis_lock import held_axis
from hil.machine.signals import ending_by_signals, stopped_by_signals
from hil.machine.wiring import BENCH_TIMEOUT_S, Links, canopen_drive, hardware_drive, modbus_drive
from hil.probe.machine_file import ProbeConfig, ProbeMachineConfig
from hil.probe.session import ProbeSession, ProbeSignal
from hil.records.rows import UM_PER_MM
from sim_backends.canopen_in_turn import drives_in_turn
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import rtu_slave, tcp_server
from sim_backends.modbus_registers import Face
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.plant.touch_probe import Chip
from sim_backends.probe import ProbeParameters, known_probe
from sim_backends.probe_bench import AxisOfBench, ProbeBench
from sim_backends.probe_latch import ProbeLatch
from sim_backends.virtual_drive import VirtualDrive, VirtualDriveSettings

VIRTUAL_BUS = "virtual"  # python-can's name of the interface


@contextmanager
def connected_probe(
    config: ProbeMachineConfig,
    *,
    touching: Sequence[str] = ("x",),
    mode: str | None = None,
    bench: ProbeBench | None = None,
    waiting: Waiting | None = None,
) -> Iterator[ProbeSession]:
    """A session on the machine of a machine file, or on a bench. Raises as `probe_drives`; arguments as of
    `ProbeSession`.
    """
    with (
        probe_drives(config, bench, waiting) as drives,
        probe_session(config, drives, touching=touching, mode=mode) as session,
    ):
        yield session


@contextmanager
def probe_drives(
    config: ProbeMachineConfig, bench: ProbeBench | None = None, waiting: Waiting | None = None
) -> Iterator[dict[str, ServoDrive]]:
    """The machine's drives, not opened; several sessions may follow each other on them. A bench is connected once.

    waiting: the object through which the clock of real drives waits (a bench was made with its own)
    Raises InputError while another process has connected one of the axis files, and whatever connecting raises.
    """
    with ExitStack() as stack:
        stack.enter_context(ending_by_signals())
        for axis in config.axes.values():
            stack.enter_context(held_axis(axis))
        yield _hardware(config, stack, waiting) if bench is None else _simulated(config, bench, stack)


def probe_session(
    config: ProbeMachineConfig,
    drives: Mapping[str, ServoDrive],
    *,
    touching: Sequence[str] = ("x",),
    mode: str | None = None,
) -> ProbeSession:
    """A session on connected drives. Raises CapabilityError for a drive that does not show the probe's signal."""
    signals = {name: _signal(drives[name], config.probe) for name in touching}
    return ProbeSession(config, drives, signals, touching=touching, mode=mode)


def _hardware(config: ProbeMachineConfig, stack: ExitStack, waiting: Waiting | None) -> dict[str, ServoDrive]:
    clock, links = WallClock(waiting), Links()
    return {name: hardware_drive(axis, clock, stack, links) for name, axis in config.axes.items()}


# -- the probe's signal --------------------------------------------------------------------------------------------------
class _Signal:
    """A bit of a drive's inputs. read: returns the word that holds it."""

    def __init__(self, read: Callable[[], int], bit: int, *, normally_closed: bool) -> None:
        self._read = read
        self._bit = bit
        self._idle = int(normally_closed)

    def touching(self) -> bool:
        return self._read() >> self._bit & 1 != self._idle


def _signal(drive: ServoDrive, probe: ProbeConfig) -> ProbeSignal:
    closed = probe.normally_closed
    if isinstance(drive, CanOpenDrive):
        return _Signal(_canopen_inputs(drive), probe.bit, normally_closed=closed)
    if isinstance(drive, ModbusDrive):
        return _Signal(_modbus_inputs(drive, probe.register), probe.bit, normally_closed=closed)
    if isinstance(drive, VirtualDrive):
        latch = drive.probe
        return _Signal(lambda: latch.inputs, probe.input - 1, normally_closed=closed)
    raise CapabilityError(f"drive {drive.name} does not show the probe's signal")


def _canopen_inputs(drive: CanOpenDrive) -> Callable[[], int]:
    """Reads object 60FDh."""

    def read() -> int:
        try:
            return drive.sdo.read(objects.DIGITAL_INPUTS)
        except AbortError as error:
            raise CapabilityError(f"drive {drive.name} does not show its inputs: {error}") from error

    return read


def _modbus_inputs(drive: ModbusDrive, register: str) -> Callable[[], int]:
    """Reads a register of the map."""

    def read() -> int:
        if register not in drive.parameters.names:
            raise CapabilityError(
                f"drive {drive.name} does not show the probe's signal: its register map has no register {register}, expected"
                " [probe] register to name one; nothing was moved"
            )
        value = drive.parameters.read(register)
        if not isinstance(value, int):
            raise CapabilityError(f"register {register} of drive {drive.name} is no whole number")
        return value

    return read


# -- the bench -----------------------------------------------------------------------------------------------------------
def probe_bench(
    config: ProbeMachineConfig,
    probe: ProbeParameters | None = None,
    *,
    in_bore: bool = False,
    waiting: Waiting | None = None,
) -> ProbeBench:
    """The simulated machine of a machine file, its probe in front of the block, or in the bore.

    probe: probe, block and bore instead of those drawn by the machine file's seed. waiting: the object that holds its
    time back.
    """
    block, bore = config.block, config.bore
    y_mm = 0.0 if block.y_mm is None else block.y_mm
    known = probe or known_probe(
        config.bench_seed,
        face_mm=block.face_mm,
        face_y_mm=y_mm,
        facing=block.facing,
        tip_radius_mm=config.probe.tip_radius_mm or 2.0,
        bore_mm=None if bore is None else (bore.x_mm, bore.y_mm),
        bore_radius_mm=0.0 if bore is None else bore.reach_mm,
    )
    if config.bench_chip_um and probe is None and not in_bore:
        known = replace(known, chips=(Chip(config.bench_chip_um / UM_PER_MM, 0, 0),))
    places = {"x": block.start_mm, "y": y_mm}
    if in_bore:
        middle = config.require_bore()
        places = {"x": middle.x_mm, "y": middle.y_mm}
    axes = {
        name: AxisOfBench(
            axis.scaling,
            axis.limits.travel_min_mm,
            axis.limits.travel_max_mm,
            places.get(name, config.orientation.zero_deg),
        )
        for name, axis in config.axes.items()
    }
    closed, clock = config.probe.normally_closed, SimClock(waiting=waiting)
    return ProbeBench(axes, known, config.orientation.sense, normally_closed=closed, clock=clock)


def _simulated(config: ProbeMachineConfig, bench: ProbeBench, stack: ExitStack) -> dict[str, ServoDrive]:
    """The bench's servos behind the wires of the axis files; those on CANopen on one bus."""
    drives: dict[str, ServoDrive] = {}
    channel = f"bench-{uuid.uuid4().hex}"
    bus = stack.enter_context(drives_in_turn(bench.clock, channel))
    links = Links({(VIRTUAL_BUS, channel): stack.enter_context(CanLink(bus.master(), bench.clock))})
    for number, (name, axis) in enumerate(config.axes.items(), start=1):
        face = axis.drive.face
        latch: ProbeLatch | None
        if face == "virtual":
            drives[name], latch = _virtual(name, axis, bench)
        elif face == "canopen":
            latch = bus.add(bench.servos[name], number, parameters=_objects(axis)).profile.probe
            on_bus = replace(axis, drive=replace(axis.drive, node_id=number))
            drives[name] = canopen_drive(on_bus, bench.clock, (VIRTUAL_BUS, channel), stack, links=links)
        else:
            drives[name], latch = _on_modbus(name, axis, bench, stack)
        if latch is not None and name != "spindle":
            bench.wire(name, latch, config.probe.input)
    bench.watch_probe()
    return drives


def _virtual(name: str, axis: DriveAxis, bench: ProbeBench) -> tuple[ServoDrive, ProbeLatch]:
    settings = VirtualDriveSettings(acceleration_mm_s2=axis.limits.max_acceleration_mm_s2, home_position_mm=0.0)
    drive = VirtualDrive(bench.servos[name], axis.scaling, axis.limits, bench.clock, name=axis.name, settings=settings)
    return stopped_by_signals(drive), drive.probe


def _objects(axis: DriveAxis) -> dict[tuple[int, int], int]:
    """The objects that a builder sets up: encoder, direct gear, a quick stop as hard as any move, homing on its
    switch.
    """
    counts = axis.scaling.encoder_counts_per_motor_rev
    ramp = axis.scaling.motor_counts_per_s(axis.limits.max_acceleration_mm_s2)
    units = {(0x608F, 1): counts, (0x608F, 2): 1, (0x6092, 1): counts, (0x6092, 2): 1}
    return {**units, (0x6085, 0): ramp, (0x6098, 0): 21, (0x6099, 1): 2 * counts, (0x6099, 2): counts // 10}


def _on_modbus(name: str, axis: DriveAxis, bench: ProbeBench, stack: ExitStack) -> tuple[ServoDrive, ProbeLatch | None]:
    """A drive on Modbus and its latch, None for a drive whose inputs cannot be read."""
    servo, unit = bench.servos[name], axis.drive.unit
    face: Face
    latch: ProbeLatch | None = None
    if axis.drive.register_map == "vendor_style":
        face = VendorRegisters(servo, counts_per_rev=axis.scaling.encoder_counts_per_motor_rev)
    else:
        face = registers = Cia402Registers(servo, parameters=_objects(axis))
        latch = registers.profile.probe
    endpoint: Endpoint
    if axis.drive.face == "modbus-tcp":
        _, port = stack.enter_context(tcp_server({unit: face}, bench.clock))
        endpoint = TcpEndpoint("127.0.0.1", port, timeout_s=BENCH_TIMEOUT_S)
    else:
        _, path = stack.enter_context(rtu_slave({unit: face}, bench.clock))
        endpoint = RtuEndpoint(path, baud=115_200, parity="N", timeout_s=BENCH_TIMEOUT_S)
    return modbus_drive(axis, bench.clock, endpoint, unit), latch
