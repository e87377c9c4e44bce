"""From a machine file to a session with its probe: the concrete drives, and where each shows the probe's signal.

On the bench the same drives are simulated, with a probe, a block and a bore near the positions of the machine file.
"""

from __future__ import annotations

import math
import random
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial

from drivers.canopen import cia301
from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.sdo import SdoClient
from drivers.cia402 import objects
from drivers.clock import Waiting, WallClock
from drivers.drive import ServoDrive
from drivers.errors import AbortError, CapabilityError, InputError
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.plan import AddressSpace, Span
from drivers.undo import undo_all
from hil.axis.axis_file import DriveAxis
from hil.machine.axis_lock import held_axis
from hil.machine.bench_modbus import BENCH_TIMEOUT_S
from hil.machine.canopen_wiring import canopen_drive
from hil.machine.interrupts import ending_by_signals, stopped_by_signals
from hil.machine.links import Links
from hil.machine.modbus_wiring import modbus_drive
from hil.machine.supervisor import finish_despite_interrupt
from hil.machine.wiring import hardware_drive
from hil.probe.machine_file import AngleConfig, BossConfig, Feature, ProbeConfig, ProbeMachineConfig, ReferenceConfig
from hil.probe.session import ControlWires, ProbeSession, ProbeSignal
from hil.records.rows import UM_PER_MM
from sim_backends.canopen_in_turn import drives_in_turn
from sim_backends.clock import SimClock
from sim_backends.control_wires import SimulatedControl, Wires
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import rtu_slave, tcp_server
from sim_backends.modbus_registers import Face
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.plant.touch_probe import Boss, Chip, Solid, Wall
from sim_backends.probe import ProbeParameters, known_probe
from sim_backends.probe_bench import AxisOfBench, ProbeBench
from sim_backends.probe_latch import ProbeLatch
from sim_backends.virtual_drive import VirtualDrive, VirtualDriveSettings

VIRTUAL_BUS = "virtual"  # python-can's name of the interface


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


# -- the control's wires -------------------------------------------------------------------------------------------------
class _CanWires:
    """60FDh and 60FEh of a drive. The mask of the outputs is put back by `restore`."""

    def __init__(self, drive: CanOpenDrive, mfin_bit: int) -> None:
        self._drive, self._bit = drive, 1 << mfin_bit
        self._mask: int | None = None

    def inputs(self) -> int:
        return self._drive.sdo.read(objects.DIGITAL_INPUTS)

    def set_mfin(self, on: bool) -> None:
        sdo = self._drive.sdo
        levels = sdo.read(objects.DIGITAL_OUTPUTS) & ~self._bit
        sdo.write(objects.DIGITAL_OUTPUTS, levels | (self._bit if on else 0))
        if self._mask is None:  # after the level, which acts as soon as the mask has its bit
            mask = sdo.read(objects.DIGITAL_OUTPUTS_MASK)
            sdo.write(objects.DIGITAL_OUTPUTS_MASK, mask | self._bit)
            self._mask = mask

    def mfin(self) -> bool:
        return bool(self._drive.sdo.read(objects.DIGITAL_OUTPUTS) & self._bit)

    def restore(self) -> None:
        self.set_mfin(False)
        if self._mask is not None:
            self._drive.sdo.write(objects.DIGITAL_OUTPUTS_MASK, self._mask)
            self._mask = None


class _ModuleWires:
    """6000h and 6200h of an I/O module (CiA 401) on the bus of a drive."""

    def __init__(self, sdo: SdoClient, blocks: int, mfin_bit: int) -> None:
        self._sdo, self._blocks = sdo, blocks
        self._output, self._bit = cia301.module_outputs(mfin_bit // 8), 1 << mfin_bit % 8

    def inputs(self) -> int:
        return sum(self._sdo.read(cia301.module_inputs(block)) << 8 * block for block in range(self._blocks))

    def set_mfin(self, on: bool) -> None:
        levels = self._sdo.read(self._output) & ~self._bit
        self._sdo.write(self._output, levels | (self._bit if on else 0))

    def mfin(self) -> bool:
        return bool(self._sdo.read(self._output) & self._bit)

    def restore(self) -> None:
        self.set_mfin(False)


class _ModbusWires:
    """Discrete inputs and a coil of a drive, or of an I/O module on its line."""

    def __init__(self, link: ModbusLink, unit: int, inputs: Span, coil: int) -> None:
        self._link, self._unit, self._inputs, self._coil = link, unit, inputs, coil

    def inputs(self) -> int:
        levels = self._link.read(self._unit, AddressSpace.DISCRETE, self._inputs)
        return sum(level << bit for bit, level in enumerate(levels))

    def set_mfin(self, on: bool) -> None:
        self._link.write(self._unit, AddressSpace.COIL, self._coil, (int(on),))

    def mfin(self) -> bool:
        return bool(self._link.read(self._unit, AddressSpace.COIL, Span(self._coil, 1))[0])

    def restore(self) -> None:
        self.set_mfin(False)


class _BareWires:
    """The terminals of a drive without a wire."""

    def __init__(self, wires: Wires, mfin_bit: int) -> None:
        self._wires, self._bit = wires, 1 << mfin_bit

    def inputs(self) -> int:
        return self._wires.inputs

    def set_mfin(self, on: bool) -> None:
        self._wires.outputs = self._wires.outputs & ~self._bit | (self._bit if on else 0)

    def mfin(self) -> bool:
        return bool(self._wires.outputs & self._bit)

    def restore(self) -> None:
        self.set_mfin(False)


def _refuse_commanding_coil(drive: ModbusDrive, coil: int) -> None:
    """Raises InputError for a coil that the drive's register map has, as it commands the drive."""
    for register in drive.registers.registers.values():
        if register.table is AddressSpace.COIL and register.span.start <= coil < register.span.end:
            raise InputError(
                f"[codes] mfin_bit and outputs_start give coil {coil}, which is {register.name} of drive {drive.name},"
                " expected a coil that commands nothing"
            )


@contextmanager
def control_wires(config: ProbeMachineConfig, drives: Mapping[str, ServoDrive]) -> Iterator[ControlWires]:
    """The control's wires at an open drive, or at a module on its bus; at the end MFIN is off, whatever happened.

    Raises InputError where none are stated, CapabilityError for a drive that has no such inputs and outputs.
    """
    codes = config.codes
    drive = drives[config.require_codes()]
    with ExitStack() as stack:
        wires: ControlWires
        if isinstance(drive, CanOpenDrive) and codes.station is not None:
            sdo = SdoClient(drive.link, codes.station, f"I/O module {codes.station}")
            stack.callback(sdo.close)
            wires = _ModuleWires(sdo, -(-codes.inputs_read // 8), codes.mfin_bit)
        elif isinstance(drive, CanOpenDrive):
            wires = _CanWires(drive, codes.mfin_bit)
        elif isinstance(drive, ModbusDrive):
            unit = drive.unit if codes.station is None else codes.station
            coil = codes.outputs_start + codes.mfin_bit
            if codes.station is None:
                _refuse_commanding_coil(drive, coil)
            wires = _ModbusWires(drive.link, unit, Span(codes.inputs_start, codes.inputs_read), coil)
        elif isinstance(drive, VirtualDrive):
            wires = _BareWires(drive.wires, codes.mfin_bit)
        else:
            raise CapabilityError(f"drive {drive.name} has no inputs and outputs for a control")
        failed: BaseException | None = None
        try:
            try:
                wires.set_mfin(False)
                wires.inputs()
            except AbortError as error:
                raise CapabilityError(f"drive {drive.name} has no inputs and outputs for a control: {error}") from error
            yield wires
        except BaseException as raised:
            failed = raised
            raise
        finally:
            undo_all((("MFIN may still be on", partial(finish_despite_interrupt, wires.restore)),), during=failed)


# -- the bench -----------------------------------------------------------------------------------------------------------
def probe_bench(
    config: ProbeMachineConfig,
    probe: ProbeParameters | None = None,
    *,
    in_bore: bool = False,
    feature: str | None = None,
    waiting: Waiting | None = None,
) -> ProbeBench:
    """The simulated machine of a machine file, its probe in front of the block, in the bore, or before a feature.

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
    if feature is not None:
        described = config.require_feature(feature)
        before = before_feature(described)
        places = {"x": before[0], "y": before[1]}
        if probe is None:
            known = replace(known, solids=feature_solids(described, config.bench_seed, known.stylus.radius_mm))
    if (heights_mm := config.heights_mm(block.z_mm)) is not None:
        places["z"] = heights_mm[0]
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
    bench = ProbeBench(axes, known, config.orientation.sense, normally_closed=closed, clock=clock)
    if (codes := config.codes).drive is not None:
        bench.control = SimulatedControl(
            Wires(),
            config.bench_program,
            codes.strobe_bit,
            codes.code_bits,
            codes.mfin_bit,
            codes.alive_bit,
            codes.first,
            codes.coding,
        )
    return bench


def before_feature(feature: Feature) -> tuple[float, float]:
    """Where X and Y are before the first contact."""
    if isinstance(feature, BossConfig):
        return feature.x_mm - feature.clear_mm, feature.y_mm
    return feature.x_from_mm if isinstance(feature, ReferenceConfig) else (feature.x_mm, feature.y_mm)


def feature_solids(feature: Feature, seed: int, radius_mm: float) -> tuple[Solid, ...]:
    """What the simulated machine has of a feature, met about half-way through the search."""
    rng = random.Random(seed)
    if isinstance(feature, BossConfig):
        middle = feature.x_mm + rng.uniform(-0.1, 0.1), feature.y_mm + rng.uniform(-0.1, 0.1), 0.0
        return (Boss(middle, feature.clear_mm - feature.search_mm / 2.0 - radius_mm),)
    faces = list(feature.faces.values()) if isinstance(feature, ReferenceConfig) else [feature]
    walls = []
    for face in faces:
        apart_mm = face.apart_mm if isinstance(face, AngleConfig) else 0.0
        place = face.start_mm(apart_mm / 2.0)
        share = rng.uniform(0.4, 0.6)
        place[face.axis] += face.direction * (share * face.search_mm + radius_mm)
        most_deg = math.degrees(math.atan(0.4 * face.search_mm / abs(apart_mm))) if apart_mm else 0.0
        outward_deg = {("x", 1): 180.0, ("x", -1): 0.0, ("y", 1): 270.0, ("y", -1): 90.0}[face.axis, face.direction]
        tilt_deg = rng.uniform(-1, 1) * min(0.5, most_deg)
        walls.append(Wall((place["x"], place["y"], 0.0), outward_deg + tilt_deg, half_width_mm=abs(apart_mm) + 5.0))
    return tuple(walls)


def _simulated(config: ProbeMachineConfig, bench: ProbeBench, stack: ExitStack) -> dict[str, ServoDrive]:
    """The bench's servos behind the wires of the axis files; those on CANopen on one bus."""
    drives: dict[str, ServoDrive] = {}
    channel = f"bench-{uuid.uuid4().hex}"
    bus = stack.enter_context(drives_in_turn(bench.clock, channel))
    links = Links({(VIRTUAL_BUS, channel): stack.enter_context(CanLink(bus.master(), bench.clock))})
    for number, (name, axis) in enumerate(config.axes.items(), start=1):
        face = axis.drive.face
        latch: ProbeLatch | None
        wires: Wires | None
        if face == "virtual":
            drives[name], latch, wires = _virtual(name, axis, bench)
        elif face == "canopen":
            profile = bus.add(bench.servos[name], number, parameters=_objects(axis)).profile
            latch, wires = profile.probe, profile.wires
            on_bus = replace(axis, drive=replace(axis.drive, node_id=number))
            drives[name] = canopen_drive(on_bus, bench.clock, (VIRTUAL_BUS, channel), stack, links=links)
        else:
            drives[name], latch, wires = _on_modbus(name, axis, bench, stack)
        if latch is not None and name in ("x", "y"):
            bench.wire(name, latch, config.probe.input)
        if wires is not None and name == config.codes.drive and config.codes.station is None:
            bench.give_codes_at(wires)
    bench.watch_probe()
    return drives


def _virtual(name: str, axis: DriveAxis, bench: ProbeBench) -> tuple[ServoDrive, ProbeLatch, Wires]:
    settings = VirtualDriveSettings(acceleration_mm_s2=axis.limits.max_acceleration_mm_s2, home_position_mm=0.0)
    drive = VirtualDrive(bench.servos[name], axis.scaling, axis.limits, bench.clock, name=axis.name, settings=settings)
    return stopped_by_signals(drive), drive.probe, drive.wires


def _objects(axis: DriveAxis) -> dict[tuple[int, int], int]:
    """The objects that a builder sets up: encoder, direct gear, a quick stop as hard as any move, homing on its
    switch.
    """
    counts = axis.scaling.encoder_counts_per_motor_rev
    ramp = axis.scaling.motor_counts_per_s(axis.limits.max_acceleration_mm_s2)
    units = {(0x608F, 1): counts, (0x608F, 2): 1, (0x6092, 1): counts, (0x6092, 2): 1}
    return {**units, (0x6085, 0): ramp, (0x6098, 0): 21, (0x6099, 1): 2 * counts, (0x6099, 2): counts // 10}


def _on_modbus(
    name: str, axis: DriveAxis, bench: ProbeBench, stack: ExitStack
) -> tuple[ServoDrive, ProbeLatch | None, Wires | None]:
    """A drive on Modbus, its latch and its terminals; None for a drive whose inputs cannot be read."""
    servo, unit = bench.servos[name], axis.drive.unit
    face: Face
    latch: ProbeLatch | None = None
    wires: Wires | None = None
    if axis.drive.register_map == "vendor_style":
        face = VendorRegisters(servo, counts_per_rev=axis.scaling.encoder_counts_per_motor_rev)
    else:
        face = registers = Cia402Registers(servo, parameters=_objects(axis))
        latch, wires = registers.profile.probe, registers.profile.wires
    endpoint: Endpoint
    if axis.drive.face == "modbus-tcp":
        _, port = stack.enter_context(tcp_server({unit: face}, bench.clock))
        endpoint = TcpEndpoint("127.0.0.1", port, timeout_s=BENCH_TIMEOUT_S)
    else:
        _, path = stack.enter_context(rtu_slave({unit: face}, bench.clock))
        endpoint = RtuEndpoint(path, baud=115_200, parity="N", timeout_s=BENCH_TIMEOUT_S)
    return modbus_drive(axis, bench.clock, endpoint, unit), latch, wires
