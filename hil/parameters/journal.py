"""The journal of a download: the old and the new value of every parameter, on disk before the first write.

One file per download, one line of JSON per step, each synced before the next step. A line torn by a power cut was never acted upon
and does not count. A download whose journal has no end is unfinished; `resume` and `rollback` recover it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from drivers.files import decode_log, read_bytes, sync_directory
from drivers.raw_parameters import DriveIdentity
from hil.records.files import parse_json, split_lines


class DownloadPhase(Enum):
    """The steps of a download."""

    BEGIN = "begin"  # nothing is written yet
    PROVEN = "proven"  # everything reads back as wanted
    STORING = "storing"  # the drive may have begun to store
    STORED = "stored"
    GOING_BACK = "going back"
    END = "end"  # with what the drive holds now


@dataclass(frozen=True)
class Noted:
    """One parameter of a download, as the drive's bytes. after: addresses that are written before it."""

    address: str
    name: str
    old: bytes
    new: bytes
    after: tuple[str, ...] = ()


@dataclass(frozen=True)
class Download:
    """Contents of a journal. store: it was to be stored; phases: in the order of the lines; ending: from the last line."""

    axis: str
    set_name: str
    set_hash: str
    identity: DriveIdentity
    parameters: tuple[Noted, ...]
    store: bool
    began: str
    path: Path
    phases: tuple[DownloadPhase, ...] = ()
    ending: str = ""

    @property
    def finished(self) -> bool:
        """Whether the journal has its end."""
        return DownloadPhase.END in self.phases

    @property
    def changes(self) -> bool:
        """Whether any new value differs from the old one."""
        return any(each.old != each.new for each in self.parameters)

    @property
    def may_have_stored(self) -> bool:
        """Whether a store was begun."""
        return DownloadPhase.STORING in self.phases


class Journal:
    """The journals of one axis, in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob("download-[0-9][0-9][0-9][0-9].jsonl"))

    def last(self) -> Download | None:
        """The latest download. Raises InputError for a file that is no journal."""
        return next((found for path in reversed(self._files()) if (found := _read(path)) is not None), None)

    def last_change(self) -> Download | None:
        """The latest download that changes a value. Raises InputError for a file that is no journal."""
        found = (_read(path) for path in reversed(self._files()))
        return next((one for one in found if one is not None and one.changes), None)

    def unfinished(self) -> Download | None:
        """The latest download if it is unfinished. Raises InputError for a file that is no journal."""
        last = self.last()
        return last if last is not None and not last.finished else None

    def begin(
        self,
        axis: str,
        set_name: str,
        set_hash: str,
        identity: DriveIdentity,
        parameters: Sequence[Noted],
        *,
        store: bool,
    ) -> Download:
        """Write the first line of a new journal, before the first write to the drive. Raises InputError when it cannot be written."""
        files = self._files()
        number = int(files[-1].stem.rpartition("-")[2]) + 1 if files else 1
        download = Download(
            axis,
            set_name,
            set_hash,
            identity,
            tuple(parameters),
            store,
            datetime.now(UTC).isoformat(timespec="seconds"),
            self.folder / f"download-{number:04d}.jsonl",
        )
        self._append(download.path, {"phase": DownloadPhase.BEGIN.value, **_form(download)}, new=True)
        return download

    def note(self, download: Download, phase: DownloadPhase, **facts: object) -> None:
        """Append a step. Raises InputError when it cannot be written."""
        self._append(download.path, {"phase": phase.value, **facts})

    def _append(self, path: Path, form: Mapping[str, object], *, new: bool = False) -> None:
        line = (json.dumps(form, separators=(",", ":")) + "\n").encode()
        try:
            if new:
                path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(
                path, os.O_RDWR | os.O_APPEND | os.O_CLOEXEC | (os.O_CREAT | os.O_EXCL if new else 0), 0o666
            )
            try:
                _cut_torn_line(handle)
                written = os.write(handle, line)
                if written != len(line):
                    raise InputError("cannot be written: the disk is full", path=path)
                os.fsync(handle)
            finally:
                os.close(handle)
            if new:
                sync_directory(path.parent)
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", path=path) from error


def _cut_torn_line(handle: int) -> None:
    data = os.read(handle, os.fstat(handle).st_size)
    if not data.endswith(b"\n"):
        os.ftruncate(handle, data.rfind(b"\n") + 1)


def _form(download: Download) -> dict[str, Any]:
    return {
        "axis": download.axis,
        "set": download.set_name,
        "hash": download.set_hash,
        "began": download.began,
        "store": download.store,
        "identity": {
            name: value if isinstance(value, str) else dict(value) for name, value in asdict(download.identity).items()
        },
        "parameters": [
            [each.address, each.name, each.old.hex(), each.new.hex(), list(each.after)] for each in download.parameters
        ],
    }


def _read(path: Path) -> Download | None:
    """A journal; None for one whose first line is torn, as nothing was written to the drive then."""
    data = read_bytes(path)
    whole = data[: data.rfind(b"\n") + 1]
    lines = split_lines(decode_log(whole))
    if not lines:
        return None
    try:
        forms = [parse_json(line) for line in lines]
        first = forms[0]
        phases = tuple(DownloadPhase(form["phase"]) for form in forms)
        if phases[0] is not DownloadPhase.BEGIN:
            raise ValueError
        return Download(
            first["axis"],
            first["set"],
            first["hash"],
            DriveIdentity(**first["identity"]),
            tuple(
                Noted(address, name, bytes.fromhex(old), bytes.fromhex(new), tuple(after))
                for address, name, old, new, after in first["parameters"]
            ),
            bool(first["store"]),
            first["began"],
            path,
            phases,
            str(forms[-1].get("ending", "")),
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError("is no journal of a download", path=path) from error
