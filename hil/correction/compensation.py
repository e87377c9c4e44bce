"""The compensation engine: computes the command for a target from tables, effects and the state when the set-point is issued.

Pure functions over frozen values: tables, effect terms, the motion so far. command = target + correction, and the correction is that
of the tables for the direction of arrival minus what the effect terms say the error will be. With a measured rise of the lost motion
in force, the tables' two directions are not switched at a reversal: the correction goes from one to the other as the wind-up does.
So it has no step there, the reversal is counted once, and after full strokes it is that of the tables alone. No I/O, no clock, no
memory: the motion so far is a value (`MotionHistory`) that the caller carries from set-point to set-point.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from drivers.errors import InputError, StateError
from hil.correction.bound import CAREFUL, SLOPE_OVER_MM, CorrectionBound
from hil.correction.rise import Rise
from hil.correction.running_lost_motion import Turns, wound_share
from hil.correction.tables import TableSet
from hil.effects import Term
from hil.effects.history import BRANCH, LONG_STROKE_MM, remembered, strokes_of
from hil.records.made_with import MadeWith
from hil.records.rows import UM_PER_MM, Floats
from hil.records.zero import Zero

Columns = Mapping[str, Floats]

BESIDE_MM = (0.0, -SLOPE_OVER_MM / 2, SLOPE_OVER_MM / 2)
"""From a target: where a command's correction is taken, the target first, so that its slope is known."""
_CHECKED_MM = 0.1
"""Distance of the places where effects of position are held against the bound: a hundredth of a usual lead."""

DIRECTION_UNKNOWN = "direction of arrival at {:g} mm is unknown: the axis has not moved since it was switched on"

WOUND_SHARE = "wound_share"
"""Column: 0 after a full stroke in −, 1 after one in +; how far the drive train is wound up between the two."""


class ErrorTerm(Protocol):
    """An effect with its fitted parameters, as the engine needs it (`hil.effects`)."""

    @property
    def needs(self) -> tuple[str, ...]:
        """The columns it reads; the engine refuses to run a term whose columns it cannot give."""

    def error_um(self, columns: Columns) -> Floats:
        """The error the effect causes, µm, shape (n,)."""


def rows_at(places_mm: Sequence[float], row: Mapping[str, float]) -> dict[str, Floats]:
    """Columns of one row for each place, everything else as in the row."""
    columns = {name: np.full(len(places_mm), value, dtype=np.float64) for name, value in row.items()}
    return {**columns, "target_mm": np.array(places_mm, dtype=np.float64)}


def fits_in_a_table(term: ErrorTerm) -> bool:
    """Whether an effect depends on position and direction alone."""
    return set(term.needs) <= {"target_mm", "direction"}


@dataclass(frozen=True)
class MotionHistory:
    """The commanded motion so far, as far as corrections depend on it.

    position_mm: last target
    direction: sign of the last commanded motion, 0 while unknown (after power-on, before the first motion)
    since_reversal_mm: travel since the last reversal, with the motion that ends on `position_mm` included
    stroke_mm: length of the stroke before that reversal; None while there was none
    turns_mm: the reversals that the wind-up remembers (`hil.correction.running_lost_motion`)
    """

    position_mm: float
    direction: int = 0
    since_reversal_mm: float = 0.0
    stroke_mm: float | None = None
    turns_mm: Turns = ()

    @property
    def stroke_or_long_mm(self) -> float:
        """The stroke before the last reversal, mm; `LONG_STROKE_MM` where there was none."""
        return LONG_STROKE_MM if self.stroke_mm is None else self.stroke_mm

    def columns(self) -> dict[str, float]:
        """What the terms read of it, by column; the direction has to be known."""
        return {
            "target_mm": self.position_mm,
            "direction": float(self.direction),
            "since_reversal_mm": self.since_reversal_mm,
            "stroke_mm": self.stroke_or_long_mm,
            **dict(zip(BRANCH, self._strokes_mm, strict=True)),
        }

    @property
    def _strokes_mm(self) -> tuple[float, ...]:
        """Those that are remembered; the first motion of all counts as one after a long stroke, as in the rows that it measures."""
        if self.stroke_mm is None and not self.turns_mm:
            return strokes_of((self.position_mm - self.direction * self.since_reversal_mm,), self.position_mm)
        return strokes_of(self.turns_mm, self.position_mm)

    def moved_to(self, target_mm: float) -> MotionHistory:
        """The history after a straight motion to a target; a motion of no length changes nothing."""
        travel = target_mm - self.position_mm
        if travel == 0.0:
            return self
        direction = 1 if travel > 0 else -1
        if self.direction == 0:
            return MotionHistory(target_mm, direction, abs(travel))
        turns = remembered(self.turns_mm, self.position_mm, self.direction, target_mm)
        if direction == self.direction:
            since_mm = self.since_reversal_mm + abs(travel)
            return MotionHistory(target_mm, direction, since_mm, self.stroke_mm, turns)
        return MotionHistory(target_mm, direction, abs(travel), self.since_reversal_mm, turns)


@dataclass(frozen=True)
class CorrectedSetPoint:
    """One corrected set-point."""

    target_mm: float
    command_mm: float
    correction_um: float
    history: MotionHistory


@dataclass(frozen=True)
class Compensation:
    """A correction: tables, the effects that the tables lack, and the rise of the lost motion after a reversal.

    Without a rise (None) the tables' directions are switched at once. zero: of the axis that it was stored for; None for one made in
    the session that uses it, or by hand. made_with: the drive's parameters then, None in the same cases.
    """

    tables: TableSet
    terms: tuple[ErrorTerm, ...] = field(default=())
    rise: Rise | None = None
    zero: Zero | None = field(default=None, compare=False, kw_only=True)
    made_with: MadeWith | None = field(default=None, compare=False, kw_only=True)

    @cached_property
    def needs(self) -> frozenset[str]:
        """Columns that are read beyond target and direction."""
        own = set() if self.rise is None else {WOUND_SHARE}
        return frozenset(own.union(*(term.needs for term in self.terms))) - {"target_mm", "direction"}

    @property
    def lags(self) -> tuple[tuple[str, float], ...]:
        """The sensors' columns that its effects read through a lag, and the time constant, s, of each."""
        return tuple(lag for term in self.terms if isinstance(term, Term) and (lag := term.lag) is not None)

    @property
    def moves_axis(self) -> str:
        """Name of the other axis that the straightness table moves; "" for none."""
        return "" if self.tables.straightness is None else self.tables.straightness_axis

    @property
    def corrects_reversal(self) -> bool:
        """Whether it takes a reversal out, so that a drive that does as well would take it out twice."""
        by_effects = any({"direction", "since_reversal_mm"}.intersection(term.needs) for term in self.terms)
        return self.rise is not None or by_effects or self.tables.corrects_reversal

    def correction_um(self, columns: Columns) -> Floats:
        """The correction for each row, µm, shape (n,).

        columns: `target_mm`, `direction` and what the terms need, each of shape (n,).
        Raises StateError when a term needs a column that is not there.
        """
        self.require(columns)
        correction = self._of_tables_um(columns)
        for term in self.terms:
            correction = correction - term.error_um(columns)
        return correction

    def require(self, columns: Iterable[str]) -> None:
        """Raises StateError when a term needs a column that is not among these."""
        missing = sorted(self.needs.difference(columns))
        if missing:
            raise StateError(f"the model in force needs {', '.join(missing)}, which this set-up does not provide")

    def check(self, bound: CorrectionBound, what: str) -> None:
        """Hold against a bound what is known without the machine: the tables, with the effects of position and direction alone.

        A rise lies between the tables' two directions, and so within the bound when they are. Other effects depend on sensors and on
        the motion: each command is held against the bound when it is made. Raises CorrectionBoundError naming the worst place.
        """
        tables = self.tables
        static = [term for term in self.terms if fits_in_a_table(term)]
        nodes = tables.nodes_mm
        if static:
            most = math.ceil((nodes[-1] - nodes[0]) / _CHECKED_MM) + 1
            nodes = np.union1d(nodes, np.linspace(nodes[0], nodes[-1], most))
        curves = {}
        for sign in (1, -1):
            columns = {"target_mm": nodes, "direction": np.full(len(nodes), float(sign))}
            errors_um = [term.error_um(columns) for term in static]
            curves[sign] = tables.correction_um(nodes, sign) - np.sum(errors_um, axis=0)
        bound.check_curves(what, nodes, curves)
        if tables.straightness is not None and tables.straightness_axis:
            across = tables.straightness
            curves = {1: across.plus_um, -1: across.minus_um}
            bound.check_curves(f"{what}, to axis {tables.straightness_axis}", across.position_mm, curves)

    def check_rows(self, bound: CorrectionBound, what: str, columns: Columns) -> None:
        """Hold the correction of measured rows, sensors and all, against a bound. Rows that lack a value are left out.

        Raises CorrectionBoundError naming the worst place.
        """
        known = np.all([np.isfinite(columns[name]) for name in (*self.needs, "target_mm")], axis=0)
        rows = {name: values[known] for name, values in columns.items()}
        bound.check_values(what, rows["target_mm"], rows["direction"], self.correction_um(rows))

    def _of_tables_um(self, columns: Columns) -> Floats:
        if self.rise is None:
            return self.tables.correction_um(columns["target_mm"], columns["direction"])
        plus, minus = (self.tables.correction_um(columns["target_mm"], sign) for sign in (1, -1))
        return np.asarray(minus + columns[WOUND_SHARE] * (plus - minus), dtype=np.float64)

    def command(
        self,
        target_mm: float,
        history: MotionHistory,
        known: Mapping[str, float],
        bound: CorrectionBound = CAREFUL,
        actual: MotionHistory | None = None,
    ) -> CorrectedSetPoint:
        """The command for a motion to a target.

        known: sensor values and the like at the moment the set-point is issued (`time_s`, `velocity_mm_s`, `temp_screw_c` …)
        bound: of the axis; a correction beyond it, or steeper with everything else as it is, raises CorrectionBoundError
        actual: the motion by the estimated actual position, with which the lost motion rises; None: it rises with the targets
        Raises InputError for a target that is no position, StateError while the direction of arrival is unknown: a correction
        for a guessed direction may be wrong by the whole backlash.
        """
        if not math.isfinite(target_mm):
            raise InputError(f"target is {target_mm} mm, expected a finite position")
        after = history.moved_to(target_mm)
        if after.direction == 0:
            raise StateError(DIRECTION_UNKNOWN.format(target_mm))
        values = {**known, **after.columns()}
        if self.rise is not None:
            by = after if actual is None or actual.direction == 0 else actual
            values[WOUND_SHARE] = wound_share(self.rise, by.position_mm, by.direction, by.turns_mm)
        near_mm = [target_mm + beside for beside in BESIDE_MM]
        near_um = self.correction_um(rows_at(near_mm, values)).tolist()
        bound.check_command(after.direction, near_mm, near_um)
        correction_um = near_um[0]
        return CorrectedSetPoint(target_mm, target_mm + correction_um / UM_PER_MM, correction_um, after)
