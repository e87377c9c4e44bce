"""Known effects as physics describes them, with free fixed points, places, lags, shapes and periods.

Each `draw_*` takes a random generator and the state of the fitting campaign (for its ranges only) and returns a
`Cause` whose `form` gives µm per unit of an amplitude that the machine sets afterwards. Names are this file's own;
`equivalence` ties them to the catalogue's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import CellType, FunctionType

import numpy as np
from numpy.random import Generator
from study.grammar.environment import Floats, State

Form = Callable[[State], Floats]

STEP = 1e-6
"""Step of a derivative, relative or absolute, whichever is larger: of a period that fits a thousand times into the travel too."""
LAG_STEP_S = 30.0
"""Step from no lag, which is the mean over a row's interval as soon as there is one."""
MOST_NUMBERS = 4
"""Most numbers of an array that are parameters: two phases are, the weights of a hysteresis follow from its length."""


@dataclass(frozen=True)
class Cause:
    """One cause: `form(state)` in µm per unit amplitude, what columns carry it, and what amplitudes are physical.

    `static`: a function of position and direction alone; `of_set_up`: belongs to the instrument or its mounting, so that a
    later campaign does not have it; `constants`: of the form, by name.
    """

    name: str
    text: str
    form: Form
    columns: tuple[str, ...]
    least: float
    most: float
    signed: bool = True
    static: bool = False
    of_set_up: bool = False
    amplitude: float = 1.0
    family: str = ""
    constants: Mapping[str, float] = field(default_factory=dict)

    def values(self, state: State) -> Floats:
        """µm, shape (n,)."""
        return np.asarray(self.amplitude * self.form(state))


def slopes(form: Form) -> Iterator[tuple[str, Form]]:
    """Derivatives of a form to the numbers it was drawn with (lag, fixed point, period …), with their names, as far as its closure
    holds them: not to its amplitude, nor to the moment of a jump, which has none. Central differences; of a lag of nothing forwards.
    """
    for place, (name, cell) in enumerate(zip(form.__code__.co_freevars, form.__closure__ or (), strict=True)):
        drawn = cell.cell_contents
        if name in ("span", "moment") or not isinstance(drawn, float | np.ndarray) or np.size(drawn) > MOST_NUMBERS:
            continue
        no_lag = name == "lag_s" and drawn == 0.0
        for index in range(np.size(drawn)):
            step = np.zeros(np.shape(drawn))
            step.flat[index] = LAG_STEP_S if no_lag else STEP * max(abs(float(np.ravel(drawn)[index])), 1.0)
            ends = drawn + step, drawn if no_lag else drawn - step
            yield name, partial(_slope, *(_remade(form, place, end) for end in ends), float(np.sum(ends[0] - ends[1])))


def _slope(above: Form, below: Form, apart: float, state: State) -> Floats:
    return (above(state) - below(state)) / apart


def _remade(form: Form, place: int, number: float | Floats) -> Form:
    """A form with another number in its closure."""
    cells = list(form.__closure__ or ())
    cells[place] = CellType(float(number) if np.ndim(number) == 0 else number)
    return FunctionType(form.__code__, form.__globals__, form.__name__, form.__defaults__, tuple(cells))


def lagged(course: Floats, time_s: Floats, lag_s: float) -> Floats:
    """First-order lag of a course sampled at times, shape (n,); begins at its first value."""
    out = np.array(course, dtype=float)
    if lag_s > 0.0:
        for row in range(1, len(out)):
            keep = np.exp(-max(time_s[row] - time_s[row - 1], 0.0) / lag_s)
            out[row] = keep * out[row - 1] + (1.0 - keep) * 0.5 * (course[row] + course[row - 1])
    return out


def draw_expansion(rng: Generator, state: State) -> Cause:
    place = str(rng.choice(["screw", "nut", "bearing", "bed"], p=[0.5, 0.15, 0.15, 0.2]))
    fixed_mm = float(rng.choice([0.0, 1.0, rng.uniform(-0.3, 1.3)])) * state.axis.travel_mm
    lag_s = float(rng.choice([0.0, 0.0, rng.uniform(30.0, 600.0)]))
    uneven = float(rng.choice([0.0, rng.uniform(-0.3, 0.3)]))

    def form(now: State) -> Floats:
        warm = lagged(now.temperature_c[place], now.time_s, lag_s) - 20.0
        way_mm = now.x_mm - fixed_mm
        return np.asarray(1e-3 * way_mm * (1.0 + uneven * way_mm / now.axis.travel_mm) * warm)

    text = f"expansion about {fixed_mm:.0f} mm by temp_{place}, lag {lag_s:.0f} s, uneven {uneven:.2f}"
    constants = {"uneven": uneven}
    return Cause(
        "expansion", text, form, (f"temp_{place}_c", "target_mm"), 4.0, 24.0, signed=False, constants=constants
    )


def draw_drift(rng: Generator, state: State) -> Cause:
    if rng.random() < 0.6:
        place = str(rng.choice(["bearing", "bed", "motor", "coolant", "nut"]))
        lag_s = float(rng.choice([0.0, rng.uniform(30.0, 900.0)]))

        def by_temperature(now: State) -> Floats:
            return lagged(now.temperature_c[place], now.time_s, lag_s) - 20.0

        return Cause(
            "drift", f"offset by temp_{place}, lag {lag_s:.0f} s", by_temperature, (f"temp_{place}_c",), 0.2, 15.0
        )
    span = float(state.time_s[-1])
    tau_s = float(span * rng.uniform(0.08, 0.7))

    def settling(now: State) -> Floats:
        return np.asarray(1.0 - np.exp(-now.time_s / tau_s))

    return Cause("settling", f"offset that settles, tau {tau_s:.0f} s", settling, ("time_s",), 0.5, 40.0)


def draw_air(rng: Generator, state: State) -> Cause:
    origin_mm = float(rng.uniform(-0.2, 0.1)) * state.axis.travel_mm

    def form(now: State) -> Floats:
        return np.asarray(1e3 * (now.x_mm - origin_mm) * now.refractivity)

    columns = ("air_pressure_hpa", "air_temp_c", "target_mm")
    text = f"uncompensated air over the measured length from {origin_mm:.0f} mm"
    return Cause("air", text, form, columns, 0.9, 1.1, signed=False, of_set_up=True)


def draw_dead_path(rng: Generator, state: State) -> Cause:
    columns = ("air_pressure_hpa", "air_temp_c")
    return Cause(
        "dead_air", "air over a fixed path, m", lambda now: 1e6 * now.refractivity, columns, 0.1, 4.0, of_set_up=True
    )


def draw_backlash(rng: Generator, state: State) -> Cause:
    kind = str(rng.choice(["line", "bow", "worn", "wave"]))
    centre, width = float(rng.uniform(-0.5, 0.5)), float(rng.uniform(0.35, 0.7))
    phase, waves = float(rng.uniform(0, 6.3)), float(rng.uniform(0.4, 1.0))
    shapes: dict[str, Callable[[Floats], Floats]] = {
        "line": lambda u: u,
        "bow": lambda u: u**2 + 0.5 * centre * u,
        "worn": lambda u: np.exp(-(((u - centre) / width) ** 2)),
        "wave": lambda u: np.sin(np.pi * waves * u + phase),
    }
    text = f"backlash that varies along the axis: {kind}"
    return Cause(
        "reversal_along",
        text,
        lambda now: now.direction * shapes[kind](now.u),
        ("direction", "target_mm"),
        0.2,
        20.0,
        static=True,
        family=kind,
    )


def _rise(kind: str, length_mm: float) -> tuple[Floats, Floats]:
    """Widths (mm) and weights of play elements whose sum rises like `kind` after a reversal from a long stroke."""
    edges = length_mm * np.concatenate([[0.0], np.geomspace(0.04, 8.0, 40)])
    rises = {
        "exponential": 1.0 - np.exp(-edges / length_mm),
        "rational": edges / (edges + 0.7 * length_mm),
        "parabola": 1.0 - np.clip(1.0 - edges / (2.0 * length_mm), 0.0, 1.0) ** 2,
        "dead zone": np.clip((edges - 0.3 * length_mm) / length_mm, 0.0, 1.0),
        "stretched": 1.0 - np.exp(-np.sqrt(edges / length_mm)),
    }[kind]
    # a sum of stops f(s) = sum w min(s, 2r): slope at s is the weight of those not yet slipping
    slopes = np.diff(rises) / np.diff(edges)
    weights = slopes - np.append(slopes[1:], 0.0)
    return edges[1:], weights


def draw_lost_motion(rng: Generator, state: State) -> Cause:
    kind = str(rng.choice(["exponential", "rational", "parabola", "dead zone", "stretched"]))
    length_mm = float(np.exp(rng.uniform(np.log(0.5), np.log(0.06 * state.axis.travel_mm))))
    widths, weights = _rise(kind, length_mm)

    def form(now: State) -> Floats:
        # one elastic stop per width: its force follows the path and slips at ± half its width
        held = np.zeros(len(widths))
        force = np.empty(len(now.path_mm))
        before = now.path_mm[0]
        for index, place in enumerate(now.path_mm):
            held = np.clip(held + (place - before), -widths / 2.0, widths / 2.0)
            force[index] = float(weights @ held)
            before = place
        return -force[now.path_row]

    text = f"lost motion, {kind} over {length_mm:.2f} mm"
    return Cause("wind_up", text, form, ("since_reversal_mm", "direction"), 0.3, 30.0, signed=False)


def draw_lag(rng: Generator, state: State) -> Cause:
    power = float(rng.choice([1.0, 1.0, rng.uniform(0.85, 1.15)]))

    def form(now: State) -> Floats:
        return np.asarray(-np.sign(now.velocity_mm_s) * np.abs(now.velocity_mm_s) ** power)

    text = f"lag behind the command, speed to the power {power:.2f}"
    return Cause("lag", text, form, ("velocity_mm_s",), 0.003, 1.5, constants={"power": power})


def draw_load(rng: Generator, state: State) -> Cause:
    kind = str(rng.choice(["everywhere", "along", "with direction", "motor"], p=[0.3, 0.3, 0.25, 0.15]))
    stiff = float(rng.uniform(-0.4, 1.4)) * state.axis.travel_mm

    def form(now: State) -> Floats:
        if kind == "motor":
            return now.torque_percent
        if kind == "along":
            return now.load_kg * (now.x_mm - stiff) / now.axis.travel_mm
        return now.load_kg * (now.direction if kind == "with direction" else 1.0)

    column = "torque_percent" if kind == "motor" else "load_kg"
    return Cause("load", f"deflection by {column}, {kind}, stiff at {stiff:.0f} mm", form, (column,), 0.0005, 0.6)


def draw_cyclic(rng: Generator, state: State) -> Cause:
    pitch = state.axis.screw_pitch_mm
    periods = [
        pitch,
        pitch / 2.0,
        pitch / 4.0,
        float(rng.uniform(1.5, 40.0)),
        float(rng.uniform(0.05, 0.3)) * state.axis.travel_mm,
    ]
    period_mm = float(rng.choice(periods, p=[0.3, 0.15, 0.1, 0.3, 0.15]))
    harmonic = float(rng.choice([0.0, rng.uniform(0.1, 0.5)]))
    order, phases = int(rng.integers(2, 4)), rng.uniform(0.0, 6.3, 2)
    uneven = float(rng.choice([0.0, rng.uniform(-0.4, 0.4)]))

    def form(now: State) -> Floats:
        turn = 2.0 * np.pi * now.x_mm / period_mm
        wave = np.sin(turn + phases[0]) + harmonic * np.sin(order * turn + phases[1])
        return np.asarray((1.0 + uneven * now.u) * wave)

    text = f"cyclic, period {period_mm:.3f} mm, order {order} × {harmonic:.2f}, uneven {uneven:.2f}"
    return Cause("cycle", text, form, ("target_mm",), 0.1, 30.0, static=True, constants={"period_mm": period_mm})


def draw_cross(rng: Generator, state: State) -> Cause:
    axis = str(rng.choice(["y", "z"]))
    kind = str(rng.choice(["skew", "straight", "bow"]))
    hinge = float(rng.uniform(-1.0, 1.0))

    def form(now: State) -> Floats:
        other = (now.y_mm if axis == "y" else now.z_mm - 100.0) / 100.0
        if kind == "skew":
            return np.asarray(other * (now.u - hinge))
        return other if kind == "straight" else other**2 * (1.0 + 0.3 * hinge * now.u)

    return Cause("cross", f"place of {axis}, {kind}", form, (f"pos_{axis}_mm",), 0.1, 20.0)


def draw_angle(rng: Generator, state: State) -> Cause:
    column = str(rng.choice(["pitch_urad", "yaw_urad"]))
    return Cause("arm", f"{column} times an arm, mm", lambda now: 1e-3 * getattr(now, column), (column,), 15.0, 500.0)


def draw_datum(rng: Generator, state: State) -> Cause:
    inside = state.time_s[int(len(state) * 0.2) : int(len(state) * 0.8)]
    moment = float(rng.choice(inside)) - 0.2
    if rng.random() < 0.4:  # between two runs
        runs = np.unique(state.run)
        moment = float(state.time_s[state.run == rng.choice(runs[1:])][0]) - 0.2
    return Cause(
        "slip",
        f"reading jumps at {moment:.0f} s",
        lambda now: (now.time_s > moment) * 1.0,
        ("time_s",),
        0.3,
        40.0,
        of_set_up=True,
    )


def draw_wear(rng: Generator, state: State) -> Cause:
    centre, width = float(rng.uniform(0.2, 0.8)), float(rng.uniform(0.025, 0.09))
    kind = str(rng.choice(["bell", "cosine", "flat", "one-sided"]))
    both = bool(rng.random() < 0.5)

    def form(now: State) -> Floats:
        a = (now.x_mm / now.axis.travel_mm - centre) / width
        shape = {
            "bell": np.exp(-0.5 * a**2),
            "cosine": 0.5 * (1.0 + np.cos(np.pi * np.clip(a / 1.8, -1.0, 1.0))),
            "flat": np.clip(2.0 - np.abs(a), 0.0, 1.0),
            "one-sided": np.where(a > -1.0, np.exp(-(a + 1.0)) * np.clip((a + 1.0) * 4.0, 0.0, 1.0), 0.0),
        }[kind]
        return np.asarray(shape if both else now.direction * shape)

    travel_mm, ways = state.axis.travel_mm, "both ways" if both else "in reversal"
    text = f"wear at {centre * travel_mm:.0f} mm, {width * travel_mm:.0f} mm wide, {kind}, {ways}"
    return Cause("wear", text, form, ("target_mm",), 0.2, 40.0, static=True, family=ways)


def draw_shape(rng: Generator, state: State) -> Cause:
    waves, phase, bow = float(rng.uniform(0.5, 1.6)), float(rng.uniform(0, 6.3)), float(rng.uniform(-1, 1))

    def form(now: State) -> Floats:
        return np.asarray(np.sin(np.pi * waves * now.u + phase) + bow * now.u**2)

    return Cause(
        "shape", f"smooth change of the pitch, {waves:.2f} half waves", form, ("target_mm",), 0.3, 40.0, static=True
    )


def draw_wander(rng: Generator, state: State) -> Cause:
    waves = [(float(rng.normal()), float(rng.uniform(0.25, 1.2)), float(rng.uniform(0, 6.3))) for _ in range(4)]
    span = float(state.time_s[-1])

    def form(now: State) -> Floats:
        return np.asarray(sum(a * np.sin(2.0 * np.pi * now.time_s / (f * span) + p) for a, f, p in waves))

    return Cause("wander", "reading wanders with time", form, ("time_s",), 0.2, 40.0, of_set_up=True)


MOVING = ("mixed", "random_moves", "feeds")
ANY = ("iso_pairs", "warm_up", "random_moves", "mixed", "stairs", "feeds")
REVERSALS = ("mixed", "random_moves", "stairs")


@dataclass(frozen=True)
class Recipe:
    """How often a cause is drawn, and what its campaign must be like to show it."""

    draw: Callable[[Generator, State], Cause]
    weight: float = 1.0
    kinds: tuple[str, ...] = ANY
    loads: bool = False
    cross: bool = False
    static: bool = False


NOT_WARM_UP = tuple(kind for kind in ANY if kind != "warm_up")
RECIPES: dict[str, Recipe] = {
    "expansion": Recipe(draw_expansion, weight=2.0),
    "drift": Recipe(draw_drift, weight=1.5),
    "air": Recipe(draw_air, weight=0.7),
    "dead_air": Recipe(draw_dead_path, weight=0.7),
    "reversal_along": Recipe(draw_backlash, static=True),
    "wind_up": Recipe(draw_lost_motion, weight=1.5, kinds=REVERSALS),
    "lag": Recipe(draw_lag, weight=1.2, kinds=MOVING),
    "load": Recipe(draw_load, weight=1.3, kinds=NOT_WARM_UP, loads=True),
    "cycle": Recipe(draw_cyclic, weight=1.5, static=True),
    "cross": Recipe(draw_cross, weight=1.2, kinds=NOT_WARM_UP, cross=True),
    "arm": Recipe(draw_angle, weight=1.2, kinds=NOT_WARM_UP, loads=True),
    "slip": Recipe(draw_datum),
    "wear": Recipe(draw_wear, static=True),
    "shape": Recipe(draw_shape, weight=0.7, static=True),
    "wander": Recipe(draw_wander, weight=0.7),
}
