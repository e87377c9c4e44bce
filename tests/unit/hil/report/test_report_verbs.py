"""`hil report` as a user sees it."""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.errors import InputError
from hil.report import command_options as report

ROWS = [(run, d, p, p + 0.001 * (run - 2) + 0.002 * d) for run in (1, 2, 3) for d in (1, -1) for p in (0.0, 10.0, 21.0)]
CSV = "run,direction,target_mm,measured_mm\n" + "".join(f"{r},{d:+d},{p},{m}\n" for r, d, p, m in ROWS)


def call(*argv: str) -> int:
    parser = argparse.ArgumentParser(prog="hil")
    report.add_parser(parser.add_subparsers())
    args = parser.parse_args(["report", *argv])
    code: int = args.run(args)
    return code


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("before.csv").write_text(CSV)
    Path("after.csv").write_text(CSV.replace("0.002", "0.0002"))
    Path("found.json").write_text('{"findings": [{"effect": "cyclic", "action": "compensate"}], "unexplained": false}')
    return tmp_path


def test_report_with_everything(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["before.csv", "after.csv", "--label", "as found", "--label", "as left", "--title", "Axis Y"]
    argv += ["--identity", "Axis=Y", "--identity", "Drive=node = 3", "--band", "-2", "2", "--diagnosis", "found.json"]
    argv += ["--table", "found.json", "--note", "hello", "--png", "png/of/it", "--out", "r.html", "--json", "r.json"]
    assert call(*argv) == 0
    html = Path("r.html").read_text(encoding="utf-8")
    for words in (
        "Axis Y",
        "as found",
        "as left",
        "node = 3",
        "cyclic",
        "hello",
        hashlib.sha256(CSV.encode()).hexdigest(),
    ):
        assert words in html
    result = json.loads(Path("r.json").read_text())
    assert result["sha256"] == hashlib.sha256(Path("r.html").read_bytes()).hexdigest()
    assert result["campaigns"][0]["iso230"]["figures_um"]["B"] == pytest.approx(4)
    assert sorted(result["drawings"]) == sorted(map(str, Path("png/of/it").iterdir()))
    assert capsys.readouterr().out.splitlines()[0] == "r.html"


def test_labels_default_to_file_names(place: Path) -> None:
    Path("sub").mkdir()
    Path("sub/before.csv").write_text(CSV)
    assert call("before.csv", "sub/before.csv", "--out", "r.html") == 0
    assert "<h2>sub/before.csv</h2>" in Path("r.html").read_text(encoding="utf-8")
    assert call("before.csv", "--out", "r.html") == 0
    assert "<h2>before</h2>" in Path("r.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["absent.csv"], r"absent\.csv: cannot be read"),
        (["found.json"], r"found\.json:1: header"),
        (["before.csv", "--label", "a", "--label", "b"], "2 --label for 1 record files"),
        (["before.csv", "--identity", "Axis"], "expected NAME=TEXT"),
        (["before.csv", "--band", "3", "2"], "expected low < high"),
        (["before.csv", "--diagnosis", "before.csv"], r"before\.csv:1: is not JSON"),
        (["before.csv", "--diagnosis", "list.json"], r"list\.json: is not a diagnosis"),
        (["before.csv", "--diagnosis", "deep.json"], r"deep\.json: is not JSON"),
        (["before.csv", "--png", "found.json/x"], r"found\.json/x: cannot be made a directory"),
        (["before.csv", "after.csv", "--label", "a", "--label", "a"], "share a label"),
    ],
)
def test_bad_input_is_refused_in_one_line(place: Path, argv: list[str], says: str) -> None:
    Path("list.json").write_text("[]")
    Path("deep.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match=says) as caught:
        call(*argv, "--out", "r.html")
    assert "\n" not in str(caught.value)


def test_an_older_report_survives_a_refusal(place: Path) -> None:
    Path("r.html").write_text("old")
    with pytest.raises(InputError):
        call("absent.csv", "--out", "r.html")
    assert Path("r.html").read_text() == "old"
    with pytest.raises(InputError, match=r"no/r\.html: cannot be written"):
        call("before.csv", "--out", "no/r.html")


@pytest.mark.outside
def test_the_command_line_starts_without_the_plotting_library() -> None:
    code = "import sys, hil.report.command; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, cwd=Path(__file__).parents[4]).returncode == 0
