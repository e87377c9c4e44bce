"""The remainder: functions of one column or two that no effect of the catalogue has, as random parts of one family.

Waves: products of harmonics (of levels, where a column has few) of one or two columns, with and without the sign of the direction;
fine ones of position and time; a turning part whose amplitude another column changes. Blocks: smooth functions of the same, processes
in time along the travel, one run, one row in n. Each pays for the choice among all of its kind.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.model.candidates import Ranked
from hil.diagnosis.model.evidence import LEAST_LEFT, Fit, Part
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.result import OUTSIDE
from hil.effects.history import BRANCH, LONG_STROKE_MM, time_column

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

NO_CAUSE = frozenset(
    {"run", "measured_mm", "command_mm", "direction", "row_order", "correction_um", "residual_um", *BRANCH}
)
"""Columns that cannot carry a cause: names, readings, and what others carry better."""
MOST_LEVELS = 8
COARSE = np.arange(0.5, 3.6, 0.5)
ALONG = np.arange(0.5, 8.1, 0.5)
FINE_PLACE, FINE_TIME = np.arange(0.5, 16.1, 0.5), np.arange(0.5, 12.1, 0.5)
"""Periods over the range of a column."""
SMOOTH, IN_A_RUN = 2.5, 5.0
"""Highest of them in a smooth block, and along the travel in one run."""
SWITCHING = np.arange(1.0, 25.0)
"""Those of a process in time: amplitudes that fall with frequency are those of a state that switches or wanders."""
WANDERING = np.arange(1.0, 9.0)
"""Half periods over a run of a drift of its own."""
TURNS = (4.0, 170.0)
"""Periods along the travel of a part that turns and changes with another column: below, the smooth blocks have it."""
CLOSELY = 3
"""Waves of each column or two that are looked at closely beside a fit, of those that explain most at a glance."""
TABLE_ORDER, MOST_OFFSETS = 7, 16
"""Highest polynomial, and most runs with an offset, of the table at that glance."""
TOGETHER = 32
"""Blocks that are looked at together."""
WIDTHS = (8, 16, 40)
"""Columns of a block, at most."""
THIN = 3e-3
"""Variance along an axis of a block, over its largest, below which it is left out."""
LEAST_HIT = 8
"""Fewest rows far off that can follow anything: a function of the travel has as many columns."""
DRAWN = 60
"""Times that their signs and places are drawn anew."""
LONGEST_CYCLE = 12
"""Rows of the longest cycle in which one row may differ."""


class Axis:
    """A column over its range."""

    def __init__(self, name: str, values: Floats) -> None:
        self.name = name
        self.values = np.abs(values) if name == "velocity_mm_s" else values
        self.levels = np.unique(np.round(self.values, 6))
        low, high = np.quantile(self.values, [0.02, 0.98])
        if high - low < 1e-9:
            low, high = self.values.min(), self.values.max()
        self._waves: dict[tuple[float, ...], Singles] = {}
        self.u = np.clip((self.values - low) / max(high - low, 1e-12), -0.3, 1.3)

    @property
    def has_levels(self) -> bool:
        return len(self.levels) <= MOST_LEVELS

    def waves(self, periods: Floats) -> Singles:
        """Cosine and sine of each, or of each level all above it and itself, (K, 2, n); made once."""
        key = tuple(periods.tolist())
        if key not in self._waves:
            if self.has_levels:
                middle = (self.levels[1:] + self.levels[:-1])[:, None] / 2
                above = self.values > middle
                both = above, above & (self.values < np.append(middle[1:], [[np.inf]], axis=0))
            else:
                angle = 2.0 * np.pi * np.outer(periods, self.u)
                both = np.cos(angle), np.sin(angle)
            self._waves[key] = np.stack(both, axis=1).astype(np.float32)
        return self._waves[key]

    def smooth(self, highest: float = SMOOTH) -> Floats:
        """1 and functions whose variance falls with frequency, (n, r)."""
        one = np.ones((len(self.values), 1))
        if self.has_levels:
            here = (np.abs(self.values[:, None] - self.levels) < 1e-5).astype(float)
            return np.hstack([one, (here - here.mean(axis=0))[:, 1:]])
        periods = np.arange(0.5, highest + 0.1, 0.5)
        falling = self.waves(periods).astype(float) / np.sqrt(1.0 + periods**2)[:, None, None]
        return np.hstack([one, falling.reshape(-1, len(one)).T])

    @cached_property
    def course(self) -> Singles:
        """1 and the smooth functions in fewer, the largest first, (r, n)."""
        smooth = self.smooth()
        return np.hstack([smooth[:, :1], thin(smooth[:, 1:])[:, ::-1]]).T.astype(np.float32)


@dataclass(frozen=True)
class Waves:
    """Products of functions of one column or two: every one of first (K, i, n) with every one of second (L, j, n), in groups of i·j
    that have a prior of their own; with the sign of the direction, (n,), or ones.
    """

    names: tuple[str, ...]
    first: Singles
    second: Singles
    sign: Singles

    @property
    def k(self) -> int:
        return int(self.first.shape[1] * self.second.shape[1])

    @property
    def groups(self) -> int:
        return len(self.first) * len(self.second)

    def block(self, group: int) -> Block:
        """One group."""
        a, b = divmod(group, len(self.second))
        i, j = np.divmod(np.arange(self.k), self.second.shape[1])
        return Block(self.names, self.first[a], self.second[b], self.sign, i, j)

    def sums(self, first: Singles, second: Singles) -> Floats:
        """Sums over the rows of products of other functions, (K, i', n) and (L, j', n), of the groups: (G, i'·j')."""
        (k, i, n), (m, j, _) = first.shape, second.shape
        sums = (first.reshape(-1, n) @ second.reshape(-1, n).T).reshape(k, i, m, j)
        return np.asarray(sums.transpose(0, 2, 1, 3).reshape(k * m, i * j), dtype=np.float64)


@dataclass(frozen=True)
class Screen:
    """What is computed once of waves, so that of each fit only the likeliest are looked at closely.

    inverse: of their products beside a table in white noise, (G, k, k); alike: correlation of their neighbouring rows, (G,)
    """

    waves: Waves
    inverse: Floats
    alike: Floats

    @classmethod
    def of(cls, waves: Waves, table: Singles, neighbours: Singles) -> Screen:
        """table: orthonormal, (q, n); neighbours: 1 where the next row is of the same run, (n - 1,)."""
        a, b, k = waves.first, waves.second, waves.k
        square = waves.sums(_pairs(a), _pairs(b)).reshape(-1, a.shape[1], a.shape[1], b.shape[1], b.shape[1])
        product = square.transpose(0, 1, 3, 2, 4).reshape(-1, k, k)
        by_table = b[:, :, None, :] * (table * waves.sign)
        held = waves.sums(a, by_table.reshape(len(b), -1, b.shape[2])).reshape(len(product), k, -1)
        whole = np.trace(product, axis1=1, axis2=2)
        left = product - held @ held.transpose(0, 2, 1)
        left += np.eye(k) * (LEAST_LEFT * whole[:, None, None] + 1e-12)
        of_run = neighbours * waves.sign[1:] * waves.sign[:-1]
        beside = waves.sums(a[:, :, 1:] * a[:, :, :-1] * of_run, b[:, :, 1:] * b[:, :, :-1])
        return cls(
            waves, np.asarray(np.linalg.inv(left), dtype=np.float64), np.sum(beside, axis=1) / np.maximum(whole, 1e-12)
        )

    def likeliest(self, fit: Fit, most: int) -> Ints:
        """Groups that probably explain most of what a fit leaves."""
        b = self.waves.sums(self.waves.first, self.waves.second * (fit.score * self.waves.sign))
        explained = np.einsum("gi,gij,gj->g", b, self.inverse, b) * fit.noise.memory.power(self.alike)
        return np.argsort(-explained)[:most].astype(np.int64)


@dataclass(frozen=True, eq=False)
class Block:
    """A random function of columns: products of functions of one column, (K, n), and of another, (L, n), with a sign, (n,).

    i, j: which of them are multiplied with which, (r,)
    """

    names: tuple[str, ...]
    first: Singles
    second: Singles
    sign: Singles
    i: Ints
    j: Ints

    @classmethod
    def of(cls, names: tuple[str, ...], rows: Singles, sign: Singles) -> Block:
        """Of functions, (r, n)."""
        at = np.arange(len(rows))
        return cls(names, rows, np.ones_like(rows[:1]), sign, at, 0 * at)

    @property
    def width(self) -> int:
        return len(self.i)

    @property
    def rows(self) -> Singles:
        """Its columns, (r, n)."""
        return np.asarray(self.first[self.i] * (self.second * self.sign)[self.j])

    @property
    def columns(self) -> Floats:
        """The same, (n, r)."""
        return self.rows.T.astype(np.float64)


@dataclass(frozen=True)
class Found:
    """A part of the remainder with the log evidence that it adds, its price included."""

    gain: float
    price: float
    block: Block


class Remainder:
    """The family for one campaign."""

    def __init__(self, campaign: CampaignRows) -> None:
        self.campaign = campaign
        survey = campaign.survey
        self.d = campaign.d if survey.has("direction") else None
        self.time = time_column(campaign.columns)
        usable = [name for name in sorted(survey.varying) if name not in NO_CAUSE or name == self.time]
        far = {name for name in usable if name == "stroke_mm" and np.any(campaign.columns[name] >= LONG_STROKE_MM)}
        self.axes = {name: Axis(name, campaign.columns[name]) for name in usable if name not in far}

    @cached_property
    def _one(self) -> Singles:
        return np.ones(len(self.campaign), dtype=np.float32)

    def _signs(self, names: tuple[str, ...]) -> list[tuple[tuple[str, ...], Singles]]:
        """Names of columns, and the sign of a function of them: none, and that of the direction."""
        both = [(names, self._one)]
        if self.d is not None:
            both.append(((*names, "direction"), self.d.astype(np.float32)))
        return both

    @cached_property
    def screens(self) -> list[Screen]:
        """All waves."""
        same_run = (np.diff(self.campaign.run) == 0).astype(np.float32)
        return [Screen.of(one, self._plain_table, same_run) for one in self._waves()]

    @cached_property
    def _plain_table(self) -> Singles:
        """Smooth functions of the position, alike and unlike in the directions, and offsets of the runs, orthonormal, (q, n)."""
        u = (self.campaign.x - self.campaign.survey.centre_mm) / self.campaign.survey.half_span_mm
        smooth = np.polynomial.legendre.legvander(u, TABLE_ORDER)
        parts = [smooth] if self.d is None else [smooth, smooth * self.d[:, None]]
        if 1 < self.campaign.runs <= MOST_OFFSETS:
            parts.append((self.campaign.run[:, None] == np.arange(1, self.campaign.runs)).astype(float))
        return np.asarray(np.linalg.qr(np.hstack(parts))[0].T, dtype=np.float32)

    def _waves(self) -> Iterator[Waves]:
        for axis in self.axes.values():
            for names, sign in self._signs((axis.name,)) if axis.name != "target_mm" else ():
                if names != (self.time,):  # that is a reading that wanders
                    yield Waves(names, axis.waves(COARSE), self._one[None, None], sign)
        for a, b in itertools.combinations(self.axes.values(), 2):
            first, second = (axis.waves(ALONG if axis.name == "target_mm" else COARSE) for axis in (a, b))
            for names, sign in self._signs((a.name, b.name)):
                yield Waves(names, first, second, sign)
        place, time = self.axes.get("target_mm"), self.axes.get(self.time)
        if place is not None and time is not None:
            yield Waves((place.name, time.name), place.waves(FINE_PLACE), time.waves(FINE_TIME), self._one)
        if place is not None and not place.has_levels:
            yield from self._turning(place)

    def _turning(self, place: Axis) -> Iterator[Waves]:
        """A period along the travel whose amplitude another column changes, straight and curved."""
        most = min(TURNS[1], self.campaign.survey.half_span_mm / 2, len(self.campaign) / 4)
        turns = np.arange(TURNS[0], most, 0.34)
        if not len(turns):
            return
        angle = 2.0 * np.pi * np.outer(turns, (place.values - place.values.min()) / np.ptp(place.values))
        wave = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
        for axis in self.axes.values():
            if axis is not place:
                z = (axis.u - axis.u.mean()).astype(np.float32)
                yield Waves((place.name, axis.name), wave, np.stack([z, z * z - np.mean(z * z)])[None], self._one)

    def _blocks(self) -> Iterator[Block]:
        place, time = self.axes.get("target_mm"), self.axes.get(self.time)
        for axis in self.axes.values():
            if axis is not place and axis is not time:  # the table, and a reading that wanders
                for names, sign in self._signs((axis.name,)):
                    yield Block.of(names, axis.course[1:], sign)
        for a, b in itertools.combinations(self.axes.values(), 2):
            i, j = _largest_products(a, b)
            for names, sign in self._signs((a.name, b.name)):
                yield Block(names, a.course, b.course, sign, i, j)
        if time is not None and not time.has_levels:
            yield from self._in_time(place, time)
        if place is not None:
            yield from self._of_rows(place)

    def _in_time(self, place: Axis | None, time: Axis) -> Iterator[Block]:
        """A state that switches or wanders: with the direction, or along the travel."""
        waves = time.waves(SWITCHING) / np.hypot(1.0, SWITCHING / 3.0)[:, None, None]
        course = np.vstack([self._one, waves.reshape(-1, len(self.campaign))])
        if self.d is not None:
            rows = thin(course[1:].T * self.d[:, None], WIDTHS[-1]).T.astype(np.float32)
            yield Block.of((time.name, "direction"), rows, self._one)
        if 1 < self.campaign.runs <= MOST_OFFSETS:
            drift = _drift_of_runs(time.values, self.campaign.run)
            yield Block.of((time.name, "run"), thin(drift, WIDTHS[-1]).T.astype(np.float32), self._one)
        if place is None:
            return
        for period in np.arange(0.5, 6.1, 0.5):
            along = place.waves(np.array([period]))[0]
            columns = (along[:, None] * course).reshape(-1, len(self.campaign)).T
            rows = thin(columns, WIDTHS[-1]).T.astype(np.float32)
            yield Block.of((place.name, time.name), rows, self._one)

    def _of_rows(self, place: Axis) -> Iterator[Block]:
        """One run, or one row in every few, that follows the travel in a way of its own."""
        along = thin(place.smooth(IN_A_RUN), WIDTHS[-1]).T.astype(np.float32)
        if self.campaign.runs > 1:
            for run in range(self.campaign.runs):
                mine = (self.campaign.run == run).astype(np.float32)
                yield Block.of((place.name, "run"), along, mine)
        order = np.arange(len(self.campaign))
        for cycle in range(3, LONGEST_CYCLE + 1):
            for first in range(cycle):
                mine = (order % cycle == first).astype(np.float32)
                yield Block.of((place.name, "row_order"), along, mine)

    @cached_property
    def _batches(self) -> list[tuple[Block, ...]]:
        """All blocks, those of about as many columns together."""
        blocks = list(self._blocks())
        found: list[tuple[Block, ...]] = []
        for low, k in itertools.pairwise((0, *WIDTHS)):
            mine = [one for one in blocks if low < one.width <= k]
            found += [tuple(mine[i : i + TOGETHER]) for i in range(0, len(mine), TOGETHER)]
        return found

    def best(self, fit: Fit, kept: int = 3) -> list[Ranked]:
        """The likeliest remainders beside a fit, as parts."""
        found = sorted([*self._best_waves(fit), *self._best_blocks(fit), *self._hit(fit)], key=lambda one: -one.gain)
        return [Ranked(one.gain, self._part(one, fit), fit) for one in found[:kept]]

    def _best_waves(self, fit: Fit) -> Iterator[Found]:
        """The best of the waves of each column or two."""
        price = math.log(2.0 * sum(screen.waves.groups for screen in self.screens) + 1.0)
        for k in sorted({screen.waves.k for screen in self.screens}):
            blocks = [
                screen.waves.block(int(group))
                for screen in self.screens
                if screen.waves.k == k
                for group in screen.likeliest(fit, CLOSELY)
            ]
            gains = fit.gains(np.vstack([one.rows for one in blocks]), k)
            yield from (Found(gain - price, price, one) for gain, one in zip(gains.tolist(), blocks, strict=True))

    def _best_blocks(self, fit: Fit) -> Iterator[Found]:
        price = math.log(2.0 * sum(map(len, self._batches)) + 1.0)
        for batch in self._batches:
            k = max(one.width for one in batch)
            wide = np.zeros((len(batch), k, len(self.campaign)), dtype=np.float32)
            for i, one in enumerate(batch):
                wide[i, : one.width] = one.rows
            gains = fit.random_gains(wide.reshape(-1, len(self.campaign)), k, batch) - price
            yield from (Found(gain, price, one) for gain, one in zip(gains.tolist(), batch, strict=True))

    def _hit(self, fit: Fit) -> Iterator[Found]:
        """Rows far off, here and there, that together follow the travel: more than they do with signs and places drawn anew, as the
        rows of a noise with heavy tails have them.
        """
        place = self.axes.get("target_mm")
        away = np.abs(fit.residual - np.median(fit.residual))
        far = away > NormalDist().inv_cdf(1.0 - 0.5 * USUAL.few) * 1.4826 * float(np.median(away))
        if place is None or not LEAST_HIT <= np.sum(far) <= len(far) / 4:
            return
        columns = thin(place.smooth() * far[:, None], WIDTHS[0])
        block = Block.of((place.name, "row_order"), columns.T.astype(np.float32), self._one)
        rng = np.random.default_rng(0)
        drawn = np.tile(fit.rest[:, None], (1, DRAWN))
        for one in drawn.T:
            one[far] = rng.permutation(one[far]) * rng.choice([-1.0, 1.0], int(np.sum(far)))
        price = max(float(np.max(fit.gains_of(columns, drawn))), 0.0)
        yield Found(fit.random_gain(columns)[0] - price, price, block)

    @staticmethod
    def _part(found: Found, fit: Fit) -> Part:
        one = found.block
        columns = thin(one.columns * math.sqrt(fit.random_gain(one.columns)[1]))
        none = columns[:, :0]
        return Part(OUTSIDE, one.names, none, columns, none, -found.price)


def _drift_of_runs(time: Floats, run: Ints) -> Floats:
    """Functions of time that differ from run to run and wander as a random walk does, (n, runs · r)."""
    columns = np.zeros((len(time), int(np.max(run)) + 1, len(WANDERING)))
    for one in range(columns.shape[1]):
        mine = run == one
        share = (time[mine] - np.min(time[mine])) / max(float(np.ptp(time[mine])), 1e-9)
        columns[mine, one] = np.cos(np.pi * np.outer(share, WANDERING)) / WANDERING
    return columns.reshape(len(time), -1)


def _pairs(functions: Singles) -> Singles:
    """Products of the functions of one group with each other, (K, i, n): (K, i·i, n)."""
    pairs = functions[:, :, None] * functions[:, None]
    return np.asarray(pairs.reshape(len(functions), -1, functions.shape[2]))


def _largest_products(a: Axis, b: Axis) -> tuple[Ints, Ints]:
    """Which functions of two columns make a smooth function of both, without what the table has of the position alone."""
    sizes = np.outer(np.sum(a.course**2, axis=1), np.sum(b.course**2, axis=1))
    sizes[0, 0] = 0.0
    sizes[:, 0] *= a.name != "target_mm"
    sizes[0, :] *= b.name != "target_mm"
    first, second = np.unravel_index(np.argsort(-sizes, axis=None)[: WIDTHS[-1]], sizes.shape)
    kept = sizes[first, second] > THIN * float(np.max(sizes))
    return first[kept].astype(np.int64), second[kept].astype(np.int64)


def thin(columns: Floats, most: int = 1000) -> Floats:
    """The same random function in few columns."""
    size, axes = np.linalg.eigh(columns.T @ columns)
    kept = size > THIN * float(size[-1])
    kept[: max(len(size) - most, 0)] = False
    return np.asarray(columns @ axes[:, kept])
