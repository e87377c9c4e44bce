"""MotionParts: what the motions of one open drive are ordered by; MoveOrder: an absolute target in the drive's own units."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.cia402.kept_settings import KeptSettings
from drivers.cia402.operation_modes import OperationModes
from drivers.cia402.own_limits import OwnLimits
from drivers.cia402.power import PowerStage
from drivers.cia402.wire import ObjectAccess, ProcessImage
from drivers.clock import Clock
from drivers.scaling import MotionScaling


@dataclass(frozen=True)
class MoveOrder:
    """Counts, and the drive's units of velocity and acceleration."""

    counts: int
    velocity: int
    acceleration: int


@dataclass(frozen=True)
class MotionParts:
    """units: of its velocities and accelerations. notes: where what is used instead of what it lacks is told, one sentence each.

    handshake_s: longest time for an acknowledgement, s. strays_counts: how far outside its path an axis may be meanwhile.
    """

    access: ObjectAccess
    image: ProcessImage
    power: PowerStage
    kept: KeptSettings
    modes: OperationModes
    limits: OwnLimits
    units: MotionScaling
    notes: list[str]
    clock: Clock
    handshake_s: float
    strays_counts: int
