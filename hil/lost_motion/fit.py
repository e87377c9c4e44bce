"""Shapes of lost motion fitted to measured reversals: two tanh terms, one, an exponential, a dead zone …, compared on
held-out strokes.

A part that is linear in travel over one stroke belongs to the table, not to the reversal; it is fitted beside every
shape and left out of the result. Amounts and that slope follow by non-negative least squares for each choice of the
lengths, so only the lengths are searched.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from drivers.errors import InputError
from hil.correction.rise import SHAPES, Rise, RiseShape
from hil.figures.error_figures import rms
from hil.lost_motion.at_load import LengthBounds, StrokePositions, fit_at_load, standard_uncertainties
from hil.records.rows import Floats

FOLDS = 5
"""Folds of the cross-validation within a single reversal."""
FIT_ROWS = 250
"""Rows, evenly thinned, that a search uses at most; the reported residuals are of all rows."""
LEAST_WEIGHT = 0.002
"""Weight, in the first search, of a row where the load stands still while the motor moves."""


@dataclass(frozen=True)
class MeasuredReversal:
    """One stroke after a reversal, measured by a laser or a load encoder.

    direction: of the stroke, +1 or -1
    travel_mm: shape (n,), ≥ 0, since the reversal
    error_um: shape (n,), actual − commanded; the first row is taken before the motion starts
    stroke_mm: travel of the stroke before; rows beyond it are left out, since the axis is then back on an earlier
    branch of the hysteresis
    over_load: the travel is the load's own, see `by_load`
    Raises InputError for other values, and for fewer than 10 rows.
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
        """Travel, mm, and change of the error against the motion since the reversal, µm, both of shape (m,), m ≤ n."""
        kept = self._kept
        risen_um = -self.direction * (self.error_um - self.error_um[0])
        return self.travel_mm[kept], risen_um[kept]

    def by_load(self) -> MeasuredReversal:
        """The same over the load's own travel instead of the motor's, which is what a correction uses.

        While the load sticks, its travel says nothing of the rise, but the rise determines the load's position: such a
        reversal is fitted to the load's position at each travel of the motor. Raises InputError unless the motor's
        travel increases row by row.
        """
        if np.any(np.diff(self.travel_mm) <= 0.0):
            raise InputError("the travel has to grow from row to row to tell the load's travel")
        risen_um = -self.direction * (self.error_um - self.error_um[0])
        return replace(self, travel_mm=np.maximum(self.travel_mm - risen_um / 1000.0, 0.0), over_load=True)

    @property
    def start_weights(self) -> Floats:
        """Weights of the rows of `rise` for a first search, shape (m,): the load's travel per motor travel."""
        travel_mm, risen_um = self.rise
        if not self.over_load:
            return np.ones(len(travel_mm))
        slope = np.diff(travel_mm) / np.diff(travel_mm + risen_um / 1000.0)
        return np.asarray(np.clip(np.minimum(np.append(slope, 1.0), np.append(1.0, slope)), LEAST_WEIGHT, 1.0))


@dataclass(frozen=True)
class Fitted:
    """A rise, and the slope of the table's own error along the stroke, µm per mm."""

    rise: Rise
    table_um_per_mm: float = 0.0

    @property
    def shape(self) -> RiseShape:
        return self.rise.shape

    def rise_um(self, travel_mm: Floats) -> Floats:
        """Expected rise of a measured reversal, µm, shape (n,): the lost motion and the table's part, at travels in
        mm.
        """
        return np.asarray(self.rise.along_um(travel_mm) + self.table_um_per_mm * travel_mm, dtype=np.float64)


@dataclass(frozen=True)
class Contender:
    """A shape fitted to all rows, its RMS on them, and its RMS on held-out rows, µm; over the load's travel: of the
    load's position.
    """

    fitted: Fitted
    rms_um: float
    held_out_rms_um: float


@dataclass(frozen=True)
class _Rows:
    """All rows of some reversals: travel, rise, weight for a first search, and number of the reversal; shape (n,)
    each.
    """

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
    def places(self) -> StrokePositions:
        return StrokePositions(self.travel_mm + self.risen_um / 1000.0, self.travel_mm, self.stroke)

    def residual_um(self, fitted: Fitted) -> Floats:
        """Fitted less measured rise, µm, at the same travel; over the load's travel, at the same travel of the
        motor.
        """
        if self.over_load:
            return self.places.residual_um(fitted.rise)
        return np.asarray(fitted.rise_um(self.travel_mm) - self.risen_um, dtype=np.float64)


def fit(
    shape: RiseShape, reversals: Sequence[MeasuredReversal], shortest_mm: float = 0.0, table: bool = True
) -> Fitted:
    """The shape closest to all rows of the reversals, with no rise shorter than shortest_mm. Raises InputError without
    reversals.

    table: whether a slope is fitted beside it; False where the table's part has been removed already.
    """
    return _fit(shape, _Rows.of(reversals), shortest_mm, table)


def compete(
    reversals: Sequence[MeasuredReversal], block_mm: float, shapes: Sequence[RiseShape] = SHAPES, table: bool = True
) -> tuple[Contender, ...]:
    """The shapes by cross-validation, the one with the least held-out RMS first.

    Several reversals are held out one at a time. A single one is cut into blocks of `block_mm` of travel, and every
    fifth block is held out in turn. A block has to be shorter than the lengths searched, and no rise shorter than it is
    tried, as it could hide where a block is missing. Raises InputError without reversals, or for blocks longer than the
    stroke.
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
        found.append(Contender(fitted, rms(rows.residual_um(fitted)), rms(np.concatenate(residuals))))
    return tuple(sorted(found, key=lambda contender: contender.held_out_rms_um))


def as_stated(rise: Rise, reversals: Sequence[MeasuredReversal]) -> Contender:
    """A rise that was not fitted: every row is held out."""
    fitted, rows = Fitted(rise), _Rows.of(reversals)
    left_um = rms(rows.residual_um(fitted))
    return Contender(fitted, left_um, left_um)


def length_bounds(span_mm: float, shortest_mm: float = 0.0) -> LengthBounds:
    """Bounds of the lengths over a travel, mm. A longer or later rise could not be separated from the table."""
    longest = span_mm / 4.0
    return LengthBounds(
        min(shortest_mm if shortest_mm > 0.0 else span_mm / 200.0, longest / 2.0), longest, span_mm / 2.0
    )


def uncertainties(
    rise: Rise, reversals: Sequence[MeasuredReversal], shortest_mm: float
) -> tuple[float, list[float], list[float]]:
    """Standard uncertainties of a rise fitted to these reversals over the load's travel: see
    `standard_uncertainties`.
    """
    rows = _Rows.of(reversals)
    return standard_uncertainties(rise, rows.places, length_bounds(float(rows.travel_mm.max()), shortest_mm))


def _fit(shape: RiseShape, rows: _Rows, shortest_mm: float, table: bool) -> Fitted:
    seen = rows.where(slice(None, None, max(1, len(rows.travel_mm) // FIT_ROWS)))
    s, y, w = seen.travel_mm, seen.risen_um, seen.weight
    span = float(s.max())
    slope = s if table else np.zeros_like(s)
    bounds = length_bounds(span, shortest_mm)

    def solved(lengths: Sequence[float]) -> tuple[Floats, Floats]:
        columns = [shape.columns(s, lengths), slope, -slope]  # the slope may have either sign
        matrix = np.column_stack(columns) * w[:, None]
        amounts, _ = scipy.optimize.nnls(matrix, w * y)
        return amounts, np.asarray(matrix @ amounts - w * y, dtype=np.float64)

    if shape.knots:
        lengths = tuple(np.geomspace(bounds.shortest_mm, span, shape.knots).tolist())
    else:
        lengths = _lengths(shape, solved, bounds, span)
    amounts = solved(lengths)[0]
    found = Rise(shape, tuple(float(a) for a in amounts[:-2]), lengths)
    if seen.over_load:
        return Fitted(fit_at_load(found, seen.places, bounds))
    return Fitted(found, float(amounts[-2] - amounts[-1]))


def _lengths(
    shape: RiseShape, solved: Callable[[Sequence[float]], tuple[Floats, Floats]], bounds: LengthBounds, span: float
) -> tuple[float, ...]:
    """The lengths with the least squares: searched from the best start for each onset, since there are several local
    minima.
    """
    low = np.array([bounds.shortest_mm] * shape.rises + [0.0] * shape.onsets)
    high = np.array([bounds.longest_mm] * shape.rises + [bounds.onset_mm] * shape.onsets)
    edge = 1e-6 * (high - low)
    rises = np.geomspace(1.01 * bounds.shortest_mm, 0.8 * bounds.longest_mm, 6).tolist()
    onsets = np.linspace(0.0, 0.8 * bounds.onset_mm, 5).tolist()
    starts = [
        min(
            ((*lengths, *onset) for lengths in itertools.product(rises, repeat=shape.rises)),
            key=lambda lengths: float(np.sum(solved(lengths)[1] ** 2)),
        )
        for onset in itertools.product(onsets, repeat=shape.onsets)
    ]
    best = min(
        (
            scipy.optimize.least_squares(
                lambda v: solved(v)[1], np.clip(one, low + edge, high - edge), bounds=(low, high), x_scale=span / 10.0
            )
            for one in starts
        ),
        key=lambda result: float(result.cost),
    )
    return tuple(float(v) for v in best.x)
