"""What a screen shows of a parameter job's result: written out by hand for each kind of result, and read back after a restart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hil.parameters.compare import Compared, Comparison, Side
from hil.parameters.outcome import MOST_ROWS, BackedUp, Outcome, ParameterRow, keep_outcome, kept_outcome, outcome_of
from hil.parameters.preflight import Objection
from hil.parameters.report import Ending, JobReport, ParameterVerdict, Row

WHOLE = Objection("", "", "the drive is enabled")
SINGLE = Objection("6065h:00", "Following error window", "is above 100")


def compared(address: str, held: int, wanted: int, side: Side, why: str = "") -> Compared:
    return Compared(address, "speed", "mm/s", held, wanted, side, why)


def comparison(*rows: Compared, objections: tuple[Objection, ...] = (), error: str = "") -> Comparison:
    return Comparison(cast(Any, None), cast(Any, None), rows=list(rows), objections=[*objections], error=error)


SAME = compared("a", 1, 1, Side.SAME)
OTHER = compared("b", 2, 3, Side.DIFFERS)
UNREAD = compared("c", 0, 4, Side.UNKNOWN, "did not answer")


def test_a_comparison_shows_what_differs_and_counts_the_rest() -> None:
    found = outcome_of(comparison(SAME, SAME, SAME, OTHER, UNREAD))
    assert (found.outcome, found.same, found.differing) == ("differs", 3, 2)
    assert found.rows == (
        ParameterRow("b", "speed", "2", "3", "mm/s", "DIFFERS"),
        ParameterRow("c", "speed", "0", "4", "mm/s", "UNKNOWN", "did not answer"),
    )
    assert outcome_of(comparison(SAME, SAME)) == Outcome("holds", same=2, differing=0)


def test_objections_to_a_parameter_are_rows_and_those_to_the_drive_are_warnings() -> None:
    found = outcome_of(comparison(SAME, objections=(WHOLE, SINGLE)))
    assert (found.outcome, found.warnings) == ("unfit", ("the drive is enabled",))
    assert found.rows == (ParameterRow("6065h:00", "Following error window", "", "", "", "", "is above 100"),)
    assert (found.same, found.differing) == (1, 0)


def test_at_most_so_many_rows_are_shown_and_all_are_counted() -> None:
    found = outcome_of(comparison(*[OTHER] * (MOST_ROWS + 5)))
    assert (len(found.rows), found.differing) == (2000, 2005)


def row(address: str, verdict: ParameterVerdict) -> Row:
    return Row(address, "gain", "1/s", 10, 20, verdict)


ROWS = (row("a", ParameterVerdict.SAME), row("b", ParameterVerdict.SAME), row("c", ParameterVerdict.WRITTEN))
CHANGED = (ParameterRow("c", "gain", "10", "20", "1/s", "WRITTEN"),)


@pytest.mark.parametrize(
    ("ending", "outcome", "same", "differing"),
    [
        (Ending.UNCHANGED, "unchanged", 3, 0),
        (Ending.WRITTEN, "written", 3, 0),
        (Ending.PUT_BACK, "put_back", 2, 1),
        (Ending.REFUSED, "refused", 2, 1),
        (Ending.UNFINISHED, "unfinished", None, None),
    ],
)
def test_a_drive_holds_all_of_a_set_after_a_good_ending_alone(
    ending: Ending, outcome: str, same: int | None, differing: int | None
) -> None:
    assert outcome_of(JobReport("X", ending, ROWS)) == Outcome(outcome, CHANGED, same=same, differing=differing)


def test_stored_is_said_only_of_what_was_stored_without_an_error() -> None:
    stored = JobReport("X", Ending.WRITTEN, ROWS, stored=True)
    assert outcome_of(stored).outcome == "stored"
    failed = outcome_of(
        replace(stored, error="lost after the store", objections=(WHOLE, SINGLE), notes=("of the maker's file",))
    )
    assert failed.outcome == "written"
    assert failed.warnings == ("lost after the store", "the drive is enabled", "of the maker's file")
    assert [one.address for one in failed.rows] == ["6065h:00", "c"]
    assert outcome_of(replace(stored, audited=False)).outcome == "written"


def test_it_is_read_back_by_a_later_server_with_the_time(tmp_path: Path) -> None:
    axis = cast(Any, SimpleNamespace(store=SimpleNamespace(directory=tmp_path / "X")))
    assert kept_outcome(axis) is None
    for result in (
        BackedUp(tmp_path / "x.params.toml", 40, 2),
        comparison(SAME, OTHER),
        JobReport("X", Ending.PUT_BACK, ROWS),
    ):
        keep_outcome(axis, result)
        kept = kept_outcome(axis)
        assert kept is not None
        assert kept.at is not None
        assert kept.at.tzinfo is not None
        assert replace(kept, at=None) == outcome_of(result)
    keep_outcome(axis, None)
    assert replace(cast(Outcome, kept_outcome(axis)), at=None) == Outcome()
    (found,) = (tmp_path / "X").rglob("*.json")
    found.write_bytes(b"{")
    assert kept_outcome(axis) is None
