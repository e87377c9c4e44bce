"""Reads the [drive] part of a register map, and refuses what cannot work before it meets a machine.

Refused with file, line and key: names of registers that do not exist, reading what is write-only and writing what is read-only,
units a role cannot have, states that no rule shows or that lead nowhere, a fault that enabling would leave, motion kept in EEPROM.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

from drivers.drive import DriveState
from drivers.modbus.drive_map import (
    ACCELERATION_UNITS,
    FAULTS,
    POSITION_UNITS,
    TORQUE_UNITS,
    VELOCITY_UNITS,
    DriveMap,
    EdgeMap,
    Handshake,
    HomingMap,
    MoveMap,
    ProbeMap,
    Ratio,
    RunMap,
    ScalingMap,
    StateRule,
    StoreMap,
    StreamMap,
    Transition,
    leads_to_enabled,
)
from drivers.modbus.map_roles import RoleReader
from drivers.modbus.register_map import RegisterMap, find_map, parse_registers
from drivers.modbus.table_map import TableBlocks
from drivers.modbus.table_reader import TableReader
from drivers.strict_toml import Document, Section, positive, whole
from drivers.touch_probe import Edge


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


class _Parser(RoleReader):
    """Reads [drive] against the registers it speaks of."""

    def drive(self, section: Section) -> DriveMap:
        drive = DriveMap(
            registers=self.registers,
            position=self.role(section, "position", POSITION_UNITS),
            velocity=self.optional_role(section, "velocity", VELOCITY_UNITS),
            torque=self.optional_role(section, "torque", TORQUE_UNITS),
            following_error=self.optional_role(section, "following_error", POSITION_UNITS),
            fault_code=self.optional_role(section, "fault_code", None),
            states=tuple(self._state_rule(each) for each in section.children("state")),
            enable=self._transitions(section, "enable"),
            disable=self._transitions(section, "disable"),
            reset_fault=self._transitions(section, "reset_fault"),
            quick_stop=self.writes_of(section, "quick_stop"),
            halt=self.writes_of(section, "halt"),
            move=self._move(section.child("move")),
            homing=self._homing(section.child("homing")) if "homing" in section else None,
            run=self._run(section.child("run")) if "run" in section else None,
            stream=self._stream(section.child("stream")) if "stream" in section else None,
            probes=self._probes(section),
            store=self._store(section.child("store")) if "store" in section else None,
            scaling=self._scaling(section.child("scaling", required=False)),
            table=self._table(section.child("correction_table")) if "correction_table" in section else None,
            identity=self._identity(section),
        )
        section.finish()
        self._check_states(drive)
        if drive.run is not None and drive.velocity is None:
            raise self.document.fail("drive.run", "needs drive.velocity, which says when a run has to be stopped")
        return drive

    def _identity(self, section: Section) -> tuple[str, ...]:
        names = section.take("identity", _names, "a list of registers' names", ())
        for name in names:
            if name not in self.registers.registers or not self.registers[name].readable:
                raise section.fail("identity", f"names {name!r}, expected registers that can be read")
        return names

    def _table(self, section: Section) -> TableBlocks:
        return TableReader(self.document, self.registers).read(section)

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
                    self.writes(each, "write", required=True),
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
                raise self.document.fail("drive.state", f"has no rule for {needed.value!r}")
        for key in ("enable", "disable", "reset_fault"):
            self._check_transitions(key, getattr(drive, key), shown)
        for state in DriveState:
            passing = state in (
                DriveState.ENABLED,
                DriveState.NOT_READY,
                *FAULTS,
            )  # left by the drive itself, or on purpose
            if state in shown and not passing and not leads_to_enabled(drive.enable, state):
                raise self.document.fail("drive.enable", f"has no way from {state.value!r} to operation enabled")
        if not any(DriveState.ENABLED in transition.sources for transition in drive.disable):
            raise self.document.fail("drive.disable", "has no way out of operation enabled")

    def _check_transitions(self, key: str, transitions: tuple[Transition, ...], shown: set[DriveState]) -> None:
        for index, transition in enumerate(transitions):
            place = f"drive.{key}[{index}]"
            for state in (*transition.sources, *transition.targets):
                if state not in shown:
                    raise self.document.fail(place, f"speaks of {state.value!r}, which no rule in drive.state shows")
            if key == "enable" and any(fault in transition.sources for fault in FAULTS):
                raise self.document.fail(place, "starts from a fault state; a fault is reset on purpose")
            if key == "reset_fault" and DriveState.ENABLED in transition.targets:
                raise self.document.fail(place, "ends enabled; a reset leaves the axis disabled")

    # -- motion --------------------------------------------------------------------------------------------------------
    def _move(self, section: Section) -> MoveMap:
        handshake = section.take("handshake", Handshake, " or ".join(each.value for each in Handshake))
        bit = handshake is Handshake.SET_POINT_BIT
        triggered = handshake is not Handshake.ON_WRITE
        move = MoveMap(
            handshake=handshake,
            target=self.role(section, "target", POSITION_UNITS, written=True),
            velocity=self.role(section, "velocity", VELOCITY_UNITS, written=True),
            acceleration=self.optional_role(section, "acceleration", ACCELERATION_UNITS, written=True),
            deceleration=self.optional_role(section, "deceleration", ACCELERATION_UNITS, written=True),
            mode=self.writes(section, "mode"),
            mode_shown=self.conditions(section, "mode_shown"),
            idle=self.conditions(section, "idle", required=bit),
            start=self.writes(section, "start", required=triggered),
            accepted=self.conditions(section, "accepted", required=triggered),
            release=self.writes(section, "release", required=bit),
            released=self.conditions(section, "released", required=bit),
            reached=self.conditions(section, "reached", required=triggered),
            window=section.take("window", positive, "a number > 0 in the target's unit", None),
            timeout_s=section.take("timeout_s", positive, "seconds > 0", 0.5),
        )
        if not triggered and move.window is None:
            raise self.document.fail(
                section.place, "lacks window, which a move started by its target alone is judged by"
            )
        section.finish()
        return move

    def _homing(self, section: Section) -> HomingMap:
        homing = HomingMap(
            mode=self.writes(section, "mode"),
            mode_shown=self.conditions(section, "mode_shown"),
            start=self.writes(section, "start", required=True),
            accepted=self.conditions(section, "accepted"),
            release=self.writes(section, "release"),
            applies=self.conditions(section, "applies"),
            attained=self.conditions(section, "attained", required=True),
            failed=self.conditions(section, "failed"),
            timeout_s=section.take("timeout_s", positive, "seconds > 0", 0.5),
            method=self.optional_role(section, "method", None),
            home_position=self.optional_role(section, "home_position", POSITION_UNITS),
        )
        section.finish()
        return homing

    def _run(self, section: Section) -> RunMap:
        run = RunMap(
            target=self._signed(section, VELOCITY_UNITS),
            acceleration=self.optional_role(section, "acceleration", ACCELERATION_UNITS, written=True),
            deceleration=self.optional_role(section, "deceleration", ACCELERATION_UNITS, written=True),
            mode=self.writes(section, "mode"),
            mode_shown=self.conditions(section, "mode_shown"),
            start=self.writes(section, "start"),
            timeout_s=section.take("timeout_s", positive, "seconds > 0", 0.5),
        )
        section.finish()
        return run

    def _stream(self, section: Section) -> StreamMap:
        stream = StreamMap(
            target=self._signed(section, POSITION_UNITS),
            mode=self.writes(section, "mode"),
            mode_shown=self.conditions(section, "mode_shown"),
            start=self.writes(section, "start"),
            least_period_s=section.take("least_period_s", positive, "seconds > 0"),
            timeout_s=section.take("timeout_s", positive, "seconds > 0", 0.5),
        )
        section.finish()
        return stream

    def _signed(self, section: Section, units: tuple[str, ...]) -> str:
        """A target that can go either way."""
        name = self.role(section, "target", units, written=True)
        kind = self.registers[name].layout.type
        if kind.is_integer and kind.bounds[0] == 0:
            raise section.fail("target", f"is {name!r} of type {kind.value}, which has no sign")
        return name

    # -- touch probe -----------------------------------------------------------------------------------------------------
    def _probes(self, section: Section) -> tuple[ProbeMap, ...]:
        probes = tuple(self._probe(each) for each in section.children("touch_probe", required=False))
        if len({probe.number for probe in probes}) != len(probes):
            raise self.document.fail("drive.touch_probe", "has two probes of one number")
        return probes

    def _probe(self, section: Section) -> ProbeMap:
        edges = {edge: self._edge(section.child(edge.name.lower())) for edge in Edge if edge.name.lower() in section}
        if not edges:
            raise self.document.fail(section.place, "lacks positive and negative, expected at least one edge")
        probe = ProbeMap(
            number=section.take("number", whole(1, 16), "the number of the input, 1 to 16"),
            off=self.writes(section, "off", required=True),
            on=self.writes(section, "on", required=True),
            continuous=self.writes(section, "continuous"),
            armed=self.conditions(section, "armed"),
            edges=edges,
        )
        section.finish()
        return probe

    def _edge(self, section: Section) -> EdgeMap:
        edge = EdgeMap(
            arm=self.writes(section, "arm"),
            latched=self.conditions(section, "latched", required=True),
            position=self.role(section, "position", POSITION_UNITS),
            stamp=self.optional_role(section, "stamp", None),
            count=self.optional_role(section, "count", None),
        )
        section.finish()
        return edge

    def _store(self, section: Section) -> StoreMap:
        store = StoreMap(
            self.writes(section, "write", required=True),
            self.conditions(section, "done"),
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
        ratio = Ratio(None, self.role(child, "register", None), self.optional_role(child, "per", None))
        child.finish()
        return ratio


_STATES = ", ".join(state.value for state in DriveState if state is not DriveState.UNKNOWN)


def _state(value: Any) -> DriveState:
    state = DriveState(value)
    if state is DriveState.UNKNOWN:
        raise ValueError
    return state


def _names(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise ValueError
    return tuple(value)


def _states(value: Any) -> tuple[DriveState, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError
    return tuple(_state(item) for item in value)
