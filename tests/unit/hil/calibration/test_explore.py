"""An exploring campaign on a toy axis: what is asked of a person is asked of a machine without power."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.toy_axis import ToyMachine, toy_session

from drivers.drive import DriveState
from hil.calibration.explore import ExploringRun, explore
from hil.machine.conditions import AskedConditions
from hil.machine.measure import Step
from hil.records.journal import Campaign
from hil.records.rows import Records

STEPS = (Step(1, 1, 30.0), Step(1, 1, 61.0), Step(1, -1, 30.0))
LOADS = (0.0, 80.0, 80.0)


def explored(path: Path, machine: ToyMachine, conditions: AskedConditions | None) -> Records:
    runs = [ExploringRun(STEPS, 0.0, 0.0, (("load_kg", load),) if conditions else ()) for load in LOADS]
    with toy_session(machine) as session:
        if conditions is not None:
            session.conditions = conditions
        session.prepare()
        return explore(session, Campaign(path, {"kind": "test"}, resume=False), "explore", runs)


def test_nobody_reaches_into_a_machine_under_power(tmp_path: Path) -> None:
    machine = ToyMachine()
    seen: list[tuple[float, DriveState]] = []
    asked = AskedConditions({"load_kg": (0.0, 80.0)}, lambda _, value: seen.append((value, machine.state)))
    records = explored(tmp_path / "asked", machine, asked)
    assert seen == [(0.0, DriveState.SWITCH_ON_DISABLED), (80.0, DriveState.SWITCH_ON_DISABLED)]
    assert records["load_kg"].tolist() == list(np.repeat(LOADS, len(STEPS)))
    plain = explored(tmp_path / "plain", ToyMachine(), None)
    assert records.error_um == pytest.approx(plain.error_um, abs=1e-6), "the datum is kept, and each target's direction"
