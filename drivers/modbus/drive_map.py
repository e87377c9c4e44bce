"""What makes registers a servo drive: states, transitions, hand-shakes and the places of its values, all as data.

    [drive]                position, velocity, torque, following_error, fault_code: names of registers; identity: a list of those that
                           tell this drive from others
    [[drive.state]]        (register, mask, value) -> a state of `DriveState`; the first rule that fits holds
    [[drive.enable]]       from these states, write this, and the drive must come to those states within timeout_s;
                           [[drive.disable]] and [[drive.reset_fault]] likewise
    [drive.quick_stop]     what to write, whatever the state; [drive.halt] to stop before switching off
    [drive.move]           hand-shake of a profile move      [drive.homing], with its method and home_position
    [drive.store]  [drive.scaling]
    [drive.run]            where the drive runs at a velocity   [drive.stream]  where it follows set-points that come cyclically
    [drive.correction_table]  the table that the drive holds itself (`drivers.modbus.table_map`)
    [[drive.touch_probe]]  one for each input that latches positions, with [drive.touch_probe.positive] and .negative for its edges

A *condition* is {register, mask, value} or {register, bit, set}; a *write* is the same, and one with a mask changes those bits only.
Values are raw. `drivers.modbus.map_loader` reads these from the file and refuses what cannot work.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction

from drivers.drive import DriveState
from drivers.modbus.register_map import RegisterMap
from drivers.modbus.table_map import TableBlocks
from drivers.touch_probe import Edge

FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION)
POSITION_UNITS = ("counts", "rev")
VELOCITY_UNITS = ("counts/s", "rpm", "rev/s")
ACCELERATION_UNITS = ("counts/s2", "rpm/s", "rev/s2")
TORQUE_UNITS = ("percent", "permille")


@dataclass(frozen=True)
class Condition:
    """Holds when (raw & mask) == value; mask None means the whole value. `negate` turns it round."""

    register: str
    mask: int | None
    value: int
    negate: bool = False

    def holds(self, raw: int) -> bool:
        seen = raw if self.mask is None else raw & self.mask
        return (seen == self.value) is not self.negate


@dataclass(frozen=True)
class Write:
    """Write the raw value; with a mask, only the bits of the mask."""

    register: str
    mask: int | None
    value: int


@dataclass(frozen=True)
class StateRule:
    condition: Condition
    state: DriveState


@dataclass(frozen=True)
class Transition:
    """From one of these states, after these writes (in this order), the drive comes to one of those."""

    sources: tuple[DriveState, ...]
    writes: tuple[Write, ...]
    targets: tuple[DriveState, ...]
    timeout_s: float


class Handshake(Enum):
    """How a drive learns that a new target is to be taken, and says that it has been."""

    SET_POINT_BIT = "set-point bit"  # CiA-402: raise the bit, see the acknowledge, take it back, see that gone
    TRIGGER = "trigger"  # write a start register or bit, which the drive takes back or answers
    ON_WRITE = "on write"  # writing the target starts the move


@dataclass(frozen=True)
class MoveMap:
    """A profile move. `window` is in the target register's unit: `reached` is believed only that close to the target."""

    handshake: Handshake
    target: str
    velocity: str
    acceleration: str | None
    deceleration: str | None
    mode: tuple[Write, ...]
    mode_shown: tuple[Condition, ...]
    idle: tuple[Condition, ...]
    start: tuple[Write, ...]
    accepted: tuple[Condition, ...]
    release: tuple[Write, ...]
    released: tuple[Condition, ...]
    reached: tuple[Condition, ...]
    window: float | None
    timeout_s: float


@dataclass(frozen=True)
class HomingMap:
    """The drive's own homing. `attained` and `failed` mean something only while `applies` holds (an empty one always does).

    method, home_position: the registers that decide what becomes the zero, where the map names them
    """

    mode: tuple[Write, ...]
    mode_shown: tuple[Condition, ...]
    start: tuple[Write, ...]
    accepted: tuple[Condition, ...]
    release: tuple[Write, ...]
    applies: tuple[Condition, ...]
    attained: tuple[Condition, ...]
    failed: tuple[Condition, ...]
    timeout_s: float
    method: str | None = None
    home_position: str | None = None


@dataclass(frozen=True)
class RunMap:
    """Profile velocity: the (signed) target is followed from when the mode is shown, after `start` where that is needed."""

    target: str
    acceleration: str | None
    deceleration: str | None
    mode: tuple[Write, ...]
    mode_shown: tuple[Condition, ...]
    start: tuple[Write, ...]
    timeout_s: float


@dataclass(frozen=True)
class StreamMap:
    """A set-point register that the drive follows as it is written, cycle by cycle, no faster than least_period_s."""

    target: str
    mode: tuple[Write, ...]
    mode_shown: tuple[Condition, ...]
    start: tuple[Write, ...]
    least_period_s: float
    timeout_s: float


@dataclass(frozen=True)
class EdgeMap:
    """One edge of a probe: written before `on` to have it latched, shown as latched by, and where its values stand."""

    arm: tuple[Write, ...]
    latched: tuple[Condition, ...]
    position: str
    stamp: str | None
    count: str | None


@dataclass(frozen=True)
class ProbeMap:
    """One probe input: `off` forgets edges and latches, then edges, `continuous` where every edge is wanted, and `on`."""

    number: int
    off: tuple[Write, ...]
    on: tuple[Write, ...]
    continuous: tuple[Write, ...]
    armed: tuple[Condition, ...]
    edges: Mapping[Edge, EdgeMap]


@dataclass(frozen=True)
class StoreMap:
    """Saving parameters to the drive's own memory."""

    writes: tuple[Write, ...]
    done: tuple[Condition, ...]
    timeout_s: float


@dataclass(frozen=True)
class Ratio:
    """A number of the drive: constant, or one register over another."""

    constant: Fraction | None
    register: str | None = None
    per: str | None = None


@dataclass(frozen=True)
class ScalingMap:
    """Where the drive states its own units; None where it does not."""

    encoder_counts_per_motor_rev: Ratio | None
    motor_revs_per_shaft_rev: Ratio | None
    feed_mm_per_shaft_rev: Ratio | None


@dataclass(frozen=True)
class DriveMap:
    """A drive model as a servo drive."""

    registers: RegisterMap
    position: str
    velocity: str | None
    torque: str | None
    following_error: str | None
    fault_code: str | None
    states: tuple[StateRule, ...]
    enable: tuple[Transition, ...]
    disable: tuple[Transition, ...]
    reset_fault: tuple[Transition, ...]
    quick_stop: tuple[Write, ...]
    halt: tuple[Write, ...]
    move: MoveMap
    homing: HomingMap | None
    run: RunMap | None
    stream: StreamMap | None
    probes: tuple[ProbeMap, ...]
    store: StoreMap | None
    scaling: ScalingMap
    table: TableBlocks | None = None
    identity: tuple[str, ...] = ()

    def sampled(self) -> tuple[str, ...]:
        """Names of all registers that one sample needs."""
        names = [self.position, self.velocity, self.torque, self.following_error, self.fault_code]
        conditions = [rule.condition for rule in self.states] + list(self.move.reached) + list(self.move.mode_shown)
        if self.homing is not None:
            conditions += [*self.homing.applies, *self.homing.attained, *self.homing.failed]
        names += [condition.register for condition in conditions]
        return tuple(dict.fromkeys(name for name in names if name is not None))

    def moving(self) -> frozenset[str]:
        """Names of all registers that commands, targets, modes and the correction table write; no parameters."""
        writes = [*self.quick_stop, *self.halt, *self.move.mode, *self.move.start, *self.move.release]
        for transition in (*self.enable, *self.disable, *self.reset_fault):
            writes += transition.writes
        targets = {self.move.target}
        if self.homing is not None:
            writes += [*self.homing.mode, *self.homing.start, *self.homing.release]
        for cyclic in (self.run, self.stream):
            if cyclic is not None:
                writes += [*cyclic.mode, *cyclic.start]
                targets.add(cyclic.target)
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
    """True when every condition holds for these raw values, by register."""
    return all(condition.holds(raw[condition.register]) for condition in conditions)


def leads_to_enabled(transitions: tuple[Transition, ...], state: DriveState) -> bool:
    """True when the transitions have a way from the state to ENABLED."""
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
