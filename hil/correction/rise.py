"""Rise of the lost motion with travel since a reversal: the shapes that are fitted, and `Rise`, a shape with its amounts.

Every shape is a sum of non-negative amounts times functions that grow from 0 to 1 with a slope of at most one over their length. So
every fitted rise is monotonic, and its end value and steepest slope are finite.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from drivers.errors import InputError
from hil.correction.published_rise import TwoTanh
from hil.records.rows import Floats

_SETTLED = 40.0
"""Lengths after which 1 - exp is 1 in double precision, tanh after half of them: exp(-40) is 4e-18, and 1 - 2^-54 rounds to 1."""
FULL_UM = 1e-9
"""Amount below which lost motion counts as none, µm."""


class Rises(Protocol):
    """A rise as the running form uses it."""

    @property
    def amount_um(self) -> float:
        """The end value, µm."""

    def risen_um(self, travel_mm: float) -> float:
        """What has come back after this much travel since the reversal that ended a full stroke, 0 … `amount_um`."""


@dataclass(frozen=True)
class RiseShape:
    """A way to rise: `columns(travel_mm, lengths_mm)` gives one column for each amount, 0 at travel 0; `rises` lengths come first.

    at: the sum of amounts times columns at one travel, quickly, for a stream that asks at every set-point.
    settled_mm: travel from which `at` gives the sum of the amounts to the last bit.
    knots: so many lengths are fixed places, evenly spread in their logarithm over the travel that was measured, and not searched.
    """

    name: str
    columns: Callable[[Floats, Sequence[float]], Floats]
    at: Callable[[float, Sequence[float], Sequence[float]], float]
    settled_mm: Callable[[Sequence[float]], float]
    rises: int = 0
    onsets: int = 0
    knots: int = 0


def _two_tanh(s: Floats, lengths: Sequence[float]) -> Floats:
    return np.column_stack([np.tanh(s / lengths[0]), np.tanh(np.maximum(s - lengths[2], 0.0) / lengths[1])])


def _two_tanh_at(s: float, lengths: Sequence[float], amounts: Sequence[float]) -> float:
    first_mm, second_mm, onset_mm = lengths
    early = amounts[0] * math.tanh(s / first_mm)
    return early if s <= onset_mm else early + amounts[1] * math.tanh((s - onset_mm) / second_mm)


def _two_tanh_settled(lengths: Sequence[float]) -> float:
    return max(_SETTLED / 2 * lengths[0], lengths[2] + _SETTLED / 2 * lengths[1])


def _straight_pieces(s: Floats, lengths: Sequence[float]) -> Floats:
    """Column k grows from 0 to 1 between place k - 1 and place k."""
    ends = np.array(lengths)
    starts = np.concatenate([[0.0], ends[:-1]])
    return np.asarray(np.clip((s[:, None] - starts) / (ends - starts), 0.0, 1.0))


def _straight_pieces_at(s: float, lengths: Sequence[float], amounts: Sequence[float]) -> float:
    k = bisect_right(lengths, s)
    if k == len(lengths):
        return sum(amounts)
    start = lengths[k - 1] if k else 0.0
    return sum(amounts[:k]) + amounts[k] * (s - start) / (lengths[k] - start)


TWO_TANH = RiseShape("two tanh", _two_tanh, _two_tanh_at, _two_tanh_settled, rises=2, onsets=1)
TANH = RiseShape(
    "tanh",
    lambda s, lengths: np.tanh(s / lengths[0])[:, None],
    lambda s, lengths, amounts: amounts[0] * math.tanh(s / lengths[0]),
    lambda lengths: _SETTLED / 2 * lengths[0],
    rises=1,
)
EXPONENTIAL = RiseShape(
    "exponential",
    lambda s, lengths: -np.expm1(-s / lengths[0])[:, None],
    lambda s, lengths, amounts: -amounts[0] * math.expm1(-s / lengths[0]),
    lambda lengths: _SETTLED * lengths[0],
    rises=1,
)
DEAD_ZONE = RiseShape(
    "dead zone",
    lambda s, lengths: np.minimum(s / lengths[0], 1.0)[:, None],
    lambda s, lengths, amounts: amounts[0] * min(s / lengths[0], 1.0),
    lambda lengths: lengths[0],
    rises=1,
)
STRAIGHT_PIECES = RiseShape(
    "straight pieces", _straight_pieces, _straight_pieces_at, lambda lengths: lengths[-1], knots=16
)
SHAPES = (TWO_TANH, TANH, EXPONENTIAL, DEAD_ZONE)
"""The smooth shapes of the literature, and the dead zone as the reference that they must improve on."""
RUNNABLE = (*SHAPES, STRAIGHT_PIECES)
"""With straight pieces between sixteen places, for a machine that no other shape describes."""


@dataclass(frozen=True)
class Rise:
    """A shape with its amounts, µm ≥ 0, and its lengths, mm. On a rotary axis read degrees for mm and thousandths of a degree for µm.

    Raises InputError for amounts or lengths that are not of that shape.
    """

    shape: RiseShape
    amounts_um: tuple[float, ...]
    lengths_mm: tuple[float, ...]

    def __post_init__(self) -> None:
        shape, lengths = self.shape, self.lengths_mm
        wanted = shape.rises + shape.onsets + shape.knots
        if len(lengths) != wanted or not all(math.isfinite(v) and v >= 0.0 for v in (*lengths, *self.amounts_um)):
            raise InputError(
                f"{shape.name}: lengths {lengths} mm, amounts {self.amounts_um} µm: expected {wanted} lengths, all ≥ 0"
            )
        steps = np.diff([0.0, *lengths]) if shape.knots else np.array(lengths[: shape.rises])
        if np.any(steps <= 0.0) or shape.columns(np.ones(1), lengths).shape[1] != len(self.amounts_um):
            raise InputError(
                f"{shape.name}: lengths {lengths} mm, amounts {self.amounts_um} µm are not those of such a shape"
            )

    @property
    def amount_um(self) -> float:
        """The whole lost motion, µm."""
        return sum(self.amounts_um)

    def risen_um(self, travel_mm: float) -> float:
        """What has come back after this much travel since the reversal that ended a full stroke, 0 … `amount_um`."""
        return self.shape.at(travel_mm, self.lengths_mm, self.amounts_um)

    @property
    def settled_mm(self) -> float:
        """Travel from which `risen_um` is `amount_um` to the last bit."""
        return self.shape.settled_mm(self.lengths_mm)

    def along_um(self, travel_mm: Floats) -> Floats:
        """`risen_um` for many travels, shape (n,), mm; returns µm, shape (n,)."""
        return np.asarray(self.shape.columns(travel_mm, self.lengths_mm) @ np.array(self.amounts_um), dtype=np.float64)

    @property
    def form(self) -> TwoTanh:
        """Pc1, Pc2, a1, a2, b2. Raises InputError for a shape that is not of tanh terms."""
        if self.shape is TWO_TANH:
            return TwoTanh(*self.amounts_um, *self.lengths_mm)
        if self.shape is TANH:
            return TwoTanh(self.amounts_um[0], 0.0, self.lengths_mm[0], self.lengths_mm[0])
        raise InputError(f"{self.shape.name} is no sum of tanh terms")

    def to_json(self) -> dict[str, Any]:
        """Plain values; `rise_from_json` reads them."""
        return {"shape": self.shape.name, "amounts_um": list(self.amounts_um), "lengths_mm": list(self.lengths_mm)}


def rise_of(form: TwoTanh) -> Rise:
    """The published two terms as a rise."""
    lengths = (form.rise_1_mm, form.rise_2_mm, form.onset_2_mm)
    return Rise(TWO_TANH, (form.amount_1_um, form.amount_2_um), lengths)


def rise_from_json(obj: object, where: str) -> Rise:
    """A rise from plain values. Raises InputError naming `where` for anything that is not exactly one."""
    if not isinstance(obj, Mapping) or set(obj) != {"shape", "amounts_um", "lengths_mm"}:
        raise InputError(f"{where} is not an object with the keys shape, amounts_um, lengths_mm")
    known = {shape.name: shape for shape in RUNNABLE}
    if not isinstance(obj["shape"], str) or obj["shape"] not in known:
        raise InputError(f"{where} names the shape {obj['shape']!r}, expected one of {', '.join(known)}")
    values = {}
    for name in ("amounts_um", "lengths_mm"):
        listed = obj[name]
        if not isinstance(listed, list) or not all(
            isinstance(v, int | float) and not isinstance(v, bool) for v in listed
        ):
            raise InputError(f"{where}.{name} is not a list of numbers")
        values[name] = tuple(float(v) for v in listed)
    try:
        return Rise(known[str(obj["shape"])], values["amounts_um"], values["lengths_mm"])
    except InputError as error:
        raise InputError(f"{where}: {error.what}") from error
