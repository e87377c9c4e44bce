"""Playback of a recorded file as an instrument, with its timing: real data for trying everything else without the instrument.

`Recording` holds the file's columns (CSV, `#` comments, header row; plain or .gz), `ReplayInstrument` plays one of them by a clock.
Readings carry their recorded time, shifted to the start of playback; after the last one none follow.
"""

from __future__ import annotations

import gzip
import io
import re
import zlib
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan
from pathlib import Path

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError
from drivers.files import encoding_of, is_row, without_empty_end
from drivers.instrument import DistanceInstrument, Environment, Reading, ReadingStatus

MOST_BYTES = 1 << 28
"""Longest text of a recording, unpacked: at 1 kHz and 60 bytes a row, 75 minutes."""
MOST_CELLS = 1 << 24
"""Most numbers of a recording: 128 MiB as they are kept."""
MOST_LINES = 1 << 22
"""At 1 kHz, 70 minutes."""
_LONGEST_LINE = 1 << 20
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_AIR = ("air_temp_c", "air_pressure_hpa", "air_humidity_percent")


@dataclass(frozen=True)
class Recording:
    """Columns of one length by name; `time_s` among them, ascending. Raises InputError for others."""

    columns: Mapping[str, Sequence[float]]

    def __post_init__(self) -> None:
        times = self.columns.get("time_s")
        if not times:
            raise InputError(f"recording has columns {', '.join(self.columns)}, expected time_s among them, and rows")
        if not all(isfinite(time) for time in times):
            raise InputError("time_s holds something that is no time")
        late = next((row for row in range(1, len(times)) if times[row] < times[row - 1]), None)
        if late is not None:
            raise InputError(f"row {late + 1} was recorded before row {late}, expected ascending time_s")

    @classmethod
    def read(cls, path: str | Path) -> Recording:
        """Read a file. Raises InputError naming it, and the line."""
        try:
            with Path(path).open("rb") as file:
                packed = file.peek(2)[:2] == b"\x1f\x8b"
                return cls(_columns(_lines(io.BufferedReader(gzip.GzipFile(fileobj=file)) if packed else file)))
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}", path=path) from error
        except (EOFError, zlib.error, UnicodeDecodeError) as error:
            raise InputError(f"is neither text nor packed text: {error}", path=path) from error
        except InputError as error:
            raise InputError(error.what, path=path, line=error.line) from error

    def column(self, name: str) -> Sequence[float]:
        """The values of a column. Raises InputError for one that is not there."""
        if name not in self.columns:
            raise InputError(f"recording has no column {name}; it has {', '.join(self.columns)}")
        return self.columns[name]


def _lines(file: io.BufferedReader) -> Iterator[str]:
    """The lines, unpacked one after the other. Raises InputError for a text or a line that is too long."""
    total = count = 0
    with io.TextIOWrapper(file, encoding=encoding_of(file.peek(4)[:4]), newline=None) as text:
        while line := text.readline(_LONGEST_LINE):
            total += len(line)
            count += 1
            if total > MOST_BYTES or count > MOST_LINES or len(line) == _LONGEST_LINE:
                raise InputError(
                    f"is too long unpacked, expected at most {MOST_BYTES >> 20} MiB in {MOST_LINES} lines"
                    f" of {_LONGEST_LINE >> 20} MiB"
                )
            yield line.lstrip("\ufeff") if count == 1 else line


def _columns(lines: Iterator[str]) -> dict[str, Sequence[float]]:
    columns: dict[str, array[float]] = {}
    cells_read = 0
    for number, line in enumerate(lines, start=1):
        if not is_row(line):
            continue
        cells = without_empty_end([cell.strip() for cell in line.split(",")], len(columns))
        if not columns:
            columns = {name: array("d") for name in cells}
            if len(columns) != len(cells):
                raise InputError("header names a column twice", line=number)
            continue
        if len(cells) != len(columns):
            raise InputError(f"row has {len(cells)} columns, expected {len(columns)}", line=number)
        cells_read += len(cells)
        if cells_read > MOST_CELLS:
            raise InputError(f"holds more than {MOST_CELLS} numbers", line=number)
        for name, cell in zip(columns, cells, strict=True):
            value = nan if not cell or cell.lower() == "nan" else float(cell) if _NUMBER.fullmatch(cell) else inf
            if value in (inf, -inf):
                raise InputError(f"{name} is {cell[:40]!r}, expected a number", line=number)
            columns[name].append(value)
    return dict(columns)


@dataclass(frozen=True)
class ReplaySettings:
    """column: the position's; direction: +1 or −1, motion of the load for rising values; speed: playback factor. Raises InputError."""

    column: str = "laser_mm"
    direction: int = 1
    speed: float = 1.0

    def __post_init__(self) -> None:
        if self.direction not in (1, -1):
            raise InputError(f"replay direction is {self.direction}, expected 1 or -1")
        if not 0.0 < self.speed <= 1e6:
            raise InputError(f"replay speed is {self.speed:g}, expected more than 0")


class ReplayInstrument(DistanceInstrument):
    """Plays from `open()` on. A row whose value is empty is a reading without a signal."""

    name = "replay"

    def __init__(self, recording: Recording, clock: Clock, settings: ReplaySettings) -> None:
        self.settings = settings
        self._values = recording.column(self.settings.column)
        first_s = recording.column("time_s")[0]
        self._due_ns = [round((time - first_s) / self.settings.speed * NS_PER_S) for time in recording.column("time_s")]
        self._recording = recording
        self._clock = clock
        self._start_ns = clock.now_ns()
        self._next = 0

    def open(self) -> None:
        self._start_ns, self._next = self._clock.now_ns(), 0

    def close(self) -> None:
        """Does nothing: no file is kept open."""

    def poll(self) -> list[Reading]:
        end = bisect_right(self._due_ns, self._clock.now_ns() - self._start_ns)
        readings = [self._reading(row) for row in range(self._next, end)]
        self._next = max(self._next, end)
        return readings

    def _reading(self, row: int) -> Reading:
        time_ns, value = self._start_ns + self._due_ns[row], self._values[row]
        if not isfinite(value):
            return Reading(time_ns, ReadingStatus.BEAM_LOST, None, row)
        return Reading(time_ns, ReadingStatus.GOOD, self.settings.direction * value, row)

    @property
    def over(self) -> bool:
        """Whether the last row has been played."""
        return self._next == len(self._due_ns)

    def environment(self) -> Environment:
        """Values of the last row played; what the recording does not hold is None."""
        row = max(0, self._next - 1)
        now = {name: column[row] for name, column in self._recording.columns.items() if isfinite(column[row])}
        air_temp_c, pressure_hpa, humidity_percent = (now.get(name) for name in _AIR)
        places = {name[5:-2]: value for name, value in now.items() if name.startswith("temp_") and name.endswith("_c")}
        time_ns = self._start_ns + self._due_ns[row]
        return Environment(time_ns, air_temp_c, pressure_hpa, humidity_percent, places)

    @property
    def sample_rate_hz(self) -> float | None:
        """The mean rate of the recording, Hz; None for one of no duration."""
        return (len(self._due_ns) - 1) * NS_PER_S / self._due_ns[-1] if self._due_ns[-1] else None
