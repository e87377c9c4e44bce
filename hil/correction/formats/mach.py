"""Screw maps of Mach3 and Mach4: the values to type into their dialogs, as a table.

Neither maker describes a file for them, so none is guessed; what the dialogs ask for is sourced. Mach4 (MachMotion's page "Mach 4
Screw Mapping"; the plugin Machine Calibration, Linear Compensation): start, length and a number of evenly spaced points with both
ends, and at each the difference between the expected and the actual position, which is the correction with its sign; one map for
both ways up to build 4779, one for each way from 4780 on. Mach3 (R. G. Sparber, "Mach3 Z Axis Screw Mapping"; dialog with commanded
and real coordinates): commanded and real position at each point, one map for both ways, measured in + direction, and its own
backlash. Which way a control counts its signs is to be proven on the machine: `hil verify` after the first point.

The table: `# ` lines with what has to be set, a header, one line for each point, mm with four decimals.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from drivers.files import without_empty_end
from hil.correction.formats.common import (
    Export,
    both_directions,
    check_written,
    delimited_rows,
    equidistant,
    number,
    numbered_lines,
    one_directional,
    one_directional_set,
    require,
    table_set,
    two_directional,
)
from hil.correction.tables import TableSet
from hil.records.rows import UM_PER_MM

DECIMALS = 4
"""Of a mm: a tenth of a µm, as fine as the dialogs show."""
_HEADS = ("position_mm,error_positive_mm,error_negative_mm", "position_mm,error_mm", "commanded_mm,real_mm")
_BACKLASH = re.compile(r'"?# backlash (\S+) mm[",;\s]*')


@dataclass(frozen=True)
class Mach4Settings:
    """asymmetric: a map for each way (build 4780 and later); else one map and a backlash.

    step_mm: None: the widest that is good enough
    tolerance_um: largest deviation from the tables by one map for both ways, and by resampling where resampling_um is None
    resampling_um: largest deviation by resampling
    """

    asymmetric: bool = True
    step_mm: float | None = None
    max_points: int = 1000
    tolerance_um: float = 0.1
    resampling_um: float | None = None

    def __post_init__(self) -> None:
        require(self.max_points >= 2, f"number of points is {self.max_points}, expected 2 or more")
        require(self.tolerance_um >= 0, f"tolerance is {self.tolerance_um} µm, expected 0 or more")


@dataclass(frozen=True)
class Mach3Settings(Mach4Settings):
    """One map of commanded and real positions, and a backlash."""

    asymmetric: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        require(not self.asymmetric, "Mach3 holds one map for both ways")


def export(tables: TableSet, settings: Mach4Settings = Mach4Settings()) -> Export:
    """The table to type in. Raises InputError, with the remedy, for tables that it cannot hold."""
    wanted = both_directions(tables)
    curves, backlash_um = wanted, 0.0
    if not settings.asymmetric:
        single, backlash_um = one_directional(wanted, settings.tolerance_um)
        curves = two_directional(single, backlash_um)
    grid, step = equidistant(
        curves,
        settings.step_mm,
        resolution_mm=0.001,
        max_points=settings.max_points,
        tolerance_um=settings.tolerance_um if settings.resampling_um is None else settings.resampling_um,
    )
    mach3 = isinstance(settings, Mach3Settings)
    at, plus, minus = grid.position_mm, grid.plus_um / UM_PER_MM, grid.minus_um / UM_PER_MM
    top = [
        f"# start {at[0]:.{DECIMALS}f} mm, length {at[-1] - at[0]:.{DECIMALS}f} mm, {len(at)} points every {step:g} mm"
    ]
    if settings.asymmetric:
        head, *columns = "position_mm,error_positive_mm,error_negative_mm", at, plus, minus
    elif mach3:
        head, *columns = "commanded_mm,real_mm", at, at - plus
    else:
        head, *columns = "position_mm,error_mm", at, plus
    if not settings.asymmetric:
        top.append(f"# backlash {backlash_um / UM_PER_MM:.{DECIMALS}f} mm")
    rows = [",".join(f"{value + 0.0:.{DECIMALS}f}" for value in row) for row in zip(*columns, strict=True)]
    text = "\n".join([*top, head, *rows]) + "\n"
    rounding = UM_PER_MM * 10.0**-DECIMALS
    deviation = check_written(load(text, settings), wanted, limit_um=2 * settings.tolerance_um + rounding + 1e-6)
    control = "Mach3" if mach3 else "Mach4"
    notes = (
        f"the values are to be typed in: {control} has no described file for them",
        "prove the sign on the machine before the whole map is typed: with one point in force, `hil verify` must get better there",
        "backlash of the control = 0: both ways are in the maps"
        if settings.asymmetric
        else "the backlash is in the second line",
    )
    return Export(text, len(at), deviation, 0.0, notes)


def load(text: str, settings: Mach4Settings = Mach4Settings()) -> TableSet:
    """The correction in a table of `export`. Raises InputError with the line."""
    backlash_um = 0.0
    for line_number, line in numbered_lines(text):
        if match := _BACKLASH.fullmatch(line):
            backlash_um = number(match[1], "the backlash", line_number) * UM_PER_MM
        elif line.startswith(("# backlash", '"# backlash')):
            raise InputError(f"is {line!r}, expected such as '# backlash 0.0030 mm'", line=line_number)
    (header_line, header), *rows = delimited_rows(text, "", _share)
    head = ",".join(header)
    if head not in _HEADS:
        raise InputError(f"is no header of a screw map, expected {' or '.join(_HEADS)}", line=header_line)
    at, *values = np.array([[number(cell, "a value", line) for cell in cells] for line, cells in rows]).T
    if len(at) < 2:
        raise InputError("holds no screw map: expected a header and at least two points")
    if np.any(np.diff(at) <= 0):
        raise InputError("positions do not ascend")
    if head.startswith("commanded"):
        values[0] = at - values[0]
    if len(values) == 2:
        return table_set(at, values[0] * UM_PER_MM, values[1] * UM_PER_MM)
    return one_directional_set(at, values[0] * UM_PER_MM, backlash_um)


def _share(cells: list[str]) -> float:
    return float(",".join(without_empty_end(cells)) in _HEADS)
