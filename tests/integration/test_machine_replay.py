"""A machine recorded while it was measured, and the recording measured again: the same rows, and a refusal of anything else."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.bench_axis import PASSWORDS, lay_out

from drivers.errors import InputError, StateError
from hil.app.main import main
from hil.axis.axis_file import AxisConfig, load_axis
from hil.figures.history import REPLAY, find_campaigns, history
from hil.machine.measure import Step, bidirectional_steps, measure
from hil.machine.replay import recorded, replayed
from hil.machine.session import AxisSession
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.records.rows import Records


def axis_at(directory: Path, face: str) -> AxisConfig:
    path = lay_out(directory, machine="typical", sections=3, runs=1)
    path.write_text(path.read_text().replace('backend = "bench"', f'backend = "bench"\nface = "{face}"'))
    return load_axis(path)


def a_pass(session: AxisSession, directory: Path, axis: AxisConfig) -> Records:
    session.prepare()
    campaign = Campaign(directory, axis.purpose("verify"), resume=False)
    return measure(session, campaign, "verify", bidirectional_steps(axis.measurement.targets_mm, 1))


@pytest.fixture(params=["virtual", pytest.param("canopen", marks=pytest.mark.outside)])
def played(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[AxisConfig, Path, Records]:
    axis = axis_at(tmp_path / "axis", request.param)
    path = tmp_path / "recording.csv"
    with connected(axis) as machine, recorded(machine, path):
        records = a_pass(machine.session, tmp_path / "was", axis)
    return axis, path, records


def test_a_recording_gives_the_same_rows_again_and_nothing_else(
    played: tuple[AxisConfig, Path, Records], tmp_path: Path
) -> None:
    axis, path, was = played
    with replayed(axis, path) as machine:
        again = a_pass(machine.session, tmp_path / "again", axis)
    assert np.array_equal(again.target_mm, was.target_mm)
    assert np.array_equal(again["motor_mm"], was["motor_mm"])
    assert np.array_equal(again.measured_mm, was.measured_mm)
    assert again["temp_screw_c"] == pytest.approx(was["temp_screw_c"], abs=0.2)
    with replayed(axis, path) as machine:
        machine.session.prepare()
        with pytest.raises(StateError, match=r"the recording moves to \d+\.\d+ mm here, asked for was a move to 7\.0"):
            machine.session.move_uncorrected(7.0, 10.0)
    with replayed(axis, path) as machine:
        steps = [Step(run, 1, target) for run in (1, 2) for target in sorted(axis.measurement.targets_mm)]
        machine.session.prepare()
        with pytest.raises(StateError, match="the recording"):
            measure(machine.session, Campaign(tmp_path / "other", {"kind": "x"}, resume=False), "x", steps)


@pytest.mark.usefixtures("passwords")
@pytest.mark.outside
def test_the_verb_records_and_replays(tmp_path: Path) -> None:
    axis = axis_at(tmp_path, "canopen")
    assert main(["calibrate", str(axis.path)]) == 0
    recording = str(tmp_path / "machine.csv")
    assert main(["verify", str(axis.path), "--record", recording, "--json", str(tmp_path / "was.json")]) == 0
    assert main(["verify", str(axis.path), "--replay", recording, "--json", str(tmp_path / "again.json")]) == 0
    was, again = (json.loads((tmp_path / name).read_text()) for name in ("was.json", "again.json"))
    assert again == was
    found = find_campaigns([axis.store.directory])
    assert sorted(one.kind for one in found) == [
        "calibrate",
        REPLAY,
        "verify",
        "verify",
    ]  # calibrate ends with other targets
    assert REPLAY not in {moment.campaign.kind for moment in history(found, ["E_up"])}
    assert main(["verify", str(axis.path), "--seed", "2", "--replay", recording]) == 2


@pytest.mark.outside
@pytest.mark.parametrize("verb", ["calibrate", "close-loop"])
def test_a_recorded_job_comes_to_the_same_again_and_stores_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    axis = axis_at(tmp_path, "virtual")
    short = [] if verb == "calibrate" else ["--runs", "2", "--rows", "8", "--warm-up", "20"]
    with monkeypatch.context() as builder:
        for name, value in PASSWORDS.items():
            builder.setenv(name, value)
        recording, was, again = (str(tmp_path / name) for name in ("machine.csv", "was.json", "again.json"))
        status = main([verb, str(axis.path), *short, "--record", recording, "--json", was])
    sealed = axis.tables_path.read_bytes()
    assert main([verb, str(axis.path), *short, "--replay", recording, "--json", again]) == status
    assert "nothing is stored" in capsys.readouterr().out
    before, after = (json.loads(Path(name).read_text()) for name in (was, again))
    if verb == "close-loop":  # thermometers are heard at other moments of a second, and a diagnosis looks at them
        found = [[finding["effect"] for finding in one.pop("diagnosis")["findings"]] for one in (before, after)]
        assert found[0] == found[1]
    assert after == before
    assert axis.tables_path.read_bytes() == sealed
    assert sorted(one.kind for one in find_campaigns([axis.store.directory])) == sorted([verb, REPLAY])


def test_what_is_no_recording_of_a_machine_is_refused(tmp_path: Path) -> None:
    axis = axis_at(tmp_path, "virtual")
    path = tmp_path / "laser.csv"
    path.write_text("time_s,laser_mm\n0,1\n")
    with pytest.raises(InputError, match=r"laser\.csv: is no recording of drive and instrument"), replayed(axis, path):
        pytest.fail("played")
    with connected(axis) as machine, pytest.raises(InputError, match="cannot be made"), recorded(machine, path):
        pytest.fail("recorded over another file")
