"""The `hil` process as its surroundings see it: streams that are closed, full or poor in letters, and Ctrl-C before it has begun."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hil.cli import main as entry

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
    command = ["sh", "-c", shell, "sh", sys.executable, "-m", "hil.cli", *map(str, argv)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})


def test_a_terminal_without_the_letters_of_the_field_gets_the_figures_all_the_same(records: Path) -> None:
    done = hil("iso230", records, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert "ISO 230-2:2014 ? 2 targets" in done.stdout


def test_with_standard_output_closed_the_verdict_still_counts(records: Path) -> None:
    done = hil("iso230", records, shell='"$@" >&-')
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_output_that_nobody_takes_is_an_error_of_one_line(records: Path) -> None:
    done = hil("iso230", records, shell='"$@" >/dev/full')
    assert done.returncode != 0
    assert done.stderr == "hil: No space left on device\n"


def test_ctrl_c_while_the_program_loads_ends_it_without_a_traceback(records: Path, tmp_path: Path) -> None:
    package = tmp_path / "path" / "numpy"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(f"import os\nos.kill(os.getpid(), {int(signal.SIGINT)})\n")
    done = hil("iso230", records, shell='exec "$@"', PYTHONPATH=str(package.parent))
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


def test_a_verb_loads_what_it_needs_and_no_more() -> None:
    """Starting a simulated part takes as long as its own modules take, not those of the diagnosis."""
    look = "import sys; from hil.cli.main import load_verbs; load_verbs(sys.argv[1:]); print(*sys.modules)"
    for verb, absent in (("sim", {"scipy", "numpy", "pymodbus"}), ("scan", {"scipy", "matplotlib"}), ("--help", set())):
        done = subprocess.run([sys.executable, "-c", look, verb], capture_output=True, text=True, check=True)
        loaded = set(done.stdout.split())
        assert not loaded & absent
        assert verb != "--help" or {f"hil.cli.{module}" for module in entry.VERBS} <= loaded


def test_ctrl_c_at_any_later_moment_is_said_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_argv: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(entry, "build_parser", interrupted)
    assert entry.main(["iso230", "records.csv"]) == 130
    assert capsys.readouterr().err.startswith("hil: interrupted; ")
