"""The journal: a row that was confirmed is there after any crash, and nothing else is taken for a row."""

from __future__ import annotations

import errno
import json
import math
import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from hil.records.journal import Begun, Campaign, RowJournal
from hil.records.rows import read_csv

NAMES = ("run", "direction", "target_mm", "measured_mm", "time_s", "torque_percent")
HEADER = ",".join(NAMES) + "\n"


def row(number: int) -> dict[str, float]:
    return {
        "run": 1.0 + number // 10,
        "direction": 1.0 if number % 2 else -1.0,
        "target_mm": 0.1 * number,
        "measured_mm": 0.1 * number + 1e-7 / 3,
        "time_s": 1.5 * number,
        "torque_percent": math.nan,
    }


def journal_of(path: Path, rows: int, comment: str = "") -> None:
    with RowJournal(path, NAMES, comment) as journal:
        for number in range(rows):
            journal.append(row(number))


def numbers(path: Path) -> list[int]:
    return [round(target / 0.1) for target in read_csv(path).target_mm]


def test_rows_come_back_as_they_were_and_the_file_is_a_record_file(tmp_path: Path) -> None:
    path = tmp_path / "measure.csv"
    with RowJournal(path, NAMES, "tables 0815\nsecond line") as journal:
        assert journal.records() is None
        for number in range(3):
            journal.append(row(number))
            assert len(journal) == number + 1
        journal.note("resumed")
        journal.append(row(3))
        records = journal.records()
    assert path.read_text(encoding="utf-8").startswith("# tables 0815\n# second line\n" + HEADER)
    for found in (records, read_csv(path)):
        assert found is not None
        assert found["measured_mm"].tolist() == [row(number)["measured_mm"] for number in range(4)]
        assert all(math.isnan(value) for value in found["torque_percent"])


@pytest.mark.parametrize("count", [1, 2, 3])
def test_withdrawn_rows_are_left_out_wherever_the_file_is_read(tmp_path: Path, count: int) -> None:
    place = Campaign(tmp_path / "c", {"kind": "test"}, resume=False)
    with place.rows("measure", NAMES) as journal:
        for number in range(3):
            journal.append(row(number))
        journal.withdraw(count, "the beam\nstood still")
        assert len(journal) == 3 - count
    assert place.has_rows("measure") == (count < 3)
    assert place.last_time_s() == (1.5 * (2 - count) if count < 3 else 0.0)
    again = Campaign(tmp_path / "c", {"kind": "test"}, resume=True)
    with again.rows("measure", NAMES) as journal:
        assert len(journal) == 3 - count
        assert (journal.records() is None) == (count == 3)
        journal.append(row(7))
    assert numbers(tmp_path / "c" / "measure.csv") == [*range(3 - count), 7]


def test_a_file_that_withdraws_more_rows_than_there_are_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "measure.csv"
    journal_of(path, 2)
    path.write_text(path.read_text() + "# withdrawn 3: by hand\n")
    with pytest.raises(InputError, match=r"line 4: withdraws 3 rows, there are 2 above it|withdraws 3 rows"):
        read_csv(path)


@given(st.integers(0, 4), st.integers(0, 400), st.booleans())
@settings(max_examples=50)
def test_torn_at_any_byte_what_was_whole_is_kept_and_what_was_torn_is_dropped(
    tmp_path_factory: pytest.TempPathFactory, rows: int, cut: int, comment: bool
) -> None:
    path = tmp_path_factory.mktemp("torn") / "measure.csv"
    said = "tables 0815" if comment else ""
    journal_of(path, rows, said)
    data = path.read_bytes()
    kept = data[: max(0, len(data) - cut)]
    path.write_bytes(kept)
    head = len(f"# {said}\n" if said else "") + len(HEADER)
    whole_rows = kept[head:].count(b"\n") if len(kept) > head else 0
    with RowJournal(path, NAMES, said) as journal:
        assert len(journal) == whole_rows
        journal.append(row(9))
    assert numbers(path) == [*range(whole_rows), 9]


@pytest.mark.parametrize("tail", [b"1,+1,0.3", b"\0\0\0\0", b"1,+1,0.3,\xff", b"#", b"# resu"])
def test_a_torn_tail_of_any_kind_is_cut_off(tmp_path: Path, tail: bytes) -> None:
    path = tmp_path / "measure.csv"
    journal_of(path, 2)
    with path.open("ab") as file:
        file.write(tail)
    campaign_columns = Campaign(tmp_path / "c", {}, resume=False)
    assert campaign_columns.columns("measure") is None
    with RowJournal(path, NAMES) as journal:
        assert len(journal) == 2
        journal.append(row(2))
    assert numbers(path) == [0, 1, 2]


def test_another_header_or_another_comment_is_refused_and_the_file_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "round-1.csv"
    journal_of(path, 2, "tables 0815")
    before = path.read_bytes()
    with pytest.raises(
        InputError, match=r"round-1\.csv:2: has columns run.*expected run,direction,target_mm,measured_mm$"
    ):
        RowJournal(path, NAMES[:4], "tables 0815")
    with pytest.raises(InputError, match=r"round-1\.csv:1: .*tables 0815.*expected '# tables 4711'"):
        RowJournal(path, NAMES, "tables 4711")
    with pytest.raises(InputError, match=r"round-1\.csv:1: "):
        RowJournal(path, NAMES)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (HEADER + "1,+1,0,0,0,\n1,0,0,0,0,\n", r":3: direction is '0'"),
        (HEADER + "1,+1,0,0,0,\n\0\0\0\0\n", r":3: row has 1 columns"),
        (HEADER + "1,+1,0,0\n", r":2: row has 4 columns"),
        ("\0\0\0\0\n", r":1: has columns"),
        ("not a journal\n" + HEADER, r":1: has columns not a journal"),
    ],
)
def test_a_damaged_file_is_refused_with_its_line_and_left_alone(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "measure.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=said) as caught:
        RowJournal(path, NAMES)
    assert len(str(caught.value).splitlines()) == 1
    assert path.read_text(encoding="utf-8") == content


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "measure.csv"
    path.write_bytes(HEADER.encode() + b"1,+1,0,0,0,\xff\n")
    with pytest.raises(InputError, match=r":2: byte FFh"):
        RowJournal(path, NAMES)


def test_temporary_files_left_over_by_others_are_no_concern(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    for name in (".measure.csv.abc123.part", ".campaign.json.def456.part", "measure.csv.part"):
        (tmp_path / "x" / name).write_bytes(b"half")
    campaign = Campaign(tmp_path / "x", {"runs": 1}, resume=False)
    with campaign.rows("measure", NAMES) as journal:
        journal.append(row(0))
    assert numbers(tmp_path / "x" / "measure.csv") == [0]
    assert campaign.last_time_s() == 0.0


# -- a disk that does not take it ---------------------------------------------------------------------------------------


class FullDisk:
    """os.write of a disk with so many bytes left; what does not fit is refused, the last write is short."""

    def __init__(self, left: int) -> None:
        self.left = left
        self.write = os.write

    def __call__(self, handle: int, data: Any) -> int:
        if self.left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        part = bytes(data)[: self.left]
        self.left -= len(part)
        return self.write(handle, part)


@pytest.mark.parametrize("left", [0, 1, 7, 20])
def test_on_a_full_disk_no_half_row_stays_and_the_error_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left: int
) -> None:
    path = tmp_path / "measure.csv"
    with RowJournal(path, NAMES) as journal:
        journal.append(row(0))
        before = path.read_bytes()
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", FullDisk(left))
            with pytest.raises(InputError, match=r"measure\.csv: cannot be written: No space left on device"):
                journal.append(row(1))
        assert path.read_bytes() == before
        assert len(journal) == 1
        journal.append(row(2))  # space again
    assert numbers(path) == [0, 2]


def test_a_row_that_could_not_be_flushed_is_not_confirmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "measure.csv"

    def broken(handle: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with RowJournal(path, NAMES) as journal:
        journal.append(row(0))
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", broken)
            with pytest.raises(InputError, match="Input/output error"):
                journal.append(row(1))
        assert len(journal) == 1
    assert numbers(path) == [0]


def test_a_full_disk_at_the_start_leaves_nothing_that_stands_in_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "measure.csv"
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", FullDisk(5))
        with pytest.raises(InputError, match="No space left"):
            RowJournal(path, NAMES)
    journal_of(path, 1)
    assert numbers(path) == [0]


def test_places_that_cannot_be_written_are_named(tmp_path: Path, as_nobody: Callable[[], None]) -> None:
    (tmp_path / "dir.csv").mkdir()
    with pytest.raises(InputError, match=r"dir\.csv: cannot be opened: Is a directory"):
        RowJournal(tmp_path / "dir.csv", NAMES)
    with pytest.raises(InputError, match="No such file"):
        RowJournal(tmp_path / "no" / "measure.csv", NAMES)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match="cannot be made"):
        Campaign(tmp_path / "file", {}, resume=False)
    as_nobody()
    with pytest.raises(InputError, match="Permission denied"):
        RowJournal(tmp_path / "measure.csv", NAMES)


# -- rows that are none ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("measured_mm", math.nan),
        ("measured_mm", math.inf),
        ("direction", 0.0),
        ("run", 1.5),
        ("torque_percent", math.inf),
    ],
)
def test_a_row_that_could_not_be_read_back_is_never_written(tmp_path: Path, name: str, value: float) -> None:
    path = tmp_path / "measure.csv"
    with RowJournal(path, NAMES) as journal:
        journal.append(row(0))
        with pytest.raises(InputError, match=name):
            journal.append({**row(1), name: value})
        assert len(journal) == 1
    assert numbers(path) == [0]


# -- kill -9 --------------------------------------------------------------------------------------------------------------

APPENDER = """
import sys
from pathlib import Path
from hil.records.journal import RowJournal

names = ("run", "direction", "target_mm", "measured_mm", "time_s", "torque_percent")
with RowJournal(Path(sys.argv[1]), names) as journal:
    print(len(journal), flush=True)
    for number in range(len(journal), 100_000):
        journal.append({name: 1.0 for name in names} | {"target_mm": 0.1 * number})
        print(number + 1, flush=True)
"""


@pytest.mark.outside
def test_no_confirmed_row_is_lost_to_kill_9(tmp_path: Path) -> None:
    """One process after another goes on with the same file, each killed after a random number of confirmed rows."""
    path = tmp_path / "measure.csv"
    generator = random.Random(1)
    confirmed = 0
    for _ in range(20):
        with subprocess.Popen(
            [sys.executable, "-c", APPENDER, str(path)], stdout=subprocess.PIPE, text=True, bufsize=1
        ) as child:
            assert child.stdout is not None
            assert int(child.stdout.readline()) >= confirmed
            for _ in range(generator.randint(0, 30)):
                confirmed = int(child.stdout.readline())
            child.send_signal(signal.SIGKILL)
            for line in child.stdout:  # what it confirmed before the signal reached it
                confirmed = int(line) if line.endswith("\n") else confirmed
        with RowJournal(path, NAMES) as journal:
            assert confirmed <= len(journal) <= confirmed + 1
            confirmed = len(journal)
    assert confirmed > 100
    assert numbers(path) == list(range(confirmed))


# -- campaigns ------------------------------------------------------------------------------------------------------------

PURPOSE: dict[str, Any] = {"kind": "calibrate", "axis": "X", "measurement": {"runs": 5, "targets_mm": [0.0, 10.0]}}


def test_a_campaign_is_begun_once_and_resumed_for_the_same_purpose_only(tmp_path: Path) -> None:
    place = tmp_path / "deep" / "campaign"
    with pytest.raises(InputError, match="no campaign to resume"):
        Campaign(place, PURPOSE, resume=True)
    Campaign(place, PURPOSE, resume=False)
    with pytest.raises(InputError, match="holds a campaign already"):
        Campaign(place, PURPOSE, resume=False)
    assert Campaign(place, PURPOSE, resume=True).resumed
    changed = {**PURPOSE, "measurement": {"runs": 3, "targets_mm": [0.0, 10.0]}, "axis": "Y"}
    with pytest.raises(InputError) as caught:
        Campaign(place, changed, resume=True)
    message = str(caught.value)
    assert 'axis was "X" and is "Y"' in message
    assert "measurement.runs was 5 and is 3" in message
    assert "targets" not in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize("content", ["", "[1, 2]", "5", "{", "null", "\ufeff{}"])
def test_a_damaged_marker_is_refused_in_one_line(tmp_path: Path, content: str) -> None:
    (tmp_path / "campaign.json").write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=r"campaign\.json") as caught:
        Campaign(tmp_path, PURPOSE, resume=True)
    assert len(str(caught.value).splitlines()) == 1


def test_rows_without_a_marker_are_not_taken_for_new_ones(tmp_path: Path) -> None:
    """Whoever deletes campaign.json to start afresh would otherwise get the old rows as freshly measured."""
    journal_of(tmp_path / "measure.csv", 2)
    with pytest.raises(InputError, match="holds rows"):
        Campaign(tmp_path, PURPOSE, resume=False)


def test_columns_and_time_of_what_is_there(tmp_path: Path) -> None:
    campaign = Campaign(tmp_path, PURPOSE, resume=False)
    assert campaign.columns("measure") is None
    assert campaign.last_time_s() == 0.0
    journal_of(tmp_path / "measure.csv", 5, "a comment")
    journal_of(tmp_path / "round-1.csv", 3)
    (tmp_path / "notes.csv").write_text("# nothing yet\n", encoding="utf-8")
    with (tmp_path / "measure.csv").open("a", encoding="utf-8") as file:
        file.write("1,+1,99")
    assert campaign.columns("measure") == NAMES
    assert campaign.last_time_s() == 6.0


def test_numbered_campaigns(tmp_path: Path) -> None:
    first = Campaign.numbered(
        tmp_path, PURPOSE, resume=True
    )  # nothing to resume: an interruption may have come before it
    assert (first.directory.name, first.resumed) == ("calibrate-001", False)
    second = Campaign.numbered(tmp_path, PURPOSE, resume=False)
    assert second.directory.name == "calibrate-002"
    (tmp_path / "calibrate-0x").mkdir()
    (tmp_path / "calibrate-010").mkdir()  # killed before its marker was written: it never was
    again = Campaign.numbered(tmp_path, PURPOSE, resume=True)
    assert (again.directory.name, again.resumed) == ("calibrate-002", True)
    other = Campaign.numbered(tmp_path, {**PURPOSE, "kind": "verify"}, resume=False)
    assert other.directory.name == "verify-001"


def test_resuming_takes_the_last_campaign_with_rows(tmp_path: Path) -> None:
    with Campaign.numbered(tmp_path, PURPOSE, resume=False).rows("measure", NAMES):
        pass
    for _ in range(2):  # the drive was off: begun, and no row
        Campaign.numbered(tmp_path, PURPOSE, resume=False)
    assert Campaign.numbered(tmp_path, PURPOSE, resume=True).directory.name == "calibrate-001"
    with Campaign.numbered(tmp_path, PURPOSE, resume=False).rows("measure", NAMES):
        pass
    assert Campaign.numbered(tmp_path, PURPOSE, resume=True).directory.name == "calibrate-004"


def test_what_was_broken_off_is_found_with_what_it_was_started_for(tmp_path: Path) -> None:
    campaign = Campaign.numbered(tmp_path, {"kind": "k", "seed": 7}, resume=False)
    assert Campaign.unfinished(tmp_path, "k") is None  # without a row there is nothing to go on with
    with campaign.rows("pass", NAMES) as journal:
        journal.append(row(1))
    assert Campaign.unfinished(tmp_path, "k") == Begun(campaign.directory, {"kind": "k", "seed": 7})
    marker = campaign.directory / "campaign.json"
    purpose = marker.read_text()
    for damaged in ("{", "[1]"):  # such a campaign cannot be resumed
        marker.write_text(damaged)
        assert Campaign.unfinished(tmp_path, "k") is None
    marker.write_text(purpose)
    campaign.finish()
    assert Campaign.unfinished(tmp_path, "k") is None


def test_a_derived_file_is_replaced_as_a_whole(tmp_path: Path) -> None:
    campaign = Campaign(tmp_path, PURPOSE, resume=False)
    path = campaign.write("result.json", b"1")
    assert campaign.write("result.json", json.dumps({"a": 1}).encode()) == path
    assert path.read_bytes() == b'{"a": 1}'
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["campaign.json", "result.json"]
