"""What ages in a fleet, at which rate of false alarms, and which axes are unlike the others."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

from drivers.errors import InputError
from hil.fleet.ageing import FALSE_PER_LOOK, FALSE_PER_YEAR, FEWEST_AXES, compare, looks_per_year, series_of, trends
from hil.fleet.detect import CLIP, arl
from hil.fleet.words import trend_json, trend_row

BEGUN = datetime(2025, 1, 6, 8, tzinfo=UTC)


def lines(
    axis: str,
    values: Any,
    quantity: str = "backlash_um",
    *,
    source: str = "verify",
    kind: str = "verify",
    std: float = 0.1,
) -> list[dict[str, Any]]:
    return [
        {
            "campaign": f"{axis}/{source}-{week}",
            "axis": axis,
            "kind": kind,
            "source": source,
            "begun": BEGUN + timedelta(weeks=week),
            "quantity": quantity,
            "value": float(value),
            "std": std,
            "of": 5,
            "temp_c": None,
        }
        for week, value in enumerate(values)
    ]


def test_like_is_compared_with_like() -> None:
    """Numbered files of torque are one series; of passes the most frequent name; the order is that of time."""
    rows = lines("X", [1.0] * 4) + lines("X", [9.0] * 3, source="uncorrected", kind="calibrate")
    rows += [
        one | {"source": f"backlash-{k}.jsonl"}
        for k, one in enumerate(lines("X", [5.0] * 6, "torque_lost_motion_um", kind="backlash"))
    ]
    backlash, torque = series_of(reversed(rows), ("backlash_um", "torque_lost_motion_um"))
    assert (backlash.what, len(backlash)) == ("verify/verify", 4)
    assert list(backlash.begun) == sorted(backlash.begun)
    assert (torque.what, len(torque)) == ("backlash", 6)
    (later,) = series_of(rows, ("backlash_um",), BEGUN + timedelta(weeks=2))
    assert len(later) == 2
    with pytest.raises(InputError, match="wear_um"):
        series_of(rows, ("wear_um",))


def test_the_rate_is_of_the_whole_fleet() -> None:
    rng = np.random.default_rng(1)
    rows = [row for k in range(40) for row in lines(f"A{k}", rng.normal(10.0, 0.2, 52))]
    found = trends(series_of(rows, ("backlash_um",)))
    assert found.looks_per_year == pytest.approx(40 * 52, rel=0.03)
    assert arl(found.threshold, clip=CLIP) == pytest.approx(found.looks_per_year / FALSE_PER_YEAR, rel=0.01)
    assert not found.remembers
    half = trends(series_of(rows, ("backlash_um",)), FALSE_PER_YEAR / 2.0)
    assert half.run_length == pytest.approx(2.0 * found.run_length)
    assert half.threshold > found.threshold
    either = [row | {"quantity": "friction_torque_percent"} for row in rows]
    assert looks_per_year(series_of(either, ("friction_torque_percent",))) == pytest.approx(2 * 40 * 52, rel=0.03)
    for rate in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError):
            trends([], rate)
    assert "0.5 false alarms a year" in found.stated()
    assert trends([]).stated().startswith("nothing is watched")


def test_the_worn_axis_is_first_and_no_other_alarms() -> None:
    rng = np.random.default_rng(2)
    weeks = np.arange(80)
    rows = [row for k in range(30) for row in lines(f"A{k:02d}", rng.normal(10.0, 0.2, 80))]
    rows += lines("worn", 10.0 * 1.01 ** np.maximum(0, weeks - 50) + rng.normal(0.0, 0.2, 80))
    rows += lines("better", 10.0 - 2.0 * (weeks > 40) + rng.normal(0.0, 0.2, 80))
    rows += lines("new", [3.0, 90.0])
    found = trends(series_of(rows, ("backlash_um",)))
    assert found.aged[0].series.axis == "worn"
    assert len(found.alarms) <= 4  # one in two years is allowed
    found = trends(series_of(rows, ("backlash_um",)), 0.02)
    assert [one.series.axis for one in found.alarms] == ["worn"]
    worn = found.aged[0]
    assert worn.growth is not None
    assert worn.growth.slope_um == pytest.approx(30.0 / 7.0 * 0.116, rel=0.15)  # 1 % a week of 10 to 13.3 µm
    assert [one.axis for one in found.short] == ["new"]
    form = trend_json(found)
    assert form["series"][0]["alarms"][0]["direction"] == 1
    assert datetime.fromisoformat(form["series"][0]["alarms"][0]["began"]) >= BEGUN + timedelta(weeks=48)
    better = next(one for one in found.aged if one.series.axis == "better")
    assert better.watched.begun in range(38, 44)
    assert better.level == pytest.approx(8.0, abs=0.3)
    assert all(len(trend_row(one)) == len(trend_row(worn)) for one in found.aged)


def test_a_season_is_told() -> None:
    rng = np.random.default_rng(3)
    season = 0.5 * np.sin(2.0 * np.pi * np.arange(104) / 52.0)
    rows = [row for k in range(10) for row in lines(f"A{k}", 10.0 + season + rng.normal(0.0, 0.2, 104))]
    assert trends(series_of(rows, ("backlash_um",))).remembers


def test_an_axis_unlike_the_others() -> None:
    rng = np.random.default_rng(4)
    rows = [row for k in range(20) for row in lines(f"A{k}", 10.0 + rng.normal() + rng.normal(0.0, 0.1, 6))]
    rows += lines("odd", [25.0] * 6) + lines("good", [1.0] * 6)
    (found,) = compare(series_of(rows, ("backlash_um",)))
    assert [one.series.axis for one in found.axes if one.unlike] == ["odd"]  # less backlash is nothing to look at
    friction = [row | {"quantity": "friction_torque_percent"} for row in rows]
    (found,) = compare(series_of(friction, ("friction_torque_percent",)))
    assert {one.series.axis for one in found.axes if one.unlike} == {"odd", "good"}
    (few,) = compare(series_of(rows[-12:], ("backlash_um",)))
    assert not any(one.unlike for one in few.axes)
    assert compare([]) == []


@pytest.mark.parametrize("axes", [FEWEST_AXES, 30])
def test_like_axes_are_seldom_called_unlike(axes: int) -> None:
    rng = np.random.default_rng(5)
    called = 0
    for _ in range(200):
        rows = [row for k in range(axes) for row in lines(f"A{k}", [10.0 + rng.normal()])]
        (found,) = compare(series_of(rows, ("backlash_um",)))
        called += any(one.unlike for one in found.axes)
    assert called / 200 <= 2.0 * FALSE_PER_LOOK
