"""TwinCAT CNC (ISG kernel) leadscrew error compensation: the compensation value list achskw*.lis, kw.ssfk.

Source: Beckhoff TF5200 / ISG "Axis compensation" and "Compensation parameters" (P-COMP-00017 to 00025, P-COMP-00059) with their
example of a bilateral list. A compensation value is the *position error*, actual - setpoint, in 0.1 µm, which the controller
subtracts from the setpoint; so a value is -correction. (The example's measured values, 19866.7 µm commanded and 19856.5 µm reached,
give -102. Its list has that point with a minus sign before the position, which its table of measured values has not.) Points need not
be equidistant (interval 0); both directions have the same points (bilateral 1). Beyond the ends the outer values hold. At most 1500
points, unless P-COMP-00059 allows more.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import (
    Export,
    both_directions,
    check_written,
    evenly,
    number,
    numbered_lines,
    require,
    rounded_nodes,
    table_set,
    thinned,
)
from hil.correction.tables import TableSet
from hil.records.rows import UM_PER_MM, Floats

QUANTUM_UM = 0.1
"""Unit of positions and values, µm."""
LARGEST = 2**31 - 1
"""Largest position or value: both have 32 bits."""


@dataclass(frozen=True)
class TwinCatSettings:
    """axis, name: number and name of the logical axis; tolerance_um: largest deviation from tables with more than max_points points"""

    axis: int = 1
    name: str = "X"
    max_points: int = 1500
    tolerance_um: float = 0.1

    def __post_init__(self) -> None:
        require(1 <= self.axis <= 65535, f"axis number is {self.axis}, expected 1 to 65535")
        require(re.fullmatch(r"\S+", self.name) is not None, f"axis name is {self.name!r}, expected one word")
        require(self.max_points >= 2, f"at most {self.max_points} points, expected 2 or more")
        require(self.tolerance_um >= 0, f"tolerance is {self.tolerance_um} µm, expected 0 or more")


def export(tables: TableSet, settings: TwinCatSettings = TwinCatSettings()) -> Export:
    """The compensation value list of these tables. Raises InputError for tables that it cannot hold."""
    wanted = both_directions(tables)
    fewer = thinned(wanted, settings.max_points, settings.tolerance_um)
    table = rounded_nodes(fewer, QUANTUM_UM / UM_PER_MM)
    setpoints = np.round(table.position_mm * UM_PER_MM / QUANTUM_UM)
    plus, minus = (np.round(-values / QUANTUM_UM) + 0.0 for values in (table.plus_um, table.minus_um))
    largest = float(np.max(np.abs([setpoints, plus, minus])))
    if largest > LARGEST:
        raise InputError(
            f"a position or value of {largest * QUANTUM_UM / UM_PER_MM:.1f} mm does not fit 32 bits of 0.1 µm"
        )
    lines = [
        f"kopf.achs_nr                        {settings.axis}",
        f"kopf.log_achs_name                  {settings.name}",
        "kw.ssfk.interval                    0",
        f"kw.ssfk.kw_startpos                 {setpoints[0]:.0f}",
        f"kw.ssfk.kw_nr_max                   {len(setpoints)}",
        "kw.ssfk.unit                        1",
        "kw.ssfk.bilateral                   1",
        "kw.ssfk.modulo                      0",
    ]
    for name, values in (("setpoint", setpoints), ("pos", plus), ("neg", minus)):
        lines += [f"kw.ssfk.table[{i}].{name:<20s}{value:.0f}" for i, value in enumerate(values)]
    text = "\n".join(lines) + "\n"
    deviation = check_written(load(text), wanted, limit_um=settings.tolerance_um + QUANTUM_UM)
    notes = [
        "lr_param.ssfk 1 (P-AXIS-00175) in the axis list; the axis must be referenced",
        "no backlash compensation (P-AXIS-00021 0): both directions are in the list",
    ]
    if float(np.max(np.abs([plus, minus]))) > 2**15 - 1:
        notes.append("values beyond ±3.2767 mm need a kernel whose values have 32 bits")
    return Export(text, len(setpoints), deviation, notes=tuple(notes))


_ENTRY = re.compile(r"(kopf|kw)\.([\w.]+?)(?:\[(\d{1,9})\]\.(\w+))?\s+(\S.*)$")


@dataclass
class _Reader:
    """The contents of a list. head: single entries with their lines; table: the columns by point number, in units of 0.1 µm."""

    head: dict[str, tuple[str, int]] = field(default_factory=dict)
    table: dict[str, dict[int, float]] = field(default_factory=lambda: {"setpoint": {}, "pos": {}, "neg": {}})

    def read(self, line: str, line_number: int) -> None:
        match = _ENTRY.match(line)
        if match is None:
            nested = "; a comment within a comment ends both: take one out" if line.endswith(("*)", "*/")) else ""
            raise InputError(f"{line!r} is no entry of a compensation value list{nested}", line=line_number)
        group, name, index, column, value = match.groups()
        if group == "kopf":
            return
        if not name.startswith("ssfk."):
            raise InputError(f"kw.{name} is no leadscrew error compensation (kw.ssfk)", line=line_number)
        if index is None:
            self.head[name.removeprefix("ssfk.")] = value.strip(), line_number
            return
        if name != "ssfk.table" or column not in self.table:
            raise InputError(f"kw.{name}[{index}].{column} is not known", line=line_number)
        if int(index) in self.table[column]:
            raise InputError(f"table[{index}].{column} is given twice", line=line_number)
        self.table[column][int(index)] = number(value.strip(), f"table[{index}].{column}", line_number)

    def entry(self, name: str, default: float) -> float:
        value, line = self.head.get(name, (str(default), 0))
        return number(value, f"kw.ssfk.{name}", line)


def load(text: str, settings: TwinCatSettings = TwinCatSettings()) -> TableSet:
    """The tables of a compensation value list, equidistant or not, unilateral or bilateral. The settings are not used.

    Comments are `#` to the end of the line, `(* *)` and `/* */`, also over several lines.
    Raises InputError, with the line where there is one, also for lists of other compensations
    (kw.crosscomp …) and values in encoder increments.
    """
    reader = _Reader()
    for line_number, line in numbered_lines(_without_comments(text)):
        if line:
            reader.read(line, line_number)
    count = int(reader.entry("kw_nr_max", 0))
    if count < 1:
        raise InputError("lacks kw.ssfk.kw_nr_max, or it is zero")
    if reader.entry("unit", 0) != 1:
        raise InputError("kw.ssfk.unit is not 1: values in encoder increments cannot be told in µm")
    if reader.entry("modulo", 0):
        raise InputError("kw.ssfk.modulo is set, expected a linear axis")
    if count > len(reader.table["pos"]):
        raise InputError(f"kw.ssfk.kw_nr_max is {count}, the table holds {len(reader.table['pos'])} values pos")
    if interval := reader.entry("interval", 0):
        setpoints = evenly(reader.entry("kw_startpos", 0), interval, count)
    else:
        setpoints = _column(reader.table["setpoint"], "setpoint", count)
    plus = -QUANTUM_UM * _column(reader.table["pos"], "pos", count)
    minus = -QUANTUM_UM * _column(reader.table["neg"], "neg", count) if reader.entry("bilateral", 0) else plus
    return table_set(np.asarray(setpoints * (QUANTUM_UM / UM_PER_MM)), plus + 0.0, minus + 0.0)


_COMMENT = re.compile(r"#|//|\(\*|/\*")
_CLOSES = {"(*": "*)", "/*": "*/"}


def _without_comments(text: str) -> str:
    """The text, with its line ends, less its comments. Raises InputError with the line for a /* that does not end."""
    kept, at = [], 0
    last = {opens: text.rfind(closes) for opens, closes in _CLOSES.items()}
    while found := _COMMENT.search(text, at):
        kept.append(text[at : found.start()])
        opens = found[0]
        if found.end() <= last.get(opens, -1):
            end = text.index(_CLOSES[opens], found.end()) + len(_CLOSES[opens])
            kept.append(" " + "\n" * len(_LINE_END.findall(text, found.end(), end)))
        elif opens == "/*":
            line = len(_LINE_END.findall(text, 0, found.start())) + 1
            raise InputError("the comment /* does not end, expected */", line=line)
        else:
            line_end = _LINE_END.search(text, found.end())
            end = len(text) if line_end is None else line_end.start()
        at = end
    return "".join([*kept, text[at:]])


_LINE_END = re.compile(r"\r\n|\n|\r")


def _column(values: dict[int, float], name: str, count: int) -> Floats:
    """The values of points 0 to count - 1, shape (count,). Raises InputError for one that is missing, and for one beyond."""
    missing = [index for index in range(count) if index not in values]
    if missing:
        raise InputError(f"lacks table[{missing[0]}].{name}, kw_nr_max is {count}")
    if len(values) > count:
        raise InputError(f"table[{max(values)}].{name} lies beyond kw_nr_max {count}")
    return np.array([values[index] for index in range(count)])
