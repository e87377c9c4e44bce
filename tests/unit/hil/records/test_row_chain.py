"""The chain beside a campaign's rows: what a crash leaves is taken up, and nothing else that is not as it was written."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from hil.records.journal import CHECKSUMS, MARKER, UNCHECKED, Campaign, checksums
from hil.records.row_chain import CHAIN, check_chain
from hil.records.rows import read_csv

NAMES = ("run", "direction", "target_mm", "measured_mm", "time_s")
PURPOSE: dict[str, Any] = {"kind": "calibrate", "axis": "X"}
HEAD = 3
"""Lines of a pass before its rows: comment, header, when it was begun."""


def row(number: int) -> dict[str, float]:
    return {
        "run": 1.0,
        "direction": 1.0,
        "target_mm": float(number),
        "measured_mm": number + 1e-7 / 3,
        "time_s": 1.5 * number,
    }


def measured(directory: Path, rows: tuple[int, ...] = (4, 3), purpose: dict[str, Any] | None = None) -> None:
    """Passes of so many rows; the last one was killed: no checksum is there of it."""
    campaign = Campaign(directory, purpose or PURPOSE, resume=False)
    for number, count in enumerate(rows):
        with campaign.rows(f"pass-{number}", NAMES, f"pass {number}") as journal:
            for place in range(count):
                journal.append(row(place))
        if number < len(rows) - 1:
            sums = (directory / CHECKSUMS).read_bytes()
    if len(rows) > 1:
        (directory / CHECKSUMS).write_bytes(sums)
    else:
        (directory / CHECKSUMS).unlink()


def resumed(directory: Path, name: str) -> list[float]:
    """The rows that a resumed campaign would go on from."""
    campaign = Campaign(directory, PURPOSE, resume=True)
    with campaign.rows(name, NAMES, name.replace("-", " ")) as journal:
        records = journal.records()
        journal.append(row(99))
    assert read_csv(directory / f"{name}.csv").target_mm[-1] == 99.0
    Campaign(directory, PURPOSE, resume=True)  # and it is whole again
    return [] if records is None else records.target_mm.tolist()


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("whole") / "campaign"
    measured(directory)
    return directory


def copy_of(whole: Path, factory: pytest.TempPathFactory) -> Path:
    directory = factory.mktemp("copy") / "campaign"
    shutil.copytree(whole, directory)
    return directory


def test_what_was_left_is_gone_on_with(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    assert resumed(copy_of(whole, tmp_path_factory), "pass-1") == [0.0, 1.0, 2.0]


@given(st.data())
@settings(max_examples=40)
def test_a_byte_changed_anywhere_in_confirmed_lines_is_refused_with_its_line(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    directory = copy_of(whole, tmp_path_factory)
    name = data.draw(st.sampled_from(["pass-0.csv", "pass-1.csv"]))  # closed, and open
    path = directory / name
    text = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(text) - 1))
    new = data.draw(st.integers(0, 255))
    assume(new != text[at])
    line = text[:at].count(b"\n") + 1
    text[at] = new
    path.write_bytes(bytes(text))
    with pytest.raises(InputError, match=r"is not as it was written|ends before this line") as caught:
        Campaign(directory, PURPOSE, resume=True)
    assert (caught.value.path, caught.value.line) == (str(path), line)
    assert len(str(caught.value).splitlines()) == 1
    assert path.read_bytes() == bytes(text), "what is refused is left alone"


@given(st.data())
@settings(max_examples=40)
def test_a_byte_changed_anywhere_in_the_chain_is_refused_or_costs_the_last_row(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    directory = copy_of(whole, tmp_path_factory)
    chain = directory / CHAIN
    text = bytearray(chain.read_bytes())
    at = data.draw(st.integers(0, len(text) - 1))
    new = data.draw(st.integers(0, 255))
    assume(new != text[at])
    last = at >= text[:-1].rfind(b"\n")
    text[at] = new
    chain.write_bytes(bytes(text))
    kept = None
    with contextlib.suppress(InputError):
        kept = resumed(directory, "pass-1")
    assert kept is None or (last and kept == [0.0, 1.0])


def moved(lines: list[bytes], data: st.DataObject) -> list[bytes]:
    """Lines in another order, one doubled, one inserted, or one gone."""
    index = data.draw(st.integers(0, len(lines) - 1))
    how = data.draw(st.sampled_from(["swap", "double", "insert", "delete"]))
    if how == "swap":
        other = data.draw(st.integers(0, len(lines) - 1))
        assume(lines[other] != lines[index])
        found = list(lines)
        found[index], found[other] = found[other], found[index]
        return found
    if how == "double":
        return [*lines[:index], lines[index], *lines[index:]]
    if how == "insert":
        return [*lines[:index], b"1,+1,7.0,7.0,1.0\n", *lines[index:]]
    return [*lines[:index], *lines[index + 1 :]]


@given(st.data())
@settings(max_examples=40)
def test_a_line_moved_doubled_inserted_or_deleted_is_refused_with_the_first_line_that_differs(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    directory = copy_of(whole, tmp_path_factory)
    path = directory / data.draw(st.sampled_from(["pass-0.csv", "pass-1.csv"]))
    lines = path.read_bytes().splitlines(keepends=True)
    now = moved(lines, data)
    path.write_bytes(b"".join(now))
    both = zip([*lines, None], [*now, None], strict=False)
    first = next(number for number, (was, is_) in enumerate(both, start=1) if was != is_)
    if now[: len(lines)] == lines and path.name == "pass-1.csv":  # one whole line behind the last: a crash leaves that
        assert resumed(directory, "pass-1") == [0.0, 1.0, 2.0]
        return
    with pytest.raises(InputError) as caught:
        Campaign(directory, PURPOSE, resume=True)
    assert (caught.value.path, caught.value.line) == (str(path), first)


@given(st.data())
@settings(max_examples=40)
def test_either_file_cut_off_anywhere_is_refused_unless_a_crash_leaves_it_so(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    directory = copy_of(whole, tmp_path_factory)
    path = directory / data.draw(st.sampled_from(["pass-0.csv", "pass-1.csv", CHAIN]))
    text = path.read_bytes()
    kept = text[: data.draw(st.integers(0, len(text) - 1))]
    path.write_bytes(kept)
    lines = kept.count(b"\n")
    if path.name != CHAIN:
        with pytest.raises(InputError, match="ends before this line") as caught:
            Campaign(directory, PURPOSE, resume=True)
        assert (caught.value.path, caught.value.line) == (str(path), lines + 1)
    elif lines == text.count(b"\n") - 1:
        assert resumed(directory, "pass-1") == [0.0, 1.0], "the last row alone had no line in the chain"
    else:
        with pytest.raises(InputError, match="was not written by this campaign"):
            Campaign(directory, PURPOSE, resume=True)


class PowerLoss(Exception):  # noqa: N818
    """The process is gone."""


@given(st.integers(0, 900), st.booleans())
@settings(max_examples=60)
@pytest.mark.outside
def test_power_lost_at_any_byte_costs_at_most_the_row_that_was_being_written(
    tmp_path_factory: pytest.TempPathFactory, left: int, synced: bool
) -> None:
    """The process dies at any byte of any file, or in the sync behind it; every row that was confirmed is there."""
    directory = tmp_path_factory.mktemp("power") / "campaign"
    write, sync, confirmed = os.write, os.fsync, 0
    dying = False

    def dies_writing(handle: int, content: Any) -> int:
        nonlocal left, dying
        part = bytes(content)[:left]
        left -= len(part)
        dying = len(part) < len(bytes(content))
        done = write(handle, part)
        if dying and not synced:
            raise PowerLoss
        return done if not dying else len(bytes(content))

    def dies_syncing(handle: int) -> None:
        sync(handle)
        if dying:
            raise PowerLoss

    campaign = Campaign(directory, PURPOSE, resume=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "write", dies_writing)
        patch.setattr(os, "fsync", dies_syncing)
        try:
            with campaign.rows("pass-0", NAMES, "pass 0") as journal:
                for number in range(5):
                    journal.append(row(number))
                    confirmed += 1
        except PowerLoss:
            pass
    kept = resumed(directory, "pass-0")
    assert kept == [float(number) for number in range(len(kept))]
    assert confirmed <= len(kept) <= confirmed + 1


@given(st.integers(0, 30), st.booleans())
@settings(max_examples=80)
def test_interrupted_at_any_call_the_campaign_is_closed_in_order_and_goes_on(
    tmp_path_factory: pytest.TempPathFactory, calls: int, done: bool
) -> None:
    """Ctrl-C comes before or after any one write or sync, in the middle of a write too; the process lives on and closes its files."""
    directory = tmp_path_factory.mktemp("interrupt") / "campaign"
    write, sync, confirmed = os.write, os.fsync, 0

    def interrupted() -> bool:
        nonlocal calls
        calls -= 1
        return calls == -1

    def writes(handle: int, content: Any) -> int:
        if interrupted():
            write(handle, bytes(content)[: None if done else len(bytes(content)) // 2])
            raise KeyboardInterrupt
        return write(handle, content)

    def syncs(handle: int) -> None:
        if interrupted():
            if done:
                sync(handle)
            raise KeyboardInterrupt
        sync(handle)

    campaign = Campaign(directory, PURPOSE, resume=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "write", writes)
        patch.setattr(os, "fsync", syncs)
        with contextlib.suppress(KeyboardInterrupt), campaign.rows("pass-0", NAMES, "pass 0") as journal:
            for number in range(4):
                journal.append(row(number))
                confirmed += 1
    for name, digest in checksums(directory).items():
        assert hashlib.sha256((directory / name).read_bytes()).hexdigest() == digest, "closed as it stands"
    kept = resumed(directory, "pass-0")
    assert kept == [float(number) for number in range(len(kept))]
    assert confirmed <= len(kept) <= confirmed + 1


def test_a_file_of_somebody_elses_beside_the_rows_is_left_alone(tmp_path: Path) -> None:
    measured(tmp_path / "c")
    (tmp_path / "c" / "notes.csv").write_text("# ask Ann\n# about the coolant")
    assert resumed(tmp_path / "c", "pass-1") == [0.0, 1.0, 2.0]
    assert (tmp_path / "c" / "notes.csv").read_text() == "# ask Ann\n# about the coolant"


def test_rows_changed_while_a_pass_is_open_are_not_closed_as_if_they_were_ours(tmp_path: Path) -> None:
    campaign = Campaign(tmp_path / "c", PURPOSE, resume=False)
    path = tmp_path / "c" / "pass-0.csv"

    def measure() -> None:
        with campaign.rows("pass-0", NAMES, "pass 0") as journal:
            journal.append(row(0))
            path.write_text(path.read_text().replace("1,+1,0.0", "1,+1,0.5"))

    with pytest.raises(InputError, match=r"pass-0\.csv:4: is not as it was written"):
        measure()
    assert not (tmp_path / "c" / CHECKSUMS).exists()


def test_a_row_whose_chain_line_found_no_room_is_taken_back(tmp_path: Path) -> None:
    write = os.write

    def full(handle: int, content: Any) -> int:
        if b" pass-0.csv" in bytes(content):
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(handle, content)

    campaign = Campaign(tmp_path / "c", PURPOSE, resume=False)
    with campaign.rows("pass-0", NAMES, "pass 0") as journal:
        journal.append(row(0))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "write", full)
            with pytest.raises(InputError, match="No space left on device; the rows before are kept"):
                journal.append(row(1))
        journal.append(row(2))  # space again
    assert resumed(tmp_path / "c", "pass-0") == [0.0, 2.0]


def swap(ours: Path, theirs: Path) -> None:
    shutil.copy(theirs / "pass-1.csv", ours / "pass-1.csv")


def add(ours: Path, theirs: Path) -> None:
    shutil.copy(theirs / "pass-1.csv", ours / "pass-2.csv")


def chain(ours: Path, theirs: Path) -> None:
    shutil.copy(theirs / CHAIN, ours / CHAIN)


def all_rows(ours: Path, theirs: Path) -> None:
    for name in ("pass-0.csv", "pass-1.csv", CHAIN, CHECKSUMS):
        shutil.copy(theirs / name, ours / name)


def purpose(ours: Path, _theirs: Path) -> None:
    (ours / MARKER).write_text(json.dumps(PURPOSE) + "\n")


def rename(ours: Path, _theirs: Path) -> None:
    (ours / "pass-1.csv").rename(ours / "round-1.csv")
    (ours / CHAIN).write_text((ours / CHAIN).read_text().replace("pass-1.csv", "round-1.csv"))


def lose(ours: Path, _theirs: Path) -> None:
    (ours / "pass-0.csv").unlink()


def lose_chain(ours: Path, _theirs: Path) -> None:
    (ours / CHAIN).unlink()


@pytest.mark.parametrize("what", [swap, add, chain, all_rows, purpose, rename, lose, lose_chain])
def test_files_of_another_campaign_and_files_that_are_gone_are_refused(
    tmp_path: Path, what: Callable[[Path, Path], None]
) -> None:
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    measured(ours)
    measured(theirs, (4, 5), {**PURPOSE, "seed": 2})
    what(ours, theirs)
    before = {path.name: path.read_bytes() for path in ours.iterdir()}
    with pytest.raises(InputError) as caught:
        Campaign(ours, PURPOSE, resume=True)
    assert len(str(caught.value).splitlines()) == 1
    assert {path.name: path.read_bytes() for path in ours.iterdir()} == before


def test_a_closed_pass_cut_off_together_with_its_chain_is_refused(tmp_path: Path) -> None:
    campaign = Campaign(tmp_path / "c", PURPOSE, resume=False)
    with campaign.rows("pass-0", NAMES, "pass 0") as journal:
        for number in range(4):
            journal.append(row(number))
    for name in ("pass-0.csv", CHAIN):
        path = tmp_path / "c" / name
        path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-1]))
    assert check_chain(tmp_path / "c", (tmp_path / "c" / MARKER).read_bytes()) is not None, "they agree with each other"
    with pytest.raises(InputError, match=r"pass-0\.csv: was changed since it was closed"):
        Campaign(tmp_path / "c", PURPOSE, resume=True)


def test_a_campaign_of_before_chains_is_resumed_with_a_warning_and_chained_from_then_on(tmp_path: Path) -> None:
    measured(tmp_path / "c")
    (tmp_path / "c" / CHAIN).unlink()
    for path in (tmp_path / "c").glob("*.csv"):
        path.write_text(path.read_text().replace(", rows chained", ""))
    (tmp_path / "c" / CHECKSUMS).unlink()
    campaign = Campaign(tmp_path / "c", PURPOSE, resume=True)
    assert campaign.warning == UNCHECKED
    assert resumed(tmp_path / "c", "pass-1") == [0.0, 1.0, 2.0]
    assert Campaign(tmp_path / "c", PURPOSE, resume=True).warning == ""
    path = tmp_path / "c" / "pass-0.csv"
    path.write_text(path.read_text().replace("1,+1,2.0", "1,+1,2.5"))
    with pytest.raises(InputError, match=rf"pass-0\.csv:{HEAD + 3}: is not as it was written"):
        Campaign(tmp_path / "c", PURPOSE, resume=True)


def test_a_second_process_is_kept_out_of_the_whole_campaign(tmp_path: Path) -> None:
    campaign = Campaign(tmp_path / "c", PURPOSE, resume=False)
    with campaign.rows("pass-0", NAMES) as journal:
        journal.append(row(0))
        with pytest.raises(InputError, match="is being written by another process"):
            Campaign(tmp_path / "c", PURPOSE, resume=True)
