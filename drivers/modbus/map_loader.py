"""Reads the [drive] part of a register map, and refuses what cannot work before it meets a machine.

Refused with file, line and key: names of registers that do not exist, reading what is write-only and writing what is read-only,
units a role cannot have, states that no rule shows or that lead nowhere, a fault that enabling would leave, motion kept in EEPROM.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

from drivers.drive import DriveState
from drivers.modbus.codec import RegisterType
from drivers.modbus.drive_map import (
    ACCELERATION_UNITS,
    FAULTS,
    POSITION_UNITS,
    TORQUE_UNITS,
    VELOCITY_UNITS,
    Condition,
    DriveMap,
    Handshake,
    HomingMap,
    MoveMap,
    Ratio,
    ScalingMap,
    StateRule,
    StoreMap,
    Transition,
    Write,
    leads_to_enabled,
)
from drivers.modbus.map_reader import Document, Section, positive, text, whole
from drivers.modbus.register_map import Memory, Register, RegisterMap, find_map, parse_registers


def load_drive_map(name_or_path: str | Path) -> DriveMap:
    """Read a register map with its [drive] part; a shipped one by name. Raises InputError naming file, line and key."""
    document = Document.read(find_map(name_or_path))
    root = document.root()
    registers = parse_registers(document, root)
    drive = _Parser(document, registers).drive(root.child("drive"))
    root.finish()
    return drive


def load_register_map(name_or_path: str | Path) -> RegisterMap:
    """Read [map] and [registers] of a file; its [drive] part, where there is one, is checked too."""
    document = Document.read(find_map(name_or_path))
    root = document.root()
    registers = parse_registers(document, root)
    if "drive" in root:
        _Parser(document, registers).drive(root.child("drive"))
    root.finish()
    return registers


class _Parser:
    """Reads [drive] against the registers it speaks of."""

    def __init__(self, document: Document, registers: RegisterMap) -> None:
        self._document = document
        self._registers = registers

    def drive(self, section: Section) -> DriveMap:
        drive = DriveMap(
            registers=self._registers,
            position=self._role(section, "position", POSITION_UNITS),
            velocity=self._optional_role(section, "velocity", VELOCITY_UNITS),
            torque=self._optional_role(section, "torque", TORQUE_UNITS),
            following_error=self._optional_role(section, "following_error", POSITION_UNITS),
            fault_code=self._optional_role(section, "fault_code", None),
            states=tuple(self._state_rule(each) for each in section.children("state")),
            enable=self._transitions(section, "enable"),
            disable=self._transitions(section, "disable"),
            reset_fault=self._transitions(section, "reset_fault"),
            quick_stop=self._writes_of(section, "quick_stop"),
            halt=self._writes_of(section, "halt"),
            move=self._move(section.child("move")),
            homing=self._homing(section.child("homing")) if "homing" in section else None,
            store=self._store(section.child("store")) if "store" in section else None,
            scaling=self._scaling(section.child("scaling", required=False)),
        )
        section.finish()
        self._check_states(drive)
        return drive

    # -- roles -------------------------------------------------------------------------------------------------------
    def _register(self, section: Section, key: str) -> Register:
        name = section.take(key, text, "the name of a register")
        if name not in self._registers.registers:
            raise section.fail(key, f"is {name!r}, expected the name of a register in [registers]")
        return self._registers.registers[name]

    def _checked(self, section: Section, key: str, register: Register, units: tuple[str, ...] | None) -> str:
        if units is not None and register.unit not in units:
            raise section.fail(
                key, f"is {register.name!r} in {register.unit or 'no unit'!r}, expected a unit of {', '.join(units)}"
            )
        if register.layout.type in (RegisterType.STRING, RegisterType.BIT):
            raise section.fail(key, f"is {register.name!r} of type {register.layout.type.value}, expected a number")
        return register.name

    def _role(self, section: Section, key: str, units: tuple[str, ...] | None, *, written: bool = False) -> str:
        register = self._register(section, key)
        if written and not register.writable:
            raise section.fail(key, f"is {register.name!r}, which is read only")
        if not written and not register.readable:
            raise section.fail(key, f"is {register.name!r}, which is write only")
        if written and register.memory is Memory.EEPROM:
            raise section.fail(key, f"is {register.name!r}, which is kept in EEPROM; motion would wear it out")
        return self._checked(section, key, register, units)

    def _optional_role(
        self, section: Section, key: str, units: tuple[str, ...] | None, *, written: bool = False
    ) -> str | None:
        return self._role(section, key, units, written=written) if key in section else None

    # -- conditions and writes -----------------------------------------------------------------------------------------
    def _masked(
        self, section: Section, *, value_key: str = "value", writing: bool = False
    ) -> tuple[Register, int | None, int]:
        register = self._register(section, "register")
        if writing and not register.writable:
            raise section.fail("register", f"is {register.name!r}, which is read only")
        if not writing and not register.readable:
            raise section.fail("register", f"is {register.name!r}, which is write only")
        if not register.layout.type.is_integer:
            raise section.fail(
                "register", f"is {register.name!r} of type {register.layout.type.value}, no whole number"
            )
        if writing and register.memory is Memory.EEPROM:
            raise section.fail("register", f"is {register.name!r}, which is kept in EEPROM; commands would wear it out")
        low, high = register.layout.type.bounds
        if "bit" in section:
            bit = section.take("bit", text, "the name of a bit")
            if bit not in register.bits:
                names = ", ".join(register.bits) or "none"
                raise section.fail("bit", f"is {bit!r}, expected a bit of {register.name} ({names})")
            mask = 1 << register.bits[bit]
            value = mask * section.take("set", whole(0, 1), "0 or 1", 1)
            return register, mask, value
        masked = section.take("mask", whole(1, (1 << 64) - 1), "a mask", None)
        value = section.take(value_key, whole(low, high), f"a whole number {low} to {high}")
        if masked is not None and (masked & ~high or low < 0):
            raise section.fail(
                "mask", f"is {masked:#x}, which does not fit {register.name} ({register.layout.type.value})"
            )
        if masked is not None and value & ~masked:
            raise section.fail(value_key, f"is {value:#x}, which has bits outside the mask {masked:#x}")
        if masked is not None and writing and not register.readable:
            raise section.fail("mask", f"needs {register.name} to be readable, to keep its other bits")
        return register, masked, value

    def _condition(self, section: Section) -> Condition:
        negate = "not_value" in section
        register, mask, value = self._masked(section, value_key="not_value" if negate else "value")
        section.finish()
        return Condition(register.name, mask, value, negate)

    def _conditions(self, section: Section, key: str, *, required: bool = False) -> tuple[Condition, ...]:
        return tuple(self._condition(each) for each in section.children(key, required=required))

    def _write(self, section: Section) -> Write:
        register, mask, value = self._masked(section, writing=True)
        section.finish()
        return Write(register.name, mask, value)

    def _writes(self, section: Section, key: str, *, required: bool = False) -> tuple[Write, ...]:
        return tuple(self._write(each) for each in section.children(key, required=required))

    def _writes_of(self, section: Section, key: str) -> tuple[Write, ...]:
        child = section.child(key)
        writes = self._writes(child, "write", required=True)
        child.finish()
        return writes

    # -- states --------------------------------------------------------------------------------------------------------
    def _state_rule(self, section: Section) -> StateRule:
        state = section.take("state", _state, _STATES)
        return StateRule(self._condition(section), state)

    def _transitions(self, section: Section, key: str) -> tuple[Transition, ...]:
        transitions: list[Transition] = []
        for each in section.children(key):
            transitions.append(
                Transition(
                    each.take("from", _states, f"a list of states ({_STATES})"),
                    self._writes(each, "write", required=True),
                    each.take("to", _states, f"a list of states ({_STATES})"),
                    each.take("timeout_s", positive, "seconds > 0", 1.0),
                )
            )
            each.finish()
        return tuple(transitions)

    def _check_states(self, drive: DriveMap) -> None:
        """States the drive cannot be seen in, or transitions that lead nowhere, are found here and not at the machine."""
        shown = {rule.state for rule in drive.states}
        for needed in (DriveState.ENABLED, DriveState.FAULT):
            if needed not in shown:
                raise self._document.fail("drive.state", f"has no rule for {needed.value!r}")
        for key in ("enable", "disable", "reset_fault"):
            self._check_transitions(key, getattr(drive, key), shown)
        for state in DriveState:
            passing = state in (
                DriveState.ENABLED,
                DriveState.NOT_READY,
                *FAULTS,
            )  # left by the drive itself, or on purpose
            if state in shown and not passing and not leads_to_enabled(drive.enable, state):
                raise self._document.fail("drive.enable", f"has no way from {state.value!r} to operation enabled")
        if not any(DriveState.ENABLED in transition.sources for transition in drive.disable):
            raise self._document.fail("drive.disable", "has no way out of operation enabled")

    def _check_transitions(self, key: str, transitions: tuple[Transition, ...], shown: set[DriveState]) -> None:
        for index, transition in enumerate(transitions):
            place = f"drive.{key}[{index}]"
            for state in (*transition.sources, *transition.targets):
                if state not in shown:
                    raise self._document.fail(place, f"speaks of {state.value!r}, which no rule in drive.state shows")
            if key == "enable" and any(fault in transition.sources for fault in FAULTS):
                raise self._document.fail(place, "starts from a fault state; a fault is reset on purpose")
            if key == "reset_fault" and DriveState.ENABLED in transition.targets:
                raise self._document.fail(place, "ends enabled; a reset leaves the axis disabled")

    # -- motion --------------------------------------------------------------------------------------------------------
    def _move(self, section: Section) -> MoveMap:
        handshake = section.take("handshake", Handshake, " or ".join(each.value for each in Handshake))
        bit = handshake is Handshake.SET_POINT_BIT
        triggered = handshake is not Handshake.ON_WRITE
        move = MoveMap(
            handshake=handshake,
            target=self._role(section, "target", POSITION_UNITS, written=True),
            velocity=self._role(section, "velocity", VELOCITY_UNITS, written=True),
            acceleration=self._optional_role(section, "acceleration", ACCELERATION_UNITS, written=True),
            deceleration=self._optional_role(section, "deceleration", ACCELERATION_UNITS, written=True),
            mode=self._writes(section, "mode"),
            mode_shown=self._conditions(section, "mode_shown"),
            idle=self._conditions(section, "idle", required=bit),
            start=self._writes(section, "start", required=triggered),
            accepted=self._conditions(section, "accepted", required=triggered),
            release=self._writes(section, "release", required=bit),
            released=self._conditions(section, "released", required=bit),
            reached=self._conditions(section, "reached", required=triggered),
            window=section.take("window", positive, "a number > 0 in the target's unit", None),
            timeout_s=section.take("timeout_s", positive, "seconds > 0", 0.5),
        )
        if not triggered and move.window is None:
            raise self._document.fail(
                section.place, "lacks window, which a move started by its target alone is judged by"
            )
        section.finish()
        return move

    def _homing(self, section: Section) -> HomingMap:
        homing = HomingMap(
            mode=self._writes(section, "mode"),
            mode_shown=self._conditions(section, "mode_shown"),
            start=self._writes(section, "start", required=True),
            accepted=self._conditions(section, "accepted"),
            release=self._writes(section, "release"),
            applies=self._conditions(section, "applies"),
            attained=self._conditions(section, "attained", required=True),
            failed=self._conditions(section, "failed"),
            timeout_s=section.take("timeout_s", positive, "seconds > 0", 0.5),
        )
        section.finish()
        return homing

    def _store(self, section: Section) -> StoreMap:
        store = StoreMap(
            self._writes(section, "write", required=True),
            self._conditions(section, "done"),
            section.take("timeout_s", positive, "seconds > 0", 5.0),
        )
        section.finish()
        return store

    # -- units ---------------------------------------------------------------------------------------------------------
    def _scaling(self, section: Section) -> ScalingMap:
        scaling = ScalingMap(
            self._ratio(section, "encoder_counts_per_motor_rev"),
            self._ratio(section, "motor_revs_per_shaft_rev"),
            self._ratio(section, "feed_mm_per_shaft_rev"),
        )
        section.finish()
        return scaling

    def _ratio(self, section: Section, key: str) -> Ratio | None:
        if key not in section:
            return None
        if not section.holds_table(key):
            return Ratio(Fraction(str(section.take(key, positive, "a number > 0, or {register, per}"))))
        child = section.child(key)
        ratio = Ratio(None, self._role(child, "register", None), self._optional_role(child, "per", None))
        child.finish()
        return ratio


_STATES = ", ".join(state.value for state in DriveState if state is not DriveState.UNKNOWN)


def _state(value: Any) -> DriveState:
    state = DriveState(value)
    if state is DriveState.UNKNOWN:
        raise ValueError
    return state


def _states(value: Any) -> tuple[DriveState, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError
    return tuple(_state(item) for item in value)
