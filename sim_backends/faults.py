"""Faults of a simulated part and their times, as data; each part acts on the faults of its own kinds. All kinds have their names here.

Times are seconds of simulated time since the clock's zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class FaultKind(Enum):
    """Kinds of fault of a machine; the comment gives the meaning of `size`."""

    # of the interferometer's signal
    BEAM_LOST = "beam lost"  # the count runs away while it lasts
    HEAD_ERROR = "head error"
    OVERSPEED = "overspeed"
    GLITCH = "glitch"  # size µm on every sample while it lasts
    # of its line
    SILENCE = "silence"  # samples are taken and numbered, but not sent
    HALF_LINE = "half line"  # a line breaks off in the middle
    GARBAGE = "garbage"  # size bytes of noise after the line (8 when 0)
    LINE_ENDS = "other line ends"  # LF, CR and CR LF in turn
    RESTART = "restart"  # numbers and counts begin anew
    # of the drive
    DRIVE_FAULT = "drive fault"  # size = error code
    JAM = "jam"  # the shaft is blocked
    TORQUE_NOISE = "torque noise"  # size: additional noise, 0.1 %


class CanFaultKind(Enum):
    """Kinds of fault of a CANopen drive and its bus; the comment gives the meaning of `size`, which the others ignore."""

    # SDO
    SDO_LATE = "SDO answers come late"  # size: s
    SDO_LOST = "SDO answers are lost"
    SDO_REQUEST_LOST = "SDO requests are lost"
    SDO_ABORTED = "SDO requests are refused"  # size: abort code
    SDO_WRITE_ABORTED = "SDO writes are refused"  # size: abort code
    SDO_WRONG_INDEX = "SDO answers name another index"
    SDO_GARBAGE = "SDO answers carry an impossible command"
    SDO_SHORT = "SDO answers are cut short"
    SDO_WRONG_VALUE = "SDO reads show another value"
    # PDO and SYNC
    TPDO_LOST = "TPDOs are lost"
    TPDO_LATE = "TPDOs come late"  # size: s
    TPDO_SHORT = "TPDOs are cut short"
    RPDO_LOST = "RPDOs are lost"
    SYNC_LOST = "SYNC is not received"
    # supervision
    HEARTBEAT_STOPS = "the heartbeat stops"
    EMCY_BURST = "a burst of emergencies"  # size: how many
    DUPLICATES = "every frame is sent twice"
    # the node
    NODE_DEAD = "the node is cut off from the bus: it neither sends nor receives"
    REBOOT = "the node restarts by itself"
    POWER_CUT = "the drive loses its supply and starts again"
    NMT_STOPPED = "another master stops the node"
    NMT_PRE_OPERATIONAL = "another master takes the node out of operation"
    FOREIGN_CONTROLWORD = "another master writes the controlword"  # size: the word
    # the firmware
    SAFE_TORQUE_OFF = "safe torque off is active"
    BRAKE_STUCK = "the brake never opens"
    SETPOINT_NOT_TAKEN = "the set-point is never acknowledged"
    ACKNOWLEDGE_STUCK = "the acknowledge bit stays set"
    NEVER_ARRIVES = "target reached is never shown"
    MODE_STUCK = "the mode of operation does not change"
    LOCAL_CONTROL = "the drive does not listen to the controlword"
    STATUS_IMPOSSIBLE = "the statusword is one that the standard does not have"
    FAULT_STAYS = "a fault cannot be reset"
    DRIVE_FAULT = "the drive goes into a fault"  # size: error code


class WireFaultKind(Enum):
    """Kinds of fault of a Modbus wire; the comment says whether the request is carried out."""

    LATE_REPLY = "late reply"  # carried out; the reply leaves delay_s of simulated time later
    DISPLACED = "displaced reply"  # carried out; the reply leaves just before the next one on the same wire
    NO_REPLY = "no reply"  # carried out; the reply is lost
    LOST_REQUEST = "lost request"  # neither carried out nor answered
    EXCEPTION = "exception"  # not carried out, answered with `code`
    BAD_CRC = "damaged reply"  # carried out; one bit of the reply's check (TCP: of its protocol id) is flipped
    WRONG_UNIT = "wrong unit"  # carried out; the reply names the next unit
    WRONG_FUNCTION = "wrong function"  # carried out; the reply is one to another function
    WRONG_ECHO = "wrong echo"  # carried out; the reply to a write names another address
    TRUNCATED = "truncated reply"  # carried out; only the first half of the reply is sent
    TORN = "torn reply"  # carried out; half of the reply is sent, the rest just before the next one
    SHORT_DATA = "short data"  # carried out; a well-formed reply with one register too few
    DROP = "connection dropped"  # carried out; TCP: the connection is closed instead of a reply
    DROP_REQUEST = "connection dropped before"  # not carried out; TCP: the connection is closed


def fault_names(kind: type[Enum]) -> tuple[str, ...]:
    return tuple(member.name.lower().replace("_", "-") for member in kind)


@dataclass(frozen=True)
class Fault:
    """One fault in force from at_s on for duration_s, s; with duration 0 it happens once."""

    kind: FaultKind
    at_s: float
    duration_s: float = 0.0
    size: float = 0.0


class FaultSchedule:
    """The faults of one part, in time order. A fault of duration 0 is returned exactly once."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._faults: list[Fault] = []
        self._done: set[int] = set()  # identities: of two faults that are alike each happens
        self.next_s = math.inf
        self.add(faults)

    def add(self, faults: Iterable[Fault]) -> None:
        """Add faults to those there are."""
        self._faults = sorted([*self._faults, *faults], key=lambda fault: fault.at_s)
        self.next_s = self._faults[0].at_s if self._faults else math.inf

    def active(self, time_s: float) -> list[Fault]:
        """The faults in force at this time, s; single ones only at the first call after their time."""
        if time_s < self.next_s:
            return []
        found = []
        for fault in self._faults:
            if fault.at_s > time_s:
                break
            if fault.duration_s == 0.0:
                if id(fault) not in self._done:
                    self._done.add(id(fault))
                    found.append(fault)
            elif time_s < fault.at_s + fault.duration_s:
                found.append(fault)
        return found

    def next_change_s(self, time_s: float) -> float:
        """Time of the next begin or end of a fault after this time, s; inf when there is none."""
        changes = [f.at_s for f in self._faults] + [f.at_s + f.duration_s for f in self._faults]
        return min((change for change in changes if change > time_s), default=math.inf)
