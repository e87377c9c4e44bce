"""Measurements of the Keysight (Agilent) E1733A laser software: a `.Lin` file of linear positioning.

The file is text, one field per line: `Identify=<name>,<type>=<value>`, the value with or without quotation marks, after a comma, a
blank, or on the next line. Two fields are read, both of the type `TextUnit`: `Positions`, the targets and their unit, and
`LinearErr`, the errors and their unit, cycle by cycle: first those of the targets forward, then of the same targets backward.
Numbers are separated by blanks, commas, semicolons or tabs; the unit comes last. The values of several lines with one name are
joined. All other fields (set-up, environment, the software's own results) are ignored.

The file does not say whether a comma separates numbers or is a decimal mark: where it can be either, the file is refused unless the
settings state a decimal comma.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import LENGTH_MM, number, numbered_lines, require
from hil.records.rows import Floats, Records

_COMMA_WITHIN = re.compile(r"\d+,\d+")
_FIELD = re.compile(r'Identify\s*=\s*"?(\w+)"?[\s,;]*"?\s*(?:(\w+)\s*=\s*(.*))?$', re.IGNORECASE)
_VALUE = re.compile(r'"?(\w+)\s*=\s*(.*)$')


@dataclass(frozen=True)
class KeysightSettings:
    """decimal: the decimal mark, "." or ",". The units are in the file."""

    decimal: str = "."

    def __post_init__(self) -> None:
        require(self.decimal in (".", ","), f"decimal mark is {self.decimal!r}, expected . or ,")


def load(text: str, settings: KeysightSettings = KeysightSettings()) -> Records:
    """The rows in the order of measuring, one run per cycle: targets forward, then backward. Raises InputError with the line."""
    targets: list[float] = []
    errors: list[float] = []
    last_line = {"positions": 0, "linearerr": 0}
    for line_number, name, kind, value in _fields(text):
        if name.lower() not in last_line:
            continue
        if kind.lower() != "textunit":
            raise InputError(f"{name} is given as {kind!r}, expected TextUnit", line=line_number)
        (targets if name.lower() == "positions" else errors).extend(
            _lengths_mm(value, name, line_number, settings.decimal)
        )
        last_line[name.lower()] = line_number
    for name, values in (("Positions", targets), ("LinearErr", errors)):
        if not values:
            raise InputError(f"holds no field {name} (Identify={name},TextUnit=…): is it a file of linear positioning?")
    per_cycle = 2 * len(targets)
    if len(set(targets)) != len(targets):
        raise InputError("names a position twice", line=last_line["positions"])
    if len(targets) > 1 and len(set(np.sign(np.diff(targets)))) > 1:
        raise InputError("names positions that neither ascend nor descend", line=last_line["positions"])
    if len(errors) % per_cycle:
        raise InputError(
            f"holds {len(errors)} errors for {len(targets)} positions, expected a multiple of {per_cycle}"
            " (forward and backward)",
            line=last_line["linearerr"],
        )
    return _records(np.array(targets), np.array(errors), per_cycle)


def _fields(text: str) -> Iterator[tuple[int, str, str, str]]:
    """Line, name, type and value of each field; a name whose value is missing has the type ""."""
    waiting: tuple[int, str] | None = None
    for line_number, line in numbered_lines(text):
        if match := _FIELD.match(line):
            if waiting is not None:
                yield *waiting, "", ""
            waiting = None if match[2] else (line_number, match[1])
            if match[2]:
                yield line_number, match[1], match[2], match[3]
        elif waiting is not None and (match := _VALUE.match(line)):
            yield line_number, waiting[1], match[1], match[2]
            waiting = None
    if waiting is not None:
        yield *waiting, "", ""


def _lengths_mm(text: str, name: str, line: int, decimal: str) -> list[float]:
    text = text.strip().strip('"')
    tokens = re.split(r"[\s;]+" if decimal == "," else r"[\s,;]+", text)
    tokens = [token for token in (token.rstrip(",") for token in tokens) if token]
    if not tokens:
        raise InputError(f"{name} is empty", line=line)
    unit = tokens[-1].lower()
    if unit not in LENGTH_MM:
        raise InputError(f"{name} ends in {tokens[-1]!r}, expected a unit of length such as mm or um", line=line)
    if decimal == "." and (both := _COMMA_WITHIN.search(text)) and len(re.split(r"[\s;]+", text)) > 2:
        raise InputError(
            f"{name} holds {both[0]!r}: one number or two? With a decimal comma, say so (decimal ,)", line=line
        )
    return [number(token, f"a value of {name}", line, decimal) * LENGTH_MM[unit] for token in tokens[:-1]]


def _records(targets: Floats, errors: Floats, per_cycle: int) -> Records:
    ascending = 1.0 if targets[-1] >= targets[0] else -1.0
    cycle_targets = np.concatenate([targets, targets[::-1]])
    cycle_direction = np.repeat([ascending, -ascending], len(targets))
    cycles = len(errors) // per_cycle
    target = np.tile(cycle_targets, cycles)
    return Records.of(
        {
            "run": np.repeat(np.arange(1.0, cycles + 1), per_cycle),
            "direction": np.tile(cycle_direction, cycles),
            "target_mm": target,
            "measured_mm": target + errors,
        }
    )
