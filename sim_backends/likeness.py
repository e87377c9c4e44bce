"""A simulated machine with the measured errors of a real one. It is a likeness: it has the sizes that were measured, and between the
measured places and in its effects the simulator's own laws."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sim_backends.bench import BESIDE_TRAVEL_MM, SWITCH_SPREAD_REV, BenchParameters
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.hysteresis import Backlash
from sim_backends.plant.parameters import PlantParameters
from sim_backends.plant.screw import Screw
from sim_backends.plant.shapes import Points, SmoothShape
from sim_backends.plant.switches import switch_on
from sim_backends.servo import ServoParameters

BESIDE_SWITCH_REV, BESIDE_STOP_REV = 0.5, 1.0
"""From the end of the length to the limit switch and to the hard stop, motor revolutions."""


@dataclass(frozen=True)
class Likeness:
    """What was measured of a machine, lengths in mm.

    error_um: at places along the axis, the mean of both directions; reversal_um: at these places, the distance between the two
    effects: ids in the catalogue with sizes, µm, which `sim_backends.plant.switches` defines
    """

    travel_mm: tuple[float, float]
    lead_mm: float
    max_velocity_mm_s: float
    max_acceleration_mm_s2: float
    error_um: Points
    reversal_um: Points
    effects: tuple[tuple[str, float], ...] = ()


def alike(found: Likeness) -> BenchParameters:
    """A bench with these errors. Its travel holds that of the machine, and 0, where it is switched on."""
    begin_mm = min(0.0, found.travel_mm[0] + BESIDE_TRAVEL_MM)
    end_mm = max(0.0, found.travel_mm[1] - BESIDE_TRAVEL_MM)
    servo = ServoParameters()
    counts, begin_rev, end_rev = servo.counts_per_rev, begin_mm / found.lead_mm, end_mm / found.lead_mm
    servo = replace(
        servo,
        switch_spread_counts=SWITCH_SPREAD_REV * counts,
        max_velocity_rev_s=found.max_velocity_mm_s / found.lead_mm,
        max_acceleration_rev_s2=found.max_acceleration_mm_s2 / found.lead_mm,
        negative_limit_counts=(begin_rev - BESIDE_SWITCH_REV) * counts,
        negative_stop_counts=(begin_rev - BESIDE_STOP_REV) * counts,
        home_switch_counts=servo.home_switch_counts + begin_rev * counts,
        positive_limit_counts=(end_rev + BESIDE_SWITCH_REV) * counts,
        positive_stop_counts=(end_rev + BESIDE_STOP_REV) * counts,
    )
    return BenchParameters(plant=_plant(found, begin_mm, end_mm - begin_mm), servo=servo)


def _plant(found: Likeness, begin_mm: float, length_mm: float) -> PlantParameters:
    """The axis with the effects, and with what they leave of the measured errors."""
    axis = FeedAxis(PlantParameters(length_mm=length_mm, begin_mm=begin_mm, screw=Screw(found.lead_mm)))
    for effect, size_um in found.effects:
        switch_on(axis, effect, size_um)
    plant, grows_um = axis.parameters, axis.parameters.lost_motion.amount_um
    error_um = tuple((place, value - plant.screw.error_um(place, place)) for place, value in found.error_um)
    reversal_um = tuple((place, max(0.0, value - grows_um)) for place, value in found.reversal_um)
    return replace(
        plant,
        screw=replace(plant.screw, pitch_um=SmoothShape(points=error_um)),
        backlash=Backlash(along_um=reversal_um),
    )
