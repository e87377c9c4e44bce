"""PlantParameters: one frozen description of a feed axis's true errors, and a few realistic ones.

Every term is zero unless requested; random terms are drawn from the seed, so that two machines of one seed are equal.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field, replace

from sim_backends.plant.ambient import AmbientParameters
from sim_backends.plant.drive_train import DriveTrain
from sim_backends.plant.guideway import CrossAxis, Guideway, LoadDeflection, MountSlip, VelocityLag
from sim_backends.plant.hysteresis import Backlash, LostMotion
from sim_backends.plant.screw import Screw, typical_screw
from sim_backends.plant.shapes import SmoothShape
from sim_backends.plant.thermal import ThermalParameters

LENGTH_MM = 500.0
"""Travel of an axis that is not told another, mm."""


@dataclass(frozen=True)
class Friction:
    """Torque at the motor for moving the table, in 0.1 % of rated: Coulomb part, excess of the break-away over it as a
    fraction, and the travel over which that excess has fallen to one half."""

    table_permille: float = 60.0
    stiction: float = 0.18
    breakaway_mm: float = 0.02


@dataclass(frozen=True)
class SensorParameters:
    """Noise of the machine's own sensors: K, % of load, µrad (standard deviations), and the lag of the screw's
    thermometer, which sits on the nut, in s."""

    temperature_k: float = 0.015
    temperature_lag_s: float = 45.0
    pressure_hpa: float = 0.05
    humidity_percent: float = 0.4
    load_percent: float = 0.3
    angle_urad: float = 0.08


@dataclass(frozen=True)
class PlantParameters:
    """The true properties of one feed axis; lengths mm, errors µm (see the parts).

    begin_mm: the near end of the length; the axis's zero, from which errors and expansion are counted, stays at 0
    drive_train: springs and friction between motor and table, in addition to `backlash`, `lost_motion` and `friction` (which
    describe the same more coarsely, and are quicker to simulate); None: a rigid one.
    """

    seed: int = 1
    length_mm: float = LENGTH_MM
    begin_mm: float = 0.0
    screw: Screw = field(default_factory=Screw)
    backlash: Backlash = field(default_factory=Backlash)
    lost_motion: LostMotion = field(default_factory=LostMotion)
    thermal: ThermalParameters = field(default_factory=ThermalParameters)
    ambient: AmbientParameters = field(default_factory=AmbientParameters)
    guideway: Guideway = field(default_factory=Guideway)
    load: LoadDeflection = field(default_factory=LoadDeflection)
    cross_axis: CrossAxis = field(default_factory=CrossAxis)
    velocity_lag: VelocityLag = field(default_factory=VelocityLag)
    slip: MountSlip = field(default_factory=MountSlip)
    friction: Friction = field(default_factory=Friction)
    drive_train: DriveTrain | None = None
    sensors: SensorParameters = field(default_factory=SensorParameters)


def ideal_axis() -> PlantParameters:
    """An axis without any error."""
    return PlantParameters()


def geometric_axis(seed: int) -> PlantParameters:
    """Pitch error and backlash only, at constant temperature: what a bidirectional table corrects completely."""
    rng = random.Random(seed)
    return PlantParameters(
        seed=seed,
        screw=typical_screw(rng.getrandbits(32), LENGTH_MM, cyclic_um=0.0),
        backlash=Backlash(rng.uniform(5.0, 9.0), middle_mm=LENGTH_MM / 2, half_travel_mm=LENGTH_MM / 2),
    )


def typical_axis(seed: int) -> PlantParameters:
    """A machining centre's axis in a workshop: pitch, cyclic error, backlash that varies, lost motion, some heat."""
    rng = random.Random(seed)
    return PlantParameters(
        seed=seed,
        screw=typical_screw(rng.getrandbits(32), LENGTH_MM),
        backlash=Backlash(
            rng.uniform(5.0, 9.0),
            slope=rng.uniform(-0.15, 0.15),
            middle_mm=LENGTH_MM / 2,
            half_travel_mm=LENGTH_MM / 2,
            gap_fraction=0.15,
            stribeck=0.12,
        ),
        lost_motion=LostMotion.spread(rng.getrandbits(32), rng.uniform(1.5, 3.0), 0.4),
        thermal=ThermalParameters(
            heating_k_per_mm=8e-5, expansion_ppm_per_k=11.5, head_drift_um_per_k=0.4, head_rise_k=2.0
        ),
        ambient=AmbientParameters(
            air_c=20.6, air_wave_k=0.3, air_walk_k=0.2, pressure_walk_hpa=1.5, humidity_walk_percent=4.0
        ),
    )


def worn_axis(seed: int) -> PlantParameters:
    """An axis with about 53 µm of lost motion, all of it wind-up of a soft drive train against the friction of a plain guideway."""
    rng = random.Random(seed)
    return PlantParameters(
        seed=seed,
        screw=typical_screw(rng.getrandbits(32), LENGTH_MM),
        friction=Friction(table_permille=0.0),
        drive_train=DriveTrain(),
    )


def bent_axis(seed: int) -> PlantParameters:
    """A geometric axis whose guideway leaves the straight line by 12 µm to either side."""
    shape = SmoothShape.random(random.Random(f"straightness {seed}").getrandbits(32), 12.0, LENGTH_MM)
    return replace(geometric_axis(seed), guideway=Guideway(straightness_um=shape))
