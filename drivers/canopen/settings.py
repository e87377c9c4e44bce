"""How a CANopen drive is to be treated: times, supervision, homing."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.canopen.power import PowerTimes


@dataclass(frozen=True)
class HomingSettings:
    """What is written before homing; whatever is None stays as the drive has it. mm/s, and load mm of the home position."""

    method: int | None = None
    speed_switch_mm_s: float | None = None
    speed_zero_mm_s: float | None = None
    home_position_mm: float | None = None


@dataclass(frozen=True)
class CanOpenSettings:
    """Times in seconds. heartbeat_s: the period asked of the drive, None leaves it and its supervision alone.

    guard_s: the drive shall stop (6007h: quick stop) when it has not heard our own heartbeat, sent as node `master_id`, for so
    long: 1016h is set up for it; a drive that cannot is told of in the drive's notes. None: it is left alone, and an axis goes on
    with its move when this process or the cable dies. No node of the bus may have the id `master_id`.
    """

    sdo_timeout_s: float = 0.5
    sample_timeout_s: float = 0.1
    handshake_timeout_s: float = 1.0
    mode_timeout_s: float = 1.0
    heartbeat_s: float | None = 0.2
    heartbeat_grace: float = 2.5  # times the period
    guard_s: float | None = None
    master_id: int = 127
    power: PowerTimes = field(default_factory=PowerTimes)
    homing: HomingSettings = field(default_factory=HomingSettings)
