"""The verbs that move an axis, as a user types them, over the virtual CAN bus and the laser's terminal."""

from __future__ import annotations

import argparse
import json
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from importlib.resources import files
from pathlib import Path

import pytest
from support import bench_axis

from drivers.errors import LinkLostError
from hil.app import main as command_line
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.correction.store import SealedStore
from hil.correction.tables import TableSet
from hil.machine.session import AxisSession
from hil.records.files import held
from hil.records.journal import RowJournal
from hil.records.rows import read_csv
from hil.records.zero import read_zero, write_zero


@pytest.fixture
def axis(passwords: None, tmp_path: Path) -> Path:
    return bench_axis.lay_out(tmp_path)


def test_doctor_finds_a_sound_axis_good(axis: Path, tmp_path: Path) -> None:
    assert main(["doctor", str(axis), "--json", str(tmp_path / "doctor.json")]) == 0
    found = json.loads((tmp_path / "doctor.json").read_text())
    names = ["drive", "limits", "scaling", "units of motion", "zero", "instrument", "speed", "units"]
    assert [check["name"] for check in found["checks"]] == names


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [("wavelength_fraction", "8", "factor of 1/4"), ("direction", "-1", "direction is reversed")],
)
def test_doctor_names_a_mistake_in_the_instruments_units(
    axis: Path, capsys: pytest.CaptureFixture[str], key: str, value: str, words: str
) -> None:
    axis.write_text(axis.read_text().replace("[instrument]", f"[instrument]\n{key} = {value}"))
    assert main(["doctor", str(axis)]) == 1
    assert words in " ".join(capsys.readouterr().out.split())


def test_calibrate_verify_and_report(axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before_after = tmp_path / "calibrated.json"
    report = tmp_path / "report.html"
    assert main(["calibrate", str(axis), "--json", str(before_after), "--report", str(report)]) == 0
    result = json.loads(before_after.read_text())
    assert result["before"]["rms_um"] > 2.0
    assert result["rounds"][-1]["rms_um"] < 0.25
    page = report.read_text(encoding="utf-8")
    assert result["rounds"][-1]["tables"] in page
    assert not re.search(r"(src|href)=\"https?:", page)

    assert main(["verify", str(axis), "--json", str(tmp_path / "verified.json")]) == 0
    verified = json.loads((tmp_path / "verified.json").read_text())
    assert verified["good"] is True
    rows = read_csv(next((tmp_path / "X-campaign").glob("verify-*/verify.csv")))
    measured = read_csv(next((tmp_path / "X-campaign").glob("calibrate-*/measure.csv")))
    assert not set(rows.target_mm) & set(measured.target_mm), "verification must look where the calibration did not"
    assert main(["check", str(tmp_path / "X-campaign/tables.sealed"), "--builder", str(tmp_path / "builder.pub")]) == 0
    capsys.readouterr()


def test_verify_refuses_tables_that_somebody_changed(
    axis: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    manual = tmp_path / "typed.csv"
    manual.write_text("position_mm,plus_um,minus_um\n20,1,2\n260,3,4\n")
    assert main(["calibrate", str(axis), "--manual", str(manual)]) == 0
    sealed = tmp_path / "X-campaign/tables.sealed"
    data = bytearray(sealed.read_bytes())
    data[len(data) // 2] ^= 1
    sealed.write_bytes(bytes(data))
    capfd.readouterr()
    assert main(["verify", str(axis)]) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "tables.sealed" in error
    assert not list((tmp_path / "X-campaign").glob("verify-*"))


def test_manual_tables_are_stored_as_typed_with_the_straightness_beside_them(axis: Path, tmp_path: Path) -> None:
    typed, straightness, out = tmp_path / "typed.csv", tmp_path / "straight.csv", tmp_path / "out.json"
    typed.write_text("position_mm,plus_um,minus_um\n20,1,2\n260,3,4\n")
    straightness.write_text("position_mm,deviation_um\n0,5\n500,5\n")
    manual = ["calibrate", str(axis), "--manual", str(typed)]
    assert main([*manual, "--straightness", str(straightness), "--json", str(out)]) == 0
    stored = TableSet.from_dict(json.loads(out.read_text())["tables"])
    assert (float(stored.correction_um(20.0, 1)), float(stored.correction_um(260.0, -1))) == (1 - 5, 4 - 5)
    assert SealedStore.of(load_axis(axis), bench_axis.PASSWORDS["HIL_PASSWORD"]).load().tables == stored


def test_a_table_with_a_password_of_its_own_is_in_force_with_it_only(
    axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    typed, own, weak = tmp_path / "typed.csv", tmp_path / "own.txt", tmp_path / "weak.txt"
    typed.write_text("position_mm,plus_um,backlash_um\n20,0,6\n260,0,6\n")
    own.write_text("backlash by torque\n")
    weak.write_text("torque\n")
    manual = ["calibrate", str(axis), "--manual", str(typed), "--table-password"]
    assert main([*manual, f"backlash={weak}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "password of X.backlash is new and has 6 characters" in line
    assert main([*manual, f"wear={own}"]) == 2
    assert "--table-password names entry wear, expected one of pitch, backlash" in capsys.readouterr().err
    assert main([*manual, f"backlash={own}"]) == 0
    capsys.readouterr()
    assert main(["verify", str(axis)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "table backlash of axis X has a password of its own (--table-password backlash=FILE)" in line
    assert not list((tmp_path / "X-campaign").glob("verify-*"))
    assert main(["verify", str(axis), "--table-password", f"backlash={own}"]) == 0
    rows = read_csv(next((tmp_path / "X-campaign").glob("verify-*/verify.csv")))
    reversal_um = rows.error_um[rows.direction < 0].mean() - rows.error_um[rows.direction > 0].mean()
    assert abs(reversal_um) < 0.5, "of 6 µm"


def test_manual_tables_refuse_what_they_cannot_go_with(
    axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    typed, straightness = tmp_path / "typed.csv", tmp_path / "straight.csv"
    typed.write_text("position_mm,plus_um,minus_um,straightness_um\n20,1,2,0\n260,3,4,0\n")
    straightness.write_text("position_mm,deviation_um\n0,5\n500,5\n")
    for also in (["--straightness", str(straightness)], ["--resume"], ["--report", str(tmp_path / "r.html")]):
        assert main(["calibrate", str(axis), "--manual", str(typed), *also]) == 2
        assert also[0] in capsys.readouterr().err
    assert not (tmp_path / "X-campaign").exists()


def test_an_axis_of_two_sections_is_verified_at_the_one_target_between(
    axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    two = axis.read_text().replace("sections = 5", "sections = 2").replace("runs = 2", "runs = 1")
    axis.write_text(two)
    assert main(["calibrate", str(axis), "--report", str(tmp_path / "calibrated.html")]) == 0
    assert main(["verify", str(axis), "--report", str(tmp_path / "verified.html")]) == 0
    assert "no figures of ISO 230-2: records hold 1 target" in capsys.readouterr().out


def test_an_axis_in_use_is_left_alone_and_no_campaign_begun(
    axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with held(axis):
        assert main(["calibrate", str(axis)]) == 2
    assert capsys.readouterr().err == f"hil: {axis}: is in use already, expected one process at a time\n"
    assert not (tmp_path / "X-campaign").exists()


@pytest.mark.parametrize("seed", ["-1", "1.5", "x", "2147483648", "٣"])
def test_a_seed_that_is_none_is_refused_in_one_line(axis: Path, capsys: pytest.CaptureFixture[str], seed: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["verify", str(axis), f"--seed={seed}"])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert (error.count("\n"), "expected a whole number from 0" in error) == (1, True)


def test_dry_run_moves_and_writes_nothing(axis: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(tmp_path.iterdir())
    for verb in ("calibrate", "verify", "doctor", "close-loop"):
        assert main([verb, str(axis), "--dry-run"]) == 0
    assert sorted(tmp_path.iterdir()) == before
    assert "would" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "counts", "status"),
    [
        ("vendor_style", 2**26, 2),
        ("cia402_over_modbus", 2**26, 2),
        ("mitsubishi_mr_je_c", 2**26, 2),
        ("kollmorgen_akd2g", 2**26, 0),
        ("vendor_style", 2**23, 0),
    ],
)
def test_a_dry_run_refuses_a_travel_that_the_registers_do_not_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, counts: int, status: int
) -> None:
    text = files("hil.examples").joinpath("modbus_axis.toml").read_text(encoding="utf-8")
    path = tmp_path / "axis.toml"
    path.write_text(text.replace("10_000", str(counts)).replace("vendor_style", name), encoding="utf-8")
    for verb in ("calibrate", "verify", "doctor", "close-loop"):
        assert main([verb, str(path), "--dry-run"]) == status
        told = capsys.readouterr()
        assert "the drive holds positions from -160 to 160 mm" in told.err if status else "would" in told.out


def test_a_wrong_password_is_refused_before_anything_moves(
    axis: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HIL_KEY_PASSWORD", "wrong")
    assert main(["calibrate", str(axis)]) == 2
    assert "password" in capsys.readouterr().err
    assert not (tmp_path / "X-campaign").exists()


@pytest.mark.usefixtures("passwords")
def test_a_band_that_cannot_be_held_ends_with_both_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bench_axis.lay_out(tmp_path, machine="typical", correction="band_um = [6.0, 6.01]")
    assert main(["calibrate", str(path)]) == 2
    error = capsys.readouterr().err
    assert re.search(r"0\.01 µm wide.*repeatability of \d+\.\d\d µm", error)
    assert not (tmp_path / "X-campaign/tables.sealed").exists()


@pytest.mark.parametrize(
    "script",
    ["commission", *(pytest.param(script, marks=pytest.mark.outside) for script in ("lost_motion", "close_the_loop"))],
)
def test_every_example_runs_as_shipped(axis: Path, script: str, capsys: pytest.CaptureFixture[str]) -> None:
    own = bench_axis.lay_out(axis.parent / script, on_a_wire=script == "commission")
    assert import_module(f"hil.examples.{script}").main(str(own)) == 0
    assert " µm" in capsys.readouterr().out


# -- how to go on ----------------------------------------------------------------------------------------------------------
def interrupted_after(
    rows: int, error: BaseException, monkeypatch: pytest.MonkeyPatch, campaigns: str = ""
) -> list[RowJournal]:
    """From so many rows on of campaigns whose names begin like this, appending one fails; the journals appended to so far."""
    append, journals = RowJournal.append, list[RowJournal]()

    def failing(journal: RowJournal, row: dict[str, float]) -> None:
        if journal.path.parent.name.startswith(campaigns):
            journals.append(journal)
            if len(journals) > rows:
                raise error
        append(journal, row)

    monkeypatch.setattr(RowJournal, "append", failing)
    return journals


def last_line(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("verb", "options", "error"),
    [
        ("calibrate", (), LinkLostError("pulled")),
        ("calibrate", (), KeyError("us")),
        ("verify", ("--seed", "3"), OSError(28, "No space")),
        ("lost-motion", ("--only-measure", "--seed", "2"), KeyboardInterrupt()),
        ("close-loop", ("--runs", "2", "--rows", "12", "--warm-up", "0", "--person", "none"), KeyboardInterrupt()),
    ],
)
def test_what_broke_off_ends_with_the_command_that_goes_on(
    axis: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    verb: str,
    options: tuple[str, ...],
    error: BaseException,
) -> None:
    typed = axis.parent / "typed.csv"
    typed.write_text("position_mm,plus_um,minus_um\n20,1,2\n260,3,4\n")
    assert main(["calibrate", str(axis), "--manual", str(typed)]) == 0
    with monkeypatch.context() as patch:
        interrupted_after(3, error, patch)
        assert main([verb, str(axis), *options]) == (130 if isinstance(error, KeyboardInterrupt) else 1)
    command = shlex.join(["hil", verb, str(axis), *options, "--resume"])
    assert last_line(capsys) == f"hil: go on with: {command}"
    listed = [option for option in options if option not in ("--only-measure", "--person", "none")]
    assert main(["records", "list", str(axis.parent), "--json", str(axis.parent / "list.json")]) == 0
    (one,) = json.loads((axis.parent / "list.json").read_text())["campaigns"]
    assert one["state"] == "unfinished"
    assert shlex.split(one["resume"]) == ["hil", verb, str(axis), *listed, "--resume"]
    assert f"go on with {one['resume']}" in capsys.readouterr().out
    with monkeypatch.context() as patch:  # broken off again: it is the same command
        interrupted_after(0, error, patch)
        assert main(shlex.split(command)[1:]) != 0
    assert last_line(capsys) == f"hil: go on with: {command}"


@pytest.mark.outside
@pytest.mark.parametrize(
    ("verb", "options"),
    [
        ("calibrate", ()),
        ("calibrate", ("--new-zero",)),
        ("close-loop", ("--runs", "2", "--rows", "12", "--warm-up", "0", "--person", "none")),
    ],
)
def test_a_proof_that_broke_off_is_gone_on_with_and_not_measured_anew(
    axis: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], verb: str, options: tuple[str, ...]
) -> None:
    """The tables are stored by then; the campaign counts as finished when its proof is."""
    typed = axis.parent / "typed.csv"
    typed.write_text("position_mm,plus_um,minus_um\n20,1,2\n260,3,4\n")
    assert main(["calibrate", str(axis), "--manual", str(typed)]) == 0
    with monkeypatch.context() as patch:
        proving = interrupted_after(3, KeyboardInterrupt(), patch, "verify")
        assert main([verb, str(axis), *options]) == 130
        assert proving
    command = shlex.join(["hil", verb, str(axis), *(one for one in options if one != "--new-zero"), "--resume"])
    assert last_line(capsys) == f"hil: go on with: {command}"
    campaigns = axis.parent / "X-campaign"
    begun = (campaigns / "verify-001" / "verify.csv").read_bytes()
    assert main(shlex.split(command)[1:]) in (0, 1)
    assert (campaigns / "verify-001" / "verify.csv").read_bytes().startswith(begun)
    assert [path.name for path in campaigns.glob("verify-*")] == ["verify-001"]
    assert main(["records", "list", str(axis.parent), "--json", str(axis.parent / "list.json")]) == 0
    states = {one["state"] for one in json.loads((axis.parent / "list.json").read_text())["campaigns"]}
    assert states == {"finished"}


@pytest.mark.outside
@pytest.mark.parametrize("part", ["dense", "calibrate", "verify"])
def test_a_dense_pass_is_measured_once_wherever_its_calibration_broke_off(
    axis: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], part: str
) -> None:
    """An older calibration that is finished is not taken for the one that the dense pass began."""
    assert main(["calibrate", str(axis), "--without-proof"]) in (0, 1)
    with monkeypatch.context() as patch:
        begun = interrupted_after(3, KeyboardInterrupt(), patch, part)
        assert main(["calibrate", str(axis), "--dense"]) == 130
        assert begun
    command = f"hil calibrate {axis} --dense --resume"
    assert last_line(capsys) == f"hil: go on with: {command}"
    campaigns = axis.parent / "X-campaign"
    dense = campaigns / "dense-001" / "dense.csv"
    before = dense.read_bytes()
    for _ in range(2):  # the second finds all of it finished and measures nothing
        assert main(shlex.split(command)[1:]) in (0, 1)
        assert dense.read_bytes().startswith(before)
        found = sorted(path.parent.name for path in campaigns.glob("*/campaign.json"))
        assert found == ["calibrate-001", "calibrate-002", "dense-001", "verify-001"]


def pulled(_session: AxisSession, *_more: object) -> None:
    raise LinkLostError("pulled")


def test_where_nothing_can_be_gone_on_with_nothing_of_it_is_said(
    axis: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patch:
        interrupted_after(3, KeyboardInterrupt(), patch)
        assert main(["calibrate", str(axis)]) == 130
    assert "go on with" in last_line(capsys)
    with monkeypatch.context() as patch:  # a new one that was not begun: --resume would take the one before it
        patch.setattr(AxisSession, "prepare", pulled)
        assert main(["calibrate", str(axis)]) == 1
    assert last_line(capsys) == "hil: pulled"
    assert main(["calibrate", str(axis), "--resume"]) == 0
    capsys.readouterr()
    assert main(["records", "list", str(axis.parent)]) == 0
    said = capsys.readouterr().out
    assert "finished" in said
    assert "go on with" not in said


def spoil_row(campaign: Path) -> str:
    rows = campaign / "measure.csv"
    rows.write_text(rows.read_text().replace("1,+1,", "1,+1,0", 1))
    return "is not as it was written"


def lose_chain(campaign: Path) -> str:
    (campaign / "rows.chain").unlink()
    return "rows.chain: is gone"


def spoil_checksum(campaign: Path) -> str:
    sums = campaign / "SHA256SUMS"
    sums.write_text(f"{'0' * 64}  measure.csv\n")
    return "was changed since it was closed"


def other_zero(campaign: Path) -> str:
    mine = read_zero(campaign / "zero.json")
    assert mine is not None
    write_zero(campaign.parent / "X.zero.json", replace(mine, id="cd" * 16))
    return "the campaign's rows were measured in another zero"


@pytest.mark.parametrize("spoil", [spoil_row, lose_chain, spoil_checksum, other_zero])
def test_what_would_be_refused_is_not_called_a_way_to_go_on(
    axis: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], spoil: Callable[[Path], str]
) -> None:
    """Spoilt before the first run told how to go on, as somebody at another terminal may; and later, for the list."""
    campaign = axis.parent / "X-campaign/calibrate-001"
    says: list[str] = []
    end = command_line._end

    def ended(error: BaseException, args: argparse.Namespace) -> tuple[str, int]:
        if not says:
            says.append(spoil(campaign))
        return end(error, args)

    with monkeypatch.context() as patch:
        interrupted_after(3, KeyboardInterrupt(), patch)
        patch.setattr(command_line, "_end", ended)
        assert main(["calibrate", str(axis)]) == 130
    told = capsys.readouterr().err
    assert "go on with: " not in told
    assert f"hil: cannot be resumed: {'' if spoil is other_zero else campaign}" in told
    assert says[0] in told.splitlines()[-1]
    assert main(["records", "list", str(axis.parent), "--json", str(axis.parent / "list.json")]) == 0
    listed = capsys.readouterr().out
    assert "go on with hil" not in listed
    assert says[0] in listed
    (one,) = json.loads((axis.parent / "list.json").read_text())["campaigns"]
    assert one["resume"] is None
    assert says[0] in one["refused"]
    assert main(["calibrate", str(axis), "--resume"]) == 2
    assert says[0] in last_line(capsys), "as was said"


def test_what_was_said_of_the_zero_once_is_not_said_again(
    axis: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patch:
        interrupted_after(3, KeyboardInterrupt(), patch)
        assert main(["calibrate", str(axis), "--new-zero", "--instrument-zeroed"]) == 130
    assert last_line(capsys) == f"hil: go on with: hil calibrate {axis} --resume"
    assert main(["calibrate", str(axis), "--resume"]) == 0


def test_a_homing_that_is_not_done_twice_is_said_before_how_to_go_on(
    axis: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    axis.write_text(axis.read_text().replace("[drive]\n", "[drive]\nhoming = { method = 37 }\n"))
    with monkeypatch.context() as patch:
        interrupted_after(3, KeyboardInterrupt(), patch)
        assert main(["calibrate", str(axis)]) == 130
    *_, needs, command = capsys.readouterr().err.splitlines()
    assert "homing method 37 is not done a second time: the drive has to say that it is still homed" in needs
    assert command == f"hil: go on with: hil calibrate {axis} --resume"
    assert main(["records", "list", str(axis.parent)]) == 0
    assert "--resume (homing method 37 is not done a second time" in capsys.readouterr().out


@pytest.mark.parametrize("closed", [True, False])
def test_a_row_changed_since_is_refused_before_anything_moves(
    axis: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], closed: bool
) -> None:
    with monkeypatch.context() as patch:
        interrupted_after(5, KeyboardInterrupt(), patch)
        assert main(["calibrate", str(axis)]) == 130
    (path,) = axis.parent.glob("X-campaign/calibrate-001/measure.csv")
    if not closed:  # as a killed process leaves it
        (path.parent / "SHA256SUMS").unlink()
    lines = path.read_text().splitlines(keepends=True)
    lines[4] = lines[4].replace(",", ",1", 1) if lines[4].startswith("#") else lines[4].replace("1,+1,", "1,+1,0", 1)
    path.write_text("".join(lines))
    changed = path.read_bytes()
    capsys.readouterr()
    assert main(["calibrate", str(axis), "--resume"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"{path}:5: is not as it was written" in error
    assert path.read_bytes() == changed
    assert not (axis.parent / "X-campaign/tables.sealed").exists()
