"""The loop, one effect of it over the CANopen slave, and the laser's terminal: an effect is switched on that the model lacks.

Before and after are measured, in campaigns of the same kind at other targets. The truth (`sim_backends.plant.switches`) has other
forms than what is fitted: lagged, saturating, breathing in amplitude.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis

from hil.axis.axis_file import load_axis
from hil.calibration.calibrate import calibrate
from hil.calibration.explore import Exploration
from hil.correction.tables import TableSet
from hil.diagnosis.loop.procedure import Turning, turn_loop
from hil.effects import ALL
from hil.effects.base import Action
from hil.machine.bench_wiring import bench_parameters, running_bench
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.records.rows import Records

NOISE_UM = 1.0  # of one sample of the laser; a reading at rest averages 15
CONDITIONS = "\n[conditions]\nload_kg = [0, 60, 120]\npos_y_mm = [0, 200, 400]\n"
SIZES_UM = {
    "cyclic": 4.0,
    "thermal_expansion": 25.0,
    "thermal_drift": 10.0,
    "backlash": 8.0,
    "backlash_position": 8.0,
    "lost_motion": 8.0,
    "load_deflection": 8.0,
    "abbe": 8.0,
    "cross_axis": 8.0,
    "local_wear": 10.0,
    "pitch_shape": 8.0,
}
QUICK = Exploration(runs=6, rows=34, warm_up_s=20.0)
WARM = Exploration(runs=6, rows=34, warm_up_s=120.0)
"""What goes with a temperature has to see one rise."""
THOROUGH = Exploration(runs=8, rows=42, warm_up_s=20.0)
"""A worn zone is narrow: it takes more rows until some of them tell its flanks."""
PLANS = {"thermal_expansion": WARM, "thermal_drift": WARM, "local_wear": THOROUGH}
ON_THE_WIRE = "thermal_drift"
"""The bus hands the same positions over whatever their error."""
IN_MOTION_ONLY = {
    "velocity_lag"
}  # nothing of it is there at rest: test_in_motion.py measures, and removes, it in passes


def test_no_effect_that_can_be_compensated_is_left_out() -> None:
    compensable = {effect.id for effect in ALL if effect.action is Action.COMPENSATE}
    assert compensable == set(SIZES_UM) | IN_MOTION_ONLY


@pytest.mark.outside
@pytest.mark.parametrize("effect", sorted(SIZES_UM))
def test_nine_tenths_of_a_hidden_effect_are_removed(effect: str, tmp_path: Path) -> None:
    path = bench_axis.lay_out(tmp_path, machine="geometric", sections=15, runs=2, on_a_wire=effect == ON_THE_WIRE)
    path.write_text(path.read_text().replace("last_mm = 260.0", "last_mm = 480.0") + CONDITIONS)
    axis = load_axis(path)
    parameters = bench_parameters(axis)
    bench = replace(parameters, laser=replace(parameters.laser, noise_um=NOISE_UM))
    with running_bench([axis], [bench]) as running, connected(axis, running) as machine:
        assert machine.bench is not None
        machine.session.prepare()
        campaign = Campaign(tmp_path / "loop", {"effect": effect}, resume=False)
        stored: list[TableSet] = []
        calibration = calibrate(machine.session, campaign, axis.correction, stored.append)
        machine.bench.switch_on(effect, SIZES_UM[effect])
        turn = turn_loop(
            machine.session,
            campaign,
            calibration.tables,
            lambda compensation: stored.append(compensation.tables),
            turning=Turning(PLANS.get(effect, QUICK)),
        )
    assert turn.diagnosis.recommended
    left = hidden_rms_um(turn.after) / hidden_rms_um(turn.before)
    assert left <= 0.1, [finding.effect for finding in turn.diagnosis.findings]


def hidden_rms_um(records: Records) -> float:
    """RMS of the error without the noise of the readings, which no correction can remove."""
    noise_um = NOISE_UM / math.sqrt(15)
    return math.sqrt(max(float(np.mean(records.error_um**2)) - noise_um**2, 0.0))
