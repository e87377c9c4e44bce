"""Stored measurements, reports and history of an axis, as the screen lists them, the newest first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from hil.diagnosis.stored import measurement_of, stored_beside
from hil.figures.history import FoundCampaign, Moment, Pass, Trend, find_campaigns, history, trend, usual_pass
from hil.figures.iso230 import Iso230
from hil.report.job import FOLDER, HISTORY_FIGURES, NAME

Points = tuple[tuple[float, float], ...]
DAY_S = 86400.0
STATES = ("torn", "changed", "open", "closed")
"""From the worst to the best."""


@dataclass(frozen=True)
class Measurement:
    """One or more passes of a campaign, measured in one condition of the machine.

    key: unique in the axis's folder; state: of its worst pass; figures_um: figures of ISO 230-2, those that it has, µm.
    """

    key: str
    kind: str
    begun: datetime
    paths: tuple[Path, ...]
    rows: int
    runs: int
    state: str
    figures_um: Mapping[str, float]

    @property
    def diagnosis(self) -> Path:
        """Path of its stored diagnosis, which may not exist."""
        return stored_beside(self.paths)


def measurements(directory: Path) -> list[Measurement]:
    """Measurements in an axis's folder, the newest first; those without a readable row are left out."""
    if not directory.is_dir():
        return []
    found = [one for campaign in find_campaigns([directory]) for one in _of(campaign)]
    return sorted(found, key=lambda one: (one.begun.timestamp(), one.key), reverse=True)


def _of(campaign: FoundCampaign) -> Iterable[Measurement]:
    groups: dict[str, list[Pass]] = {}
    for one in campaign.passes:
        if one.records is not None:
            groups.setdefault(measurement_of(one.name), []).append(one)
    for name, passes in groups.items():
        figures = passes[0].figures() if len(passes) == 1 else ""
        known = figures.figures() if isinstance(figures, Iso230) else {}
        yield Measurement(
            f"{campaign.directory.name}/{name}",
            campaign.kind,
            passes[0].begun,
            tuple(one.path for one in passes),
            sum(len(one.records) for one in passes if one.records is not None),
            sum(len(one.records.runs) for one in passes if one.records is not None),
            min((one.state for one in passes), key=STATES.index),
            {figure: value for figure, value in known.items() if value is not None},
        )


# -- reports -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ReportFile:
    """One report of an axis. kind: report, comparison or history."""

    name: str
    kind: str
    made: datetime
    paper: str  # name of its PDF, "" where it has none


def reports(directory: Path) -> list[ReportFile]:
    """Reports in an axis's folder, the newest first."""
    pages = [path for path in (directory / FOLDER).glob("*.html") if NAME.fullmatch(path.name)]
    found = []
    for page in pages:
        paper = page.with_suffix(".pdf")
        made = datetime.fromtimestamp(page.stat().st_mtime).astimezone()
        found.append(ReportFile(page.name, page.stem.partition("-")[0], made, paper.name if paper.exists() else ""))
    return sorted(found, key=lambda one: (one.made, one.name), reverse=True)


# -- history -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class AxisHistory:
    """Figures of ISO 230-2 over time, of the passes of one name.

    times_s: of each point, s since 1970; figures_um: by name, a value in µm for each time, None where the pass has none
    trends: by name, None for too few points
    """

    usual: str
    times_s: tuple[float, ...]
    figures_um: Mapping[str, tuple[float | None, ...]]
    trends: Mapping[str, Trend | None]

    @property
    def begun(self) -> datetime:
        """Time of the first point."""
        return datetime.fromtimestamp(self.times_s[0]).astimezone()

    @property
    def days(self) -> tuple[float, ...]:
        """Days of each point since the first."""
        return tuple((time_s - self.times_s[0]) / DAY_S for time_s in self.times_s)

    def points(self, name: str) -> Points:
        """A figure as (day, µm)."""
        return tuple(
            (day, value) for day, value in zip(self.days, self.figures_um[name], strict=True) if value is not None
        )

    def line(self, name: str) -> Points:
        """The two ends (day, µm) of a figure's trend line; empty without a trend."""
        found, points = self.trends[name], self.points(name)
        if found is None:
            return ()
        day, value = (sum(column) / len(points) for column in zip(*points, strict=True))
        return tuple((end, value + found.slope_um / 30.0 * (end - day)) for end in (points[0][0], points[-1][0]))


@dataclass(frozen=True)
class ReportsScreen:
    """Measurements, reports and history of an axis."""

    measurements: tuple[Measurement, ...]
    reports: tuple[ReportFile, ...]
    history: AxisHistory | None


def reports_screen(directory: Path, axis: str) -> ReportsScreen:
    """Measurements, reports and history in an axis's folder. Reads files: not to be called in a page's own loop."""
    return ReportsScreen(tuple(measurements(directory)), tuple(reports(directory)), axis_history(directory, axis))


def axis_history(directory: Path, axis: str) -> AxisHistory | None:
    """History in an axis's folder; None where no pass has figures."""
    campaigns = [one for one in find_campaigns([directory]) if one.axis == axis] if directory.is_dir() else []
    moments = history(campaigns, HISTORY_FIGURES)
    if not moments:
        return None
    usual = usual_pass(moments)
    moments = [one for one in moments if one.at.name == usual]
    times_s = tuple(one.at.begun.timestamp() for one in moments)
    days = np.array(times_s) / DAY_S
    trends = {name: trend(days, np.array([one.figures_um[name] for one in moments])) for name in HISTORY_FIGURES}
    return AxisHistory(usual, times_s, {name: _known(moments, name) for name in HISTORY_FIGURES}, trends)


def _known(moments: Iterable[Moment], name: str) -> tuple[float | None, ...]:
    values = (one.figures_um[name] for one in moments)
    return tuple(None if math.isnan(value) else value for value in values)
