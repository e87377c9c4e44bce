"""Calibration, system A (JP4875672B2): measure, compute tables, prove and store them, revise sections outside the band
until none is left.

The procedure depends only on its rows: resumed after an interruption, it replays those on disk to the same tables and
continues with the first missing row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.errors import UnprovenError
from hil.axis.axis_file import CorrectionConfig
from hil.correction.compensation import Compensation
from hil.correction.tables import (
    Band,
    DirectionalTable,
    OutsideBand,
    SingleTable,
    TableSet,
    compute_tables,
    initial_specified,
    revise,
    section_means,
    sections_outside,
    split_specified,
)
from hil.figures.error_figures import rms
from hil.machine.events import Event, Listener, silent
from hil.machine.measure import bidirectional_steps, measure, steps_for_sections
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import Records

Store = Callable[[TableSet], None]
"""store(tables): stores tables before they are put into force."""


@dataclass(frozen=True)
class Round:
    """One proof of the tables: the rows measured with them in force, and the sections outside the band."""

    records: Records
    tables: TableSet
    outside: tuple[OutsideBand, ...]


@dataclass(frozen=True)
class Calibration:
    """The result of a calibration.

    before: the uncorrected machine; rounds: each proof, in order; tables: the last tables, stored and in force
    moved_um: by target in mm and direction, what fine steps moved it by in all, µm
    """

    before: Records
    rounds: tuple[Round, ...]
    tables: TableSet
    moved_um: Mapping[tuple[float, int], float] = field(default_factory=dict)

    @property
    def outside(self) -> tuple[OutsideBand, ...]:
        """The sections outside the band in the last round."""
        return self.rounds[-1].outside

    @property
    def inside(self) -> bool:
        """Every section and direction is inside the band (always true without a band)."""
        return not self.outside


def calibrate(
    session: AxisSession,
    campaign: Campaign,
    correction: CorrectionConfig,
    store: Store,
    listener: Listener = silent,
    *,
    straightness: DirectionalTable | None = None,
    backlash: SingleTable | None = None,
) -> Calibration:
    """Runs the whole calibration on a prepared session.

    straightness: a straightness correction that is stored and put into force together with the tables
    backlash: measured by other means, on positions of its own; it takes the place of the measured directions' difference

    Leaves the tables in force in the session. Raises, before a table is stored: InputError when the band is narrower than the
    machine's repeatability, CorrectionBoundError for a table beyond the axis's bound, and UnprovenError for one whose proof
    contradicts it (`check_proof`): nothing is in force then, and the campaign is finished.
    """
    how = session.how
    session.compensation = None
    before = measure(session, campaign, "measure", bidirectional_steps(how.targets_mm, how.runs), listener)
    if correction.band is not None:
        correction.band.check_repeatability(section_means(before).pooled_std_um)
    tables = compute_tables(before, correction.mode, straightness)
    if backlash is not None:
        tables = tables.with_backlash(backlash)
    if correction.band is not None:
        tables = replace(tables, specified=initial_specified(tables.pitch.position_mm, correction.band))
    steps = bidirectional_steps(how.targets_mm, how.runs)
    rounds: list[Round] = []
    moved_um: Moved = {}
    while True:
        number = len(rounds) + 1
        stored = as_stored(tables, correction)
        compensation = Compensation(stored)
        compensation.check(session.command_state.bound, "correction computed from these runs not used")
        session.compensation = compensation
        records = measure(session, campaign, f"round-{number}", steps, listener, comment=f"tables {stored.digest()}")
        outside = _outside(records, correction.band)
        try:
            check_proof(before, records, correction.band)
        except UnprovenError:
            session.compensation = None
            campaign.finish()
            raise
        store(stored)
        rounds.append(Round(records, stored, tuple(outside)))
        listener(Event(f"round-{number}", _verdict(outside, correction.band)))
        if correction.band is None or not outside or number == correction.max_rounds:
            return Calibration(before, tuple(rounds), stored, moved_um)
        revised = _revised(tables, outside, correction, number, moved_um)
        if revised == tables:
            listener(Event(f"round-{number}", f"{_total(correction)}: nothing is left to revise", warning=True))
            return Calibration(before, tuple(rounds), stored, moved_um)
        tables = revised
        steps = steps_for_sections([(section.target_mm, section.direction) for section in outside], how.runs)


CONTRADICTS_SHARE = 0.5
"""A correction that leaves more than this of an error at a section did not correct that error."""
CHANGES_UM, CHANGES_SHARE = 20.0, 0.25
"""… unless no more is left than a machine may change by between two passes: 2 K of a metre of steel at 11.7 µm/(m·K), or this share
of its worst error, as of a machine that has effects besides those of position."""
NOISE_STD = 3.0
_ROUNDING_UM = 1e-6  # of sums of fine steps: less than any step


def check_proof(before: Records, proof: Records, band: Band | None) -> None:
    """Checks by the runs with the tables in force that tables made from `before` correct what they were made for;
    tables inside the band do.

    Raises UnprovenError where the mean errors are no smaller overall, by more than twice their uncertainty, or where
    the error of a section remains: then one of its rows is wrong, in either pass, or the machine has changed. Errors
    count from the band, µm.
    """
    was, left = _sections(before, band), _sections(proof, band)
    if not any(left.values()) and band is not None:
        return
    spread_um = _spread_um(before, band) * math.sqrt(len(was) / len(before) + len(left) / len(proof))
    worst_um = max(abs(error_um) for error_um in was.values())
    for (target_mm, direction), error_um in sorted(left.items(), key=lambda one: -abs(one[1])):
        was_um = was[target_mm, direction]
        may_um = max(CHANGES_UM, CHANGES_SHARE * worst_um) + NOISE_STD * spread_um
        if abs(error_um) > max(CONTRADICTS_SHARE * abs(was_um), may_um):
            raise UnprovenError(
                f"tables not used: their proof contradicts the runs they are made from at {target_mm:g} mm"
                f" ({'+' if direction > 0 else '−'}), where {error_um:+.1f} µm are left of {was_um:+.1f} µm; a pass is wrong there,"
                " or the machine changes: measure again"
            )
    was_rms_um, left_rms_um = (rms([errors[where] for where in left]) for errors in (was, left))
    uncertainty_um = 2.0 * spread_um / math.sqrt(len(left))
    if not left_rms_um + uncertainty_um < was_rms_um:
        nothing = (
            "; this axis has no error that its own repeatability does not hide" if was_rms_um < uncertainty_um else ""
        )
        raise UnprovenError(
            f"tables not used: in force they leave {left_rms_um:.2f} µm (root mean square) of {was_rms_um:.2f} µm, which is no better"
            f" than before by more than its uncertainty of {uncertainty_um:.2f} µm{nothing}"
        )


def _sections(records: Records, band: Band | None) -> dict[tuple[float, int], float]:
    """How far the mean of each section and direction is from the band, without one from 0, µm."""
    means = section_means(records)
    return {
        (target_mm, sign): error_um - (0.0 if band is None else band.at(target_mm, sign).nearest_um(error_um))
        for sign, errors_um in ((1, means.plus_um), (-1, means.minus_um))
        for target_mm, error_um in zip(means.target_mm.tolist(), errors_um.tolist(), strict=True)
        if not math.isnan(error_um)
    }


def _spread_um(records: Records, band: Band | None) -> float:
    """Standard deviation of a run about the mean of its section, µm: the median of all sections, which one wrong row
    does not widen. 0.0 of a single run.
    """
    spreads = [
        float(np.std(errors_um, ddof=1))
        for target_mm, sign in _sections(records, band)
        if len(errors_um := records.error_um[(abs(records.target_mm - target_mm) < 1e-6) & (records.direction == sign)])
        > 1
    ]
    return float(np.median(spreads)) if spreads else 0.0


def as_stored(tables: TableSet, correction: CorrectionConfig) -> TableSet:
    """The tables in the form in which they are stored: with a share moved to straightness, or combined; the total
    correction at the targets is the same, and between them too unless it goes by steps.
    """
    if tables.specified is not None and correction.straightness_share > 0:
        tables = split_specified(tables, correction.straightness_share)
    elif correction.combined:
        tables = tables.combined()
    return tables.stepped() if correction.interpolation == "step" else tables


def _outside(records: Records, band: Band | None) -> list[OutsideBand]:
    return [] if band is None else sections_outside(section_means(records), band)


Moved = dict[tuple[float, int], float]
"""By target in mm and direction: what fine steps have moved it by over all rounds so far, µm."""


def _revised(
    tables: TableSet, outside: Sequence[OutsideBand], correction: CorrectionConfig, number: int, moved_um: Moved
) -> TableSet:
    """Revised by system A's formula after the first proof, by fine steps after each later one, which are added to `moved_um`.

    A section stays as it is where another step would move it by more than `fine_total_um` in all.
    """
    if tables.specified is None or correction.band is None:
        return tables
    if number == 1:
        return replace(tables, specified=revise(tables.specified, outside, correction.band))
    specified: DirectionalTable = tables.specified
    for section in outside:
        band, place = correction.band.at(section.target_mm, section.direction), (section.target_mm, section.direction)
        distance_um = max(band.low_um - section.error_um, section.error_um - band.high_um)
        reach_um = min(distance_um + band.width_um / 4, correction.fine_range_um)
        step_um = math.copysign(correction.fine_step_um, band.middle_um - section.error_um)
        for _ in range(max(1, round(reach_um / correction.fine_step_um))):
            total_um = moved_um.get(place, 0.0) + step_um
            if abs(total_um) > correction.fine_total_um + _ROUNDING_UM:
                break
            moved_um[place] = total_um
            specified = revise(specified, [section], correction.band, fine_step_um=correction.fine_step_um)
    return replace(tables, specified=specified)


def _total(correction: CorrectionConfig) -> str:
    return f"fine steps may move a section by {correction.fine_total_um:g} µm in all (fine_total_um)"


def _verdict(outside: Sequence[OutsideBand], band: Band | None) -> str:
    if band is None:
        return "measured with the correction in force"
    if not outside:
        return f"all sections inside {band}"
    return f"{len(outside)} outside {band}"
