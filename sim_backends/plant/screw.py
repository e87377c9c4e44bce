"""The ball screw: deviation of the nut from the position by the screw's angle, without reversal and temperature.

A smooth pitch error over the length, and the cyclic error of the lead (bearing run-out, misaligned coupling), whose amplitude
varies along the screw as on real ones.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field

from sim_backends.plant.shapes import SmoothShape


@dataclass(frozen=True)
class CyclicError:
    """Periodic error of the screw's rotation.

    amplitude_um: of the strongest harmonic; second_um: of twice its frequency; period_mm: travel per cycle;
    modulation: 0…1, relative variation of the amplitude over `breath_mm` of travel; phases in rad.
    """

    amplitude_um: float = 0.0
    period_mm: float = 10.0
    second_um: float = 0.0
    phase_rad: float = 0.0
    second_phase_rad: float = 0.0
    modulation: float = 0.0
    breath_mm: float = 370.0

    def value_um(self, motor_mm: float) -> float:
        """µm at a motor position in mm of nominal travel."""
        turn = math.tau * motor_mm / self.period_mm
        breath = 1.0 + self.modulation * math.sin(math.tau * motor_mm / self.breath_mm + 0.7)
        return breath * (
            self.amplitude_um * math.sin(turn + self.phase_rad)
            + self.second_um * math.sin(2.0 * turn + self.second_phase_rad)
        )


@dataclass(frozen=True)
class LocalWear:
    """A worn zone, flat-bottomed with shoulders, deeper where it was used most; µm, mm."""

    depth_um: float = 0.0
    centre_mm: float = 0.0
    half_width_mm: float = 20.0

    def value_um(self, x_mm: float) -> float:
        """Depth at x, µm."""
        r = abs(x_mm - self.centre_mm) / self.half_width_mm
        return -self.depth_um / (1.0 + r**6) if r < 3.0 else 0.0


@dataclass(frozen=True)
class Screw:
    """Lead in mm per revolution, and its errors."""

    lead_mm: float = 10.0
    pitch_um: SmoothShape = field(default_factory=SmoothShape)
    cyclic: CyclicError = field(default_factory=CyclicError)
    wear: LocalWear = field(default_factory=LocalWear)

    def error_um(self, motor_mm: float, nut_mm: float) -> float:
        """Deviation of the nut, µm, at an angle of the screw (as nominal travel, mm) and a position of the nut along it, mm."""
        error = self.pitch_um.value(nut_mm)
        if self.cyclic.amplitude_um or self.cyclic.second_um:
            error += self.cyclic.value_um(motor_mm)
        if self.wear.depth_um:
            error += self.wear.value_um(nut_mm)
        return error


def typical_screw(
    seed: int,
    length_mm: float,
    *,
    pitch_peak_um: float = 12.0,
    cyclic_um: float = 1.2,
) -> Screw:
    """A ground screw of class IT3 to IT5, not compensated; lengths in mm, amplitudes in µm."""
    rng = random.Random(seed)
    return Screw(
        pitch_um=SmoothShape.random(rng.getrandbits(32), pitch_peak_um, length_mm, slope_per_mm=0.018),
        cyclic=CyclicError(
            amplitude_um=cyclic_um,
            period_mm=Screw.lead_mm,
            second_um=0.35 * cyclic_um,
            phase_rad=rng.uniform(0.0, math.tau),
            second_phase_rad=rng.uniform(0.0, math.tau),
            modulation=0.25,
        ),
    )
