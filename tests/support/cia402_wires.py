"""The wires that carry a CiA 402 drive, each around one simulated drive whose objects are watched.

Two are the project's; the two others are the least that `drivers.cia402` needs of a wire: a plain dictionary, and the registers of a
Modbus unit that are CiA 402 objects.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace

from support.served_drive import served

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.settings import CanOpenSettings
from drivers.cia402 import objects
from drivers.cia402.drive import Cia402Drive
from drivers.cia402.objects import DataType, Entry
from drivers.cia402.settings import Cia402Settings
from drivers.cia402.wire import OBJECT_MISSING, Absent
from drivers.clock import Clock
from drivers.drive import Capability, DriveSample
from drivers.errors import AbortError
from drivers.limits import DriveLimits
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.map_roles import Write
from drivers.modbus.register_access import RegisterAccess
from drivers.scaling import AxisScaling
from drivers.shutdown import Left, StoppableDrive
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_dictionary import Dictionary, RefusedError
from sim_backends.canopen_profile import DriveProfile
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import tcp_server
from sim_backends.servo import SimulatedServo

LIMITS = DriveLimits(-200.0, 200.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
SCALING = AxisScaling(SMALL_SERVO.counts_per_rev, 10.0)
STATUSWORD, CONTROLWORD, TARGET_POSITION = 0x6041, 0x6040, 0x607A
IMAGE = (
    objects.STATUSWORD,
    objects.POSITION_ACTUAL,
    objects.VELOCITY_ACTUAL,
    objects.TORQUE_ACTUAL,
    objects.FOLLOWING_ERROR_ACTUAL,
)


# -- the least that a wire gives ------------------------------------------------------------------------------------------
class DictionaryAccess:
    """Objects of a simulated drive without a wire between; each access takes a millisecond."""

    name = "drive X"

    def __init__(self, dictionary: Dictionary, clock: Clock) -> None:
        self._dictionary = dictionary
        self._clock = clock

    def read(self, entry: Entry) -> int:
        self._clock.sleep_s(0.001)
        try:
            value = entry.unpack(self._dictionary.read(*entry.key))
        except RefusedError as error:
            raise AbortError(f"{self.name}: {entry} is not read", error.code) from error
        assert isinstance(value, int)
        return value

    def read_all(self, entries: Sequence[Entry]) -> dict[Entry, int]:
        """At once."""
        return {entry: self.read(entry) for entry in entries}

    def read_if_shown(self, entry: Entry, absent: Absent) -> int | Absent:
        try:
            return self.read(entry)
        except AbortError:
            return absent

    def write(self, entry: Entry, value: int) -> None:
        self._clock.sleep_s(0.001)
        self._write(entry, value)

    def _write(self, entry: Entry, value: int) -> None:
        try:
            self._dictionary.write(*entry.key, entry.pack(value))
        except RefusedError as error:
            raise AbortError(f"{self.name}: {entry} is not written", error.code) from error

    def send(self, word: int) -> None:
        """A controlword, without waiting."""
        self._write(objects.CONTROLWORD, word)


class RegisterObjects(DictionaryAccess):
    """Objects that stand in registers, by (index, sub-index)."""

    def __init__(self, access: RegisterAccess, names: Mapping[tuple[int, int], str]) -> None:
        self._access = access
        self._names = names

    def _register(self, entry: Entry) -> str:
        if entry.key not in self._names:
            raise AbortError(f"{self.name}: {entry} is no register", OBJECT_MISSING[0])
        return self._names[entry.key]

    def read(self, entry: Entry) -> int:
        name = self._register(entry)
        return self._access.integers([name])[name]

    def read_all(self, entries: Sequence[Entry]) -> dict[Entry, int]:
        names = {entry: self._register(entry) for entry in entries}
        values = self._access.integers(names.values())
        return {entry: values[name] for entry, name in names.items()}

    def write(self, entry: Entry, value: int) -> None:
        self._access.write({self._register(entry): value})

    def send(self, word: int) -> None:
        self._access.post([Write(self._register(objects.CONTROLWORD), None, word)])


class ReadImage:
    """Values that are read when they are asked for."""

    def __init__(self, access: DictionaryAccess, clock: Clock) -> None:
        self._access = access
        self._clock = clock
        self.values: dict[Entry, int] = {}
        self.heard_ns = self.asked_ns = 0

    @property
    def statusword(self) -> int:
        return self.values[objects.STATUSWORD]

    @property
    def position_counts(self) -> int:
        return self.values[objects.POSITION_ACTUAL]

    def refresh(self) -> None:
        self.asked_ns = self._clock.now_ns()
        self.values = self._access.read_all(IMAGE)
        self.heard_ns = self._clock.now_ns()


class BareDrive(Cia402Drive):
    """What a wire's drive adds to the standard, and no more. connect: gives the objects, and what closes them."""

    def __init__(self, clock: Clock, settings: Cia402Settings, connect: Callable[[], DictionaryAccess]) -> None:
        super().__init__("X", SCALING, LIMITS, clock, settings)
        self._connect = connect

    def open(self) -> None:
        self.way_out.over()
        self.notes = []
        self._objects = self._connect()
        vendor = self._objects.read_if_shown(Entry(0x1018, 1, DataType.U32, "vendor id"), 0)
        self._take_up(self._objects, ReadImage(self._objects, self.clock), vendor)
        self._open = True

    @property
    def capabilities(self) -> frozenset[Capability]:
        return frozenset({Capability.PROFILE_POSITION, Capability.HOMING})

    def _send_word(self, word: int, *, every_way: bool = True) -> None:
        del every_way
        with suppress(Exception):
            self._objects.send(word)

    def _glance(self) -> DriveSample:
        return self._look()

    def _look(self) -> DriveSample:
        self.image.refresh()
        return self._as_sample()

    def _put_back(self, left: Left) -> None:
        if left is Left.OFF:
            self.kept.put_back()

    def _ask(self) -> None:
        """It answers."""

    def _release(self) -> None:
        self._open = False


# -- rigs -----------------------------------------------------------------------------------------------------------------
@dataclass
class WatchedDrive:
    """words: every controlword that the drive was given, each with the statusword that it had shown last; targets: 607Ah, with the
    position then."""

    drive: StoppableDrive
    dictionary: Dictionary
    profile: DriveProfile
    servo: SimulatedServo
    clock: SimClock
    words: list[tuple[int, int]] = field(default_factory=list)
    targets: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._shown = 0
        self.dictionary.on_read(STATUSWORD, 0, self._show)
        self.dictionary.on_write(CONTROLWORD, 0, lambda word: self.words.append((word, self._shown)))
        self.dictionary.on_write(
            TARGET_POSITION, 0, lambda counts: self.targets.append((counts, self.servo.position_actual_counts))
        )

    def _show(self) -> int:
        self._shown = self.profile.statusword()
        return self._shown


Wired = Callable[[Cia402Settings], AbstractContextManager[WatchedDrive]]


def _machine() -> tuple[SimClock, SimulatedServo]:
    clock = SimClock()
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    clock.attach(servo.advance, bearable=servo.bearable)
    return clock, servo


@contextmanager
def canopen(settings: Cia402Settings) -> Iterator[WatchedDrive]:
    """python-can's virtual bus."""
    clock, servo = _machine()
    channel = uuid.uuid4().hex
    patient = CanOpenSettings(**vars(settings), sdo_timeout_s=5.0, sample_timeout_s=5.0)
    with (
        served(servo, clock, interface="virtual", channel=channel, node_id=5) as slave,
        CanLink.open(clock, interface="virtual", channel=channel) as link,
    ):
        drive = CanOpenDrive("X", SCALING, LIMITS, clock, link=link, node_id=5, settings=patient)
        yield WatchedDrive(drive, slave.dictionary, slave.profile, servo, clock)


@contextmanager
def dictionary(settings: Cia402Settings) -> Iterator[WatchedDrive]:
    """No wire."""
    clock, servo = _machine()
    device = Cia402Registers(servo)
    clock.attach(lambda now_ns, _: device.tick(now_ns), bearable=device.bearable)
    drive = BareDrive(clock, settings, lambda: DictionaryAccess(device.dictionary, clock))
    yield WatchedDrive(drive, device.dictionary, device.profile, servo, clock)


@contextmanager
def _registers() -> Iterator[tuple[Cia402Registers, SimClock, SimulatedServo, ModbusLink]]:
    clock, servo = _machine()
    device = Cia402Registers(servo)
    with tcp_server({7: device}, clock) as (_, port):
        yield device, clock, servo, ModbusLink(TcpEndpoint("127.0.0.1", port), clock)


@contextmanager
def registers(settings: Cia402Settings) -> Iterator[WatchedDrive]:
    """Modbus TCP; the registers are taken as objects."""
    with _registers() as (device, clock, servo, link):
        found = load_drive_map("cia402_over_modbus").registers

        def connect() -> DictionaryAccess:
            link.open()
            return RegisterObjects(RegisterAccess(link, 7, found), OBJECT_REGISTERS)

        named = replace(settings, modes=(1, 6))  # 6502h is no register, nor is the target of the modes of velocity
        drive = BareDrive(clock, named, connect)
        yield WatchedDrive(drive, device.dictionary, device.profile, servo, clock)
        link.close()


@contextmanager
def register_map(settings: Cia402Settings) -> Iterator[WatchedDrive]:
    """Modbus TCP; the roles of the registers are taken from the map."""
    del settings
    with _registers() as (device, clock, servo, link):
        drive = ModbusDrive(
            "X", SCALING, LIMITS, clock, link=link, unit=7, drive_map=load_drive_map("cia402_over_modbus")
        )
        yield WatchedDrive(drive, device.dictionary, device.profile, servo, clock)


OBJECT_REGISTERS = {
    objects.STATUSWORD.key: "statusword",
    objects.MODE_DISPLAY.key: "mode_display",
    objects.POSITION_ACTUAL.key: "position_actual",
    objects.VELOCITY_ACTUAL.key: "velocity_actual",
    objects.TORQUE_ACTUAL.key: "torque_actual",
    objects.ERROR_CODE.key: "error_code",
    objects.FOLLOWING_ERROR_ACTUAL.key: "following_error",
    objects.CONTROLWORD.key: "controlword",
    objects.MODE.key: "mode",
    objects.TARGET_POSITION.key: "target_position",
    objects.PROFILE_VELOCITY.key: "profile_velocity",
    objects.PROFILE_ACCELERATION.key: "profile_acceleration",
    objects.PROFILE_DECELERATION.key: "profile_deceleration",
    objects.QUICK_STOP_DECELERATION.key: "quick_stop_deceleration",
    objects.QUICK_STOP_OPTION.key: "quick_stop_option",
    objects.HOMING_METHOD.key: "homing_method",
    objects.HOME_OFFSET.key: "home_offset",
    objects.POSITION_WINDOW.key: "position_window",
    (0x1018, 1): "vendor_id",
}
WIRES: dict[str, Wired] = {
    "dictionary": dictionary,
    "canopen, virtual bus": canopen,
    "modbus, registers as objects": registers,
    "modbus, register map": register_map,
}
