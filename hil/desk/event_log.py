"""The log of an axis for people: who started, stopped and wrote what, and alarms with cause and remedy. Kept on disk, one line each.

An entry holds a key and figures, not a sentence, so that each screen tells it in its own language. An alarm stands until somebody has
acknowledged it, also over a restart.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from enum import Enum
from pathlib import Path

from drivers.errors import InputError
from drivers.files import decode_log, read_bytes
from hil.records.files import parse_json, split_lines

EVENTS = "events.jsonl"
MOST_BYTES = 4_000_000
"""Largest size of the file, some ten thousand entries. A full one becomes `events.jsonl.1`, replacing the one before, and the
new one begins with the alarms that still stand."""
KEPT = 500
"""Latest entries in memory, for the screen, and standing alarms at most."""


class LogKind(Enum):
    """Kind of an entry."""

    ALARM = "alarm"
    JOB = "job"
    WRITE = "write"
    STOP = "stop"
    CONTROL = "control"
    ACKNOWLEDGED = "acknowledged"


@dataclass(frozen=True)
class LogEntry:
    """number: in the order of time; when: ISO 8601 with offset; what: key of the sentence; figures: what fills its places

    who: name of the browser, "" for none; cause: in English, of an alarm; remedy: key of what to do
    """

    number: int
    when: str
    kind: LogKind
    axis: str
    what: str
    figures: Mapping[str, str] = field(default_factory=dict)
    who: str = ""
    cause: str = ""
    remedy: str = ""

    @property
    def time(self) -> datetime:
        """When it was."""
        return datetime.fromisoformat(self.when)


class EventLog:
    """The log in one file, for any thread. A line that cannot be read is left out.

    trouble: why the file could not be written; the entries are in memory all the same
    """

    def __init__(self, path: Path, axis: str) -> None:
        self.path, self.axis = path, axis
        self._lock = threading.Lock()
        self._entries: deque[LogEntry] = deque(maxlen=KEPT)
        self._open: dict[int, LogEntry] = {}  # alarms that nobody has acknowledged
        self._number = 0
        self.trouble = ""
        for entry in _read(path):
            self._take(entry)

    def add(
        self, kind: LogKind, what: str, *, who: str = "", cause: str = "", remedy: str = "", **figures: str
    ) -> LogEntry:
        """Add an entry, in memory and on disk."""
        with self._lock:
            when = datetime.now().astimezone().isoformat(timespec="milliseconds")
            entry = LogEntry(self._number + 1, when, kind, self.axis, what, figures, who, cause, remedy)
            self._take(entry)
            try:
                self._write(entry)
                self.trouble = ""
            except OSError as error:
                self.trouble = f"{self.path}: {error.strerror}"
            return entry

    def acknowledge(self, number: int, who: str) -> None:
        """Acknowledge the alarm of this number; ignored for one that does not stand any more."""
        if number in self._open:
            self.add(LogKind.ACKNOWLEDGED, "acknowledged", who=who, number=str(number))

    def entries(self) -> tuple[LogEntry, ...]:
        """The latest entries, the newest first."""
        with self._lock:
            return tuple(reversed(self._entries))

    def alarms(self) -> tuple[LogEntry, ...]:
        """Alarms that nobody has acknowledged, the newest first."""
        with self._lock:
            return tuple(reversed(self._open.values()))

    @property
    def number(self) -> int:
        """Number of the latest entry, for a reader that looks for new ones."""
        return self._number

    def _take(self, entry: LogEntry) -> None:
        self._number = entry.number
        self._entries.append(entry)
        if entry.kind is LogKind.ALARM:
            self._open[entry.number] = entry
            if len(self._open) > KEPT:
                del self._open[min(self._open)]
        elif entry.kind is LogKind.ACKNOWLEDGED:
            self._open.pop(int(entry.figures.get("number", 0)), None)

    def _write(self, entry: LogEntry) -> None:
        text = _line(entry)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.exists() and self.path.stat().st_size + len(text) > MOST_BYTES:
            self.path.replace(self.path.with_name(f"{self.path.name}.1"))
            text = b"".join(_line(alarm) for alarm in self._open.values() if alarm is not entry) + text
        with self.path.open("ab", buffering=0) as file:
            file.write(text)


def _line(entry: LogEntry) -> bytes:
    return (json.dumps({**asdict(entry), "kind": entry.kind.value}, ensure_ascii=False) + "\n").encode()


def _read(path: Path) -> list[LogEntry]:
    entries = []
    try:
        lines = split_lines(decode_log(read_bytes(path)))
    except InputError:
        return []
    for line in lines:
        try:
            form = parse_json(line)
            entries.append(LogEntry(**{**form, "kind": LogKind(form["kind"])}))
        except (ValueError, TypeError, KeyError):
            continue
    return entries
