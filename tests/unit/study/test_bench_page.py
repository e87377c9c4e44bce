"""The table of benchmarks: what a bench records is a line of it, and the page holds lines of benches that there are."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path

import pytest
from support.bench import ROW, median_ratio, number, row

BENCH = Path(__file__).parents[2] / "bench"


def test_a_line_is_printed_recorded_and_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = importlib.util.spec_from_file_location("bench_main", BENCH / "__main__.py")
    assert spec is not None
    assert spec.loader is not None
    command = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, command)  # for its dataclass
    spec.loader.exec_module(command)
    recorded: list[tuple[str, object]] = []
    row(lambda *pair: recorded.append(pair), "looking", 4.2, 2.0, "µs", beside="guessing", asked="≤ 3")
    assert capsys.readouterr().out == "\nlooking | 4.2 µs | guessing: 2 µs | 2.1 | ≤ 3\n"
    ((name, value),) = recorded
    assert name == ROW
    line = command.line("x.py", json.loads(str(value)))
    written = command.page(f"# Page\n{command.BEGIN}\nold", [line])
    assert "old" not in written
    assert written.endswith("| looking | 4.2 µs | guessing: 2 µs | 2.1 | ≤ 3 | `x.py` |\n")
    newer, other = line.replace("4.2 µs", "5 µs").replace("2 µs", "1 µs"), line.replace("looking", "hearing")
    assert command.joined([line, other], [newer]) == [newer, other]
    assert command.BEGIN in command.PAGE.read_text(encoding="utf-8")
    for file in re.findall(r"`(test_\w+\.py)` \|", command.PAGE.read_text(encoding="utf-8")):
        assert (BENCH / file).exists()


def test_figures_have_three_digits_and_ratios_are_of_rounds() -> None:
    assert [number(value) for value in (0.000123456, 1.23456, 123.4, 1234.5, 2e6)] == [
        "0.000123",
        "1.23",
        "123",
        "1,234",
        "2,000,000",
    ]
    assert median_ratio([1.0, 2.0, 30.0], [1.0, 1.0, 10.0]) == 2.0
