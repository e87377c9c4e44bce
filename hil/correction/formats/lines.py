"""Measurements as lines of text by a pattern, for programs whose files no format here knows (XL-80-like listings, logs of a display).

The pattern is a regular expression with named groups: `target_<unit>` and `measured_<unit>` or `error_<unit>` (measured - target), the
unit one of nm, um, mm, cm, m, in; `run` and `direction` where the lines have them, else both are taken from the order of the targets
(`measured_csv.inferred`). Any other group is a record column of its name. Lines before the first match and after the last one are
heading and trailer; a line between them that does not match is refused, never skipped.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import LENGTH_MM, numbered_lines, require
from hil.correction.formats.measured_csv import cell_value, ordered_records
from hil.records.rows import Floats, Records


@dataclass(frozen=True)
class LinesSettings:
    """pattern: the regular expression; decimal: the decimal mark, "." or ","."""

    pattern: str = ""
    decimal: str = "."

    def __post_init__(self) -> None:
        require(self.decimal in (".", ","), f"decimal mark is {self.decimal!r}, expected . or ,")
        names = list(self.compiled.groupindex)
        parts = [name.rpartition("_") for name in names]
        lengths = [what for what, _, unit in parts if what in ("target", "measured", "error") and unit in LENGTH_MM]
        require(lengths.count("target") == 1, "the pattern needs one group target_<unit>, such as (?P<target_mm>\\S+)")
        require(
            lengths.count("measured") + lengths.count("error") == 1,
            "the pattern needs one group measured_<unit> or error_<unit>, such as (?P<error_um>\\S+)",
        )

    @property
    def compiled(self) -> re.Pattern[str]:
        """Raises InputError for what is no regular expression."""
        try:
            return re.compile(self.pattern)
        except re.error as error:
            raise InputError(f"pattern is {self.pattern!r}, no regular expression: {error}") from error


def load(text: str, settings: LinesSettings) -> Records:
    """The rows in the order of the file. Raises InputError with the line."""
    pattern = settings.compiled
    found: list[tuple[int, re.Match[str]]] = []
    between: int | None = None
    for line_number, line in numbered_lines(text):
        if match := pattern.search(line):
            if between is not None and found:
                raise InputError("does not match the pattern, and lines after it do", line=between)
            found.append((line_number, match))
        elif line and between is None and found:
            between = line_number
    if len(found) < 2:
        raise InputError(f"has {len(found)} lines that match the pattern, expected at least 2")
    columns: dict[str, list[float]] = {}
    for line_number, match in found:
        for name, cell in match.groupdict().items():
            if cell is None:
                raise InputError(f"has no {name}", line=line_number)
            columns.setdefault(name, []).append(cell_value(name, cell, settings.decimal, line_number))
    return _records({name: np.array(values) for name, values in columns.items()}, [line for line, _ in found])


def _records(columns: dict[str, Floats], lines: Sequence[int]) -> Records:
    lengths = {}
    for name in list(columns):
        what, _, unit = name.rpartition("_")
        if what in ("target", "measured", "error") and unit in LENGTH_MM:
            lengths[what] = columns.pop(name) * LENGTH_MM[unit]
    target = lengths["target"]
    columns["target_mm"] = target
    columns["measured_mm"] = lengths["measured"] if "measured" in lengths else target + lengths["error"]
    return ordered_records(columns, lines)
