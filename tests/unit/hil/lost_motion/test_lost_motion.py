"""What the strokes of a measurement are, what is read from them, and what they put into force; the machine is arithmetic here."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from support.wind_up import WindUp, moved_to

from drivers.errors import InputError
from drivers.limits import DriveLimits
from hil.axis.axis_file import AxisConfig
from hil.axis.lost_motion import LostMotionConfig, default_lost_motion
from hil.correction.compensation import Compensation
from hil.correction.rise import EXPONENTIAL, TWO_TANH, Rise
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.effects import ALL, term_from_json
from hil.lost_motion.estimate import ReversalFit, Uncertain
from hil.lost_motion.fit import Contender, Fitted
from hil.lost_motion.measured import ReversalResult
from hil.lost_motion.procedure import (
    LostMotionProof,
    LostMotionResult,
    confirmed,
    left_by_um,
    proof_steps,
    residual_um,
    reversals_of,
    stretch_of,
    stroke_steps,
    verdict,
    with_rise,
)
from hil.machine.measure import Step
from hil.records.rows import Floats, Records
from hil.ui.screen.texts import Texts

LIMITS = DriveLimits(-2.0, 502.0, 100.0, 500.0)
HOW = LostMotionConfig(
    at_mm=100.0, stroke_mm=4.0, places=12, finest_um=2.0, runs=2, proof_moves=30, shortest_rise_um=0.25
)
TRUTH = Rise(TWO_TANH, (6.0, 2.0), (0.01, 0.2, 0.05))
FOUND = ReversalFit(TRUTH, {"amount_um": Uncertain(8.0, 0.1)}, {}, (), (), 0.0)


def place_um(x: Floats | float) -> Floats:
    return np.asarray(3.0 * np.sin(np.asarray(x)) + 0.7 * (np.asarray(x) - 100.0))


def driven(steps: list[Step], correction_um: Floats | None = None, truth: Rise = TRUTH) -> Records:
    """The machine: what belongs to the place, and a wind-up that follows the *targets* (it is asked about its bookkeeping only)."""
    state, rows = WindUp(HOW.high_mm, 1), []
    state, _ = moved_to(truth, state, steps[0].target_mm - 9.0 * steps[0].direction)
    for number, step in enumerate(steps):
        state, wound_um = moved_to(truth, state, step.target_mm)
        error_um = float(place_um(step.target_mm)) + truth.amount_um / 2.0 - wound_um
        error_um += 0.0 if correction_um is None else float(correction_um[number])
        rows.append((step.run, step.direction, step.target_mm, step.target_mm + error_um / 1000.0))
    columns = np.array(rows, dtype=np.float64).T
    return Records.of(dict(zip(("run", "direction", "target_mm", "measured_mm"), columns, strict=True)))


def test_strokes_go_to_and_fro_without_a_step_aside() -> None:
    steps = stroke_steps(HOW)
    assert len(steps) == 5 * 25  # 12 places at each end and the turning itself, five strokes
    for before, after in pairwise(steps):
        assert (after.target_mm - before.target_mm) * after.direction > 0.0
        assert after.overrun_mm == 0.0
    assert [step.run for step in steps] == sorted(step.run for step in steps)
    assert {step.run for step in steps} == {1, 2, 3, 4, 5}


def test_proof_moves_are_of_all_lengths_repeatable_and_inside() -> None:
    steps = proof_steps(HOW, 1)
    assert proof_steps(HOW, 1) == steps != proof_steps(HOW, 2)
    travels = [abs(b.target_mm - a.target_mm) for a, b in pairwise(steps)]
    assert len(travels) == HOW.proof_moves
    assert min(travels) < 0.05
    assert max(travels) > 1.0
    assert all(HOW.low_mm <= step.target_mm <= HOW.high_mm for step in steps)
    for before, after in pairwise(steps):
        assert (after.target_mm - before.target_mm) * after.direction > 0.0


def test_a_reversal_is_what_its_places_show_beyond_their_own_error() -> None:
    records = driven(stroke_steps(HOW))
    reversals = reversals_of(records, HOW)
    assert [one.direction for one in reversals] == [1, -1, 1, -1]
    for one in reversals:
        travel, risen = one.rise
        assert travel.tolist() == pytest.approx([0.0, *HOW.travels_mm])
        assert risen == pytest.approx(TRUTH.along_um(travel), abs=1e-4)
    stretch = stretch_of(records, HOW, TRUTH.amount_um)
    assert stretch.noise_um < 1e-4
    assert stretch.error_um == pytest.approx(place_um(stretch.position_mm), abs=1e-4)


def test_what_is_left_is_told_apart_from_the_place_and_the_tables() -> None:
    stretch = stretch_of(driven(stroke_steps(HOW)), HOW, TRUTH.amount_um)
    steps = proof_steps(HOW, 1)
    before = driven(steps)
    left = residual_um(before, stretch, None)
    assert np.ptp(left) == pytest.approx(TRUTH.amount_um, abs=0.5)
    nodes = np.array([90.0, 110.0])
    tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(nodes, np.array([5.0, 7.0]), np.array([-3.0, -1.0])))
    by_tables = np.array([float(tables.correction_um([s.target_mm], s.direction)[0]) for s in steps])
    with_tables = residual_um(driven(steps, by_tables), stretch, Compensation(tables))
    direction = np.array([step.direction for step in steps])
    assert with_tables == pytest.approx(left + 4.0 * direction, abs=1e-3)  # switched at once: half of 8 either way


@pytest.mark.parametrize("truth", [TRUTH, Rise(EXPONENTIAL, (8.0,), (0.08,))], ids=lambda rise: rise.shape.name)
def test_another_shape_stays_only_where_it_would_have_left_less_of_the_moves_before(truth: Rise) -> None:
    """The moves are those without the correction; what stands in them for the tables in force is taken out again."""
    other = Rise(EXPONENTIAL, (8.0,), (0.08,))
    contenders = tuple(Contender(Fitted(rise), 0.1, 0.1) for rise in (other, TRUTH))
    strokes = driven(stroke_steps(HOW), truth=truth)
    found = ReversalFit(other, {}, {}, contenders, tuple(reversals_of(strokes, HOW)), 0.0)
    stretch = stretch_of(strokes, HOW, 8.0)
    moves = driven(proof_steps(HOW, 1), truth=truth)
    assert left_by_um(truth, moves, stretch) == pytest.approx(0.0, abs=1e-4)
    assert confirmed(found, moves, stretch).rise == truth
    assert confirmed(replace(found, asked_for=True), moves, stretch).rise == other


def test_without_tables_the_lost_motion_alone_is_put_into_force() -> None:
    alone = with_rise(None, FOUND, HOW, (LIMITS.travel_min_mm, LIMITS.travel_max_mm))
    at = np.array([100.0])
    assert float(alone.tables.correction_um(at, 1)[0]) == 0.0
    assert float(alone.tables.correction_um(at, -1)[0]) == pytest.approx(-8.0)
    assert alone.rise is TRUTH
    worn = replace(FOUND, rise=Rise(TWO_TANH, (9.0, 3.0), (0.01, 0.2, 0.05)))
    anew = with_rise(alone, worn, HOW, (LIMITS.travel_min_mm, LIMITS.travel_max_mm))
    assert float(anew.tables.correction_um(at, -1)[0]) == pytest.approx(-12.0)  # measured again, not held to what was


def test_beside_tables_nothing_is_counted_twice() -> None:
    nodes = np.array([0.0, 500.0])
    tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(nodes, np.full(2, 6.0), np.full(2, -2.2)))
    form = {"effect": "lost_motion", "form": "tanh", "inputs": ["since_reversal_mm", "direction"]}
    zero = [[0.0, 0.0], [0.0, 0.0]]
    term = term_from_json(
        {**form, "constants": {}, "nonlinear": {"length_mm": 0.3}, "coefficients": [4.0], "covariance": zero}, ALL, "t"
    )
    extended = with_rise(Compensation(tables, (term,)), FOUND, HOW, (0.0, 500.0))
    assert extended.tables is tables
    assert extended.terms == ()
    other = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(nodes, np.full(2, 20.0), np.full(2, -20.0)))
    with pytest.raises(InputError, match=r"hold a reversal of 40\.0 µm at 100 mm, measured now are 8\.0 µm"):
        with_rise(Compensation(other), FOUND, HOW, (0.0, 500.0))


def test_a_proof_needs_little_left_little_too_much_and_less_than_before() -> None:
    records = driven(proof_steps(HOW, 1))
    small, much = np.full(len(records), 0.3), np.full(len(records), 3.0)
    assert LostMotionProof(records, records, much, small, 8.0, 0.01).good
    too_far = np.where(records.direction > 0, 0.5, -0.5)
    assert not LostMotionProof(records, records, much, too_far, 8.0, 0.01).good
    assert LostMotionProof(records, records, much, -0.9 * too_far, 8.0, 0.01).over_um == 0.0
    assert not LostMotionProof(records, records, much, -0.9 * too_far, 8.0, 0.01).good  # never too far, and still off
    assert LostMotionProof(records, records, much, too_far, 8.0, 0.2).good  # no worse than noise


def test_the_gain_of_a_proof_by_hand() -> None:
    """Squares fall by 3, 0, 3 and 0 µm²: 1.5 in the mean, with s = √3 and √3/2 of the mean; the RMS add up to √2.5 + 1."""
    records = driven(proof_steps(HOW, 1))
    before, after = np.array([2.0, -1.0, -2.0, 1.0]), np.array([1.0, 1.0, -1.0, -1.0])
    gain = LostMotionProof(records, records, before, after, 8.0, 0.01).improvement_um
    assert gain.value == pytest.approx(math.sqrt(2.5) - 1.0)
    assert gain.std == pytest.approx(math.sqrt(3.0) / 2.0 / (math.sqrt(2.5) + 1.0))
    assert LostMotionProof(records, records, 0.0 * before, 0.0 * after, 8.0, 0.01).improvement_um == Uncertain(0.0, 0.0)


def test_what_is_no_better_than_before_is_not_stored_whatever_is_left() -> None:
    """The case that was stored: 0.25 µm before and 0.26 after, of 53 µm."""
    records = driven(proof_steps(HOW, 1))
    alike = np.random.default_rng(4).normal(0.0, 0.25, (2, len(records)))
    same = LostMotionProof(records, records, alike[0], 1.04 * alike[1], 53.0, 0.01)
    assert not same.improves
    assert not same.good
    assert same.needless  # 0.25 of 53 µm was good already
    alone = Compensation(TableSet.zero(np.array([0.0, 100.0])))
    result = replace(LostMotionResult(records, FOUND, None, alone, same), estimate=FOUND)  # type: ignore[arg-type]
    assert result.needless
    assert not result.good
    (said,) = verdict(result)
    assert re.fullmatch(
        r"no proven improvement, so nothing is stored: 0\.\d\d µm RMS before, 0\.\d\d after,"
        r" a gain of -?0\.\d{3} ± 0\.\d{3} µm \(k = 2\);"
        r" what is in force stays, nothing has to be done",
        said,
    )
    bad = LostMotionProof(records, records, 10.0 * alike[0], 10.0 * alike[1], 53.0, 0.01)
    assert not bad.needless  # no better, and nothing was good before
    (said,) = verdict(replace(result, proof=bad))
    assert said.endswith("look for what changes at the axis, then measure again with more runs and proof_moves")


def test_beside_fitted_effects_it_says_what_to_do_first() -> None:
    """After `hil close-loop`: what is stored was fitted together, and no other measurement helps before a new calibration."""
    form = {"effect": "velocity_lag", "form": "proportional", "inputs": ["velocity_mm_s", "direction"], "constants": {}}
    term = term_from_json({**form, "nonlinear": {}, "coefficients": [1.0], "covariance": [[0.0]]}, ALL, "t")
    beside = Compensation(TableSet.zero(np.array([0.0, 100.0])), (term,))
    records = driven(proof_steps(HOW, 1))
    noise = np.random.default_rng(4).normal(0.0, 1.0, len(records))
    better = LostMotionProof(records, records, 4.0 * noise, 3.0 * noise, 10.0, 0.01)
    same = LostMotionProof(records, records, 4.0 * noise, 4.0 * noise, 10.0, 0.01)
    assert (better.improves, better.good, same.improves) == (True, False, False)
    for proof in (better, same):
        (said,) = verdict(LostMotionResult(records, FOUND, None, beside, proof))  # type: ignore[arg-type]
        assert "what is stored also corrects velocity_lag" in said
        assert "first calibrate again (hil calibrate)" in said
        assert "measure again with more" not in said
        assert "hil calibrate" in (shown := Texts("de").said(said))
        assert shown != said


def test_an_axis_file_that_says_nothing_has_strokes_in_the_middle() -> None:
    how = default_lost_motion(Path("x.toml"), LIMITS, (20.0, 260.0))
    assert (how.low_mm, how.high_mm) == (137.0, 143.0)
    assert how.travels_mm[0] == 0.002
    assert how.travels_mm[-1] < 3.0
    with pytest.raises(InputError, match="leave the travel"):
        default_lost_motion(Path("x.toml"), replace(LIMITS, travel_max_mm=140.0), (20.0, 260.0))


# -- what is told --------------------------------------------------------------------------------------------------
RISE = Rise(TWO_TANH, (51.95, 1.14), (0.0021, 0.4, 0.2))
LENGTHS = {
    "rise_1_mm": Uncertain(0.0021, 0.00002),
    "rise_2_mm": Uncertain(0.4, 90.0),
    "onset_2_mm": Uncertain(0.2, 0.0),
}


def told(first: Uncertain, second: Uncertain) -> dict[str, str]:
    parameters = {"amount_um": Uncertain(53.09, 0.0032), "amount_1_um": first, "amount_2_um": second, **LENGTHS}
    found = ReversalFit(RISE, parameters, parameters, (), (), 0.0)
    proof = SimpleNamespace(before_um=np.ones(2), after_um=np.zeros(2), over_um=0.1, improvement_um=Uncertain(1.0, 0.0))
    result = SimpleNamespace(estimate=found, stretch=SimpleNamespace(noise_um=0.01), proof=proof)
    axis, how = cast(AxisConfig, None), cast(LostMotionConfig, None)
    return ReversalResult(axis, Path(), how, cast(LostMotionResult, cast(Any, result)), None).facts()


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (Uncertain(51.95, 1075.0), Uncertain(1.14, 1075.0)),  # share the whole in any way
        (Uncertain(51.95, 0.7), Uncertain(1.14, 0.7)),  # the second may not be there
        (Uncertain(53.09, 0.0032), Uncertain(1e-11, 0.0)),  # is not there
    ],
)
def test_amounts_that_are_not_determined_are_not_told(first: Uncertain, second: Uncertain) -> None:
    said = told(first, second)
    assert said["  amount um"] == "53.09 ± 0.0064 (k = 2)"
    assert said["  single amounts"] == "not determined one by one, only their sum"
    assert {name for name in said if name.startswith("  ")} == {"  amount um", "  single amounts", "  rise 1 mm"}


def test_amounts_that_are_determined_are_told() -> None:
    said = told(Uncertain(51.95, 0.1), Uncertain(1.14, 0.1))
    assert (said["  amount 1 um"], said["  amount 2 um"]) == ("51.95 ± 0.2 (k = 2)", "1.14 ± 0.2 (k = 2)")
    assert "  single amounts" not in said
