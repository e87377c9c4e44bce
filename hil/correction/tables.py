"""Correction tables of one axis, and the arithmetic of system A on them (JP4875672B2).

Every table holds *corrections* in µm (what is added to the command), so pitch correction = A - B in the + direction and A - C in the
- direction (A target, B and C mean measured positions).
Between nodes corrections are linear in position; beyond the ends the end value holds.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.errors import InputError
from drivers.toml_types import Number, Sign
from hil.records.rows import Floats, Records

FORMAT = "hil-tables/1"


class TableMode(Enum):
    """How the two directions are stored."""

    BIDIRECTIONAL = "bidirectional"  # one pitch table per direction; the backlash is inside them
    UNIDIRECTIONAL_BACKLASH = "unidirectional+backlash"  # the + direction, and the backlash beside it
    MEAN_BACKLASH = "mean+backlash"  # the mean of both directions, and the backlash beside it, half of it each way


INTERPOLATIONS = ("linear", "step")
"""Between two targets: the correction changes in proportion, or each section around a target keeps its value."""
RAMP_MM = 0.001
"""Travel over which the correction changes from one section to the next, of "step": a set-point apart at 1 mm/s and 1 ms."""
_MANY = 1000
"""Positions from which one search in a joined table takes less time than two (`tests/bench/test_engine_cost.py`)."""


def _column(values: ArrayLike, what: str) -> Floats:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what} must be a list of finite numbers") from error
    if array.ndim != 1 or not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be a list of finite numbers")
    array.setflags(write=False)
    return array


def _positions(values: ArrayLike) -> Floats:
    array = _column(values, "position_mm")
    if len(array) == 0 or np.any(np.diff(array) <= 0):
        raise InputError("position_mm must hold at least one position, strictly ascending")
    return array


def _section_ends(position_mm: Floats) -> Floats:
    """Begin and end of the section around each position, mm, (2 n,); sections are a ramp apart. The outer ones end a ramp outside.

    Raises InputError for positions that are not two ramps apart.
    """
    gaps = np.diff(position_mm)
    if len(gaps) and float(gaps.min()) < 2.0 * RAMP_MM:
        raise InputError(
            f"sections of {gaps.min():g} mm: expected at least {2.0 * RAMP_MM:g} mm for a correction by steps"
        )
    half = position_mm[:-1] + gaps / 2.0
    begins = np.concatenate([[position_mm[0] - RAMP_MM], half + RAMP_MM / 2.0])
    ends = np.concatenate([half - RAMP_MM / 2.0, [position_mm[-1] + RAMP_MM]])
    return np.column_stack([begins, ends]).ravel()


def _is_plus(direction: ArrayLike) -> NDArray[np.bool_]:
    """Where a direction is +1; a direction that is neither +1 nor -1 is refused, never guessed."""
    signs = np.asarray(direction, dtype=np.float64)
    if not np.all(np.abs(signs) == 1.0):
        raise InputError("direction of arrival is unknown: expected +1 or -1")
    return np.asarray(signs > 0)


def _same_length(name: str, array: Floats, positions: Floats) -> None:
    if len(array) != len(positions):
        raise InputError(f"{name} has {len(array)} values for {len(positions)} positions")


@dataclass(frozen=True, eq=False)
class SingleTable:
    """One value per position: a backlash table, D = C - B, µm."""

    position_mm: Floats
    value_um: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_mm", _positions(self.position_mm))
        object.__setattr__(self, "value_um", _column(self.value_um, "value_um"))
        _same_length("value_um", self.value_um, self.position_mm)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SingleTable) and _single_dict(self) == _single_dict(other)

    def __hash__(self) -> int:
        return hash(tuple(self.position_mm.tolist()))

    def at(self, position_mm: ArrayLike) -> Floats:
        """Value in µm at positions of any shape."""
        return np.asarray(
            np.interp(np.asarray(position_mm, dtype=np.float64), self.position_mm, self.value_um), dtype=np.float64
        )

    def stepped(self) -> SingleTable:
        """See `TableSet.stepped`."""
        return SingleTable(_section_ends(self.position_mm), np.repeat(self.value_um, 2))


@dataclass(frozen=True, eq=False)
class DirectionalTable:
    """A correction per direction at the same positions, µm."""

    position_mm: Floats
    plus_um: Floats
    minus_um: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_mm", _positions(self.position_mm))
        for name in ("plus_um", "minus_um"):
            object.__setattr__(self, name, _column(getattr(self, name), name))
            _same_length(name, getattr(self, name), self.position_mm)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, DirectionalTable) and _directional_dict(self) == _directional_dict(other)

    def __hash__(self) -> int:
        return hash(tuple(self.position_mm.tolist()))

    @classmethod
    def constant(cls, position_mm: Floats, value_um: float) -> DirectionalTable:
        """The same value everywhere, in both directions."""
        return cls.alike(position_mm, np.full(len(position_mm), value_um))

    @classmethod
    def alike(cls, position_mm: ArrayLike, value_um: ArrayLike) -> DirectionalTable:
        """The same values in both directions."""
        values = _column(value_um, "value_um")
        return cls(_positions(position_mm), values, values)

    @property
    def is_alike(self) -> bool:
        """Whether both directions have the same values."""
        return bool(np.all(self.plus_um == self.minus_um))

    def at(self, position_mm: ArrayLike, direction: ArrayLike) -> Floats:
        """Correction in µm at positions, arrived at in a direction, broadcast together. InputError unless it is +1 or -1."""
        position, is_plus = np.asarray(position_mm, dtype=np.float64), _is_plus(direction)
        if is_plus.ndim == 0:
            one_um = self.plus_um if is_plus else self.minus_um
            return np.asarray(np.interp(position, self.position_mm, one_um), dtype=np.float64)
        if position.size < _MANY or self._joined is None:
            plus, minus = (np.interp(position, self.position_mm, one) for one in (self.plus_um, self.minus_um))
            return np.asarray(np.where(is_plus, plus, minus), dtype=np.float64)
        both_mm, both_um, apart_mm = self._joined
        inside = np.clip(position, self.position_mm[0], self.position_mm[-1])
        return np.asarray(np.interp(np.where(is_plus, inside, inside + apart_mm), both_mm, both_um), dtype=np.float64)

    @cached_property
    def _joined(self) -> tuple[Floats, Floats, float] | None:
        """Both directions as one table, the − direction's places moved up by the third value, mm: one search in place of two.

        None where moved places would no longer ascend.
        """
        apart_mm = float(np.ptp(self.position_mm)) + 1.0
        both_mm = np.concatenate([self.position_mm, self.position_mm + apart_mm])
        ascend = bool(np.all(np.diff(both_mm) > 0.0))
        return (both_mm, np.concatenate([self.plus_um, self.minus_um]), apart_mm) if ascend else None

    def stepped(self) -> DirectionalTable:
        """See `TableSet.stepped`."""
        ends = _section_ends(self.position_mm)
        return DirectionalTable(ends, np.repeat(self.plus_um, 2), np.repeat(self.minus_um, 2))

    def plus(self, other: DirectionalTable) -> DirectionalTable:
        """The sum, on the nodes of both."""
        nodes = np.union1d(self.position_mm, other.position_mm)
        return DirectionalTable(nodes, self.at(nodes, 1) + other.at(nodes, 1), self.at(nodes, -1) + other.at(nodes, -1))

    def plus_at_own(self, other: DirectionalTable) -> DirectionalTable:
        """The sum on this table's own nodes."""
        nodes = self.position_mm
        return DirectionalTable(nodes, self.plus_um + other.at(nodes, 1), self.minus_um + other.at(nodes, -1))

    def scaled(self, factor: float) -> DirectionalTable:
        """All corrections times a factor."""
        return DirectionalTable(self.position_mm, self.plus_um * factor, self.minus_um * factor)


@dataclass(frozen=True)
class TableSet:
    """The tables in force on one axis.

    mode: how `pitch` is to be read. In BIDIRECTIONAL mode `pitch` holds both directions, and `backlash`, when present, is
    knowledge kept for machines that can store one direction only: it is **not** added. In UNIDIRECTIONAL_BACKLASH mode only
    `pitch.plus_um` is used and the - direction is plus - backlash. In MEAN_BACKLASH mode the mean of both of `pitch` is used, and the
    directions are mean + backlash/2 and mean - backlash/2: a backlash that was measured by other means takes the place of the
    directions' own difference, so that it is counted once.
    specified: the specified-accuracy correction (E in the + direction, F in the - direction), or None
    straightness: a correction in µm from a straightness (tilt) measurement, by position and direction, or None
    straightness_axis: which axis's command it is added to; "" is this axis, otherwise the name of the cross axis
    """

    mode: TableMode
    pitch: DirectionalTable
    backlash: SingleTable | None = None
    specified: DirectionalTable | None = None
    straightness: DirectionalTable | None = None
    straightness_axis: str = ""

    def __post_init__(self) -> None:
        if self.mode is not TableMode.BIDIRECTIONAL and self.backlash is None:
            raise InputError(f"table mode {self.mode.value} needs a backlash table")

    @classmethod
    def zero(cls, position_mm: Floats) -> TableSet:
        return cls(TableMode.BIDIRECTIONAL, DirectionalTable.constant(position_mm, 0.0))

    @property
    def nodes_mm(self) -> Floats:
        """The nodes of all parts that are added to the axis's own command, ascending: between them `correction_um` is linear."""
        parts = [self.pitch.position_mm]
        if self.mode is not TableMode.BIDIRECTIONAL and self.backlash is not None:
            parts.append(self.backlash.position_mm)
        if self.specified is not None:
            parts.append(self.specified.position_mm)
        if self.straightness is not None and not self.straightness_axis:
            parts.append(self.straightness.position_mm)
        return np.unique(np.concatenate(parts))

    @property
    def corrects_reversal(self) -> bool:
        """Whether the pitch part differs in the two directions anywhere."""
        nodes = self.nodes_mm
        return bool(np.any(self.pitch_um(nodes, 1) != self.pitch_um(nodes, -1)))

    def pitch_um(self, position_mm: ArrayLike, direction: ArrayLike) -> Floats:
        """The pitch part with the direction's share of the backlash, counted once, µm."""
        if self.mode is TableMode.BIDIRECTIONAL or self.backlash is None:
            return self.pitch.at(position_mm, direction)
        plus, amount = self.pitch.at(position_mm, 1), self.backlash.at(position_mm)
        if self.mode is TableMode.MEAN_BACKLASH:
            plus = (plus + self.pitch.at(position_mm, -1) + amount) / 2
        return np.asarray(np.where(_is_plus(direction), plus, plus - amount))

    def correction_um(self, position_mm: ArrayLike, direction: ArrayLike) -> Floats:
        """The whole correction at rest on a position, arrived at in a direction, µm."""
        total = self.pitch_um(position_mm, direction)
        if self.specified is not None:
            total = total + self.specified.at(position_mm, direction)
        if self.straightness is not None and not self.straightness_axis:
            total = total + self.straightness.at(position_mm, direction)
        return total

    def cross_correction_um(self, position_mm: ArrayLike, direction: ArrayLike, cross_axis: str) -> Floats:
        """What this axis's position, arrived at in a direction, adds to the command of another axis, µm; zero unless a straightness
        table names it.
        """
        if self.straightness is None or not cross_axis or cross_axis != self.straightness_axis:
            return np.zeros(np.shape(position_mm))
        return self.straightness.at(position_mm, direction)

    def with_backlash(self, backlash: SingleTable) -> TableSet:
        """The same pitch with a backlash that was measured by other means, on positions of its own; it counts once.

        Beside two-directional tables it takes the place of their own difference; beside one-directional ones the + direction stays.
        """
        one = self.mode is TableMode.UNIDIRECTIONAL_BACKLASH
        return replace(self, mode=self.mode if one else TableMode.MEAN_BACKLASH, backlash=backlash)

    def combined(self) -> TableSet:
        """Pitch and specified-accuracy in one table with one look-up; the same output everywhere.

        The difference F - E of the two directions moves into the backlash table, which may have been measured by other means:
        plus' = pitch + E, D' = D - (F - E).
        """
        if self.specified is None:
            return self
        nodes = np.union1d(self.pitch.position_mm, self.specified.position_mm)
        if self.backlash is not None:
            nodes = np.union1d(nodes, self.backlash.position_mm)
        part = {sign: self.pitch_um(nodes, sign) + self.specified.at(nodes, sign) for sign in (1, -1)}
        pitch = DirectionalTable(nodes, part[1], part[-1])
        backlash = self.backlash
        if backlash is not None:
            moved = self.specified.at(nodes, 1) - self.specified.at(nodes, -1)
            backlash = SingleTable(nodes, backlash.at(nodes) + moved)
        return replace(self, pitch=pitch, backlash=backlash, specified=None)

    def stepped(self) -> TableSet:
        """Each table with one value for the section around each of its positions, up to half-way to the next (claims 1 and 2, S6)."""
        return replace(
            self,
            pitch=self.pitch.stepped(),
            backlash=None if self.backlash is None else self.backlash.stepped(),
            specified=None if self.specified is None else self.specified.stepped(),
            straightness=None if self.straightness is None else self.straightness.stepped(),
        )

    def to_dict(self) -> dict[str, Any]:
        """A JSON-able form; `from_dict` gives the same tables back bit for bit."""
        return {
            "format": FORMAT,
            "mode": self.mode.value,
            "pitch": _directional_dict(self.pitch),
            "backlash": None if self.backlash is None else _single_dict(self.backlash),
            "specified": None if self.specified is None else _directional_dict(self.specified),
            "straightness": None if self.straightness is None else _directional_dict(self.straightness),
            "straightness_axis": self.straightness_axis,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TableSet:
        """Tables from the form of `to_dict`. Raises InputError for any other."""
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            found = data.get("format") if isinstance(data, Mapping) else type(data).__name__
            raise InputError(f"tables have format {found!r}, expected {FORMAT!r}")
        _check_keys(data, ("format", "mode", *_PARTS, "straightness_axis"), "tables")
        try:
            mode = TableMode(data["mode"])
        except ValueError as error:
            modes = " or ".join(mode.value for mode in TableMode)
            raise InputError(f"tables have mode {data['mode']!r}, expected {modes}") from error
        axis = data["straightness_axis"]
        if not isinstance(axis, str):
            raise InputError(f"tables have straightness_axis {axis!r}, expected a name or an empty one")
        if data["pitch"] is None:
            raise InputError("tables lack pitch")
        part: dict[str, Any] = {
            name: None if data[name] is None else _part(kind, data[name], name) for name, kind in _PARTS.items()
        }
        return cls(mode=mode, straightness_axis=axis, **part)

    def digest(self) -> str:
        """SHA-256 over the canonical JSON form, hex; a report names the tables in force by it."""
        text = json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


_PARTS: Mapping[str, type[SingleTable | DirectionalTable]] = {
    "pitch": DirectionalTable,
    "backlash": SingleTable,
    "specified": DirectionalTable,
    "straightness": DirectionalTable,
}


def _check_keys(data: Mapping[str, Any], expected: Sequence[str], what: str) -> None:
    for name in expected:
        if name not in data:
            raise InputError(f"{what} lack {name}")
    for name in data:
        if name not in expected:
            raise InputError(f"{what} hold an unknown entry {name!r}")


def _part(kind: type[SingleTable | DirectionalTable], data: object, name: str) -> Any:
    """One table of the plain form; only JSON numbers are numbers in it, neither true nor "1"."""
    if not isinstance(data, Mapping):
        raise InputError(f"{name} is {type(data).__name__}, expected a table")
    if kind is DirectionalTable and set(data) == {
        "position_mm",
        "value_um",
    }:  # straightness stored before it had directions
        data = {"position_mm": data["position_mm"], "plus_um": data["value_um"], "minus_um": data["value_um"]}
    columns = tuple(column.name for column in fields(kind))
    _check_keys(data, columns, name)
    for column in columns:
        if not isinstance(data[column], list):
            raise InputError(f"{name}.{column} is {type(data[column]).__name__}, expected a list of finite numbers")
        for value in data[column]:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"{name}.{column} holds {value!r:.40}, expected a finite number")
    try:
        return kind(**data)
    except InputError as error:
        raise InputError(f"{name}: {error.what}") from error


def _directional_dict(table: DirectionalTable) -> dict[str, list[float]]:
    return {
        "position_mm": table.position_mm.tolist(),
        "plus_um": table.plus_um.tolist(),
        "minus_um": table.minus_um.tolist(),
    }


def _single_dict(table: SingleTable) -> dict[str, list[float]]:
    return {"position_mm": table.position_mm.tolist(), "value_um": table.value_um.tolist()}


@dataclass(frozen=True)
class SectionMeans:
    """Means of the repeated runs, per section (target) and direction.

    plus_um, minus_um: mean error (B - A, C - A) of the machine as it was commanded, µm, NaN where a direction was not measured
    """

    target_mm: Floats
    plus_um: Floats
    minus_um: Floats
    pooled_std_um: float  # standard deviation of a single run about its section's mean; NaN with one run


def section_means(records: Records, error_um: Floats | None = None) -> SectionMeans:
    """Means per target and direction of `error_um` (default: error as measured), shape (rows,).

    Rows belong to one section when their targets are equal to the nanometre.
    """
    error = records.error_um if error_um is None else error_um
    keys = np.round(records.target_mm, 6)
    targets = np.unique(keys)
    means = {1: np.full(len(targets), np.nan), -1: np.full(len(targets), np.nan)}
    squares, degrees = 0.0, 0
    for index, target in enumerate(targets):
        for direction in (1, -1):
            values = error[(keys == target) & (records.direction == direction)]
            if len(values):
                means[direction][index] = values.mean()
                squares += float(np.sum((values - values.mean()) ** 2))
                degrees += len(values) - 1
    pooled = math.sqrt(squares / degrees) if degrees else math.nan
    return SectionMeans(targets, means[1], means[-1], pooled)


def compute_tables(
    records: Records, mode: TableMode = TableMode.BIDIRECTIONAL, straightness: DirectionalTable | None = None
) -> TableSet:
    """Pitch and backlash tables from measured runs (system A).

    Uses the error of the uncorrected machine (measured - command), so records taken with a correction in force serve as well. A
    straightness table that goes into the same set (and the same command) takes its part of the error: what it corrects at a
    section is not corrected again by the pitch table.
    Raises InputError when a section lacks one of its directions.
    """
    means = section_means(records, records.uncorrected_error_um)
    for direction, values in (("+", means.plus_um), ("-", means.minus_um)):
        lacking = means.target_mm[np.isnan(values)]
        if len(lacking):
            raise InputError(f"section at {lacking[0]:g} mm was not measured in the {direction} direction")
    own = DirectionalTable(means.target_mm, -means.plus_um, -means.minus_um)
    pitch = own if straightness is None else own.plus_at_own(straightness.scaled(-1.0))
    backlash = SingleTable(means.target_mm, pitch.plus_um - pitch.minus_um)
    return TableSet(mode, pitch, backlash, straightness=straightness)


# -- specified accuracy ------------------------------------------------------------------------------------------------


_SAME_MM = 1e-6  # between two targets that are the same one: rows state them to the nanometre


@dataclass(frozen=True)
class SignedSections:
    """The sign of a specified accuracy in the sections from a position up to, and not including, another, mm.

    plus, minus: of the + and of the - direction, +1 or -1: system A lets the builder choose it for E and F of every section (S14)
    """

    from_mm: Number
    to_mm: Number
    plus: Sign = 1
    minus: Sign = 1

    def __post_init__(self) -> None:
        if not self.from_mm < self.to_mm:
            raise InputError(f"sections from {self.from_mm:g} to {self.to_mm:g} mm, expected from_mm < to_mm")
        if not {self.plus, self.minus} <= {1, -1}:
            raise InputError(f"signs are {self.plus} and {self.minus}, expected 1 or -1")


@dataclass(frozen=True)
class Band:
    """A specified accuracy: the machine's mean error is to lie between low and high, µm, in every section and direction.

    signs: where it is to lie between -high and -low instead; sections and directions that are not named have the sign +
    """

    low_um: float
    high_um: float
    signs: tuple[SignedSections, ...] = ()

    def __post_init__(self) -> None:
        ordered = sorted(self.signs, key=lambda sections: sections.from_mm)
        for one, other in itertools.pairwise(ordered):
            if other.from_mm < one.to_mm:
                raise InputError(f"sections from {other.from_mm:g} mm have two signs, another ends at {one.to_mm:g} mm")
        if not (math.isfinite(self.low_um) and math.isfinite(self.high_um) and self.low_um < self.high_um):
            raise InputError(f"band is {self.low_um} to {self.high_um} µm, expected low < high")

    @property
    def middle_um(self) -> float:
        """Middle of the band, µm."""
        return (self.low_um + self.high_um) / 2

    @property
    def width_um(self) -> float:
        """Width of the band, µm."""
        return self.high_um - self.low_um

    def at(self, position_mm: float, direction: int) -> Band:
        """The band of one section and direction, with its sign."""
        for one in self.signs:
            if one.from_mm <= position_mm < one.to_mm:
                sign = one.plus if direction > 0 else one.minus
                return Band(self.low_um, self.high_um) if sign > 0 else Band(-self.high_um, -self.low_um)
        return Band(self.low_um, self.high_um)

    def nearest_um(self, error_um: float) -> float:
        """The error itself inside the band, else its nearer end, µm."""
        return min(max(error_um, self.low_um), self.high_um)

    def stretches(self, low_mm: float, high_mm: float) -> list[tuple[float, float, Band, Band]]:
        """From, to, mm, and the bands of the + and - direction there: between low and high, cut where a sign may change."""
        cuts = {end for one in self.signs for end in (one.from_mm, one.to_mm) if low_mm < end < high_mm}
        ends = sorted({low_mm, *cuts, high_mm})
        return [(start, end, self.at(start, 1), self.at(start, -1)) for start, end in itertools.pairwise(ends)]

    def unlike_targets(
        self, position_mm: float, direction: int, targets_mm: Sequence[float]
    ) -> tuple[float, float] | None:
        """The targets on both sides, mm, where they have bands of different sign, so that the correction between them runs from one to
        the other and the band is asked for at neither value; None where they have one, as at a target itself.

        targets_mm: that the tables were made at
        """
        if not self.signs or not targets_mm:
            return None
        low = max((t for t in targets_mm if t <= position_mm + _SAME_MM), default=min(targets_mm))
        high = min((t for t in targets_mm if t >= position_mm - _SAME_MM), default=max(targets_mm))
        return None if self.at(low, direction) == self.at(high, direction) else (low, high)

    def __str__(self) -> str:
        return f"{self.low_um:g} to {self.high_um:g} µm{', with the signs of its sections' if self.signs else ''}"

    def holds(self, error_um: ArrayLike) -> NDArray[np.bool_]:
        """True where an error lies inside; NaN (not measured) lies outside."""
        error = np.asarray(error_um, dtype=np.float64)
        return np.asarray((error >= self.low_um) & (error <= self.high_um))

    def check_repeatability(self, pooled_std_um: float) -> None:
        """Raises InputError for a band narrower than the machine's own repeatability (4 s, ISO 230-2), naming both figures.

        pooled_std_um: standard deviation of a single run, µm; NaN (one run) raises too.
        """
        if math.isnan(pooled_std_um):
            raise InputError("a band needs the machine's repeatability, and that at least 2 runs")
        repeatability_um = 4 * pooled_std_um
        if self.width_um < repeatability_um:
            raise InputError(
                f"band {self.low_um:g} to {self.high_um:g} µm is {self.width_um:.2f} µm wide, narrower than the machine's"
                f" repeatability of {repeatability_um:.2f} µm (4 s); widen the band or improve the machine"
            )


def initial_specified(target_mm: Floats, band: Band) -> DirectionalTable:
    """The middle of the band with its sign: E in the + direction, F in the - direction, in every section."""
    plus, minus = ([band.at(float(target), sign).middle_um for target in target_mm] for sign in (1, -1))
    return DirectionalTable(target_mm, np.array(plus), np.array(minus))


def revised_value_um(
    target_um: float, specified_um: float, measured_um: float, wanted_um: float | None = None
) -> float:
    """One revision of system A: E + {(A + E) - B}, all in µm. Worked case: A 0.5, E 6.5, B 6.0 gives 7.5.

    `wanted_um` is the deviation that is really wanted; in the first round it is E itself, as published. From the second round
    on E has moved away from it, and aiming at A + E again would run away from the band.
    """
    wanted = specified_um if wanted_um is None else wanted_um
    return specified_um + ((target_um + wanted) - measured_um)


@dataclass(frozen=True)
class OutsideBand:
    """One section and direction whose mean error lies outside the band."""

    target_mm: float
    direction: int
    error_um: float

    def __str__(self) -> str:
        return f"{self.target_mm:g} mm {'+' if self.direction > 0 else '-'} ({self.error_um:+.2f} µm)"


def sections_outside(means: SectionMeans, band: Band) -> list[OutsideBand]:
    """The measured sections and directions outside the band; what was not measured is not judged."""
    found = []
    for direction, errors in ((1, means.plus_um), (-1, means.minus_um)):
        for target, error in zip(means.target_mm, errors, strict=True):
            if not math.isnan(error) and not bool(band.at(float(target), direction).holds(error)):
                found.append(OutsideBand(float(target), direction, float(error)))
    return sorted(found, key=lambda section: (section.target_mm, -section.direction))


@dataclass(frozen=True)
class NotJudged:
    """One section and direction that no band is asked for: it lies between targets whose bands differ in sign.

    low_mm, high_mm: those targets; the correction runs from the one's specified value to the other's
    """

    target_mm: float
    direction: int
    low_mm: float
    high_mm: float

    def __str__(self) -> str:
        return (
            f"{self.target_mm:g} mm {'+' if self.direction > 0 else '-'}, between the targets {self.low_mm:g} and {self.high_mm:g} mm:"
            " their specified values differ in sign, and the correction runs from one to the other"
        )


def judge(
    means: SectionMeans, band: Band, targets_mm: Sequence[float]
) -> tuple[tuple[OutsideBand, ...], tuple[NotJudged, ...]]:
    """The sections outside the band, and those not judged (`Band.unlike_targets`). targets_mm: that the tables were made at."""
    unlike = []
    for direction, errors in ((1, means.plus_um), (-1, means.minus_um)):
        for target in means.target_mm[~np.isnan(errors)].tolist():
            if (beside := band.unlike_targets(target, direction, targets_mm)) is not None:
                unlike.append(NotJudged(target, direction, *beside))
    places = {(one.target_mm, one.direction) for one in unlike}
    outside = [one for one in sections_outside(means, band) if (one.target_mm, one.direction) not in places]
    return tuple(outside), tuple(sorted(unlike, key=lambda one: (one.target_mm, -one.direction)))


def revise(
    specified: DirectionalTable, outside: Iterable[OutsideBand], band: Band, *, fine_step_um: float | None = None
) -> DirectionalTable:
    """The specified-accuracy table with the sections outside the band revised, µm.

    fine_step_um: None, by system A's formula with the middle of the band as the wanted deviation; else by one such step towards the
    band. Raises InputError for a section that the table lacks.
    """
    values = {1: specified.plus_um.copy(), -1: specified.minus_um.copy()}
    for section in outside:
        index = int(np.argmin(np.abs(specified.position_mm - section.target_mm)))
        if abs(specified.position_mm[index] - section.target_mm) > 1e-6:
            raise InputError(f"no section of the specified-accuracy table at {section.target_mm:g} mm")
        wanted_um = band.at(section.target_mm, section.direction).middle_um
        if fine_step_um is None:
            old = float(values[section.direction][index])
            values[section.direction][index] = revised_value_um(0.0, old, section.error_um, wanted_um)
        else:
            step = math.copysign(fine_step_um, wanted_um - section.error_um)
            values[section.direction][index] += step
    return DirectionalTable(specified.position_mm, values[1], values[-1])


# -- straightness --------------------------------------------------------------------------------------------------------


def split_specified(tables: TableSet, straightness_share: float) -> TableSet:
    """Share the specified-accuracy correction out between pitch and straightness.

    part_straightness = share · E and share · F, part_pitch = specified - part_straightness; stored pitch = pitch + part_pitch, stored
    straightness = straightness + part_straightness, and no separate specified table is left. Both are added to the command, so
    the total is what it was; a straightness table that corrects a cross axis cannot take a share.
    Raises InputError for a share outside 0..1, without a specified table, or with a cross-axis straightness table.
    """
    if not 0.0 <= straightness_share <= 1.0:
        raise InputError(f"straightness share is {straightness_share}, expected 0 to 1")
    if tables.specified is None:
        raise InputError("straightness_share needs a specified accuracy (band_um)")
    if tables.straightness_axis:
        raise InputError(
            f"the straightness table corrects axis {tables.straightness_axis}, so it cannot take a share of the specified accuracy"
        )
    part_straightness = tables.specified.scaled(straightness_share)
    part_pitch = tables.specified.scaled(1.0 - straightness_share)
    straightness = part_straightness if tables.straightness is None else tables.straightness.plus(part_straightness)
    return replace(replace(tables, specified=part_pitch).combined(), straightness=straightness)


def straightness_table(
    position_mm: ArrayLike, deviation_um: ArrayLike, minus_um: ArrayLike | None = None
) -> DirectionalTable:
    """Straightness correction from measured deviations across the axis: correction = -deviation, µm.

    minus_um: deviation in the - direction, None where it is that of the + direction
    """
    plus = -_column(deviation_um, "deviation_um")
    minus = plus if minus_um is None else -_column(minus_um, "deviation_um")
    return DirectionalTable(_positions(position_mm), plus, minus)
