"""The page of the four systems: every statement is complete, what it cites is there, and the counts are those of the statements."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "hil/docs/systems.md").read_text(encoding="utf-8")
STATES = {"Here": "here", "Different": "different", "Not here": "not here"}


@dataclass(frozen=True)
class Statement:
    """A line of the page. says: with its place in the document; remark: "" where there is none; tests: with their paths, or none."""

    number: str
    state: str
    says: str
    remark: str
    tests: str


def statements() -> Iterator[Statement]:
    """The lines below the headings of the states."""
    for title, text in re.findall(r"^### (.+)\n((?:(?!#).*\n)*)", PAGE, re.M):
        for line in re.findall(r"^- ([A-D]\d+\. .*)$", text, re.M):
            match = re.fullmatch(r"([A-D]\d+)\. (.+? \(.+?\))(?:\. Here: (.+?))?\. (No test\.|`[\w./]+\.py::.+)", line)
            assert match, line
            yield Statement(match[1], STATES[title], match[2], match[3] or "", match[4])


ROWS = list(statements())


def cited(cell: str) -> list[tuple[str, str]]:
    """Path and name of each `path::name` in a cell."""
    return re.findall(r"`([\w./]+\.py)::([\w.]+)`", cell)


def defines(path: Path, name: str) -> bool:
    """Whether a file defines each part of a dotted name: a function, a class or a constant."""
    text = path.read_text(encoding="utf-8")
    return all(re.search(rf"^\s*(async )?(def|class) {one}\b|^{one}\b[^\n]* =", text, re.M) for one in name.split("."))


@pytest.mark.parametrize("row", ROWS, ids=[row.number for row in ROWS])
def test_a_statement_is_complete_and_cites_what_is_there(row: Statement) -> None:
    assert cited(row.tests) or row.tests == "No test."
    for path, name in cited(row.tests):
        assert defines(ROOT / "tests" / path, name), f"tests/{path} defines no {name}"
    if row.state == "here":
        assert cited(row.tests), "what is here has a test"
    else:
        assert row.remark, "a difference has its reason"


def test_every_number_is_there_once() -> None:
    for letter, last in {"A": 39, "B": 34, "C": 18, "D": 23}.items():
        own = [int(row.number[1:]) for row in ROWS if row.number[0] == letter]
        assert sorted(own) == list(range(1, last + 1))


def test_the_counts_are_those_of_the_statements() -> None:
    for letter in "ABCD":
        states = Counter(row.state for row in ROWS if row.number[0] == letter)
        counts = " | ".join(str(number) for number in (states.total(), *(states[state] for state in STATES.values())))
        assert re.search(rf"^\| {letter}\. .* \| {re.escape(counts)} \|$", PAGE, re.M), f"{letter}: {counts}"


def test_what_the_text_beside_the_tables_cites_is_there() -> None:
    prose = "\n".join(line for line in PAGE.splitlines() if not re.match(r"- [A-D]\d+\. ", line))
    for path, name in cited(prose):
        folder = ROOT if path.startswith("tests/") else ROOT / "hil"
        assert defines(folder / path, name), f"{path} defines no {name}"
