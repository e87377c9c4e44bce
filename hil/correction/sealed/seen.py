"""What a machine remembers of its sealed file, kept beside its axis: so that an older file, or another machine's, is not taken for it.

A file keeps its id for life, and its counter grows by one each time the builder changes it. The first file that is used is
remembered; from then on a file of another id, of a smaller counter, or of the same counter with other contents is refused, until
the builder accepts it with the private key. The note itself is not signed: who may write the folder may delete it, and with it the
memory.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from drivers.files import replace_file
from hil.correction.sealed.errors import ReplacedError
from hil.correction.sealed.sealing import SealedInfo
from hil.records.files import read_note


@dataclass(frozen=True)
class SeenFile:
    """A sealed file. id, sha256, builder (fingerprint): in hex; counter: 0 for a file of version 1; date: "" for one."""

    id: str
    counter: int
    date: str
    builder: str
    sha256: str

    @classmethod
    def of(cls, info: SealedInfo) -> SeenFile:
        """What a checked file states."""
        binding = info.binding
        counter, date = (0, "") if binding is None else (binding.counter, binding.date)
        return cls(info.id, counter, date, info.builder, info.sha256)

    def __str__(self) -> str:
        return f"{self.id[:8]}, change {self.counter}" + (f" of {self.date[:10]}" if self.date else "")


def check_seen(note: Path, info: SealedInfo) -> None:
    """Returns where the checked file is the one in the note or a later one, or there is no note yet; updates the note.

    Raises ReplacedError for an older file, another one, or another of the same number; InputError for a note that cannot be read
    or written.
    """
    now = SeenFile.of(info)
    last = read_note(note, _read, "does not say which sealed file was used before")
    if last is not None and last.id != now.id:
        raise _replaced(
            f"is another file ({now}) than the one used before ({last}): of another machine, or sealed anew"
        )
    if last is not None and now.counter < last.counter:
        raise _replaced(f"is older ({now}) than the file used before ({last})")
    if last is not None and (now.counter, now.builder) == (last.counter, last.builder) and now.sha256 != last.sha256:
        raise _replaced(f"has the number, but not the contents, of the file used before ({last})")
    if now != last:
        remember(note, info)


def remember(note: Path, info: SealedInfo) -> None:
    """Put this file into the note, whatever was there: the builder has made or accepted it. Raises InputError."""
    replace_file(note, (json.dumps(asdict(SeenFile.of(info)), indent=1) + "\n").encode())


def _replaced(what: str) -> ReplacedError:
    return ReplacedError(f"{what}; the builder accepts it with `hil sign --accept AXIS.toml`")


def _read(form: Any) -> SeenFile:
    seen = SeenFile(**form)
    texts = (seen.id, seen.date, seen.builder, seen.sha256)
    if type(seen.counter) is not int or not all(isinstance(text, str) for text in texts):
        raise ValueError("types")
    return seen
