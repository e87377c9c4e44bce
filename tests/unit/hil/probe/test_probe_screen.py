"""What is drawn of a run-out, made of what was measured and kept."""

from __future__ import annotations

import cmath
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from math import radians
from pathlib import Path

import pytest
from support import probe_files

from hil.desk.plan import Move, Plan
from hil.probe.job import centring_plan, codes, correction_plan, feature_plan, measuring_plan
from hil.probe.machine_file import BossConfig, ProbeMachineConfig, load_probe_machine
from hil.probe.page_data import HistoryEntry, ball_positions, history_curves, history_entries, std_um, worst_closure_um
from hil.probe.procedure import RunOutMeasurement
from hil.probe.runout import CorrectionCode, FourFeeds, RunOut, mean_feeds, run_out
from hil.probe.store import RunOutStore

BALL_UM = 30.0 - 40.0j
WHEN = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)


@pytest.fixture
def config(tmp_path: Path) -> ProbeMachineConfig:
    return load_probe_machine(probe_files.lay_out(tmp_path))


def measured(facing: int, *off_um: float) -> RunOutMeasurement:
    """Two turns of the ball by 90° each time, contact where its rim is 2 mm further towards the face; off_um: of the first turn."""
    feeds = [2.0 - facing * (BALL_UM * 1j**quarter).real / 1000.0 for quarter in range(4)]
    first = [feed + off / 1000.0 for feed, off in zip(feeds, off_um or (0.0,) * 4, strict=True)]
    turns = FourFeeds(*first), FourFeeds(*feeds)
    return RunOutMeasurement(turns, run_out(mean_feeds(turns), 4.0, facing=facing), "latch", 1.0)


@pytest.mark.parametrize("facing", [1, -1])
def test_the_contacts_lie_where_the_ball_was(config: ProbeMachineConfig, facing: int) -> None:
    config = replace(config, block=replace(config.block, face_mm=config.block.start_mm + 4.0 * facing))
    shown = ball_positions(config, measured(facing))
    places = {angle: cmath.rect(far, radians(bearing)) for angle, (far, bearing) in shown.at.items()}
    assert places == pytest.approx({0: BALL_UM, 90: BALL_UM * 1j, 180: -BALL_UM, 270: BALL_UM * -1j})
    assert cmath.rect(shown.run_out[0], radians(shown.run_out[1])) == pytest.approx(BALL_UM)


def test_a_chip_shows_as_contacts_off_the_circle_and_in_the_figures(config: ProbeMachineConfig) -> None:
    clean, chip = measured(1), measured(1, -20.0, 0.0, 0.0, 0.0)
    distances = [far for far, _ in ball_positions(config, chip).at.values()]
    assert max(distances) - min(distances) > 5.0
    assert worst_closure_um(chip) == pytest.approx(-20.0)
    assert (std_um(config, clean) or 0.0) < 0.01  # that of a position
    # pooled over four angles 2 · 10² / 4, half of it for two turns, half of that for half a difference of two means
    assert std_um(config, chip) == pytest.approx(12.5**0.5, rel=1e-3)
    assert std_um(config, replace(clean, mode="step")) == pytest.approx(1.0 / 24.0**0.5, rel=1e-3)


# -- history -----------------------------------------------------------------------------------------------------------------
def test_the_history_as_it_is_kept_and_drawn(tmp_path: Path) -> None:
    store = RunOutStore(tmp_path / "store", "mill")
    found, turn = RunOut(0.03, -0.04, 2.0), FourFeeds(2.0, 2.0, 2.0, 2.0)
    worse = replace(turn, n_0_mm=1.99)
    store.append(WHEN, "latch", (turn, worse), found, "stored")
    store.append(WHEN + timedelta(hours=5), "step", (worse,), found, "refused: the contacts do not close: N0")
    verdict = "broken off: StoppedByOperator: stopped by the operator"
    store.append(WHEN + timedelta(hours=6), "latch", (turn,), found, verdict)
    shown = history_entries(store.history())
    assert shown[0] == HistoryEntry(WHEN, "latch", 30.0, -40.0, 2.0, -10.0, "stored", "")
    assert [(one.verdict, one.why) for one in shown[1:]] == [
        ("refused", "the contacts do not close: N0"),
        ("broken off", "stopped by the operator"),
    ]
    drawn = history_curves(shown)
    assert drawn is not None
    assert (drawn.begun, drawn.unit, drawn.x, drawn.y) == (WHEN, "hours", [(0.0, 30.0)], [(0.0, -40.0)])
    assert drawn.left_out == [(5.0, 30.0), (5.0, -40.0), (6.0, 30.0), (6.0, -40.0)]
    assert history_curves([]) is None


# -- what is asked before ------------------------------------------------------------------------------------------------------
def moves(plan: Plan) -> set[Move]:
    return set(plan.moves)


def test_plans_say_what_moves_how_far(config: ProbeMachineConfig) -> None:
    store = RunOutStore(config.store.directory, config.name)
    plan = measuring_plan(config, store, "latch")
    assert moves(plan) == {
        Move("place Y", 40.0, 40.0, 10.0, "goes"),
        Move("place X", 101.0, 101.0, 10.0, "goes"),
        Move("touch X", 101.0, 104.0, 2.0),
        Move("spindle S", 0.0, 270.0, 180.0, "turns"),
    }
    assert (plan.axis, plan.positions, plan.overtravel_mm, plan.locked) == ("X, Y, S", 8, 1.0, False)
    assert [write.place for write in plan.writes] == [str(store.path), str(store.history_path)]
    assert Move("step X", 101.0, 104.0, 2.0) in moves(measuring_plan(config, store, "step"))

    known = RunOut(0.03, -0.04, 2.0)
    x, y = Move("correct X", -0.05, 0.05, 10.0, "drives"), Move("correct Y", -0.05, 0.05, 10.0, "drives")
    assert moves(correction_plan(config, known, CorrectionCode.M91)) == {x}
    assert moves(correction_plan(config, known, CorrectionCode.M92)) == {y}
    assert moves(centring_plan(config, known, CorrectionCode.M93, "latch")) == {
        Move("place X", 50.0, 50.0, 10.0, "goes"),
        Move("place Y", 60.0, 60.0, 10.0, "goes"),
        Move("bore_touch X", 42.0, 58.0, 2.0),
        Move("bore_touch Y", 52.0, 68.0, 2.0),
        x,
        y,
    }
    boss = replace(config, features={"boss": BossConfig(80.0, 81.0, 9.0, 1.5)})
    assert moves(feature_plan(boss, "boss", "step")) == {
        Move("between X", 71.0, 89.0, 10.0),
        Move("between Y", 72.0, 90.0, 10.0),
        Move("other_step X", 71.0, 72.5, 2.0),
        Move("other_step X", 87.5, 89.0, 2.0),
        Move("other_step Y", 72.0, 73.5, 2.0),
        Move("other_step Y", 88.5, 90.0, 2.0),
    }
    assert codes(config) == tuple(CorrectionCode)
    assert codes(replace(config, y=None)) == (CorrectionCode.M91,)
