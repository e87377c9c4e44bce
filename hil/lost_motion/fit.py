"""The shape of lost motion from measured reversals: two tanh terms, one, an exponential, a dead zone …, judged on held-out strokes.

What is linear in travel over one stroke belongs to the table, not to the reversal; it is fitted beside every shape and left out of
the result. Amounts and that slope follow by non-negative least squares for each choice of the lengths, so only those are searched.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from drivers.errors import InputError
from hil.correction.published_rise import TwoTanh
from hil.correction.rise import SHAPES, Floats, Rise, Shape
from hil.lost_motion.at_load import Places, Reach, fit_at_load, standard_uncertainties

FOLDS = 5
FIT_ROWS = 250
"""A search sees about this many rows, evenly picked; what is reported is of all of them."""
LEAST_WEIGHT = 0.002
"""Of a row where the load stands still while the motor moves, where a search begins."""


@dataclass(frozen=True)
class MeasuredReversal:
    """One stroke after a reversal, by a laser or a load encoder.

    direction: of the stroke, +1 or -1. travel_mm: shape (n,), ≥ 0, since the reversal. error_um: shape (n,), actual − commanded; its
    first row is taken before the motion starts. stroke_mm: travel of the stroke before; rows beyond it are left out, as the axis is
    back on an earlier branch there. over_load: the travel is the load's own, see `by_load`.
    Raises InputError for anything else, and for fewer than 10 rows.
    """

    direction: int
    travel_mm: Floats
    error_um: Floats
    stroke_mm: float = math.inf
    over_load: bool = False

    def __post_init__(self) -> None:
        rows = len(self.travel_mm)
        finite = bool(np.all(np.isfinite(self.travel_mm)) and np.all(np.isfinite(self.error_um)))
        if self.direction not in (1, -1) or len(self.error_um) != rows or not finite or np.any(self.travel_mm < 0.0):
            raise InputError(
                f"reversal in direction {self.direction} with {rows} travels and {len(self.error_um)} errors:"
                " expected +1 or -1, and as many finite errors as travels, none of which is below 0"
            )
        if int(self._kept.sum()) < 10 or not np.any(self.travel_mm > 0.0):
            raise InputError(
                f"{int(self._kept.sum())} rows within the stroke: too few, at least 10 are needed, and some travel"
            )

    @property
    def _kept(self) -> NDArray[np.bool_]:
        return np.asarray(self.travel_mm <= self.stroke_mm)

    @property
    def rise(self) -> tuple[Floats, Floats]:
        """Travel, mm, and how much the error has moved against the motion since the reversal, µm, both of shape (m,), m ≤ n."""
        kept = self._kept
        risen_um = -self.direction * (self.error_um - self.error_um[0])
        return self.travel_mm[kept], risen_um[kept]

    def by_load(self) -> MeasuredReversal:
        """The same over the load's own travel instead of the motor's: what a correction needs, under which the load is on its target.

        While the load sticks, its travel tells nothing of the rise, but the rise tells where the load is: such a reversal is fitted by
        where the load should be after each of the motor's travels. Raises InputError unless the motor's travel grows row by row.
        """
        if np.any(np.diff(self.travel_mm) <= 0.0):
            raise InputError("the travel has to grow from row to row to tell the load's travel")
        risen_um = -self.direction * (self.error_um - self.error_um[0])
        return replace(self, travel_mm=np.maximum(self.travel_mm - risen_um / 1000.0, 0.0), over_load=True)

    @property
    def start_weights(self) -> Floats:
        """For a first search, of the rows of `rise`, shape (m,): the load's travel per motor travel, by which errors show."""
        travel_mm, risen_um = self.rise
        if not self.over_load:
            return np.ones(len(travel_mm))
        slope = np.diff(travel_mm) / np.diff(travel_mm + risen_um / 1000.0)
        return np.asarray(np.clip(np.minimum(np.append(slope, 1.0), np.append(1.0, slope)), LEAST_WEIGHT, 1.0))


@dataclass(frozen=True)
class Fitted:
    """A rise, and what the table was off along the stroke, µm of rise per mm."""

    rise: Rise
    table_um_per_mm: float = 0.0

    @property
    def shape(self) -> Shape:
        return self.rise.shape

    def rise_um(self, travel_mm: Floats) -> Floats:
        """What a measured reversal is expected to show, shape (n,): the lost motion come back, and the table's part."""
        return np.asarray(self.rise.along_um(travel_mm) + self.table_um_per_mm * travel_mm, dtype=np.float64)

    @property
    def form(self) -> TwoTanh:
        """Pc1, Pc2, a1, a2, b2. Raises InputError for a shape that is not of tanh terms."""
        return self.rise.form


@dataclass(frozen=True)
class Contender:
    """A shape fitted to all rows, its RMS on them, and its RMS on rows it had not seen, µm; over the load: of its place."""

    fitted: Fitted
    rms_um: float
    held_out_rms_um: float


@dataclass(frozen=True)
class _Rows:
    """All rows of some reversals: travel, rise, weight for a first search, and which reversal each is of; shape (n,) each."""

    travel_mm: Floats
    risen_um: Floats
    weight: Floats
    stroke: NDArray[np.int64]
    over_load: bool

    @classmethod
    def of(cls, reversals: Sequence[MeasuredReversal]) -> _Rows:
        if not reversals:
            raise InputError("no reversal was measured")
        if len({reversal.over_load for reversal in reversals}) > 1:
            raise InputError("some reversals are over the load's travel and some are not")
        rises = [reversal.rise for reversal in reversals]
        stroke = np.repeat(np.arange(len(rises)), [len(travel) for travel, _ in rises])
        weight = np.concatenate([reversal.start_weights for reversal in reversals])
        travel, risen = (np.concatenate([pair[k] for pair in rises]) for k in (0, 1))
        return cls(travel, risen, weight, stroke, reversals[0].over_load)

    def where(self, rows: NDArray[np.bool_] | slice) -> _Rows:
        return _Rows(self.travel_mm[rows], self.risen_um[rows], self.weight[rows], self.stroke[rows], self.over_load)

    @property
    def places(self) -> Places:
        return Places(self.travel_mm + self.risen_um / 1000.0, self.travel_mm, self.stroke)

    def residual_um(self, fitted: Fitted) -> Floats:
        """Rise less measured rise, at the same travel; over the load's travel, at the same travel of the motor."""
        if self.over_load:
            return self.places.residual_um(fitted.rise)
        return np.asarray(fitted.rise_um(self.travel_mm) - self.risen_um, dtype=np.float64)


def fit(shape: Shape, reversals: Sequence[MeasuredReversal], shortest_mm: float = 0.0, table: bool = True) -> Fitted:
    """The shape that is closest to all rows of the reversals, with no rise shorter than given. Raises InputError without any.

    table: whether a slope is fitted beside it; False where what belongs to the table has been taken out already.
    """
    return _fit(shape, _Rows.of(reversals), shortest_mm, table)


def compete(
    reversals: Sequence[MeasuredReversal],
    block_mm: float,
    shapes: Sequence[Shape] = SHAPES,
    table: bool = True,
) -> tuple[Contender, ...]:
    """The shapes, the one with the least held-out RMS first.

    With several reversals each is held out in turn, whole. A single one is cut into blocks of `block_mm` of travel, and every fifth
    block is held out in turn. A block has to be shorter than the lengths sought, as no rise shorter than it is tried: it could hide
    where a block is missing. Raises InputError without reversals, or for blocks longer than the stroke.
    """
    rows = _Rows.of(reversals)
    if not 0.0 < block_mm < float(rows.travel_mm.max()):
        raise InputError(f"blocks of {block_mm:g} mm: expected > 0 and less than the stroke")
    fold = rows.stroke if len(reversals) > 1 else (rows.travel_mm // block_mm).astype(np.int64) % FOLDS
    found = []
    for shape in shapes:
        fitted = _fit(shape, rows, block_mm, table)
        residuals = []
        for out in (fold == k for k in np.unique(fold)):
            seen = _fit(shape, rows.where(~out), block_mm, table)
            residuals.append(rows.where(out).residual_um(seen))
        found.append(Contender(fitted, _rms(rows.residual_um(fitted)), _rms(np.concatenate(residuals))))
    return tuple(sorted(found, key=lambda contender: contender.held_out_rms_um))


def reach_of(span_mm: float, shortest_mm: float = 0.0) -> Reach:
    """How far lengths may go over a travel. Slower or later, and a rise could not be told from the table."""
    longest = span_mm / 4.0
    return Reach(min(shortest_mm if shortest_mm > 0.0 else span_mm / 200.0, longest / 2.0), longest, span_mm / 2.0)


def uncertainties(
    rise: Rise, reversals: Sequence[MeasuredReversal], shortest_mm: float
) -> tuple[float, list[float], list[float]]:
    """Standard uncertainties of a rise that was fitted to these reversals over the load's travel: see `standard_uncertainties`."""
    rows = _Rows.of(reversals)
    return standard_uncertainties(rise, rows.places, reach_of(float(rows.travel_mm.max()), shortest_mm))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _fit(shape: Shape, rows: _Rows, shortest_mm: float, table: bool = True) -> Fitted:
    seen = rows.where(slice(None, None, max(1, len(rows.travel_mm) // FIT_ROWS)))
    s, y, w = seen.travel_mm, seen.risen_um, seen.weight
    span = float(s.max())
    slope = s if table else np.zeros_like(s)
    reach = reach_of(span, shortest_mm)

    def solved(lengths: Sequence[float]) -> tuple[Floats, Floats]:
        columns = [shape.columns(s, lengths), slope, -slope]  # the slope may have either sign
        matrix = np.column_stack(columns) * w[:, None]
        amounts, _ = nnls(matrix, w * y)
        return amounts, np.asarray(matrix @ amounts - w * y, dtype=np.float64)

    if shape.knots:
        lengths = tuple(np.geomspace(reach.shortest_mm, span, shape.knots).tolist())
    else:
        lengths = _lengths(shape, solved, reach, span)
    amounts = solved(lengths)[0]
    found = Rise(shape, tuple(float(a) for a in amounts[:-2]), lengths)
    if seen.over_load:
        return Fitted(fit_at_load(found, seen.places, reach))
    return Fitted(found, float(amounts[-2] - amounts[-1]))


def _lengths(
    shape: Shape, solved: Callable[[Sequence[float]], tuple[Floats, Floats]], reach: Reach, span: float
) -> tuple[float, ...]:
    """The lengths with the least squares: from the best start of each onset, as there are several hollows."""
    low = np.array([reach.shortest_mm] * shape.rises + [0.0] * shape.onsets)
    high = np.array([reach.longest_mm] * shape.rises + [reach.onset_mm] * shape.onsets)
    edge = 1e-6 * (high - low)
    rises = np.geomspace(1.01 * reach.shortest_mm, 0.8 * reach.longest_mm, 6).tolist()
    onsets = np.linspace(0.0, 0.8 * reach.onset_mm, 5).tolist()
    starts = [
        min(
            ((*lengths, *onset) for lengths in itertools.product(rises, repeat=shape.rises)),
            key=lambda lengths: float(np.sum(solved(lengths)[1] ** 2)),
        )
        for onset in itertools.product(onsets, repeat=shape.onsets)
    ]
    best = min(
        (
            least_squares(
                lambda v: solved(v)[1], np.clip(one, low + edge, high - edge), bounds=(low, high), x_scale=span / 10.0
            )
            for one in starts
        ),
        key=lambda result: float(result.cost),
    )
    return tuple(float(v) for v in best.x)
