"""Designs that confuse causes, and what is asked for next: on machines drawn at random, and by the loop itself on the bench."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from study.next_study import cases, run, summary
from support import bench_axis

from hil.axis.axis_file import load_axis
from hil.calibration.calibrate import calibrate
from hil.calibration.explore import Exploration
from hil.diagnosis.loop.procedure import Turning, turn_loop
from hil.machine.bench_wiring import bench_parameters, running_bench
from hil.machine.wiring import connected
from hil.records.journal import Campaign


@pytest.mark.outside
def test_after_what_it_asks_for_it_is_right() -> None:
    """Two machines of each effect; `python tests/study/next_study.py --machines 340` is the whole study."""
    figures = summary([run(case) for case in cases(34)])
    assert figures["confused by the standard test"] >= 17
    assert figures["truth among those named"] >= 0.95
    assert figures["right at the end, of those confused"] >= 0.95
    assert figures["runs asked for, mean of those confused"] <= 2.0


@pytest.mark.outside
def test_the_loop_makes_the_run_that_tells_its_rivals_apart(tmp_path: Path) -> None:
    """A short exploration leaves drift by warmth and a wandering beam; warming up and cooling down is what the axis can do alone."""
    path = bench_axis.lay_out(tmp_path, machine="geometric", sections=9, runs=2)
    text = path.read_text().replace("last_mm = 260.0", "last_mm = 480.0")
    path.write_text(text.replace('backend = "bench"', 'backend = "bench"\nface = "virtual"'))
    axis = load_axis(path)
    parameters = bench_parameters(axis)
    bench = replace(parameters, laser=replace(parameters.laser, noise_um=1.0))
    with running_bench([axis], [bench]) as running, connected(axis, running) as machine:
        assert machine.bench is not None
        machine.session.prepare()
        campaign = Campaign(tmp_path / "loop", {}, resume=False)
        tables = calibrate(machine.session, campaign, axis.correction, lambda _: None).tables
        machine.bench.switch_on("thermal_drift", 14.0)
        turning = Turning(Exploration(runs=3, rows=16, warm_up_s=60.0))
        turn = turn_loop(machine.session, campaign, tables, lambda _: None, turning=turning)
    assert turn.further[0].name == "warm and cool"
    assert not any(made.person for made in turn.further)
    assert len(turn.diagnosed) == len(turn.before) + sum(len(made.points) for made in turn.further)
    left = {f.effect for f in turn.diagnosis.findings} | {r.effect for f in turn.diagnosis.findings for r in f.rivals}
    assert "thermal_drift" in left
    assert float(turn.after.error_um.std()) < 0.4 * float(turn.before.error_um.std())
