"""Causes outside every catalogue, composed from a grammar.

    cause  := factor | factor × factor | mask · factor × factor
    factor := form(column) | form(lag(column)) | play(column) | relay(column) | hidden state | direction
    form   := wave | step | hinge | bump | power | switches | chirp | bend
    mask   := moving rows | one run | every tenth row | one row in ten at random | one load
A composition that the table or what is known of feed axes can nearly represent is refused (`left_of_known`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from study.grammar.environment import Floats, State
from study.grammar.physics import Cause, Form, lagged
from study.grammar.reference import free_table, left_beside

Univariate = Callable[[Floats], Floats]
HIDDEN = ""
"""Stands for a column that nobody can log."""

LEAST_LEFT = 0.5
"""Smallest part (RMS) that must be left beside the table and all known forms at once."""
LEAST_OUTSIDE_TABLE = 0.2


@dataclass(frozen=True)
class Column:
    """A quantity that a factor may take: logged name, value of a state, range over the fitting campaign, most waves
    along it.
    """

    name: str
    get: Form
    low: float
    high: float
    waves: float

    def scaled(self, state: State) -> Floats:
        """0 to 1 over the range of the fitting campaign."""
        return np.asarray((self.get(state) - self.low) / (self.high - self.low))


def columns(state: State) -> dict[str, Column]:
    """The columns that take at least three values in a campaign."""
    getters: dict[str, tuple[Form, float]] = {
        "target_mm": (lambda s: s.x_mm, 6.0),
        "time_s": (lambda s: s.time_s, 6.0),
        "since_reversal_mm": (lambda s: s.since_reversal_mm, 3.0),
        "stroke_mm": (lambda s: s.stroke_mm, 2.0),
        "velocity_mm_s": (lambda s: s.velocity_mm_s, 1.5),
        "load_kg": (lambda s: s.load_kg, 1.5),
        "pos_y_mm": (lambda s: s.y_mm, 2.5),
        "pos_z_mm": (lambda s: s.z_mm, 2.5),
        "pitch_urad": (lambda s: s.pitch_urad, 2.0),
        "air_pressure_hpa": (lambda s: s.air_pressure_hpa, 2.0),
        "air_temp_c": (lambda s: s.air_temp_c, 2.0),
    }
    for place in state.temperature_c:
        getters[f"temp_{place}_c"] = (lambda s, place=place: s.temperature_c[place], 2.5)
    found = {}
    for name, (get, waves) in getters.items():
        values = get(state)
        if len(np.unique(np.round(values, 6))) >= 3:
            found[name] = Column(name, get, float(values.min()), float(values.max()), waves)
    return found


_FORM_SHARES = {
    "wave": 0.24,
    "step": 0.12,
    "hinge": 0.14,
    "bump": 0.14,
    "power": 0.1,
    "switches": 0.08,
    "chirp": 0.08,
    "bend": 0.1,
}


def _always(state: State) -> Floats:
    return np.ones(len(state))


def _direction(state: State) -> Floats:
    return state.direction


def draw_form(rng: Generator, waves: float) -> tuple[str, Univariate]:
    """A function of a column scaled to 0 … 1, with its text."""
    kind = str(rng.choice(list(_FORM_SHARES), p=list(_FORM_SHARES.values())))
    place, phase = float(rng.uniform(0.25, 0.75)), float(rng.uniform(0.0, 6.3))
    count, width = float(rng.uniform(0.5, waves)), float(rng.uniform(0.07, 0.25))
    power = float(rng.choice([0.5, 2.0, 3.0, 4.0]))
    edges = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(3, 8))))
    forms: dict[str, tuple[str, Univariate]] = {
        "wave": (f"wave {count:.2f}", lambda w: np.sin(2.0 * np.pi * count * w + phase)),
        "step": (f"step {place:.2f}", lambda w: np.where(w > place, 1.0, -1.0)),
        "hinge": (f"hinge {place:.2f}", lambda w: np.maximum(w - place, 0.0)),
        "bump": (f"bump {place:.2f} ± {width:.2f}", lambda w: np.exp(-0.5 * ((w - place) / width) ** 2)),
        "power": (
            f"power {power:.1f}",
            lambda w: np.sign(w - 0.5) ** (power % 2.0 == 1.0) * np.abs(2.0 * w - 1.0) ** power,
        ),
        "switches": (f"switches {len(edges)}", lambda w: np.where(np.searchsorted(edges, w) % 2 == 0, 1.0, -1.0)),
        "chirp": (
            f"chirp {count:.1f}",
            lambda w: np.sin(2.0 * np.pi * count * (0.4 * w + 0.8 * w**2) + phase),
        ),
        "bend": (f"bend {place:.2f}", lambda w: np.abs(w - place)),
    }
    return forms[kind]


def _plain(rng: Generator, column: Column) -> tuple[str, Form]:
    text, form = draw_form(rng, column.waves)
    return f"{text} of {column.name}", lambda s: form(column.scaled(s))


def _lag(rng: Generator, column: Column, span_s: float) -> tuple[str, Form]:
    text, form = draw_form(rng, column.waves)
    lag_s = float(rng.uniform(0.02, 0.25)) * span_s
    return f"{text} of {column.name} behind by {lag_s:.0f} s", lambda s: form(lagged(column.scaled(s), s.time_s, lag_s))


def _play(rng: Generator, column: Column) -> tuple[str, Form]:
    width = float(rng.uniform(0.1, 0.3))

    def form(state: State) -> Floats:
        at, out = 0.5, np.empty(len(state))
        for row, value in enumerate(column.scaled(state)):
            at = min(max(at, value - width), value + width)
            out[row] = at - value
        return out / width

    return f"play {width:.2f} of {column.name}", form


def _relay(rng: Generator, column: Column) -> tuple[str, Form]:
    low, high = float(rng.uniform(0.2, 0.45)), float(rng.uniform(0.55, 0.8))

    def form(state: State) -> Floats:
        on, out = -1.0, np.empty(len(state))
        for row, value in enumerate(column.scaled(state)):
            on = 1.0 if value > high else -1.0 if value < low else on
            out[row] = on
        return out

    return f"relay {low:.2f}/{high:.2f} of {column.name}", form


def _hidden(rng: Generator, span_s: float) -> tuple[str, Form]:
    mean_s = float(rng.uniform(0.06, 0.2)) * span_s

    def form(state: State) -> Floats:
        own = np.random.default_rng([*state.key, 77])
        edges = np.cumsum(own.exponential(mean_s, 400))
        return np.where(np.searchsorted(edges, state.time_s) % 2 == 0, 1.0, -1.0)

    return f"hidden state that switches about every {mean_s:.0f} s", form


def _mask(rng: Generator, state: State) -> tuple[str, Form, str]:
    """Its text, which rows it takes, and its kind."""
    kinds = ["one run", "every tenth", "one in ten"]
    kinds += ["moving", "moving"] if 0.15 < float(np.mean(state.moving)) < 0.85 else []
    kinds += ["load"] if len(np.unique(state.load_kg)) > 2 else []
    kind = str(rng.choice(kinds))
    if kind == "moving":
        return "moving rows", lambda s: s.moving * 1.0, kind
    if kind == "load":
        level = float(np.median(state.load_kg))
        return f"load above {level:.0f} kg", lambda s: (s.load_kg > level) * 1.0, kind
    if kind == "one run":
        run = float(rng.choice(np.unique(state.run)[1:]))
        return f"run {run:.0f}", lambda s: (s.run == run) * 1.0, kind
    if kind == "every tenth":
        first = int(rng.integers(10))
        return "every tenth row", lambda s: (np.arange(len(s)) % 10 == first) * 1.0, kind
    return "one row in ten", lambda s: (np.random.default_rng([*s.key, 78]).random(len(s)) < 0.1) * 1.0, kind


FAMILIES = ("product", "with direction", "alone", "lag", "play", "relay", "hidden", "partial")
_SHARES = (0.4, 0.08, 0.06, 0.08, 0.06, 0.08, 0.08, 0.16)


def draw_family(rng: Generator) -> str:
    return str(rng.choice(FAMILIES, p=_SHARES))


def draw_outside(rng: Generator, state: State, family: str) -> Cause | None:
    """One composition of a family of `FAMILIES`, None when the known forms represent it on these rows."""
    here = columns(state)
    moves = [name for name in here if name != "target_mm"]
    slow = [name for name in moves if name.startswith(("temp_", "air_"))]
    span = float(state.time_s[-1])
    x = here["target_mm"]
    one = here[str(rng.choice(moves))]
    carried: tuple[str, ...]
    mask: tuple[str, Form, str] = ("", _always, "")
    if family in ("lag", "play", "relay"):
        name = str(rng.choice(slow))
        first = (
            _lag(rng, here[name], span)
            if family == "lag"
            else {"play": _play, "relay": _relay}[family](rng, here[name])
        )
        second = _plain(rng, x)
        carried = (name, "target_mm")
    elif family == "hidden":
        first = _hidden(rng, span)
        beside = str(rng.choice(["target_mm", "direction", HIDDEN], p=[0.6, 0.2, 0.2]))
        second = _plain(rng, x) if beside == "target_mm" else ("direction", _direction) if beside else ("", _always)
        carried = ("time_s", *([beside] if beside == "target_mm" else []))
    elif family == "with direction":
        first, second, carried = _plain(rng, one), ("direction", _direction), (one.name,)
    elif family == "alone":
        first, second, carried = _plain(rng, one), ("", _always), (one.name,)
    else:
        other = x if rng.random() < 0.65 else here[str(rng.choice([name for name in moves if name != one.name]))]
        first, second, carried = _plain(rng, one), _plain(rng, other), (one.name, other.name)
        if family == "partial":
            mask = _mask(rng, state)
            first, carried = (first, carried) if rng.random() < 0.3 else (_plain(rng, x), ("target_mm",))
            second = second if len(carried) == 2 else ("", _always)
    f, g, m = first[1], second[1], mask[1]

    def form(now: State) -> Floats:
        return np.asarray(m(now) * f(now) * g(now))

    values = form(state)
    if float(np.std(values)) < 1e-6:
        return None
    beside_table = left_beside(values, free_table(state))
    share = float(np.std(beside_table)) / float(np.sqrt(np.mean(values**2)))
    if share < LEAST_OUTSIDE_TABLE or left_of_known(values, state) < LEAST_LEFT:
        return None
    text = " × ".join(part for part in (mask[0] and f"on {mask[0]}", first[0], second[0]) if part)
    kind = f"partial: {mask[2]}" if mask[0] else family
    return Cause("outside", text, form, tuple(dict.fromkeys(carried)), 0.0, 60.0, family=kind)


def left_of_known(values: Floats, state: State) -> float:
    """Part (RMS) of what is outside the table that is left beside all known forms together, or beside one jump of the
    reading.
    """
    u, d, t = state.u, state.direction, state.time_s / float(state.time_s[-1])
    known: list[Floats] = []
    for course in (*state.temperature_c.values(), state.refractivity, *(np.exp(-t / tau) for tau in (0.1, 0.4, 2.0))):
        known += [course, course * u]
    known += [state.load_kg, state.load_kg * u, state.load_kg * d, state.load_kg * d * u, state.torque_percent]
    known += [state.velocity_mm_s, state.pitch_urad, state.yaw_urad]
    for place in (state.y_mm, state.z_mm):
        known += [place, place * u, place**2]
    known += [d * np.exp(-state.since_reversal_mm / (part * state.axis.travel_mm)) for part in (0.003, 0.01, 0.04)]
    table = free_table(state)
    outside = left_beside(values, table)
    whole = float(np.sqrt(np.mean(outside**2))) or 1.0
    both = np.column_stack([table, *(k / (np.std(k) or 1.0) for k in known)])
    left = float(np.sqrt(np.mean(left_beside(values, both) ** 2))) / whole
    rows = np.arange(len(state))
    steps = left_beside((rows[:, None] >= np.arange(8, len(state) - 8, 4)) * 1.0, table)
    alike = (steps.T @ outside) ** 2 / np.maximum(np.sum(steps**2, axis=0) * float(outside @ outside), 1e-12)
    return min(left, float(np.sqrt(1.0 - min(float(np.max(alike)), 1.0))))
