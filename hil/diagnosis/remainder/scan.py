"""A scan for structure of any form: products of harmonics of every pair of columns, with and without the direction.

Each column is scaled to its own range; cosines and sines of half a period to 3.5 periods along it resolve steps, hinges and waves
alike, and finer ones along position and time resolve beats. A group of such products is tested beside everything in the null: its
share of the residual sum of squares is Beta distributed, whatever the columns. Of some ten thousand groups the best one is asked for.
How likely that is by chance the residual itself says, with the signs of its rows drawn anew: the rows keep their sizes, so that a few
rows that vary more than the others, as fast ones do, are no structure (Rademacher weights of the wild bootstrap).
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Projection
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.search.structure import usable_columns

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

COARSE, STEP = 3.5, 0.5
"""Most periods along a column, and the step between them: 1, 2 and 3.5 periods found 22, 29 and 30 of 30 causes of one set."""
FINE_POSITION, FINE_TIME = 16.0, 12.0
"""The same along position and along time, together."""
FINER_POSITION, COARSER = 8.0, 2.0
"""The same along the position where up to so few along another column multiply it: a part that turns, and what changes its error."""
FEW_LEVELS = 8
"""Distinct values up to which a column is set in steps."""
RESCORED = 25
"""Best groups, at most GROUPS of the same columns, that are tested under every noise model nearly as good."""
WORSE = 12.0
"""-log10 of a probability by which a group may be behind the best of its batch to stand for its columns."""
GROUPS = 2
"""Groups that stand for a set of columns."""
LEFT = 1e-4
"""Share of a product's squared norm that must be left beside the null; single precision resolves no less."""
BATCH = 1024
"""Groups tested together."""
WIDTHS = (2, 4)
"""Columns of a group of one column and of a product of two."""
LEAST_SCALE = 1.0 / math.log(10.0)
"""Scale of -log10 of the smallest of many probabilities in even noise, which is Gumbel distributed; where rows differ it is larger."""
NEARLY = 1.0
"""Score below that from which the scan fires, down to which the signs are asked."""


@dataclass(frozen=True, eq=False)
class Variable:
    """A column scaled to 0 … 1 between its 2 % and 98 % quantiles, (n,); levels: its values where they are few, ascending.

    A column of few levels has no waves but steps: from each level on, and at it alone. They are numbered like periods.
    """

    name: str
    u: Floats
    levels: tuple[float, ...]

    def periods(self, most: float) -> Floats:
        """Periods along it, or the numbers of its steps, (k,)."""
        if self.levels:
            return np.arange(1.0, len(self.levels))
        return np.arange(STEP, most + 1e-9, STEP)

    def waves(self, periods: Floats) -> Floats:
        """Cosine and sine, or the two steps, of each, (k, 2, n)."""
        if self.levels:
            middle = np.array([(a + b) / 2 for a, b in itertools.pairwise(self.levels)] + [np.inf])
            first = np.asarray(periods, dtype=np.int64) - 1
            from_here = self.u[None, :] > middle[first][:, None]
            return np.stack([from_here, from_here & (self.u[None, :] < middle[first + 1][:, None])], axis=1).astype(
                float
            )
        angle = 2.0 * np.pi * np.asarray(periods)[:, None] * self.u[None, :]
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@dataclass(frozen=True)
class Group:
    """A product: periods along each of one or two columns (`Variable`), and whether it changes sign with the direction."""

    first: Variable
    periods: float
    second: Variable | None = None
    second_periods: float = 0.0
    with_direction: bool = False

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The columns that its waves run along."""
        return (self.first,) if self.second is None else (self.first, self.second)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        names = [self.first.name, *([self.second.name] if self.second else [])]
        return (*sorted(names), *(["direction"] if self.with_direction else []))

    @property
    def width(self) -> int:
        """Number of its columns."""
        return 2 if self.second is None else 4

    def design(self, d: Floats) -> Floats:
        """Its columns, shape (n, 2) or (n, 4)."""
        waves = self.first.waves(np.array([self.periods]))[0].T
        if self.second is not None:
            other = self.second.waves(np.array([self.second_periods]))[0].T
            waves = (waves[:, :, None] * other[:, None, :]).reshape(len(d), -1)
        return np.asarray(waves * d[:, None] if self.with_direction else waves, dtype=np.float64)


@dataclass(frozen=True)
class Scan:
    """The best groups with -log10 of the probability that chance reaches as much with any group, best first.

    batches: all groups as they were tested together, with -log10 of the probability of each by itself, shape (G,)
    uneven: columns of which the signs say that chance reaches as much
    """

    best: tuple[tuple[Group, float], ...]
    batches: tuple[tuple[Sequence[Group], Floats], ...]
    uneven: frozenset[tuple[Variable, ...]]

    @cached_property
    def by_columns(self) -> tuple[tuple[Group, ...], ...]:
        """The best groups of each set of columns, at most GROUPS, the best set first: asked for when what is left must be named."""
        sets: dict[tuple[str, str, bool], list[tuple[float, Group]]] = {}
        for groups, raw in self.batches:
            scores = raw
            if self.uneven:
                scores = np.where([group.variables in self.uneven for group in groups], -np.inf, raw)
            for i in np.flatnonzero(scores > np.max(scores) - WORSE).tolist():
                one = groups[i]
                key = one.first.name, one.second.name if one.second else "", one.with_direction
                sets.setdefault(key, []).append((float(scores[i]), one))
        ordered = [sorted(own, key=lambda pair: -pair[0])[:GROUPS] for own in sets.values()]
        return tuple(tuple(group for _, group in own) for own in sorted(ordered, key=lambda own: -own[0][0]))

    @property
    def score(self) -> float:
        """Of the best group, with the number of groups."""
        return self.best[0][1] if self.best else -np.inf


def variables(campaign: CampaignRows, *, signed: bool = False) -> tuple[Variable, ...]:
    """The columns that vary and may carry something; the velocity as a speed where the direction tells its sign, if not `signed`."""
    values = {name: campaign.columns[name] for name in usable_columns(campaign)}
    if "velocity_mm_s" in values and campaign.survey.has("direction") and not signed:
        values["velocity_mm_s"] = np.abs(values["velocity_mm_s"])
    return tuple(scaled(name, one) for name, one in values.items() if np.ptp(one) > 0.0)


def scaled(name: str, values: Floats) -> Variable:
    """A column that varies, from its values (n,)."""
    low, high = np.quantile(values, (0.02, 0.98))
    if high <= low:
        low, high = float(np.min(values)), float(np.max(values))
    u = (values - low) / (high - low)
    levels = np.unique(np.round(u, 3))
    return Variable(name, u, tuple(levels.tolist()) if len(levels) <= FEW_LEVELS else ())


def scan(null: Null, columns: Sequence[Variable]) -> Scan:
    """Tests every group under the best noise model, and the best ones again under those nearly as good; the worst counts.

    Waves of one column share half of the chance of a false alarm, products of two the other half: of these there are many more. Where
    a group nearly fires, or does, the signs say how likely it is among the groups of its columns, under the best noise model.
    """
    campaign = null.linear.campaign
    d = campaign.d if campaign.survey.has("direction") else None
    batches: list[tuple[Sequence[Group], Floats]] = []
    for groups, design in _batches(columns, d):
        batches.append((groups, -log10_probability(null.best, design)))
    tests = {width: sum(len(groups) for groups, _ in batches if groups[0].width == width) for width in WIDTHS}
    known = {width: math.log10(len(WIDTHS) * max(count, 1)) for width, count in tests.items()}
    found = _best_of_each(batches, known)
    scores = np.array([score for score, _ in found])
    for width in WIDTHS:
        mine = [i for i, (score, group) in enumerate(found) if group.width == width and score > 0.0]
        if not mine:
            continue
        designs = [found[i][1].design(campaign.d) for i in mine]
        stacked = np.stack([design.T for design in designs]).astype(np.float32)
        for projection in null.nearly_as_good:
            scores[mine] = np.minimum(scores[mine], -log10_probability(projection, stacked) - known[width])
    fires = policy().scan_fires_at
    settled, uneven = -np.inf, set()
    for own in dict.fromkeys(group.variables for _, group in found):
        mine = [i for i, (_, group) in enumerate(found) if group.variables == own]
        top = float(np.max(scores[mine]))
        if top <= fires - NEARLY or top <= settled:
            continue
        by_chance = best_by_chance(null, own, d)
        for i in mine:
            width = found[i][1].width
            chance = by_chance[width]
            scores[i] = chance.score(scores[i] + known[width]) - known[width] + math.log10(chance.groups)
        top = float(np.max(scores[mine]))
        if top >= fires:
            settled = max(settled, top)
        elif top < fires - NEARLY:
            uneven.add(own)
    best = [(group, float(score)) for (_, group), score in zip(found, scores, strict=True)]
    return Scan(tuple(sorted(best, key=lambda pair: -pair[1])), tuple(batches), frozenset(uneven))


def _best_of_each(
    batches: Sequence[tuple[Sequence[Group], Floats]], known: dict[int, float]
) -> list[tuple[float, Group]]:
    """The best groups with their scores by number, best first: at most GROUPS of the same columns, so that those of a few uneven rows
    do not keep out a cause of all rows.
    """
    if not batches:
        return []
    every = [group for groups, _ in batches for group in groups]
    scores = np.concatenate([raw - known[groups[0].width] for groups, raw in batches])
    taken: Counter[tuple[Variable, ...]] = Counter()
    out: list[tuple[float, Group]] = []
    for i in np.argsort(-scores).tolist():
        group = every[i]
        if taken[group.variables] < GROUPS:
            taken[group.variables] += 1
            out.append((float(scores[i]), group))
            if len(out) == RESCORED:
                break
    return out


@dataclass(frozen=True)
class Chance:
    """What the best of some groups reaches by chance, -log10 of a probability: Gumbel distributed with this location and scale."""

    groups: int
    location: float
    scale: float

    def score(self, reached: float) -> float:
        """-log10 of the probability that chance reaches as much."""
        return -math.log10(max(-math.expm1(-math.exp(-(reached - self.location) / self.scale)), 1e-300))


def best_by_chance(null: Null, columns: Sequence[Variable], d: Floats | None) -> dict[int, Chance]:
    """By width, the best group of some columns in the residual with the signs of its rows drawn anew."""
    rest, rss = null.signs_anew
    most = {width: np.zeros(len(rss)) for width in WIDTHS}
    count = dict.fromkeys(WIDTHS, 0)
    for groups, design in _batches(columns, d):
        width = groups[0].width
        count[width] += len(groups)
        most[width] = np.maximum(most[width], np.max(_explained(null.best, design, rest), axis=0) / rss)
    out = {}
    for width, share in most.items():
        reached = -log10_tail(share, width, null.best.dof)
        scale = max(math.sqrt(6.0) / math.pi * float(np.std(reached)), LEAST_SCALE)
        out[width] = Chance(max(count[width], 1), float(np.mean(reached)) - float(np.euler_gamma) * scale, scale)
    return out


def log10_probability(projection: Projection, design: Singles) -> Floats:
    """Log10 of the probability in noise of as much as each group (G, w, n) explains, shape (G,)."""
    explained = _explained(projection, design, projection.rest[:, None])[:, 0]
    return log10_tail(explained / float(projection.rss), design.shape[1], projection.dof)


def _explained(projection: Projection, design: Singles, rest: Floats) -> Floats:
    """Squares that each group (G, w, n) explains of each whitened residual with the null projected out (n, k), shape (G, k)."""
    count, width, n = design.shape
    flat = design.reshape(count * width, n)
    white = np.ascontiguousarray(projection.whitened.whiten(flat.T).T)
    shadow = (white @ projection.projected.astype(np.float32)).reshape(count, width, -1)
    blocks = white.reshape(count, width, n)
    whole = blocks @ blocks.transpose(0, 2, 1)
    raw = np.einsum("gii->gi", whole)
    inner = whole - shadow @ shadow.transpose(0, 2, 1)
    b = (white @ rest.astype(np.float32)).reshape(count, width, -1).astype(np.float64)
    root = np.sqrt(np.maximum(raw, 1e-20)).astype(np.float64)
    scaled = inner / (root[:, :, None] * root[:, None, :])
    gone = np.einsum("gii->gi", scaled) < LEFT
    b = np.where(gone[:, :, None], 0.0, b / root[:, :, None])
    normal = scaled.astype(np.float64) + LEFT * np.eye(width)
    return np.asarray(np.einsum("gik,gik->gk", b, np.linalg.solve(normal, b)))


def log10_tail(share: Floats, width: int, dof: float) -> Floats:
    """Log10 of the chance that as many columns explain such a share of the squares of white noise, shape of `share`."""
    rest = max(dof - width, 2.0) / 2.0
    return np.asarray(np.log10(np.maximum(betainc(rest, width / 2.0, 1.0 - np.clip(share, 0.0, 1.0 - 1e-12)), 1e-300)))


def _batches(columns: Sequence[Variable], d: Floats | None) -> Iterator[tuple[list[Group], Singles]]:
    """Groups of one width and their products, shape (G, w, n), at most about BATCH together."""
    waves = {v.name: _waves(v, max(COARSE, _fine(v))) for v in columns}
    signs = [False] if d is None else [False, True]
    for directed in signs:
        sign = np.ones(1, dtype=np.float32) if not directed or d is None else d.astype(np.float32)
        groups: list[Group] = []
        parts: list[Singles] = []
        for v in columns:
            periods, w = waves[v.name]
            groups += [Group(v, float(k), with_direction=directed) for k in periods]
            parts.append(w * sign)
        if groups:
            yield groups, np.concatenate(parts)
        groups, parts = [], []
        for a, b in itertools.combinations(columns, 2):
            (ka, wa), (kb, wb) = waves[a.name], waves[b.name]
            both_fine = bool(_fine(a) and _fine(b)) and not directed
            if not both_fine:
                ka, kb = (k if v.levels else k[k <= COARSE] for v, k in ((a, ka), (b, kb)))
            if not len(ka) or not len(kb):
                continue
            more = [] if directed or both_fine else _finer(a, waves[a.name], b, waves[b.name])
            for (i, wi), (j, wj) in [((ka, wa[: len(ka)]), (kb, wb[: len(kb)])), *more]:
                product = wi[:, None, :, None] * (wj[:, None, :] * sign)[None]
                groups += [Group(a, float(m), b, float(n), with_direction=directed) for m, n in itertools.product(i, j)]
                parts.append(product.reshape(len(i) * len(j), 4, -1))
            if len(groups) >= BATCH:
                yield groups, np.concatenate(parts)
                groups, parts = [], []
        if groups:
            yield groups, np.concatenate(parts)


Waves = tuple[Floats, Singles]


def _finer(a: Variable, first: Waves, b: Variable, second: Waves) -> list[tuple[Waves, Waves]]:
    """The waves of two columns of which one is the position, finer along that one than the products of all columns are."""
    if "target_mm" not in (a.name, b.name):
        return []

    def taken(v: Variable, own: Waves) -> Waves:
        k, w = own
        if v.name == "target_mm":
            which = (k > COARSE) & (k <= FINER_POSITION)
        else:
            which = np.ones(len(k), dtype=np.bool_) if v.levels else k <= COARSER
        return k[which], w[which]

    pair = taken(a, first), taken(b, second)
    return [pair] if len(pair[0][0]) and len(pair[1][0]) else []


def _fine(variable: Variable) -> float:
    return {"target_mm": FINE_POSITION, "time_s": FINE_TIME, "row_order": FINE_TIME}.get(variable.name, 0.0)


def _waves(variable: Variable, most: float) -> tuple[Floats, Singles]:
    """Periods (k,) and the waves (k, 2, n)."""
    periods = variable.periods(most)
    return periods, variable.waves(periods).astype(np.float32)
