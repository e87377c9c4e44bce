"""The tables of a fleet's results as words, for terminal and page, and their JSON form."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from hil.fleet.ageing import FALSE_PER_LOOK, MONTH_DAYS, Aged, ComparedAxes, FleetTrend, Unlike
from hil.fleet.causes import Cause
from hil.fleet.values import QUANTITIES

TREND_HEAD = (
    "axis",
    "what",
    "of",
    "values",
    "level ± U",
    "noise",
    "change in 30 days ± U",
    "alarm since",
    "of threshold",
)
MEMORY = (
    "Values follow those before them (correlation of scores {:.2f}, by chance at most ±{:.2f}): a season or a shared instrument;"
    " false alarms are more frequent than stated."
)


def number(value: float, digits: int = 3) -> str:
    """A figure with significant digits; a dash where there is none."""
    return "–" if not math.isfinite(value) else f"{value:.{digits}g}"


def with_u(value: float, u: float, unit: str) -> str:
    """A value with its expanded uncertainty, as far as it has one."""
    return f"{number(value)} {unit}" if not math.isfinite(u) else f"{number(value)} ± {number(u, 2)} {unit}"


def trend_row(one: Aged) -> tuple[str, ...]:
    """The cells of a series under `TREND_HEAD`."""
    series, alarm = one.series, one.alarm
    unit = series.about.unit
    growth = "–" if one.growth is None else with_u(one.growth.slope_um, 2.0 * one.growth.std_um, unit)
    return (
        series.axis,
        series.about.title,
        series.what,
        str(len(series)),
        with_u(one.level, one.level_u, unit),
        number(one.noise, 2),
        growth,
        "–" if alarm is None else f"{series.begun[alarm.at]:%Y-%m-%d}",
        f"{100.0 * one.nearness:.0f} %",
    )


def trend_json(found: FleetTrend) -> dict[str, Any]:
    """The machine-readable result of `hil fleet trend`."""
    return {
        "looks_per_year": found.looks_per_year,
        "false_alarms_per_year": found.false_per_year,
        "run_length": found.run_length,
        "threshold": found.threshold,
        "memory": {"correlation": found.memory, "std": found.memory_std, "beyond_chance": found.remembers},
        "alarms": len(found.alarms),
        "series": [_series_json(one) for one in found.aged],
        "too_short": [{"axis": one.axis, "quantity": one.quantity, "values": len(one)} for one in found.short],
    }


def _series_json(one: Aged) -> dict[str, Any]:
    series = one.series

    def when(at: int | None) -> str | None:
        return None if at is None else series.begun[at].isoformat(timespec="seconds")

    growth = None
    if one.growth is not None:
        growth = {"per_days": MONTH_DAYS, "value": one.growth.slope_um, "std": one.growth.std_um}
    return {
        "axis": series.axis,
        "quantity": series.quantity,
        "unit": series.about.unit,
        "of": series.what,
        "values": len(series),
        "level": {"value": one.level, "expanded": one.level_u},
        "noise": one.noise,
        "growth": growth,
        "measured_against_itself_since": when(one.watched.begun),
        "share_of_threshold": one.nearness,
        "alarm": one.alarm is not None,
        "alarms": [
            {
                "found": when(alarm.at),
                "began": when(alarm.onset),
                "until": when(alarm.until),
                "direction": 1 if alarm.upwards else -1,
                "campaign": series.campaigns[alarm.at],
            }
            for alarm in one.watched.alarms
        ],
        "last": {"begun": when(-1), "value": float(series.value[-1]), "std": float(series.std[-1])},
    }


def compare_head(one: ComparedAxes) -> tuple[str, ...]:
    return ("axis", "of", f"{QUANTITIES[one.quantity].title} ± U", "from the median, in spreads", "unlike the others")


def compare_row(each: Unlike, one: ComparedAxes) -> tuple[str, ...]:
    """The cells of an axis under `compare_head`."""
    unit = QUANTITIES[one.quantity].unit
    said = "–" if math.isnan(one.limit) else "yes" if each.unlike else "no"
    return (each.series.axis, each.series.what, with_u(each.level, each.level_u, unit), number(each.deviation), said)


def compare_rule(one: ComparedAxes) -> str:
    """The rule of a comparison in a sentence."""
    if math.isnan(one.limit):
        return f"{len(one.axes)} axes are too few to call one unlike the others."
    return (
        f"Unlike: beyond {one.limit:.1f} spreads from the median, which of like axes one is in {100 * FALSE_PER_LOOK:.0f} of 100"
        " comparisons."
    )


def compare_json(one: ComparedAxes) -> dict[str, Any]:
    """The machine-readable result of a comparison."""
    return {
        "quantity": one.quantity,
        "unit": QUANTITIES[one.quantity].unit,
        "median": one.median,
        "spread": one.spread,
        "limit": one.limit,
        "axes": [
            {
                "axis": each.series.axis,
                "of": each.series.what,
                "level": each.level,
                "expanded": each.level_u,
                "deviation": each.deviation,
                "unlike": each.unlike,
            }
            for each in one.axes
        ],
    }


def causes_head() -> tuple[str, ...]:
    return ("axis", "pass", "begun", "cause", "RMS, µm", "confidence", "action", "before, µm", "after, µm", "left")


def causes_row(one: Cause) -> tuple[str, ...]:
    """The cells of a cause under `causes_head`."""
    task = one.task
    first = (task.axis, f"{task.campaign}/{task.name}", f"{task.begun:%Y-%m-%d}")
    if one.why:
        return (*first, f"not diagnosed: {one.why}", "–", "–", "–", "–", "–", "–")
    left = "unexplained" if one.unexplained else "–"
    figures = (f"{one.before_um:.2f}", f"{one.after_um:.2f}", left)
    if not one.effect:
        return (*first, "none", "–", "–", "–", *figures)
    return (*first, one.effect, f"{one.rms_um:.2f}", f"{one.confidence:.2f}", one.action, *figures)


def cause_json(one: Cause) -> Mapping[str, Any]:
    """The machine-readable form of a cause."""
    return {
        "axis": one.task.axis,
        "campaign": one.task.campaign,
        "pass": one.task.name,
        "begun": one.task.begun.isoformat(timespec="seconds"),
        "effect": one.effect or None,
        "rms_um": one.rms_um,
        "confidence": one.confidence,
        "action": one.action or None,
        "explanation": one.explanation,
        "before_um": one.before_um,
        "after_um": one.after_um,
        "unexplained": one.unexplained,
        "why": one.why,
    }
