"""Parser of faults as a user types them: kind, time, duration, size.

    beam-lost@20+3        from 20 s on, for 3 s              drive-fault@12=0x8611       at 12 s, with this size
    heartbeat-stops@30    from 30 s on, for good             no-reply#5*2                the 5th request and the one after it

Names are those of the kinds, in lower case with dashes. Times are seconds since the simulated part was started; without a duration a
fault of the machine happens once and one of the CAN bus stays.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from drivers.errors import InputError
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind, Fault, FaultKind, WireFaultKind, fault_names
from sim_backends.modbus_faults import WireFault

_TEXT = re.compile(
    r"(?P<kind>[a-z][a-z-]*)"
    r"((@(?P<at>[\d.]+))?(\+(?P<lasts>[\d.]+))?|#(?P<nth>\d+)(\*(?P<count>\d+))?)"
    r"(=(?P<size>0x[0-9a-fA-F]+|[\d.]+))?"
)
_DRIVE_KINDS = (FaultKind.DRIVE_FAULT, FaultKind.JAM, FaultKind.TORQUE_NOISE)


@dataclass(frozen=True)
class Faults:
    """Faults by the part to which they apply."""

    laser: tuple[Fault, ...] = ()
    servo: tuple[Fault, ...] = ()
    can: tuple[CanFault, ...] = ()
    modbus: tuple[WireFault, ...] = ()


def parse_faults(texts: Iterable[str], *, wire: type[CanFaultKind] | type[WireFaultKind] | None = None) -> Faults:
    """Faults of a machine and, where it has one, of its wire. A name of both means the machine's.

    Raises InputError naming the text and what was expected.
    """
    laser: list[Fault] = []
    servo: list[Fault] = []
    can: list[CanFault] = []
    modbus: list[WireFault] = []
    for text in texts:
        match = _TEXT.fullmatch(text)
        if match is None:
            raise InputError(
                f"fault {text!r}, expected KIND@SECONDS[+SECONDS][=SIZE] or KIND#REQUEST[*COUNT][=SECONDS]"
            )
        name = match["kind"].replace("-", "_").upper()
        at_s, lasts_s, size = _number(match["at"]), _number(match["lasts"]), _number(match["size"])
        if name in FaultKind.__members__:
            fault = Fault(FaultKind[name], at_s, lasts_s, size)
            _refuse(match["nth"], text, "a time (@)")
            (servo if fault.kind in _DRIVE_KINDS else laser).append(fault)
        elif wire is CanFaultKind and name in CanFaultKind.__members__:
            _refuse(match["nth"], text, "a time (@)")
            can.append(CanFault(CanFaultKind[name], at_s, lasts_s, size))
        elif wire is WireFaultKind and name in WireFaultKind.__members__:
            _refuse(match["at"] or match["lasts"], text, "a request's number (#)")
            count = int(match["count"] or 1)
            modbus.append(WireFault(WireFaultKind[name], int(match["nth"] or 1), count, delay_s=size))
        else:
            known = fault_names(FaultKind) + (fault_names(wire) if wire else ())
            raise InputError(f"fault {text!r}: unknown kind {match['kind']}, expected one of {', '.join(known)}")
    return Faults(tuple(laser), tuple(servo), tuple(can), tuple(modbus))


def _number(text: str | None) -> float:
    if text is None:
        return 0.0
    try:
        return float(int(text, 16)) if text.startswith("0x") else float(text)
    except ValueError as error:
        raise InputError(f"{text!r} is no number") from error


def _refuse(part: str | None, text: str, expected: str) -> None:
    if part is not None:
        raise InputError(f"fault {text!r}: this kind takes {expected}")
