"""The shape of lost motion from measured reversals: two tanh terms, one, an exponential and a dead zone, judged on held-out strokes.

What is linear in travel over one stroke belongs to the table, not to the reversal; it is fitted beside every shape and left out of
the result. Amounts and that slope follow by non-negative least squares for each choice of the lengths, so only those are searched.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from drivers.errors import InputError
from hil.lost_motion.published import TwoTanh

Floats = NDArray[np.float64]

FOLDS = 5
FIT_ROWS = 250
"""A search sees about this many rows, evenly picked; what is reported is of all of them."""


@dataclass(frozen=True)
class MeasuredReversal:
    """One stroke after a reversal, by a laser or a load encoder.

    direction: of the stroke, +1 or -1. travel_mm: shape (n,), ≥ 0, since the reversal. error_um: shape (n,), actual − commanded; its
    first row is taken before the motion starts. stroke_mm: travel of the stroke before; rows beyond it are left out, as the axis is
    back on an earlier branch there. Raises InputError for anything else, and for fewer than 10 rows.
    """

    direction: int
    travel_mm: Floats
    error_um: Floats
    stroke_mm: float = math.inf

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


@dataclass(frozen=True)
class Shape:
    """A way to rise: `columns(travel_mm, lengths_mm)` gives one column for each amount, 0 at travel 0; `rises` lengths come first."""

    name: str
    columns: Callable[[Floats, Sequence[float]], Floats]
    rises: int
    onsets: int = 0


def _two_tanh(s: Floats, lengths: Sequence[float]) -> Floats:
    return np.column_stack([np.tanh(s / lengths[0]), np.tanh(np.maximum(s - lengths[2], 0.0) / lengths[1])])


TWO_TANH = Shape("two tanh", _two_tanh, rises=2, onsets=1)
TANH = Shape("tanh", lambda s, lengths: np.tanh(s / lengths[0])[:, None], rises=1)
EXPONENTIAL = Shape("exponential", lambda s, lengths: -np.expm1(-s / lengths[0])[:, None], rises=1)
DEAD_ZONE = Shape("dead zone", lambda s, lengths: np.minimum(s / lengths[0], 1.0)[:, None], rises=1)
SHAPES = (TWO_TANH, TANH, EXPONENTIAL, DEAD_ZONE)


@dataclass(frozen=True)
class Fitted:
    """A shape with its amounts, µm, its lengths, mm, and what the table was off along the stroke, µm of rise per mm."""

    shape: Shape
    amounts_um: tuple[float, ...]
    lengths_mm: tuple[float, ...]
    table_um_per_mm: float

    def rise_um(self, travel_mm: Floats) -> Floats:
        """What a measured reversal is expected to show, shape (n,): the lost motion come back, and the table's part."""
        columns = self.shape.columns(travel_mm, self.lengths_mm)
        return np.asarray(columns @ np.array(self.amounts_um) + self.table_um_per_mm * travel_mm, dtype=np.float64)

    @property
    def form(self) -> TwoTanh:
        """Pc1, Pc2, a1, a2, b2. Raises InputError for a shape that is not of tanh terms."""
        if self.shape is TWO_TANH:
            return TwoTanh(*self.amounts_um, *self.lengths_mm)
        if self.shape is TANH:
            return TwoTanh(self.amounts_um[0], 0.0, self.lengths_mm[0], self.lengths_mm[0])
        raise InputError(f"{self.shape.name} is no sum of tanh terms")


@dataclass(frozen=True)
class Contender:
    """A shape fitted to all rows, its RMS on them, and its RMS on rows it had not seen, µm."""

    fitted: Fitted
    rms_um: float
    held_out_rms_um: float


def fit(shape: Shape, reversals: Sequence[MeasuredReversal], shortest_mm: float = 0.0, table: bool = True) -> Fitted:
    """The shape that is closest to all rows of the reversals, with no rise shorter than given. Raises InputError without any.

    table: whether a slope is fitted beside it; False where a table that was measured with this motion is in force already.
    """
    travel_mm, risen_um, _ = _rows(reversals)
    return _fit(shape, travel_mm, risen_um, shortest_mm, table)


def compete(
    reversals: Sequence[MeasuredReversal], block_mm: float, shapes: Sequence[Shape] = SHAPES
) -> tuple[Contender, ...]:
    """The shapes, the one with the least held-out RMS first.

    With several reversals each is held out in turn, whole. A single one is cut into blocks of `block_mm` of travel, and every fifth
    block is held out in turn. A block has to be shorter than the lengths sought, as no rise shorter than it is tried: it could hide
    where a block is missing. Raises InputError without reversals, or for blocks longer than the stroke.
    """
    travel_mm, risen_um, stroke = _rows(reversals)
    if not 0.0 < block_mm < float(travel_mm.max()):
        raise InputError(f"blocks of {block_mm:g} mm: expected > 0 and less than the stroke")
    fold = stroke if len(reversals) > 1 else (travel_mm // block_mm).astype(np.int64) % FOLDS
    found = []
    for shape in shapes:
        residuals = []
        for out in (fold == k for k in np.unique(fold)):
            seen = _fit(shape, travel_mm[~out], risen_um[~out], block_mm)
            residuals.append(seen.rise_um(travel_mm[out]) - risen_um[out])
        fitted = _fit(shape, travel_mm, risen_um, block_mm)
        found.append(Contender(fitted, _rms(fitted.rise_um(travel_mm) - risen_um), _rms(np.concatenate(residuals))))
    return tuple(sorted(found, key=lambda contender: contender.held_out_rms_um))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rows(reversals: Sequence[MeasuredReversal]) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """All travels, all rises, and which reversal each is of."""
    if not reversals:
        raise InputError("no reversal was measured")
    rises = [reversal.rise for reversal in reversals]
    stroke = np.repeat(np.arange(len(rises)), [len(travel) for travel, _ in rises])
    return np.concatenate([t for t, _ in rises]), np.concatenate([r for _, r in rises]), stroke


def _fit(shape: Shape, travel_mm: Floats, risen_um: Floats, shortest_mm: float, table: bool = True) -> Fitted:
    every = max(1, len(travel_mm) // FIT_ROWS)
    s, y = travel_mm[::every], risen_um[::every]
    span = float(s.max())
    slope = s if table else np.zeros_like(s)

    def solved(lengths: Sequence[float]) -> tuple[Floats, Floats]:
        matrix = np.column_stack([shape.columns(s, lengths), slope, -slope])  # the slope may have either sign
        amounts, _ = nnls(matrix, y)
        return amounts, np.asarray(matrix @ amounts - y, dtype=np.float64)

    high, last = span / 4.0, span / 2.0  # slower or later, and it could not be told from the table
    low = min(max(span / 200.0, shortest_mm), high / 2.0)
    rises = np.geomspace(max(span / 60.0, 1.01 * low), 0.8 * high, 5).tolist()
    onsets = np.linspace(0.0, 0.8 * last, 5).tolist()
    starts = [  # the best of each onset: the search falls into the nearest of several hollows
        min(
            ((*lengths, *onset) for lengths in itertools.product(rises, repeat=shape.rises)),
            key=lambda lengths: float(np.sum(solved(lengths)[1] ** 2)),
        )
        for onset in itertools.product(onsets, repeat=shape.onsets)
    ]
    bounds = ([low] * shape.rises + [0.0] * shape.onsets, [high] * shape.rises + [last] * shape.onsets)
    best = min(
        (least_squares(lambda v: solved(v)[1], start, bounds=bounds, x_scale=span / 10.0) for start in starts),
        key=lambda result: float(result.cost),
    )
    lengths = tuple(float(v) for v in best.x)
    amounts = solved(lengths)[0]
    return Fitted(shape, tuple(float(a) for a in amounts[:-2]), lengths, float(amounts[-2] - amounts[-1]))
