"""All benchmarks, and the one table of the pages: python tests/bench [--write] [PYTEST OPTION…]

Prints the table; --write puts it into hil/docs/benchmarks.md, unless a bench failed. With further options, such as
-k streaming, the lines of benches that were not run stay. The page holds those lines that the benches print (`support.bench.row`)
which have an aim. Takes 10 minutes; other work on the computer makes the figures worse, the ratios less so, as both sides
take turns.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

import pytest

if not __package__:  # run as a folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from support.bench import ROW

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "hil/docs/benchmarks.md"
BEGIN = "<!-- python tests/bench --write -->"
HEAD = "| Figure | Ours | Beside | Ratio | Asked | Bench |\n|---|---|---|---|---|---|"


@dataclass
class Rows:
    """A plugin that collects the lines of the benches. found: file and cells, in the order of the benches"""

    found: list[tuple[str, dict[str, str]]] = field(default_factory=list)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take the lines of a bench that passed."""
        if report.when != "call" or not report.passed:
            return
        file = report.nodeid.split("::")[0].rpartition("/")[2]
        self.found += [(file, json.loads(str(v))) for k, v in report.user_properties if k == ROW]


def line(file: str, cells: Mapping[str, str]) -> str:
    """One line of the table as Markdown."""
    words = (cells["figure"], cells["ours"], cells["beside"], cells["ratio"], cells["asked"] or "–", f"`{file}`")
    return f"| {' | '.join(words)} |"


def table(lines: Iterable[str]) -> str:
    """The table as Markdown."""
    return "\n".join([HEAD, *lines])


def joined(old: Iterable[str], new: Iterable[str]) -> list[str]:
    """Lines of an older table with newer ones in their places: the same figure, beside the same, by the same bench."""

    def key(one: str) -> tuple[str, str, str]:
        figure, _, beside, *_, file = one.strip("| ").split(" | ")
        return file, figure, beside.partition(":")[0]

    lines = {key(one): one for one in old} | {key(one): one for one in new}
    return [lines[one] for one in sorted(lines, key=lambda one: one[0])]


def page(text: str, lines: Iterable[str]) -> str:
    """The page with this table below its mark, and with the host it was measured on."""
    host = (
        f"Python {platform.python_version()}, {os.cpu_count()} cores of {platform.machine()}, {date.today():%Y-%m-%d}"
    )
    return f"{text[: text.index(BEGIN)]}{BEGIN}\n\nMeasured with {host}.\n\n{table(lines)}\n"


def main(words: Sequence[str]) -> int:
    """Exit status 0 when every bench passed."""
    rows = Rows()
    options = [word for word in words if word != "--write"]
    status = pytest.main(
        [str(HERE), "-q", "-s", "-n", "0", "-m", "outside", "-p", "no:cacheprovider", *options], [rows]
    )
    print("\n" + table(line(file, cells) for file, cells in rows.found))
    if "--write" in words:
        if status != pytest.ExitCode.OK:
            print("not written: a bench failed", file=sys.stderr)
            return 1
        text = PAGE.read_text(encoding="utf-8")
        old = [one for one in text.splitlines() if one.startswith("| ") and one.endswith("` |")] if options else []
        new = [line(file, cells) for file, cells in rows.found if cells["asked"]]
        PAGE.write_text(page(text, joined(old, new)), encoding="utf-8")
    return int(status)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
