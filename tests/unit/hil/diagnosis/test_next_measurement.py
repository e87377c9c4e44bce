"""Which measurement tells causes apart: the discrimination by hand, plain motion against the engine's history, one whole choice."""

from __future__ import annotations

import numpy as np
import pytest

from hil.correction.compensation import MotionHistory
from hil.diagnosis.joining import joined, segments
from hil.diagnosis.next.causes import weigh
from hil.diagnosis.next.continuation import TYPICAL_OFFSET, Continuation
from hil.diagnosis.next.feasible import feasible_runs
from hil.diagnosis.next.next_measurement import least_told, outlook
from hil.diagnosis.next.planned_run import Means, PlannedPoint, motion_columns
from hil.effects import ALL
from hil.effects.model import Model, PitchTable
from hil.records.rows import Records

NOISE_UM = 0.5
FLAT = Model(PitchTable((0.0, 200.0), (0.0, 0.0), (0.0, 0.0), (), ()))


def one_feed(rows_each_way: int = 32) -> Records:
    """A gap of ±2 µm between the directions, captured in motion at one feed."""
    rng = np.random.default_rng(3)
    direction = np.tile([1.0, -1.0], rows_each_way)
    target = rng.uniform(0.0, 200.0, len(direction)).round(3)
    error = 2.0 * direction + NOISE_UM * rng.normal(size=len(direction))
    return Records.of(
        {
            "run": np.repeat([1.0, 2.0], rows_each_way),
            "direction": direction,
            "target_mm": target,
            "measured_mm": target + error / 1e3,
            "time_s": 5.0 * np.arange(len(direction)),
            "velocity_mm_s": np.full(len(direction), 40.0),
        }
    )


def test_discrimination_is_what_a_refit_by_hand_leaves() -> None:
    records, means = one_feed(), Means(0.0, 200.0, feeds_mm_s=(40.0, 10.0, 20.0))
    causes = [cause for cause in weigh(records, FLAT, ALL) if cause.id in ("backlash", "velocity_lag")]
    feeds = next(plan for plan in feasible_runs(means, first_run=3) if plan.name == "feeds")
    drawing = Continuation(records, FLAT, causes, means)
    first, second = [cause.id for cause in causes].index("backlash"), [c.id for c in causes].index("velocity_lag")
    plan = motion_columns(feeds.points, means)
    direction = np.concatenate([records.direction, plan["direction"]])
    speed = np.concatenate([records["velocity_mm_s"], plan["velocity_mm_s"]])
    run_number = np.concatenate([records.run, plan["run"]])
    amount = drawing.so_far[first][0] * records.direction[0]
    offsets = (run_number[:, None] == np.unique(run_number)) * TYPICAL_OFFSET
    covariance = np.eye(len(direction)) + offsets @ offsets.T
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    others = root @ np.column_stack([direction * speed, np.ones(len(direction))])
    wanted = root @ (amount * direction)
    left = wanted - others @ np.linalg.lstsq(others, wanted, rcond=None)[0]
    by_hand = float(left @ left) / drawing.noise_um**2
    # the declared table may move a little too, so that a rival can follow a little farther than by hand
    assert 0.6 * by_hand < drawing.discrimination(feeds)[first, second] <= 1.01 * by_hand
    assert drawing.noise_um == pytest.approx(NOISE_UM, rel=0.2)
    repeat = next(plan for plan in feasible_runs(means, first_run=3) if plan.name == "repeat")
    assert drawing.discrimination(repeat)[first, second] < 1.0, "at one feed nothing sets them apart"


def standing_still(error_um: np.ndarray, target_mm: np.ndarray, direction: np.ndarray) -> Records:
    """Five runs there and back, 6 s a row, without any sensor."""
    return Records.of(
        {
            "run": np.repeat(np.arange(1.0, 6.0), len(target_mm) // 5),
            "direction": direction,
            "target_mm": target_mm,
            "measured_mm": target_mm + error_um / 1e3,
            "time_s": 6.0 * np.arange(len(target_mm)),
        }
    )


def there_and_back() -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Targets, directions, and the numbers of the noise."""
    there = np.linspace(5.0, 195.0, 13)
    return np.tile([*there, *there[::-1]], 5), np.tile(np.repeat([1.0, -1.0], 13), 5), np.random.default_rng(4)


def test_a_bow_of_the_place_may_be_a_tilt_that_nobody_read() -> None:
    """An arm of 200 mm makes 0.2 µm of a µrad: the course of the angle has the size of what it makes."""
    target, direction, rng = there_and_back()
    bow_um = 2.0 * np.cos(3.0 * (target - 100.0) / 100.0) + 0.4 * rng.normal(size=len(target))
    weights = {cause.id: cause.weight for cause in weigh(standing_still(bow_um, target, direction), FLAT, ALL)}
    assert weights["abbe"] > 0.2
    assert weights["pitch_shape"] > 0.015, "even odds that the angle changed, and the smaller shape"


def test_an_offset_that_wanders_is_no_backlash_with_an_unread_temperature() -> None:
    """Any course of an unread sensor explains an offset; what it makes of the reversal has the sign of the direction."""
    target, direction, rng = there_and_back()
    wander_um = np.cumsum(rng.normal(size=len(target))) * 0.3 + 0.1 * rng.normal(size=len(target))
    weights = {cause.id: cause.weight for cause in weigh(standing_still(wander_um, target, direction), FLAT, ALL)}
    assert min(weights[name] for name in ("thermal_drift", "dead_path", "beam_drift")) > 0.1
    assert weights["backlash"] < 0.01


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_in_eight_minutes_no_shop_goes_as_far_as_in_six_hours(seed: int) -> None:
    """Growth by 1.5 K in six hours, of the screw or of air that nobody logged: the run once more hardly tells, air sensors do."""
    rng = np.random.default_rng(seed)
    there = np.linspace(0.0, 1000.0, 20)
    target = np.tile(np.concatenate([there, there[::-1]]), 6)
    time_s = 90.0 * np.arange(len(target))
    rise_k = 1.5 * np.sin(np.pi * time_s / time_s[-1])
    error_um = 0.93e-3 * rise_k * target + 0.3 * rng.normal(size=len(target))
    records = Records.of(
        {
            "run": np.repeat(np.arange(1.0, 7.0), 40),
            "direction": np.tile(np.repeat([1.0, -1.0], 20), 6),
            "target_mm": target,
            "measured_mm": target + error_um / 1e3,
            "time_s": time_s,
            "temp_screw_c": 20.0 + rise_k + 0.01 * rng.normal(size=len(target)),
        }
    )
    flat = Model(PitchTable((0.0, 1000.0), (0.0, 0.0), (0.0, 0.0), (), ()))
    look = outlook(records, flat, Means(0.0, 1000.0, sensors=frozenset({"temp_screw_c"})))
    assert {cause.id for cause in look.rivals} == {"air_index", "thermal_expansion"}
    told = {one.run.name: one.tells("air_index", "thermal_expansion") for one in look.prospects}
    assert max(told["repeat"], told["shifted"], told["fine"]) < 0.5 * least_told()
    best = look.best_for("air_index", "thermal_expansion")
    assert best is not None
    assert best.run.name == "air"


def test_what_was_never_varied_stays_a_rival_and_what_was_does_not() -> None:
    records = one_feed()
    names = {cause.id for cause in weigh(records, FLAT, ALL) if cause.weight > 0.05}
    assert names - {"backlash_position"} == {"backlash", "velocity_lag", "load_deflection"}
    varied = records.with_column("load_kg", np.tile([20.0, 20.0, 90.0, 90.0], len(records) // 4))
    assert "load_deflection" not in {cause.id for cause in weigh(varied, FLAT, ALL) if cause.weight > 0.05}


def test_motion_is_the_engines() -> None:
    """Travel since the turn and the stroke before it, against the history that the engine keeps while it moves."""
    rng = np.random.default_rng(8)
    means = Means(0.0, 300.0, overrun_mm=2.0)
    points = [
        PlannedPoint(1, int(d), float(x), float(o))
        for d, x, o in zip(
            rng.choice([1, -1], 60), rng.uniform(20, 280, 60).round(3), rng.uniform(0.5, 15, 60), strict=True
        )
    ]
    columns = motion_columns(points, means)
    history = MotionHistory(-2.0).moved_to(0.0)
    for row, point in enumerate(points):
        travel = (point.target_mm - history.position_mm) * point.direction
        if not travel > 0 or history.direction != point.direction:
            history = history.moved_to(point.target_mm - point.direction * point.overrun_mm)
        history = history.moved_to(point.target_mm)
        assert columns["since_reversal_mm"][row] == pytest.approx(history.since_reversal_mm)
        if row > 3:
            assert columns["stroke_mm"][row] == pytest.approx(history.stroke_or_long_mm)
    assert np.all(np.diff(columns["time_s"]) > means.reading_s)


def test_every_feasible_run_stays_inside_the_travel_and_says_who_must_act() -> None:
    means = Means(
        10.0, 490.0, overrun_mm=1.5, levels={"load_kg": (0.0, 80.0)}, feeds_mm_s=(20.0, 40.0), pitches_mm=(10.0,)
    )
    runs = feasible_runs(means)
    for plan in runs:
        for point in plan.points:
            assert 10.0 <= point.target_mm <= 490.0
            assert 8.5 - 1e-6 <= point.target_mm - point.direction * point.overrun_mm <= 491.5 + 1e-6
        assert plan.minutes > 1.0
        assert f"{len(plan.points)} rows" in plan.describe()
    needs = {plan.name for plan in runs if plan.person}
    assert needs == {"levels of load_kg", "thermometers", "air", "thermometers and air", "second offset", "realigned"}
    alone = Means(10.0, 490.0, levels={"load_kg": (0.0, 80.0)}, by_itself=frozenset({"load_kg"}), mountable=frozenset())
    assert not [plan for plan in feasible_runs(alone) if plan.person]


def test_campaigns_join_with_what_was_set_and_without_what_was_not_read() -> None:
    old = one_feed()
    new = old.with_column("load_kg", np.full(len(old), 30.0)).with_column("temp_screw_c", np.full(len(old), 21.0))
    both = joined([old, new])
    assert np.all(both["load_kg"] == 30.0), "before it was written down it stood as it stood first"
    assert np.all(np.isnan(both["temp_screw_c"][: len(old)]))
    first, second = segments(both)
    assert "temp_screw_c" not in first
    assert len(first) == len(second) == len(old)


def test_a_cause_that_only_earlier_rows_show_is_drawn_by_what_the_last_rows_have() -> None:
    """A level nobody read, in rows without sensors; then rows with a thermometer, and fewer of them."""
    old = one_feed()
    short = one_feed(10)
    new = short.with_column("temp_screw_c", 20.0 + 0.01 * np.arange(len(short)))
    causes = [cause for cause in weigh(old, FLAT, ALL) if cause.weight > 0.01]
    assert any(cause.unseen is not None for cause in causes)
    drawing = Continuation(joined([old, new]), FLAT, causes, Means(0.0, 200.0, feeds_mm_s=(40.0, 10.0, 20.0)))
    assert [len(so_far) for so_far in drawing.so_far] == [len(new)] * len(causes)
    runs = feasible_runs(Means(0.0, 200.0, feeds_mm_s=(40.0, 10.0, 20.0)), first_run=5)
    assert all(np.all(np.isfinite(drawing.discrimination(run))) for run in runs[:3])


@pytest.mark.parametrize("travel_mm", [0.1, 316e-6])
def test_a_short_travel_is_measured_too_at_as_many_places(travel_mm: float) -> None:
    """A piezo's travel of 0.1 mm, half a wavelength: targets of whole µm would be a hundred places, or one."""
    for short, long in zip(feasible_runs(Means(0.0, travel_mm)), feasible_runs(Means(0.0, 400.0)), strict=True):
        places = [{point.target_mm for point in run.points} for run in (short, long)]
        assert all(-0.01 * travel_mm <= place <= 1.01 * travel_mm for place in places[0])
        assert len(places[0]) >= 0.9 * min(len(places[1]), 60), short.name
