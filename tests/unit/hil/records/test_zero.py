"""The zero of an axis as it is kept: what its files may hold, and which homing is let through."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from drivers.drive import DriveZero
from drivers.errors import InputError
from hil.records.zero import Reference, Zero, ZeroError, ZeroKeeper, homing_risk, read_zero, write_zero

REFERENCE = Reference(20.0, -3.25, "umd", 1000, "2026-03-01T08:00:00+00:00")
ZERO = Zero("ab" * 16, "X", "2026-03-01T07:59:00+00:00", {"serial": 7}, True, 37, 0.0, REFERENCE)


def ago(hours: float) -> str:
    return (datetime.now(UTC) - timedelta(hours=hours)).isoformat()


@dataclass
class Drive:
    """As much of one as a keeper asks."""

    now: DriveZero = field(default_factory=lambda: DriveZero(37, 0.0, {"serial": 7}))
    homed: bool | None = None
    before_homing: Any = None
    homed_elsewhere: Any = None

    def zero(self) -> DriveZero:
        return self.now

    def says_homed(self) -> bool | None:
        return self.homed


def keeper(directory: Path, drive: Drive, **how: Any) -> ZeroKeeper:
    made = ZeroKeeper(directory / "X.zero.json", "X", instrument="umd", **how)
    made.guard(drive)  # type: ignore[arg-type]
    return made


def begin(one: ZeroKeeper, drive: Drive, **how: Any) -> None:
    one.begin(drive, **{"homes": True, **how})  # type: ignore[arg-type]


def test_a_zero_comes_back_from_its_file(tmp_path: Path) -> None:
    assert read_zero(tmp_path / "zero.json") is None
    write_zero(tmp_path / "kept" / "zero.json", ZERO)
    assert read_zero(tmp_path / "kept" / "zero.json") == ZERO


@pytest.mark.parametrize(
    "text",
    [
        "",
        "7",
        "[]",
        "null",
        "{}",
        json.dumps({**ZERO.to_json(), "id": 3}),
        json.dumps({**ZERO.to_json(), "other": 3}),
        json.dumps({**ZERO.to_json(), "drive": "7"}),
        json.dumps({**ZERO.to_json(), "reference": {"motor_mm": 1.0}}),
        json.dumps({**ZERO.to_json(), "reference": {**vars(REFERENCE), "time": "noon"}}),
        json.dumps({**ZERO.to_json(), "reference": {**vars(REFERENCE), "motor_mm": "x"}}),
        "[" * 100_000,
    ],
)
def test_what_is_no_zero_is_refused_in_a_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "zero.json"
    path.write_text(text)
    with pytest.raises(InputError, match="does not say what zero"):
        read_zero(path)


@pytest.mark.parametrize("method", [33, 34, 35, 37])
def test_homing_by_whoever_asks_is_refused_where_it_would_lose_the_zero(tmp_path: Path, method: int) -> None:
    """Not only by a session: an axis without an instrument, a touch probe, a script."""
    drive = Drive(DriveZero(method, 0.0, {"serial": 7}))
    one = keeper(tmp_path, drive)
    drive.before_homing()  # a fresh axis
    found = read_zero(one.path)
    assert found is not None
    assert (found.method, found.reference) == (method, None)
    with pytest.raises(ZeroError, match=f"homing method {method} depends on where the axis stands"):
        drive.before_homing()
    drive.homed = True
    with pytest.raises(ZeroError, match="would be lost"):
        drive.before_homing()
    assert read_zero(one.path) == found


@pytest.mark.parametrize("method", [1, 17, 21, -3, None])
def test_homing_to_a_switch_is_let_through_each_time(tmp_path: Path, method: int | None) -> None:
    drive = Drive(DriveZero(method, 0.0, {"serial": 7}))
    one = keeper(tmp_path, drive)
    drive.before_homing()
    found = read_zero(one.path)
    drive.before_homing()
    assert read_zero(one.path) == found


def test_leave_to_home_is_for_one_homing(tmp_path: Path) -> None:
    drive = Drive()
    one = keeper(tmp_path, drive)
    begin(one, drive)
    drive.before_homing()
    with pytest.raises(ZeroError):
        drive.before_homing()


@pytest.mark.parametrize(
    ("now", "said"),
    [
        (DriveZero(17, 0.0, {"serial": 7}), "would home by homing method 17 to 0 mm"),
        (DriveZero(1, -5.0, {"serial": 7}), "would home by homing method 1 to -5 mm"),
        (DriveZero(1, 0.0, {"serial": 8}), "was made with drive serial 7, this one is serial 8"),
    ],
)
def test_another_drive_or_another_homing_is_another_zero(tmp_path: Path, now: DriveZero, said: str) -> None:
    drive = Drive(now)
    one = keeper(tmp_path, drive)
    write_zero(one.path, replace(ZERO, method=1))
    with pytest.raises(ZeroError, match=said):
        begin(one, drive)


def test_rows_and_tables_of_another_zero_are_refused(tmp_path: Path) -> None:
    drive = Drive(DriveZero(1, 0.0, {"serial": 7}))
    one = keeper(tmp_path, drive)
    write_zero(one.path, replace(ZERO, method=1))
    other = replace(ZERO, id="cd" * 16, method=1)
    write_zero(tmp_path / "verify-001" / "zero.json", other)
    with pytest.raises(ZeroError, match="the tables were made in another zero"):
        begin(one, drive, tables=other)
    with pytest.raises(ZeroError, match="the campaign's rows were measured in another zero"):
        begin(one, drive, campaign=tmp_path / "verify-001")


def test_tables_carry_the_zero_to_where_the_axiss_file_is_not(tmp_path: Path) -> None:
    drive = Drive(DriveZero(1, 0.0, {"serial": 7}))
    one = keeper(tmp_path, drive)
    begin(one, drive, tables=replace(ZERO, method=1, reference=replace(REFERENCE, sequence=None)))
    with pytest.raises(ZeroError, match=r"\+1\.0000 mm from where it was"):
        one.at_reference(19.0, -3.25, 2000, 50.0)


def test_tables_that_state_no_zero_are_not_for_a_homing_that_depends_on_the_place(tmp_path: Path) -> None:
    drive = Drive()
    one = keeper(tmp_path, drive)
    with pytest.raises(ZeroError, match="what was measured before would be lost"):
        begin(one, drive, old_tables=True)


def test_another_axiss_rows_do_not_make_this_one_any_less_fresh(tmp_path: Path) -> None:
    drive = Drive()
    one = keeper(tmp_path, drive)
    campaign = tmp_path / "calibrate-001"
    campaign.mkdir()
    (campaign / "campaign.json").write_text('{"axis": "Y"}')
    (campaign / "measure.csv").write_text("run\n")
    begin(one, drive)
    (campaign / "campaign.json").write_text('{"axis": "X"}')
    with pytest.raises(ZeroError):
        begin(one, drive)


@pytest.mark.parametrize(
    ("sequence", "refused"),
    [(4_000_000, True), (2_500_000, True), (200_000, False), (999, False), (None, True)],
    ids=["ran on", "many lost", "too few for the time", "fewer than before", "not numbered"],
)
def test_an_instrument_is_believed_while_it_has_run_on(tmp_path: Path, sequence: int | None, refused: bool) -> None:
    """A day at 50 readings a second is 4.3 million; the home switch gives the drive's zero back either way."""
    drive = Drive(DriveZero(17, 0.0, {"serial": 7}))
    one = keeper(tmp_path, drive)
    begin(one, drive)
    now = read_zero(one.path) or one.current
    assert now is not None
    day_before = Reference(20.0, -3.25, "umd", 1000, ago(24.0))
    write_zero(one.path, replace(now, reference=day_before))
    begin(one, drive)
    if refused:
        with pytest.raises(ZeroError, match="finds the reference position"):
            one.at_reference(20.0, 5.0, sequence, 50.0)
        return
    one.at_reference(20.0, 5.0, sequence, 50.0)
    kept = read_zero(one.path)
    assert kept is not None
    assert kept.id == now.id
    assert kept.reference is not None
    assert (kept.reference.instrument_mm, kept.reference.sequence) == (5.0, sequence)


@pytest.mark.parametrize("homes", [True, False], ids=["37", "not homed"])
@pytest.mark.parametrize("absolute", [False, True])
def test_a_drive_that_was_homed_by_another_program_is_not_believed_by_its_word(
    tmp_path: Path, homes: bool, absolute: bool
) -> None:
    """It says that it is homed, and was, elsewhere; the instrument was switched off meanwhile and shows nothing of it."""
    drive = Drive(homed=True)
    one = keeper(tmp_path, drive, absolute_encoder=absolute)
    write_zero(one.path, replace(ZERO, homes=homes))
    kept = one.path.read_bytes()
    begin(one, drive, homes=homes)
    if absolute:
        one.at_reference(20.0, 55.0, 100, 50.0)  # a stated fact, whoever homes
        return
    with pytest.raises(ZeroError, match="says that it is homed, but not by what: another program may have homed it"):
        one.at_reference(20.0, 55.0, 100, 50.0)
    assert one.path.read_bytes() == kept
    one.instrument_zeroed = True  # a person says so
    begin(one, drive, homes=homes)
    one.at_reference(20.0, 55.0, 100, 50.0)
    assert read_zero(one.path) != ZERO


@pytest.mark.parametrize("homes", [True, False], ids=["37", "not homed"])
def test_a_drive_that_was_homed_by_another_program_is_found_by_an_instrument_that_ran_on(
    tmp_path: Path, homes: bool
) -> None:
    drive = Drive(homed=True)
    one = keeper(tmp_path, drive)
    write_zero(one.path, replace(ZERO, homes=homes, reference=replace(REFERENCE, time=ago(1.0))))
    begin(one, drive, homes=homes)
    with pytest.raises(ZeroError, match=r"\+58\.2500 mm from where it was"):
        one.at_reference(20.0, 55.0, 1000 + 180_000, 50.0)


def test_small_shifts_do_not_add_up(tmp_path: Path) -> None:
    """Each reading is held against the first one, not against the last."""
    drive = Drive(DriveZero(17, 0.0, {"serial": 7}))
    one = keeper(tmp_path, drive)
    begin(one, drive)
    one.at_reference(20.0, 5.0, 1000, 50.0)
    begin(one, drive)
    one.at_reference(20.0, 5.06, 2000, 50.0)
    begin(one, drive)
    with pytest.raises(ZeroError, match=r"\+0\.1200 mm"):
        one.at_reference(20.0, 5.12, 3000, 50.0)


@pytest.mark.parametrize("method", [35, 37, 33, -1, None])
def test_methods_that_are_a_risk_are_named(method: int | None) -> None:
    assert homing_risk(True, method)
    assert homing_risk(False, method) is None


@pytest.mark.parametrize("method", [1, 2, 14, 17, 21, 30])
def test_methods_with_a_switch_are_none(method: int) -> None:
    assert homing_risk(True, method) is None


@pytest.mark.parametrize("absolute", [False, True])
def test_a_drive_that_homed_elsewhere_is_not_believed_when_it_says_that_it_is_homed(
    tmp_path: Path, absolute: bool
) -> None:
    drive = Drive()
    begin(keeper(tmp_path, drive, absolute_encoder=absolute), drive)
    drive.before_homing()
    drive.homed_elsewhere()
    drive.homed = True
    with pytest.raises(ZeroError, match=r"--new-zero, in a script new_zero=True"):
        begin(keeper(tmp_path, drive, absolute_encoder=absolute), drive)
    anew = keeper(tmp_path, drive, absolute_encoder=absolute)
    anew.anew = True
    begin(anew, drive)
    drive.before_homing()
    anew.at_reference(20.0, -3.25, 1000, None)
    begin(keeper(tmp_path, drive, absolute_encoder=absolute), drive)
