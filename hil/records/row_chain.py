"""The chain of checksums beside a campaign's rows: it shows, before they are used, that the rows are as they were
written.

`rows.chain` has one line for each line of the campaign's record files, in the order of writing: the SHA-256 of the
line, its file's name and the checksum before it; the first is chained to the campaign's purpose. A line that was
changed, inserted, deleted, moved, or brought from another campaign breaks it. It guards against mistakes, not against
an attacker who recomputes it.

A row is confirmed when both are on the disk: the row is synced first, then its line here. So a crash leaves at most the
last row without its line. That row was never confirmed and the axis had not moved on: it is cut off and measured again.
An incomplete last line of the chain is cut off too. Any other difference was not caused by a crash and is refused with
its file and line.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError
from drivers.files import read_bytes, replace_file, sync_directory
from hil.records.files import AppendedFile, append_durably, held

CHAIN = "rows.chain"
_FORMAT = b"hil-rows/1\n"
_ENTRY = re.compile(rb"([0-9a-f]{64}) ([^/\x00-\x1f]+\.csv)")


@dataclass(frozen=True)
class Chained:
    """What a chain covers that agrees with its files.

    lines: chained lines of each record file, by its name; unconfirmed: complete lines after them that a crash left, by
    name
    latest: the name of the file that was written last
    digest: the last checksum; size: bytes of `rows.chain` up to its last complete line
    """

    lines: Mapping[str, int]
    unconfirmed: Mapping[str, int]
    latest: str
    digest: bytes
    size: int


def check_chain(directory: Path, origin: bytes) -> Chained | None:
    """Compares a campaign's record files with their chain; None where there is none. Reads only.

    origin: the bytes of the campaign's purpose. Raises InputError naming the first line that is not as it was written.
    """
    path = directory / CHAIN
    if not path.exists():
        return None
    entries = _entries(read_bytes(path), path)
    digest, latest = _seed(origin), ""
    files: dict[str, list[bytes]] = {}
    lines: dict[str, int] = {}
    size = len(_FORMAT) if entries is not None else 0
    for number, (stated, name) in enumerate(entries or (), start=2):
        if name not in files:
            files[name] = written_lines(directory / name)
        at = lines.get(name, 0)
        if at >= len(files[name]):
            raise InputError(
                f"ends before this line, which was written: it is line {number} of {CHAIN}",
                path=directory / name,
                line=at + 1,
            )
        digest = _link(digest, name, files[name][at])
        if digest.hex() != stated:
            raise InputError(
                f"is not as it was written: it does not agree with line {number} of {CHAIN}; expected rows that were not"
                " changed, or a new campaign",
                path=directory / name,
                line=at + 1,
            )
        lines[name], latest = at + 1, name
        size += len(stated) + len(name.encode()) + 2
    return Chained(lines, _unconfirmed(directory, lines, latest), latest, digest, size)


def order_written(directory: Path) -> list[str]:
    """Names of a campaign's record files in the order of their first chained lines, as far as the chain can be read; nothing is
    checked.
    """
    path = directory / CHAIN
    lines = read_bytes(path).split(b"\n") if path.exists() else []
    return list(
        dict.fromkeys(match[2].decode("utf-8", "replace") for line in lines if (match := _ENTRY.fullmatch(line)))
    )


def _entries(data: bytes, path: Path) -> list[tuple[str, str]] | None:
    """Checksums and names; None where not even the first line was written. An invalid last line is incomplete and
    ignored.
    """
    whole = data.split(b"\n")[:-1]
    if not whole:
        return None
    if whole[0] + b"\n" != _FORMAT:
        raise InputError("is no chain of rows", path=path, line=1)
    entries = []
    for number, line in enumerate(whole[1:], start=2):
        match = _ENTRY.fullmatch(line)
        if match is None:
            if number == len(whole):
                break
            raise InputError("holds a line that is no checksum and name", path=path, line=number)
        entries.append((match[1].decode(), match[2].decode("utf-8", "replace")))
    return entries


def _unconfirmed(directory: Path, lines: Mapping[str, int], latest: str) -> dict[str, int]:
    """Complete lines that are not chained: one of the file written last, or the header of a file without rows."""
    found = {}
    for path in sorted(directory.glob("*.csv")):
        written = written_lines(path)
        chained = lines.get(path.name, 0)
        extra = len(written) - chained
        if extra and not (extra == 1 and path.name == latest) and sum(map(_is_data, written)) > 1:
            raise InputError(f"was not written by this campaign: {CHAIN} ends before it", path=path, line=chained + 1)
        if extra:
            found[path.name] = extra
    return found


def written_lines(path: Path) -> list[bytes]:
    """The complete lines of a record file with their ends; none where there is no file."""
    return _split(read_bytes(path)) if path.exists() else []


def _split(data: bytes) -> list[bytes]:
    return [line + b"\n" for line in data.split(b"\n")[:-1]]


def _is_data(line: bytes) -> bool:
    """Whether a line is a header or a row."""
    return bool(line.strip()) and not line.lstrip().startswith(b"#")


def _seed(origin: bytes) -> bytes:
    return hashlib.sha256(_FORMAT + origin).digest()


def _link(digest: bytes, name: str, line: bytes) -> bytes:
    return hashlib.sha256(digest + name.encode() + b"\n" + line).digest()


def adopt(directory: Path, origin: bytes) -> None:
    """Starts a chain over existing rows of a campaign from before chains. Earlier changes of them stay undetected."""
    with held(directory):
        digest, text = _seed(origin), _FORMAT
        for path in sorted(directory.glob("*.csv"), key=lambda one: (one.stat().st_mtime_ns, one.name)):
            for line in written_lines(path):
                digest = _link(digest, path.name, line)
                text += f"{digest.hex()} {path.name}\n".encode()
        replace_file(directory / CHAIN, text)


class RowChain(AppendedFile):
    """A campaign's chain, open for appending by one process at a time.

    Opening compares all of it with the record files, and cuts off the unconfirmed lines that a crash left in it and in
    the file that was written last. Raises InputError as `check_chain` does, and while another process has it open.
    """

    def __init__(self, directory: Path, origin: bytes) -> None:
        self._directory = directory
        super().__init__(directory / CHAIN)
        try:
            self._recover(origin)
        except BaseException:
            self.close()
            raise

    def _recover(self, origin: bytes) -> None:
        found = check_chain(self._directory, origin)
        if found is None:
            raise InputError("is gone", path=self.path)
        self._digest, self._lines = found.digest, dict(found.lines)
        try:
            os.ftruncate(self._fd, found.size)
            if found.size == 0:
                os.write(self._fd, _FORMAT)
            os.fsync(self._fd)
            sync_directory(self._directory)
            if found.latest:
                os.truncate(self._directory / found.latest, len(self.confirmed(found.latest)))
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", path=self.path) from error

    def confirmed(self, name: str) -> bytes:
        """The chained lines of a record file."""
        return b"".join(written_lines(self._directory / name)[: self._lines.get(name, 0)])

    def add(self, name: str, data: bytes) -> None:
        """Chains lines that are on the disk as the last ones of a record file; on return the chain is too. Raises
        OSError.
        """
        digest, text, lines = self._digest, b"", _split(data)
        for line in lines:
            digest = _link(digest, name, line)
            text += f"{digest.hex()} {name}\n".encode()
        append_durably(self._fd, text)
        self._digest = digest
        self._lines[name] = self._lines.get(name, 0) + len(lines)
