"""A machine of the study: plant, noise, 0 to 2 known effects, 0 or 1 outside cause, a fitting campaign and a fresh
one.

The strength of a cause is the RMS, on the rows of the fitting campaign, of what a free table of position and
direction cannot hold of it, over the standard deviation of the whole noise. A static cause that such a table holds is
scaled by its RMS beside a straight line per direction instead and marked `held`; beside an older table, which was
fitted before the cause came, it is scaled by its RMS beside a constant and is not held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from study.grammar import campaign, noise, outside, physics
from study.grammar.campaign import Axis, Variation
from study.grammar.environment import OPTIONAL, Floats, State, carry_out, draw_machine, logged
from study.grammar.environment import Machine as Surroundings
from study.grammar.noise import Noise
from study.grammar.physics import RECIPES, Cause
from study.grammar.reference import left_beside, outside_um
from study.grammar.twins import DISTANCE, course_of_time, twin

LOTS = ("strong", "weak", "outside strong", "outside weak", "clean", "pairs", "missing")
SEEDS = {"tuning": range(100_000, 200_000), "reporting": range(800_000, 900_000)}
"""Numbers of machines for trying things out, and for the figures that are reported."""

STRONG, WEAK = (1.5, 4.0), (0.5, 1.5)
SD_UM = (0.12, 2.5)
"""Standard deviations of the whole noise that a machine may have, µm."""
USUAL_SD_UM = (0.3, 1.0)
FARTHEST = 1.5
"""Largest RMS of a cause outside the table on fresh rows over that on fitting rows: how far a model may be asked to extrapolate."""
HELD = 0.25
"""A cause is held where a free table leaves less than this part of the noise's standard deviation."""
OLDER = {"reversal_along": 0.7, "wear": 0.7, "shape": 0.7, "cycle": 0.25}
"""How often a static cause came after the table had been measured."""


@dataclass(frozen=True)
class Campaign:
    """Rows with what is in them, µm, shape (n,) each; `records` is what is written down."""

    state: State
    pitch_um: Floats
    cause_um: tuple[Floats, ...]
    noise_um: Floats
    records: dict[str, Floats]

    @property
    def error_um(self) -> Floats:
        return self.pitch_um + self.caused_um + self.noise_um

    @property
    def caused_um(self) -> Floats:
        """All causes together."""
        return np.asarray(sum(self.cause_um, np.zeros(len(self.state))))


@dataclass(frozen=True)
class Drawn:
    """One machine with its campaigns; `older` is the campaign of an older table, where there is one."""

    seed: int
    lot: str
    kind: str
    noise: Noise
    sd_um: float
    causes: tuple[Cause, ...]
    ratios: tuple[float, ...]
    held: tuple[bool, ...]
    fit: Campaign
    fresh: Campaign
    older: Campaign | None
    removed: tuple[str, ...]
    attempts: int

    def truth(self) -> dict[str, object]:
        """What was put in, for a report."""
        causes = []
        for index, (cause, ratio, held) in enumerate(zip(self.causes, self.ratios, self.held, strict=True)):
            values = self.fit.cause_um[index]
            rival, distance = twin(cause, self.fit.state, self.noise.covariance(self.fit.state), set(self.fit.records))
            causes.append(
                {
                    "name": cause.name,
                    "family": cause.family,
                    "what": cause.text,
                    "columns": list(cause.columns),
                    "amplitude": cause.amplitude,
                    "ratio": ratio,
                    "held": held,
                    "static": cause.static,
                    "of_set_up": cause.of_set_up,
                    "outside_um": outside_um(values, self.fit.state),
                    "rms_um": float(np.std(values)),
                    "course_of_time": course_of_time(cause, self.fit.state),
                    "nearest_other": [rival, min(distance, 1e9)],
                    "twin": not cause.static and cause.name != "outside" and distance < DISTANCE,
                }
            )
        return {
            "seed": self.seed,
            "lot": self.lot,
            "campaign": self.kind,
            "rows": len(self.fit.state),
            "travel_mm": self.fit.state.axis.travel_mm,
            "noise": self.noise.kind,
            "noise_um": self.sd_um,
            "causes": causes,
            "older_table": self.older is not None,
            "removed": list(self.removed),
            "logged": [name for name in self.fit.records if name in OPTIONAL],
        }


@dataclass(frozen=True)
class _Order:
    """What is decided before anything is tried: refused trials must not change the shares of the causes."""

    names: tuple[str, ...]
    ratios: tuple[float, ...]
    noise: str
    family: str
    older: bool


@dataclass(frozen=True)
class _Plant:
    axis: Axis
    surroundings: Surroundings
    lead: float
    waves: tuple[tuple[float, float, float], ...]
    backlash_um: float

    def pitch_um(self, state: State) -> Floats:
        part = state.x_mm / state.axis.travel_mm
        values = self.lead * state.u - 0.5 * self.backlash_um * state.direction
        for amplitude, length, phase in self.waves:
            values = values + amplitude * np.sin(2.0 * np.pi * part / length + phase)
        return np.asarray(values)


def draw(lot: str, seed: int) -> Drawn:
    """The machine of a lot of `LOTS` with a number of `SEEDS`; the same each time. Raises RuntimeError where none can
    be made.
    """
    order = _order(np.random.default_rng([seed, LOTS.index(lot)]), lot, seed)
    for attempt in range(400):
        made = _attempt(np.random.default_rng([seed, LOTS.index(lot), 1, attempt]), lot, seed, order, attempt)
        if made is not None:
            return made
    raise RuntimeError(f"no machine of lot {lot} with {order.names} after 400 trials (seed {seed})")


def _order(rng: Generator, lot: str, seed: int) -> _Order:
    strong, weak = float(rng.uniform(*STRONG)), float(rng.uniform(*WEAK))
    names = list(RECIPES)
    if lot == "missing":  # what has no sensor of its own has nothing that could be missing
        names = [name for name in names if not RECIPES[name].static and name not in ("slip", "wander")]
    if lot == "pairs":
        names = [name for name in names if not RECIPES[name].static or name == "cycle"]
    weights = np.array([RECIPES[name].weight for name in names])
    picked = tuple(str(name) for name in rng.choice(names, size=2, replace=False, p=weights / weights.sum()))
    kind = noise.KINDS[seed % len(noise.KINDS)] if lot == "clean" else str(rng.choice(noise.KINDS))
    older = bool(rng.random() < OLDER.get(picked[0], 0.0))
    beside = bool(rng.random() < 0.25)
    while beside and RECIPES[picked[1]].static:
        picked = (picked[0], str(rng.choice(names)))
    second = float(rng.uniform(*STRONG))
    family = outside.draw_family(rng)
    if lot == "clean":
        return _Order((), (), kind, "", False)
    if lot.startswith("outside"):
        ratio = strong if lot == "outside strong" else weak
        return _Order((picked[1],) * beside, (ratio, *((second,) * beside)), kind, family, False)
    if lot == "pairs":
        return _Order(picked, (strong, second), kind, "", False)
    return _Order(picked[:1], (weak if lot == "weak" else strong,), kind, "", older and lot in ("strong", "weak"))


def _attempt(rng: Generator, lot: str, seed: int, order: _Order, attempt: int) -> Drawn | None:
    recipes = [RECIPES[name] for name in order.names]
    kinds = [k for k in campaign.KINDS if all(k in recipe.kinds for recipe in recipes)]
    if order.noise in ("speed", "mixed"):
        kinds = [k for k in kinds if k in physics.MOVING] or kinds
    if order.family:
        kinds = [k for k in kinds if k != "warm_up"] or kinds
    if not kinds:
        kinds = list(physics.MOVING[:2])
    kind = str(rng.choice(kinds))
    axis = campaign.draw_axis(rng)
    varied = Variation(
        loads=any(r.loads for r in recipes) or bool(order.family) or rng.random() < 0.5,
        cross=any(r.cross for r in recipes) or bool(order.family) or rng.random() < 0.4,
        slow=bool(rng.random() < 0.5),
    )
    plant = _Plant(
        axis,
        draw_machine(rng),
        float(rng.normal(0.0, 6.0)),
        tuple(
            (float(rng.normal(0.0, 2.5)), float(rng.uniform(0.45, 1.8)), float(rng.uniform(0, 6.3))) for _ in range(3)
        ),
        float(rng.uniform(1.0, 15.0)),
    )
    key = (seed, LOTS.index(lot), attempt)
    state = _state(rng, plant, kind, varied, (*key, 0))
    causes: list[Cause] = []
    if order.family:
        composed = outside.draw_outside(rng, state, order.family)
        if composed is None:
            return None
        causes.append(composed)
    causes += [recipe.draw(rng, state) for recipe in recipes]
    scaled = _scaled(rng, state, causes, order)
    if scaled is None:
        return None
    noisy = noise.draw_noise(rng, order.noise, 1.0)
    causes, sd_um = scaled
    noisy = noise.scaled(noisy, sd_um / noisy.sd_um(state))
    held = tuple(not order.older and outside_um(cause.values(state), state) < HELD * sd_um for cause in causes)
    if any(held) and not all(cause.static for cause, one in zip(causes, held, strict=True) if one):
        return None
    columns, removed = _columns(rng, lot, causes)
    fit = _campaign(rng, plant, noisy, causes=causes, state=state, columns=columns)
    again = kind if rng.random() < 0.5 or "mixed" not in kinds else "mixed"
    fresh_state = _fresh_state(rng, plant, again, varied, fit=fit, causes=causes)
    if fresh_state is None:
        return None
    fresh = _campaign(rng, plant, noisy, causes=causes, state=fresh_state, columns=columns, fresh=True)
    older = None
    if order.older:
        before = _state(rng, plant, "iso_pairs", varied, (*key, 2))
        older = _campaign(rng, plant, noisy, causes=(), state=before, columns=columns)
    return Drawn(
        seed,
        lot,
        kind,
        noisy,
        noisy.sd_um(state),
        tuple(causes),
        order.ratios,
        held,
        fit,
        fresh,
        older,
        removed,
        attempt + 1,
    )


def _state(rng: Generator, plant: _Plant, kind: str, varied: Variation, key: tuple[int, ...]) -> State:
    moves = campaign.plan(rng, plant.axis, kind, varied)
    heat, room_k = float(rng.uniform(0.5, 2.0)), float(rng.uniform(0.2, 1.5))
    state = carry_out(rng, plant.surroundings, plant.axis, moves, heat=heat, room_k=room_k)
    return replace(state, key=key)


def _fresh_state(
    rng: Generator, plant: _Plant, kind: str, varied: Variation, *, fit: Campaign, causes: Sequence[Cause]
) -> State | None:
    """A campaign in other conditions that no known cause makes far larger than the fitting one did; None where none is met."""
    for _ in range(30):
        state = _state(rng, plant, kind, varied, (*fit.state.key[:-1], 1))
        known = [
            pair for pair in zip(causes, fit.cause_um, strict=True) if not pair[0].static and pair[0].name != "outside"
        ]
        sizes = [(outside_um(cause.values(state), state), outside_um(here, fit.state)) for cause, here in known]
        if all(there <= FARTHEST * here for there, here in sizes):
            return state
    return None


def _scaled(rng: Generator, state: State, causes: Sequence[Cause], order: _Order) -> tuple[list[Cause], float] | None:
    """Causes with amplitudes, and the noise's standard deviation, that give the ratios asked for within physical
    bounds.
    """
    sizes = []
    for cause, ratio in zip(causes, order.ratios, strict=True):
        values = cause.form(state)
        size = outside_um(values, state)
        if cause.static:
            line = np.column_stack([np.ones(len(state)), state.u, state.direction, state.u * state.direction])
            whole = float(np.std(left_beside(values, line[:, :1] if order.older else line)))
            size = whole if order.older or ratio * size < HELD * whole else size
        sizes.append(size)
    if any(size < 1e-9 for size in sizes):
        return None
    bounds = [
        (max(cause.least, 1e-3 / size) * size / ratio, cause.most * size / ratio)
        for cause, size, ratio in zip(causes, sizes, order.ratios, strict=True)
    ]
    for low, high in (USUAL_SD_UM, SD_UM):
        least, most = max([low, *(b[0] for b in bounds)]), min([high, *(b[1] for b in bounds)])
        if least < most:
            sd_um = float(np.exp(rng.uniform(np.log(least), np.log(most))))
            made = []
            for cause, size, ratio in zip(causes, sizes, order.ratios, strict=True):
                sign = float(rng.choice([-1.0, 1.0])) if cause.signed else 1.0
                made.append(replace(cause, amplitude=sign * ratio * sd_um / size))
            return made, sd_um
    return None


_KEPT = ("time_s", "velocity_mm_s", "since_reversal_mm", "stroke_mm")


def _columns(rng: Generator, lot: str, causes: Sequence[Cause]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Columns that are logged, and the ones that a cause needs and that are not."""
    needed = {name for cause in causes for name in cause.columns} & set(OPTIONAL)
    chosen = [name for name in OPTIONAL if name in needed or name in _KEPT or rng.random() < 0.75]
    if lot != "missing":
        return tuple(chosen), ()
    if rng.random() < 0.4:
        return (), tuple(sorted(needed))
    gone = set(needed)
    if any(name.startswith("temp_") for name in needed):
        gone |= {name for name in OPTIONAL if name.startswith("temp_")}
    return tuple(name for name in chosen if name not in gone), tuple(sorted(needed))


def _campaign(
    rng: Generator,
    plant: _Plant,
    noisy: Noise,
    *,
    causes: Sequence[Cause],
    state: State,
    columns: Sequence[str],
    fresh: bool = False,
) -> Campaign:
    pitch_um, noise_um = plant.pitch_um(state), noisy.draw(rng, state)
    cause_um = tuple(cause.values(state) * (0.0 if fresh and cause.of_set_up else 1.0) for cause in causes)
    total = pitch_um + np.asarray(sum(cause_um, np.zeros(len(state)))) + noise_um
    return Campaign(state, pitch_um, cause_um, noise_um, logged(rng, state, total, columns))
