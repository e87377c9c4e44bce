"""`hil export` and `hil import` as a user types them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from hil.app.terminal.main import main
from hil.correction.compensation import Compensation
from hil.correction.manual import read_manual_tables
from hil.correction.sealed import new_key, save_public_key
from hil.correction.store import SealedStore
from hil.correction.tables import TableSet
from hil.effects import ALL, term_from_json
from hil.effects.cyclic import FUNDAMENTAL
from hil.effects.model import Model, PitchTable
from hil.records.rows import read_csv

MANUAL = "position_mm,plus_um,minus_um\n0,0,-4\n10,5,1\n20,-2,-6\n"

OPTIONS = {
    "linuxcnc": ["--type", "0"],
    "sinumerik": ["--axis", "X1"],
    "fanuc": ["--axis", "2", "--step-mm", "10"],
    "twincat": ["--axis", "2", "--name", "Y"],
}
AGAIN = {"linuxcnc": ["--type", "0"], "sinumerik": [], "fanuc": ["--axis", "2"], "twincat": []}


@pytest.fixture
def manual(tmp_path: Path) -> str:
    path = tmp_path / "typed.csv"
    path.write_text(MANUAL)
    return str(path)


@pytest.mark.parametrize("name", OPTIONS)
def test_out_and_back(name: str, manual: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there, back, report = str(tmp_path / "there"), str(tmp_path / "back.csv"), tmp_path / "r.json"
    assert main(["export", manual, "--format", name, "--out", there, *OPTIONS[name], "--json", str(report)]) == 0
    said = capsys.readouterr().out
    assert "3 per direction" in said or "2 per direction" in said
    assert "set: " in said
    facts = json.loads(report.read_text())
    assert facts["deviation_um"] < 0.001
    assert facts["written"] == there
    assert main(["import", there, "--format", name, "--out", back, *AGAIN[name]]) == 0
    tables = read_manual_tables(back)
    for direction, expected in ((1, [0.0, 5.0, -2.0]), (-1, [-4.0, 1.0, -6.0])):
        assert tables.correction_um([0.0, 10.0, 20.0], direction) == pytest.approx(expected, abs=1e-3)


def test_dry_run_writes_nothing(manual: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "x.comp"
    assert main(["export", manual, "--format", "linuxcnc", "--out", str(out), "--dry-run"]) == 0
    assert not out.exists()
    assert "would write" in capsys.readouterr().out


def test_an_option_of_another_format_is_refused(
    manual: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x.comp"
    assert main(["export", manual, "--format", "linuxcnc", "--out", str(out), "--magnification", "2"]) == 2
    assert capsys.readouterr().err == "hil: --magnification is no option of the format linuxcnc\n"
    assert main(["export", manual, "--format", "fanuc", "--axis", "X", "--out", str(out)]) == 2
    assert "--axis is 'X', expected a whole number for fanuc" in capsys.readouterr().err
    assert main(["import", manual, "--format", "keysight", "--column", "run=x", "--out", str(out)]) == 2
    assert "--column is no option of the format keysight" in capsys.readouterr().err


def test_what_a_format_cannot_hold_is_one_line_and_writes_nothing(
    manual: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x.ini"
    arguments = ["export", manual, "--format", "sinumerik", "--out", str(out), "--reference-mm", "10"]
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"hil: {manual}: the correction at the reference point 10 mm is 5.000 µm")
    assert error.count("\n") == 1
    assert not out.exists()
    assert main([*arguments, "--allow-shift"]) == 0
    assert "+5.0000 µm taken out" in capsys.readouterr().out


def test_what_to_change_is_named_as_it_is_typed(
    manual: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "x.ini")
    assert main(["export", manual, "--format", "sinumerik", "--out", out, "--reference-mm", "10"]) == 2
    assert "allow the shift (--allow-shift)" in capsys.readouterr().err
    assert main(["export", manual, "--format", "sinumerik", "--out", out, "--max-points", "2"]) == 2
    assert "(--tolerance-um), or more points (--max-points)" in capsys.readouterr().err


WIDE = "target;1\N{UPWARDS ARROW};1\N{DOWNWARDS ARROW}\r\n0,5;1,5;\N{MINUS SIGN}1,5\r\n100;2;\N{MINUS SIGN}2\r\n"
ASCII = WIDE.translate({0x2191: "+", 0x2193: "-", 0x2212: "-"})


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (WIDE.encode(), None),
        (WIDE.encode("utf-8-sig"), None),
        (WIDE.encode("utf-16"), None),
        (b"\xfe\xff" + WIDE.encode("utf-16-be"), None),
        (ASCII.replace("target", "Weg in \N{MICRO SIGN}m").encode("latin-1"), None),
        (ASCII.replace("\r\n", "\r").encode(), None),
        (WIDE.encode("utf-16-le"), "UTF-16 without its byte-order mark"),
        (WIDE.encode("utf-16")[:-1], "is not UTF-16 text"),
        (b"", "holds no table"),
    ],
)
def test_text_of_any_office_program_is_read_or_refused_in_a_line(
    data: bytes, says: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "wide.csv", tmp_path / "records.csv"
    path.write_bytes(data)
    status = main(["import", str(path), "--format", "iso-wide", "--decimal", ",", "--out", str(out)])
    if says is not None:
        error = capsys.readouterr().err
        assert (status, error.count("\n")) == (2, 1)
        assert says in error
        return
    assert status == 0
    assert read_csv(out).target_mm.tolist() == [0.5, 100.0, 100.0, 0.5]
    assert read_csv(out).error_um == pytest.approx([1.5, 2.0, -2.0, -1.5])


def test_tables_as_json_from_here_and_from_calibrate(manual: str, tmp_path: Path) -> None:
    tables = read_manual_tables(manual)
    (tmp_path / "tables.json").write_text(json.dumps(tables.to_dict()))
    (tmp_path / "calibrate.json").write_text(json.dumps({"axis": "X", "tables": tables.to_dict()}))
    texts = []
    for name in ("tables.json", "calibrate.json", "typed.csv"):
        out = tmp_path / (name + ".comp")
        assert main(["export", str(tmp_path / name), "--format", "linuxcnc", "--out", str(out)]) == 0
        texts.append(out.read_text())
    assert texts[0] == texts[1] == texts[2]
    out = tmp_path / "again.json"
    assert main(["import", str(tmp_path / "typed.csv.comp"), "--format", "linuxcnc", "--out", str(out)]) == 0
    again = TableSet.from_dict(json.loads(out.read_text()))
    assert np.allclose(again.correction_um([0.0, 10.0, 20.0], -1), [-4, 1, -6])


AXIS = """\
[axis]
name = "X"
travel_min_mm = 0.0
travel_max_mm = 100.0
max_velocity_mm_s = 10.0
max_acceleration_mm_s2 = 100.0
[scaling]
encoder_counts_per_motor_rev = 1000
feed_mm_per_shaft_rev = 10.0
[drive]
backend = "bench"
[instrument]
[measurement]
first_mm = 10.0
last_mm = 90.0
sections = 5
velocity_mm_s = 5.0
[store]
directory = "store"
builder_public = "builder.pub"
"""


CYCLIC = {
    "effect": "cyclic",
    "form": FUNDAMENTAL,
    "inputs": ["target_mm"],
    "constants": {},
    "nonlinear": {"period_mm": 10.0},
    "coefficients": [1.0, 0.5],
    "covariance": [[0.0] * 3] * 3,
}
LAG = {
    "effect": "velocity_lag",
    "form": "proportional",
    "inputs": ["velocity_mm_s", "direction"],
    "constants": {},
    "nonlinear": {},
    "coefficients": [0.02],
    "covariance": [[0.0]],
}


def test_from_the_sealed_store(
    manual: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "X.toml").write_text(AXIS)
    key = new_key()
    save_public_key(tmp_path / "builder.pub", key.public_key())
    store = SealedStore(tmp_path / "store" / "tables.sealed", "X", "secret of the axis", key.public_key(), key)
    tables = read_manual_tables(manual)
    cyclic, lag = (term_from_json(obj, ALL, obj["effect"]) for obj in (CYCLIC, LAG))
    store.save(Compensation(tables, (cyclic, lag)))
    monkeypatch.setenv("HIL_PASSWORD", "secret of the axis")
    out = tmp_path / "x.comp"
    arguments = ["export", str(tmp_path / "X.toml"), "--format", "linuxcnc", "--out", str(out)]
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert "holds velocity_lag, and" in error, "a cyclic error can be held by a table, and is"
    assert "--tables-only" in error
    assert not out.exists()
    assert main([*arguments, "--tables-only"]) == 0
    rows = np.loadtxt(out)
    node = rows[rows[:, 0] == 10.0][0]
    assert node[1:] == pytest.approx(
        1e-3 * (np.array([5.0, 1.0]) - cyclic.error_um({"target_mm": np.array([10.0])})), abs=1e-9
    )


def test_from_a_fitted_model(tmp_path: Path) -> None:
    """A model holds errors, a controller corrections."""
    path, out = tmp_path / "model.json", tmp_path / "x.comp"
    path.write_text(Model(PitchTable.of([0.0, 10.0], [1.0, 2.0], [-3.0, 4.0])).to_json())
    assert main(["export", str(path), "--format", "linuxcnc", "--out", str(out)]) == 0
    assert out.read_text().splitlines()[1] == "10.000000000 -0.002000000 -0.004000000"


def test_records_of_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lin = tmp_path / "a.Lin"
    lin.write_bytes(
        "Identify=Positions,TextUnit=0, 10 mm\r\nIdentify=LinearErr,TextUnit=1, 2, 3, 4 µm\r\n".encode("latin-1")
    )
    out = tmp_path / "records.csv"
    assert main(["import", str(lin), "--format", "keysight", "--out", str(out)]) == 0
    records = read_csv(out)
    assert records.error_um == pytest.approx([1, 2, 3, 4])
    assert records.direction.tolist() == [1, 1, -1, -1]
    assert "4 rows, 1 runs, 2 targets" in capsys.readouterr().out
    wide = tmp_path / "wide.csv"
    wide.write_text("target,1+,1-\n0,1,4\n10,2,3\n")
    assert main(["import", str(wide), "--format", "iso-wide", "--out", str(out)]) == 0
    assert read_csv(out).error_um == pytest.approx([1, 2, 3, 4])
    plain = tmp_path / "plain.csv"
    plain.write_text("Soll;Ist\n0;1,0\n10;10002,0\n10;10003,0\n0;4,0\n")
    columns = ["--column", "target_mm=Soll", "--column", "measured_mm=Ist:um", "--decimal", ",", "--infer"]
    assert main(["import", str(plain), "--format", "csv", *columns, "--out", str(out)]) == 0
    assert read_csv(out).error_um == pytest.approx([1, 2, 3, 4])
    broken = tmp_path / "broken.csv"
    broken.write_text("target,1+\n0,one\n")
    assert main(["import", str(broken), "--format", "iso-wide", "--out", str(out)]) == 2
    assert capsys.readouterr().err == f"hil: {broken}:2: 1+ is 'one', expected a number\n"


@pytest.mark.parametrize("name", ["fanuc", "sinumerik", "twincat"])
@pytest.mark.parametrize("asked", [0.05, 0.3, 1.0])
def test_the_tolerance_that_was_asked_for_is_kept_or_refused(
    name: str, asked: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A curve that no straight lines hold, in both directions; 12 machines drawn at random. Judged by reading the file back."""
    rng = np.random.default_rng(8)
    kept = refused = 0
    for machine in range(12):
        at = np.unique(np.round(rng.uniform(0.0, 500.0, 24), 1))
        table = np.cumsum(rng.normal(0.0, 2.0, len(at)))
        lost = rng.uniform(1.0, 8.0)
        curves = "".join(f"{x},{y:.4f},{y - lost:.4f}\n" for x, y in zip(at, table - table[0], strict=True))
        source, there, back = tmp_path / "t.csv", tmp_path / "there", tmp_path / "back.csv"
        source.write_text(f"position_mm,plus_um,minus_um\n{curves}")
        more = OPTIONS[name][:2] if name == "fanuc" else OPTIONS[name]
        more = [*more, "--reference-mm", f"{at[0]}"] if name != "twincat" else more
        argv = ["export", str(source), "--format", name, "--out", str(there), *more, "--tolerance-um", f"{asked}"]
        if name == "fanuc" and machine % 2:
            argv += ["--detection-unit-um", "0.1"]
        code = main(argv)
        if code == 2:
            refused += 1
            assert "µm" in capsys.readouterr().err
            there.unlink(missing_ok=True)
            continue
        kept += 1
        again = [*AGAIN[name], *(["--reference-mm", f"{at[0]}"] if name == "fanuc" else [])]
        again += ["--detection-unit-um", "0.1"] if name == "fanuc" and machine % 2 else []
        assert main(["import", str(there), "--format", name, "--out", str(back), *again]) == 0
        wanted, found = read_manual_tables(str(source)), read_manual_tables(str(back))
        where = np.linspace(at[0], at[-1], 4001)
        off = [np.max(np.abs(wanted.correction_um(where, sign) - found.correction_um(where, sign))) for sign in (1, -1)]
        assert max(off) <= asked + 1e-3
    assert kept + refused == 12
    if name == "fanuc" and asked == 0.3:
        assert refused >= 6  # a detection unit of 1 µm rounds by up to 0.5


@pytest.mark.parametrize("name", ["fanuc", "sinumerik", "twincat", "linuxcnc", "mach3", "mach4"])
def test_the_tolerance_that_a_refusal_names_is_kept(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two directions whose difference varies along the axis by 1.2 µm: one map with a constant backlash is off by 0.3 µm at least."""
    at = np.arange(0.0, 501.0, 2.5)
    plus = 1.3 * np.sin(2 * np.pi * at / 97.0)
    minus = plus - 9.0 - 0.6 * np.cos(2 * np.pi * at / 500.0)
    source, out = tmp_path / "t.csv", tmp_path / "there"
    curves = "".join(f"{x},{up:.4f},{down:.4f}\n" for x, up, down in zip(at, plus, minus, strict=True))
    source.write_text(f"position_mm,plus_um,minus_um\n{curves}")
    argv = ["export", str(source), "--format", name, "--out", str(out)]
    argv += OPTIONS.get(name, [])[:2] if name == "fanuc" else OPTIONS.get(name, [])
    said = ""
    for asked in (0.32, 0.0005):
        if main([*argv, "--tolerance-um", f"{asked}"]) == 2:
            said = capsys.readouterr().err
            break
    advised = re.search(r"The best it reaches is ([\d.]+) µm\. Allow that \(--tolerance-um\)", said)
    if name in ("fanuc", "mach3"):
        assert advised is not None, said
    if advised is None:
        return
    assert not out.exists()
    assert main([*argv, "--tolerance-um", advised[1]]) == 0
    if name == "mach3":
        assert (
            float(advised[1]) < 0.5
        )  # 0.3 by the constant backlash, 0.05 by the digits of each part, the rest by the points
