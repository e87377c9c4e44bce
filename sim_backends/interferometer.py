"""Optics and counter of a simulated laser interferometer: from the true position of an axis to units of displacement. No wire.

The air is the true one, computed by another equation than hosts compensate with; set-up errors (angle, dead path, drift) are physics.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from sim_backends.plant.air import refractive_index
from sim_backends.plant.axis import FeedAxis


@dataclass(frozen=True)
class LaserParameters:
    """The instrument and its set-up.

    rate_hz: lines per second; units_per_wavelength: 2, 4 or 8 by the optics; direction: counts rise (+1) or fall (−1) with the axis;
    zero_mm: where on the axis the count is zero (true position, beam aligned); dead_path_mm: air between optics and that place;
    misalignment_mrad: angle between beam and axis; wavelength_error_ppm: of the true vacuum wavelength;
    noise_um: white, per sample; drift_um: wander of the beam or mount over hours, 1/f; drift_um_per_h: steady part;
    subdivision_nm: periodic error of the interpolation; reference_hz: frequency difference of the two-frequency head;
    latency_s, jitter_s: delay from a sample to its line at the reader, and its largest variation;
    angle_urad_per_unit: angle optics on axes 2 (pitch) and 3 (yaw), one unit of them; None: not fitted, lines of 8 numbers.
    straightness_um_per_unit: straightness optics on axis 2 instead, one unit of them, signed; straightness_noise_um: per sample.
    """

    rate_hz: float = 50.0
    units_per_wavelength: int = 2
    vacuum_wavelength_nm: float = 632.9912
    direction: int = 1
    zero_mm: float = 0.0
    dead_path_mm: float = 0.0
    misalignment_mrad: float = 0.0
    wavelength_error_ppm: float = 0.0
    noise_um: float = 0.03
    drift_um: float = 0.0
    drift_um_per_h: float = 0.0
    subdivision_nm: float = 0.0
    reference_hz: float = 2.0e6
    angle_urad_per_unit: float | None = None
    straightness_um_per_unit: float | None = None
    straightness_noise_um: float = 0.05
    latency_s: float = 0.0
    jitter_s: float = 0.0
    sensors_fitted: bool = True
    material_place: str = "screw"
    seed: int = 11


class Interferometer:
    """Optics and counter: from the true position of an axis to counts. No wire."""

    def __init__(self, axis: FeedAxis, parameters: LaserParameters) -> None:
        self.axis = axis
        self._rng = random.Random(parameters.seed)
        self._time_s = 0.0
        # 1/f: random walks of equal size, each with a memory four times as long as the one before
        self._walks = [self._rng.gauss(0.0, 1.0) for _ in range(6)]
        self._walk_due_s = 0.0
        self._drift_um = 0.0
        self._air = (math.nan, math.nan, math.nan)
        self.index = 1.0
        self._drift_offset_um = 0.0
        self._set(parameters)
        self._look_at_air()
        self._index_at_zero = self.index

    def configure(self, parameters: LaserParameters) -> None:
        """Change the set-up while it runs; a new dead path counts from the present air, a drift from its present value."""
        if parameters.dead_path_mm != self.parameters.dead_path_mm:
            self._look_at_air()
            self._index_at_zero = self.index
        if parameters.drift_um and not self.parameters.drift_um:
            self._drift_offset_um = self._steady_walk() * parameters.drift_um
        self._set(parameters)

    def _set(self, parameters: LaserParameters) -> None:
        self.parameters = parameters
        self._unit_mm = (
            parameters.vacuum_wavelength_nm
            * (1.0 + parameters.wavelength_error_ppm * 1e-6)
            / parameters.units_per_wavelength
        ) * 1e-6
        self._cosine = math.cos(parameters.misalignment_mrad * 1e-3)
        self._air = (math.nan, math.nan, math.nan)

    def _look_at_air(self) -> None:
        air = self.axis.ambient.air
        if air is not self._air:
            self._air = air
            self.index = refractive_index(*air, self.parameters.vacuum_wavelength_nm)

    def _drift(self, time_s: float) -> float:
        p = self.parameters
        if p.drift_um and time_s >= self._walk_due_s:
            self._walk_due_s = time_s + 1.0
            memory_s = 8.0
            for i, walk in enumerate(self._walks):
                keep = math.exp(-1.0 / memory_s)
                self._walks[i] = keep * walk + math.sqrt(1.0 - keep * keep) * self._rng.gauss(0.0, 1.0)
                memory_s *= 4.0
            self._drift_um = p.drift_um * self._steady_walk() - self._drift_offset_um
        return (self._drift_um if p.drift_um else 0.0) + p.drift_um_per_h * time_s / 3600.0

    def _steady_walk(self) -> float:
        return sum(self._walks) / math.sqrt(len(self._walks))

    def units(self, time_s: float, extra_um: float = 0.0) -> float:
        """The displacement at time_s (s) plus extra_um (µm), in units of the optics, not yet quantised."""
        p = self.parameters
        self._look_at_air()
        shift_um = self._drift(time_s) + extra_um + self._rng.gauss(0.0, p.noise_um)
        seen_mm = (self.axis.position_mm - p.zero_mm) * self._cosine + shift_um * 1e-3
        path_mm = self.index * (p.dead_path_mm + seen_mm) - self._index_at_zero * p.dead_path_mm
        units = p.direction * path_mm / self._unit_mm
        if p.subdivision_nm:
            units += p.subdivision_nm * 1e-6 / self._unit_mm * math.sin(math.tau * units)
        return units
