"""`hil iso230` as a user sees it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest
from support.places import SHARED_DATA as DATA

from drivers.errors import InputError
from hil.files.command_options import add_iso230

SMALL = "run,direction,target_mm,measured_mm\n" + "".join(
    f"{run},{d:+d},{p},{p + 0.001 * run * d}\n" for run in (1, 2, 3) for d in (1, -1) for p in (0.0, 10.0, 21.0)
)


def call(*argv: str) -> int:
    parser = argparse.ArgumentParser(prog="hil")
    add_iso230(parser.add_subparsers())
    args = parser.parse_args(["iso230", *argv])
    code: int = args.run(args)
    return code


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA} (set HIL_SHARED_DATA)")
def test_prints_the_published_figures(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(str(DATA / "iso230_example.csv")) == 0
    printed = {words[0]: words[1] for line in capsys.readouterr().out.splitlines() if len(words := line.split()) > 2}
    expected = {"B": "4.12", "B̄": "-3.71", "M": "3.99", "E↑": "3.94", "E↓": "4.04", "E": "7.70"}
    expected |= {"R↑": "2.99", "R↓": "2.55", "R": "6.55", "A↑": "6.14", "A↓": "5.77", "A": "9.59"}
    assert {name: printed[name] for name in expected} == expected


def test_writes_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "r.csv").write_text(SMALL)
    assert call(str(tmp_path / "r.csv"), "--json", str(tmp_path / "out.json")) == 0
    result = json.loads((tmp_path / "out.json").read_text())
    assert result["figures_um"]["B"] == pytest.approx(4)
    assert (result["m"], result["n"], len(result["targets"])) == (3, 3, 3)
    assert "3 runs per direction" in capsys.readouterr().out


def test_one_direction_prints_dashes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "r.csv").write_text("".join(line for line in SMALL.splitlines(True) if ",-1," not in line))
    assert call(str(tmp_path / "r.csv")) == 0
    out = capsys.readouterr().out
    assert "direction +1 only" in out
    assert "x̄↓" not in out


def test_errors_name_the_file(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text(SMALL + "4,+1,10.0,10.0\n")
    with pytest.raises(InputError, match=r"r\.csv: target 10 mm has 4 run"):
        call(str(tmp_path / "r.csv"))
    with pytest.raises(InputError, match=r"absent\.csv: cannot be read"):
        call(str(tmp_path / "absent.csv"))
