"""FANUC stored pitch error compensation, as a program that writes parameters and points (G10 L50, or G10 L52 for series 30i).

Sources: FANUC Series 0i-B Parameter Manual B-63980EN (parameters 3620 to 3624 with the numbering and its example), FANUC 16i/18i
technical report A-77810E (bidirectional compensation, 3605#0, 3626, 3627), operator's manual (programmable parameter input: G10 L50,
N parameter P axis R value, N 10000 + point R value, G11), 30i/31i parameter manual B-63950EN (parameters as they are punched out: N
number Q kind A axis P value, M and I before a length in mm and inch; 3602#0).

Point n belongs to one section: with the reference's point number r (parameter 3620) and the interval L (3624) it is the section from
(n - r - 1)·L to (n - r)·L from the reference. Its value, -7 to 7 times the magnification 3623 in detection units, is
added when the axis crosses the section upwards, and subtracted when it crosses it downwards. So the correction at a grid position is
the *sum* of the values between it and the reference, and zero at the reference. The values are differences of the rounded sums, so
that rounding errors do not add up: each sum is within half a step.
Bidirectional: the values above are for the + direction, those from number 3626 on for the - direction, as increments upwards too, and
3627 (in detection units) is the correction at the reference when it is reached against the direction of reference return.
One-directional: one set of points, and the backlash 1851.
Coordinates are the machine's; the reference position is at `reference_mm`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from hil.correction.formats.common import (
    LENGTH_MM,
    Export,
    anchored,
    both_directions,
    check_written,
    equidistant,
    evenly,
    numbered_lines,
    one_directional,
    one_directional_set,
    require,
    table_set,
    two_directional,
)
from hil.correction.tables import DirectionalTable, TableSet
from hil.records.rows import Floats

LARGEST = 7
"""Largest value of a point, steps of `FanucSettings.step_um`."""
LAST_NUMBER = 1023
"""Highest point number that is written."""
LARGEST_NUMBER = 99_999
"""Highest point number that is read: a file may come from a control with more points."""
LARGEST_ABSOLUTE = 32767
"""Largest value of parameter 3627, detection units."""
LARGEST_BACKLASH = 9999
"""Largest value of parameter 1851, detection units."""
POINT_BASE = 10000
"""Added to a point's number in its N address."""
SERIES = {
    "16i": ("G10 L50", "16i, 18i, 21i and 0i-B; a 30i, 31i or 32i needs G10 L52: --series 30i"),
    "30i": ("G10 L52", "30i, 31i and 32i; a 16i, 18i, 21i or 0i-B needs G10 L50: --series 16i"),
}
"""Series of a control -> the block that begins its parameter input, and the series that take it."""

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class FanucSettings:
    """axis: number of the controlled axis (P)

    detection_unit_um: detection unit of the axis, µm; magnification: 3623
    first_number: lowest point number that is free for this axis
    reference_mm: machine coordinate of the reference position; reference_direction: direction of reference return, +1 or -1
    allow_shift: whether the correction at the reference position may be subtracted from the whole table
    step_mm: interval 3624; None: the widest that keeps the tolerance of resampling; setting_unit_mm: unit of 3624 (0.001 mm with IS-B)
    rapid_mm_min: highest feed of the axis; None: the interval is not checked against feed/7500
    tolerance_um: largest deviation from the tables by one backlash for both directions, and by resampling where resampling_um is None
    resampling_um: largest deviation by resampling
    bidirectional: 3605#0; False: one set of points and 1851; bits_3605: the other bits of 3605, which the program writes too
    program: O number of the program; series: of the control, one of `SERIES`
    """

    axis: int = 1
    detection_unit_um: float = 1.0
    magnification: int = 1
    first_number: int = 0
    reference_mm: float = 0.0
    reference_direction: int = 1
    allow_shift: bool = False
    step_mm: float | None = None
    setting_unit_mm: float = 0.001
    rapid_mm_min: float | None = None
    tolerance_um: float = 0.1
    resampling_um: float | None = None
    bidirectional: bool = True
    bits_3605: int = 0
    program: int = 9000
    series: str = "16i"

    def __post_init__(self) -> None:
        require(1 <= self.axis <= 99, f"axis number is {self.axis}, expected 1 to 99")
        require(self.detection_unit_um > 0, f"detection unit is {self.detection_unit_um} µm, expected more than 0")
        require(1 <= self.magnification <= 100, f"magnification (3623) is {self.magnification}, expected 1 to 100")
        require(
            0 <= self.first_number < LAST_NUMBER, f"first number is {self.first_number}, expected 0 to {LAST_NUMBER}"
        )
        require(
            self.reference_direction in (1, -1), f"reference return is {self.reference_direction}, expected 1 or -1"
        )
        require(self.setting_unit_mm > 0, f"setting unit is {self.setting_unit_mm} mm, expected more than 0")
        require(0 <= self.bits_3605 <= 255, f"bits of 3605 are {self.bits_3605}, expected 0 to 255")
        require(1 <= self.program <= 9999, f"program number is {self.program}, expected 1 to 9999")
        require(self.series in SERIES, f"series is {self.series!r}, expected {' or '.join(SERIES)}")
        require(self.tolerance_um >= 0, f"tolerance is {self.tolerance_um} µm, expected 0 or more")

    @property
    def step_um(self) -> float:
        """Correction that a point value of 1 adds, µm."""
        return self.detection_unit_um * self.magnification


def export(tables: TableSet, settings: FanucSettings = FanucSettings()) -> Export:
    """The program of these tables. Raises InputError, with the remedy, for tables that it cannot hold."""
    wanted, shift = anchored(
        both_directions(tables),
        settings.reference_mm,
        settings.reference_direction,
        allow_shift=settings.allow_shift,
        tolerance_um=settings.step_um / 2,
    )
    backlash_um, curves = 0.0, wanted
    if not settings.bidirectional:
        single, backlash_um = one_directional(wanted, settings.tolerance_um)
        curves = two_directional(single, backlash_um)
    sets = 2 if settings.bidirectional else 1
    grid, interval = equidistant(
        curves,
        settings.step_mm,
        resolution_mm=settings.setting_unit_mm,
        max_points=(LAST_NUMBER - settings.first_number) // sets,
        tolerance_um=settings.tolerance_um if settings.resampling_um is None else settings.resampling_um,
        origin_mm=settings.reference_mm,
    )
    _check_interval(interval, settings)
    text, points = _program(grid, interval, backlash_um, settings)
    limit = 2 * settings.tolerance_um + settings.step_um / 2 + settings.detection_unit_um / 2 + 1e-6
    deviation = check_written(load(text, settings), wanted, limit_um=limit)
    block, takes = SERIES[settings.series]
    notes = (
        f"the program is in {block}, for series {takes}",
        f"values are in {settings.detection_unit_um:g} µm (detection unit) times 3623; the reference position is"
        f" {settings.reference_mm:g} mm, reference return in {'+' if settings.reference_direction > 0 else '-'}",
        "parameter writing on (PWE), run the program, power off and on, return to the reference; the other bits of 3605"
        f" become {settings.bits_3605 & 0xFE:08b}",
        "1851 (backlash) of the axis = 0: both directions are in the points"
        if settings.bidirectional
        else "1851 is in the program",
    )
    return Export(text, points, deviation, shift, notes)


def _check_interval(step_mm: float, settings: FanucSettings) -> None:
    if settings.rapid_mm_min is not None and step_mm < settings.rapid_mm_min / 7500:
        raise InputError(
            f"an interval of {step_mm:g} mm is less than the {settings.rapid_mm_min / 7500:.3f} mm that"
            f" {settings.rapid_mm_min:g} mm/min need (feed/7500); allow more deviation, for a wider one"
        )


def _program(grid: DirectionalTable, interval: float, backlash_um: float, settings: FanucSettings) -> tuple[str, int]:
    """The program's text, and the number of points of one direction."""
    steps = np.round((grid.position_mm - settings.reference_mm) / interval).astype(np.int64)
    zero = int(np.flatnonzero(steps == 0)[0])
    sections = len(steps) - 1
    reference = settings.first_number + zero - 1  # the section below the reference has the reference's number
    reference = max(reference, 0)
    low, high = reference - zero + 1, reference - zero + sections
    toward, against = ("plus", "minus") if settings.reference_direction > 0 else ("minus", "plus")
    curve = {"plus": grid.plus_um, "minus": grid.minus_um}
    values = {toward: _increments(curve[toward], zero, 0, settings)}
    absolute = 0
    minus_low = high + 1
    if settings.bidirectional:
        absolute = int(np.round(curve[against][zero] / settings.detection_unit_um))
        values[against] = _increments(curve[against], zero, absolute, settings)
        if abs(absolute) > LARGEST_ABSOLUTE:
            raise InputError(f"3627 would be {absolute}, more than {LARGEST_ABSOLUTE} detection units")
    else:
        values = {"plus": values[toward]}
    top = minus_low + sections - 1 if settings.bidirectional else high
    if top > LAST_NUMBER:
        raise InputError(
            f"point numbers run to {top}, and the control has {LAST_NUMBER}; begin lower or widen the interval"
        )
    axis = f"P{settings.axis}"
    bits = settings.bits_3605 & 0xFE | int(settings.bidirectional)
    lines = ["%", f"O{settings.program:04d}", SERIES[settings.series][0]]
    lines += [
        f"N3605 {axis} R{bits:08b}",
        f"N3620 {axis} R{reference}",
        f"N3621 {axis} R{low}",
        f"N3622 {axis} R{high}",
    ]
    width = f"{interval:.6f}" if settings.series == "30i" else f"{round(interval / settings.setting_unit_mm)}"
    lines += [f"N3623 {axis} R{settings.magnification}", f"N3624 {axis} R{width}"]
    if settings.bidirectional:
        lines += [f"N3626 {axis} R{minus_low}", f"N3627 {axis} R{absolute}"]
    else:
        backlash = int(np.round(backlash_um / settings.detection_unit_um))
        if abs(backlash) > LARGEST_BACKLASH:
            raise InputError(f"1851 would be {backlash}, more than {LARGEST_BACKLASH} detection units")
        lines.append(f"N1851 {axis} R{backlash}")
    lines += _points(low, values["plus"])
    if settings.bidirectional:
        lines += _points(minus_low, values["minus"])
    return "\n".join([*lines, "G11", "M30", "%"]) + "\n", sections


def _increments(correction_um: Floats, zero: int, at_zero_units: int, settings: FanucSettings) -> Ints:
    """Point values whose sums from the reference, at index `zero`, follow the curve, steps. at_zero_units: 3627, detection units."""
    step = settings.step_um
    base = at_zero_units * settings.detection_unit_um
    sums = np.round((correction_um - base) / step).astype(np.int64)
    sums[zero] = 0
    values: Ints = np.diff(sums)
    largest = int(np.max(np.abs(values)))
    if largest > LARGEST:
        needed = settings.magnification * -(-largest // LARGEST)
        raise InputError(
            f"a point needs {largest} steps of {step:g} µm, expected at most {LARGEST}: set a magnification (3623) of {needed}"
            " or a shorter interval"
        )
    return values


def _points(first: int, values: Ints) -> list[str]:
    return [f"N{POINT_BASE + first + offset} R{value}" for offset, value in enumerate(values)]


# -- reading -----------------------------------------------------------------------------------------------------------

_FRAME = re.compile(r"%.*|[O:]\d+|<[^>]*>|(N\d+\s*)?(M30|M0?2|M99)|")
_BEGIN = re.compile(r"(N\d+\s*)?(G90\s*)?G10\s*L5[02]")
_WORD = re.compile(r"([A-Z])\s*([+-]?\d{1,9}(?:\.\d{0,9})?)\s*")
_TAPE = re.compile(r"[\x00\x11-\x14]")
"""Feed and control codes DC1 to DC4 that a control punches around the text."""
_PARAMETERS = (1851, 3605, 3620, 3621, 3622, 3623, 3624, 3626, 3627)
_TOTALS = 3602
"""Its bit 0: the points are totals from the reference, not increments (30i)."""


@dataclass
class _Reader:
    """What a file holds of one axis. parameters: by number, 3624 in mm; points: by number"""

    settings: FanucSettings
    parameters: dict[int, float] = field(default_factory=dict)
    points: dict[int, int] = field(default_factory=dict)

    def block(self, text: str, line: int, *, program: bool) -> bool:
        """Takes the values of a block, of a program (N P R) or as a control punches it out (N Q A P); False for what is none."""
        words = _WORD.findall(text)
        if not words or words[0][0] != "N" or "".join(_WORD.split(text)[::3]):
            return False
        number, axis, bit = int(float(words[0][1])), None, None
        for letter, value in words[1:]:
            if letter in ("RMI" if program else "PMI"):
                self._value(number, axis, (letter, value, bit), line)
            elif letter == ("P" if program else "A"):
                axis = int(float(value))
            elif letter == "Q" and program:
                bit = int(float(value))
            elif letter not in "QLST":  # kind of data, path, spindle
                return False
        return len(words) > 1

    def _value(self, number: int, axis: int | None, word: tuple[str, str, int | None], line: int) -> None:
        letter, text, bit = word
        if number >= POINT_BASE:
            _point(self.points, number - POINT_BASE, int(_whole(number, text, line)), line)
        elif number == _TOTALS and set(text) <= {"0", "1"} and bit in (None, 0) and int(text, 2) & 1:
            raise InputError("3602#0 is 1: the points are totals, expected increments", line=line)
        elif number in _PARAMETERS and axis is None:
            raise InputError(f"parameter {number} lacks its axis", line=line)
        elif number in _PARAMETERS and axis == self.settings.axis and bit in (None, 0):
            if number in self.parameters:
                raise InputError(f"parameter {number} of axis {axis} is given twice", line=line)
            self.parameters[number] = self._parameter(number, letter, text, line)

    def _parameter(self, number: int, letter: str, text: str, line: int) -> float:
        if number == 3605:
            return int(text, 2) if set(text) <= {"0", "1"} else _whole(number, text, line)
        if number != 3624:
            return _whole(number, text, line)
        if letter == "I":
            return float(text) * LENGTH_MM["inch"]
        return float(text) * (1.0 if letter == "M" or "." in text else self.settings.setting_unit_mm)


def _whole(number: int, text: str, line: int) -> float:
    value = float(text)
    if value != int(value):
        raise InputError(f"N{number} is {text}, expected a whole number", line=line)
    return value


def load(text: str, settings: FanucSettings = FanucSettings()) -> TableSet:
    """The tables of one axis from a program (G10 L50, G10 L52), or from parameters and points as a control punches them out.

    Taken from the settings, as the file does not hold them: axis, detection unit, setting unit (of a 3624 without decimal point), the
    reference's coordinate and the direction of reference return. Raises InputError with the line for a block that is not understood,
    and for a missing parameter or point.
    """
    reader = _Reader(settings)
    inside = ended = punched = False
    for line_number, raw in numbered_lines(_TAPE.sub("", text)):
        before, closing, after = raw.rpartition(
            ")"
        )  # every remark ends in the first part, so that each is looked at once
        line = (re.sub(r"\([^)]*\)", "", before + closing) + after).rstrip(";").strip().upper()
        if _BEGIN.fullmatch(line):
            inside = True
        elif re.fullmatch(r"(N\d+\s*)?G11", line):
            inside, ended = False, True
        elif not inside and _FRAME.fullmatch(line):
            continue
        elif not line or reader.block(line, line_number, program=inside):
            punched = punched or not inside
        else:
            raise InputError(
                f"{raw!r} is no block of parameter input (a program G10 L50 or G10 L52, or parameters punched out)",
                line=line_number,
            )
    if inside or not (ended or punched):
        raise InputError(
            "holds no parameter input: neither a program from G10 L50 or L52 to G11 nor punched parameters"
        )
    return _tables(reader.parameters, reader.points, settings)


def _point(points: dict[int, int], name: int, value: int, line: int) -> None:
    if name in points:
        raise InputError(f"point {name} is given twice", line=line)
    if abs(value) > LARGEST:
        raise InputError(f"point {name} is {value}, expected -{LARGEST} to {LARGEST}", line=line)
    points[name] = value


def _tables(parameters: dict[int, float], points: dict[int, int], settings: FanucSettings) -> TableSet:
    def parameter(name: int) -> int:
        if name not in parameters:
            raise InputError(f"lacks parameter {name} of axis {settings.axis}")
        return int(parameters[name])

    reference, low, high = parameter(3620), parameter(3621), parameter(3622)
    parameter(3624)
    interval = parameters[3624]
    step_um = parameter(3623) * settings.detection_unit_um
    if not (0 <= low <= high <= LARGEST_NUMBER and low - 1 <= reference <= high and interval > 0):
        raise InputError(
            f"3620 to 3622 are {reference}, {low}, {high} with an interval of {interval:g} mm: expected 3621 - 1 <= 3620 <= 3622"
        )

    def sums(first: int) -> Floats:
        lacking = [name for name in range(first, first + high - low + 1) if name not in points]
        if lacking:
            raise InputError(f"lacks point {lacking[0]} (N{POINT_BASE + lacking[0]})")
        values = [points[first + offset] for offset in range(high - low + 1)]
        running = np.concatenate([[0], np.cumsum(values)])
        return np.asarray((running - running[reference - low + 1]) * step_um, dtype=np.float64)

    positions = evenly(settings.reference_mm + interval * (low - 1 - reference), interval, high - low + 2)
    plus = sums(low)
    if not int(parameters.get(3605, 0)) & 1:
        backlash_um = parameters.get(1851, 0) * settings.detection_unit_um
        if not backlash_um:
            return table_set(positions, plus, plus)
        if settings.reference_direction < 0:
            plus = plus + backlash_um
        return one_directional_set(positions, plus, backlash_um)
    minus = sums(parameter(3626))
    absolute_um = parameter(3627) * settings.detection_unit_um
    if settings.reference_direction > 0:
        return table_set(positions, plus, minus + absolute_um)
    return table_set(positions, plus + absolute_um, minus)
