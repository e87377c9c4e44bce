"""The contents of the page of system A: the axis before and after its correction, its figures with uncertainty, the
band.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, accuracy_of, uncertainty_of
from hil.calibration.job import CALIBRATE, UNCORRECTED, VERIFY, backlash_of, signs_of
from hil.correction.store import bound_tables
from hil.correction.tables import Band, NotJudged, OutsideBand, SignedSections, SingleTable, judge, section_means
from hil.figures.history import Pass, read_campaign, series
from hil.figures.iso230 import iso230
from hil.figures.uncertainty import budget_um
from hil.figures.verdict import Accuracy
from hil.records.journal import Campaign
from hil.records.rows import Records, concatenate

Points = tuple[tuple[float, float], ...]
STAGES = ("before", "after", "verified", "uncorrected")
"""Measurements that are shown, in this order."""
SHOWN = ("A", "E", "R", "M", "B")
"""Figures of ISO 230-2 that are shown."""


@dataclass(frozen=True)
class MeasuredStage:
    """One measurement of the axis.

    means_um: mean error of each target, (mm, µm), by direction; figures_um, u95_um: of ISO 230-2 with their expanded
    uncertainty (k = 2), unknown ones left out; band: with the signs that the campaign was begun with; outside: sections outside
    it, None without a band; not_judged: those that it asks nothing for; accuracy: A with its uncertainty against the limit
    """

    begun: datetime
    means_um: Mapping[int, Points]
    figures_um: Mapping[str, float]
    u95_um: Mapping[str, float]
    band: Band | None
    outside: tuple[OutsideBand, ...] | None
    not_judged: tuple[NotJudged, ...] = ()
    accuracy: Accuracy | None = None

    @property
    def sections(self) -> int:
        """Number of sections and directions measured and judged."""
        return sum(map(len, self.means_um.values())) - len(self.not_judged)


class Resumable(NamedTuple):
    """A campaign that can be resumed. seed: of its targets; signs, backlash: that it was begun with."""

    campaign: str
    seed: int
    signs: tuple[SignedSections, ...] = ()
    backlash: SingleTable | None = None


@dataclass(frozen=True)
class CalibrationScreen:
    """stages: by name, of STAGES, those that were measured; unfinished: job -> the campaign that can be resumed; tables: whether the
    axis has any stored
    """

    stages: Mapping[str, MeasuredStage]
    unfinished: Mapping[str, Resumable]
    tables: bool

    @property
    def verified(self) -> MeasuredStage | None:
        """The verification of the present tables; None where the last one is older than the last calibration."""
        found, after = self.stages.get("verified"), self.stages.get("after")
        return None if found is None or (after is not None and found.begun < after.begun) else found


def calibration_screen(axis: AxisConfig) -> CalibrationScreen:
    """Reads the axis's folder; too slow for the page's event loop. Raises InputError for a campaign that cannot be
    read.
    """
    folder = axis.store.directory
    stages: dict[str, MeasuredStage] = {}
    passes, band = _last_passes(axis, CALIBRATE)
    measured = {"before": (passes.get("measure"), band)}
    rounds = [one for name, one in sorted(passes.items(), key=_number) if name.startswith("round-")]
    for name, kind in (("verified", VERIFY), ("uncorrected", UNCORRECTED)):
        its_passes, its_band = _last_passes(axis, kind)
        measured[name] = (its_passes.get(kind), its_band)
    for name, (one, its_band) in measured.items():
        if one is not None and one.records is not None:
            stages[name] = _stage(axis, one.begun, one.records, its_band, corrected=name == "verified")
    proofs = [one.records for one in rounds if one.records is not None]
    if proofs:
        stages["after"] = _stage(axis, rounds[-1].begun, latest(proofs), band, corrected=True)
    unfinished = {kind: found for kind in (CALIBRATE, VERIFY, UNCORRECTED) if (found := _unfinished(folder, kind))}
    return CalibrationScreen(
        {name: stages[name] for name in STAGES if name in stages}, unfinished, bound_tables(axis) is not None
    )


def latest(rounds: Sequence[Records]) -> Records:
    """The rows of each section and direction from the last round that measured it: a later round measures only sections
    outside the band.
    """
    kept: list[Records] = []
    known: set[tuple[float, float]] = set()
    for records in reversed(rounds):
        keys = list(zip(np.round(records.target_mm, 6).tolist(), records.direction.tolist(), strict=True))
        kept.append(records.where(np.array([key not in known for key in keys])))
        known.update(keys)
    return concatenate([records for records in reversed(kept) if len(records)])


def _stage(axis: AxisConfig, begun: datetime, records: Records, band: Band | None, *, corrected: bool) -> MeasuredStage:
    means = section_means(records)
    curves = {
        sign: tuple((float(x), float(y)) for x, y in zip(means.target_mm, values, strict=True) if np.isfinite(y))
        for sign, values in ((1, means.plus_um), (-1, means.minus_um))
    }
    figures, u95 = _figures(axis, records)
    found = accuracy_of(axis, records, corrected=corrected)
    if band is None:
        return MeasuredStage(begun, curves, figures, u95, None, None, accuracy=found)
    judged = judge(means, band, axis.measurement.targets_mm)
    return MeasuredStage(begun, curves, figures, u95, band, *judged, accuracy=found)


def _figures(axis: AxisConfig, records: Records) -> tuple[dict[str, float], dict[str, float]]:
    """Figures and uncertainties; empty where the rows are too few, such as during a pass."""
    try:
        found = iso230(records)
    except InputError:
        return {}, {}
    values = {name: value for name in SHOWN if (value := found.figures()[name]) is not None}
    known = budget_um(uncertainty_of(axis), found, records)
    return values, {name: known[name] for name in values if name in known}


def _last_passes(axis: AxisConfig, kind: str) -> tuple[dict[str, Pass], Band | None]:
    """The passes of the last campaign of this kind that has rows, by name, and the axis's band with the signs that it states."""
    band = axis.correction.band
    for directory in series(axis.store.directory, kind):
        campaign = read_campaign(directory)
        passes = {one.name: one for one in campaign.passes if one.records is not None}
        if passes:
            return passes, None if band is None else replace(band, signs=_signs(campaign.purpose))
    return {}, band


def _signs(purpose: Mapping[str, Any]) -> tuple[SignedSections, ...]:
    """None of a campaign that states no band: its rows are held against the axis file's as it is without signs."""
    return signs_of(purpose) if (purpose.get("correction") or {}).get("band") else ()


def _number(item: tuple[str, Any]) -> int:
    number = item[0].rpartition("-")[2]
    return int(number) if number.isdecimal() else 0


def _unfinished(folder: Path, kind: str) -> Resumable | None:
    found = Campaign.unfinished(folder, kind)
    seed = None if found is None else found.purpose.get("seed", 1)
    if found is None or not isinstance(seed, int):
        return None
    return Resumable(found.directory.name, seed, _signs(found.purpose), backlash_of(found.purpose))
