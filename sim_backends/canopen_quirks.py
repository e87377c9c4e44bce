"""The simulated drive as one of the documented drives: the strict drive, with the switches of a profile (`drive_profiles.Switches`).

Nothing here knows a maker: what differs from drive to drive is data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivers.cia402.state_machine import QUICK_STOP_ENDINGS, Command, state_bits
from drivers.clock import NS_PER_S
from drivers.drive import DriveState
from sim_backends.bench import HOMING_REV_S, HOMING_SLOW_REV_S, BenchParameters
from sim_backends.canopen_dictionary import INVALID_VALUE, WRONG_STATE, Dictionary, Item, Key, RefusedError
from sim_backends.canopen_drive import Send
from sim_backends.canopen_pdo_engine import DISABLED, NOT_MAPPABLE, PDO_TOO_LONG, PdoEngine
from sim_backends.canopen_profile import BIT_12, HALT, PP, QUICK_STOP_OFF, REACHED, DriveProfile
from sim_backends.canopen_strict import (
    AxisObjects,
    StrictDictionary,
    StrictPdoEngine,
    StrictProfile,
    StrictSlave,
    UnitServo,
)
from sim_backends.drive_profiles import DriveProfileFile, Switches
from sim_backends.maker_file import MakerFile, MotionUnits
from sim_backends.servo import SimulatedServo

HOMING_WITHOUT_MOTION = 37
CHANGES_EVERY_S = 10.0
"""How often an object that changes by itself does so, s."""
LENGTH_EXCEEDED = 0x8220
"""Emergency of a PDO that is longer than its mapping."""
INCREMENTS = 0x00B50000  # 60A8h
FAULT_BIT = 0x0008


class QuirkyServo(UnitServo):
    """A servo whose position is shown with an offset, in the drive's units, until it is homed, and which may home where it stands."""

    def __init__(self, servo: SimulatedServo, units: MotionUnits, switches: Switches) -> None:
        super().__init__(servo, units)
        self._offset = switches.start_counts
        self._homing_moves = switches.homing_moves

    @property
    def _added(self) -> int:
        return 0 if self.servo.homed else self._offset

    @property
    def position_demand_counts(self) -> int:
        return super().position_demand_counts + self._added

    @property
    def position_actual_counts(self) -> int:
        return super().position_actual_counts + self._added

    def move_absolute(self, target: int, velocity: float, acceleration: float) -> None:
        super().move_absolute(target - self._added, velocity, acceleration)

    def cyclic_position(self, target: int) -> None:
        super().cyclic_position(target - self._added)

    def start_homing(self, method: int, switch: float, zero: float, offset: int) -> None:
        super().start_homing(method if self._homing_moves else HOMING_WITHOUT_MOTION, switch, zero, offset)


class QuirkyDictionary(StrictDictionary):
    """Entries that answer a write with a value that they do not take. ignored: those values, by entry."""

    ignored: Mapping[Key, tuple[int, ...]]

    def write(self, index: int, subindex: int, data: bytes) -> None:
        values = self.ignored.get((index, subindex), ())
        codec = self.item(index, subindex).codec
        if values and codec is not None and len(data) == codec.size and codec.unpack(data)[0] in values:
            return
        super().write(index, subindex, data)


class QuirkyProfile(StrictProfile):
    """The device profile with the switches of a documented drive."""

    def __init__(self, objects: Any, servo: Any, emergency: Any, switches: Switches) -> None:
        self._switches = switches
        self._sampled: int | None = None  # a controlword that the firmware has not looked at yet
        self._next_look_ns = 0
        self._fault_bit = False
        self._shown_mode = 0
        super().__init__(objects, servo, emergency)

    def _bind(self) -> None:
        super()._bind()
        od, switches = self._od, self._switches
        if switches.error_codes:
            od.on_read(0x603F, 0, lambda: switches.error_codes.get(self.servo.fault_code, self.servo.fault_code))
        if switches.mode_shown_enabled:
            od.on_read(0x6061, 0, lambda: self._shown_mode)
        if switches.homing_methods:
            od.on_write(0x6098, 0, self._check_method)

    def _check_method(self, method: int) -> None:
        known = (*self._switches.homing_methods, *self._switches.homing_ignored)
        if method not in known:
            raise RefusedError(INVALID_VALUE)

    def reset(self) -> None:
        super().reset()
        self._sampled, self._fault_bit, self._shown_mode = None, False, self._mode
        if self._switches.not_ready_at_first:
            self.state = DriveState.NOT_READY

    # -- time ----------------------------------------------------------------------------------------------------------
    def tick(self, now_ns: int) -> None:
        before = self.state
        super().tick(now_ns)
        if self._sampled is not None and now_ns >= self._next_look_ns:
            word, self._sampled = self._sampled, None
            self._take(word)
        stopped = before is DriveState.QUICK_STOP and self.state is DriveState.SWITCH_ON_DISABLED
        if stopped and self._switches.quick_stop_ends == "switched on":
            self.state = DriveState.SWITCHED_ON
        if self.state is DriveState.ENABLED:
            self._shown_mode = self._mode
            if self._switches.acknowledged_until_arrival:
                self._update_acknowledge()

    def due_ns(self) -> int | None:
        """Latest time of the next `tick`, ns; None when nothing is scheduled."""
        return None if self._sampled is None else self._next_look_ns

    # -- statusword ----------------------------------------------------------------------------------------------------
    def _true_statusword(self) -> int:
        word = super()._true_statusword()
        bits = self._switches.statusword_bits
        if self.state is DriveState.QUICK_STOP and not self._switches.quick_stop_shown:
            hidden = state_bits(DriveState.SWITCH_ON_DISABLED)
            word = word & ~(0x6F | QUICK_STOP_OFF) | hidden
        if self._fault_bit:
            word |= FAULT_BIT
        if self.state is DriveState.ENABLED:
            word |= bits.get("enabled", 0)
        if self.state is DriveState.FAULT:
            word |= bits.get("fault", 0)
        return word | bits.get("always", 0)

    def _homing_bits(self) -> int:
        word = super()._homing_bits()
        return word if self._switches.homing_reached or not word & BIT_12 else word & ~REACHED

    # -- controlword ---------------------------------------------------------------------------------------------------
    def _write_controlword(self, word: int) -> None:
        loop_ns = round(self._switches.loop_s * NS_PER_S)
        if loop_ns:
            self._sampled, self._next_look_ns = word, (self._now_ns // loop_ns + 1) * loop_ns
        else:
            self._take(word)

    def _take(self, word: int) -> None:
        if self.state is DriveState.NOT_READY:
            self.state = DriveState.SWITCH_ON_DISABLED
        before = self.state
        super()._write_controlword(word)
        if self._switches.fault_bit_until_shutdown and before is DriveState.FAULT is not self.state:
            self._fault_bit = True

    def _obey(self, command: Command) -> None:
        if command is Command.SHUTDOWN:
            self._fault_bit = False
        resumes = command is Command.ENABLE_OPERATION and self.state is DriveState.QUICK_STOP
        if resumes and self._switches.quick_stop_resumes and not QUICK_STOP_ENDINGS[self._od.number(0x605A)].stays:
            self.servo.power_off()
            self.state = DriveState.ENABLED
            return
        super()._obey(command)

    def _write_mode(self, mode: int) -> None:
        if self._control & HALT and not self._switches.mode_in_halt:
            raise RefusedError(WRONG_STATE)
        super()._write_mode(mode)

    def _update_acknowledge(self) -> None:
        if self._switches.acknowledged_until_arrival and self._mode == PP and not self.servo.target_reached:
            return
        super()._update_acknowledge()


class QuirkyPdoEngine(StrictPdoEngine):
    """PDOs with the rules of a documented drive."""

    def __init__(self, dictionary: Dictionary, send: Any, short_pdo: Any, switches: Switches, emergency: Any) -> None:
        self._switches = switches
        self._emergency = emergency
        super().__init__(dictionary, send, short_pdo)
        self.kinds = frozenset(switches.rpdo_kinds) or None

    def _fixed(self, pdo: Any) -> bool:
        return not self._switches.pdo_switched_off or super()._fixed(pdo)

    def _write_cob_id(self, pdo: Any, value: int) -> None:
        if value & DISABLED and not self._switches.pdo_switched_off:
            raise RefusedError(INVALID_VALUE)
        super()._write_cob_id(pdo, value)

    def _write_count(self, pdo: Any, value: int) -> None:
        if value > self._switches.pdo_entries:
            raise RefusedError(PDO_TOO_LONG)
        super()._write_count(pdo, value)

    def _mapped_item(self, pdo: Any, mapping: int) -> Item:
        if self._checks and self._switches.mapped_once:
            others = (one for one in self._pdos if one is not pdo and one.transmit is pdo.transmit)
            place = (mapping >> 16, mapping >> 8 & 0xFF)
            if any(item.key == place for one in others for item in one.items):
                raise RefusedError(NOT_MAPPABLE)
        return super()._mapped_item(pdo, mapping)

    def _map(self, pdo: Any, mappings: list[int]) -> None:
        if self._checks and self._switches.pdo_mapping == "kept":
            for mapping in mappings:
                self._mapped_item(pdo, mapping)
            return
        super()._map(pdo, mappings)

    def on_frame(self, cob_id: int, data: bytes) -> None:
        if any(len(data) > pdo.codec.size for pdo in self._receivers.get(cob_id, ())):
            self._emergency(LENGTH_EXCEEDED)
            if self._switches.pdo_mapping == "kept":
                return
        super().on_frame(cob_id, data)


class ProfiledSlave(StrictSlave):
    """One node as a documented drive. maker: the objects of a maker's file instead of the profile's own."""

    _dictionary_kind = QuirkyDictionary

    def __init__(
        self,
        servo: SimulatedServo,
        node_id: int,
        send: Send,
        *,
        profile: DriveProfileFile,
        maker: MakerFile | None = None,
        lead_m: float = 0.010,
        **others: Any,
    ) -> None:
        self.switches = profile.switches
        objects = profile.over(maker)
        self._told = profile.units(objects, lead_m)
        self._answers = 0
        super().__init__(servo, node_id, send, maker=objects, lead_m=lead_m, **others)
        for place in self.switches.changing:
            self._let_change(place.key)

    def _let_change(self, key: Key) -> None:
        if key in self.dictionary.items:
            delivered = self.dictionary.number(*key)
            every_ns = CHANGES_EVERY_S * NS_PER_S
            self.dictionary.on_read(*key, lambda: delivered + int(self._now_ns // every_ns) % 100)

    def _made_dictionary(self, eds: Path, own: Mapping[Key, Item]) -> Dictionary:
        dictionary = super()._made_dictionary(eds, own)
        assert isinstance(dictionary, QuirkyDictionary)
        dictionary.ignored = {(0x6098, 0): self.switches.homing_ignored}
        return dictionary

    def _made_profile(self, servo: Any) -> DriveProfile:
        self.units = [self._told]
        moved = QuirkyServo(servo, self._told, self.switches)
        objects = AxisObjects(self.dictionary, 1)  # type: ignore[arg-type]
        return QuirkyProfile(objects, moved, self.emergency, self.switches)

    def _made_pdos(self) -> PdoEngine:
        return QuirkyPdoEngine(self.dictionary, self._transmit, self._on_short_pdo, self.switches, self.emergency)

    def emergency(self, code: int) -> None:
        super().emergency(self.switches.error_codes.get(code, code))

    def due_ns(self) -> int | None:
        profile = self.profile
        times = [super().due_ns(), profile.due_ns() if isinstance(profile, QuirkyProfile) else None]
        return min((time_ns for time_ns in times if time_ns is not None), default=None)

    def on_frame(self, cob_id: int, data: bytes, now_ns: int) -> None:
        if cob_id == 0x600 + self.node_id and len(data) == 8:
            index, subindex = int.from_bytes(data[1:3], "little"), data[3]
            if data[0] >> 5 == 1 and any(place.holds((index, subindex)) for place in self.switches.unanswered):
                return
            self._answers += 1
            every = self.switches.sdo_emergency
            if every and self._answers % every == 0:
                self._transmit(0x80 + self.node_id, bytes((0x00, 0xFF, 0x81, 0, 0, 0, 0, 0)))
        super().on_frame(cob_id, data, now_ns)


def profile_counts(profile: DriveProfileFile, bench: BenchParameters) -> int:
    """Position counts per motor revolution of a drive by a profile on a bench."""
    lead_m = bench.plant.screw.lead_mm / 1000.0
    return round(1.0 / profile.units(profile.over(), lead_m).position_rev)


def machine_objects(profile: DriveProfileFile, bench: BenchParameters) -> dict[Key, int]:
    """Settings of the machine in the drive's own units, as its commissioning tool would leave them, where the profile states no value.

    Encoder and feed, homing, ramps and largest velocity of `BenchParameters.objects`.
    """
    lead_m = bench.plant.screw.lead_mm / 1000.0
    if profile.axis_file.homing_method is not None:
        bench = replace(bench, homing_method=profile.axis_file.homing_method)
    objects = profile.over()
    units = profile.units(objects, lead_m)
    counts = round(1.0 / units.position_rev)
    ramp = max(1, round(bench.servo.max_acceleration_rev_s2 / units.acceleration_rev_s2))
    fastest = round(bench.servo.max_velocity_rev_s / units.velocity_rev_s)
    shown = 1.0 / bench.servo.counts_per_rev / units.position_rev  # the drive's counts per count of the servo
    wanted: dict[Key, int] = {
        (0x608F, 1): counts,
        (0x608F, 2): 1,
        (0x6091, 1): 1,
        (0x6091, 2): 1,
        (0x6092, 1): counts,
        (0x6092, 2): 1,
        (0x60A8, 0): INCREMENTS,
        (0x6065, 0): round(bench.servo.following_window_counts * shown),
        (0x6067, 0): max(1, round(bench.servo.position_window_counts * shown)),
        (0x6083, 0): ramp,
        (0x6084, 0): ramp,
        (0x6085, 0): ramp,
        (0x607F, 0): fastest,
        (0x6080, 0): fastest,
        (0x60C5, 0): ramp,
        (0x60C6, 0): ramp,
        (0x6098, 0): bench.homing_method,
        (0x607C, 0): round(bench.home_counts * shown),
        (0x6099, 1): max(1, round(HOMING_REV_S / units.velocity_rev_s)),
        (0x6099, 2): max(1, round(HOMING_SLOW_REV_S / units.velocity_rev_s)),
    }
    stated = {place.key for place in profile.switches.values}
    items = objects.items(1)
    settings = {}
    for key, value in wanted.items():
        item = items.get(key)
        if item is None or key in stated or not item.writable:
            continue
        settings[key] = value if item.high is None else min(value, item.high)
    return settings
