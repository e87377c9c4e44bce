"""A user's own procedure in one file, by `hil run`, by `axis.run` and on the screen's desk."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis

import hil
from drivers.drive import DriveState
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.desk.desk import Desk
from hil.examples import creep
from hil.records.rows import read_csv
from hil.script.procedure_job import procedure_job

HEAD = """\
from collections.abc import Iterator
import hil

class Steps(hil.Procedure):
    places_mm: tuple[float, ...] = (40.0, 60.0, 30.0)
    readings: int = 3

    def plan(self, axis: hil.Axis) -> Iterator[hil.Move]:
        yield hil.Move("measure", 25.0, 80.0, 100.0)

    def run(self, axis: hil.Axis) -> Iterator[hil.Row]:
        for run, place_mm in enumerate(self.places_mm, start=1):
            axis.move_to(place_mm)
            for number in range(self.readings):
                yield axis.read().row(run)
"""
LINE_OF_MOVE, LINE_OF_YIELD, LINE_OF_PLAN = 13, 15, 8


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    bench_axis.lay_out(tmp_path)
    (tmp_path / "steps.py").write_text(HEAD)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rows_of(folder: Path, name: str = "steps") -> Path:
    return folder / f"X-campaign/run-{name}-001/{name}.csv"


def test_creep_after_a_stop_becomes_rows_that_the_diagnosis_takes(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(creep.__file__, "creep.py")
    words = ["run", "creep.py", "axis.toml", "--watch-s", "4", "--targets_mm", "100,20,60"]
    assert main([*words[:-2], "--targets", "100,60", "--dry-run"]) == 0
    datum_mm = load_axis("axis.toml").measurement.reference_mm
    overrun_mm = load_axis("axis.toml").measurement.overrun_mm
    assert (
        f"would move between {datum_mm - overrun_mm:.3f} and 100.000 mm (corrections come on top) at 50 and 100 mm/s"
        in (capsys.readouterr().out)
    )
    assert not (folder / "X-campaign").exists()
    assert main([*words, "--json", "creep.json", "--report", "creep.html"]) == 0
    rows = read_csv(rows_of(folder, "creep"))
    assert list(np.unique(rows.run)) == [1, 2, 3]
    assert set(rows.direction[rows.run == 2]) == {-1.0}
    assert {"time_s", "motor_mm", "air_temp_c", "temp_screw_c"} <= set(rows.columns)
    result = json.loads(Path("creep.json").read_text())
    assert (result["rows"], result["parameters"]["watch_s"]) == (len(rows), 4.0)
    assert "Creep" in Path("creep.html").read_text(encoding="utf-8")
    assert rows_of(folder, "creep").with_name("creep.py").read_bytes() == Path("creep.py").read_bytes()
    assert main(["diagnose", str(rows_of(folder, "creep")), "--json", "found.json"]) in (0, 1)
    diagnosed = json.loads(Path("found.json").read_text())
    assert "findings" in diagnosed
    assert not [note for note in diagnosed["notes"] if "made up" in note], "the rows say when the axis reversed"
    assert set(rows["stroke_mm"][rows.run == 3]) == {80.0}
    capsys.readouterr()
    assert main(["records", "list", "X-campaign"]) == 0
    assert "run-creep-001" in capsys.readouterr().out


OF_CREEP = """\
import hil
from hil.examples.creep import Creep

class Steps(Creep):
    targets_mm: float = 30.5
    watch_s: int = 3

    def plan(self, axis: hil.Axis):
        yield hil.Move("measure", self.targets_mm, self.targets_mm, 100.0)
"""


def test_a_parameter_has_the_type_of_the_class_that_declares_it_last(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "steps.py").write_text(OF_CREEP)
    assert main(["run", "steps.py", "axis.toml", "--dry-run", "--targets-mm", "31.5"]) == 0
    assert "31.5" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["run", "steps.py", "axis.toml", "--dry-run", "--watch-s", "2.5"])
    assert "--watch-s/--watch_s: is '2.5', expected a whole number" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("class Steps(hil.Procedure)", "class Steps", None, "holds no procedure"),
        ("import hil\n", "import hil\nclass More(hil.Procedure): pass\n", 5, "holds More and Steps"),
        ("def plan", "def plane", 4, "Steps has no plan()"),
        ("readings: int = 3", "readings: list = [3]", None, "ValueError"),
        ("readings: int = 3", "readings: complex = 3j", 6, "is of type complex"),
        ("readings: int = 3", "readings: int = 'three'", 6, "is 'three', expected a whole number"),
        ("readings: int = 3", "readings: 'Number' = 3", 4, "unknown type"),
        ("readings: int = 3", "readings: int = 3\n    json: str = ''", 7, "hil run has an option of this name"),
        ("class Steps(", "class Steps((", 4, "SyntaxError"),
        ("25.0, 80.0, 100.0", "25.0, 900.0, 100.0", LINE_OF_PLAN, "outside the travel"),
        ("25.0, 80.0, 100.0", "25.0, 80.0, 1e6", LINE_OF_PLAN, "at most 200 mm/s"),
        ("25.0, 80.0, 100.0", "80.0, 25.0, 1.0", LINE_OF_PLAN, "low_mm ≤ high_mm"),
        ("yield hil.Move", "return hil.Move", LINE_OF_PLAN, "TypeError"),
        ("yield hil.Move(", "yield dict(what=1) or hil.Move(", LINE_OF_PLAN, "expected moves"),
        ("25.0, 80.0,", "25.0, 80.0 / 0.0,", LINE_OF_PLAN + 1, "ZeroDivisionError"),
    ],
)
def test_a_mistake_in_the_file_is_one_line_before_anything_moves(  # noqa: PLR0917
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, line: int | None, words: str
) -> None:
    (folder / "steps.py").write_text(HEAD.replace(old, new, 1))
    assert main(["run", "steps.py", "axis.toml"]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert words in said
    assert f"steps.py:{line}: " in said if line else "steps.py" in said
    assert not list(folder.glob("X-campaign/run-*"))


@pytest.mark.parametrize(
    ("old", "new", "line", "words", "status"),
    [
        ("axis.read().row(run)", "axis.read().row(run // 0)", LINE_OF_YIELD, "ZeroDivisionError", 2),
        ("axis.read().row(run)", "axis.read()", LINE_OF_YIELD, "expected a row", 2),
        ("axis.read().row(run)", "axis.read().row(-run)", LINE_OF_YIELD, "after one of run -1", 2),
        (".row(run)", ".row(run) | ({'x': 1.0} if number else {})", LINE_OF_YIELD, "new column(s) x", 2),
        (".row(run)", ".row(run) | ({'motor_mm': 'far'} if number else {})", LINE_OF_YIELD, "motor_mm", 2),
        (".row(run)", ".row(run) | {'direction': 0.0}", LINE_OF_YIELD, "direction", 2),
        ("range(self.readings)", "range(0)", 11, "yields no row", 2),
        ("axis.move_to(place_mm)", "axis.home()", LINE_OF_MOVE, "is homed already", 2),
        ("axis.move_to(place_mm)", "axis.verify(corrected=False)", LINE_OF_MOVE, "no attribute 'verify'", 2),
        ("axis.move_to(place_mm)", "axis.parameters.backup()", LINE_OF_MOVE, "no attribute 'parameters'", 2),
        ("axis.move_to(place_mm)", "axis.move_to(90.0)", LINE_OF_MOVE, "no move that plan() names", 1),
        ("axis.move_to(place_mm)", "axis.move_to(40.0, 150.0)", LINE_OF_MOVE, "no move that plan() names", 1),
        ("axis.move_to(place_mm)", "axis.stream([20.2, 19.0], 0.1)", LINE_OF_MOVE, "no move that plan() names", 1),
    ],
)
def test_a_mistake_while_it_runs_names_its_line(  # noqa: PLR0917
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, line: int, words: str, status: int
) -> None:
    (folder / "steps.py").write_text(HEAD.replace(old, new, 1))
    assert main(["run", "steps.py", "axis.toml"]) == status
    said = capsys.readouterr().err.splitlines()
    assert words in said[0]
    assert f"steps.py:{line}" in said[0]
    assert all(one.startswith("hil: go on with: hil run steps.py axis.toml") for one in said[1:])


def test_a_wrong_value_on_the_command_line_names_its_option(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--readings", "3.5"], ["--places-mm", "20,nan"], ["--reading-s", "3"]):
        with pytest.raises(SystemExit) as ended:
            main(["run", "steps.py", "axis.toml", *words])
        assert ended.value.code == 2
        assert words[0] in capsys.readouterr().err
    assert main(["run", "steps.txt", "axis.toml"]) == 2
    assert main(["run", "gone.py", "axis.toml"]) == 2


class Watched(hil.Procedure):
    """Three runs of three readings. skips: passes over the runs that are on disk, else leaves that to the journal."""

    skips: bool = True

    def plan(self, axis: hil.Axis) -> Iterator[hil.Move]:
        yield hil.Move("measure", 25.0, 80.0, 100.0)

    def run(self, axis: hil.Axis) -> Iterator[hil.Row]:
        for run, place_mm in enumerate((40.0, 60.0, 30.0), start=1):
            axis.move_to(place_mm)
            if self.skips and run < axis.first_run:
                continue
            for _ in range(3):
                yield axis.read().row(run)


def pressed(event: hil.Event) -> None:
    if event.done == 5:
        raise KeyboardInterrupt


@pytest.mark.parametrize("skips", [True, False])
def test_ctrl_c_keeps_the_rows_and_the_broken_run_is_measured_again(folder: Path, skips: bool) -> None:
    with pytest.raises(KeyboardInterrupt), hil.open("axis.toml", on_event=pressed) as axis:
        axis.run(Watched(skips=skips))
    with hil.open("axis.toml") as axis:
        assert axis.read().state != DriveState.ENABLED.value
        before = read_csv(rows_of(folder, "watched"))
        assert list(before.run) == [1, 1, 1, 2, 2]
        whole = axis.run(Watched(skips=skips), resume=True)
    assert list(whole.rows["run"]) == [1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert list(whole.rows["time_s"][:3]) == list(before["time_s"][:3])
    assert np.all(np.diff(whole.rows["time_s"]) > 0.0)
    assert list(read_csv(whole.path).run) == list(whole.rows["run"])


class GoesBack(Watched):
    """Moves when it is ended."""

    def run(self, axis: hil.Axis) -> Iterator[hil.Row]:
        try:
            yield from super().run(axis)
        finally:
            axis.move_to(30.0)


def test_after_ctrl_c_the_end_of_a_procedure_moves_nothing(folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt) as ended, hil.open("axis.toml", on_event=pressed) as axis:
        axis.run(GoesBack())
    assert "no move that plan() names" in " ".join(ended.value.__notes__)


class Follows(hil.Procedure):
    """Set-points that are sums, at the planned velocity."""

    def plan(self, axis: hil.Axis) -> Iterator[hil.Move]:
        yield hil.Move("measure", 30.0, 36.0, 10.0)

    def run(self, axis: hil.Axis) -> Iterator[hil.Row]:
        axis.move_to(30.0, 10.0)
        for one in axis.stream([30.0 + 0.1 * step for step in range(1, 61)], 0.01):
            yield {"run": 1, "direction": 1.0, "measured_mm": one["motor_mm"], **one}


def test_a_rounded_set_point_is_within_the_plan(folder: Path) -> None:
    with hil.open("axis.toml") as axis:
        assert len(axis.run(Follows()).rows["run"]) == 60


def test_a_resumed_procedure_goes_on(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = HEAD.replace(
        "                yield", "                if run == 2 and number == 2: BREAK\n                yield"
    )
    (folder / "steps.py").write_text(lines.replace("BREAK", "raise KeyboardInterrupt"))
    assert main(["run", "steps.py", "axis.toml", "--readings", "4"]) == 130
    assert "go on with: hil run steps.py axis.toml --readings 4 --resume" in capsys.readouterr().err
    kept = read_csv(rows_of(folder))
    assert list(kept.run) == [1] * 4 + [2] * 2
    other_columns = lines.replace("BREAK", "pass").replace(".row(run)", ".row(run) | {'x': 1.0}")
    (folder / "steps.py").write_text(other_columns)
    assert main(["run", "steps.py", "axis.toml", "--readings", "4", "--resume"]) == 2
    assert list(read_csv(rows_of(folder)).run) == list(kept.run), "nothing is withdrawn for a row that is refused"
    (folder / "steps.py").write_text(lines.replace("BREAK", "raise ValueError"))
    assert main(["run", "steps.py", "axis.toml", "--readings", "4", "--resume"]) == 2
    assert main(["run", "steps.py", "axis.toml", "--readings", "5", "--resume"]) == 2
    assert "readings was 4 and is 5" in capsys.readouterr().err
    (folder / "steps.py").write_text(HEAD)  # mended
    assert main(["run", "steps.py", "axis.toml", "--readings", "4", "--resume"]) == 0
    whole = read_csv(rows_of(folder))
    assert list(whole.run) == [1] * 4 + [2] * 4 + [3] * 4
    assert list(whole.measured_mm[:4]) == list(kept.measured_mm[:4])
    assert np.all(np.diff(whole["time_s"]) > 0.0)
    assert len(list(folder.glob("X-campaign/run-*"))) == 1
    assert main(["run", "steps.py", "axis.toml", "--readings", "4", "--resume"]) == 2
    assert "there is nothing to resume" in capsys.readouterr().err


@pytest.mark.usefixtures("passwords")
def test_with_the_stored_correction_in_force(folder: Path) -> None:
    with hil.open("axis.toml") as axis:
        axis.calibrate(targets_mm=[20.0, 60.0, 100.0], dwell_s=0.1, reading_s=0.1)
        bare, corrected = (axis.run(Watched(), corrected=one) for one in (False, True))
    assert np.all(bare.rows["command_mm"] == bare.rows["target_mm"])
    assert np.all(corrected.rows["command_mm"] != corrected.rows["target_mm"])
    assert "Watched of X: 9 rows in 3 run(s)" in repr(corrected)


def test_the_desk_of_the_screen_carries_it_out(folder: Path) -> None:
    axis = load_axis("axis.toml")
    job = procedure_job(axis, Watched())
    assert job.plan.reach_mm == pytest.approx((axis.measurement.reference_mm - 1.0, 80.0))
    with Desk(axis, pace=0.0) as desk:
        deadline = time.monotonic() + 30.0
        while not desk.live.connected and time.monotonic() < deadline:
            time.sleep(0.01)
        desk.run(desk.take_control("me"), job)
        while (shown := desk.job()) is not None and shown.running and time.monotonic() < deadline:
            time.sleep(0.01)
    assert len(read_csv(rows_of(folder, "watched"))) == 9
