"""The report's part on the extended model's residual: along each relevant column, and as a spectrum over the position.

From the JSON form of `hil diagnose` (`left`, see `hil.diagnosis.pictures`); a missing key is left out, never guessed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from hil.records.rows import Floats
from hil.ui.report.blocks import Block, DataTable, Drawing, Heading, said
from hil.ui.report.markup import plain
from hil.ui.report.svg import RC, Ground, Theme, figure_on, fresh, label_axes
from hil.ui.report.views import label_of, list_of, object_of, objects_of, value_of

ACROSS = 3
ROW_IN, WIDTH_IN = 2.2, 9.6
MOST_DOTS = 300
"""Most points of one plot: more overlap, and make the page heavy."""
REACH = 0.995
"""Share of the rows that the plots show; rows beyond are not drawn."""


@dataclass(frozen=True)
class Panel:
    """One small plot: residuals of rows against x, each (n,), and the mean curves of their groups."""

    label: str
    x: Floats
    left_um: Floats
    direction: Floats
    curves: tuple[MeanCurve, ...]


def panels_plot(panels: Sequence[Panel], theme: Theme, ground: Ground = fresh) -> FigureBase:
    down = -(-len(panels) // ACROSS)
    with mpl.rc_context(RC):
        figure = figure_on(ground, WIDTH_IN, ROW_IN * down, top_in=0.25)
        figure.subplots_adjust(hspace=0.48, wspace=0.08)
        axes = figure.subplots(down, ACROSS, sharey=True, squeeze=False).ravel()
        for index, (ax, panel) in enumerate(zip(axes, panels, strict=False)):
            _draw(ax, panel, theme)
            label_axes(ax, theme, plain(panel.label), "What is left, µm" if index % ACROSS == 0 else "")
            ax.margins(x=0.03)
            ax.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
            if panel.label == "Direction":
                ax.set_xticks([-1, 1], ["−", "+"])
                ax.margins(x=0.5)
        for ax in axes[len(panels) :]:
            ax.set_axis_off()
        if panels:
            reach = float(np.quantile(np.abs(panels[0].left_um), REACH))
            axes[0].set_ylim(-1.1 * reach, 1.1 * reach)
        return figure


def _draw(ax: Axes, panel: Panel, theme: Theme) -> None:
    ax.axhline(0, color=theme.muted, lw=1)
    shown = np.arange(0, len(panel.x), -(-len(panel.x) // MOST_DOTS))
    for sign, color, marker in ((1, theme.up, "^"), (-1, theme.down, "v")):
        here = shown[panel.direction[shown] == sign]
        ax.plot(panel.x[here], panel.left_um[here], marker, color=color, ms=2, mew=0, alpha=0.45)
    lines = ((theme.ink, "-"), (theme.accent, (0, (4, 1.6))))
    for curve, (color, dash) in zip(panel.curves, lines, strict=False):
        if curve.levels:
            spread = np.nan_to_num(np.array([curve.mean_um - curve.low_um, curve.high_um - curve.mean_um]))
            ax.errorbar(curve.at, curve.mean_um, spread, color=color, fmt="o", ms=4, lw=1.4, capsize=3, zorder=4)
            ax.plot(curve.at, curve.mean_um, color=color, lw=0.9, linestyle=dash, label=curve.label, zorder=4)
        else:
            ax.fill_between(curve.at, curve.low_um, curve.high_um, color=color, alpha=0.22, lw=0)
            ax.plot(curve.at, curve.mean_um, color=color, lw=1.8, linestyle=dash, label=curve.label, zorder=4)
    if len(panel.curves) > 1:
        ax.legend(
            loc="lower left", bbox_to_anchor=(0, 1), ncols=2, labelcolor=theme.ink, borderpad=0, fontsize=7, handlelength=1.6,
            columnspacing=0.8, borderaxespad=0.15,
        )  # fmt: skip


def spectrum_plot(spectrum: Spectrum, theme: Theme, ground: Ground = fresh) -> FigureBase:
    """Amplitude against period, the noise level dashed, the highest line labelled."""
    period, amplitude = spectrum.highest
    with mpl.rc_context(RC):
        figure = figure_on(ground, WIDTH_IN, 2.8, top_in=0.3)
        ax = figure.subplots()
        ax.plot(spectrum.period_mm, spectrum.amplitude_um, color=theme.ink, lw=1)
        level = f"exceeded by noise alone in 5 of 100 cases: {spectrum.level_um:.3g} µm"
        ax.axhline(spectrum.level_um, color=theme.accent, lw=1.2, linestyle=(0, (4, 1.6)), label=level)
        ax.plot([period], [amplitude], "o", mfc="none", mec=theme.accent, ms=7)
        ax.annotate(
            f"{period:.4g} mm: {amplitude:.3g} µm",
            (period, amplitude),
            (8, 0),
            textcoords="offset points",
            color=theme.ink,
            fontsize=8,
        )
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.set_ylim(0, 1.15 * max(amplitude, spectrum.level_um))
        label_axes(ax, theme, "Period, mm", "Amplitude, µm")
        ax.legend(loc="lower right", bbox_to_anchor=(1, 1), labelcolor=theme.ink, borderpad=0, borderaxespad=0.2)
        return figure


Mask = NDArray[np.bool_]

EMPTY = 0.01
"""Highest line over the noise level, below which the rows were fitted by a table at just their targets."""


@dataclass(frozen=True)
class LeftOver:
    """left_um: residual of each row; columns: with `run` and `direction`; carriers: columns of each unexplained
    structure; all (n,)
    """

    left_um: Floats
    columns: Mapping[str, Floats]
    carriers: tuple[tuple[str, ...], ...]


def read(diagnosis: Mapping[str, Any]) -> LeftOver | None:
    """The residual in a diagnosis; None where it cannot be plotted."""
    form = object_of(diagnosis.get("left"))
    left = _numbers(form.get("left_um"))
    read_columns = {str(name): _numbers(values) for name, values in object_of(form.get("columns")).items()}
    if left is None:
        return None
    columns = {name: values for name, values in read_columns.items() if values is not None and len(values) == len(left)}
    if not {"run", "direction", "target_mm"} <= set(columns):
        return None
    carriers = [tuple(map(str, list_of(one.get("columns")))) for one in objects_of(diagnosis.get("carried_by"))]
    return LeftOver(left, columns, tuple(carriers))


def section(diagnosis: Mapping[str, Any]) -> list[Block]:
    """The blocks of the part; empty where the diagnosis has nothing to plot."""
    found = read(diagnosis)
    if found is None:
        return []
    shown = panels(found)
    parts: list[Block] = [
        Heading("What the extended model leaves", 3),
        said(
            "Each drawing shows the same rows along another column: dots are rows (of many, some), lines the means of neighbouring"
            " rows, bands hold the true mean in 95 of 100 cases. A line that leaves zero by more than its band shows what is left."
            " Where two columns carry it together, the rows are split by the other one."
        ),
        Drawing(
            "leftover",
            "left-over",
            partial(panels_plot, shown),
            "What is left, along each column",
            f"What is left of each row, {len(found.left_um)} rows in all. Rows are taken as independent of each other.",
        ),
        DataTable("data-left-over-means", "Data of the lines and bands", _table(shown)),
        DataTable("data-left-over", "What is left, row by row", {**found.columns, "left_um": found.left_um}),
    ]
    seen = spectrum(found.columns["target_mm"], found.left_um, found.columns["run"])
    return parts if seen is None else [*parts, *_spectrum(seen)]


def panels(found: LeftOver) -> list[Panel]:
    """Each column with the mean curves along it."""
    out = []
    for name, values in found.columns.items():
        if name == "run" or np.ptp(values) == 0:
            continue
        label = "Row (the records hold no time)" if name == "row_order" else label_of(name)
        for groups in _splits(name, found):
            there = {which: rows for which, rows in groups.items() if np.any(rows)}
            curves = tuple(mean_curve(which, values[rows], found.left_um[rows]) for which, rows in there.items())
            out.append(Panel(label, values, found.left_um, found.columns["direction"], curves))
    return out


def _splits(name: str, found: LeftOver) -> list[dict[str, Mask]]:
    """The rows of each curve along a column, for every plot of it.

    The position is always split by direction; a column of a structure of several columns is split by the others.
    """
    direction = found.columns["direction"]
    signs = {"direction +": direction > 0, "direction −": direction < 0}
    mine = [carrier for carrier in found.carriers if name in carrier]
    others = dict.fromkeys(other for carrier in mine for other in carrier if other not in (name, "direction"))
    halves = [_halves(other, found.columns[other]) for other in others if other in found.columns]
    if name == "direction":
        return [{"all rows": np.ones(len(direction), dtype=np.bool_)}]
    if name == "target_mm":
        return [signs, *halves]
    if any("direction" in carrier for carrier in mine):
        return [signs, *halves]
    return halves or [{"all rows": np.ones(len(direction), dtype=np.bool_)}]


def _halves(name: str, values: Floats) -> dict[str, Mask]:
    middle = float(np.median(values))
    what = label_of(name).partition(",")[0].lower()
    return {f"{what} up to {middle:.4g}": values <= middle, f"{what} above {middle:.4g}": values > middle}


def _table(shown: Sequence[Panel]) -> dict[str, Floats]:
    """The bins of all curves, one below the other; plot and line are counted from 1."""
    parts: dict[str, list[Floats]] = {}
    for number, panel in enumerate(shown, start=1):
        for line, curve in enumerate(panel.curves, start=1):
            size = len(curve.at)
            columns = {"drawing": np.full(size, float(number)), "line": np.full(size, float(line)), "at": curve.at}
            columns |= {"mean_um": curve.mean_um, "low_um": curve.low_um, "high_um": curve.high_um, "rows": curve.rows}
            for name, values in columns.items():
                parts.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}


def _spectrum(seen: Spectrum) -> list[Block]:
    period, amplitude = seen.highest
    if amplitude < EMPTY * seen.level_um:
        return [
            said(
                "Over the position there is no spectrum to draw: at these targets the table holds whatever follows it."
            )
        ]
    verdict = "above" if amplitude > seen.level_um else "below"
    caption = (
        f"Spectrum of what is left over the position. The highest line, {amplitude:.3g} µm at a period of {period:.4g} mm, is"
        f" {verdict} the dashed level of {seen.level_um:.3g} µm, which the highest line of the same values in random order within each"
        f" run exceeds in {100 * EXCEEDED:.0f} of 100 cases."
    )
    return [
        Drawing("spectrum", "spectrum", partial(spectrum_plot, seen), "Spectrum of what is left", caption),
        DataTable(
            "data-spectrum", "Data of this drawing", {"period_mm": seen.period_mm, "amplitude_um": seen.amplitude_um}
        ),
    ]


def _numbers(values: object) -> Floats | None:
    """A JSON list of finite numbers as an array, None for anything else."""
    known = [value_of(value, "value") for value in list_of(values)]
    if not known or any(value is None for value in known):
        return None
    return np.array(known, dtype=np.float64)


LINES = 1500
OVERSAMPLING = 3.0
SHORTEST_MM = 0.5
ORDERS = 400
"""Permutations."""
EXCEEDED = 0.05
"""Share of the permutations that exceed the noise level."""
ONE_SIDED = 0.2
"""Least determinant of sine and cosine at the targets (0: collinear) at which an amplitude is determined."""
SAME_MM = 0.01


@dataclass(frozen=True)
class Spectrum:
    """Periods descending, (f,), amplitudes there, (f,); level_um: noise level that the highest line exceeds by chance
    in EXCEEDED of all cases.
    """

    period_mm: Floats
    amplitude_um: Floats
    level_um: float

    @property
    def highest(self) -> tuple[float, float]:
        """Period and amplitude of the highest line."""
        top = int(np.argmax(self.amplitude_um))
        return float(self.period_mm[top]), float(self.amplitude_um[top])


def spectrum(target_mm: Floats, residual_um: Floats, run: Floats, seed: int = 0) -> Spectrum | None:
    """The spectrum of rows, each array (n,); None where the targets resolve fewer than two periods."""
    frequency = _frequencies(target_mm)
    if len(frequency) < 2 or len(target_mm) < 8:
        return None
    angle = 2 * np.pi * target_mm[:, None] * frequency
    sine, cosine = (wave - np.mean(wave, axis=0) for wave in (np.sin(angle), np.cos(angle)))
    ss, cc, sc = np.sum(sine**2, axis=0), np.sum(cosine**2, axis=0), np.sum(sine * cosine, axis=0)
    determinant = ss * cc - sc**2
    told = determinant > ONE_SIDED * (0.5 * (ss + cc)) ** 2
    if np.count_nonzero(told) < 2:
        return None
    centred = residual_um - np.mean(residual_um)
    orders = _in_random_order(centred, run, np.random.default_rng(seed))
    y = np.column_stack([centred, orders]).astype(np.float32)
    sy, cy = (wave[:, told].T.astype(np.float32) @ y for wave in (sine, cosine))
    ss, cc, sc, determinant = (each[told, None] for each in (ss, cc, sc, determinant))
    amplitude = np.hypot(cc * sy - sc * cy, ss * cy - sc * sy) / determinant
    level = float(np.quantile(np.max(amplitude[:, 1:], axis=0), 1.0 - EXCEEDED))
    return Spectrum(1.0 / frequency[told], np.asarray(amplitude[:, 0], dtype=np.float64), level)


def _frequencies(target_mm: Floats) -> Floats:
    """Even in frequency, finer than the travel resolves, up to the resolution of the targets, per mm, ascending."""
    places = np.unique(np.round(target_mm / SAME_MM)) * SAME_MM
    travel = float(np.ptp(places))
    if travel <= 0.0:
        return np.zeros(0)
    shortest = SHORTEST_MM
    if 3 * len(places) <= len(target_mm):  # the same targets again and again: nothing is known between them
        shortest = max(shortest, 2.0 * float(np.median(np.diff(places))))
    step = 1.0 / (OVERSAMPLING * travel)
    count = int(min(LINES, (1.0 / shortest - 1.0 / travel) / step + 1.0))
    return np.asarray(1.0 / travel + step * np.arange(max(count, 0)))


def _in_random_order(values: Floats, run: Floats, rng: np.random.Generator) -> Floats:
    """The values (n,) with those of each run permuted ORDERS times, shape (n, ORDERS)."""
    out = np.empty((len(values), ORDERS))
    for number in np.unique(run):
        rows: NDArray[np.int64] = np.flatnonzero(run == number)
        order = np.argsort(rng.random((len(rows), ORDERS)), axis=0)
        out[rows] = values[rows][order]
    return out


Index = np.ndarray[tuple[int, ...], np.dtype[np.intp]]

ROWS_PER_BIN = 12
MOST_BINS = 16
MOST_LEVELS = 10
"""Up to so many values, each with its neighbours within NEAR of the span, each is a bin of its own."""
NEAR = 0.05
BAND = 0.95
"""Confidence level of the band."""


@dataclass(frozen=True)
class MeanCurve:
    """label: of its rows; at: mean of the column in each bin, ascending; mean, low, high: of the residual, µm; rows in
    it; each (k,)

    levels: the bins are levels that were set, between which nothing was measured
    """

    label: str
    at: Floats
    mean_um: Floats
    low_um: Floats
    high_um: Floats
    rows: Floats
    levels: bool


def mean_curve(label: str, x: Floats, residual_um: Floats) -> MeanCurve:
    """The curve of rows, each array (n,), n ≥ 1. A bin of a single row has no band (low and high are NaN)."""
    level = _levels(x)
    levels = level is not None
    index = _bins(x) if level is None else level
    rows = np.bincount(index).astype(np.float64)
    at = np.bincount(index, weights=x) / rows
    mean = np.bincount(index, weights=residual_um) / rows
    square = np.bincount(index, weights=(residual_um - mean[index]) ** 2)
    dof = np.maximum(rows - 1, 1)
    half = scipy.special.stdtrit(dof, (1 + BAND) / 2) * np.sqrt(square / dof / rows)
    half[rows < 2] = np.nan
    return MeanCurve(label, at, mean, mean - half, mean + half, rows, levels)


def _levels(x: Floats) -> Index | None:
    """Level of each row, numbered upwards, shape (n,); None where the column does not keep to few levels."""
    order = np.argsort(x, kind="stable")
    span = float(np.ptp(x))
    rank = np.concatenate([[0], np.cumsum(np.diff(x[order]) > NEAR * span)])
    if rank[-1] >= MOST_LEVELS:
        return None
    index = np.empty(len(x), dtype=np.intp)
    index[order] = rank
    widths = [float(np.ptp(x[index == level])) for level in range(int(rank[-1]) + 1)]
    return index if max(widths) <= NEAR * span else None


def _bins(x: Floats) -> Index:
    """Bins of equal count as far as ties allow, numbered without gaps, shape (n,)."""
    count = int(np.clip(len(x) // ROWS_PER_BIN, 2, MOST_BINS))
    edges = np.unique(np.quantile(x, np.linspace(0, 1, count + 1)))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(0, len(edges) - 2))
    return np.unique(index, return_inverse=True)[1].reshape(-1)
