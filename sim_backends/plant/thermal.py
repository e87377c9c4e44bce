"""Heat: the work of moving warms the screw, which warms the machine's base; both lose heat to the air.

Two lumps, T1 the screw and T2 the base, in closed form for any step with constant heating; two more lags make the head (spindle
side) follow late. Temperatures in °C, times in s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ThermalParameters:
    """Thermal properties of the machine.

    heating_k_per_mm: rise of the screw per mm of travel, without losses
    screw_to_air_s, screw_to_base_s, base_to_screw_s, base_to_air_s: time constants of the four ways (1/rate)
    expansion_ppm_per_k: of the screw; fixed_bearing_mm: the place that does not move
    base_share: share of the screw's expansion that follows the base instead (nut, bearing brackets)
    head_drift_um_per_k: offset between table and instrument per K of the head's rise; head_rise_k: rise of the head after
    switch-on, by two lags of head_lag_s in series
    start_screw_rise_k: rise of the screw at the beginning over the air, for a machine that was already at work
    """

    heating_k_per_mm: float = 0.0
    screw_to_air_s: float = 1500.0
    screw_to_base_s: float = 2600.0
    base_to_screw_s: float = 16000.0
    base_to_air_s: float = 9000.0
    expansion_ppm_per_k: float = 0.0
    fixed_bearing_mm: float = 0.0
    reference_c: float = 20.0
    base_share: float = 0.15
    head_drift_um_per_k: float = 0.0
    head_rise_k: float = 0.0
    head_lag_s: float = 700.0
    start_screw_rise_k: float = 0.0


@dataclass(slots=True)
class ThermalState:
    """Temperatures of screw and base, °C, and rises of the head, K."""

    screw_c: float
    base_c: float
    head_rise_k: float = 0.0
    head_inner_k: float = 0.0


class Thermal:
    """The lumps with their state; `step` is exact for constant heating and air temperature."""

    def __init__(self, parameters: ThermalParameters, air_c: float) -> None:
        self.state = ThermalState(air_c + parameters.start_screw_rise_k, air_c)
        self.configure(parameters)

    def configure(self, parameters: ThermalParameters) -> None:
        """Change the parameters; temperatures are kept."""
        self.parameters = p = parameters
        a11 = -1.0 / p.screw_to_air_s - 1.0 / p.screw_to_base_s
        a12 = 1.0 / p.screw_to_base_s
        a21 = 1.0 / p.base_to_screw_s
        a22 = -1.0 / p.base_to_screw_s - 1.0 / p.base_to_air_s
        mean = 0.5 * (a11 + a22)
        root = math.sqrt(0.25 * (a11 - a22) ** 2 + a12 * a21)
        self._a = (a11, a12, a21, a22)
        self._rates = (mean + root, mean - root)
        self._determinant = a11 * a22 - a12 * a21
        self._cached_dt_s = -1.0
        self._cached = (1.0, 0.0, 0.0, 1.0, 1.0)

    def step(self, moved_mm: float, dt_s: float, air_c: float) -> None:
        """Advance the temperatures by dt_s seconds, in which the screw moved `moved_mm` of travel (≥ 0) evenly."""
        state, p = self.state, self.parameters
        if dt_s != self._cached_dt_s:
            self._cached = self._transition(dt_s)
            self._cached_dt_s = dt_s
        e11, e12, e21, e22, head = self._cached
        _, _, a21, a22 = self._a
        power = moved_mm * p.heating_k_per_mm / dt_s
        # equilibrium rises over the air: A·r + (power, 0) = 0
        rest1 = -a22 * power / self._determinant
        rest2 = a21 * power / self._determinant
        r1 = state.screw_c - air_c - rest1
        r2 = state.base_c - air_c - rest2
        state.screw_c = air_c + rest1 + e11 * r1 + e12 * r2
        state.base_c = air_c + rest2 + e21 * r1 + e22 * r2
        if p.head_rise_k:
            # two equal lags in series, exactly: (1 + t/τ)·e^(−t/τ)
            x = dt_s / p.head_lag_s
            inner, outer = state.head_inner_k - p.head_rise_k, state.head_rise_k - p.head_rise_k
            state.head_rise_k = p.head_rise_k + head * (outer + x * inner)
            state.head_inner_k = p.head_rise_k + head * inner

    def _transition(self, dt_s: float) -> tuple[float, float, float, float, float]:
        """exp(A·dt) by its eigenvalues (Sylvester), and the head's decay."""
        a11, a12, a21, a22 = self._a
        l1, l2 = self._rates
        x1, x2 = math.exp(l1 * dt_s), math.exp(l2 * dt_s)
        d = l1 - l2
        f, g = (x1 - x2) / d, (l1 * x2 - l2 * x1) / d
        return f * a11 + g, f * a12, f * a21, f * a22 + g, math.exp(-dt_s / self.parameters.head_lag_s)

    def expansion_mm(self, x_mm: float) -> float:
        """Displacement of a position x of the table by the screw's expansion, mm."""
        p = self.parameters
        if p.expansion_ppm_per_k == 0.0:
            return 0.0
        effective_c = (1.0 - p.base_share) * self.state.screw_c + p.base_share * self.state.base_c
        return p.expansion_ppm_per_k * 1e-6 * (effective_c - p.reference_c) * (x_mm - p.fixed_bearing_mm)

    @property
    def head_drift_um(self) -> float:
        """Offset of the table against the instrument, µm."""
        return self.parameters.head_drift_um_per_k * self.state.head_rise_k
