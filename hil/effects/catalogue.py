"""The list of the known effects."""

from __future__ import annotations

from hil.effects.abbe import Abbe
from hil.effects.air_index import AirIndex
from hil.effects.backlash import Backlash
from hil.effects.backlash_position import BacklashPosition
from hil.effects.base import Effect
from hil.effects.beam_drift import BeamDrift
from hil.effects.cosine import Cosine
from hil.effects.cross_axis import CrossAxis
from hil.effects.cyclic import Cyclic
from hil.effects.datum_step import DatumStep
from hil.effects.dead_path import DeadPath
from hil.effects.load_deflection import LoadDeflection
from hil.effects.local_wear import LocalWear
from hil.effects.lost_motion import LostMotion
from hil.effects.pitch_shape import PitchShape
from hil.effects.thermal_drift import ThermalDrift
from hil.effects.thermal_expansion import ThermalExpansion
from hil.effects.velocity_lag import VelocityLag

ALL: tuple[Effect, ...] = (
    Cyclic(),
    ThermalExpansion(),
    ThermalDrift(),
    Backlash(),
    BacklashPosition(),
    LostMotion(),
    VelocityLag(),
    LoadDeflection(),
    Abbe(),
    CrossAxis(),
    LocalWear(),
    PitchShape(),
    DatumStep(),
    DeadPath(),
    AirIndex(),
    Cosine(),
    BeamDrift(),
)
