"""The strict simulated drive: a CANopen slave from any maker's EDS or DCF file alone, which enforces what the file says.

What is missing is missing (0602 0000h), what is read-only is read-only, limits, sizes and PDO mappability hold, and motion obeys the
units of the file (`maker_file.motion_units`). The motor turns in revolutions of its own: `StrictSlave.units` says what the drive takes
its numbers for, and the servo what the shaft then does.

Where a file leaves a firmware's own value open (no object, or an object without a default), the drive uses the value in `OWN`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.cia402.state_machine import QUICK_STOP_ENDINGS
from drivers.drive import DriveState
from sim_backends.canopen_dictionary import INVALID_VALUE, WRONG_STATE, Dictionary, Item, Key, RefusedError
from sim_backends.canopen_drive import CanOpenSlave, Send
from sim_backends.canopen_pdo_engine import DISABLED, PdoEngine
from sim_backends.canopen_profile import BIT_12, NEW_SETPOINT, PV, DriveProfile
from sim_backends.maker_file import ORIENTAL, PROFILE, MakerFile, MotionUnits, modes_by_objects, motion_units
from sim_backends.servo import SimulatedServo

IP = 7
NO_LIMIT = 0xFFFFFFFF
OWN: Mapping[Key, int] = {
    (0x1005, 0): 0xFFFF,  # no SYNC object: SYNC is not heard
    (0x605A, 0): 2,
    (0x605D, 0): 1,
    (0x605E, 0): 2,
    (0x6066, 0): 50,
}
OPEN_IF_ZERO = (0x6065, 0x607F)
"""A following error window or a largest velocity of 0 supervises nothing."""
OWN_HOMING, OWN_HOMING_REV_S = 17, 0.25
"""Of a drive whose method or speed of homing cannot be chosen: the negative limit switch, rev/s."""
OWN_ACCELERATION_REV_S2 = 50.0
"""Of a drive whose ramp is 0 or is no object."""


class StrictDictionary(Dictionary):
    """The objects of the file; the firmware's own access finds a value for those that are missing as well."""

    def __init__(self, items: dict[Key, Item], own: Mapping[Key, int]) -> None:
        super().__init__(items)
        self._own = dict(own)

    def number(self, index: int, subindex: int = 0) -> int:
        key = (index, subindex)
        item = self.items.get(key)
        if item is None or item.codec is None:
            reader = self._readers.get(key)
            return reader() if reader is not None else self._own.get(key, 0)
        return super().number(index, subindex)

    def set_number(self, index: int, subindex: int, value: int) -> None:
        item = self.items.get((index, subindex))
        if item is None or item.codec is None:
            self._own[index, subindex] = value
        else:
            self.set_raw(item.key, _packed(item.codec, value))

    def read(self, index: int, subindex: int) -> bytes:
        item = self.item(index, subindex)
        reader = self._readers.get(item.key)
        if item.readable and reader is not None and item.codec is not None:
            return _packed(item.codec, reader())
        return super().read(index, subindex)


def _packed(codec: struct.Struct, value: int) -> bytes:
    """A value in as many bytes as the object has: too many are cut, as in a drive with a wider register."""
    if codec.format.strip("<>") == "?":
        return codec.pack(bool(value))
    return (value & ((1 << 8 * codec.size) - 1)).to_bytes(codec.size, "little")


class AxisObjects:
    """The objects of one axis of a node as those of its first axis: 6040h + n·800h is shown as 6040h."""

    def __init__(self, dictionary: StrictDictionary, axis: int) -> None:
        self._dictionary = dictionary
        self._offset = 0x800 * (axis - 1)

    def _place(self, index: int) -> int:
        return index + self._offset if 0x6000 <= index < 0x6800 else index

    @property
    def items(self) -> Mapping[Key, Item]:
        """The entries of the node, those of this axis as the first axis's."""
        return {(index - self._offset, sub): item for (index, sub), item in self._dictionary.items.items()}

    def number(self, index: int, subindex: int = 0) -> int:
        """As `Dictionary.number`, with values that a firmware can work with."""
        value = self._dictionary.number(self._place(index), subindex)
        if index in OPEN_IF_ZERO and value <= 0:
            return NO_LIMIT
        if index == 0x605A and value not in QUICK_STOP_ENDINGS:
            return 2
        if index == 0x6098 and not self._writable(index):
            return OWN_HOMING
        if value == 0 and (self._place(index), subindex) not in self._dictionary.items:
            return OWN.get((index, subindex), 0)
        return value

    def _writable(self, index: int) -> bool:
        item = self._dictionary.items.get((self._place(index), 0))
        return item is not None and item.writable

    def on_read(self, index: int, subindex: int, reader: Callable[[], int]) -> None:
        self._dictionary.on_read(self._place(index), subindex, reader)

    def on_write(self, index: int, subindex: int, writer: Callable[[int], None]) -> None:
        self._dictionary.on_write(self._place(index), subindex, writer)


class UnitServo:
    """A servo as a firmware with its own units of position, velocity and acceleration drives it. All else is the servo's."""

    def __init__(self, servo: SimulatedServo, units: MotionUnits) -> None:
        self.servo = servo
        counts = servo.parameters.counts_per_rev
        self._position = units.position_rev * counts  # servo counts per unit
        self._velocity = units.velocity_rev_s * counts
        self._acceleration = units.acceleration_rev_s2 * counts
        self._own_acceleration = OWN_ACCELERATION_REV_S2 * counts

    def __getattr__(self, name: str) -> Any:
        return getattr(self.servo, name)

    def _ramp(self, acceleration: float) -> float:
        return abs(acceleration) * self._acceleration or self._own_acceleration

    @property
    def position_demand_counts(self) -> int:
        return round(self.servo.position_demand_counts / self._position)

    @property
    def position_actual_counts(self) -> int:
        return round(self.servo.position_actual_counts / self._position)

    @property
    def velocity_actual_counts_s(self) -> int:
        return round(self.servo.velocity_actual_counts_s / self._velocity)

    @property
    def following_error_counts(self) -> int:
        return round(self.servo.following_error_counts / self._position)

    def quick_stop(self, deceleration: float) -> None:
        self.servo.quick_stop(self._ramp(deceleration))

    def halt(self, deceleration: float) -> None:
        self.servo.halt(self._ramp(deceleration))

    def move_absolute(self, target: int, velocity: float, acceleration: float) -> None:
        if velocity:
            self.servo.move_absolute(
                round(target * self._position), velocity * self._velocity, self._ramp(acceleration)
            )

    def move_velocity(self, velocity: float, acceleration: float) -> None:
        self.servo.move_velocity(velocity * self._velocity, self._ramp(acceleration))

    def start_homing(self, method: int, switch: float, zero: float, offset: int) -> None:
        if switch <= 0:
            switch = OWN_HOMING_REV_S * self.servo.parameters.counts_per_rev / self._velocity
        self.servo.start_homing(
            method, switch * self._velocity, (zero or switch) * self._velocity, round(offset * self._position)
        )

    def cyclic_position(self, target: int) -> None:
        self.servo.cyclic_position(round(target * self._position))

    def cyclic_velocity(self, velocity: float) -> None:
        self.servo.cyclic_velocity(velocity * self._velocity)


class StrictProfile(DriveProfile):
    """The device profile over the objects of a file, with interpolated position (mode 7: 60C1h, active while bit 4 is set)."""

    _interpolates = False

    def _bind(self) -> None:
        super()._bind()
        self._od.on_write(0x60C1, 1, self._write_interpolation_data)

    def reset(self) -> None:
        super().reset()
        self._interpolates = False
        mode = self._od.number(0x6060)
        self._mode = mode if 0 < mode <= 10 and self._od.number(0x6502) & 1 << (mode - 1) else 0

    @property
    def cyclic(self) -> bool:
        return super().cyclic or (self._interpolates and self.state is DriveState.ENABLED)

    def _true_statusword(self) -> int:
        word = super()._true_statusword()
        if self._mode == IP and self._interpolates and self.state is DriveState.ENABLED and not self._servo.stopping:
            word |= BIT_12
        return word

    def _write_controlword(self, word: int) -> None:
        super()._write_controlword(word)
        self._interpolates = self._mode == IP and self.state is DriveState.ENABLED and bool(word & NEW_SETPOINT)

    def _write_interpolation_data(self, target: int) -> None:
        if self._interpolates:
            self._servo.cyclic_position(self._clamp(target))

    def _write_target_velocity(self, velocity: int) -> None:
        largest = self._od.number(0x607F)
        super()._write_target_velocity(max(-largest, min(largest, velocity)))

    def _finish_enabling(self) -> None:
        super()._finish_enabling()
        if self.state is DriveState.ENABLED and self._mode == PV:
            self._write_target_velocity(self._od.number(0x60FF))


class StrictPdoEngine(PdoEngine):
    """PDOs as delivered are taken whatever they map; what the master maps is checked. kinds: transmission types of RPDO 1 and on."""

    _checks = False
    kinds: frozenset[int] | None = None

    def reload(self) -> None:
        self._checks = False
        super().reload()
        for pdo in self._pdos:
            if not pdo.cob_id:
                self._set_cob_id(pdo, DISABLED)
        self._checks = True

    def _write_kind(self, pdo: Any, value: int) -> None:
        if self.kinds is not None and not pdo.transmit and value not in self.kinds:
            raise RefusedError(INVALID_VALUE)
        super()._write_kind(pdo, value)

    def _fixed(self, pdo: Any) -> bool:
        """Whether its COB-ID is read-only, so that it cannot be switched off to be mapped."""
        item = self._dictionary.items.get((pdo.communication, 1))
        return item is not None and not item.writable

    def _write_mapping(self, pdo: Any, value: int) -> None:
        if not self._fixed(pdo):
            super()._write_mapping(pdo, value)
            return
        if self._count(pdo):
            raise RefusedError(WRONG_STATE)
        if value:
            self._mapped_item(pdo, value)

    def _write_count(self, pdo: Any, value: int) -> None:
        if not self._fixed(pdo):
            super()._write_count(pdo, value)
            return
        self._map(pdo, [self._dictionary.number(pdo.mapping, sub) for sub in range(1, value + 1)])

    def _mapped_item(self, pdo: Any, mapping: int) -> Item:
        delivered = [
            number
            for (index, _), entry in self._dictionary.items.items()
            if index == pdo.mapping and entry.codec is not None
            for (number,) in (entry.codec.unpack(entry.default),)
        ]
        if self._checks and mapping not in delivered:
            return super()._mapped_item(pdo, mapping)
        item = self._dictionary.items.get((mapping >> 16, mapping >> 8 & 0xFF))
        bits = mapping & 0xFF
        if item is not None and item.bits == bits:
            return item
        codec = struct.Struct({8: "<B", 16: "<H", 32: "<I", 64: "<Q"}.get(bits, "<B"))
        return Item(mapping >> 16, mapping >> 8 & 0xFF, "", "rw", codec, None, None, True, bytes(codec.size))

    def _map(self, pdo: Any, mappings: list[int]) -> None:
        if self._checks:
            super()._map(pdo, mappings)
            return
        kept: list[int] = []
        for mapping in mappings:  # a file's default that no frame could carry is cut
            if mapping & 0xFF in (8, 16, 32, 64) and sum(other & 0xFF for other in (*kept, mapping)) <= 64:
                kept.append(mapping)
        super()._map(pdo, kept)


class StrictSlave(CanOpenSlave):
    """One node from a maker's file. servos: of its further axes, the first axis's is `servo`. units: of each axis."""

    _dictionary_kind: type[StrictDictionary] = StrictDictionary

    def __init__(
        self,
        servo: SimulatedServo,
        node_id: int,
        send: Send,
        *,
        maker: MakerFile,
        lead_m: float = 0.010,
        servos: Sequence[SimulatedServo] = (),
        **others: Any,
    ) -> None:
        self.maker = maker
        self._servos = (servo, *servos)
        self.units = [motion_units(maker, 4096, lead_m, axis) for axis in range(1, len(self._servos) + 1)]
        self.more: list[StrictProfile] = []
        super().__init__(servo, node_id, send, **others)

    def _made_dictionary(self, eds: Path, own: Mapping[Key, Item]) -> Dictionary:
        del eds
        firmware = {
            (0x1014, 0): 0x80 + self.node_id,
            **OWN,
        }
        for axis in range(1, len(self._servos) + 1):
            firmware[0x6502 + 0x800 * (axis - 1), 0] = modes_by_objects(self.maker, axis)
        dictionary = self._dictionary_kind({**self.maker.items(self.node_id), **own}, firmware)
        identity = {(0x1000, 0): PROFILE, (0x1018, 1): self.maker.vendor}
        for key, value in (identity | {key: firmware[key] for key in firmware if key[0] & 0xF7FF == 0x6502}).items():
            if key in dictionary.items and self.maker.number(*key) is None:  # a constant that the file leaves open
                dictionary.set_number(*key, value)
        return dictionary

    def _made_profile(self, servo: Any) -> DriveProfile:
        del servo
        profiles = [
            StrictProfile(AxisObjects(self.dictionary, axis), UnitServo(own, units), self.emergency)  # type: ignore[arg-type]
            for axis, (own, units) in enumerate(zip(self._servos, self.units, strict=True), start=1)
        ]
        self.more = profiles[1:]
        return profiles[0]

    def _made_pdos(self) -> PdoEngine:
        engine = StrictPdoEngine(self.dictionary, self._transmit, self._on_short_pdo)
        if self.maker.vendor == ORIENTAL:  # its manual: 00h, FEh and FFh only
            engine.kinds = frozenset((0x00, 0xFE, 0xFF))
        return engine

    def boot(self, now_ns: int) -> None:
        super().boot(now_ns)
        for profile in self.more:
            profile.reset()

    def tick(self, now_ns: int) -> None:
        for profile in self.more:
            profile.tick(now_ns)
        super().tick(now_ns)
