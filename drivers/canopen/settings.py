"""Settings of a CANopen drive: times, supervision, homing."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.canopen.power import PowerTimes


@dataclass(frozen=True)
class HomingSettings:
    """Objects written before homing; a None is not written. mm/s, and load mm of the home position."""

    method: int | None = None
    speed_switch_mm_s: float | None = None
    speed_zero_mm_s: float | None = None
    home_position_mm: float | None = None


@dataclass(frozen=True)
class CanOpenSettings:
    """Times in seconds. heartbeat_s: the period requested of the drive, None leaves it and its supervision unchanged.

    guard_s: the drive shall stop (6007h: quick stop) when it has not received our own heartbeat, sent as node `master_id`, for so
    long: 1016h is set up for it; where that fails, the drive's notes say so. None: 1016h is not written, and an axis continues
    its move when this process ends or the cable breaks. No node of the bus may have the id `master_id`.

    velocity_unit, acceleration_unit: of 6081h, 60FFh, 606Ch and of 6083h to 6085h where no object of the drive states them, in the
    form of `scaling.motion_unit`; None: by the drive's objects, its maker's manual or the standard. modes: numbers of 6060h of a
    drive without 6502h; empty: they are tried at standstill. axis: of a node with several axes; indices + 800h for each further one.
    """

    sdo_timeout_s: float = 0.5
    sample_timeout_s: float = 0.1
    handshake_timeout_s: float = 1.0
    mode_timeout_s: float = 1.0
    heartbeat_s: float | None = 0.2
    heartbeat_grace: float = 2.5  # times the period
    guard_s: float | None = None
    master_id: int = 127
    velocity_unit: str | None = None
    acceleration_unit: str | None = None
    modes: tuple[int, ...] = ()
    axis: int = 1
    power: PowerTimes = field(default_factory=PowerTimes)
    homing: HomingSettings = field(default_factory=HomingSettings)
