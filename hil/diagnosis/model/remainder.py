"""The remainder: functions of columns that no effect of the catalogue has, as random parts of one family.

Smooth functions of one column or two; waves along the travel that another column or a state in time changes; a state with the
direction; a drift of each run; one run; one row in n. Each pays for the choice among all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hil.diagnosis.campaign import CampaignRows, Floats, Ints, Singles
from hil.diagnosis.model.evidence import Fit, Part
from hil.diagnosis.result import OUTSIDE
from hil.effects.history import BRANCH, LONG_STROKE_MM, time_column

NO_CAUSE = frozenset(
    {"run", "measured_mm", "command_mm", "direction", "row_order", "correction_um", "residual_um", *BRANCH}
)
"""Columns that cannot carry a cause: names, readings, and what others carry better."""
MOST_LEVELS = 8
SMOOTH = 5.0
"""Most periods over the range of a column in a smooth block."""
ALONG = np.arange(0.5, 8.1, 0.5)
"""Those of a wave along the travel that another column changes."""
SWITCHING = np.arange(1.0, 25.0)
"""Those of a process in time: amplitudes that fall with frequency are those of a state that switches or wanders."""
WANDERING = np.arange(1.0, 9.0)
"""Half periods over a run of a drift of its own."""
MOST_RUNS = 16
"""Runs up to which each may have such a drift."""
TOGETHER = 32
"""Blocks that are looked at together."""
WIDEST = 40
"""Columns of a block, at most."""
KEPT = 2
"""Likeliest remainders that are followed."""
THIN = 3e-3
"""Variance along an axis of a block, over its largest, below which it is left out."""
LONGEST_CYCLE = 12
"""Rows of the longest cycle in which one row may differ."""


class ColumnRange:
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

    def waves(self, periods: Floats) -> Floats:
        """Cosine and sine of each number of periods over the range, (n, 2 K)."""
        angle = 2.0 * np.pi * np.outer(self.u, periods)
        return np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(len(angle), -1)

    def smooth(self) -> Floats:
        """1 and functions whose variance falls with frequency, (n, r)."""
        one = np.ones((len(self.u), 1))
        if self.has_levels:
            here = (np.abs(self.values[:, None] - self.levels) < 1e-5).astype(float)
            return np.hstack([one, (here - here.mean(axis=0))[:, 1:]])
        periods = np.arange(0.5, SMOOTH + 0.1, 0.5)
        return np.hstack([one, self.waves(periods) / np.repeat(np.sqrt(1.0 + periods**2), 2)])

    @cached_property
    def course(self) -> Singles:
        """1 and the smooth functions in fewer, the largest first, (r, n)."""
        smooth = self.smooth()
        return np.hstack([smooth[:, :1], thin(smooth[:, 1:])[:, ::-1]]).T.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Block:
    """A random function of columns, (r, n), with a sign in each row, (n,), or none; the two share what is in memory."""

    names: tuple[str, ...]
    alike: Singles
    sign: Singles | None = None

    @classmethod
    def of(cls, names: tuple[str, ...], columns: Floats) -> Block:
        """Of columns (n, r), in fewer."""
        return cls(names, thin(columns, WIDEST).T.astype(np.float32))

    @property
    def rows(self) -> Singles:
        """Its columns as rows, (r, n)."""
        return self.alike if self.sign is None else self.alike * self.sign


class Remainder:
    """The family for one campaign."""

    def __init__(self, campaign: CampaignRows) -> None:
        self.campaign = campaign
        survey = campaign.survey
        self.d = campaign.d if survey.has("direction") else None
        self._sign = campaign.d.astype(np.float32)
        self.time = time_column(campaign.columns)
        usable = {name for name in survey.varying if name not in NO_CAUSE or name == self.time}
        if "stroke_mm" in usable and np.any(campaign.columns["stroke_mm"] >= LONG_STROKE_MM):
            usable.remove("stroke_mm")
        self.axes = {name: ColumnRange(name, campaign.columns[name]) for name in sorted(usable)}

    def _signed(self, names: tuple[str, ...], rows: Singles) -> Iterator[Block]:
        """A function alike in both directions, and one with the sign of the direction."""
        yield Block(names, rows)
        if self.d is not None:
            yield Block((*names, "direction"), rows, self._sign)

    def _blocks(self) -> Iterator[Block]:
        place, time = self.axes.get("target_mm"), self.axes.get(self.time)
        for axis in self.axes.values():
            if axis is not place and axis is not time:  # the table, and a reading that wanders
                yield from self._signed((axis.name,), axis.course[1:])
        for a, b in itertools.combinations(self.axes.values(), 2):
            yield from self._signed((a.name, b.name), _products(a, b))
        if time is not None and not time.has_levels:
            yield from self._in_time(time)
        if place is not None:
            yield from self._of_rows(place)
            for axis in self.axes.values():
                if axis is not place:
                    yield from self._along(place, axis)

    def _in_time(self, time: ColumnRange) -> Iterator[Block]:
        """A state that switches or wanders, with the direction, and a drift that each run has anew."""
        if self.d is not None:
            yield Block.of((time.name, "direction"), _switching(time) * self.d[:, None])
        if 1 < self.campaign.runs <= MOST_RUNS:
            yield Block.of((time.name, "run"), _drift_of_runs(time.values, self.campaign.run))

    def _along(self, place: ColumnRange, axis: ColumnRange) -> Iterator[Block]:
        """A wave along the travel whose amplitude and phase another column changes, or a state in time; itself it is an effect's."""
        is_time = axis.name == self.time and not axis.has_levels
        course = _switching(axis) if is_time else axis.course[1:].T.astype(np.float64)
        for periods in ALONG:
            columns = place.waves(np.array([periods]))[:, :, None] * course[:, None]
            yield from self._signed((place.name, axis.name), Block.of((), columns.reshape(len(course), -1)).alike)

    def _of_rows(self, place: ColumnRange) -> Iterator[Block]:
        """One run, or one row in every few, that follows the travel in a way of its own."""
        along = place.smooth()
        order = np.arange(len(self.campaign))
        if self.campaign.runs > 1:
            for run in range(self.campaign.runs):
                yield Block.of((place.name, "run"), along * (self.campaign.run == run)[:, None])
        for cycle in range(3, LONGEST_CYCLE + 1):
            for first in range(cycle):
                yield Block.of((place.name, "row_order"), along * (order % cycle == first)[:, None])

    @cached_property
    def _batches(self) -> list[tuple[Block, ...]]:
        """All blocks, those of about as many columns together."""
        blocks = sorted(self._blocks(), key=lambda one: len(one.alike))
        return [tuple(blocks[i : i + TOGETHER]) for i in range(0, len(blocks), TOGETHER)]

    def best(self, fit: Fit) -> list[Part]:
        """The likeliest remainders beside a fit, as parts."""
        price = math.log(2.0 * sum(map(len, self._batches)))
        found: list[tuple[float, Block]] = []
        for batch in self._batches:
            wide = np.zeros((len(batch), len(batch[-1].alike), len(self.campaign)), dtype=np.float32)
            for i, one in enumerate(batch):
                wide[i, : len(one.alike)] = one.rows
            gains = fit.random_gains(wide.reshape(-1, len(self.campaign)), wide.shape[1], batch) - price
            found += zip(gains.tolist(), batch, strict=True)
        found.sort(key=lambda one: -one[0])
        return [_part(block, fit, price) for _, block in found[:KEPT]]


def _part(block: Block, fit: Fit, price: float) -> Part:
    columns = block.rows.T.astype(np.float64)
    columns = thin(columns * math.sqrt(fit.random_gain(columns)[1]))
    none = columns[:, :0]
    return Part(OUTSIDE, block.names, none, columns, none, -price)


def _switching(time: ColumnRange) -> Floats:
    """The course of a state, without its mean, (n, r)."""
    return np.asarray(time.waves(SWITCHING) / np.repeat(np.hypot(1.0, SWITCHING / 3.0), 2))


def _drift_of_runs(time: Floats, run: Ints) -> Floats:
    """Functions of time that differ from run to run and wander as a random walk does, (n, runs · r)."""
    columns = np.zeros((len(time), int(np.max(run)) + 1, len(WANDERING)))
    for one in range(columns.shape[1]):
        mine = run == one
        share = (time[mine] - np.min(time[mine])) / max(float(np.ptp(time[mine])), 1e-9)
        columns[mine, one] = np.cos(np.pi * np.outer(share, WANDERING)) / WANDERING
    return columns.reshape(len(time), -1)


def _products(a: ColumnRange, b: ColumnRange) -> Singles:
    """A smooth function of two columns, without what the table has of the position alone, (r, n)."""
    sizes = np.outer(np.sum(a.course**2, axis=1), np.sum(b.course**2, axis=1))
    sizes[0, 0] = 0.0
    sizes[:, 0] *= a.name != "target_mm"
    sizes[0, :] *= b.name != "target_mm"
    i, j = np.unravel_index(np.argsort(-sizes, axis=None)[:WIDEST], sizes.shape)
    kept = sizes[i, j] > THIN * float(np.max(sizes))
    return np.asarray(a.course[i[kept]] * b.course[j[kept]])


def thin(columns: Floats, most: int = 1000) -> Floats:
    """The same random function in few columns."""
    size, axes = np.linalg.eigh(columns.T @ columns)
    kept = size > THIN * float(size[-1])
    kept[: max(len(size) - most, 0)] = False
    return np.asarray(columns @ axes[:, kept])
