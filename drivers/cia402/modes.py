"""Modes of operation of CiA 402 as data, for drive and master alike: their numbers, and what the statusword says in homing mode."""

from __future__ import annotations

from enum import Enum, IntEnum


class Mode(IntEnum):
    """Modes of operation, 6060h and 6061h; the bit of mode m > 0 in 6502h is m - 1."""

    NONE = 0
    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    HOMING = 6
    INTERPOLATED_POSITION = 7
    CYCLIC_POSITION = 8
    CYCLIC_VELOCITY = 9
    CYCLIC_TORQUE = 10

    @property
    def supported_bit(self) -> int:
        """The mask of this mode in 6502h, 0 for NONE."""
        return 1 << (self - 1) if self > 0 else 0


class HomingStatus(Enum):
    """Statusword bits 13, 12 and 10 in homing mode; reserved patterns decode to None."""

    IN_PROGRESS = 0b000
    INTERRUPTED = 0b001  # or not started
    ATTAINED_NOT_REACHED = 0b010
    COMPLETED = 0b011
    ERROR_MOVING = 0b100
    ERROR_STANDSTILL = 0b101

    @property
    def failed(self) -> bool:
        return self in (HomingStatus.ERROR_MOVING, HomingStatus.ERROR_STANDSTILL)


def decode_homing(statusword: int) -> HomingStatus | None:
    """Homing status of a statusword read in homing mode (6061h = 6); None for the reserved patterns 11x (bits 13, 12, 10)."""
    bits = (statusword >> 11 & 0b100) | (statusword >> 11 & 0b010) | (statusword >> 10 & 0b001)
    try:
        return HomingStatus(bits)
    except ValueError:
        return None
