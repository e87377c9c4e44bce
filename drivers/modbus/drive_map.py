"""The map of a servo drive in Modbus registers: states, transitions, hand-shakes and registers of its values, all as data.

    [drive]                position, velocity, torque, following_error, fault_code: names of registers; identity: a list of those that
                           tell this drive from others
    [[drive.state]]        (register, mask, value) -> a state of `DriveState`; the first rule that fits holds
    [[drive.enable]]       from these states, write this, and the drive must come to those states within timeout_s;
                           [[drive.disable]] and [[drive.reset_fault]] likewise
    [drive.quick_stop]     what to write, in any state; [drive.halt] to stop before switching off
    [drive.move]           hand-shake of a profile move      [drive.homing], with its method and home_position
    [drive.store]  [drive.scaling]
    [drive.stream]         where the drive follows set-points that come cyclically
    [[drive.needs]]        what must hold for the rest to be true: assigned inputs and outputs, modes, where writes are kept
    without_homing         why there is no [drive.homing], where the drive cannot be asked to home
    [drive.correction_table]  the table that the drive holds itself (`drivers.modbus.table_map`)
    [[drive.touch_probe]]  one for each input that latches positions, with [drive.touch_probe.positive] and .negative for its edges

A *condition* is {register, mask, value} or {register, bit, set}, and its value may be a list of which any will do; a *write* is the
same, one with a mask changes those bits only, and after one with pause_s the drive is left alone. Values are raw.
`drivers.modbus.map_loader` reads these from the file and refuses what cannot work together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from typing import Annotated

from drivers.drive import DriveState
from drivers.modbus.codec import Raw
from drivers.modbus.map_facts import Proof
from drivers.modbus.map_roles import (
    Condition,
    ConditionRow,
    Conditions,
    Named,
    SomeConditions,
    SomeWrites,
    Write,
    Writes,
    WriteTable,
    role,
)
from drivers.modbus.register_map import Memory, Register, RegisterMap
from drivers.modbus.table_map import TableBlocks, TableSection, table_blocks
from drivers.toml_schema import Document
from drivers.toml_types import Key, Limits, Positive, SchemaError, Text, Via, not_empty
from drivers.touch_probe import Edge

POSITION_UNITS = ("counts", "rev")
VELOCITY_UNITS = ("counts/s", "rpm", "rev/s")
ACCELERATION_UNITS = ("counts/s2", "rpm/s", "rev/s2", "ms/1000rpm", "ms/3000rpm")
TORQUE_UNITS = ("percent", "permille")


_SHOWN_STATES = [state.value for state in DriveState if state is not DriveState.UNKNOWN]


def _shown_state(state: DriveState, _: Document) -> DriveState:
    if state is DriveState.UNKNOWN:
        raise ValueError
    return state


def _readable(register: Register, _: Document) -> str:
    if not register.readable:
        raise SchemaError("", f"is {register.name!r}, expected registers that can be read")
    return register.name


State = Annotated[DriveState, _shown_state, Limits(description=", ".join(_SHOWN_STATES))]
States = Annotated[tuple[State, ...], not_empty]
Position = Annotated[str, role(POSITION_UNITS)]
Acceleration = Annotated[str, role(ACCELERATION_UNITS, written=True)]
AnyNumber = Annotated[str, role(None)]


@dataclass(frozen=True)
class StateRule:
    """A condition, and the state that it shows."""

    condition: Condition
    state: DriveState


@dataclass(frozen=True, kw_only=True)
class _StateRow(ConditionRow):
    state: State


ShownState = Annotated[StateRule, Via(_StateRow, lambda row, _: StateRule(row.condition(), row.state))]


@dataclass(frozen=True)
class StateChange:
    """From one of these states, after these writes (in this order), the drive comes to one of those."""

    sources: Annotated[States, Key("from")]
    writes: Annotated[SomeWrites, Key("write")]
    targets: Annotated[States, Key("to")]
    timeout_s: Positive = 1.0
    remedy: Text = ""


class Handshake(Enum):
    """Hand-shake for a new target: how it is announced to the drive, and how the drive acknowledges it."""

    SET_POINT_BIT = (
        "set-point bit"  # CiA-402: set the bit, wait for the acknowledge, clear it, wait until that is cleared
    )
    TRIGGER = "trigger"  # write a start register or bit, which the drive clears or answers
    ON_WRITE = "on write"  # writing the target starts the move


_NEEDED = {
    Handshake.SET_POINT_BIT: ("idle", "start", "accepted", "release", "released", "reached"),
    Handshake.TRIGGER: ("start", "reached"),  # without `accepted`, the axis that departs shows that it was taken
    Handshake.ON_WRITE: (),
}


@dataclass(frozen=True)
class MoveMap:
    """A profile move. `window`, in the target register's unit: `reached` counts only this close to the target. Raises SchemaError.

    relative: the target is written as its distance from where the axis stands; the drive knows no other kind.
    limited: the drive limits the move by a limit of its own, of position, velocity or current
    """

    handshake: Handshake
    target: Annotated[str, role(POSITION_UNITS, written=True)]
    velocity: Annotated[str, role(VELOCITY_UNITS, written=True)]
    acceleration: Acceleration | None = None
    deceleration: Acceleration | None = None
    mode: Writes = ()
    mode_shown: Conditions = ()
    idle: Conditions = ()
    start: Writes = ()
    accepted: Conditions = ()
    release: Writes = ()
    released: Conditions = ()
    reached: Conditions = ()
    limited: Conditions = ()
    window: Positive | None = None
    timeout_s: Positive = 0.5
    relative: bool = False

    def __post_init__(self) -> None:
        if self.relative and self.handshake is Handshake.ON_WRITE:
            raise SchemaError(
                "relative", "is true, and a target that starts a move cannot be set to 0 before power comes on"
            )
        for key in _NEEDED[self.handshake]:
            if not getattr(self, key):
                raise SchemaError("", f"lacks {key}, expected a list of tables")
        if self.handshake is Handshake.ON_WRITE and self.window is None:
            raise SchemaError("", "lacks window, which a move started by its target alone is judged by")


@dataclass(frozen=True)
class HomingMap:
    """The drive's own homing. `attained` and `failed` are valid only while `applies` holds (an empty one always does).

    method, home_position: the registers that define the zero, where the map names them; makers_method: the numbers of `method` are
    the maker's own, not those of CiA 402
    at_power_on: the drive homes as its power comes on: it is taken off, then `start` arms the homing and switches on
    remedy: what to look at where the homing is not taken up
    """

    start: SomeWrites
    attained: SomeConditions
    mode: Writes = ()
    mode_shown: Conditions = ()
    accepted: Conditions = ()
    release: Writes = ()
    applies: Conditions = ()
    failed: Conditions = ()
    timeout_s: Positive = 0.5
    method: AnyNumber | None = None
    home_position: Position | None = None
    makers_method: bool = False
    at_power_on: bool = False
    remedy: Text = ""


@dataclass(frozen=True)
class Need:
    """What must hold for the rest of the map to be true of a drive.

    write: makes it hold while the axis is enabled, and is put back afterwards; None: only the user may change it, by `remedy`.
    """

    condition: Condition
    why: str
    remedy: str = ""
    write: Write | None = None


@dataclass(frozen=True, kw_only=True)
class _NeedRow(ConditionRow):
    why: Text
    remedy: Text = ""
    by_us: bool = False

    def need(self) -> Need:
        condition = self.condition()
        if not self.by_us:
            return Need(condition, self.why, self.remedy)
        if not self.register.writable or self.register.memory is Memory.EEPROM or condition.negate:
            raise SchemaError("by_us", f"is for a value that can be written to RAM, {self.register.name} cannot")
        return Need(condition, self.why, self.remedy, Write(condition.register, condition.mask, condition.values[0]))


Needs = tuple[Annotated[Need, Via(_NeedRow, lambda row, _: row.need())], ...]


@dataclass(frozen=True)
class StreamMap:
    """A set-point register that the drive follows as it is written, cycle by cycle, no faster than least_period_s."""

    target: Annotated[str, role(POSITION_UNITS, written=True, signed=True)]
    least_period_s: Positive
    mode: Writes = ()
    mode_shown: Conditions = ()
    start: Writes = ()
    timeout_s: Positive = 0.5


@dataclass(frozen=True)
class EdgeMap:
    """One edge of a probe: the writes that select it before `on`, the condition that shows a latch, and the registers of its
    values."""

    latched: SomeConditions
    position: Position
    arm: Writes = ()
    stamp: AnyNumber | None = None
    count: AnyNumber | None = None


@dataclass(frozen=True)
class ProbeMap:
    """One probe input: `off` discards edges and latches, then edges, `continuous` where every edge is wanted, and `on`."""

    number: Annotated[int, Limits(ge=1, le=16, description="the number of the input, 1 to 16")]
    off: SomeWrites
    on: SomeWrites
    positive: EdgeMap | None = None
    negative: EdgeMap | None = None
    continuous: Writes = ()
    armed: Conditions = ()

    def __post_init__(self) -> None:
        if not self.edges:
            raise SchemaError("", "lacks positive and negative, expected at least one edge")

    @property
    def edges(self) -> Mapping[Edge, EdgeMap]:
        both = {Edge.POSITIVE: self.positive, Edge.NEGATIVE: self.negative}
        return {edge: found for edge, found in both.items() if found is not None}


@dataclass(frozen=True)
class StoreMap:
    """Saving parameters to the drive's own memory."""

    writes: Annotated[SomeWrites, Key("write")]
    done: Conditions = ()
    timeout_s: Positive = 5.0


@dataclass(frozen=True)
class Ratio:
    """A number of the drive: constant, or one register over another, times a whole number."""

    constant: Fraction | None
    register: str | None = None
    per: str | None = None
    times: int = 1


@dataclass(frozen=True)
class _RatioRow:
    register: AnyNumber
    per: AnyNumber | None = None
    times: Annotated[int, Limits(ge=1, le=2**40, description="a whole number > 0")] = 1


def _ratio(value: float | _RatioRow, _: Document) -> Ratio:
    if isinstance(value, _RatioRow):
        return Ratio(None, value.register, value.per, value.times)
    return Ratio(Fraction(str(value)))


Stated = Annotated[Ratio | None, Via(Positive | _RatioRow, _ratio, "a number > 0, or {register, per, times}")]


@dataclass(frozen=True)
class ScalingMap:
    """The drive's own units; None where it does not state them."""

    encoder_counts_per_motor_rev: Stated = None
    motor_revs_per_shaft_rev: Stated = None
    feed_mm_per_shaft_rev: Stated = None


@dataclass(frozen=True)
class DriveMap:
    """A drive model as a servo drive."""

    registers: Annotated[RegisterMap, Key("")]
    position: Position
    states: Annotated[tuple[ShownState, ...], Key("state"), not_empty]
    enable: Annotated[tuple[StateChange, ...], not_empty]
    disable: Annotated[tuple[StateChange, ...], not_empty]
    reset_fault: Annotated[tuple[StateChange, ...], not_empty]
    quick_stop: WriteTable
    halt: WriteTable
    move: MoveMap
    velocity: Annotated[str, role(VELOCITY_UNITS)] | None = None
    torque: Annotated[str, role(TORQUE_UNITS)] | None = None
    following_error: Position | None = None
    fault_code: AnyNumber | None = None
    homing: HomingMap | None = None
    stream: StreamMap | None = None
    probes: Annotated[tuple[ProbeMap, ...], Key("touch_probe")] = ()
    store: StoreMap | None = None
    scaling: ScalingMap = ScalingMap()
    table: Annotated[TableBlocks | None, Key("correction_table"), Via(TableSection, table_blocks)] = None
    identity: tuple[Annotated[str, Via(Named, _readable)], ...] = ()
    needs: Needs = ()
    without_homing: Text = ""

    def __post_init__(self) -> None:
        if len({probe.number for probe in self.probes}) != len(self.probes):
            raise SchemaError("touch_probe", "has two probes of one number")

    @property
    def state_registers(self) -> tuple[str, ...]:
        """Names of the registers that show the state."""
        return tuple(dict.fromkeys(rule.condition.register for rule in self.states))

    def state_of(self, raw: Mapping[str, Raw]) -> DriveState:
        """The state of the first rule that fits; UNKNOWN where none does."""
        for rule in self.states:
            value = raw[rule.condition.register]
            if isinstance(value, int) and rule.condition.holds(value):
                return rule.state
        return DriveState.UNKNOWN

    def sampled(self) -> tuple[str, ...]:
        """Names of all registers that one sample needs."""
        names = [
            self.position,
            self.velocity,
            self.torque,
            self.following_error,
            self.fault_code,
            *self.state_registers,
        ]
        conditions = [*self.move.reached, *self.move.limited, *self.move.mode_shown]
        if self.homing is not None:
            conditions += [*self.homing.applies, *self.homing.attained, *self.homing.failed]
        names += [condition.register for condition in conditions]
        return tuple(dict.fromkeys(name for name in names if name is not None))

    def weak(self) -> Mapping[Proof, tuple[str, ...]]:
        """What has to be proven on the drive before it is used, in sentences, by what proves it; empty where nothing has to."""
        found: dict[Proof, list[str]] = {}
        for fact in self.registers.facts:
            if fact.strength.is_weak:
                found.setdefault(fact.proof, []).append(f"{fact.about}: {fact.says} ({fact.strength.value})")
        told: set[str] = set()
        for proof, names in self._used().items():
            for name in dict.fromkeys(names):
                register = self.registers[name]
                if register.origin.strength.is_weak and name not in told:
                    told.add(name)
                    place = f"{register.table.value} {register.span.start:#06x}"
                    found.setdefault(proof, []).append(f"{name} at {place} ({register.origin.strength.value})")
        return {proof: tuple(each) for proof, each in found.items()}

    def _used(self) -> Mapping[Proof, list[str]]:
        """Names of registers by what proves them."""
        powered = [*self.enable, *self.disable]
        move = self.move
        moved = [self.position, self.velocity, move.target, move.velocity, move.acceleration, move.deceleration]
        asked = [*move.idle, *move.accepted, *move.released, *move.reached, *move.limited, *move.mode_shown]
        orders = [*move.mode, *move.start, *move.release]
        homing: list[str | None] = []
        if self.homing is not None:
            homing = [write.register for write in self.homing.start]
            homing += [each.register for each in (*self.homing.attained, *self.homing.applies)]
            homing += [self.homing.method, self.homing.home_position]
        used: dict[Proof, list[str | None]] = {
            Proof.READING: [need.condition.register for need in self.needs],
            Proof.ENABLING: [
                *self.state_registers,
                *(write.register for transition in powered for write in transition.writes),
            ],
            Proof.MOVE: [*moved, *(each.register for each in asked), *(each.register for each in orders)],
            Proof.STOP: [write.register for write in (*self.quick_stop, *self.halt)],
            Proof.HOMING: homing,
        }
        return {proof: [name for name in names if name is not None] for proof, names in used.items()}

    def wide(self) -> tuple[str, ...]:
        """Names of the registers of two or more words that decide where and how fast the axis moves."""
        move = self.move
        names = [self.position, self.velocity, self.following_error, move.target]
        names += [move.velocity, move.acceleration, move.deceleration]
        known = dict.fromkeys(name for name in names if name is not None)
        return tuple(name for name in known if self.registers[name].layout.type.words > 1)

    @property
    def speed_is_narrow(self) -> bool:
        """Whether speed or ramp of a move is one word: then no wrong word order makes a first slow move fast."""
        move = self.move
        names = [name for name in (move.velocity, move.acceleration) if name is not None]
        return any(self.registers[name].layout.type.words == 1 for name in names)

    def moving(self) -> frozenset[str]:
        """Names of all registers that commands, targets, modes and the correction table write; no parameters."""
        writes = [*self.quick_stop, *self.halt, *self.move.mode, *self.move.start, *self.move.release]
        for transition in (*self.enable, *self.disable, *self.reset_fault):
            writes += transition.writes
        targets = {self.move.target}
        if self.homing is not None:
            writes += [*self.homing.mode, *self.homing.start, *self.homing.release]
        if self.stream is not None:
            writes += [*self.stream.mode, *self.stream.start]
            targets.add(self.stream.target)
        for probe in self.probes:
            writes += [*probe.off, *probe.on, *probe.continuous]
            for edge in probe.edges.values():
                writes += edge.arm
        if self.store is not None:
            writes += self.store.writes
        if self.table is not None:  # changed as a whole, by itself
            targets |= self.table.names()
        return frozenset({write.register for write in writes} | targets)


def all_hold(conditions: tuple[Condition, ...], raw: Mapping[str, int]) -> bool:
    """Whether every condition holds for these raw values, by register."""
    return all(condition.holds(raw[condition.register]) for condition in conditions)


def leads_to_enabled(transitions: tuple[StateChange, ...], state: DriveState) -> bool:
    """Whether the transitions have a way from the state to ENABLED."""
    seen: set[DriveState] = set()
    open_states = {state}
    while open_states:
        state = open_states.pop()
        if state is DriveState.ENABLED:
            return True
        seen.add(state)
        for transition in transitions:
            if state in transition.sources:
                open_states |= set(transition.targets) - seen
    return False
