"""Calibration, system A: measure, compute, store, prove, revise what lies outside, until everything lies inside (JP4875672B2).

The procedure depends on its rows alone: taken up after an interruption, it replays those on disk to the same tables and goes on with
the first row missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from hil.axis.axis_file import CorrectionConfig
from hil.correction.compensation import Compensation
from hil.correction.tables import (
    Band,
    DirectionalTable,
    Outside,
    SingleTable,
    TableSet,
    compute_tables,
    initial_specified,
    revise,
    section_means,
    sections_outside,
    split_specified,
)
from hil.machine.events import Event, Listener, silent
from hil.machine.measure import bidirectional_steps, measure, steps_for_sections
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import Records

Store = Callable[[TableSet], None]


@dataclass(frozen=True)
class Round:
    """One proof of the tables: what was measured with them in force, and which sections lay outside the band."""

    records: Records
    tables: TableSet
    outside: tuple[Outside, ...]


@dataclass(frozen=True)
class Calibration:
    """What a calibration came to.

    before: the uncorrected machine; rounds: each proof, in order; tables: the last tables, stored and in force
    """

    before: Records
    rounds: tuple[Round, ...]
    tables: TableSet

    @property
    def outside(self) -> tuple[Outside, ...]:
        return self.rounds[-1].outside

    @property
    def inside(self) -> bool:
        """Every section and direction ended inside the band (always true without a band)."""
        return not self.outside


def calibrate(
    session: AxisSession,
    campaign: Campaign,
    correction: CorrectionConfig,
    store: Store,
    listener: Listener = silent,
    *,
    straightness: SingleTable | None = None,
) -> Calibration:
    """Run the whole of it on a prepared session.

    straightness: a straightness correction that is stored and put into force together with the tables

    Leaves the tables in force in the session. Raises InputError, before any table is stored, when the band is narrower than the
    machine's repeatability, and CorrectionBoundError, before it is stored, for a table beyond the axis's bound.
    """
    how = session.how
    session.compensation = None
    before = measure(session, campaign, "measure", bidirectional_steps(how.targets_mm, how.runs), listener)
    if correction.band is not None:
        check_band(before, correction.band)
    tables = compute_tables(before, correction.mode, straightness)
    if correction.band is not None:
        tables = replace(tables, specified=initial_specified(tables.pitch.position_mm, correction.band))
    steps = bidirectional_steps(how.targets_mm, how.runs)
    rounds: list[Round] = []
    while True:
        number = len(rounds) + 1
        stored = as_stored(tables, correction)
        compensation = Compensation(stored)
        compensation.check(session.steering.bound, "correction computed from these runs not used")
        store(stored)
        session.compensation = compensation
        records = measure(session, campaign, f"round-{number}", steps, listener, comment=f"tables {stored.digest()}")
        outside = _outside(records, correction.band)
        rounds.append(Round(records, stored, tuple(outside)))
        listener(Event(f"round-{number}", _verdict(outside, correction.band)))
        if correction.band is None or not outside or number == correction.max_rounds:
            return Calibration(before, tuple(rounds), stored)
        tables = _revised(tables, outside, correction, number)
        steps = steps_for_sections([(section.target_mm, section.direction) for section in outside], how.runs)


def check_band(records: Records, band: Band) -> None:
    """Refuse a band narrower than the repeatability seen in these runs; InputError with both figures."""
    band.check_repeatability(section_means(records).pooled_std_um)


def as_stored(tables: TableSet, correction: CorrectionConfig) -> TableSet:
    """The form the tables are stored in: with a share moved to straightness, or combined; the same total correction."""
    if tables.specified is not None and correction.straightness_share > 0:
        return split_specified(tables, correction.straightness_share)
    return tables.combined() if correction.combined else tables


def _outside(records: Records, band: Band | None) -> list[Outside]:
    return [] if band is None else sections_outside(section_means(records), band)


def _revised(tables: TableSet, outside: Sequence[Outside], correction: CorrectionConfig, number: int) -> TableSet:
    """By system A's formula after the first proof, by fine steps after each later one."""
    if tables.specified is None or correction.band is None:
        return tables
    if number == 1:
        return replace(tables, specified=revise(tables.specified, outside, correction.band))
    specified: DirectionalTable = tables.specified
    for section in outside:
        distance_um = max(correction.band.low_um - section.error_um, section.error_um - correction.band.high_um)
        reach_um = min(distance_um + correction.band.width_um / 4, correction.fine_range_um)
        for _ in range(max(1, round(reach_um / correction.fine_step_um))):
            specified = revise(specified, [section], correction.band, fine_step_um=correction.fine_step_um)
    return replace(tables, specified=specified)


def _verdict(outside: Sequence[Outside], band: Band | None) -> str:
    if band is None:
        return "measured with the correction in force"
    if not outside:
        return f"all sections inside {band.low_um:g} to {band.high_um:g} µm"
    return f"{len(outside)} outside {band.low_um:g} to {band.high_um:g} µm"
