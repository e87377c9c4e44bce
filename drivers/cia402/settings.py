"""Settings of a CiA 402 drive that no wire decides: times, units, modes, homing."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.cia402.homing import HomingSettings
from drivers.cia402.power import PowerTimes


@dataclass(frozen=True)
class Cia402Settings:
    """Times in seconds.

    velocity_unit, acceleration_unit: of 6081h, 60FFh, 606Ch and of 6083h to 6085h where no object of the drive states them, in the
    form of `scaling.motion_unit`; None: by the drive's objects, its maker's manual or the standard. modes: numbers of 6060h of a
    drive without 6502h; empty: they are tried at standstill.
    """

    handshake_timeout_s: float = 1.0
    mode_timeout_s: float = 1.0
    velocity_unit: str | None = None
    acceleration_unit: str | None = None
    modes: tuple[int, ...] = ()
    power: PowerTimes = field(default_factory=PowerTimes)
    homing: HomingSettings = field(default_factory=HomingSettings)
