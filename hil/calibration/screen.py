"""What the screen of system A shows: the axis before and after its correction, its figures with their uncertainty, the band."""

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

Curve = tuple[tuple[float, float], ...]
STAGES = ("before", "after", "verified", "uncorrected")
SHOWN = ("A", "E", "R", "M", "B")
"""Figures of ISO 230-2 on this screen."""


@dataclass(frozen=True)
class Stage:
    """The axis as measured once.

    means_um: mean error of each target, µm over mm, by direction; figures_um, u95_um: of ISO 230-2 with their expanded uncertainty
    (k = 2), what is not known is not in it; outside: sections outside the band, None without a band
    """

    begun: datetime
    means_um: Mapping[int, Curve]
    figures_um: Mapping[str, float]
    u95_um: Mapping[str, float]
    outside: tuple[Outside, ...] | None

    @property
    def sections(self) -> int:
        """How many sections and directions were measured."""
        return sum(map(len, self.means_um.values()))


@dataclass(frozen=True)
class CalibrationScreen:
    """stages: by name, of STAGES, those that were measured; unfinished: job -> the campaign that can be gone on with, and the
    seed of its targets; tables: whether any are stored"""

    stages: Mapping[str, Stage]
    unfinished: Mapping[str, tuple[str, int]]
    tables: bool


def calibration_screen(axis: AxisConfig) -> CalibrationScreen:
    """From the axis's folder. Reads files: not for a page's own loop."""
    folder = axis.store.directory
    stages: dict[str, Stage] = {}
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
    """Each section and direction as the last round that measured it found it: a later round measures only what lay outside."""
    kept: list[Records] = []
    known: set[tuple[float, float]] = set()
    for records in reversed(rounds):
        keys = list(zip(np.round(records.target_mm, 6).tolist(), records.direction.tolist(), strict=True))
        kept.append(records.where(np.array([key not in known for key in keys])))
        known.update(keys)
    return concatenate([records for records in reversed(kept) if len(records)])


def _stage(axis: AxisConfig, begun: datetime, records: Records) -> Stage:
    means, band = section_means(records), axis.correction.band
    curves = {
        sign: tuple((float(x), float(y)) for x, y in zip(means.target_mm, values, strict=True) if np.isfinite(y))
        for sign, values in ((1, means.plus_um), (-1, means.minus_um))
    }
    figures, u95 = _figures(axis, records)
    outside = None if band is None else tuple(sections_outside(means, band))
    return Stage(begun, curves, figures, u95, outside)


def _figures(axis: AxisConfig, records: Records) -> tuple[dict[str, float], dict[str, float]]:
    """Empty where the rows are too few, such as in the middle of a pass."""
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
    """Of the last campaign of this kind that has rows, by name."""
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
