"""The delay of an instrument's readings against the drive's positions, from passes in motion. No I/O.

A reading dated τ too late shows the axis v·τ behind the drive's position: of opposite sign in the two directions and
proportional to the feed. Lost motion also has the sign of the direction, but is the same at every feed. Errors of
position are the same in both directions. So half the difference between a pass up and the pass down over the same
stretch is a straight line over feeds: its slope is τ, its intercept half the lost motion.

The slope is the sum of everything that delays the reading against the drive's own position by a time: the instrument's
conversion and its link, the age of the drive's position in its message, and a table that trails its motor by a time
(velocity_lag). No motion separates these, accelerated or not. The servo's following error is not among them: the
drive's position is that of its encoder. An edge that instrument and drive both see does separate them: the difference
between the two positions at the edge is the machine's lag, the time from the edge to the reading's arrival the link's
latency. Friction that grows with speed adds to the slope; with three feeds or more a bend of the line shows it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from drivers.errors import InputError
from hil.records.rows import UM_PER_MM, Floats, Records

DELAY = "delay_s"
"""Column of rows captured at an edge: time from the edge to the arrival of its reading, s."""
SPREAD_OF_FEEDS = 1.5
"""Least ratio of the fastest to the slowest feed; below it slope and intercept cannot be separated."""
FEWEST_PAIRS = 3
"""Fewest pairs of passes."""
ARRIVAL_TOLERANCE_S = 2e-6
"""Tolerance of the arrival's time, s. It is the same for all passes, so their scatter does not contain it."""
_GRID = 50  # positions at which a pass up and a pass down are compared
_CONFIDENCE = 0.99  # confidence at which a bend of the line counts


@dataclass(frozen=True)
class TimeShift:
    """The reading's delay against the drive's position, s, and its standard deviation with `freedom` degrees of
    freedom.

    lost_motion_um: at a reversal, the same at each feed; straight: whether the line over feeds shows no bend, None of
    two feeds
    """

    shift_s: float
    std_s: float
    freedom: int
    lost_motion_um: float
    straight: bool | None = None

    @property
    def within_s(self) -> float:
        """Half width of the 95 % confidence interval."""
        return _student(self.freedom, 0.975) * self.std_s


@dataclass(frozen=True)
class Latency:
    """Time from a sample to its arrival, s, each figure with its half width (95 %).

    at_edges: measured at edges that drive and instrument share, and so separated from a lag of the machine
    lag_s, lag_within_s: of the table behind its motor, NaN where the latency includes it
    """

    latency_s: float
    within_s: float
    at_edges: bool
    lag_s: float = math.nan
    lag_within_s: float = math.nan
    straight: bool | None = None

    def to_json(self) -> dict[str, float | bool]:
        """Plain values; unknown ones are left out."""
        known = {name: value for name, value in vars(self).items() if value is not None}
        return {name: value for name, value in known.items() if not math.isnan(value)}

    def describe(self) -> str:
        """One line for the head of the rows and for a report."""
        text = f"latency {_ms(self.latency_s)} ± {_ms(self.within_s)} ms (95 %)"
        if self.at_edges:
            lag = f"{_ms(self.lag_s)} ± {_ms(self.lag_within_s)} ms"
            return f"{text}, by edges that drive and instrument share; the table is {lag} behind its motor"
        return f"{text}, by passes up and down; a lag of the table behind its motor would be in it"


def _ms(seconds: float) -> str:
    """Milliseconds to three decimals, without a negative zero."""
    return f"{round(1e3 * seconds, 3) + 0.0:.3f}"


def check_feeds(feeds: Sequence[float]) -> None:
    """Raises InputError for pairs of passes at feeds (mm/s) that cannot separate latency from lost motion."""
    if len(feeds) < FEWEST_PAIRS or max(feeds) < SPREAD_OF_FEEDS * min(feeds):
        raise InputError(
            f"{len(feeds)} pairs of passes at {', '.join(f'{feed:g}' for feed in sorted(set(feeds)))} mm/s cannot tell a latency"
            f" from lost motion; expected {FEWEST_PAIRS} or more, with feeds a factor {SPREAD_OF_FEEDS:g} apart"
        )


def time_shift(records: Records) -> TimeShift:
    """The delay from rows in motion with the drive's own position (`motor_mm`), passes up and down over the same
    stretch at each feed.

    Raises InputError as `check_feeds`.
    """
    feeds, halves = _half_differences(records)
    check_feeds(feeds)
    feed, half = np.array(feeds), np.array(halves)
    rows = np.column_stack([np.ones_like(feed), feed])
    line, std = _fit(rows, half)
    straight = None
    if len(set(feeds)) > 2 and len(half) > 3:
        bent, bend_std = _fit(np.column_stack([rows, feed**2]), half)
        straight = bool(abs(bent[2]) <= _student(len(half) - 3, (1.0 + _CONFIDENCE) / 2.0) * bend_std[2])
    # positions in µm over feeds in mm/s; a reading that is late is behind
    return TimeShift(
        -float(line[1]) / UM_PER_MM, float(std[1]) / UM_PER_MM, len(half) - 2, -2.0 * float(line[0]), straight=straight
    )


def latency_at_edges(records: Records) -> Latency:
    """The latency from the delays of rows captured at edges, the table's lag from their positions.

    Each pass counts as one observation: its rows share the uncertainty of its clock. Raises InputError for fewer than
    two passes, and as `check_feeds`.
    """
    delays = [float(np.mean(records[DELAY][chosen])) for chosen in _passes(records)]
    if len(delays) < 2:
        raise InputError(f"{len(delays)} pass with edges that both saw; expected two or more")
    within_s = _student(len(delays) - 1, 0.975) * float(np.std(delays, ddof=1)) / math.sqrt(len(delays))
    lag = time_shift(records)
    return Latency(
        float(np.mean(delays)),
        math.hypot(within_s, ARRIVAL_TOLERANCE_S),
        at_edges=True,
        lag_s=lag.shift_s,
        lag_within_s=lag.within_s,
        straight=lag.straight,
    )


def latency_by_passes(dated_by_s: float, remaining: TimeShift) -> Latency:
    """The latency of rows that were dated by `dated_by_s`, corrected by the remaining shift."""
    within_s = math.hypot(remaining.within_s, ARRIVAL_TOLERANCE_S)
    return Latency(dated_by_s + remaining.shift_s, within_s, at_edges=False, straight=remaining.straight)


def _passes(records: Records) -> list[Floats]:
    """Rows of each pass, as masks."""
    keys = list(zip(records.run, records["velocity_mm_s"], records.direction, strict=True))
    return [np.array([key == one for key in keys]) for one in dict.fromkeys(keys)]


def _half_differences(records: Records) -> tuple[list[float], list[float]]:
    """Feed of each pair of passes (mm/s), and half of up minus down over their common stretch, µm."""
    behind_um = (records.measured_mm - records["motor_mm"]) * UM_PER_MM
    feeds, halves = [], []
    for run, feed in dict.fromkeys(zip(records.run, records["velocity_mm_s"], strict=True)):
        both = [
            (records.run == run) & (records["velocity_mm_s"] == feed) & (records.direction == way) for way in (1, -1)
        ]
        if min(chosen.sum() for chosen in both) < 2:
            continue
        place = [records["motor_mm"][chosen] for chosen in both]
        low, high = max(where.min() for where in place), min(where.max() for where in place)
        if not low < high:
            continue
        grid = np.linspace(low, high, _GRID)
        up, down = (_at(grid, where, behind_um[chosen]) for where, chosen in zip(place, both, strict=True))
        feeds.append(float(feed))
        halves.append(float(np.mean(up - down)) / 2.0)
    return feeds, halves


def _at(grid: Floats, place: Floats, value: Floats) -> Floats:
    order = np.argsort(place)
    return np.asarray(np.interp(grid, place[order], value[order]))


def _student(freedom: float, probability: float) -> float:
    """Quantile of Student's t distribution."""

    return float(scipy.special.stdtrit(freedom, probability))


def _fit(rows: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Least squares; coefficients and their standard deviations.

    Of two estimates the larger: with equal variance for all values, and with each value's own squared residual
    (HC3, since the passes at one feed may scatter more than at another).
    """
    inverse = np.linalg.inv(rows.T @ rows)
    found = inverse @ rows.T @ values
    residual = values - rows @ found
    even = inverse * float(residual @ residual) / (len(values) - rows.shape[1])
    leverage = np.einsum("ij,jk,ik->i", rows, inverse, rows)
    own = (residual / np.maximum(1.0 - leverage, 0.1)) ** 2
    uneven = inverse @ (rows.T * own) @ rows @ inverse
    return found, np.sqrt(np.maximum(np.diag(even), np.diag(uneven)))
