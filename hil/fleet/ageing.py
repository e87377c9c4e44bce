"""Axes that age, from the values of the index: alarms at a stated rate of false ones in the whole fleet, and what to
look at first.

One series is one quantity of one axis, of passes of one name and kind, so that like is compared with like. All
series share the rate: with m looks a year in the whole fleet and f false alarms a year allowed, each CUSUM gets the
threshold at which it runs m/f values on the average without ageing (`detect.threshold_for`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import NormalDist
from typing import Any

import numpy as np
import scipy

from drivers.errors import InputError
from hil.figures.history import Trend, trend
from hil.fleet.detect import LEAST, SURER, Alarm, Watched, memory, threshold_for, watch
from hil.fleet.values import QUANTITIES, Quantity
from hil.records.rows import Floats

YEAR_S = 365.25 * 86400.0
MONTH_DAYS = 30.0
FALSE_PER_YEAR = 0.5
"""False alarms a year in the whole fleet, where nothing else is asked for: so that there is at most one in 9 of 10 years, and in the
mean also where the noise has heavy tails (`python tests/study/fleet_trend.py`)."""
RECENT = 5
"""Values whose mean is an axis's present level: what one campaign scatters by is divided by √5."""
FEWEST_AXES = 8
"""Least number of axes in which one is called unlike the others: the spread of fewer says too little."""
FALSE_PER_LOOK = 0.05
"""Probability that any axis is called unlike the others in one comparison where all are alike."""
_SPREAD_FREEDOM = 0.45
"""Degrees of freedom of the median absolute deviation, per axis but one. Of 20,000 simulated fleets of like axes one was called unlike
in 0.02 (8 axes) to 0.05 (200); with 0.37, its efficiency, in 0.01 to 0.046; by the normal distribution in 0.26 to 0.08."""
_SPREAD = 1.0 / NormalDist().inv_cdf(0.75)  # of the median absolute deviation of a normal distribution


@dataclass(frozen=True)
class AxisSeries:
    """The values of one quantity of one axis, in the order of time, shape (n,) each. std: NaN for none; what: kind
    and pass"""

    axis: str
    quantity: str
    what: str
    begun: tuple[datetime, ...]
    value: Floats
    std: Floats
    campaigns: tuple[str, ...]

    @property
    def about(self) -> Quantity:
        return QUANTITIES[self.quantity]

    @property
    def days(self) -> Floats:
        """Days since 1970, shape (n,)."""
        return np.array([one.timestamp() / 86400.0 for one in self.begun])

    def __len__(self) -> int:
        return len(self.value)


def series_of(
    rows: Iterable[Mapping[str, Any]], quantities: Sequence[str], since: datetime | None = None
) -> list[AxisSeries]:
    """The series of an index's results. quantities: which; since: older values are left out. Of each axis and
    quantity the kind and pass that there is most of; the newest of equals.
    """
    unknown = [name for name in quantities if name not in QUANTITIES]
    if unknown:
        raise InputError(f"{unknown[0]} is no quantity, expected one of {', '.join(QUANTITIES)}")
    grouped: dict[tuple[str, str], dict[str, list[Mapping[str, Any]]]] = {}
    for row in rows:
        if row["quantity"] in quantities and (since is None or row["begun"] >= since):
            passes = grouped.setdefault((row["axis"], row["quantity"]), {})
            passes.setdefault(_kind_and_pass(row), []).append(row)
    found = []
    for (axis, quantity), by_pass in sorted(grouped.items()):
        what, own = max(by_pass.items(), key=lambda item: (len(item[1]), max(row["begun"] for row in item[1]), item[0]))
        lines = sorted(own, key=lambda row: (row["begun"], row["campaign"]))
        found.append(
            AxisSeries(
                axis,
                quantity,
                what,
                tuple(row["begun"] for row in lines),
                np.array([row["value"] for row in lines], dtype=np.float64),
                np.array([math.nan if row["std"] is None else row["std"] for row in lines], dtype=np.float64),
                tuple(row["campaign"] for row in lines),
            )
        )
    return found


def _kind_and_pass(row: Mapping[str, Any]) -> str:
    """Files of measurements by torque are numbered and of one kind."""
    return f"{row['kind']}" if row["kind"] == "backlash" else f"{row['kind']}/{row['source']}"


# -- trend -------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Aged:
    """One watched series. level, level_u: mean of the last values and its expanded uncertainty (k = 2) by their
    scatter; growth: the straight line since the alarm's onset, else since the axis is measured against itself;
    noise: scatter from campaign to campaign beside a straight line, standard deviation
    """

    series: AxisSeries
    watched: Watched
    level: float
    level_u: float
    growth: Trend | None
    noise: float

    @property
    def alarm(self) -> Alarm | None:
        return self.watched.standing

    @property
    def nearness(self) -> float:
        """The CUSUM as a share of its threshold: 1 is an alarm."""
        return self.watched.nearness(either=self.series.about.either)

    @property
    def rank(self) -> tuple[bool, float, float]:
        """The larger, the sooner to look at: alarms that stand first, by growth as a share of the level; then the
        nearest to an alarm."""
        share = 0.0
        if self.alarm is not None and self.growth is not None:
            share = abs(self.growth.slope_um) / max(abs(self.level), self.noise, 1e-12)
        return self.alarm is not None, share, self.nearness


@dataclass(frozen=True)
class FleetTrend:
    """All watched series, what to look at first at the top.

    short: series of fewer than `LEAST` values, not watched; looks_per_year: values of the whole fleet in a year,
    twice where a fall is an alarm too; threshold, run_length: of each CUSUM; false_per_year: in the whole fleet, as
    asked for; memory, memory_std: correlation of scores with those before them, and its standard error
    """

    aged: tuple[Aged, ...]
    short: tuple[AxisSeries, ...]
    looks_per_year: float
    threshold: float
    run_length: float
    false_per_year: float
    memory: float
    memory_std: float

    @property
    def alarms(self) -> tuple[Aged, ...]:
        """Those with an alarm that stands."""
        return tuple(one for one in self.aged if one.alarm is not None)

    @property
    def remembers(self) -> bool:
        """Whether values follow those before them, so that false alarms are more frequent than stated."""
        return self.memory > 2.0 * self.memory_std

    def stated(self) -> str:
        """The rate of false alarms in a sentence."""
        if not self.aged:
            return f"nothing is watched: no series has the {LEAST} values that it takes"
        return (
            f"{self.looks_per_year:.0f} looks a year in the whole fleet; threshold {self.threshold:.2f} standard"
            f" deviations: each CUSUM runs {self.run_length:.0f} values on the average without ageing, the fleet gives"
            f" {self.false_per_year:g} false alarm{'s' if self.false_per_year != 1.0 else ''} a year"
        )


def trends(series: Sequence[AxisSeries], false_per_year: float = FALSE_PER_YEAR) -> FleetTrend:
    """Watch all series. Raises InputError for a rate that is not above 0."""
    if not false_per_year > 0.0:
        raise InputError(f"false alarms a year are {false_per_year:g}, expected more than 0")
    long = [one for one in series if len(one) >= LEAST]
    looks = looks_per_year(long)
    run_length = max(looks, 1.0) / false_per_year
    threshold = threshold_for(run_length)
    better_at = threshold_for(SURER * run_length)
    aged = sorted((_aged(one, threshold, better_at) for one in long), key=lambda one: one.rank, reverse=True)
    remembered, std = memory([one.watched.score for one in aged if one.alarm is None])
    short = tuple(one for one in series if len(one) < LEAST)
    return FleetTrend(tuple(aged), short, looks, threshold, run_length, false_per_year, remembered, std)


def looks_per_year(series: Sequence[AxisSeries]) -> float:
    """How often a year any CUSUM gets a value: those of the last year, or of the time there is, at least a month."""
    if not series:
        return 0.0
    newest = max(one.begun[-1].timestamp() for one in series)
    oldest = min(one.begun[0].timestamp() for one in series)
    span_s = min(YEAR_S, max(newest - oldest, MONTH_DAYS * 86400.0))
    count = sum(
        (2 if one.about.either else 1) * sum(when.timestamp() > newest - span_s for when in one.begun) for one in series
    )
    return count * YEAR_S / span_s


def _aged(series: AxisSeries, threshold: float, better_at: float) -> Aged:
    watched = watch(series.value, threshold, series.std, either=series.about.either, better_at=better_at)
    alarm = watched.standing
    since = watched.begun if alarm is None else alarm.onset
    if len(series) - since < LEAST:
        since = max(watched.begun, len(series) - 2 * LEAST)
    days, values = series.days[since:], series.value[since:]
    recent = series.value[watched.begun :][-RECENT:]
    u = 2.0 * float(recent.std(ddof=1)) / math.sqrt(len(recent)) if len(recent) > 1 else math.nan
    return Aged(series, watched, float(recent.mean()), u, trend(days, values), _noise(series.value[watched.begun :]))


def _noise(value: Floats) -> float:
    """Standard deviation from campaign to campaign by the second differences, which a straight course does not
    change; NaN of fewer than three."""
    if len(value) < 3:
        return math.nan
    return float(np.sqrt(np.mean(np.diff(value, 2) ** 2) / 6.0))


# -- compare -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Unlike:
    """An axis beside the others in one quantity. deviation: from their median in their spread; unlike: beyond
    `limit`; for_worse: on the side that is"""

    series: AxisSeries
    level: float
    level_u: float
    deviation: float
    unlike: bool


@dataclass(frozen=True)
class ComparedAxes:
    """One quantity over all axes, the worst first. median, spread: of the levels, the spread by the median absolute
    deviation; limit: of a deviation, in spreads, NaN with too few axes"""

    quantity: str
    axes: tuple[Unlike, ...]
    median: float
    spread: float
    limit: float


def compare(series: Sequence[AxisSeries]) -> list[ComparedAxes]:
    """Each axis's present level beside those of the others, quantity by quantity.

    The limit is such that in a fleet of like axes, normally spread, one is called unlike in at most `FALSE_PER_LOOK` of
    the comparisons of a quantity (Bonferroni, Student's distribution with `_SPREAD_FREEDOM`).
    """
    found = []
    for quantity in dict.fromkeys(one.quantity for one in series):
        own = [one for one in series if one.quantity == quantity]
        levels = np.array([one.value[-RECENT:].mean() for one in own])
        median = float(np.median(levels))
        spread = float(np.median(np.abs(levels - median))) * _SPREAD
        either = QUANTITIES[quantity].either
        limit = _limit(len(own), either=either)
        rows = []
        for one, level in zip(own, levels.tolist(), strict=True):
            recent = one.value[-RECENT:]
            u = 2.0 * float(recent.std(ddof=1)) / math.sqrt(len(recent)) if len(recent) > 1 else math.nan
            away = (level - median) / spread if spread > 0.0 else 0.0
            away = abs(away) if either else away
            rows.append(Unlike(one, level, u, away, away > limit))
        rows.sort(key=lambda one: one.deviation, reverse=True)
        found.append(ComparedAxes(quantity, tuple(rows), median, spread, limit))
    return found


def _limit(axes: int, *, either: bool) -> float:
    if axes < FEWEST_AXES:
        return math.nan
    return -float(scipy.special.stdtrit(_SPREAD_FREEDOM * (axes - 1), FALSE_PER_LOOK / axes / (2.0 if either else 1.0)))
