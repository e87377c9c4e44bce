"""Loader of register maps; it refuses a [drive] part that cannot work before it is used at a machine.

Refused with file, line and key: states that no rule shows or that lead nowhere, a fault that enabling would leave. The limits of
single keys are in `drivers.modbus.drive_map`.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from drivers.drive import FAULTS, DriveState
from drivers.files import read_text
from drivers.modbus.drive_map import DriveMap, StateChange, leads_to_enabled
from drivers.modbus.register_map import RegisterMap, find_map, parse_registers
from drivers.toml_schema import MOST_BYTES, Document


def load_drive_map(name_or_path: str | Path) -> DriveMap:
    """Read a register map with its [drive] part; a shipped one by name. Raises InputError naming file, line and key.

    The text is read at each call, and understood once."""
    path = find_map(name_or_path)
    return _drive_map(path, read_text(path, MOST_BYTES, expected="TOML"))


@lru_cache(maxsize=64)
def _drive_map(path: Path, text: str) -> DriveMap:
    document = Document(path, text)
    drive = _drive(document, parse_registers(document))
    document.finish()
    return drive


def _drive(document: Document, registers: RegisterMap) -> DriveMap:
    document.context = registers
    drive = document.load(DriveMap, "drive", usual={"registers": registers})
    shown = {rule.state for rule in drive.states}
    for needed in (DriveState.ENABLED, DriveState.FAULT):
        if needed not in shown:
            raise document.fail("drive.state", f"has no rule for {needed.value!r}")
    for key in ("enable", "disable", "reset_fault"):
        for index, transition in enumerate(getattr(drive, key)):
            if what := _wrong(key, transition, shown):
                raise document.fail(("drive", key, index), what)
    for state in shown - {
        DriveState.ENABLED,
        DriveState.NOT_READY,
        *FAULTS,
    }:  # left by the drive itself, or by a fault reset
        if not leads_to_enabled(drive.enable, state):
            raise document.fail("drive.enable", f"has no way from {state.value!r} to operation enabled")
    if not any(DriveState.ENABLED in transition.sources for transition in drive.disable):
        raise document.fail("drive.disable", "has no way out of operation enabled")
    return drive


def _wrong(key: str, transition: StateChange, shown: set[DriveState]) -> str:
    """Why a transition is refused, "" for one that is accepted."""
    for state in (*transition.sources, *transition.targets):
        if state not in shown:
            return f"speaks of {state.value!r}, which no rule in drive.state shows"
    if key == "enable" and any(fault in transition.sources for fault in FAULTS):
        return "starts from a fault state; a fault is reset on purpose"
    if key == "reset_fault" and DriveState.ENABLED in transition.targets:
        return "ends enabled; a reset leaves the axis disabled"
    return ""
