"""Designed campaigns, and what a measured one can never show."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import InputError
from hil.diagnosis.campaign import prepare
from hil.diagnosis.next.check_campaign import CampaignCheck, check_campaign, repeats_of
from hil.diagnosis.next.design import design, plan_minutes
from hil.diagnosis.next.planned_run import Means, motion_columns
from hil.records.rows import Records

MEANS = Means(10.0, 490.0, feed_mm_s=50.0, reading_s=2.0, levels={"load_kg": (0.0, 60.0, 120.0)}, pitches_mm=(10.0,))


def measured(columns: dict[str, np.ndarray]) -> Records:
    """Records of a machine without any error: what a campaign can show does not depend on what was read."""
    kept = {name: values for name, values in columns.items() if name != "strokes_s"}
    return Records.of({**kept, "measured_mm": kept["target_mm"]})


def standard(spacing_mm: float, runs: int = 5, targets: int = 12) -> dict[str, np.ndarray]:
    """The same targets there and back, run after run."""
    way = 20.0 + spacing_mm * np.arange(targets)
    once = np.concatenate([way, way[::-1]])
    return {
        "run": np.repeat(np.arange(1.0, runs + 1), len(once)),
        "direction": np.tile(np.repeat([1.0, -1.0], targets), runs),
        "target_mm": np.tile(once, runs),
        "time_s": 6.0 * np.arange(runs * len(once)),
    }


def gaps(check: CampaignCheck, kind: str) -> list[tuple[str, ...]]:
    return [gap.effects for gap in check.gaps if gap.kind == kind]


@pytest.mark.parametrize("minutes", [45.0, 90.0])
def test_a_design_keeps_to_its_minutes_and_to_the_travel(minutes: float) -> None:
    points = design(MEANS, minutes)
    assert 0.5 * minutes < plan_minutes(points, MEANS) <= minutes
    assert all(
        10.0 <= p.target_mm <= 490.0 and 9.0 <= p.target_mm - p.direction * p.overrun_mm <= 491.0 for p in points
    )
    assert min(abs(p.target_mm / 10.0 - round(p.target_mm / 10.0)) for p in points) > 0.01, "off the pitch"


def test_a_design_confounds_nothing_and_repeats_some() -> None:
    columns = motion_columns(design(MEANS, 70.0), MEANS)
    time, x, d, load = (columns[name] for name in ("time_s", "target_mm", "direction", "load_kg"))
    names = (x, d, load, columns["since_reversal_mm"])
    assert max(abs(np.corrcoef(time, values)[0, 1]) for values in names) < 0.35
    check = check_campaign(measured(columns), (10.0,))
    assert check.repeats >= 12
    assert not [gap for gap in check.gaps if gap.kind in ("repeats", "pitch", "order")]
    assert {"cyclic", "lost_motion", "load_deflection", "thermal_drift", "datum_step"} <= set(check.visible)


def test_too_few_minutes_are_refused_with_what_it_takes() -> None:
    with pytest.raises(InputError, match=r"5 min are too short .* expected at least \d+"):
        design(MEANS, 5.0)


@pytest.mark.parametrize("minutes", [25.0, 26.0, 33.0, 47.0, 61.0])
def test_a_design_keeps_its_word(minutes: float) -> None:
    planned = plan_minutes(design(MEANS, minutes), MEANS)
    assert 0.85 * minutes <= planned <= minutes


def test_the_time_named_for_the_smallest_is_enough() -> None:
    with pytest.raises(InputError) as refused:
        design(MEANS, 1.0)
    least = float(str(refused.value).split("at least ")[1].split(" min")[0])
    assert plan_minutes(design(MEANS, least), MEANS) <= least
    with pytest.raises(InputError):
        design(MEANS, least - 0.2)


def test_targets_in_step_with_the_pitch_and_effects_in_the_table_are_named() -> None:
    check = check_campaign(measured(standard(40.0)), (10.0,))
    pitch = [gap for gap in check.gaps if gap.kind == "pitch"]
    assert [gap.what.split(" mm")[0].split()[-1] for gap in pitch] == ["5", "10"]
    assert {"cyclic", "backlash", "pitch_shape", "cosine", "lost_motion"} <= set(gaps(check, "blind")[0])
    assert ("load_deflection",) in gaps(check, "missing")
    assert ("velocity_lag",) in gaps(check, "missing")
    off = check_campaign(measured(standard(38.7)), (10.0,))
    assert not gaps(off, "pitch")


def test_columns_that_go_together_are_named_together() -> None:
    columns = standard(38.7)
    rng = np.random.default_rng(1)
    load = rng.choice([0.0, 50.0, 100.0], len(columns["run"]))
    together = {**columns, "load_kg": load, "pos_y_mm": 3.0 * load + 5.0}
    assert ("load_deflection", "cross_axis") in gaps(check_campaign(measured(together)), "alike")
    apart = {**columns, "load_kg": load, "pos_y_mm": rng.choice([-100.0, 100.0], len(load))}
    assert ("load_deflection", "cross_axis") not in gaps(check_campaign(measured(apart)), "alike")


def test_one_run_one_way_has_no_repeats_and_position_stands_for_time() -> None:
    columns = {name: values[:12] for name, values in standard(38.7, targets=12).items()}
    check = check_campaign(measured(columns))
    rows = prepare(measured(columns))
    assert check.repeats == repeats_of(rows.x, rows.d) == 0
    assert gaps(check, "repeats")
    assert gaps(check, "order")
