"""What is written first, and what a journal still says after it was torn."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.raw_parameters import DriveIdentity
from hil.parameters.journal import DownloadPhase, Journal, Noted
from hil.parameters.transaction import in_order, uncrossed

RANKS = {"unit": 0, "limit": 1}


def _rank(address: str) -> int:
    return RANKS.get(address, 2)


def test_units_before_limits_before_the_rest_and_else_as_given() -> None:
    assert in_order(["b", "limit", "a", "unit"], _rank, {}) == ["unit", "limit", "b", "a"]


def test_what_comes_after_another_waits_for_it() -> None:
    assert in_order(["a", "b", "c"], _rank, {"a": ["c"], "b": ["nobody"]}) == ["b", "c", "a"]
    with pytest.raises(InputError, match="expected an order without a cycle"):
        in_order(["a", "b"], _rank, {"a": ["b"], "b": ["a"]})


def test_a_limit_whose_other_is_not_written_has_nothing_to_wait_for() -> None:
    for one in ("low", "high"):
        assert in_order([one], _rank, {}, [("low", "high"), ("high", "low")]) == [one]


PAIR = ("low", "high")
limits = st.tuples(st.integers(-100, 100), st.integers(-100, 100)).map(sorted)


@settings(max_examples=40)
@given(limits, limits)
def test_limits_never_cross(before: list[int], wanted: list[int]) -> None:
    held, goals = dict(zip(PAIR, before, strict=True)), dict(zip(PAIR, wanted, strict=True))
    for address in in_order(PAIR, _rank, {}, uncrossed([PAIR], held, goals)):
        held[address] = goals[address]
        assert held["low"] <= held["high"]


def test_a_pair_that_is_not_entirely_known_has_no_order() -> None:
    whole = {"low": 1.0, "high": 2.0}
    for one in ({}, {"low": 5.0}, {"high": 5.0}):
        assert uncrossed([PAIR], whole, one) == uncrossed([PAIR], one, whole) == []


NOTED = (Noted("2210h:01", "gain", b"\1\0", b"\2\0", ("2210h:02",)), Noted("x", "", b"", b"\xff"))
IDENTITY = DriveIdentity("canopen", {"vendor_id": 1}, {}, {"serial": 5})


def _begun(folder: Path) -> Journal:
    journal = Journal(folder)
    journal.begin("X", "new", "sha256:0", IDENTITY, NOTED, store=True)
    return journal


def test_a_journal_says_what_was_to_be_done_and_how_far_it_came(tmp_path: Path) -> None:
    journal = _begun(tmp_path)
    found = Journal(tmp_path).unfinished()
    assert found is not None
    assert (found.axis, found.parameters, found.identity, found.store) == ("X", NOTED, IDENTITY, True)
    assert not found.may_have_stored
    journal.note(found, DownloadPhase.STORING)
    assert Journal(tmp_path).last().may_have_stored  # type: ignore[union-attr]
    journal.note(found, DownloadPhase.END, ending="WRITTEN")
    assert journal.unfinished() is None
    last = journal.last()
    assert last is not None
    assert last.ending == "WRITTEN"
    assert journal.begin("X", "next", "", IDENTITY, NOTED, store=False).path.name == "download-0002.jsonl"


def test_each_step_is_on_the_disk_before_the_next_and_no_file_stays_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first with the folder that the new file's name is in."""
    synced: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append((handle, os.fstat(handle).st_ino)))
    journal = _begun(tmp_path)
    journal.note(journal.unfinished(), DownloadPhase.PROVEN)  # type: ignore[arg-type]
    file, folder = (tmp_path / "download-0001.jsonl").stat().st_ino, tmp_path.stat().st_ino
    assert [inode for _, inode in synced] == [file, folder, file]
    for handle, _ in synced:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(handle)


def test_a_line_torn_anywhere_does_not_count_and_the_next_one_stands_alone(tmp_path: Path) -> None:
    journal = _begun(tmp_path)
    path = tmp_path / "download-0001.jsonl"
    first = path.read_bytes()
    journal.note(journal.unfinished(), DownloadPhase.PROVEN)  # type: ignore[arg-type]
    whole = path.read_bytes()
    for cut in range(len(first), len(whole), 5):
        path.write_bytes(whole[:cut])
        assert journal.unfinished().phases == (DownloadPhase.BEGIN,)  # type: ignore[union-attr]
        journal.note(journal.unfinished(), DownloadPhase.STORING)  # type: ignore[arg-type]
        assert journal.unfinished().phases == (DownloadPhase.BEGIN, DownloadPhase.STORING)  # type: ignore[union-attr]
    for cut in range(0, len(first), 9):
        path.write_bytes(first[:cut])
        assert journal.unfinished() is None  # nothing was written to the drive then


@pytest.mark.parametrize("text", ["{}\n", '{"phase": "begin"}\n', "[]\n", "begin\n", '{"phase": "proven"}\n'])
def test_another_file_is_no_journal(tmp_path: Path, text: str) -> None:
    (tmp_path / "download-0001.jsonl").write_text(text)
    with pytest.raises(InputError, match=r"download-0001.jsonl: is no journal of a download"):
        Journal(tmp_path).unfinished()
