"""Measurements of Renishaw's laser software: text files `.rtl`, and `.pos` of the same sections.

The maker's description is not public; the layout is what independent programs read and write of it. A section begins with a
line such as `TARGET DATA::`. Read are `Target-count:` and the numbers after `Targets :` up to `Flags:` (positions, mm, over
several lines); `Run-count:` in `RUNS::`; and in `DEVIATIONS::` after `Run Target Data:` one line for each reading: number of
the run, number of the target (from 1), deviation (reading - target, µm). A run is one way along the axis; in a bidirectional
test the second one goes back. Two runs of opposite direction are one run here. `USER-TEXT::` (machine, serial number, date,
axis) and `ENVIRONMENT::` are left out.

Sources, all of public repositories: a pitch-compensation editor in C# (class FileRenishaw: sections, three columns, several
lines of targets), a calibration program in C# (LinearCalc: Targets to Flags in mm, deviations in µm, every second run
backward), a measuring program in C# that writes the file (deviation 1000 (reading - target), both in mm; `Flags: 0 0 2 0`
bidirectional, `0 1 2 0` one way with zeros for the way back), a viewer in JavaScript (the same columns), an evaluation in
Python (Targets to Flags, deviations to the next section). No file of Renishaw's own was seen.

`.pos` is an extension of several makers: one with the sections above is read; one of averages alone (`Bidirectional Avg
Error`, API) holds no runs and is refused.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import number, numbered_lines, require
from hil.records.rows import UM_PER_MM, Records

_SECTION = re.compile(r"([A-Z][A-Z0-9 -]*)::$")
_KEY = re.compile(r"([A-Za-z][\w -]*?)\s*:\s*(.*)$")
_AVERAGES = "Avg Error"
_OTHERS = ("angular", "straightness", "flatness", "squareness", "rotary", "dynamic")
"""Quantities of the maker's software that are no positions; as owner of a file they are refused."""


@dataclass(frozen=True)
class RenishawSettings:
    """decimal: the decimal mark, "." or ","."""

    decimal: str = "."

    def __post_init__(self) -> None:
        require(self.decimal in (".", ","), f"decimal mark is {self.decimal!r}, expected . or ,")


@dataclass
class _Read:
    """What a file holds.

    readings: run -> [(target from 1, deviation µm, line)] in the order of the file; one_way: its flags where they say that only
    the way there was measured
    """

    targets_mm: list[float]
    target_count: int | None
    run_count: int | None
    readings: dict[int, list[tuple[int, float, int]]]
    last_line: int
    one_way: list[str] | None = None


def load(text: str, settings: RenishawSettings = RenishawSettings()) -> Records:
    """The rows in the order of the file; the first way and the one back are one run. Raises InputError with the line."""
    read = _sections(text, settings)
    _check(read)
    rows: list[tuple[float, float, float, float]] = []
    run, seen = 0, set[int]()
    for number_, readings in read.readings.items():
        sign = _direction(number_, readings)
        if sign in seen or not seen:
            run, seen = run + 1, set()
        seen.add(sign)
        for target, deviation_um, _ in readings:
            at = read.targets_mm[target - 1]
            rows.append((float(run), float(sign * _ascending(read)), at, at + deviation_um / UM_PER_MM))
    return Records.of(dict(zip(("run", "direction", "target_mm", "measured_mm"), np.array(rows).T, strict=True)))


def _ascending(read: _Read) -> int:
    """+1 where the numbers of the targets rise with their positions, else -1."""
    return 1 if read.targets_mm[-1] > read.targets_mm[0] else -1


def _sections(text: str, settings: RenishawSettings) -> _Read:
    read = _Read([], None, None, {}, 0)
    section = part = ""
    for line_number, line in numbered_lines(text):
        if not line:
            continue
        read.last_line = line_number
        if _AVERAGES in line:
            what = "holds averages of the runs (Avg Error), not the readings; export the measurement itself"
            raise InputError(what, line=line_number)
        if match := _SECTION.match(line):
            section, part = match[1].strip(), ""
        elif match := _KEY.match(line):
            part = match[1].strip().lower()
            _key(read, (section, part), match[2], line_number, settings)
        elif section == "TARGET DATA" and part == "targets":
            read.targets_mm += [number(cell, "a target", line_number, settings.decimal) for cell in line.split()]
        elif section == "DEVIATIONS" and part == "run target data":
            _reading(read, line, line_number, settings)
    return read


def _key(read: _Read, where: tuple[str, str], value: str, line: int, settings: RenishawSettings) -> None:
    (section, name), value = where, value.strip()
    if section == "TARGET DATA" and name == "target-count":
        read.target_count = _whole(value, "Target-count", line)
    elif section == "TARGET DATA" and name == "targets" and value:
        read.targets_mm += [number(cell, "a target", line, settings.decimal) for cell in value.split()]
    elif section == "RUNS" and name == "run-count":
        read.run_count = _whole(value, "Run-count", line)
    elif section == "HEADER" and name == "owner" and value.lower().startswith(_OTHERS):
        raise InputError(f"is a measurement of {value!r}: its deviations are no lengths along the axis", line=line)
    elif section == "TARGET DATA" and name == "flags" and (flags := value.split())[1:2] == ["1"]:
        read.one_way = flags


def _whole(text: str, what: str, line: int) -> int:
    if not re.fullmatch(r"\d{1,6}", text):
        raise InputError(f"{what} is {text!r}, expected a whole number", line=line)
    return int(text)


def _reading(read: _Read, line: str, line_number: int, settings: RenishawSettings) -> None:
    cells = line.split()
    if len(cells) != 3:
        raise InputError(f"a reading has {len(cells)} columns, expected run, target and deviation", line=line_number)
    run, target = (_whole(cell, name, line_number) for cell, name in zip(cells, ("run", "target"), strict=False))
    deviation = number(cells[2], "a deviation", line_number, settings.decimal)
    read.readings.setdefault(run, []).append((target, deviation, line_number))


def _check(read: _Read) -> None:
    """Raises InputError for a file that is incomplete or not in order."""
    if not read.targets_mm or not read.readings:
        missing = "targets (Targets :)" if not read.targets_mm else "readings (Run Target Data:)"
        raise InputError(f"holds no {missing}: is it a measurement of Renishaw's laser software?")
    count = len(read.targets_mm)
    if read.target_count is not None and read.target_count != count:
        raise InputError(f"names {count} targets, and Target-count says {read.target_count}")
    steps = np.sign(np.diff(read.targets_mm))
    if count < 2 or len(set(steps.tolist())) != 1 or steps[0] == 0:
        raise InputError("targets neither ascend nor descend")
    if read.run_count is not None and read.run_count != len(read.readings):
        raise InputError(f"holds {len(read.readings)} runs, and Run-count says {read.run_count}", line=read.last_line)
    if read.one_way and any(_direction(run, readings) < 0 for run, readings in read.readings.items()):
        what = f"flags {' '.join(read.one_way)} say one way, and runs go back: such runs are filled with zeros, take them out"
        raise InputError(what, line=read.last_line)
    for run, readings in read.readings.items():
        for target, _, line in readings:
            if not 1 <= target <= count:
                raise InputError(f"target {target} of run {run} is none of the {count}", line=line)
        if len(readings) != count:
            raise InputError(f"run {run} has {len(readings)} readings, expected {count}", line=readings[-1][2])


def _direction(run: int, readings: list[tuple[int, float, int]]) -> int:
    """+1 for targets in the order of their numbers, -1 for the opposite order."""
    steps = {later[0] - earlier[0] for earlier, later in itertools.pairwise(readings)}
    if steps == {1}:
        return 1
    if steps == {-1}:
        return -1
    raise InputError(f"the targets of run {run} are not in order, one way along the axis", line=readings[0][2])
