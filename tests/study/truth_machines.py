"""Machines with known errors, to judge the diagnosis: written separately, numbers only, nothing imported from the project.

The forms are not the fitted ones: temperatures act through a lag and saturate, cyclic errors swell along the travel and carry a
harmonic, steps settle.
A machine is drawn from a seed; `campaign` measures it cold, at fresh targets, with every sensor of the record format present.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Columns = dict[str, Array]

PERIODS_MM = (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0)


@dataclass(frozen=True)
class Plan:
    """How a campaign is run: about the same targets in each run."""

    runs: int = 8
    targets: int = 21


@dataclass(frozen=True)
class Machine:
    """One machine. strength: RMS of each hidden effect, without the part that a table can hold, over the noise standard deviation."""

    seed: int
    effects: tuple[str, ...] = ()
    strength: tuple[float, ...] = ()
    noise: str = "normal"

    def campaign(self, number: int = 0, plan: Plan | None = None) -> tuple[Columns, dict[str, Array]]:
        """Records of one campaign, and the true contributions per row in µm ('clean' is table and effects without noise)."""
        plan = plan or Plan()
        c, base, shapes = self._draw(number, plan)
        zero = (c, shapes) if number == 0 else self._draw(0, plan)[::2]
        first = {name: _size(zero[0], shape) for name, shape in zero[1].items()}
        sigma = float(np.random.default_rng([self.seed, 5]).uniform(0.2, 1.2))
        parts: dict[str, Array] = {"table": base}
        for name, strength in zip(self.effects, self.strength, strict=True):
            parts[name] = shapes[name] * (strength * sigma / first[name])
        clean = np.sum(list(parts.values()), axis=0)
        noise = _noise(self.noise, c, np.random.default_rng([self.seed, 6, number])) * sigma
        c["measured_mm"] = c["target_mm"] + (clean + noise) / 1e3
        return c, parts | {"clean": clean, "noise": noise, "sigma": np.array(sigma)}

    def _draw(self, number: int, plan: Plan) -> tuple[Columns, Array, dict[str, Array]]:
        """Columns, table error and the unscaled shape of each effect."""
        c, base, half, origin = self._conditions(number, plan)
        usual = c if number == 0 else self._conditions(0, plan)[0]
        shapes: dict[str, Array] = {}
        for index, name in enumerate(self.effects):
            own = np.random.default_rng([self.seed, 3, index])
            happening = np.random.default_rng([self.seed, 4, index, number])
            if name in OUTSIDE_EFFECTS:
                shapes[name] = OUTSIDE_EFFECTS[name](c, usual)
            else:
                shapes[name] = EFFECTS[name](c, own, happening, half, origin)
        return c, base, shapes

    def _conditions(self, number: int, plan: Plan) -> tuple[Columns, Array, float, float]:
        """Columns and table error, half the travel and its middle."""
        fixed = np.random.default_rng([self.seed, 1])
        rng = np.random.default_rng([self.seed, 2, number])
        half = float(fixed.choice([150.0, 250.0, 400.0, 600.0]))
        origin = float(fixed.choice([0.0, 0.0, half, half * 0.3]))
        c = _motion(fixed, rng, plan, half, origin)
        _sensors(c, fixed, rng, half)
        return c, _pitch(c, fixed, half, origin), half, origin


def _motion(fixed: np.random.Generator, rng: np.random.Generator, plan: Plan, half: float, origin: float) -> Columns:
    step = 2 * half / plan.targets
    middle = origin - half + step * (np.arange(plan.targets) + 0.5)
    fixed.uniform(size=plan.targets)  # drawn and not used: without it every seed would be another machine
    interval = fixed.uniform(3.0, 9.0)
    run, direction, target, time = [], [], [], []
    now = 0.0
    for r in range(plan.runs):
        points = middle + rng.uniform(-0.5, 0.5, plan.targets) * step
        stops = [(1, t) for t in points] + [(-1, t) for t in points[::-1]]
        for d, t in stops:
            now += interval * rng.uniform(0.9, 1.1)
            run.append(r + 1)
            direction.append(d)
            target.append(t)
            time.append(now)
        now += fixed.uniform(5.0, 40.0)
    return {
        "run": np.array(run, float),
        "direction": np.array(direction, float),
        "target_mm": np.round(np.array(target), 4),
        "time_s": np.array(time),
    }


def _walk(rng: np.random.Generator, n: int, memory: float = 60.0) -> Array:
    """A smooth random course of unit size."""
    white = rng.normal(size=n + int(6 * memory))
    kernel = np.exp(-0.5 * (np.arange(-3 * memory, 3 * memory + 1) / memory) ** 2)
    course = np.convolve(white, kernel, "same")[int(3 * memory) : int(3 * memory) + n]
    return course / np.sqrt(np.sum(kernel**2))


def _lag(time: Array, value: Array, tau: float) -> Array:
    out = np.empty_like(value)
    state = value[0]
    before = time[0]
    for i, (t, v) in enumerate(zip(time, value, strict=True)):
        state += (v - state) * (1 - np.exp(-(t - before) / tau))
        before = t
        out[i] = state
    return out


def _sensors(c: Columns, fixed: np.random.Generator, rng: np.random.Generator, half: float) -> None:
    n = len(c["run"])
    t, d, run = c["time_s"], c["direction"], c["run"].astype(int)
    span = t[-1]

    def levels(values: Array) -> Array:
        """Per row, per run or per block, as it comes."""
        kind = str(fixed.choice(["row", "block", "run"]))
        if kind == "row":
            return rng.choice(values, n)
        if kind == "block":
            return np.repeat(rng.choice(values, n // 7 + 1), 7)[:n]
        return rng.choice(values, run.max() + 1)[run]

    c["velocity_mm_s"] = levels(np.array([10.0, 25.0, 50.0, 100.0])) * rng.uniform(0.98, 1.02, n)
    c["since_reversal_mm"] = rng.uniform(0.5, 1.0, n) * np.exp(rng.uniform(np.log(2.0), np.log(half), n))
    c["stroke_mm"] = rng.uniform(0.2 * half, 2 * half, n)
    c["load_kg"] = levels(np.array([0.0, 40.0, 80.0, 160.0])) + rng.normal(0, 0.5, n)
    duty = _lag(t, levels(np.array([0.2, 0.6, 1.0])), span / 12)
    heat = _lag(t, duty * fixed.uniform(4.0, 10.0), span * fixed.uniform(0.1, 0.4))
    ambient = 20 + rng.normal(0, 1.0) + 0.5 * _walk(rng, n)
    c["temp_screw_c"] = ambient + heat - heat[0] + rng.normal(0, 0.03, n)
    nut = _lag(t, duty * fixed.uniform(3.0, 8.0), span * fixed.uniform(0.03, 0.1))
    c["temp_nut_c"] = ambient + nut - nut[0] + 0.5 * _walk(rng, n, 30) + rng.normal(0, 0.03, n)
    c["temp_bed_c"] = (
        20 + rng.normal(0, 0.5) + fixed.choice([-1.0, 1.0]) * 1.2 * _walk(rng, n, 90) + rng.normal(0, 0.03, n)
    )
    c["air_temp_c"] = 20 + rng.normal(0, 0.5) + 0.9 * _walk(rng, n, 40) + rng.normal(0, 0.03, n)
    c["air_pressure_hpa"] = 1005 + rng.normal(0, 8.0) + 2.5 * _walk(rng, n, 80) + rng.normal(0, 0.05, n)
    c["air_humidity_percent"] = 50 + rng.normal(0, 5.0) + 6.0 * _walk(rng, n, 50) + rng.normal(0, 0.3, n)
    friction = 8 + 0.05 * c["velocity_mm_s"] + 0.03 * c["load_kg"]
    c["torque_percent"] = d * friction + 3.0 * rng.normal(size=n) + 2.0 * _walk(rng, n, 25)
    u = (c["target_mm"] - np.mean(c["target_mm"])) / half
    tilt = 8 * np.sin(2.1 * u + 0.4) + 6.0 * _walk(rng, n, 35) + 0.02 * c["load_kg"] * u
    c["pitch_urad"] = tilt + rng.normal(0, 0.5, n)
    c["yaw_urad"] = 5 * u**2 + 4.0 * _walk(rng, n, 20) + rng.normal(0, 0.5, n)
    c["pos_y_mm"] = levels(np.linspace(-200.0, 200.0, 5)) + rng.uniform(-1, 1, n)
    c["coolant_lpm"] = 12 + 2.0 * _walk(rng, n, 30) + rng.normal(0, 0.1, n)


def _pitch(c: Columns, fixed: np.random.Generator, half: float, origin: float) -> Array:
    u = (c["target_mm"] - origin) / half
    size = fixed.uniform(5.0, 25.0)
    f = np.zeros_like(u)
    for k in range(1, 6):
        f += size * k**-1.5 * fixed.normal() * np.sin(0.5 * np.pi * k * u + fixed.uniform(0, 6.28))
    gap = fixed.uniform(1.0, 8.0) + fixed.uniform(0, 1.0) * u + fixed.uniform(0, 0.6) * np.cos(2 * u)
    return f + fixed.uniform(-10, 10) * u - 0.5 * gap * c["direction"]


def _noise(kind: str, c: Columns, rng: np.random.Generator) -> Array:
    n = len(c["run"])
    white = rng.normal(size=n)
    if kind == "walk":
        walk = np.cumsum(rng.normal(size=n)) / np.sqrt(n)
        return white + 0.5 * (walk - walk.mean())
    return white


def _size(c: Columns, shape: Array) -> float:
    """RMS of a shape about its mean, beside any smooth function of position and direction."""
    z = shape - np.mean(shape)
    u = c["target_mm"] - np.mean(c["target_mm"])
    smooth = np.polynomial.legendre.legvander(u / np.max(np.abs(u)), 10)
    columns = np.hstack([smooth, smooth * c["direction"][:, None]])
    z = z - columns @ np.linalg.lstsq(columns, z, rcond=None)[0]
    return max(float(np.std(z)), 1e-12)


Maker = Callable[[Columns, np.random.Generator, np.random.Generator, float, float], Array]


def _cyclic(c: Columns, own: np.random.Generator, _: np.random.Generator, half: float, origin: float) -> Array:
    period = float(own.choice(PERIODS_MM))
    phase = own.uniform(0, 2 * np.pi)
    u = (c["target_mm"] - origin) / half
    angle = 2 * np.pi * c["target_mm"] / period + phase
    return (1 + own.uniform(0, 0.35) * u) * np.sin(angle) + own.uniform(0, 0.2) * np.sin(2 * angle + 1.0)


def _temperature(c: Columns, own: np.random.Generator) -> Array:
    place = str(own.choice(["screw", "nut", "bed"]))
    value = c[f"temp_{place}_c"]
    slow = _lag(c["time_s"], value, own.uniform(0.01, 0.05) * c["time_s"][-1])
    return slow - 20.0


def _saturate(z: Array, own: np.random.Generator) -> Array:
    size = float(np.max(np.abs(z))) or 1.0
    return z / (1 + own.uniform(0, 0.25) * np.abs(z) / size)


def _thermal_drift(c: Columns, own: np.random.Generator, _: np.random.Generator, half: float, origin: float) -> Array:
    if own.random() < 0.35:
        tau = own.uniform(300, 1200)
        return 1 - np.exp(-((c["time_s"] / tau) ** own.uniform(0.85, 1.1)))
    return _saturate(_temperature(c, own), own)


def _datum_step(c: Columns, own: np.random.Generator, now: np.random.Generator, half: float, origin: float) -> Array:
    at = now.uniform(0.12, 0.88) * c["time_s"][-1]
    since = np.clip(c["time_s"] - at, 0, None)
    return (c["time_s"] > at) * (1 - 0.3 * np.exp(-since / 8.0))


EFFECTS: dict[str, Maker] = {"cyclic": _cyclic, "thermal_drift": _thermal_drift, "datum_step": _datum_step}


def _unit(z: Array, usual: Array) -> Array:
    """About the usual mean, in usual standard deviations: those of the first campaign, so that the machine stays the same."""
    return (z - np.mean(usual)) / (np.std(usual) or 1.0)


Outsider = Callable[[Columns, Columns], Array]
"""The second columns are those of the first campaign."""


def _of(column: str) -> Callable[[Columns, Columns], Array]:
    return lambda c, usual: _unit(c[column], usual[column])


_humidity, _bed, _load, _cross = map(_of, ("air_humidity_percent", "temp_bed_c", "load_kg", "pos_y_mm"))


def _friction(c: Columns) -> Array:
    return c["torque_percent"] * c["direction"]


OUTSIDE_EFFECTS: dict[str, Outsider] = {
    "torque_times_temperature": lambda c, u: _unit(_friction(c), _friction(u)) * _bed(c, u),
    "feed_resonance": lambda c, _u: np.exp(-0.5 * ((c["velocity_mm_s"] - 50) / 4) ** 2),
    "cross_product": lambda c, u: _cross(c, u) * _load(c, u),
    "direction_times_humidity": lambda c, u: c["direction"] * _humidity(c, u),
}
"""Effects that no catalogue has."""
