"""The correction of a stream of set-points, prepared once: the same as `Compensation.command` in a small part of its time.

Within a stream the sensors' values stay as they were at its begin. So what the place alone decides is prepared: the tables of both
directions and every effect that is straight along the axis become one list of sections, and each other effect a function of the place
(`Term.along`). The wind-up of the lost motion changes its course only at a reversal and where a loop closes; between two of these
lies a `_Branch`.

A set-point that goes on along its branch is computed from these and held against the largest correction; the slope was held against
its bound when the branch began, by the steepest that all parts together can be. Every other set-point is computed at three places and
held against the bound as `Compensation.command` does: a reversal, a loop that closes, an axis that stands, a correction beyond the
bound, parts that could be too steep together, effects of time, feed or travel, a lost motion that rises with the actual position.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError, StateError
from hil.correction.bound import BEYOND_WITH_STRAIGHTNESS, SLOPE_OVER_MM, CorrectionBound
from hil.correction.compensation import (
    BESIDE_MM,
    DIRECTION_UNKNOWN,
    WOUND_SHARE,
    Compensation,
    ErrorTerm,
    MotionHistory,
    rows_at,
)
from hil.correction.rise import FULL_UM
from hil.correction.running_lost_motion import share_of, wound_at_turn_um, wound_share
from hil.correction.tables import TableSet
from hil.effects.base import Straight, Term, Wave
from hil.records.rows import UM_PER_MM

_CHANGING = frozenset({"time_s", "velocity_mm_s", "since_reversal_mm", "stroke_mm", WOUND_SHARE})
"""Columns that change from set-point to set-point; the direction has its two values."""
_OWN = ("since_reversal_mm", "stroke_mm")
_SLACK = 1e-9
"""Share that the steepest slope stays below its bound, for rounding."""
_UNCORRECTED = Compensation(TableSet.zero(np.zeros(1)))

_Section = tuple[float, float, float, float, float]
"""Between two nodes: the first, mm; the correction there in the − direction, µm, and its slope, µm/mm; what + has more of both."""


@dataclass(frozen=True, slots=True)
class _Along:
    """What the place alone decides, in one direction. sections[i]: below node i; wave_um: effects that are not straight; steepest:
    of all together, µm/mm.
    """

    nodes_mm: list[float]
    sections: list[_Section]
    wave_um: Callable[[float], float] | None
    steepest: float

    def correction_um(self, place_mm: float, share: float) -> float:
        """The correction with this share of the wind-up, 0 … 1."""
        from_mm, low_um, low_slope, more_um, more_slope = self.sections[bisect_right(self.nodes_mm, place_mm)]
        past_mm = place_mm - from_mm
        correction_um = low_um + low_slope * past_mm + share * (more_um + more_slope * past_mm)
        return correction_um if self.wave_um is None else correction_um - self.wave_um(place_mm)


def _along(tables: TableSet, parts: list[Straight | Wave]) -> _Along:
    nodes = tables.nodes_mm
    minus, plus = (tables.correction_um(nodes, sign) for sign in (-1, 1))
    more = plus - minus
    straight = [part for part in parts if isinstance(part, Straight)]
    waves = [part for part in parts if isinstance(part, Wave)]
    slope = sum(part.slope for part in straight)
    low = minus - slope * nodes - sum(part.at_zero_um for part in straight)
    low_slope, more_slope = (np.concatenate([[0.0], np.diff(one) / np.diff(nodes), [0.0]]) for one in (minus, more))
    low_slope -= slope  # beyond the ends, too
    sections = zip(
        *(np.concatenate([one[:1], one]).tolist() for one in (nodes, low)),
        low_slope.tolist(),
        np.concatenate([more[:1], more]).tolist(),
        more_slope.tolist(),
        strict=True,
    )
    steepest = float(np.max(np.abs([low_slope, low_slope + more_slope]))) + sum(wave.steepest for wave in waves)
    return _Along(nodes.tolist(), list(sections), _sum_of([wave.at_um for wave in waves]), steepest)


def _sum_of(functions: list[Callable[[float], float]]) -> Callable[[float], float] | None:
    if len(functions) <= 1:
        return functions[0] if functions else None
    return lambda place_mm: sum(function(place_mm) for function in functions)


@dataclass(frozen=True, slots=True)
class _Branch:
    """A motion in one direction while the wind-up keeps its course. Places are counted in the direction of motion: times `sign`.

    sign: +1 or -1; turn_mm: where it began; at_turn_um: the wind-up there; settled_at_mm: from where on the share of
    the wind-up is `settled`; until_mm: where a loop closes, NaN where each set-point is looked at; first: the history where it began
    """

    sign: float
    turn_mm: float
    at_turn_um: float
    settled_at_mm: float
    settled: float
    until_mm: float
    first: MotionHistory
    along: _Along


class StreamedCorrection:
    """The commands of one stream: `command_mm` for each set-point, and `issued` once the drive has it.

    compensation: None leaves commands as they are; history, commanded_mm: at the begin of the stream; known: sensors' values then.
    `time_s` and `velocity_mm_s` are read from it at every set-point where `follows_motion`. by_estimate: the lost motion rises with
    `actual`, the motion by the estimated actual position, once that is known.
    Raises StateError for an effect whose columns are not there, InputError for one whose columns are empty.
    """

    __slots__ = (
        "_along",
        "_amount_um",
        "_amounts_um",
        "_at",
        "_bound",
        "_branch",
        "_by_arrays",
        "_by_estimate",
        "_compensation",
        "_corrects",
        "_ended",
        "_issued_um",
        "_lengths_mm",
        "_max_um",
        "_min_um",
        "_next_branch",
        "_next_reached_mm",
        "_reached_mm",
        "_rise",
        "_until_mm",
        "actual",
        "correction_um",
        "known",
    )

    def __init__(
        self,
        compensation: Compensation | None,
        history: MotionHistory,
        commanded_mm: float,
        known: dict[str, float],
        bound: CorrectionBound,
        *,
        by_estimate: bool = False,
    ) -> None:
        self._corrects = compensation is not None
        self._compensation = compensation or _UNCORRECTED
        self.known, self._bound, self._min_um, self._max_um = known, bound, -bound.max_um, bound.max_um
        self._by_estimate, self._ended = by_estimate, False
        self.actual: MotionHistory | None = None
        rise = self._compensation.rise
        self._rise = rise if rise is not None and rise.amount_um >= FULL_UM else None
        if self._rise is not None:
            shape = self._rise.shape
            self._at, self._lengths_mm, self._amounts_um = shape.at, self._rise.lengths_mm, self._rise.amounts_um
            self._amount_um = self._rise.amount_um
        self._by_arrays: list[ErrorTerm] = []
        self._along = self._prepared()
        self._next_branch: _Branch | None = None
        self._branch = self._branch_from(history)
        self._until_mm = self._branch.until_mm
        self._reached_mm = self._next_reached_mm = self._branch.sign * history.position_mm
        self.correction_um = self._issued_um = (commanded_mm - history.position_mm) * UM_PER_MM

    def _prepared(self) -> dict[int, _Along]:
        """By direction; terms that only arrays can give are put into `_by_arrays`."""
        compensation, parts = self._compensation, dict[int, list[Straight | Wave]]({1: [], -1: []})
        compensation.require({*self.known, *_OWN, *([] if compensation.rise is None else [WOUND_SHARE])})
        turns = any("direction" in term.needs for term in compensation.terms)
        for term in compensation.terms:
            found: dict[int, Straight | Wave] = {}
            if isinstance(term, Term) and _CHANGING.isdisjoint(term.needs):
                for sign in parts if turns else (1,):
                    if (one := term.along({**self.known, "direction": float(sign)})) is not None:
                        found[sign] = one
            for sign, one in found.items():
                parts[sign].append(one)
            if not found:
                self._by_arrays.append(term)
        plus = _along(compensation.tables, parts[1])
        return {1: plus, -1: _along(compensation.tables, parts[-1]) if turns else plus}

    # -- set-points ------------------------------------------------------------------------------------------------------
    def command_mm(self, target_mm: float, across_um: float = 0.0) -> float:
        """The command for the next set-point. across_um: as in `hil.machine.set_points.CommandState.command`.

        Raises InputError for a target that is no position, StateError while the direction of arrival is unknown and after the
        stream's end, CorrectionBoundError.
        """
        if across_um:
            return self._with_across_mm(target_mm, across_um)
        branch = self._branch
        reached_mm = branch.sign * target_mm
        if not self._reached_mm < reached_mm < self._until_mm:
            return target_mm + self._checked_um(target_mm) / UM_PER_MM
        if reached_mm >= branch.settled_at_mm:
            share = branch.settled
        else:
            risen_um = self._at(reached_mm - branch.turn_mm, self._lengths_mm, self._amounts_um)
            share = (branch.at_turn_um + branch.sign * risen_um) / self._amount_um
            share = 0.0 if share < 0.0 else share if share < 1.0 else 1.0
        along = branch.along
        from_mm, low_um, low_slope, more_um, more_slope = along.sections[bisect_right(along.nodes_mm, target_mm)]
        past_mm = target_mm - from_mm
        correction_um = low_um + low_slope * past_mm + share * (more_um + more_slope * past_mm)
        if along.wave_um is not None:
            correction_um -= along.wave_um(target_mm)
        if not self._min_um <= correction_um <= self._max_um:
            return target_mm + self._checked_um(target_mm) / UM_PER_MM
        self._next_branch, self._next_reached_mm, self.correction_um = None, reached_mm, correction_um
        return target_mm + correction_um / UM_PER_MM

    def issued(self) -> None:
        """The drive has taken the last command."""
        if self._next_branch is not None:
            self._take(self._next_branch)
        self._reached_mm, self._issued_um = self._next_reached_mm, self.correction_um

    def end(self) -> None:
        """Refuse further set-points: the motion goes on in another way, or is unknown."""
        self._ended, self._until_mm = True, math.nan

    @property
    def follows_motion(self) -> bool:
        """Whether `time_s` and `velocity_mm_s` in `known` have to be those of each set-point."""
        return bool(self._by_arrays)

    @property
    def history(self) -> MotionHistory:
        """The motion so far, up to the last command that was issued."""
        first, position_mm = self._branch.first, self._branch.sign * self._reached_mm
        since_mm = first.since_reversal_mm + abs(position_mm - first.position_mm)
        return MotionHistory(position_mm, first.direction, since_mm, first.stroke_mm, first.turns_mm)

    @property
    def commanded_mm(self) -> float:
        """The last command that was issued."""
        return self._branch.sign * self._reached_mm + self._issued_um / UM_PER_MM

    # -- branches --------------------------------------------------------------------------------------------------------
    def _branch_from(self, first: MotionHistory) -> _Branch:
        direction, turns, rise = first.direction, first.turns_mm, self._rise
        sign, along = float(direction or 1), self._along[direction or 1]
        until_mm = sign * turns[-2] if len(turns) >= 2 else math.inf
        steep = not along.steepest * SLOPE_OVER_MM * (1 + _SLACK) <= self._bound.max_slope_um_per_mm
        if steep or not direction or self._by_estimate or self._by_arrays:
            until_mm = math.nan
        if rise is None:
            return _Branch(sign, 0.0, 0.0, -math.inf, 1.0 if direction > 0 else 0.0, until_mm, first, along)
        wound_um = wound_at_turn_um(rise, direction, turns)
        if not turns:
            share = share_of(wound_um, rise.amount_um)
            return _Branch(sign, 0.0, wound_um, -math.inf, share, until_mm, first, along)
        share = share_of(wound_um + direction * rise.amount_um, rise.amount_um)
        turn_mm = sign * turns[-1]
        return _Branch(sign, turn_mm, wound_um, turn_mm + rise.settled_mm, share, until_mm, first, along)

    def _take(self, branch: _Branch) -> None:
        self._branch, self._next_branch = branch, None
        self._until_mm = math.nan if self._ended else branch.until_mm

    def _checked_um(self, target_mm: float) -> float:
        """The correction, µm, with everything that `Compensation.command` looks at."""
        if self._ended:
            raise StateError("these set-points' stream has ended, and the motion since then is not known to it")
        if not math.isfinite(target_mm):
            raise InputError(f"target is {target_mm} mm, expected a finite position")
        before, branch, self._next_branch = self.history, self._branch, None
        after = before.moved_to(target_mm)
        if (after.direction, after.turns_mm) != (before.direction, before.turns_mm):
            branch = self._next_branch = self._branch_from(after)
        self._next_reached_mm = branch.sign * target_mm
        if after.direction == 0 and self._corrects:
            raise StateError(DIRECTION_UNKNOWN.format(target_mm))
        rise = self._compensation.rise
        share = 1.0 if after.direction > 0 else 0.0
        if rise is not None:
            by = after if self.actual is None or self.actual.direction == 0 else self.actual
            share = wound_share(rise, by.position_mm, by.direction, by.turns_mm)
        near_mm = [target_mm + beside for beside in BESIDE_MM]
        near_um = [branch.along.correction_um(place_mm, share) for place_mm in near_mm]
        if self._by_arrays:
            columns = rows_at(near_mm, {**self.known, **after.columns(), WOUND_SHARE: share})
            for term in self._by_arrays:
                near_um = [whole - float(part) for whole, part in zip(near_um, term.error_um(columns), strict=True)]
        self._bound.check_command(after.direction, near_mm, near_um)
        self.correction_um = near_um[0]
        return near_um[0]

    def _with_across_mm(self, target_mm: float, across_um: float) -> float:
        target_mm += across_um / UM_PER_MM
        command_mm = self.command_mm(target_mm)
        total_um = self.correction_um + across_um
        if not abs(total_um) <= self._max_um:
            direction = (self._next_branch or self._branch).first.direction
            self._bound.check_values(BEYOND_WITH_STRAIGHTNESS, target_mm, direction, total_um)
        return command_mm
