"""Comparison of two campaigns of one axis: the change of its error, and whether it exceeds the scatter.

The difference is the mean error of B minus that of A, per target of B and direction. Between the targets of A its means are
interpolated linearly; targets of B outside the range of A are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import matplotlib as mpl
import numpy as np
import scipy
from matplotlib.figure import FigureBase

from hil.figures.error_figures import rms
from hil.records.rows import Floats, Records
from hil.ui.report.blocks import Block, DataTable, Drawing, Heading, said
from hil.ui.report.data import NamedCampaign
from hil.ui.report.svg import RC, Ground, Theme, figure_on, fresh, label_axes

SAME_MM = 1e-4
"""Targets closer than this are the same target."""


@dataclass(frozen=True)
class Difference:
    """B − A. Arrays of one shape (n,), sorted by direction, then by position.

    limit_um: half width of the 95 % interval of a difference by the scatter of the runs alone (Student's t), NaN where a mean is of
    one run; between: number of rows whose mean of A is interpolated
    """

    direction: Floats
    target_mm: Floats
    difference_um: Floats
    limit_um: Floats
    between: int

    @property
    def clear(self) -> int:
        """Number of differences larger than their limit."""
        return int(np.sum(np.abs(self.difference_um) > self.limit_um))

    @property
    def judged(self) -> int:
        """Number of differences that have a limit."""
        return int(np.sum(np.isfinite(self.limit_um)))


@dataclass(frozen=True)
class _Means:
    """Of one direction, shape (n,) each: targets, ascending; mean error; its variance, NaN of a single run; number of runs."""

    target_mm: Floats
    mean_um: Floats
    var_um2: Floats
    runs: Floats

    @classmethod
    def of(cls, records: Records, sign: float) -> _Means:
        here = records.direction == sign
        key = np.round(records.target_mm[here] / SAME_MM)
        groups = [
            (records.target_mm[here][key == one][0], records.error_um[here][key == one]) for one in np.unique(key)
        ]
        rows = [
            (target, errors.mean(), errors.var(ddof=1) / len(errors) if len(errors) > 1 else math.nan, len(errors))
            for target, errors in groups
        ]
        return cls(*np.array(rows, dtype=np.float64).reshape(-1, 4).T)

    def at(self, target_mm: float) -> tuple[float, float, float]:
        """Mean, variance of the mean and number of runs at a position, linear between the targets."""
        mean, var, runs = (
            float(np.interp(target_mm, self.target_mm, values)) for values in (self.mean_um, self.var_um2, self.runs)
        )
        return mean, var, runs


def difference(a: Records, b: Records) -> Difference:
    """The difference b − a; empty where their targets have no range in common."""
    rows: list[tuple[float, float, float, float]] = []
    between = 0
    for sign in (1.0, -1.0):
        was, now = _Means.of(a, sign), _Means.of(b, sign)
        if not len(was.target_mm):
            continue
        low, high = was.target_mm[0] - SAME_MM, was.target_mm[-1] + SAME_MM
        for target, mean, var, runs in zip(now.target_mm, now.mean_um, now.var_um2, now.runs, strict=True):
            if low <= target <= high:
                between += bool(np.min(np.abs(was.target_mm - target)) > SAME_MM)
                mean_was, var_was, runs_was = was.at(float(target))
                limit_um = math.sqrt(var + var_was) * float(
                    scipy.special.stdtrit(max(1.0, runs + runs_was - 2.0), 0.975)
                )
                rows.append((sign, float(target), float(mean - mean_was), limit_um))
    direction, target_mm, difference_um, limits_um = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    return Difference(direction, target_mm, difference_um, limits_um, between)


def difference_figure(found: Difference, theme: Theme, ground: Ground = fresh) -> FigureBase:
    """Difference against position, with error bars of `limit_um`."""
    with mpl.rc_context(RC):
        figure = figure_on(ground, 9.6, 3.0)
        ax = figure.subplots()
        ax.axhline(0, color=theme.muted, lw=1)
        for sign, color, marker, name in ((1.0, theme.up, "^", "direction +"), (-1.0, theme.down, "v", "direction −")):
            here = found.direction == sign
            if np.any(here):
                bars = np.nan_to_num(found.limit_um[here])
                ax.errorbar(
                    found.target_mm[here],
                    found.difference_um[here],
                    bars,
                    color=color,
                    marker=marker,
                    ms=4.5,
                    lw=1,
                    label=name,
                )
        label_axes(ax, theme, "Target position, mm", "Difference, µm")
        figure.legend(loc="upper left", ncols=4, labelcolor=theme.ink, bbox_to_anchor=(ax.get_position().x0, 1))
        return figure


def section(a: NamedCampaign, b: NamedCampaign) -> list[Block]:
    """The blocks of the comparison in a report."""
    found = difference(a.records, b.records)
    head = Heading(f"{b.label} against {a.label}")
    if not len(found.target_mm):
        return [head, said("The two have no stretch in common.", "callout")]
    columns = {
        "direction": found.direction,
        "target_mm": found.target_mm,
        "difference_um": found.difference_um,
        "limit_um": found.limit_um,
    }
    return [
        head,
        said(verdict(found)),
        Drawing(
            "difference",
            "difference",
            partial(difference_figure, found),
            "Difference against position",
            f"Mean error of {b.label} minus that of {a.label}, bars as long as 95 of 100 are by scatter alone.",
        ),
        DataTable("data-difference", "Data of this drawing", columns),
    ]


def verdict(found: Difference) -> str:
    """Result of the comparison in one or two sentences."""
    largest = int(np.argmax(np.abs(found.difference_um)))
    at = f"{found.difference_um[largest]:+.2f} µm at {found.target_mm[largest]:g} mm"
    said = f"With one run each there is no scatter to judge by; the largest difference is {at}."
    if found.judged:
        said = (
            f"{found.clear} of {found.judged} target means differ by more than the scatter of the runs explains in 95 of 100;"
            f" the largest difference is {at}."
        )
    mean = float(found.difference_um.mean())
    said += f" On the average {mean:+.2f} µm, RMS {rms(found.difference_um):.2f} µm."
    if found.between:
        said += f" {found.between} targets are not the other's: its means were taken between its targets."
    return said
