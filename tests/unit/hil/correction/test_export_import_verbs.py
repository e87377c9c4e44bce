"""`hil export` and `hil import` as a user types them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.instruments.replay import Recording
from drivers.limits import DriveLimits
from hil.app.main import main
from hil.correction.compensation import Compensation
from hil.correction.formats import CONTROLLERS, MEASUREMENTS
from hil.correction.manual import read_manual_tables
from hil.correction.sealed import new_key, save_public_key
from hil.correction.store import SealedStore
from hil.correction.tables import TableSet
from hil.diagnosis.next.plans import read_plan
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
        (ASCII.replace("target", "L\N{LATIN SMALL LETTER A WITH DIAERESIS}nge").encode("latin-1"), None),
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
@pytest.mark.parametrize(
    "asked",
    [0.3, *(pytest.param(asked, marks=pytest.mark.outside) for asked in (0.05, 1.0))],
)
def test_the_tolerance_that_was_asked_for_is_kept_or_refused(
    name: str, asked: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A curve that no straight lines hold, in both directions; 4 machines drawn at random. Judged by reading the file back."""
    rng = np.random.default_rng(8)
    kept = refused = 0
    for machine in range(4):
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
    assert kept + refused == 4
    if name == "fanuc" and asked == 0.3:
        assert refused >= 2  # a detection unit of 1 µm rounds by up to 0.5


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


TRIMS = "0 0 -0.004\n100 -0.002 -0.006\n200 -0.005 -0.009\n"
REACHED = "0 0 0.004\n100 100.002 100.006\n200 200.005 200.009\n"
SCREW_MAP = "0,{0}\n50,{1}\n120,{2}\n"
WRONG: dict[str, tuple[str, list[str], str]] = {
    "linuxcnc reached": (
        REACHED,
        ["linuxcnc", "--type", "1"],
        "COMP_FILE_TYPE 1 but of the other one: give that (--type)",
    ),
    "linuxcnc trims": (TRIMS, ["linuxcnc", "--type", "0"], "COMP_FILE_TYPE 0 but of the other one: give that (--type)"),
    "linuxcnc one reached": ("100 100.002 100.006\n", ["linuxcnc"], "give that (--type)"),
    "csv other unit of targets": (
        "run,direction,target_mm,measured_mm\n1,+,0,0\n1,+,.05,50.002\n1,+,.09,90.001\n",
        ["csv"],
        "with :UNIT where it is another (--column)",
    ),
    "csv short axis": (
        "run,direction,target_mm,measured_mm\n1,+,0,.002\n1,+,.5,.003\n1,+,.9,.001\n",
        ["csv"],
        "error_um=HEADER",
    ),
    "csv directions": (
        "run,direction,target_mm,measured_mm\n1,-,0,.002\n1,-,50,50\n1,+,50,50\n1,+,0,0\n",
        ["csv"],
        "exchange the directions",
    ),
    "lines directions": (
        "+ 9 9.001\n+ 5 5.002\n+ 0 0\n- 0 .001\n- 5 5\n- 9 9\n",
        ["lines", "--pattern", r"^(?P<direction>\S) (?P<target_mm>\S+) (?P<measured_mm>\S+)$"],
        "exchange the directions",
    ),
    "csv heading": (
        "run,direction,target_mm,Dev [mm]\n1,+,0,.002\n1,-,0,.001\n",
        ["csv", "--column", "error_um=Dev [mm]"],
        "column 4 is in mm, taken is um; state it: --column NAME=HEADER:UNIT",
    ),
    "csv heading of two lines": (
        'run,direction,target_mm,"Dev\n(mm)"\n1,+,0,.002\n1,-,0,.001\n',
        ["csv", "--column", "error_um=Dev (mm)"],
        ":1: column 4 is in mm, taken is um",
    ),
    "iso-wide heading": ("Target (inch),1+,1-\n0,1,4\n50,2,4\n", ["iso-wide"], "column 1 is in inch, taken is mm"),
    "mach3 errors": ("commanded_mm,real_mm\n" + SCREW_MAP.format(0, 0.01, 0.02), ["mach3"], "position_mm,error_mm"),
    "mach4 positions": (
        "position_mm,error_mm\n" + SCREW_MAP.format(0, 50.01, 120.0),
        ["mach4", "--symmetric"],
        "real_mm",
    ),
    "sinumerik positions": (
        "".join(f"$AA_ENC_COMP[0,{i},X1]={100 * i}.002\n" for i in range(3))
        + "".join(f"$AA_ENC_COMP_{key}[0,X1]={value}\n" for key, value in (("STEP", 100), ("MIN", 0), ("MAX", 200))),
        ["sinumerik"],
        "errors in place of positions",
    ),
    "twincat positions": (
        "kw.ssfk.kw_nr_max 3\nkw.ssfk.unit 1\n"
        + "".join(f"kw.ssfk.table[{i}].setpoint {1000 * i}\nkw.ssfk.table[{i}].pos {1000 * i + 2}\n" for i in range(3)),
        ["twincat"],
        "errors in place of positions",
    ),
    "fanuc unit": (
        "G10 L50\nN3620 P1 R1\nN3621 P1 R1\nN3622 P1 R3\nN3623 P1 R1\nN3624 P1 R20\nN10001 R5\nN10002 R6\nN10003 R4\nG11\n",
        ["fanuc", "--axis", "1"],
        "(--detection-unit-um) and 3624 in 0.001 mm (--setting-unit-mm)",
    ),
    "grblhal steps": (
        "; hil: X from 0 to 300 mm\n$100=320\n",
        ["grblhal", "--steps-per-mm", "160"],
        "(--steps-per-mm)",
    ),
    "csv errors": (
        "run,direction,target_mm,measured_mm\n1,+,0,.002\n1,+,50,.003\n1,+,90,.001\n",
        ["csv"],
        "error_um=HEADER",
    ),
    "csv positions": (
        "run,direction,target_mm,error_um\n1,+,0,.002\n1,+,50,50.003\n1,+,90,90.001\n",
        ["csv", "--column", "error_um=error_um"],
        "measured_mm=HEADER",
    ),
    "csv unit": (
        "run,direction,target_mm,measured_mm\n1,+,0,0\n1,+,50,50000\n1,+,90,90001\n",
        ["csv"],
        "with :UNIT where it is another (--column)",
    ),
    "iso-wide positions": ("target,1+,1-\n0,0,.004\n50,50.001,50.004\n90,90,90.003\n", ["iso-wide"], "(--cells)"),
    "iso-wide errors": (
        "target,1+,1-\n0,1,4\n50,2,4\n90,1,3\n",
        ["iso-wide", "--cells", "position_mm"],
        "deviation_um, deviation_mm, position_mm, as the cells are (--cells)",
    ),
    "keysight positions": (
        "Identify=Positions,TextUnit=0 50 90 mm\nIdentify=LinearErr,TextUnit=0 50.1 90 90 50 0.1 mm\n",
        ["keysight"],
        "write the errors",
    ),
    "lines positions": (
        "0 0.001\n50 50.002\n90 90.001\n",
        ["lines", "--pattern", r"^(?P<target_mm>\S+) (?P<error_um>\S+)$"],
        "measured_<unit> for positions",
    ),
    "renishaw positions": (
        "TARGET DATA::\nTarget-count: 3\nTargets :\n0 50 90\nFlags: 0 0 2 0\nRUNS::\nRun-count: 1\nDEVIATIONS::\n"
        "Run Target Data:\n1 1 0.001\n1 2 50.002\n1 3 90.001\n",
        ["renishaw"],
        "write the errors",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_values_read_as_what_they_are_not_are_refused_with_the_option(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, options, remedy = WRONG[name]
    path, out = tmp_path / "file", tmp_path / "out.csv"
    path.write_text(text)
    assert main(["import", str(path), "--format", *options, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"hil: {path}:")
    assert said.count("\n") == 1
    assert remedy in said
    assert not out.exists()


def test_every_format_of_import_is_tried_with_values_of_the_other_kind() -> None:
    tried = {options[0] for _, options, _ in WRONG.values()}
    assert {one.name for one in (*CONTROLLERS, *MEASUREMENTS)} - tried == {"fluidnc"}  # the settings of grblhal


GERMAN = [
    *(
        "--column",
        "run=Lauf",
        "--column",
        "direction=Richtung",
        "--column",
        "target_mm=Soll",
        "--column",
        "measured_mm=Ist",
    ),
    *("--decimal", ","),
]
HEAD, ROWS = "Lauf§Richtung§Soll§Ist", ["1§+§0,0§0,002", "1§-§0,0§0,004"]


@pytest.mark.parametrize("delimiter", [";", "\t", "|"])
@pytest.mark.parametrize(
    "lines",
    [
        ["sep=§", HEAD, *ROWS],
        ['"sep=§"', "", HEAD, *ROWS],
        [HEAD, *ROWS, "§§§", "§§§"],
        [HEAD, *(row + "§§" for row in ROWS)],
        [HEAD + "§", *(row + "§" for row in ROWS)],
        [HEAD, "§§mm§mm", *ROWS],
        [HEAD, "-§§[MM]§(mm)", *ROWS],
        ["Messung der X-Achse", "Datum§12.03.2024", "", HEAD, *ROWS],
        ["sep=§", "Messung§X-Achse", HEAD, "§§mm§mm", *ROWS, "§§§§"],
        [
            '"Messung',
            'der Achse"§"in mm"',
            HEAD.replace("Lauf", '"Lauf"') + '§"Bemerkung\n(frei)"',
            *(row + "§" for row in ROWS),
        ],
        ['L = 10"§"offen', HEAD, *ROWS],
    ],
)
def test_what_a_spreadsheet_writes_round_a_table_is_no_row(delimiter: str, lines: list[str], tmp_path: Path) -> None:
    path, out = tmp_path / "lab.csv", tmp_path / "records.csv"
    path.write_text("\r\n".join(lines).replace("§", delimiter), newline="")
    named = [] if any("sep=" in line for line in lines) else ["--delimiter", delimiter]
    assert main(["import", str(path), "--format", "csv", *GERMAN, *named, "--out", str(out)]) == 0
    assert read_csv(out).error_um == pytest.approx([2, 4])


@pytest.mark.parametrize(
    ("text", "reader"),
    [
        ("sep=,\nrun,direction,target_mm,measured_mm,\n1,+1,0,0.001,,\n,,,\n", read_csv),
        ("sep=,\nposition_mm,plus_um,minus_um,\n0,1,2,,\n,,\n9,1,2\n", read_manual_tables),
        ("sep=,\ntime_s,laser_mm,\n0,1,\n,,\n", Recording.read),
        (
            "sep=,\nrun,direction,target_mm,\n1,+1,10,,\n,,\n",
            partial(read_plan, limits=DriveLimits(0.0, 500.0, 100.0, 500.0)),
        ),
    ],
)
def test_tables_of_this_program_are_read_when_a_spreadsheet_saved_them(
    text: str, reader: Callable[[Path], object], tmp_path: Path
) -> None:
    path, plain = tmp_path / "saved.csv", tmp_path / "plain.csv"
    path.write_text(text)
    rows = [line.rstrip(",") for line in text.splitlines()[1:]]
    plain.write_text("\n".join(filter(None, rows)) + "\n")
    assert repr(reader(path)) == repr(reader(plain))


def test_a_row_of_other_units_is_refused_with_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "lab.csv", str(tmp_path / "records.csv")
    path.write_text("\n".join([HEAD, "§§mm§µm", *ROWS]).replace("§", ";"))
    assert main(["import", str(path), "--format", "csv", *GERMAN, "--out", out]) == 2
    assert f"{path}:2: column 4 is in µm, taken is mm; state it: --column NAME=HEADER:UNIT" in capsys.readouterr().err
    path.write_text("target,1+,1-\nmm,mm,mm\n0,0.001,0.004\n9,0.001,0.004\n")
    assert main(["import", str(path), "--format", "iso-wide", "--out", out]) == 2
    assert "column 2 is in mm, taken is um" in capsys.readouterr().err
    assert main(["import", str(path), "--format", "iso-wide", "--cells", "deviation_mm", "--out", out]) == 0
    path.write_text("run,direction,target_mm,Dev [mm]\n,,in mm,mm\n1,+,0,.002\n1,-,0,.001\n")
    assert main(["import", str(path), "--format", "csv", "--column", "error_um=Dev [mm]:mm", "--out", out]) == 0
    assert read_csv(out).error_um == pytest.approx([2, 1])
