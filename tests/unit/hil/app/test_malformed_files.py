"""Every malformed file, through every verb that reads such a file: exit status 2 and one line that names the place."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from hil.app.main import main

CORPUS = Path(__file__).parents[1] / "corpus"
RECORDS = tomllib.loads((CORPUS / "records" / "expected.toml").read_text(encoding="utf-8"))
AXIS = tomllib.loads((CORPUS / "axis" / "expected.toml").read_text(encoding="utf-8"))


def check_one_line(error: str, path: Path, line: int, words: list[str]) -> None:
    assert error.endswith("\n")
    assert error.count("\n") == 1, error
    assert error.startswith(f"hil: {path}:{line}: " if line else f"hil: {path}: ")
    assert "Traceback" not in error
    for word in words:
        assert " ".join(word.split()) in error


@pytest.mark.parametrize("verb", [["iso230"], ["fit", "--out", "nothing.json"], ["diagnose"]], ids=lambda verb: verb[0])
def test_malformed_records(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    every = 1 if verb == ["iso230"] else 10  # the others read them by the same function
    for name, expected in list(RECORDS.items())[::every]:
        path = CORPUS / "records" / name
        assert main([*verb, str(path)]) == 2, name
        out, error = capfd.readouterr()
        check_one_line(error, path, expected["line"], expected["words"])
        assert out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("verb", ["calibrate", "doctor"])
def test_malformed_axis_files(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, expected in AXIS.items():
        path = CORPUS / "axis" / name
        assert main([verb, str(path)]) == 2, name
        out, error = capfd.readouterr()
        check_one_line(error, path, expected["line"], expected["words"])
        assert out == ""
    assert list(tmp_path.iterdir()) == []
    assert {path.name for path in (CORPUS / "axis").iterdir()} == {"expected.toml", *AXIS}, (
        "something was written there"
    )


@pytest.mark.outside
@pytest.mark.parametrize(
    "arguments",
    [
        ["iso230", str(CORPUS / "records" / "direction_zero.csv")],
        ["calibrate", str(CORPUS / "axis" / "limits_reversed.toml")],
        ["calibrate", str(CORPUS)],
        ["calibrate", "nowhere.toml"],
        ["calibrat", "x.toml"],
        [],
    ],
)
def test_as_a_process_of_its_own(arguments: list[str], tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hil.app", *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("hil")
    assert done.stdout == ""
