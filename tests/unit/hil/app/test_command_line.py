"""The `hil` process as its surroundings see it: streams that are closed, full or poor in letters, and Ctrl-C before it has begun."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
import tomllib
from functools import partial
from importlib import import_module
from pathlib import Path

import pytest
from support import bench_axis
from support.toy_axis import ToyDrive, ToyMachine

from hil.app import main as entry
from hil.correction import CONTROLLER_FORMATS, MEASUREMENT_FORMATS, RISE_SHAPES
from hil.correction.formats import CONTROLLERS, MEASUREMENTS
from hil.correction.rise import RUNNABLE
from hil.desk.error_log import MOST_BYTES, ErrorLog
from hil.ui.terminal.options import Later
from hil.ui.terminal.progress import telling_notes

RECORDS = "run,direction,target_mm,measured_mm\n" + "".join(
    f"{run},{d:+d},{p},{p + 0.001 * run * d}\n" for run in (1, 2) for d in (1, -1) for p in (0.0, 10.0)
)


@pytest.fixture
def records(tmp_path: Path) -> Path:
    path = tmp_path / "µm é.csv"
    path.write_text(RECORDS)
    return path


def hil(*argv: str | Path, shell: str = '"$@"', **environment: str) -> subprocess.CompletedProcess[str]:
    """Run it in a shell, which lays the streams; its standard error is read."""
    command = ["sh", "-c", shell, "sh", sys.executable, "-m", "hil.app", *map(str, argv)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})


@pytest.mark.outside
def test_a_terminal_without_the_letters_of_the_field_gets_the_figures_all_the_same(records: Path) -> None:
    done = hil("iso230", records, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert "ISO 230-2:2014 ? 2 targets" in done.stdout


@pytest.mark.outside
def test_with_standard_output_closed_the_verdict_still_counts(records: Path) -> None:
    done = hil("iso230", records, shell='"$@" >&-')
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.outside
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_output_that_nobody_takes_is_an_error_of_one_line(records: Path) -> None:
    done = hil("iso230", records, shell='"$@" >/dev/full')
    assert done.returncode != 0
    assert done.stderr == "hil: No space left on device\n"


@pytest.mark.outside
def test_ctrl_c_while_the_program_loads_ends_it_without_a_traceback(records: Path, tmp_path: Path) -> None:
    package = tmp_path / "path" / "numpy"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(f"import os\nos.kill(os.getpid(), {int(signal.SIGINT)})\n")
    done = hil("iso230", records, shell='exec "$@"', PYTHONPATH=str(package.parent))
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


WIRES = {"can", "canopen", "pymodbus", "serial"}
HEAVY = {"numpy", "scipy.special", "matplotlib", "cryptography", "rich", "nicegui", "msgspec", *WIRES}
"""SciPy alone loads next to nothing; every module of it that computes loads `scipy.special`."""


HELP = """
import contextlib, io, sys
from hil.app.main import build_parser
for argv in sys.argv[1:]:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        build_parser(argv.split()).parse_args([*argv.split(), "--help"])
print(*sys.modules)
"""


READ_SECTIONS = {"drives", "backlash"}
"""Their options are named in sections of the axis file."""


@pytest.mark.outside
@pytest.mark.parametrize(
    ("verbs", "absent"),
    [
        (["", "nonsense", *entry.VERBS.keys() - READ_SECTIONS], HEAVY),
        (list(READ_SECTIONS), HEAVY - {"msgspec"}),
    ],
)
def test_the_help_of_a_verb_loads_neither_wires_nor_what_computes(verbs: list[str], absent: set[str]) -> None:
    done = subprocess.run([sys.executable, "-c", HELP, *verbs], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & absent


@pytest.mark.outside
@pytest.mark.parametrize(
    ("modules", "absent"),
    [
        (
            "hil.calibration.commands.calibrate",
            HEAVY - {"numpy", "cryptography", "msgspec", "serial"} | {"scipy", "sim_backends.bench"},
        ),
        ("hil.doctor.command", HEAVY - {"numpy", "cryptography", "msgspec", "serial"} | {"sim_backends.bench"}),
        (
            "hil.calibration.commands.verify hil.machine.canopen_wiring",
            {"scipy", "rich", "pymodbus", "canopen"},
        ),
        ("hil.calibration.commands.verify hil.machine.modbus_wiring", {"scipy", "rich", "can", "canopen"}),
        ("hil.backlash.command", WIRES - {"serial"}),
    ],
)
def test_a_job_loads_the_wire_of_its_axis_file_and_before_it_connects_none(modules: str, absent: set[str]) -> None:
    load = "import importlib, sys; [importlib.import_module(one) for one in sys.argv[1:]]; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", load, *modules.split()], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & absent


def _sub_verbs(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return [parser, *(one for action in below for each in action.choices.values() for one in _sub_verbs(each))]


def test_what_a_verb_runs_is_there() -> None:
    """Named by module and function, and imported when the verb runs."""
    parsers = [one for verb in entry.VERBS for one in _sub_verbs(entry.build_parser([verb]))]
    runs = [run for one in parsers if isinstance(run := one.get_default("run"), Later)]
    assert len(runs) > len(entry.VERBS)
    assert all(callable(getattr(import_module(run.module), run.name)) for run in runs)


@pytest.mark.parametrize("verb", entry.VERBS)
def test_every_line_of_the_help_has_its_verb(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        entry.build_parser([verb]).parse_args([verb, "--help"])
    assert capsys.readouterr().out.startswith(f"usage: hil {verb} ")


def mistaken(_args: object) -> int:
    raise LookupError("nobody\nforesaw this")


def test_a_mistake_of_the_program_is_one_line_and_its_traceback_a_file(
    records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("hil.files.iso230.run", mistaken)
    log = tmp_path / "state" / "hil" / "errors.log"
    assert entry.main(["iso230", str(records)]) == 1
    assert capsys.readouterr().err == f"hil: LookupError: nobody foresaw this; the traceback is in {log}\n"
    assert 'raise LookupError("nobody\\nforesaw this")' in log.read_text()
    axis = bench_axis.lay_out(tmp_path)
    monkeypatch.setattr("hil.doctor.command.run", mistaken)
    assert entry.main(["doctor", str(axis)]) == 1
    log = tmp_path / "X-campaign" / "errors.log"
    assert capsys.readouterr().err.endswith(f"; the traceback is in {log}\n")
    assert "Traceback" in log.read_text()


def test_a_file_that_cannot_be_written_hides_no_mistake(
    records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "state").write_text("no directory")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("hil.files.iso230.run", mistaken)
    assert entry.main(["iso230", str(records)]) == 1
    assert "LookupError: nobody foresaw this; its traceback cannot be kept in" in capsys.readouterr().err


def test_a_thread_that_nobody_watches_tells_its_mistake_and_leaves_its_traceback(
    records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(_args: object) -> int:
        for work in (partial(mistaken, None), sys.exit):
            thread = threading.Thread(target=work, name="stray")
            thread.start()
            thread.join()
        return 0

    hook = threading.excepthook
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("hil.files.iso230.run", run)
    assert entry.main(["iso230", str(records)]) == 0
    log = tmp_path / "state" / "hil" / "errors.log"
    assert capsys.readouterr().err == f"hil: LookupError: nobody foresaw this; the traceback is in {log}\n"
    assert "thread stray" in log.read_text()
    assert threading.excepthook is hook


def test_the_file_of_tracebacks_stays_small_and_keeps_the_same_one_once(tmp_path: Path) -> None:
    log = ErrorLog(tmp_path / "errors.log")
    for number in range(3 * MOST_BYTES // 1000):
        error = ValueError(f"{number} {'x' * 1000}")
        assert log.line_of(error) == log.line_of(error)
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == ["errors.log", "errors.log.1"]
    assert all(path.stat().st_size <= MOST_BYTES for path in tmp_path.iterdir())
    text = log.path.read_text()
    assert text.count(f"ValueError: {number} ") == 1, "the last one, once"


def test_ctrl_c_at_any_later_moment_is_said_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_argv: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(entry, "build_parser", interrupted)
    assert entry.main(["iso230", "records.csv"]) == 130
    assert capsys.readouterr().err.startswith("hil: interrupted; ")


def test_notes_of_a_drive_that_came_up_in_a_block_are_told_at_its_end(capsys: pytest.CaptureFixture[str]) -> None:
    drive = ToyDrive(ToyMachine())
    drive.notes = ["found by open"]
    with telling_notes(drive):
        drive.notes = ["found by open", "it does not take 6084h"]
        assert capsys.readouterr().err == ""
    assert capsys.readouterr().err == "hil: it does not take 6084h\n"


@pytest.mark.parametrize(
    ("line", "nearest"),
    [
        (
            "calibrat X.toml",
            "hil: argument VERB: invalid choice: 'calibrat', the nearest is calibrate (see hil --help)",
        ),
        ("Lost_Motion X.toml", "the nearest is lost-motion"),
        ("params bakup X.toml", "'bakup', the nearest is backup (see hil params --help)"),
        ("import x --format linxcnc --out y", "'linxcnc', the nearest is linuxcnc (see hil import --help)"),
        ("xyzzy", "choose from 'help', 'demo'"),
    ],
)
def test_a_wrong_verb_or_choice_names_the_nearest(line: str, nearest: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        entry.main(line.split())
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert nearest in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("report R --out PLACE/page.html", ""),  # written before the output is
        ("import R --format csv --out PLACE/copy.csv", ""),
        ("iso230 R --json PLACE/figures.json", "PLACE/figures.json was not written"),
        ("help", ""),
    ],
)
def test_an_output_that_its_reader_closes_is_an_error_that_names_what_was_lost(
    line: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = tmp_path / "rows.csv"
    rows.write_text("run,direction,target_mm,measured_mm\n1,+1,0,0.001\n1,+1,9,9.001\n1,-1,9,9.002\n1,-1,0,0.003\n")
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w", buffering=1) as closed:
        monkeypatch.setattr("sys.stdout", closed)
        assert (
            entry.main(
                [
                    word.replace("R", str(rows)) if word == "R" else word.replace("PLACE", str(tmp_path))
                    for word in line.split()
                ]
            )
            == 1
        )
        monkeypatch.undo()
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith("hil: the output was closed by its reader")
    assert says.replace("PLACE", str(tmp_path)) in said
    assert ("was not written" in said) == bool(says)


def test_the_version_is_that_of_the_project(capsys: pytest.CaptureFixture[str]) -> None:
    stated = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text())["project"]["version"]
    with pytest.raises(SystemExit, match="0"):
        entry.main(["--version"])
    assert capsys.readouterr().out == f"hil {stated}\n"


def test_what_options_name_is_what_there_is() -> None:
    assert tuple(one.name for one in CONTROLLERS) == CONTROLLER_FORMATS
    assert tuple(one.name for one in MEASUREMENTS) == MEASUREMENT_FORMATS
    assert tuple(shape.name for shape in RUNNABLE) == RISE_SHAPES
