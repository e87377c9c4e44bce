"""A CANopen node's parameters as raw bytes, over SDO only. `not_parameters` says what may not be written.

For whole sets the node is not opened as a drive: no PDO is mapped, no heartbeat requested, nothing is set up that would have to be
restored, so the values read are those that the user set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

from drivers.canopen import cia301
from drivers.canopen.eds import EdsEntry
from drivers.canopen.eds_text import summary
from drivers.canopen.known_objects import FITTING, address_of, kind_of, known_objects, range_of, unit_text
from drivers.canopen.node import NmtCommand, Node
from drivers.canopen.not_parameters import refusal
from drivers.canopen.pdo import SETTINGS
from drivers.canopen.sdo import most_bytes
from drivers.canopen.side_by_side import CanLine
from drivers.canopen.whole_pdo import PdoImage, described, pdo_at, read_pdo, write_pdo
from drivers.canopen.wire_time import transfer
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.cia402.state_machine import decode_state
from drivers.cia402.units import MOTION_OBJECTS, motion_units
from drivers.cia402.wire import OBJECT_MISSING
from drivers.drive import DriveState
from drivers.errors import (
    AbortError,
    CapabilityError,
    InputError,
    NoAnswerError,
    ProtocolError,
)
from drivers.parameters import ParameterInfo, ParameterKind, ParameterValue
from drivers.raw_parameters import (
    DriveIdentity,
    Pause,
    RawForm,
    RawParameter,
    RawParameters,
    Steps,
    WireTime,
)
from drivers.scaling import AxisScaling, MotionScaling

STORE_S = 10.0  # longest time of a drive's store command
START_S = 10.0  # longest time from a reset to the boot-up message
_UNITS = (0x608F, 0x6090, 0x6091, 0x6092, 0x6093, 0x6096, 0x6097, 0x60A8, 0x60A9)
_LIMITS = (0x607B, 0x607D, 0x607F, 0x6080, 0x60C5, 0x60C6)
_PAIRS = (("607B:01", "607B:02"), ("607D:01", "607D:02"))


class CanOpenRawParameters(RawParameters):
    """Parameters of one node, which is open. Without a maker's file: the standard's objects, without limits.

    scaling, velocity_unit, acceleration_unit: of the axis file, for the units of velocities and accelerations, which `identify` reads;
    units: these, where they are known. Without one of both these objects are shown without a unit.
    """

    def __init__(
        self,
        node: Node,
        line: CanLine,
        *,
        scaling: AxisScaling | None = None,
        velocity_unit: str | None = None,
        acceleration_unit: str | None = None,
        units: MotionScaling | None = None,
    ) -> None:
        self.name = node.name
        self.line: CanLine = line
        self.clock = line.link.clock
        self.assumed = node.eds is None
        self.path = None if node.eds is None else node.eds.path
        self._node = node
        self._eds = node.eds
        self._scaling = scaling
        self._stated = {"velocity": velocity_unit, "acceleration": acceleration_unit}
        self._motion = units
        self._known = known_objects(node.eds)
        self._keys = {address_of(key): found for key, found in sorted(self._known.entries.items())}
        self._described: dict[str, RawParameter] = {}

    # -- description ---------------------------------------------------------------------------------------------------
    @cached_property
    def entries(self) -> Mapping[str, RawParameter]:
        return {address: self._parameter(address) for address, found in self._keys.items() if _shown(found)}

    @cached_property
    def names(self) -> Mapping[str, str]:
        """The standard's objects under its names, the others by their addresses."""
        named = {name: address_of(key) for name, key in self._known.names.items()}
        others = {address for address, found in self._keys.items() if _shown(found)}.difference(named.values())
        return named | {address: address for address in sorted(others)}

    def _parameter(self, address: str) -> RawParameter:
        if address not in self._described:
            found = self._keys[address]
            entry, (low, high), refused = found.entry, range_of(found), refusal(found, self._node.table)
            unit = unit_text(self._known.units.get(entry.key, ""), None)
            info = ParameterInfo(
                entry.name, kind_of(entry.type), unit, low, high, refused is None, description=str(entry)
            )
            told = () if refused is None else (refused.why, refused.kind.value)
            self._described[address] = RawParameter(address, info, entry.type.name, *told)
        return self._described[address]

    def find(self, address: str) -> RawParameter | None:
        """The parameter at an address: a PDO as a whole ("1400h PDO") too, and an object that is refused as it cannot be read."""
        pdo = pdo_at(address)
        if pdo is None:
            return self._parameter(address) if address in self._keys else None
        if self._eds is not None and (pdo.communication, 1) not in self._eds.entries:
            return None
        return RawParameter(address, ParameterInfo(pdo.name, ParameterKind.TEXT, "", None, None, True), "PDO")

    def unit_of(self, parameter: RawParameter) -> str:
        """That of a velocity or an acceleration is known after `identify`, as the drive had it then."""
        found = self._keys.get(parameter.address)
        return "" if found is None else unit_text(self._known.units.get(found.entry.key, ""), self._motion)

    def doubts_of_file(self, found: DriveIdentity) -> Sequence[str]:
        if self._eds is None:
            return ()
        vendor, product = (found.model.get(name) for name in ("vendor_id", "product_code"))
        return self._eds.doubts(*(number if isinstance(number, int) else None for number in (vendor, product)))

    @property
    def file_notes(self) -> Sequence[str]:
        return () if self._eds is None else summary(self._eds.notes)

    def _entry(self, entry: RawParameter) -> Entry:
        return self._keys[entry.address].entry

    def encode(self, entry: RawParameter, value: ParameterValue) -> bytes:
        """A value in its unit -> bytes, little endian. Raises InputError."""
        kind = entry.info.kind
        if pdo_at(entry.address) is not None:
            raise InputError("is a PDO, expected its raw form")
        if not isinstance(value, FITTING[kind]) or isinstance(value, bool):
            raise InputError(f"{value!r} is no {kind.value}")
        return self._entry(entry).pack(value)

    def decode(self, entry: RawParameter, data: bytes) -> ParameterValue:
        if pdo_at(entry.address) is not None:
            return described(data)
        value = self._entry(entry).unpack(data)
        return int(value) if isinstance(value, bool) else value

    def from_raw(self, entry: RawParameter, raw: RawForm) -> bytes:
        """A raw value -> bytes, little endian. Raises InputError."""
        if isinstance(raw, int):
            if entry.info.kind is not ParameterKind.INTEGER:
                raise InputError(f"raw is {raw}, expected hexadecimal digits for a {entry.type}")
            return self._entry(entry).pack(raw)
        try:
            data = bytes.fromhex(raw)
        except ValueError as error:
            raise InputError(f"raw is {raw!r}, expected hexadecimal digits") from error
        if pdo_at(entry.address) is not None:
            PdoImage.unpack(data)
            return data
        size = self._entry(entry).type.size
        if size and len(data) != size:
            raise InputError(f"raw is {len(data)} bytes, a {entry.type} has {size}")
        return data

    def to_raw(self, entry: RawParameter, data: bytes) -> RawForm:
        if entry.info.kind is ParameterKind.INTEGER:
            return int(self._entry(entry).unpack(data))
        return data.hex()

    def objection(self, entry: RawParameter, data: bytes) -> str | None:
        return super().objection(entry, data) if pdo_at(entry.address) is None else PdoImage.unpack(data).objection()

    def same(self, entry: RawParameter, shown: bytes, meant: bytes) -> bool:
        if pdo_at(entry.address) is not None:
            return PdoImage.unpack(shown).holds(PdoImage.unpack(meant))
        return self._entry(entry).same(shown, meant)

    def rank(self, address: str) -> int:
        """Units first, then limits, then the rest, and PDOs last."""
        if pdo_at(address) is not None:
            return 3
        index = self._keys[address].entry.index
        return 0 if index in _UNITS else 1 if index in _LIMITS else 2

    @property
    def limit_pairs(self) -> Sequence[tuple[str, str]]:
        return [(f"{low[:4]}h{low[4:]}", f"{high[:4]}h{high[4:]}") for low, high in _PAIRS]

    def cost(self, reads: Sequence[tuple[str, bytes]], writes: Sequence[tuple[str, bytes]]) -> WireTime:
        sizes = [size for address, data in reads for size in _sizes(address, data, written=False)]
        sizes += [size for address, data in writes for size in _sizes(address, data, written=True)]
        return sum((transfer(size, self.line.link.bitrate) for size in sizes), WireTime())

    # -- transfers -------------------------------------------------------------------------------------------------------
    def _upload(self, entry: Entry) -> Steps[bytes]:
        return self._node.sdo.reading(entry.index, entry.subindex, most_bytes(entry))

    def _download(
        self, entry: Entry, data: bytes, *, timeout_s: float | None = None, reads_back: bool = True
    ) -> Steps[None]:
        return self._node.sdo.writing(
            entry.index, entry.subindex, data, timeout_s=timeout_s, reads_back=reads_back, same=entry.same
        )

    def _optional(self, entry: Entry) -> Steps[int | str | None]:
        """A value, None where the node does not have the object."""
        try:
            value = entry.unpack((yield from self._upload(entry)))
        except AbortError as error:
            if error.code in OBJECT_MISSING:
                return None
            raise
        return value if isinstance(value, str) else int(value)

    def _read_group(self, addresses: Sequence[str]) -> Steps[Sequence[bytes]]:
        (address,) = addresses
        pdo = pdo_at(address)
        if pdo is None:
            return [(yield from self._upload(self._keys[address].entry))]
        return [(yield from read_pdo(self._node.sdo, pdo)).pack()]

    def _write_group(self, items: Sequence[tuple[str, bytes]]) -> Steps[None]:
        ((address, data),) = items
        pdo = pdo_at(address)
        if pdo is None:
            yield from self._download(self._keys[address].entry, data)
        else:
            present, meant = (yield from read_pdo(self._node.sdo, pdo)), PdoImage.unpack(data)
            if not present.holds(meant):
                yield from write_pdo(self._node.sdo, present, meant)

    def _read_units(self, scaling: AxisScaling, vendor: int) -> Steps[MotionScaling | None]:
        """Of velocity and acceleration, by the axis file, the drive's objects, its maker's manual or the standard; None where one of
        the objects cannot be understood."""
        found: dict[Entry, int] = {}
        for entry in MOTION_OBJECTS:
            try:
                found[entry] = int(entry.unpack((yield from self._upload(entry))))
            except AbortError:
                continue
            except ProtocolError:
                return None
        return motion_units(found.get, scaling, **self._stated, vendor=vendor)

    # -- on the wire -----------------------------------------------------------------------------------------------------
    def identify(self) -> Steps[DriveIdentity]:
        """1018h, 1008h to 100Ah; objects that the node does not have are left out. The units of `unit_of` are read too."""
        facts: dict[str, int | str] = {}
        for name, entry in (
            ("vendor_id", cia301.VENDOR_ID),
            ("product_code", cia301.PRODUCT_CODE),
            ("revision", cia301.REVISION),
            ("serial", cia301.SERIAL_NUMBER),
            ("device", cia301.DEVICE_NAME),
            ("hardware", cia301.HARDWARE_VERSION),
            ("firmware", cia301.SOFTWARE_VERSION),
        ):
            value = yield from self._optional(entry)
            if value is not None:
                facts[name] = value

        def chosen(*names: str) -> dict[str, int | str]:
            return {name: facts[name] for name in names if name in facts}

        if self._scaling is not None:
            vendor = int(facts.get("vendor_id", 0))
            vendor = vendor if self._eds is None else self._eds.maker(vendor)
            self._motion = yield from self._read_units(self._scaling, vendor)
        model = chosen("vendor_id", "product_code", "device")
        return DriveIdentity("canopen", model, chosen("revision", "hardware", "firmware"), chosen("serial"))

    def state(self) -> Steps[DriveState]:
        word = yield from self._optional(objects.STATUSWORD)
        return DriveState.UNKNOWN if not isinstance(word, int) else decode_state(word)

    # -- storing and restoring ---------------------------------------------------------------------------------------------
    def objection_to_store(self) -> Steps[str | None]:
        abilities = yield from self._optional(cia301.STORE_ALL)
        if isinstance(abilities, int) and abilities & cia301.ON_COMMAND:
            return None
        return f"it does not keep its parameters on command ({cia301.STORE_ALL})"

    def store(self) -> Steps[None]:
        """1010h:1 := "save"; before that targets are made harmless, as a drive may store them too."""
        position = yield from self._optional(objects.POSITION_ACTUAL)
        targets = [
            (objects.TARGET_POSITION, position),
            (objects.TARGET_VELOCITY, 0),
            (objects.TARGET_TORQUE, 0),
        ]
        for entry, value in targets:
            if isinstance(value, int):
                yield from self._make_harmless(entry, value)
        yield from self._download(cia301.STORE_ALL, cia301.SAVE, timeout_s=STORE_S, reads_back=False)

    def _make_harmless(self, entry: Entry, value: int) -> Steps[None]:
        try:
            yield from self._download(entry, entry.pack(value))
        except AbortError as error:
            if error.code not in OBJECT_MISSING:
                raise

    def load_defaults(self) -> Steps[None]:
        """1011h:1 := "load". Raises CapabilityError where it is not done on command."""
        abilities = yield from self._optional(cia301.RESTORE_ALL)
        if not isinstance(abilities, int) or not abilities & cia301.ON_COMMAND:
            raise CapabilityError(f"drive {self.name}: {cia301.RESTORE_ALL} is not done on command")
        yield from self._download(cia301.RESTORE_ALL, b"load", timeout_s=STORE_S, reads_back=False)

    def restart(self) -> Steps[None]:
        """NMT reset node; returns when its boot-up was received. Raises NoAnswerError."""
        before = self._node.monitor.boot_ups
        self._node.monitor.command(NmtCommand.RESET_NODE)
        yield Pause(START_S, lambda: self._node.monitor.boot_ups > before)
        if self._node.monitor.boot_ups == before:
            raise NoAnswerError(
                f"drive {self.name}: no boot-up of node {self._node.node_id} within {START_S:g} s of its reset"
            )

    @property
    def restarts(self) -> int:
        return self._node.monitor.boot_ups

    @property
    def hears_restarts(self) -> bool:
        return True

    @property
    def gone(self) -> bool:
        return self.line.lost


def _shown(found: EdsEntry) -> bool:
    return found.readable and found.entry.type is not DataType.DOMAIN


def _sizes(address: str, data: bytes, *, written: bool) -> list[int]:
    """Bytes of each transfer that reads or writes a parameter."""
    if pdo_at(address) is None:
        return [len(data)]
    image = PdoImage.unpack(data)
    given = [len(part) for _, part in image.items]
    look = [*given, *(4 for sub in SETTINGS if (False, sub) not in image.numbers)]
    # a write sees it first, disables and clears it, writes it, sees its mapping and enables it
    return [*look, 4, 1, *given, *given] if written else look
