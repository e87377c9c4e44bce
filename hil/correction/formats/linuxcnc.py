"""LinuxCNC screw error compensation: the COMP_FILE of a joint.

Source: LinuxCNC's Integrator Manual, INI configuration, [JOINT_n] COMP_FILE and COMP_FILE_TYPE, and the behaviour of the program
itself (tests/interop run it). Each line is a triplet `nominal forward reverse` in the machine's length unit. With type 0 forward and
reverse are the positions that are reached, nominal + error = nominal - correction; with type 1 they are trims that LinuxCNC adds to
the command: the correction with its sign. LinuxCNC stops reading, without an error, at the first line that is no triplet: a file has
no header, no comment and no empty line. It takes at most 256 points, and the outer values hold beyond the ends. With a compensation
file, BACKLASH is not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import (
    Export,
    both_directions,
    check_written,
    number,
    numbered_lines,
    require,
    rounded_nodes,
    table_set,
    thinned,
)
from hil.correction.tables import TableSet
from hil.records.rows import UM_PER_MM

MAX_POINTS = 256
RESOLUTION_MM = 1e-9
"""Last decimal that is written, in the machine's unit."""
UNITS_MM = {"mm": 1.0, "metric": 1.0, "in": 25.4, "inch": 25.4, "imperial": 25.4}
"""Words of LINEAR_UNITS -> mm."""


@dataclass(frozen=True)
class LinuxCncSettings:
    """comp_type: COMP_FILE_TYPE, 0 (positions reached) or 1 (trims); unit: the machine's LINEAR_UNITS, a word of `UNITS_MM`.

    tolerance_um: largest deviation from tables that have more points than fit
    """

    comp_type: int = 1
    unit: str = "mm"
    tolerance_um: float = 0.1

    def __post_init__(self) -> None:
        require(self.comp_type in (0, 1), f"COMP_FILE_TYPE is {self.comp_type}, expected 0 or 1")
        require(self.unit.lower() in UNITS_MM, f"unit is {self.unit!r}, expected mm or inch")
        require(self.tolerance_um >= 0, f"tolerance is {self.tolerance_um} µm, expected 0 or more")


def export(tables: TableSet, settings: LinuxCncSettings = LinuxCncSettings()) -> Export:
    """The COMP_FILE of these tables. Raises InputError for tables that it cannot hold."""
    wanted = both_directions(tables)
    unit_mm = UNITS_MM[settings.unit.lower()]
    table = rounded_nodes(thinned(wanted, MAX_POINTS, settings.tolerance_um), RESOLUTION_MM * unit_mm)
    lines = []
    for position, plus, minus in zip(table.position_mm, table.plus_um, table.minus_um, strict=True):
        values = np.array([plus, minus]) / UM_PER_MM
        if settings.comp_type == 0:
            values = position - values
        lines.append(" ".join(f"{value / unit_mm + 0.0:.9f}" for value in (position, *values)))
    text = "\n".join(lines) + "\n"
    deviation = check_written(load(text, settings), wanted, limit_um=settings.tolerance_um + 1e-4)
    notes = (
        f"[JOINT_n] COMP_FILE = the file, COMP_FILE_TYPE = {settings.comp_type}",
        "leave BACKLASH out: both directions are in the file",
    )
    return Export(text, len(lines), deviation, notes=notes)


def load(text: str, settings: LinuxCncSettings = LinuxCncSettings()) -> TableSet:
    """The tables of a COMP_FILE. Its type and unit are taken from the settings, as the file does not hold them.

    Raises InputError with the line for one that LinuxCNC would not read, or that it would stop at.
    """
    rows: list[list[float]] = []
    ended = 0
    for line_number, line in numbered_lines(text):
        if not line:
            ended = ended or line_number
            continue
        cells = line.split()
        if ended or len(cells) != 3 or cells[0].startswith("#"):
            raise InputError(
                f"{line!r} is no triplet of numbers after which LinuxCNC would read on"
                if not ended
                else f"comes after the empty line {ended}, where LinuxCNC stops reading",
                line=line_number,
            )
        rows.append([number(cell, "value", line_number) for cell in cells])
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise InputError(f"nominal {cells[0]} does not ascend", line=line_number)
        if len(rows) > MAX_POINTS:
            raise InputError(f"is point {len(rows)}, LinuxCNC takes at most {MAX_POINTS}", line=line_number)
    if not rows:
        raise InputError("holds no triplet `nominal forward reverse`")
    nominal, forward, reverse = np.array(rows).T * UNITS_MM[settings.unit.lower()]
    if settings.comp_type == 0:
        forward, reverse = nominal - forward, nominal - reverse
    return table_set(nominal, forward * UM_PER_MM, reverse * UM_PER_MM)
