"""Scan of a Modbus line: each unit is asked for one register. Nothing is written.

Any answer counts, a refusal included: a unit without that register is there nevertheless. With a register map a drive's state and
position are read as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

from drivers.drive import DriveState
from drivers.errors import (
    AbortError,
    BridgeError,
    InputError,
    LinkLostError,
    NoAnswerError,
    OtherAnswerError,
    ProtocolError,
)
from drivers.modbus.codec import Raw
from drivers.modbus.drive_map import DriveMap
from drivers.modbus.link import LinkPolicy, ModbusLink
from drivers.modbus.plan import AddressSpace, Span
from drivers.modbus.register_access import RegisterAccess

POLICY = LinkPolicy(read_retries=0, busy_s=0.0, quiet_s=0.02)
"""Policy of a link for scanning: each unit is asked once; one that is busy is there."""


@dataclass(frozen=True)
class FoundUnit:
    """One unit that answered. refusal: its refusal of the register, "" when it gave it. also: ids that it answered in place of.

    With a register map: state, raw position, fault code; problem: why these could not be read.
    """

    unit: int
    refusal: str = ""
    state: DriveState | None = None
    position_raw: Raw | None = None
    fault_code: Raw | None = None
    problem: str = ""
    also: tuple[int, ...] = ()


def scan(
    link: ModbusLink,
    units: Iterable[int],
    drive_map: DriveMap | None = None,
    *,
    progress: Callable[[int], None] = lambda _done: None,
) -> list[FoundUnit]:
    """Ask each unit for holding register 0; reads only. The link must be open; make it with `POLICY`.

    Raises LinkLostError when the connection is lost and cannot be opened again.
    """
    found: dict[int, FoundUnit] = {}
    answered: dict[int, list[int]] = {}  # ids asked, by the unit that answered in their place

    def ask(unit: int) -> None:
        try:
            refusal = _ask(link, unit)
        except OtherAnswerError as error:
            answered.setdefault(unit if error.unit is None else error.unit, []).append(unit)
        else:
            if refusal is not None:
                found[unit] = FoundUnit(unit, refusal) if drive_map is None else _drive(link, unit, refusal, drive_map)

    for done, unit in enumerate(units, start=1):
        ask(unit)
        progress(done)
    for unit in [unit for unit in answered if unit not in found]:
        with suppress(InputError):  # an id that cannot be asked, as 0 on a serial line
            ask(unit)
        found.setdefault(unit, FoundUnit(unit, "answers other ids only"))
    return [replace(found[unit], also=tuple(answered.get(unit, ()))) for unit in sorted(found)]


def _ask(link: ModbusLink, unit: int) -> str | None:
    """None: no unit there; else its refusal, "" when it gave the register. Raises OtherAnswerError."""
    try:
        link.read(unit, AddressSpace.HOLDING, Span(0, 1), urgent=True)
    except AbortError as error:
        return str(error).rpartition(": ")[2]
    except ProtocolError as error:
        return f"gives an invalid reply: {error}"
    except OtherAnswerError:
        raise
    except NoAnswerError:
        return None
    except LinkLostError:
        link.close()  # some servers disconnect after a request to a missing unit; open raises where they refuse the next connection
        link.open()
        return None
    return ""


def _drive(link: ModbusLink, unit: int, refusal: str, drive_map: DriveMap) -> FoundUnit:
    """A unit read by a register map, as far as it answers."""
    access = RegisterAccess(link, unit, drive_map.registers)
    names = (*drive_map.state_registers, drive_map.position, drive_map.fault_code)
    try:
        raw = access.read(tuple(dict.fromkeys(name for name in names if name is not None)))
    except BridgeError as error:
        return FoundUnit(unit, refusal, problem=f"does not fit the register map: {error}")
    return FoundUnit(
        unit,
        refusal,
        state=drive_map.state_of(raw),
        position_raw=raw[drive_map.position],
        fault_code=None if drive_map.fault_code is None else raw[drive_map.fault_code] or None,
    )
