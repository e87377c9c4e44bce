"""The bridge's correction and the drive's are never in force together: the drive is asked, before anything moves."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.table_axis import lay_out_table_axis, store

import sim_backends.virtual_drive
from drivers.errors import StateError
from drivers.limits import DriveLimits
from drivers.set_points import SetPointSettings
from hil.app.main import main
from hil.correction.compensation import Compensation
from hil.correction.tables import TableSet
from hil.doctor.procedure import doctor
from hil.drive_table.change import changing, held_table
from hil.drive_table.quantise import drive_table, wanted_of
from hil.machine.replay import recorded
from hil.machine.session import AxisSession
from hil.machine.wiring import connected
from sim_backends.virtual_faces import VirtualCorrectionTable

WORDS = "drive X corrects this axis itself, its .* is switched on"
LIMITS = DriveLimits(-2.0, 502.0, 200.0, 1000.0)


def hand_to_the_drive(session: AxisSession, tables: TableSet) -> None:
    """Behind the bridge's back, as another master or the operator's panel would."""
    table = held_table(session.drive)
    made = drive_table(wanted_of(Compensation(tables)), table.description, session.drive.scaling, LIMITS)
    table.write(made.raw)
    table.switch(True)


@pytest.mark.parametrize("face", ["in process", pytest.param("canopen, array", marks=pytest.mark.outside)])
def test_a_session_asks_the_drive_first(face: str, tmp_path: Path) -> None:
    axis, tables = lay_out_table_axis(tmp_path, face)
    with connected(axis) as machine:
        session = machine.session
        session.compensation = Compensation(tables)
        session.compensation = None
        hand_to_the_drive(session, tables)
        before = session.drive.sample()
        with pytest.raises(StateError, match=WORDS):
            session.prepare()
        with pytest.raises(StateError, match=f"{WORDS}.*twice"):
            session.compensation = Compensation(tables)
        assert session.compensation is None
        after = session.drive.sample()
        assert (after.state, after.position_load_mm) == (before.state, before.position_load_mm)
        said = next(check for check in doctor(session, move=False) if check.name == "drive's table")
        assert said.good
        assert "the drive corrects by its" in said.detail
        held_table(session.drive).switch(False)
        session.compensation = Compensation(tables)
        with (
            pytest.raises(StateError, match="the bridge's correction is in force"),
            changing(session.drive, tmp_path / "note.json", pytest.fail) as change,
        ):
            change.switch(True)
        assert not held_table(session.drive).enabled()
        session.compensation = None
        with changing(session.drive, tmp_path / "note.json", pytest.fail) as change:
            change.switch(True)
        assert held_table(session.drive).enabled()


def test_a_drive_that_is_recorded_says_it_too(tmp_path: Path) -> None:
    axis, tables = lay_out_table_axis(tmp_path, "in process")
    with connected(axis) as machine, recorded(machine, tmp_path / "recording.csv"):
        hand_to_the_drive(machine.session, tables)
        with pytest.raises(StateError, match=WORDS):
            machine.session.prepare()


def test_a_table_switched_on_meanwhile_stops_the_next_corrected_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    axis, tables = lay_out_table_axis(tmp_path, "in process")
    with connected(axis) as machine:
        session = machine.session
        session.prepare()
        session.compensation = Compensation(tables)
        session.move_to(30.0)
        place = session.drive.sample().position_load_mm
        monkeypatch.setattr(VirtualCorrectionTable, "enabled", lambda _table: True)
        with pytest.raises(StateError, match=WORDS):
            session.move_to(40.0)
        with pytest.raises(StateError, match=WORDS):
            session.approach(40.0)
        with pytest.raises(StateError, match=WORDS):
            session.stream_along([(31.0, 10.0)], SetPointSettings(0.01), lambda _stream: None)
        assert session.drive.sample().position_load_mm == pytest.approx(place, abs=1e-4)
        session.compensation = None  # without the bridge's own the axis may move
        session.move_to(40.0)


@pytest.mark.usefixtures("passwords")
@pytest.mark.outside
@pytest.mark.parametrize("verb", ["calibrate", "verify", "close-loop"])
def test_no_verb_corrects_what_the_drive_corrects(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    axis, tables = lay_out_table_axis(tmp_path, "in process")
    store(axis, tables)
    sealed = axis.tables_path.read_bytes()

    class SwitchedOn(VirtualCorrectionTable):
        def enabled(self) -> bool:
            return True

    monkeypatch.setattr(sim_backends.virtual_drive, "VirtualCorrectionTable", SwitchedOn)
    assert main([verb, str(axis.path)]) == 2
    *said_before, line = capsys.readouterr().err.splitlines()
    assert "corrects this axis itself, its pitch table is switched on" in line
    assert "hil params table remove" in line
    # tables made without a zero are noted wherever they are opened
    assert all("states no zero of axis X" in note for note in said_before)
    assert len(said_before) <= 1
    assert axis.tables_path.read_bytes() == sealed
    assert not list(axis.store.directory.rglob("*.csv")), "a row was measured"


@pytest.mark.outside
def test_backlash_by_torque_is_refused_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    axis, _ = lay_out_table_axis(tmp_path, "in process")
    monkeypatch.setattr(VirtualCorrectionTable, "enabled", lambda _table: True)
    assert main(["backlash", str(axis.path)]) == 2
    assert "would be missing from the lost motion" in capsys.readouterr().err
