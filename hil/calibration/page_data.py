"""The contents of the page of system A: the axis before and after its correction, its figures with uncertainty, the
band.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.app.jobs.identity import uncertainty_of
from hil.axis.axis_file import AxisConfig
from hil.calibration.job import CALIBRATE, UNCORRECTED, VERIFY
from hil.correction.tables import Outside, section_means, sections_outside
from hil.figures.history import Pass, read_campaign
from hil.figures.iso230 import iso230
from hil.figures.uncertainty import budget
from hil.records.journal import MARKER, Campaign
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
    uncertainty (k = 2), unknown ones left out; outside: sections outside the band, None without a band
    """

    begun: datetime
    means_um: Mapping[int, Points]
    figures_um: Mapping[str, float]
    u95_um: Mapping[str, float]
    outside: tuple[Outside, ...] | None

    @property
    def sections(self) -> int:
        """Number of sections and directions measured."""
        return sum(map(len, self.means_um.values()))


@dataclass(frozen=True)
class CalibrationScreen:
    """stages: by name, of STAGES, those that were measured; unfinished: job -> the campaign that can be resumed, and
    the seed of its targets; tables: whether any are stored
    """

    stages: Mapping[str, MeasuredStage]
    unfinished: Mapping[str, tuple[str, int]]
    tables: bool


def calibration_screen(axis: AxisConfig) -> CalibrationScreen:
    """Reads the axis's folder; too slow for the page's event loop. Raises InputError for a campaign that cannot be
    read.
    """
    folder = axis.store.directory
    stages: dict[str, MeasuredStage] = {}
    passes = _last_passes(folder, CALIBRATE)
    measured = {"before": passes.get("measure"), "after": None, "verified": None, "uncorrected": None}
    rounds = [one for name, one in sorted(passes.items(), key=_number) if name.startswith("round-")]
    for name, kind in (("verified", VERIFY), ("uncorrected", UNCORRECTED)):
        measured[name] = _last_passes(folder, kind).get(kind)
    for name, one in measured.items():
        if one is not None and one.records is not None:
            stages[name] = _stage(axis, one.begun, one.records)
    proofs = [one.records for one in rounds if one.records is not None]
    if proofs:
        stages["after"] = _stage(axis, rounds[-1].begun, latest(proofs))
    unfinished = {kind: found for kind in (CALIBRATE, VERIFY, UNCORRECTED) if (found := _unfinished(folder, kind))}
    return CalibrationScreen(
        {name: stages[name] for name in STAGES if name in stages}, unfinished, axis.tables_path.exists()
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


def _stage(axis: AxisConfig, begun: datetime, records: Records) -> MeasuredStage:
    means, band = section_means(records), axis.correction.band
    curves = {
        sign: tuple((float(x), float(y)) for x, y in zip(means.target_mm, values, strict=True) if np.isfinite(y))
        for sign, values in ((1, means.plus_um), (-1, means.minus_um))
    }
    figures, u95 = _figures(axis, records)
    outside = None if band is None else tuple(sections_outside(means, band))
    return MeasuredStage(begun, curves, figures, u95, outside)


def _figures(axis: AxisConfig, records: Records) -> tuple[dict[str, float], dict[str, float]]:
    """Figures and uncertainties; empty where the rows are too few, such as during a pass."""
    try:
        found = iso230(records)
    except InputError:
        return {}, {}
    values = {name: value for name in SHOWN if (value := found.figures()[name]) is not None}
    inputs = uncertainty_of(axis)
    try:
        known = {} if inputs is None else budget(inputs, found, records).figures_um
    except InputError:
        known = {}
    return values, {name: known[name] for name in values if name in known}


def _last_passes(folder: Path, kind: str) -> dict[str, Pass]:
    """The passes of the last campaign of this kind that has rows, by name."""
    for directory in sorted(folder.glob(f"{kind}-[0-9]*"), key=_of_series, reverse=True):
        if (directory / MARKER).is_file():
            passes = {one.name: one for one in read_campaign(directory).passes if one.records is not None}
            if passes:
                return passes
    return {}


def _of_series(directory: Path) -> int:
    number = directory.name.rpartition("-")[2]
    return int(number) if number.isdecimal() else -1


def _number(item: tuple[str, Any]) -> int:
    number = item[0].rpartition("-")[2]
    return int(number) if number.isdecimal() else 0


def _unfinished(folder: Path, kind: str) -> tuple[str, int] | None:
    found = Campaign.unfinished(folder, kind)
    seed = None if found is None else found.purpose.get("seed", 1)
    return (found.directory.name, seed) if found is not None and isinstance(seed, int) else None
