"""The machine's own sensors: thermometers by place, air, load cell, level, each with its own noise and lag.

Noise is drawn once per tick, so a reading does not depend on how often it is read.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from sim_backends.plant.parameters import SensorParameters


@dataclass(slots=True)
class SensorReadings:
    """The latest readings; `temps_c` by place, °C."""

    temps_c: dict[str, float]
    air_c: float
    air_pressure_hpa: float
    air_humidity_percent: float
    load_kg: float
    angle_noise_urad: tuple[float, float]


class Sensors:
    """Readings of the true values, with noise and lag."""

    def __init__(self, parameters: SensorParameters, seed: int, screw_c: float) -> None:
        self.parameters = parameters
        self._rng = random.Random(seed)
        self._nut_c = screw_c
        self.readings = SensorReadings({}, screw_c, 0.0, 0.0, 0.0, (0.0, 0.0))

    def tick(
        self,
        dt_s: float,
        temps_c: dict[str, float],
        air: tuple[float, float, float],
        load_kg: float,
    ) -> None:
        """Take new readings after dt_s seconds: temperatures by place (°C), air (°C, hPa, %), load (kg)."""
        p, gauss = self.parameters, self._rng.gauss
        self._nut_c += (temps_c["screw"] - self._nut_c) * -math.expm1(-dt_s / p.temperature_lag_s)
        readings = self.readings
        for place, value in temps_c.items():
            readings.temps_c[place] = (self._nut_c if place == "screw" else value) + gauss(0.0, p.temperature_k)
        readings.air_c = air[0] + gauss(0.0, p.temperature_k)
        readings.air_pressure_hpa = air[1] + gauss(0.0, p.pressure_hpa)
        readings.air_humidity_percent = min(100.0, max(0.0, air[2] + gauss(0.0, p.humidity_percent)))
        readings.load_kg = load_kg * (1.0 + gauss(0.0, p.load_percent / 100.0))
        readings.angle_noise_urad = (gauss(0.0, p.angle_urad), gauss(0.0, p.angle_urad))
