"""Small machines with grblHAL or FluidNC: the two numbers of an axis that such a control can hold.

grblHAL has a backlash per axis, setting $160 + axis (0 for X) in mm with three decimals, where it was built with
ENABLE_BACKLASH_COMPENSATION, and the steps per mm, $100 + axis (source: its settings.h and settings.c: AXIS_SETTINGS_INCREMENT 10,
Setting_AxisBacklash = 100 + 6 increments, format "#####0.000"). FluidNC has the steps per mm alone, `steps_per_mm` in its
configuration; its makers decline a backlash (bdring/FluidNC, pull request 24 and issue 756). Neither holds a table along the axis.

What is written: the backlash that lies in the middle of the axis's, and, where the present steps per mm are given, steps per mm
that take up the straight part of the tables from machine zero. What stays is the deviation; an export whose deviation is over the
tolerance is refused, so that nobody loses a table unawares. The first line, a comment, keeps the range for reading back.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import scipy

from drivers.errors import InputError
from hil.correction.formats.common import (
    Export,
    both_directions,
    enough,
    largest_difference_um,
    number,
    numbered_lines,
    require,
    shifted,
    table_set,
)
from hil.correction.tables import DirectionalTable, TableSet
from hil.records.rows import UM_PER_MM, Floats

AXES = "XYZABC"
STEPS_SETTING, BACKLASH_SETTING = 100, 160
_RANGE = re.compile(r"[;#] hil: (\w) from (\S+) to (\S+) mm$")


@dataclass(frozen=True)
class GrblHalSettings:
    """axis: its letter; steps_per_mm: as set now, None: left as it is; tolerance_um: largest deviation from the tables."""

    axis: str = "X"
    steps_per_mm: float | None = None
    tolerance_um: float = 0.1

    def __post_init__(self) -> None:
        require(self.axis in AXES and len(self.axis) == 1, f"axis is {self.axis!r}, expected one of {', '.join(AXES)}")
        require(
            self.steps_per_mm is None or self.steps_per_mm > 0,
            f"steps per mm are {self.steps_per_mm}, expected more than 0",
        )
        require(self.tolerance_um >= 0, f"tolerance is {self.tolerance_um} µm, expected 0 or more")


class FluidNcSettings(GrblHalSettings):
    """As for grblHAL; steps_per_mm is needed."""


_FLUIDNC = FluidNcSettings()


def export_grblhal(tables: TableSet, settings: GrblHalSettings = GrblHalSettings()) -> Export:
    """Settings to send to grblHAL. Raises InputError where a backlash and a straight line do not hold the tables."""
    wanted = both_directions(tables)
    difference = wanted.plus_um - wanted.minus_um
    backlash_um = round((float(difference.min()) + float(difference.max())) / 2)  # three decimals of a mm
    require(backlash_um >= 0, f"the backlash would be {backlash_um} µm, and the control's cannot be negative")
    index = AXES.index(settings.axis)
    steps = _steps(wanted, backlash_um, settings)
    lines = [_range_line(";", wanted, settings), f"${BACKLASH_SETTING + index}={backlash_um / UM_PER_MM:.3f}"]
    if steps is not None:
        lines.append(f"${STEPS_SETTING + index}={steps:.5f}")
    notes = (
        f"send the lines; ${BACKLASH_SETTING + index} exists where grblHAL was built with ENABLE_BACKLASH_COMPENSATION",
        "the control holds no table along the axis: the deviation is what stays uncorrected",
        *(() if steps is not None else ("with --steps-per-mm the straight part would be corrected too",)),
    )
    text = "\n".join(lines) + "\n"
    return _exported(text, wanted, load_grblhal(text, settings), settings, notes)


def export_fluidnc(tables: TableSet, settings: GrblHalSettings = _FLUIDNC) -> Export:
    """The lines of FluidNC's configuration. Raises InputError where a straight line does not hold the tables."""
    wanted = both_directions(tables)
    require(
        settings.steps_per_mm is not None,
        "FluidNC takes nothing but steps per mm: state those that are set now (steps_per_mm)",
    )
    middle = DirectionalTable(
        wanted.position_mm, (wanted.plus_um + wanted.minus_um) / 2, (wanted.plus_um + wanted.minus_um) / 2
    )
    steps = _steps(middle, 0.0, settings)
    text = f"{_range_line('#', wanted, settings)}\naxes:\n  {settings.axis.lower()}:\n    steps_per_mm: {steps:.5f}\n"
    notes = (
        "merge steps_per_mm into the configuration of the axis",
        "FluidNC holds neither a backlash nor a table along the axis: the deviation is what stays uncorrected",
    )
    return _exported(text, wanted, load_fluidnc(text, settings), settings, notes)


def _range_line(mark: str, table: DirectionalTable, settings: GrblHalSettings) -> str:
    return f"{mark} hil: {settings.axis} from {table.position_mm[0]:.6f} to {table.position_mm[-1]:.6f} mm"


def _steps(wanted: DirectionalTable, backlash_um: float, settings: GrblHalSettings) -> float | None:
    """The steps per mm with the straight part of the correction of the + direction, None where they are not to be changed."""
    if settings.steps_per_mm is None:
        return None
    curve = (wanted.plus_um + wanted.minus_um + backlash_um) / 2
    return settings.steps_per_mm * (1.0 + _slope(wanted.position_mm, curve) / UM_PER_MM)


def _slope(x_mm: Floats, y_um: Floats) -> float:
    """Slope, µm/mm, of the straight line with the smallest largest distance from a curve, by a linear program."""

    one = np.ones_like(x_mm)
    above, below = np.column_stack([x_mm, one, -one]), np.column_stack([-x_mm, -one, -one])
    sides = np.concatenate([y_um, -y_um])
    found = scipy.optimize.linprog(
        [0.0, 0.0, 1.0], np.vstack([above, below]), sides, bounds=[(None, None), (None, None), (0.0, None)]
    )
    return float(found.x[0])


def _exported(
    text: str, wanted: DirectionalTable, read_back: TableSet, settings: GrblHalSettings, notes: tuple[str, ...]
) -> Export:
    held = both_directions(read_back)
    nodes = np.union1d(held.position_mm, wanted.position_mm)
    off = np.concatenate([wanted.at(nodes, sign) - held.at(nodes, sign) for sign in (1, -1)])
    shift = float(off.max() + off.min()) / 2  # a constant moves the machine's zero, which nobody measures from
    deviation = largest_difference_um(held, shifted(wanted, -shift))
    if deviation > settings.tolerance_um:
        raise InputError(
            f"the control would deviate by up to {enough(deviation)} µm from the tables, more than {settings.tolerance_um:g} µm;"
            " allow a larger deviation (tolerance_um) to export it"
        )
    return Export(text, len(held.position_mm), deviation, shift, notes)


def load_grblhal(text: str, settings: GrblHalSettings = GrblHalSettings()) -> TableSet:
    """The correction in grblHAL's settings. Raises InputError with the line; steps per mm need those of before (steps_per_mm)."""
    index = AXES.index(settings.axis)
    values: dict[int, float] = {}
    ends: tuple[float, float] | None = None
    for line_number, line in numbered_lines(text):
        if match := _RANGE.match(line):
            ends = _ends(match, settings, line_number)
        elif match := re.fullmatch(r"\$(\d+)=(\S+)", line):
            values[int(match[1])] = number(match[2], f"${match[1]}", line_number)
        elif line and not line.startswith((";", "(")):
            raise InputError(f"is {line!r}, expected a setting such as $160=0.012", line=line_number)
    steps = values.get(STEPS_SETTING + index)
    return _tables(ends, values.get(BACKLASH_SETTING + index, 0.0) * UM_PER_MM, steps, settings)


def load_fluidnc(text: str, settings: GrblHalSettings = _FLUIDNC) -> TableSet:
    """The correction in the lines of `export_fluidnc`. Raises InputError with the line."""
    ends: tuple[float, float] | None = None
    steps: float | None = None
    axis = ""
    for line_number, line in numbered_lines(text):
        if match := _RANGE.match(line):
            ends = _ends(match, settings, line_number)
        elif match := re.fullmatch(r"([a-z]):", line):
            axis = match[1].upper()
        elif (match := re.fullmatch(r"steps_per_mm:\s*(\S+)", line)) and axis == settings.axis:
            steps = number(match[1], "steps_per_mm", line_number)
    if steps is None:
        raise InputError(f"holds no steps_per_mm of axis {settings.axis}")
    return _tables(ends, 0.0, steps, settings)


def _ends(match: re.Match[str], settings: GrblHalSettings, line: int) -> tuple[float, float]:
    if match[1] != settings.axis:
        raise InputError(f"is of axis {match[1]}, expected {settings.axis}", line=line)
    return number(match[2], "the first position", line), number(match[3], "the last position", line)


def _tables(
    ends: tuple[float, float] | None, backlash_um: float, steps: float | None, settings: GrblHalSettings
) -> TableSet:
    if ends is None or not ends[0] < ends[1]:
        raise InputError("does not say from where to where it holds (the comment line `hil: X from … to … mm`)")
    if steps is not None and settings.steps_per_mm is None:
        raise InputError("changes the steps per mm: state those of before (steps_per_mm)")
    at = np.array(ends)
    ratio = 1.0 if steps is None or settings.steps_per_mm is None else steps / settings.steps_per_mm
    plus = (ratio - 1.0) * at * UM_PER_MM
    return table_set(at, plus, plus - backlash_um)
