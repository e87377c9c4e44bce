"""How late an instrument's readings are against the drive's positions, from passes in motion. Pure.

A reading that is taken for one of a moment τ too late shows the axis v·τ behind where the drive says it is: of opposite sign in both
directions and in proportion to the feed. What an axis loses at a reversal has the sign of the direction too, but is the same at every
feed; its errors of position are the same in both directions. So half the difference between a pass up and the pass down over the same
stretch is, over feeds, a straight line: its slope is τ, its intercept half the lost motion.

What the slope cannot tell apart: everything that delays the reading against the drive's own position by a time. That is the
instrument's conversion and its link, the age of the drive's position in its message, and a table that trails its motor by a time
(velocity_lag). No motion separates these, accelerated or not. The servo's following error is not among them: the drive's position is
what its encoder says. An edge that instrument and drive both see does separate them: what is left between the two positions of one
moment is the machine's, and between the edge and the reading's arrival the link's. Friction that grows with speed adds to the
slope; with three feeds or more a bend of the line shows it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from drivers.errors import InputError
from hil.records.rows import UM_PER_MM, Floats, Records

DELAY = "delay_s"
"""Column of rows that were captured at an edge: from the edge to the arrival of the reading that belongs to it."""
SPREAD_OF_FEEDS = 1.5
"""The fastest feed must be so much faster than the slowest: else a slope and an intercept are one thing."""
FEWEST_PAIRS = 3
LOOKS_S = 2e-6
"""No closer is an arrival looked for; it is the same for all passes and does not show in their scatter."""
_GRID = 50
_SURE = 0.99


@dataclass(frozen=True)
class TimeShift:
    """The reading's delay against the drive's position, s, and its standard deviation with so many degrees of freedom.

    lost_motion_um: at a reversal, the same at each feed; straight: whether the line over feeds shows no bend, None of two feeds
    """

    shift_s: float
    std_s: float
    freedom: int
    lost_motion_um: float
    straight: bool | None = None

    @property
    def within_s(self) -> float:
        """Half of the interval that holds it with 95 % probability."""
        return float(student.ppf(0.975, self.freedom)) * self.std_s


@dataclass(frozen=True)
class Latency:
    """From a sample to its arrival, and what of it is known how well (95 %).

    at_edges: whether an edge that both saw tells it from a lag of the machine; lag_s, lag_within_s: of the table behind its motor, NaN
    where the latency holds it
    """

    latency_s: float
    within_s: float
    at_edges: bool
    lag_s: float = math.nan
    lag_within_s: float = math.nan
    straight: bool | None = None

    def to_json(self) -> dict[str, float | bool]:
        """As plain values; what is not known is left out."""
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
    """To a microsecond, and no zero below zero."""
    return f"{round(1e3 * seconds, 3) + 0.0:.3f}"


def check_feeds(feeds: Sequence[float]) -> None:
    """Raises InputError for pairs of passes at these feeds (mm/s) that nothing can be told from."""
    if len(feeds) < FEWEST_PAIRS or max(feeds) < SPREAD_OF_FEEDS * min(feeds):
        raise InputError(
            f"{len(feeds)} pairs of passes at {', '.join(f'{feed:g}' for feed in sorted(set(feeds)))} mm/s cannot tell a latency"
            f" from lost motion; expected {FEWEST_PAIRS} or more, with feeds a factor {SPREAD_OF_FEEDS:g} apart"
        )


def time_shift(records: Records) -> TimeShift:
    """From rows in motion with the drive's own position (`motor_mm`), passes up and down over the same stretch at each feed.

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
        straight = bool(abs(bent[2]) <= float(student.ppf((1.0 + _SURE) / 2.0, len(half) - 3)) * bend_std[2])
    # positions in µm over feeds in mm/s; a reading that is late is behind
    return TimeShift(
        -float(line[1]) / UM_PER_MM, float(std[1]) / UM_PER_MM, len(half) - 2, -2.0 * float(line[0]), straight=straight
    )


def latency_at_edges(records: Records) -> Latency:
    """From rows that were captured at edges: the latency from their delays, the table's lag from their positions.

    Passes are what is counted: the rows of one share the doubt of its clock.
    """
    delays = [float(np.mean(records[DELAY][chosen])) for chosen in _passes(records)]
    if len(delays) < 2:
        raise InputError(f"{len(delays)} pass with edges that both saw; expected two or more")
    within_s = float(student.ppf(0.975, len(delays) - 1)) * float(np.std(delays, ddof=1)) / math.sqrt(len(delays))
    lag = time_shift(records)
    return Latency(
        float(np.mean(delays)),
        math.hypot(within_s, LOOKS_S),
        at_edges=True,
        lag_s=lag.shift_s,
        lag_within_s=lag.within_s,
        straight=lag.straight,
    )


def latency_by_passes(dated_by_s: float, left: TimeShift) -> Latency:
    """Of rows that were dated by a latency already, and what of a shift was left in them."""
    within_s = math.hypot(left.within_s, LOOKS_S)
    return Latency(dated_by_s + left.shift_s, within_s, at_edges=False, straight=left.straight)


def _passes(records: Records) -> list[Floats]:
    """Rows of each pass, as masks."""
    keys = list(zip(records.run, records["velocity_mm_s"], records.direction, strict=True))
    return [np.array([key == one for key in keys]) for one in dict.fromkeys(keys)]


def _half_differences(records: Records) -> tuple[list[float], list[float]]:
    """Feed of each pair of passes, and half of up minus down over what both cover, µm."""
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


def _fit(rows: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Least squares and the standard deviations of what it finds.

    The larger of two: as if all values were as good as each other, and by what each of them is off, weighed by how much it decides
    (the passes at one feed may scatter more than at another).
    """
    inverse = np.linalg.inv(rows.T @ rows)
    found = inverse @ rows.T @ values
    residual = values - rows @ found
    even = inverse * float(residual @ residual) / (len(values) - rows.shape[1])
    leverage = np.einsum("ij,jk,ik->i", rows, inverse, rows)
    own = (residual / np.maximum(1.0 - leverage, 0.1)) ** 2
    uneven = inverse @ (rows.T * own) @ rows @ inverse
    return found, np.sqrt(np.maximum(np.diag(even), np.diag(uneven)))
