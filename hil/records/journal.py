"""The journal of a campaign: rows reach the disk as they are measured, and a restart finds every one of them.

A campaign is a directory. Each measuring pass in it is a record file that only grows (`*.csv`, the format of
`hil.records.rows`), written row by row and synced before the axis moves on. An incomplete last line, left by a power
cut, was never confirmed and is dropped. The purpose of the campaign stands in `campaign.json`, written once; resuming
with another purpose is refused. Each line is chained to the one before it in `rows.chain` (`hil.records.row_chain`),
and resuming refuses rows that are not as they were written. A pass states when it was begun. When it is closed its
checksum goes to `SHA256SUMS`, for `sha256sum --check` and `hil records inspect`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from drivers.files import read_bytes, read_text, replace_file, sync_directory
from hil.records.files import AppendedFile, append_durably, parse_json
from hil.records.row_chain import CHAIN, Chained, RowChain, adopt, check_chain, written_lines
from hil.records.rows import WITHDRAWN, Records, format_row, parse_csv, parse_rows

CHECKSUMS = "SHA256SUMS"
FINISHED = "finished"
"""Name of the empty file that marks a campaign whose job is complete; one without it can be resumed."""
DISCARDED = "discarded"
"""Name of the empty file that marks a campaign that somebody gave up: its rows stay, and it cannot be resumed."""
BEGUN = "begun "
"""Start of the comment line with the time at which a pass was begun."""
CHAINED = ", rows chained"
"""End of that line where the campaign has a chain: a chain that was deleted is noticed by it."""
UNCHECKED = (
    f"its rows were measured before rows were chained ({CHAIN}): whether they are as they were written is not known"
)
"""Warning of a resumed campaign without a chain."""
MARKER = "campaign.json"
"""Name of the file with a campaign's purpose."""


class RowJournal(AppendedFile):
    """One growing record file, open for appending by one process at a time."""

    def __init__(self, path: Path, names: Sequence[str], comment: str = "", chain: RowChain | None = None) -> None:
        """Opens the file.

        names: the header; comment: lines above it that state what the rows belong to; chain: receives each line
        Raises InputError when the file was begun with another header or comment, holds an invalid row, cannot be
        written, or is open in another process.
        """
        self.names = tuple(names)
        self._chain = chain
        self._header = ("".join(f"# {line}\n" for line in comment.splitlines()) + ",".join(self.names) + "\n").encode()
        self._rows = 0
        super().__init__(path)
        try:
            self._recover()
        except BaseException:
            self.close()
            raise

    def _recover(self) -> None:
        """Counts the rows; an incomplete last line was left by a crash, never confirmed, and is cut off."""
        data = read_bytes(self.path)
        whole = data[: data.rfind(b"\n") + 1] if self._chain is None else self._chain.confirmed(self.path.name)
        if len(whole) < len(self._header) and self._header.startswith(whole):  # new, or killed before its first row
            self._write(self._header[len(whole) :], keep=len(whole))
            sync_directory(self.path.parent)
            return
        lines = whole.decode("utf-8", "replace").split("\n")
        if not whole.startswith(self._header):
            self._refuse_header(lines)
        if len(whole) != len(data):
            self._write(b"", keep=len(whole))
        if sum(map(_is_data, lines)) > 1:
            self._rows = len(parse_rows(read_text(self.path), self.path)[1])

    def _refuse_header(self, lines: Sequence[str]) -> None:
        expected = ",".join(self.names)
        for number, line in enumerate(lines, start=1):
            if _is_data(line):
                if line != expected:
                    raise InputError(f"has columns {line[:200]}, expected {expected}", path=self.path, line=number)
                break
        first = self._header.decode().split("\n")[0]
        raise InputError(
            f"was measured for something else: {lines[0][:100]!r}, expected {first!r}", path=self.path, line=1
        )

    def __len__(self) -> int:
        """Rows confirmed on disk."""
        return self._rows

    def records(self) -> Records | None:
        """All rows, None while there are none. Raises InputError for a file that cannot be read."""
        if not self._rows:
            return None
        return parse_csv(read_text(self.path), self.path)

    def check(self, row: Mapping[str, float]) -> None:
        """Raises InputError for a row that could not be read back."""
        Records.of({name: [row[name]] for name in self.names})

    def append(self, row: Mapping[str, float]) -> None:
        """Writes one row; on return it is on disk.

        Raises InputError, with the file as it was, for a row that could not be read back and when the disk does not
        take it.
        """
        self.check(row)
        self._write((format_row(row, self.names) + "\n").encode())
        self._rows += 1

    def note(self, text: str) -> None:
        """Writes comment lines, for example that a measurement was resumed. Raises InputError when they cannot be
        written.
        """
        for line in text.splitlines():  # one at a time: a crash leaves at most one that is not chained
            self._write(f"# {line}\n".encode())

    def withdraw(self, count: int, why: str) -> None:
        """States that the last `count` rows are not to be used; whoever reads the file leaves them out. One line of why."""
        self._write(f"# {WITHDRAWN} {count}: {' '.join(why.split())}\n".encode())
        self._rows -= count

    def _write(self, data: bytes, *, keep: int | None = None) -> None:
        """Writes data after the first `keep` bytes (default: all there is), completely or not at all, flushes it to the
        disk, and chains it.

        An interrupt during this leaves a file that the next opening recovers, and closes it.
        """

        def chain() -> None:
            if self._chain is not None and data:
                self._chain.add(self.path.name, data)

        try:
            append_durably(self._fd, data, keep=keep, then=chain)
        except OSError as error:
            raise InputError(
                f"cannot be written: {error.strerror}; the rows before are kept", path=self.path
            ) from error
        except BaseException:
            self.close()
            raise


@dataclass(frozen=True)
class Begun:
    """A campaign on disk that can be resumed. purpose: what it was started for"""

    directory: Path
    purpose: Mapping[str, Any]

    @property
    def rows(self) -> int:
        """Number of whole lines below the headings of all passes."""
        lines = [line for path in self.directory.glob("*.csv") for line in read_bytes(path).split(b"\n")[:-1]]
        return sum(line[:1].isdigit() or line[:1] == b"-" for line in lines)


class Campaign:
    """The directory of one campaign: its purpose, its passes and their chain."""

    def __init__(self, directory: Path, purpose: Mapping[str, Any], *, resume: bool) -> None:
        """Starts a campaign, or resumes one.

        purpose: JSON-able; decides which rows are to be measured (axis, plan, mode). A resumed campaign must have the
        same.
        Raises InputError when the directory holds a campaign and `resume` is False, holds none and it is True, or holds
        another, and naming the first line of a resumed one that is not as it was written.
        """
        self.directory = directory
        self.resumed = resume
        self.warning = ""  # what could not be checked when it was resumed
        marker = directory / MARKER
        text = json.dumps(purpose, indent=1, sort_keys=True, allow_nan=False)
        if resume:
            if not marker.exists():
                raise InputError("holds no campaign to resume", path=directory)
            if (directory / DISCARDED).exists():
                raise InputError("was discarded, expected a new measurement", path=directory)
            _check_same(directory, json.loads(text))
            self.warning = _check_rows(directory)
            return
        if marker.exists():
            raise InputError("holds a campaign already; use --resume, or another directory", path=directory)
        if next(directory.glob("*.csv"), None) is not None:
            raise InputError("holds rows without saying what they are of (campaign.json is gone)", path=directory)
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot be made: {error.strerror}", path=directory) from error
        replace_file(marker, text.encode())

    @classmethod
    def numbered(cls, parent: Path, purpose: Mapping[str, Any], *, resume: bool) -> Campaign:
        """The next of a series of campaigns below `parent` (calibrate-001, calibrate-002 …), or with `resume` the last
        one.

        A campaign interrupted before its first row, for example by a drive that did not answer, is passed over for the
        last one with rows. With no campaign to resume, the first is started: the interruption may have come before it.
        Raises InputError as the class does.
        """
        kind = str(purpose["kind"])
        begun = {
            int(suffix): any(path.parent.glob("*.csv"))
            for path in parent.glob(f"{kind}-[0-9]*/{MARKER}")
            if (suffix := path.parent.name.removeprefix(f"{kind}-")).isdecimal()
        }
        last = max(begun, default=0)
        if resume and begun:
            number = max((number for number, rows in begun.items() if rows), default=last)
            return cls(parent / f"{kind}-{number:03d}", purpose, resume=True)
        return cls(parent / f"{kind}-{last + 1:03d}", purpose, resume=False)

    @contextmanager
    def rows(self, name: str, columns: Sequence[str], comment: str = "") -> Iterator[RowJournal]:
        """The journal of one measuring pass, open for appending. On leaving, also by an error, it is closed and its
        checksum is written.

        Raises InputError naming the first line that is not as it was written, also when it was changed while the pass
        was open.
        """
        path = self.directory / f"{name}.csv"
        try:
            with self._chain() as chain, RowJournal(path, columns, comment, chain) as journal:
                if not len(journal):
                    journal.note(f"{BEGUN}{datetime.now().astimezone().isoformat(timespec='seconds')}{CHAINED}")
                yield journal
        except BaseException:
            with suppress(InputError):  # the error that ended the pass is the one to report
                self._write_checksum(path)
            raise
        self._write_checksum(path)

    def _chain(self) -> RowChain:
        return RowChain(self.directory, read_bytes(self.directory / MARKER))

    def _write_checksum(self, path: Path) -> None:
        """The checksum of the confirmed lines: opening the chain has cut off what an interrupt left behind them."""
        with self._chain() as chain:
            confirmed = chain.confirmed(path.name)
        if not confirmed:
            return
        sums = checksums(self.directory) | {path.name: hashlib.sha256(confirmed).hexdigest()}
        text = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
        replace_file(self.directory / CHECKSUMS, text.encode())

    def finish(self) -> None:
        """Marks the campaign's job as complete. Raises InputError when that cannot be written."""
        replace_file(self.directory / FINISHED, b"")

    @staticmethod
    def unfinished(parent: Path, kind: str) -> Begun | None:
        """The `latest` of this kind, where its job is not complete."""
        last = Campaign.latest(parent, kind)
        return None if last is None or (last.directory / FINISHED).exists() else last

    @staticmethod
    def latest(parent: Path, kind: str) -> Begun | None:
        """The campaign of this kind that `numbered` would resume, if it has rows and was not discarded.

        None, too, where its purpose cannot be read: it cannot be resumed.
        """
        begun = [path.parent for path in parent.glob(f"{kind}-[0-9]*/{MARKER}")]
        with_rows = [
            path for path in begun if path.name.removeprefix(f"{kind}-").isdecimal() and any(path.glob("*.csv"))
        ]
        last = max(with_rows, key=lambda path: int(path.name.rpartition("-")[2]), default=None)
        if last is None or (last / DISCARDED).exists():
            return None
        try:
            return Begun(last, read_purpose(last))
        except InputError:
            return None

    @staticmethod
    def discard(directory: Path) -> None:
        """Give up a campaign that was broken off. Its rows stay. Raises InputError when that cannot be written."""
        replace_file(directory / DISCARDED, b"")

    def columns(self, name: str) -> tuple[str, ...] | None:
        """The columns of a pass that was begun, else None."""
        path = self.directory / f"{name}.csv"
        lines = _written_lines(path) if path.exists() else []
        header = next(filter(_is_data, lines), None)
        return None if header is None else tuple(header.split(","))

    def has_rows(self, name: str) -> bool:
        """Whether a pass was begun and has at least one row on disk. Raises InputError for a file that cannot be read."""
        path = self.directory / f"{name}.csv"
        lines = _written_lines(path) if path.exists() else []
        return any(map(_is_data, lines)) and bool(parse_rows("\n".join(lines), path)[1])

    def last_time_s(self) -> float:
        """The latest `time_s` of all rows of all passes, s; 0.0 without rows."""
        latest = 0.0
        for path in self.directory.glob("*.csv"):
            lines = _written_lines(path)
            header, rows = parse_rows("\n".join(lines), path) if any(map(_is_data, lines)) else ([], [])
            if rows and "time_s" in header:
                latest = max(latest, rows[-1][header.index("time_s")])
        return latest

    def write(self, name: str, data: bytes) -> Path:
        """Writes a derived file beside the rows, completely or not at all. Raises InputError when it cannot be
        written.
        """
        path = self.directory / name
        replace_file(path, data)
        return path


def checksums(directory: Path) -> dict[str, str]:
    """SHA-256 of each pass when it was last closed, by file name; lines of another form are ignored."""
    path = directory / CHECKSUMS
    lines = read_text(path).splitlines() if path.exists() else []
    return {match[2]: match[1] for line in lines if (match := re.fullmatch(r"([0-9a-f]{64})  ([^/]+)", line))}


def _check_rows(directory: Path) -> str:
    """Refuses rows that are not as they were written, with InputError naming file and line; returns a warning, or
    "".
    """
    origin, warning = read_bytes(directory / MARKER), ""
    check_resumable(directory)
    if not (directory / CHAIN).exists():
        if not _passes(directory):
            return ""
        adopt(directory, origin)
        warning = UNCHECKED
    with RowChain(directory, origin):
        pass
    return warning


def check_resumable(directory: Path) -> Chained | None:
    """Compare a campaign's rows with its chain and its checksums as resuming does, changing nothing; None where it has no chain.

    Raises InputError naming file and line, upon which resuming is refused.
    """
    if not (directory / CHAIN).exists() and any(map(_says_chained, _passes(directory))):
        raise InputError("is gone; without it the rows beside it cannot be checked", path=directory / CHAIN)
    found = check_rows(directory)
    _check_closed(directory)
    return found


def _passes(directory: Path) -> list[Path]:
    return sorted(path for path in directory.glob("*.csv") if written_lines(path))


def _says_chained(path: Path) -> bool:
    return any(line.startswith(f"# {BEGUN}") and line.endswith(CHAINED) for line in _written_lines(path))


def _check_closed(directory: Path) -> None:
    """Refuses a pass that changed since it was closed, other than by growing."""
    for name, digest in checksums(directory).items():
        path = directory / name
        if not path.exists() or not grew_from(digest, read_bytes(path)):
            raise InputError(f"was changed since it was closed: it does not agree with {CHECKSUMS}", path=path)


def grew_from(digest: str, data: bytes) -> bool:
    """Whether data begins with whole lines of this SHA-256: a pass that was closed, and perhaps continued."""
    found = hashlib.sha256()
    for line in data.splitlines(keepends=True):
        found.update(line)
        if found.hexdigest() == digest:
            return True
    return False


def _written_lines(path: Path) -> list[str]:
    """The complete lines of a journal."""
    data = read_bytes(path)
    return data[: data.rfind(b"\n") + 1].decode("utf-8", "replace").split("\n")


def _is_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def check_rows(directory: Path) -> Chained | None:
    """Compares the rows of a campaign with its chain; None where it has none. Raises InputError naming the first line
    that differs.
    """
    return check_chain(directory, read_bytes(directory / MARKER))


def read_purpose(directory: Path) -> dict[str, Any]:
    """The purpose of the campaign in this directory. Raises InputError where it cannot be read."""
    marker = directory / MARKER
    try:
        purpose = parse_json(read_text(marker))
    except ValueError as error:
        raise InputError("is not JSON, expected what the campaign was started for", path=marker) from error
    if not isinstance(purpose, dict):
        raise InputError("does not say what the campaign was started for", path=marker)
    return purpose


def name_of(path: str | Path) -> str:
    """The name of a record file as outputs show it: with its campaign's folder where it lies in one."""
    path = Path(path)
    return f"{path.parent.name}/{path.name}" if (path.parent / MARKER).exists() else path.name


def measurement_of(stem: str) -> str:
    """Name of the measurement of a pass: before-1, before-2 … are "before"; any other pass is its own measurement."""
    match = re.fullmatch(r"((?:motion-)?(?:before|after)|next-\d+)-\d+", stem)
    return stem if match is None else match[1]


def pass_number(stem: str) -> int:
    """Number of a pass within its measurement, 0 for one that has none."""
    name = measurement_of(stem)
    return 0 if name == stem else int(stem.removeprefix(f"{name}-"))


def simulated(path: str | Path) -> bool:
    """Whether the campaign of this record file states a simulated machine; False where it lies in none."""
    directory = Path(path).parent
    drive = read_purpose(directory).get("drive") if (directory / MARKER).exists() else None
    return isinstance(drive, dict) and (drive.get("backend") == "bench" or drive.get("simulated") is True)


def stated_targets_mm(path: str | Path) -> tuple[float, ...]:
    """Targets of the axis's tables, mm, as the campaign of this record file states them; () where it states none or there is none."""
    directory = Path(path).parent
    if not (directory / MARKER).exists():
        return ()
    measurement = read_purpose(directory).get("measurement")
    targets = measurement.get("targets_mm") if isinstance(measurement, dict) else None
    numbers = isinstance(targets, list) and all(isinstance(one, int | float) for one in targets)
    return tuple(map(float, targets)) if isinstance(targets, list) and numbers else ()


def check_as_measured(path: str | Path, axis: str) -> str:
    """Refuses rows of another axis and rows that are not as they were written, by the campaign that the file lies in.

    Returns what could not be checked, "" for nothing. Raises InputError.
    """
    path = Path(path)
    if not (path.parent / MARKER).exists():
        return f"{path.name} lies outside its campaign: nothing shows whose rows they are, and that they are as they were written"
    if (stated := read_purpose(path.parent).get("axis")) != axis:
        raise InputError(f"was measured on axis {stated}, and the axis file is of axis {axis}", path=path)
    found = check_resumable(path.parent)
    if found is None or path.name not in found.lines:
        return f"{path.name} is not chained: whether its rows are as they were written is not known"
    return ""


def _check_same(directory: Path, purpose: Mapping[str, Any]) -> None:
    """Raises InputError, naming the differences, unless the campaign was started for this purpose."""
    started_for = read_purpose(directory)
    differences = list(_differences(started_for, purpose, ""))
    if differences:
        more = f" and {len(differences) - 3} more" if len(differences) > 3 else ""
        raise InputError(
            f"was started for something else: {', '.join(differences[:3])}{more};"
            " expected the axis file it was started with, or a new campaign",
            path=directory / MARKER,
        )


def _differences(was: Any, now: Any, name: str) -> Iterator[str]:
    """`name was … and is …` for every difference, innermost names first."""
    if isinstance(was, dict) and isinstance(now, dict):
        for key in sorted({*was, *now}):
            yield from _differences(was.get(key), now.get(key), f"{name}.{key}" if name else key)
    elif was != now:
        yield f"{name or 'it'} was {_brief(was)} and is {_brief(now)}"


def _brief(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:40] + "…"
