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

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.model.candidates import Ranked
from hil.diagnosis.model.evidence import Fit, Part
from hil.diagnosis.result import OUTSIDE
from hil.effects.history import BRANCH, LONG_STROKE_MM, time_column

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

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
TURNS = (4.0, 170.0)
"""Periods along the travel of a part that turns and changes with another column: below, the smooth blocks have it."""
MOST_BYTES = 120_000_000
"""Most bytes of waves that are kept; of more rows they are made again for each scan."""
WIDTHS = (8, 16, 40)
"""Columns of a block, at most."""
THIN = 3e-3
"""Variance along an axis of a block, over its largest, below which it is left out."""
FAR, LEAST_HIT = 2.5, 8
"""Robust standard deviations from which a row is far off, and the fewest such rows that can follow anything."""
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
        self.u = np.clip((self.values - low) / max(high - low, 1e-12), -0.3, 1.3)

    @property
    def has_levels(self) -> bool:
        return len(self.levels) <= MOST_LEVELS

    def waves(self, periods: Floats) -> Singles:
        """Cosine and sine of each, or of each level all above it and itself, (n, K, 2)."""
        if self.has_levels:
            middle = (self.levels[1:] + self.levels[:-1]) / 2
            above = self.values[:, None] > middle
            only = above & (self.values[:, None] < np.append(middle[1:], np.inf))
            return np.stack([above, only], axis=2).astype(np.float32)
        angle = 2.0 * np.pi * np.outer(self.u, periods)
        return np.stack([np.cos(angle), np.sin(angle)], axis=2).astype(np.float32)

    def smooth(self, highest: float = SMOOTH) -> Floats:
        """1 and functions whose variance falls with frequency, (n, r)."""
        if self.has_levels:
            here = (np.abs(self.values[:, None] - self.levels) < 1e-5).astype(float)
            return np.column_stack([np.ones(len(here)), (here - here.mean(axis=0))[:, 1:]])
        periods = np.arange(0.5, highest + 0.1, 0.5)
        falling = self.waves(periods).astype(float) / np.sqrt(1.0 + periods**2)[None, :, None]
        return np.column_stack([np.ones(len(falling)), falling.reshape(len(falling), -1)])


@dataclass(frozen=True)
class Waves:
    """Groups of k columns side by side (n, G·k) that follow the same columns."""

    names: tuple[str, ...]
    columns: Singles
    k: int


@dataclass(frozen=True)
class Block:
    """A random function of columns, (n, r)."""

    names: tuple[str, ...]
    columns: Floats


@dataclass(frozen=True)
class Batch:
    """Blocks of k columns each, side by side in single precision."""

    blocks: list[Block]
    columns: Singles
    k: int


class Remainder:
    """The family for one campaign."""

    def __init__(self, campaign: CampaignRows) -> None:
        self.campaign = campaign
        survey = campaign.survey
        self.d = campaign.d if survey.has("direction") else None
        self.time = time_column(campaign.columns)
        usable = [name for name in sorted(survey.varying) if name not in NO_CAUSE or name == self.time]
        far = {name for name in usable if name == "stroke_mm" and np.any(campaign.columns[name] >= LONG_STROKE_MM)}
        self._kept: list[Waves] | None = None
        self.axes = {name: Axis(name, campaign.columns[name]) for name in usable if name not in far}

    def _signed(self, names: tuple[str, ...], columns: Floats) -> Iterator[Block]:
        yield Block(names, columns)
        if self.d is not None:
            yield Block((*names, "direction"), columns * self.d[:, None])

    def _waves(self, names: tuple[str, ...], columns: Singles, k: int) -> Iterator[Waves]:
        yield Waves(names, columns, k)
        if self.d is not None:
            yield Waves((*names, "direction"), columns * self.d.astype(np.float32)[:, None], k)

    def waves(self) -> Iterator[Waves]:
        """All groups, from memory where they are few."""
        if self._kept is not None:
            yield from self._kept
            return
        kept: list[Waves] = []
        size = 0
        for one in self._all_waves():
            size += one.columns.nbytes
            if size < MOST_BYTES:
                kept.append(one)
            yield one
        self._kept = kept if size < MOST_BYTES else None

    def _all_waves(self) -> Iterator[Waves]:
        n = len(self.campaign)
        for axis in self.axes.values():
            if axis.name == "target_mm":
                continue
            own = self._waves((axis.name,), axis.waves(COARSE).reshape(n, -1), 2)
            yield from (one for one in own if one.names != (self.time,))  # that is a reading that wanders
        for a, b in itertools.combinations(self.axes.values(), 2):
            first, second = (one.waves(ALONG if one.name == "target_mm" else COARSE) for one in (a, b))
            yield from self._waves((a.name, b.name), _products(first, second), 4)
        place, time = self.axes.get("target_mm"), self.axes.get(self.time)
        if place is not None and time is not None:
            fine = _products(place.waves(FINE_PLACE), time.waves(FINE_TIME))
            yield Waves((place.name, time.name), fine, 4)
        if place is not None and not place.has_levels:
            yield from self._turning(place)

    def _turning(self, place: Axis) -> Iterator[Waves]:
        """A period along the travel whose amplitude another column changes, straight and curved."""
        most = min(TURNS[1], self.campaign.survey.half_span_mm / 2, len(self.campaign) / 4)
        turns = np.arange(TURNS[0], most, 0.34)
        if not len(turns):
            return
        angle = 2.0 * np.pi * np.outer((place.values - place.values.min()) / np.ptp(place.values), turns)
        wave = np.stack([np.cos(angle), np.sin(angle)], axis=2).astype(np.float32)
        for axis in self.axes.values():
            if axis is not place:
                z = (axis.u - axis.u.mean()).astype(np.float32)[:, None, None]
                columns = np.concatenate([wave * z, wave * (z * z - float(np.mean(z * z)))], axis=2)
                yield Waves((place.name, axis.name), columns.reshape(len(z), -1), 4)

    @cached_property
    def batches(self) -> list[Batch]:
        """The blocks in the fewest columns that hold them, those of about as many together."""
        thinned = [Block(one.names, thin(one.columns, WIDTHS[-1])) for one in self._blocks()]
        found = []
        for low, k in itertools.pairwise((0, *WIDTHS)):
            mine = [one for one in thinned if low < one.columns.shape[1] <= k]
            if mine:
                wide = [np.pad(one.columns, ((0, 0), (0, k - one.columns.shape[1]))) for one in mine]
                found.append(Batch(mine, np.hstack(wide).astype(np.float32), k))
        return found

    def _blocks(self) -> list[Block]:
        found: list[Block] = []
        for axis in self.axes.values():
            if axis.name not in ("target_mm", self.time):  # the table, and a reading that wanders
                found += self._signed((axis.name,), axis.smooth()[:, 1:])
        for a, b in itertools.combinations(self.axes.values(), 2):
            found += self._signed((a.name, b.name), _smooth_pair(a, b))
        place, time = self.axes.get("target_mm"), self.axes.get(self.time)
        if time is not None:
            found += self._in_time(place, time)
        if place is not None:
            found += self._of_rows(place)
        return found

    def _in_time(self, place: Axis | None, time: Axis) -> Iterator[Block]:
        """A state that switches or wanders: with the direction, or along the travel."""
        n = len(self.campaign)
        if time.has_levels:
            return
        falling = (time.waves(SWITCHING) / np.hypot(1.0, SWITCHING / 3.0)[None, :, None]).reshape(n, -1).astype(float)
        if self.d is not None:
            yield Block((time.name, "direction"), falling * self.d[:, None])
        if place is None:
            return
        course = np.column_stack([np.ones(n), falling])
        for period in np.arange(0.5, 6.1, 0.5):
            along = place.waves(np.array([period]))[:, 0].astype(float)
            yield Block((place.name, time.name), (along[:, :, None] * course[:, None, :]).reshape(n, -1))

    def _of_rows(self, place: Axis) -> Iterator[Block]:
        """One run, or one row in every few, that follows the travel in a way of its own."""
        along = place.smooth(IN_A_RUN)
        if self.campaign.runs > 1:
            for run in range(self.campaign.runs):
                yield Block((place.name, "run"), along * (self.campaign.run == run)[:, None])
        order = np.arange(len(self.campaign))
        for cycle in range(3, LONGEST_CYCLE + 1):
            for first in range(cycle):
                mask = (order % cycle == first)[:, None]
                yield Block((place.name, "row_order"), along * mask)

    def best(self, fit: Fit, kept: int = 3) -> list[Ranked]:
        """The likeliest remainders beside a fit, as parts."""
        waves: list[tuple[float, Block]] = []
        count = 0
        for one in self.waves():
            gains = fit.gains(one.columns, one.k)
            count += len(gains)
            at = int(np.argmax(gains))
            columns = one.columns[:, at * one.k : (at + 1) * one.k].astype(float)
            waves.append((float(gains[at]), Block(one.names, columns)))
        price = math.log(2.0 * count + 1.0)
        found = [(gain - price, price, block) for gain, block in waves]
        price = math.log(2.0 * sum(len(batch.blocks) for batch in self.batches) + 1.0)
        for batch in self.batches:
            gains = fit.random_gains(batch.columns, batch.k) - price
            found += [(float(gains[i]), price, batch.blocks[i]) for i in np.argsort(-gains)[:kept]]
        found += self._hit(fit)
        found.sort(key=lambda one: -one[0])
        return [Ranked(gain, self._part(one, price, fit), fit) for gain, price, one in found[:kept]]

    def _hit(self, fit: Fit) -> Iterator[tuple[float, float, Block]]:
        """Rows far off, here and there, that together follow the travel: more than they do with signs and places drawn anew, as the
        rows of a noise with heavy tails have them.
        """
        place = self.axes.get("target_mm")
        away = np.abs(fit.residual - np.median(fit.residual))
        far = away > FAR * 1.4826 * float(np.median(away))
        if place is None or not LEAST_HIT <= np.sum(far) <= len(far) / 4:
            return
        block = Block((place.name, "row_order"), thin(place.smooth() * far[:, None], WIDTHS[0]))
        rng = np.random.default_rng(0)
        drawn = np.tile(fit.rest[:, None], (1, DRAWN))
        for one in drawn.T:
            one[far] = rng.permutation(one[far]) * rng.choice([-1.0, 1.0], int(np.sum(far)))
        price = max(float(np.max(fit.gains_of(block.columns, drawn))), 0.0)
        yield fit.random_gain(block.columns)[0] - price, price, block

    @staticmethod
    def _part(one: Block, price: float, fit: Fit) -> Part:
        columns = thin(one.columns * math.sqrt(fit.random_gain(one.columns)[1]))
        none = columns[:, :0]
        return Part(OUTSIDE, one.names, none, columns, none, -price)


def _products(a: Singles, b: Singles) -> Singles:
    """Products of the functions of two columns, (n, K, i) and (n, L, j): (n, K·L·i·j), those of one pair of periods side by side."""
    return np.asarray((a[:, :, None, :, None] * b[:, None, :, None, :]).reshape(len(a), -1))


def _smooth_pair(a: Axis, b: Axis) -> Floats:
    """A smooth function of two columns, without what the table has of the position alone."""
    product = a.smooth()[:, :, None] * b.smooth()[:, None, :]
    kept = np.ones(product.shape[1:], dtype=bool)
    kept[0, 0] = False
    kept[:, 0] &= a.name != "target_mm"
    kept[0, :] &= b.name != "target_mm"
    return np.asarray(product[:, kept])


def thin(columns: Floats, most: int = 1000) -> Floats:
    """The same random function in few columns."""
    size, axes = np.linalg.eigh(columns.T @ columns)
    kept = size > THIN * float(size[-1])
    kept[: max(len(size) - most, 0)] = False
    return np.asarray(columns @ axes[:, kept])
