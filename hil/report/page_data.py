"""Reports, stored measurements and history of an axis, as the page of reports lists them, the newest first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from hil.figures.history import Moment, Trend, find_campaigns, history, trend, usual_pass
from hil.report.job import FOLDER, HISTORY_FIGURES, NAME
from hil.ui.screen.campaigns import Measurement, measurements

Points = tuple[tuple[float, float], ...]
DAY_S = 86400.0


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
