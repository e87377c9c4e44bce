"""Machines measured by a given plan, run after run: the true errors for judging the choice of the next measurement.

Numbers only, nothing imported from the project. Unlike `truth_machines`, which draws its own campaign, a machine here is given rows to
measure: position, direction, travel before, feed, load, warm-up. Temperatures and air vary
meanwhile, and are recorded only where a sensor was requested. Earlier rows never change: a longer plan
that begins with the same rows begins with the same readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Columns = dict[str, Array]

AGAINST = ("backlash", "backlash_position", "lost_motion", "velocity_lag", "load_deflection")
ALONG = ("pitch_shape", "cyclic", "local_wear", "cosine", "abbe", "cross_axis")
IN_TIME = ("thermal_drift", "thermal_expansion", "dead_path", "air_index", "beam_drift", "datum_step")
"""Effects that a standard test without sensors confuses with each other, by their similarity there."""
USUAL_LOAD_KG, USUAL_CROSS_MM = 60.0, 120.0


@dataclass(frozen=True)
class PlannedMachine:
    """strength: RMS of the hidden effect over the first `rows` rows, over the noise standard deviation.

    feed_mm_s: at which positions are captured; 0 at rest. noise: another number gives the same machine with other noise
    """

    seed: int
    effect: str = ""
    strength: float = 3.0
    low_mm: float = 0.0
    high_mm: float = 480.0
    feed_mm_s: float = 0.0
    noise: int = 0

    @property
    def sigma_um(self) -> float:
        return float(np.random.default_rng([self.seed, 9]).uniform(0.2, 1.0))

    def measure(self, plan: Columns, rows: int) -> Columns:
        """Readings (µm) and sensors of planned rows, all of them from the machine's first on.

        plan: run, direction, target_mm, time_s, since_reversal_mm, stroke_mm; optionally velocity_mm_s, load_kg, pos_y_mm, setup, and
        strokes_s (seconds of fast strokes just before the row); NaN for the default.
        """
        c = self._surroundings(plan)
        hidden = np.zeros(len(c["run"]))
        if self.effect:
            shape = self._shape(c)
            first = shape[:rows] - np.mean(shape[:rows])
            hidden = shape * self.strength * self.sigma_um / float(np.std(first))
        noise = _series(self.seed, 11 + 1000 * self.noise, len(hidden)) * self.sigma_um
        c["measured_mm"] = c["target_mm"] + (self.table_um(c) + hidden + noise) / 1e3
        return c

    def table_um(self, c: Columns) -> Array:
        """Errors at the time when the table was made, µm."""
        own = np.random.default_rng([self.seed, 1])
        u = self._u(c)
        f = sum(own.normal() * 6.0 / k**1.5 * np.sin(1.6 * k * u + own.uniform(0, 6.28)) for k in range(1, 5))
        return f + own.uniform(-8, 8) * u - 0.5 * own.uniform(1, 6) * c["direction"]

    def _u(self, c: Columns) -> Array:
        return (2 * c["target_mm"] - self.low_mm - self.high_mm) / (self.high_mm - self.low_mm)

    def _surroundings(self, plan: Columns) -> Columns:
        n, t = len(plan["run"]), plan["time_s"]
        usual = {
            "velocity_mm_s": self.feed_mm_s,
            "load_kg": USUAL_LOAD_KG,
            "pos_y_mm": USUAL_CROSS_MM,
            "abbe_offset_mm": 0.0,
            "strokes_s": 0.0,
            "setup": 1.0,
        }
        c = dict(plan)
        for name, value in usual.items():
            given = plan.get(name, np.full(n, np.nan))
            c[name] = np.where(np.isnan(given), value, given)
        heat = self._heat(t, c["strokes_s"])
        c["temp_screw_c"] = 20 + self._course(t, 21, 0.4) + heat + 0.03 * _series(self.seed, 31, n)
        c["temp_bed_c"] = 20 + self._course(t, 22, 0.9) + 0.15 * heat + 0.03 * _series(self.seed, 32, n)
        c["air_temp_c"] = 20 + self._course(t, 23, 0.9) + 0.03 * _series(self.seed, 33, n)
        c["air_pressure_hpa"] = 1005 + self._course(t, 24, 2.5) + 0.05 * _series(self.seed, 34, n)
        c["air_humidity_percent"] = 50 + self._course(t, 25, 5.0) + 0.3 * _series(self.seed, 35, n)
        own = np.random.default_rng([self.seed, 2])
        u = self._u(c)
        bend = own.uniform(1.4, 3.2)
        c["true_pitch_urad"] = 9 * np.sin(bend * u + own.uniform(0, 6.28)) + own.uniform(-6, 6) * u
        c["pitch_urad"] = c["true_pitch_urad"] + 0.4 * _series(self.seed, 36, n)
        c["yaw_urad"] = 5 * np.cos(own.uniform(1.0, 2.5) * u + 1.0) + 0.4 * _series(self.seed, 37, n)
        return c

    def _heat(self, t: Array, strokes_s: Array) -> Array:
        """Warming of the screw above its surroundings, K: slowly by measuring, fast by strokes."""
        own = np.random.default_rng([self.seed, 3])
        tau, rise = own.uniform(500.0, 1200.0), own.uniform(5.0, 9.0)
        out, heat, before = np.empty(len(t)), 0.0, 0.0
        for i, (now, fast) in enumerate(zip(t, strokes_s, strict=True)):
            for duration, duty in ((now - before - fast, 0.3), (fast, 1.0)):
                heat += (rise * duty - heat) * (1 - np.exp(-max(duration, 0.0) / tau))
            out[i], before = heat, now
        return out

    def _course(self, t: Array, key: int, size: float) -> Array:
        own = np.random.default_rng([self.seed, key])
        periods = np.exp(own.uniform(np.log(700.0), np.log(9000.0), 5))
        waves = np.sin(2 * np.pi * t[:, None] / periods + own.uniform(0, 6.28, 5)) @ own.normal(size=5)
        return size * waves / 1.6

    def _shape(self, c: Columns) -> Array:
        """The hidden effect, unscaled; its form always differs from the fitted one."""
        own = np.random.default_rng([self.seed, 4])
        family = self._against if self.effect in AGAINST else self._along if self.effect in ALONG else self._in_time
        return family(c, own)

    def _against(self, c: Columns, own: np.random.Generator) -> Array:
        """Effects that differ with the direction."""
        u, d, half = self._u(c), c["direction"], (self.high_mm - self.low_mm) / 2
        if self.effect == "backlash":
            shape = np.ones(len(d))
        elif self.effect == "backlash_position":
            shape = np.sin(own.uniform(0.7, 1.2) * u) + own.uniform(-0.4, 0.4) * u**2
        elif self.effect == "lost_motion":
            s = c["since_reversal_mm"] / (own.uniform(0.06, 0.25) * half)
            shape = 1 / (1 + s**2) if own.random() < 0.5 else np.exp(-(s ** own.uniform(0.8, 1.3)))
        elif self.effect == "velocity_lag":
            shape = c["velocity_mm_s"] / (1 + own.uniform(0, 0.2) * c["velocity_mm_s"] / 100.0)
        else:
            force = c["load_kg"] / (1 + own.uniform(0, 0.2) * c["load_kg"] / 160.0)
            shape = force * (u if own.random() < 0.5 else 1.0)
        return d * shape

    def _along(self, c: Columns, own: np.random.Generator) -> Array:
        """Effects that differ along the travel."""
        u, half = self._u(c), (self.high_mm - self.low_mm) / 2
        if self.effect == "pitch_shape":
            bow = own.uniform(0.4, 1.0) * np.cos(own.uniform(2, 4) * u)
            shape = np.tanh(own.uniform(0.8, 2) * (u - own.uniform(-0.4, 0.4))) + bow
        elif self.effect == "cyclic":
            angle = 2 * np.pi * c["target_mm"] / float(own.choice([5.0, 8.0, 10.0, 12.0, 16.0, 20.0]))
            shape = (1 + own.uniform(0, 0.3) * u) * np.sin(angle + own.uniform(0, 6.28))
        elif self.effect == "local_wear":
            centre, width = own.uniform(-0.6, 0.6) * half + half + self.low_mm, own.uniform(0.07, 0.14) * half
            bump = np.cos(np.clip((c["target_mm"] - centre) / width, -1.9, 1.9) * 0.8) ** 2
            shape = bump * (c["direction"] if own.random() < 0.4 else 1.0)
        elif self.effect == "cosine":
            shape = -c["target_mm"] * np.where(c["setup"] > 1, 0.05, 1.0)
        elif self.effect == "abbe":
            arm = own.uniform(60.0, 350.0) * own.choice([-1.0, 1.0])
            tilt = c["true_pitch_urad"] * (1 + own.uniform(-0.15, 0.15) * u)
            shape = tilt * (arm + c["abbe_offset_mm"]) / arm
        else:
            shape = c["pos_y_mm"] / 200.0 * (u + 0.1 * u**3)
        return shape

    def _in_time(self, c: Columns, own: np.random.Generator) -> Array:
        """Effects that vary in time."""
        t, x = c["time_s"], c["target_mm"]
        if self.effect == "thermal_drift":
            shape = _lagged(t, c["temp_screw_c"], own.uniform(20, 60))
        elif self.effect == "thermal_expansion":
            shape = x * (_lagged(t, c["temp_screw_c"], own.uniform(20, 60)) - 20.0)
        elif self.effect == "dead_path":
            shape = _index_ppm(c)
        elif self.effect == "air_index":
            shape = x * _index_ppm(c)
        elif self.effect == "beam_drift":
            shape = self._wander(t)
        else:
            at = own.uniform(0.2, 0.8) * 1000.0
            shape = (t > at) * (1 - 0.3 * np.exp(-np.clip(t - at, 0, None) / 8.0))
        return shape

    def _wander(self, t: Array) -> Array:
        """1/f noise over four hours."""
        own = np.random.default_rng([self.seed, 5])
        k = np.arange(4, 400)
        phase = own.uniform(0, 6.28, len(k))
        size = own.normal(size=len(k)) / k
        return np.sin(np.pi * np.outer(t / 14400.0, k) + phase) @ size


def _series(seed: int, key: int, n: int) -> Array:
    return np.random.default_rng([seed, key]).normal(size=n)


def _lagged(t: Array, value: Array, tau: float) -> Array:
    out, state, before = np.empty(len(t)), float(value[0]), t[0]
    for i, (now, v) in enumerate(zip(t, value, strict=True)):
        state += (v - state) * (1 - np.exp(-(now - before) / tau))
        out[i], before = state, now
    return out


def _index_ppm(c: Columns) -> Array:
    kelvin = c["air_temp_c"] + 273.15
    return 78.66 * c["air_pressure_hpa"] / kelvin - 0.0085 * (c["air_humidity_percent"] - 50) - 271.4
