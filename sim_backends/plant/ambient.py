"""The workshop's air: temperature, pressure and humidity, each a slow wave plus a bounded random walk.

Advanced in fixed ticks by its owner, so that it depends only on the seed and the time, not on when it is read.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass


@dataclass(frozen=True)
class AmbientParameters:
    """Means (°C, hPa, %), and their variation (standard deviation of the walk over long times, peak of the wave)."""

    air_c: float = 20.0
    air_wave_k: float = 0.0
    air_wave_period_s: float = 5400.0
    air_walk_k: float = 0.0
    pressure_hpa: float = 1013.25
    pressure_walk_hpa: float = 0.0
    humidity_percent: float = 50.0
    humidity_walk_percent: float = 0.0
    walk_memory_s: float = 1800.0


class Ambient:
    """Present values, singly and as `air` (°C, hPa, %), which is a new tuple whenever a value changed; `tick` advances them."""

    def __init__(self, parameters: AmbientParameters, seed: int) -> None:
        self.parameters = parameters
        self._rng = random.Random(seed)
        self._walks = [0.0, 0.0, 0.0]
        self._time_s = 0.0
        self._show()

    def configure(self, parameters: AmbientParameters) -> None:
        self.parameters = parameters
        self._show()

    def tick(self, dt_s: float) -> None:
        """Advance the air by dt_s seconds."""
        p = self.parameters
        self._time_s += dt_s
        if p.air_walk_k or p.pressure_walk_hpa or p.humidity_walk_percent:
            keep = math.exp(-dt_s / p.walk_memory_s)
            kick = math.sqrt(1.0 - keep * keep)
            self._walks = [keep * w + kick * self._rng.gauss(0.0, 1.0) for w in self._walks]
        elif not p.air_wave_k:
            return
        self._show()

    def _show(self) -> None:
        p = self.parameters
        wave = p.air_wave_k * math.sin(math.tau * self._time_s / p.air_wave_period_s)
        self.air_c = p.air_c + wave + p.air_walk_k * self._walks[0]
        self.pressure_hpa = p.pressure_hpa + p.pressure_walk_hpa * self._walks[1]
        self.humidity_percent = min(100.0, max(0.0, p.humidity_percent + p.humidity_walk_percent * self._walks[2]))
        self.air = (self.air_c, self.pressure_hpa, self.humidity_percent)
