"""Straightness of an axis by its instrument's straightness optics, and its correction by the axis at right angles.

While this axis moves, the other one is moved by what the table says for the place (`hil.machine.cross_axis`). The deviation counts
from the least-squares line through the mean deviations (ISO 230-1, straightness): how the optics lie to the axis is not known, and
squareness is not measured here. The table has a value per place and direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from drivers.errors import InputError, UnprovenError
from hil.axis.axis_file import AxisConfig, StraightnessConfig
from hil.correction.compensation import Compensation
from hil.correction.tables import TableSet, section_means, straightness_table
from hil.figures.error_figures import rms
from hil.machine.events import Listener, silent
from hil.machine.measure import bidirectional_steps, measure, other_targets
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import Floats, Records

COVERAGE = 2.0
"""k of the stated uncertainties."""
TWICE = 1.5
"""Ratio of what is left to what there was from which the sign is suspected: a correction of the wrong sign doubles the error."""


@dataclass(frozen=True)
class Straightness:
    """The straightness of one pass.

    plus_um, minus_um: deviation of each direction from the least-squares line through the means of both, (m,); mean_std_um: standard
    deviation of such a mean by the scatter of the runs, NaN of a single run
    """

    target_mm: Floats
    plus_um: Floats
    minus_um: Floats
    mean_std_um: float

    @property
    def deviation_um(self) -> Floats:
        """The mean of both directions."""
        return np.asarray((self.plus_um + self.minus_um) / 2.0)

    @property
    def reversal_um(self) -> float:
        """Largest difference between the directions."""
        return float(np.max(np.abs(self.plus_um - self.minus_um)))

    @property
    def rms_um(self) -> float:
        """Root mean square of the deviations of both directions."""
        return rms([self.plus_um, self.minus_um])

    @property
    def range_um(self) -> float:
        """Largest less smallest mean of both directions: the straightness deviation of ISO 230-1."""
        return float(np.ptp(self.deviation_um))

    @property
    def rms_expanded_um(self) -> float:
        """Expanded uncertainty (k = 2) of `rms_um` by the scatter of the runs; the optics' own is not in it."""
        return COVERAGE * self.mean_std_um / math.sqrt(len(self.target_mm))

    @property
    def range_expanded_um(self) -> float:
        """The same of `range_um`, a difference of two means."""
        return COVERAGE * math.sqrt(2.0) * self.mean_std_um

    def figures(self) -> dict[str, float | None]:
        """The figures as plain values; None for an uncertainty of a single run."""
        values = {
            "rms_um": self.rms_um,
            "rms_expanded_um": self.rms_expanded_um,
            "range_um": self.range_um,
            "range_expanded_um": self.range_expanded_um,
            "reversal_um": self.reversal_um,
        }
        return {name: None if math.isnan(value) else value for name, value in values.items()}

    def __str__(self) -> str:
        return (
            f"{self.range_um:.2f} ± {self.range_expanded_um:.2f} µm from end to end, {self.rms_um:.2f} ± {self.rms_expanded_um:.2f} µm"
            f" root mean square (k = 2, scatter of the runs), {self.reversal_um:.2f} µm between the directions"
        )


def straightness_of(records: Records, column: str) -> Straightness:
    """The straightness of measured rows. column: of the optics, µm.

    Raises InputError for rows without the column, a row without a value, fewer than three places, or a place that lacks a direction.
    """
    if column not in records.columns:
        raise InputError(f"rows have no column {column}: [instrument] beside names no straightness optics by that name")
    values = records[column]
    if not np.all(np.isfinite(values)):
        where = float(records.target_mm[~np.isfinite(values)][0])
        raise InputError(f"{column} has no value at {where:g} mm: the straightness optics had no signal there")
    means = section_means(records, values)
    if len(means.target_mm) < 3:
        raise InputError(f"straightness needs three places or more, the rows have {len(means.target_mm)}")
    both = (means.plus_um + means.minus_um) / 2.0
    if np.any(np.isnan(both)):
        raise InputError(f"section at {means.target_mm[np.isnan(both)][0]:g} mm was not measured in both directions")
    line = np.polyval(np.polyfit(means.target_mm, both, 1), means.target_mm)
    each = len(records) / len(both)
    return Straightness(
        means.target_mm, means.plus_um - line, means.minus_um - line, means.pooled_std_um / math.sqrt(each)
    )


def straightness_in(axis: AxisConfig, records: Records) -> Straightness | None:
    """As `straightness_of`; None where the axis file has no [straightness], or the rows cannot tell."""
    if axis.straightness is None:
        return None
    try:
        return straightness_of(records, axis.straightness.column)
    except InputError:
        return None


@dataclass(frozen=True)
class StraightnessResult:
    """A measurement and its proof at other targets, without and with the correction in force. compensation: to be stored."""

    measured: Straightness
    before: Straightness
    after: Straightness
    compensation: Compensation

    @property
    def difference_um(self) -> float:
        """Expanded uncertainty (k = 2) of the difference between the root mean squares before and after, µm."""
        return math.hypot(self.before.rms_expanded_um, self.after.rms_expanded_um)


def without_straightness(present: Compensation | None, targets_mm: Floats) -> Compensation:
    """The compensation less its straightness of another axis; that of no correction where there is none.

    Raises InputError where the straightness table is this axis's own: it may hold a part of the specified accuracy.
    """
    if present is None:
        return Compensation(TableSet.zero(targets_mm))
    tables = present.tables
    if tables.straightness is not None and not tables.straightness_axis:
        raise InputError(
            "the stored straightness table corrects this axis itself, and a store holds one: calibrate without it first"
        )
    return replace(present, tables=replace(tables, straightness=None, straightness_axis=""))


def measure_straightness(
    session: AxisSession,
    campaign: Campaign,
    config: StraightnessConfig,
    present: Compensation | None,
    listener: Listener = silent,
    *,
    seed: int = 1,
) -> StraightnessResult:
    """Measures on a prepared session whose `cross` stands ready: at its targets, then at others without and with the correction.

    present: what is stored for this axis, in force throughout; seed: chooses the other targets.
    Raises UnprovenError where the correction leaves no less by more than the uncertainty of the difference: nothing is to be stored;
    InputError, CorrectionBoundError and LimitError for a table that cannot be used, and what moving and reading raise.
    """
    how, cross = session.how, session.require_cross()
    base = without_straightness(present, np.array(sorted(how.targets_mm)))
    session.compensation = base
    rows = measure(session, campaign, "measure", bidirectional_steps(how.targets_mm, how.runs), listener)
    measured = straightness_of(rows, config.column)
    by_direction = (config.sign * measured.plus_um, config.sign * measured.minus_um)
    table = straightness_table(measured.target_mm, *by_direction)
    tables = replace(base.tables, straightness=table, straightness_axis=cross.name)
    compensation = replace(base, tables=tables)
    compensation.check(session.command_state.bound, "straightness correction computed from these runs not used")
    cross.check(tables)
    steps = bidirectional_steps(other_targets(how, seed), how.runs)
    before = straightness_of(measure(session, campaign, "before", steps, listener), config.column)
    session.compensation = compensation
    comment = f"tables {tables.digest()}"
    after = straightness_of(measure(session, campaign, "after", steps, listener, comment=comment), config.column)
    result = StraightnessResult(measured, before, after, compensation)
    check_straighter(result)
    return result


def check_straighter(result: StraightnessResult) -> None:
    """Raises UnprovenError unless the correction leaves less, by more than the uncertainty of the difference."""
    was_um, left_um = result.before.rms_um, result.after.rms_um
    if left_um + result.difference_um < was_um:
        return
    hint = "; it doubles the error, its sign is wrong ([straightness] sign)" if left_um > TWICE * was_um else ""
    raise UnprovenError(
        f"straightness correction not stored: in force it leaves {left_um:.2f} µm (root mean square) of {was_um:.2f} µm, which is no"
        f" better by more than the uncertainty of the difference, {result.difference_um:.2f} µm{hint}"
    )
