"""The page of the four systems: every row is complete, what it cites is there, and its counts are those of its rows."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "hil/docs/systems.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
    for line in PAGE.splitlines()
    if re.match(r"\| [A-D]\d+ \|", line)
]
STATES = ("here", "different", "not here")


def cited(cell: str) -> list[tuple[str, str]]:
    """Path and name of each `path::name` in a cell."""
    return re.findall(r"`([\w./]+\.py)::([\w.]+)`", cell)


def defines(path: Path, name: str) -> bool:
    """Whether a file defines each part of a dotted name: a function, a class or a constant."""
    text = path.read_text(encoding="utf-8")
    return all(re.search(rf"^\s*(async )?(def|class) {one}\b|^{one}\b[^\n]* =", text, re.M) for one in name.split("."))


@pytest.mark.parametrize("row", ROWS, ids=[row[0] for row in ROWS])
def test_a_row_is_complete_and_cites_what_is_there(row: list[str]) -> None:
    _, says, state, test = row
    assert re.fullmatch(r".+ \(.+\)", says), "a statement has its place in the document"
    state, _, reason = state.partition(": ")
    assert state in STATES
    assert cited(test) or test == "none"
    for path, name in cited(test):
        assert defines(ROOT / "tests" / path, name), f"tests/{path} defines no {name}"
    if state == "here":
        assert cited(test), "what is here has a test"
    else:
        assert reason, "a difference has its reason"


def test_the_counts_are_those_of_the_rows() -> None:
    for letter in "ABCD":
        states = Counter(row[2].partition(": ")[0] for row in ROWS if row[0].startswith(letter))
        counts = " | ".join(str(number) for number in (states.total(), *(states[state] for state in STATES)))
        assert re.search(rf"^\| {letter}\. .* \| {re.escape(counts)} \|$", PAGE, re.M), f"{letter}: {counts}"


def test_what_the_text_beside_the_tables_cites_is_there() -> None:
    prose = "\n".join(line for line in PAGE.splitlines() if not line.startswith("|"))
    for path, name in cited(prose):
        folder = ROOT if path.startswith("tests/") else ROOT / "hil"
        assert defines(folder / path, name), f"{path} defines no {name}"
