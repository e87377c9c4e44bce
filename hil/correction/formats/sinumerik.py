"""SINUMERIK compensation tables: EEC (leadscrew and measuring system error, one table and MD32450) and CEC (one per direction).

Source: SINUMERIK 840D sl/828D Function Manual Extended Functions, K3 Compensations (6FC5397-1BP40): measuring system error
compensation and its example, sag compensation with $AN_CEC_DIRECTION, direction-dependent leadscrew compensation. **A positive value
moves the axis in the negative direction**, so a value is -correction, in mm; the table has to be zero at the reference point. Between
points the control interpolates linearly; beyond the ends the outer values hold.
EEC has no direction: its table is that of the direction in which the reference point is approached. MD32450 BACKLASH, positive where
the encoder leads the machine's table, is added at a reversal and removed at the next one, so that in both cases
- direction = + direction - backlash. An EEC file has no place for the backlash: in files of this program a comment holds it, and the
direction of approach.
A CEC table can also hold a straightness correction of another axis: its input axis is this one, its output axis the other, and it is
for both directions.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import (
    Export,
    anchored,
    both_directions,
    check_written,
    equidistant,
    evenly,
    number,
    numbered_lines,
    one_directional,
    one_directional_set,
    require,
    table_set,
    two_directional,
)
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet
from hil.records.rows import UM_PER_MM, Floats

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")

DOWNWARDS = " ; reference point approached in -"
"""End of the comment with the backlash, where the reference point is approached in the - direction."""
_FRAME = re.compile(
    r"%.*|CHANDATA\s*\(\s*\d+\s*\)|M17|M30|M0?[0-2]|RET|NEWCONF|STOPRE|\$[MS][NAC]_\w+\s*(\[.*?\])?\s*=.*",
    re.IGNORECASE,
)
"""Lines that change no table: frame, end, and machine and setting data."""
_INCH = re.compile(r"\$M[NA]_\w*SCALING_SYSTEM\w*_METRIC\s*(\[.*?\])?\s*=\s*(0|FALSE)\s*", re.IGNORECASE)
_BLOCK_NUMBER = re.compile(r"^\s*N\d+\s*", re.IGNORECASE)
_TRUTH = {"true": "1", "false": "0"}
_NEXT = re.compile(r"(?<!\s)\s+(?=\$A)", re.IGNORECASE)
"""Between the assignments of a block."""
_EEC_VALUE = re.compile(r"\$AA_ENC_COMP\s*\[\s*(\d{1,9})\s*,\s*(\d{1,9})\s*,\s*(\w+)\s*\]\s*=\s*(\S+)$", re.IGNORECASE)
_EEC_KEY = re.compile(
    r"\$AA_ENC_COMP_(STEP|MIN|MAX|IS_MODULO)\s*\[\s*(\d{1,9})\s*,\s*(\w+)\s*\]\s*=\s*(\S+)$", re.IGNORECASE
)
_BACKLASH = re.compile(r"\$MA_BACKLASH\[\s*(\d{1,9})\s*,\s*(\w+)\s*\]\s*=\s*([-+.\dEe]+)", re.IGNORECASE)
_CEC_VALUE = re.compile(r"\$AN_CEC\s*\[\s*(\d{1,9})\s*[,.]\s*(\d{1,9})\s*\]\s*=\s*(\S+)$", re.IGNORECASE)
_CEC_KEY = re.compile(
    r"\$AN_CEC_(INPUT_NCU|INPUT_AXIS|OUTPUT_NCU|OUTPUT_AXIS|STEP|MIN|MAX|DIRECTION|MULT_BY_TABLE|IS_MODULO)\s*\[\s*(\d{1,9})\s*\]\s*=\s*(\S+)$",
    re.IGNORECASE,
)


@dataclass
class _Found:
    """One table while its lines are read. line: of its first entry; keys: texts of the other entries; values: mm, by point number."""

    line: int
    keys: dict[str, str] = field(default_factory=dict)
    values: dict[int, float] = field(default_factory=dict)

    def key(self, name: str, default: str | None = None) -> float:
        if name not in self.keys and default is None:
            raise InputError(f"the table that begins here lacks {name}", line=self.line)
        text = self.keys.get(name, default or "")
        return number(_TRUTH.get(text.lower(), text), name, self.line)

    def curve(self) -> SingleTable:
        """The correction, µm, over position, mm. Raises InputError for values that do not fit MIN, MAX and STEP."""
        if self.key("IS_MODULO", "0"):
            what = f"the table that begins here is of a modulo axis (IS_MODULO {self.keys['IS_MODULO']}), expected a linear one"
            raise InputError(what, line=self.line)
        low, high, step = self.key("MIN"), self.key("MAX"), self.key("STEP")
        if not (step > 0 and high > low):
            raise InputError(f"MIN {low:g}, MAX {high:g}, STEP {step:g} make no grid", line=self.line)
        points = np.floor((high - low) / step + 1e-6) + 1
        if not any(value for point, value in self.values.items() if point >= points):  # room that is not used
            self.values = {point: value for point, value in self.values.items() if point < points}
        if points != len(self.values) or sorted(self.values) != list(range(len(self.values))):
            raise InputError(
                f"MIN, MAX and STEP make points 0 to {points - 1:.0f}, the table holds {len(self.values)}"
                f" from {min(self.values, default=0)} to {max(self.values, default=0)}",
                line=self.line,
            )
        values = np.array([self.values[point] for point in range(len(self.values))])
        return SingleTable(evenly(low, step, len(values)), -values * UM_PER_MM)


@dataclass
class _Reader:
    """The contents of a file. eec: by (encoder, axis); cec: by index; downwards: the reference point is approached in -."""

    eec: dict[tuple[int, str], _Found] = field(default_factory=dict)
    cec: dict[int, _Found] = field(default_factory=dict)
    backlash_um: float = 0.0
    downwards: bool = False

    def read(self, raw: str, line_number: int) -> None:
        if match := _BACKLASH.search(raw):
            self.backlash_um = number(match[3], "MD32450", line_number) * UM_PER_MM
            self.downwards = raw.rstrip().endswith(DOWNWARDS.strip())
            return
        whole = _BLOCK_NUMBER.sub("", raw.partition(";")[0], count=1).strip()
        for line in _NEXT.split(whole):
            self._assignment(line, line_number)

    def _assignment(self, line: str, line_number: int) -> None:
        if _INCH.fullmatch(line):
            raise InputError(f"{line!r}: the tables are in inch, expected mm", line=line_number)
        if not line or _FRAME.fullmatch(line):
            return
        if match := _EEC_VALUE.match(line):
            found = self._eec(match[1], match[3], line_number)
            _once(found.values, int(match[2]), number(match[4], "value", line_number), line_number)
        elif match := _EEC_KEY.match(line):
            _once(self._eec(match[2], match[3], line_number).keys, match[1].upper(), match[4], line_number)
        elif match := _CEC_VALUE.match(line):
            found = self._cec(match[1], line_number)
            _once(found.values, int(match[2]), number(match[3], "value", line_number), line_number)
        elif match := _CEC_KEY.match(line):
            _once(self._cec(match[2], line_number).keys, match[1].upper(), match[3], line_number)
        else:
            raise InputError(
                f"{line!r} is no line of a compensation table, expected such as $AN_CEC[0,1]=0.002", line=line_number
            )

    def _eec(self, encoder: str, axis: str, line: int) -> _Found:
        return self.eec.setdefault((int(encoder), axis.upper()), _Found(line))

    def _cec(self, index: str, line: int) -> _Found:
        return self.cec.setdefault(int(index), _Found(line))


def read(text: str) -> TableSet:
    """The tables of an EEC or CEC file of one axis.

    Raises InputError, with the line where there is one, for a line that is not understood, tables that do not fit together, and more
    than one axis.
    """
    reader = _Reader()
    for line_number, raw in numbered_lines(text):
        reader.read(raw, line_number)
    if reader.eec and reader.cec:
        raise InputError("holds EEC and CEC tables, expected one kind")
    if reader.cec:
        return _cec_set(reader.cec)
    if len(reader.eec) > 1:
        raise InputError(f"holds EEC tables of {len(reader.eec)} axes or encoders, expected one")
    if not reader.eec:
        raise InputError("holds no compensation table ($AA_ENC_COMP or $AN_CEC)")
    curve = next(iter(reader.eec.values())).curve()
    if reader.backlash_um:
        plus_um = curve.value_um + (reader.backlash_um if reader.downwards else 0.0)
        return one_directional_set(curve.position_mm, plus_um, reader.backlash_um)
    return table_set(curve.position_mm, curve.value_um, curve.value_um)


def _once(into: dict[_Key, _Value], key: _Key, value: _Value, line: int) -> None:
    if key in into:
        raise InputError(f"gives {key} a second time", line=line)
    into[key] = value


def _cec_set(found: dict[int, _Found]) -> TableSet:
    own: dict[int, SingleTable] = {}
    cross: dict[int, SingleTable] = {}
    cross_axis = ""
    inputs = {table.keys.get("INPUT_AXIS", "").upper() for table in found.values()}
    if len(inputs) != 1:
        raise InputError(f"holds tables of the input axes {', '.join(sorted(inputs))}, expected one")
    for table in found.values():
        if table.key("MULT_BY_TABLE", "0"):
            raise InputError("the table that begins here is multiplied by another one", line=table.line)
        of, to = table.key("INPUT_NCU", "0"), table.key("OUTPUT_NCU", "0")
        if of and to and of != to:
            raise InputError(
                f"the table that begins here corrects an axis of NCU {to:g} by one of NCU {of:g}, expected the same NCU",
                line=table.line,
            )
        direction, target = table.key("DIRECTION"), table.keys.get("OUTPUT_AXIS", "").strip("()")
        curve = table.curve()
        into = own
        if target.upper() != next(iter(inputs)).strip("()"):
            if cross and target != cross_axis:
                raise InputError("the table that begins here corrects a second other axis", line=table.line)
            into, cross_axis = cross, target
        if direction not in (0, 1, -1):
            raise InputError(f"DIRECTION is {direction:g}, expected 0, 1 or -1", line=table.line)
        for sign in (1, -1) if direction == 0 else (int(direction),):
            if sign in into:
                raise InputError(f"the table that begins here is a second one for direction {sign:+d}", line=table.line)
            into[sign] = curve
    if not own:
        raise InputError(
            f"corrects axis {cross_axis} by the position of {next(iter(inputs)).strip('()')} alone, expected one axis for itself"
        )
    straightness = _both(cross) if cross else None
    return TableSet(TableMode.BIDIRECTIONAL, _both(own), straightness=straightness, straightness_axis=cross_axis)


def _both(curves: dict[int, SingleTable]) -> DirectionalTable:
    if set(curves) != {1, -1}:
        have = ", ".join(f"{sign:+d}" for sign in curves) or "none"
        raise InputError(f"has CEC tables for direction {have}, expected both (or direction 0)")
    nodes = np.union1d(curves[1].position_mm, curves[-1].position_mm)
    return DirectionalTable(nodes, curves[1].at(nodes), curves[-1].at(nodes))


RESOLUTION_MM = 1e-6
"""Positions and steps are written with six decimals of a mm."""
VALUE_QUANTUM_UM = 1e-3
"""So are the values."""


@dataclass(frozen=True)
class SinumerikSettings:
    """table: "cec" (one table per direction) or "eec" (one table, and MD32450)

    axis: name of the machine axis, such as X1 or AX1; index: that of the first CEC table, or the encoder of an EEC table
    reference_mm, reference_direction: position of the reference point, and direction of its approach (+1, -1): the value there is zero
    allow_shift: whether the correction at the reference point may be subtracted from the whole table
    step_mm: distance of the points; None: the widest that keeps the tolerance of resampling
    max_points: MD38000 (EEC) or MD18342 (CEC)
    max_correction_um: MD32720 (CEC); tolerance_um: largest deviation from the tables by one backlash for both
        directions (EEC), and by resampling where resampling_um is None; resampling_um: largest deviation by resampling
    cross_axis: machine axis that a straightness table corrects (CEC); "": its name in the tables
    """

    table: str = "cec"
    axis: str = "X1"
    index: int = 0
    reference_mm: float = 0.0
    reference_direction: int = 1
    allow_shift: bool = False
    step_mm: float | None = None
    max_points: int = 200
    max_correction_um: float = 1000.0
    tolerance_um: float = 0.1
    resampling_um: float | None = None
    cross_axis: str = ""

    def __post_init__(self) -> None:
        require(self.table in ("cec", "eec"), f"table is {self.table!r}, expected cec or eec")
        for axis in (self.axis, self.cross_axis or self.axis):
            require(re.fullmatch(r"[A-Za-z_][A-Za-z_0-9]*", axis) is not None, f"axis is {axis!r}, expected such as X1")
        require(self.index >= 0, f"index is {self.index}, expected 0 or more")
        require(self.reference_direction in (1, -1), f"direction is {self.reference_direction}, expected 1 or -1")
        require(self.max_points >= 2, f"at most {self.max_points} points, expected 2 or more")
        require(self.tolerance_um >= 0, f"tolerance is {self.tolerance_um} µm, expected 0 or more")


def export(tables: TableSet, settings: SinumerikSettings = SinumerikSettings()) -> Export:
    """The INI file of these tables. Raises InputError for tables that it cannot hold."""
    whole = both_directions(tables, cross_axis=settings.table == "cec")
    wanted, shift = anchored(
        whole,
        settings.reference_mm,
        settings.reference_direction,
        allow_shift=settings.allow_shift,
        tolerance_um=VALUE_QUANTUM_UM / 2,
    )
    largest = float(np.max(np.abs([wanted.plus_um, wanted.minus_um])))
    if settings.table == "cec" and largest > settings.max_correction_um:
        raise InputError(
            f"a correction of {largest:.1f} µm is more than the sum MD32720 allows, {settings.max_correction_um:g} µm;"
            " raise it on the control and here"
        )
    return _eec(wanted, shift, settings) if settings.table == "eec" else _cec(tables, wanted, shift, settings)


def _resampled(table: DirectionalTable, settings: SinumerikSettings) -> tuple[DirectionalTable, float]:
    return equidistant(
        table,
        settings.step_mm,
        resolution_mm=RESOLUTION_MM,
        max_points=settings.max_points,
        tolerance_um=settings.tolerance_um if settings.resampling_um is None else settings.resampling_um,
    )


def _eec(wanted: DirectionalTable, shift: float, settings: SinumerikSettings) -> Export:
    single, backlash_um = one_directional(wanted, settings.tolerance_um)
    grid, step = _resampled(two_directional(single, backlash_um), settings)
    index, axis = settings.index, settings.axis
    lines = ["%_N_AX_EEC_INI", "CHANDATA(1)"]
    downwards = settings.reference_direction < 0
    if round(backlash_um, 3):
        lines.append(f";$MA_BACKLASH[{index},{axis}]={backlash_um / UM_PER_MM:.6f}{DOWNWARDS if downwards else ''}")
    lines += _values(f"$AA_ENC_COMP[{index},{{}},{axis}]", grid.minus_um if downwards else grid.plus_um)
    lines += [
        f"$AA_ENC_COMP_STEP[{index},{axis}]={step:.6f}",
        f"$AA_ENC_COMP_MIN[{index},{axis}]={grid.position_mm[0]:.6f}",
        f"$AA_ENC_COMP_MAX[{index},{axis}]={grid.position_mm[-1]:.6f}",
        f"$AA_ENC_COMP_IS_MODULO[{index},{axis}]=0",
        "M17",
    ]
    text = "\n".join(lines) + "\n"
    points = len(grid.position_mm)
    notes = [
        f"MD38000 MM_ENC_COMP_MAX_POINTS[{index},{axis}] at least {points}; after loading MD32700 ENC_COMP_ENABLE[{index}]"
        " = 1 and a reference point approach",
        f"MD32450 BACKLASH[{index}] of {axis} = {backlash_um / UM_PER_MM:.6f} mm, by hand: the file loads the table only; the"
        f" reference point is approached in {'-' if downwards else '+'}",
    ]
    deviation = check_written(load(text), wanted, limit_um=2 * settings.tolerance_um + 2 * VALUE_QUANTUM_UM)
    return Export(text, points, deviation, shift, tuple(notes))


def _cec(tables: TableSet, wanted: DirectionalTable, shift: float, settings: SinumerikSettings) -> Export:
    grid, step = _resampled(wanted, settings)
    axis, index = settings.axis, settings.index
    lines = ["%_N_NC_CEC_INI", "CHANDATA(1)"]
    lines += _cec_table(index, (axis, axis), 1, grid.position_mm, step, grid.plus_um)
    lines += _cec_table(index + 1, (axis, axis), -1, grid.position_mm, step, grid.minus_um)
    used = [index, index + 1]
    extra: tuple[str, ...] = ()
    if tables.straightness is not None and tables.straightness_axis:
        cross, cross_shift = anchored(
            tables.straightness,
            settings.reference_mm,
            1,
            allow_shift=settings.allow_shift,
            tolerance_um=VALUE_QUANTUM_UM / 2,
        )
        other, other_step = _resampled(cross, settings)
        other_axis = settings.cross_axis or tables.straightness_axis
        for sign, values_um in ((0, other.plus_um),) if other.is_alike else ((1, other.plus_um), (-1, other.minus_um)):
            used.append(used[-1] + 1)
            lines += _cec_table(used[-1], (axis, other_axis), sign, other.position_mm, other_step, values_um)
        if cross_shift:
            extra = (f"taken out of the correction of {other_axis}: {cross_shift:.3f} µm",)
    text = "\n".join([*lines, "M17"]) + "\n"
    written = load(text)
    deviation = check_written(
        replace(written, straightness=None, straightness_axis=""),
        wanted,
        limit_um=settings.tolerance_um + 2 * VALUE_QUANTUM_UM,
    )
    points = len(grid.position_mm)
    notes = (
        f"MD18342 MM_CEC_MAX_POINTS of tables {', '.join(map(str, used))} at least {points} (re-organises memory: archive first)",
        f"MD32710 CEC_ENABLE of the axis, then SD41300 CEC_TABLE_ENABLE of tables {', '.join(map(str, used))}, referenced",
        f"MD32450 BACKLASH of {axis} = 0: both directions are in the tables",
    )
    return Export(text, points, deviation, shift, (*notes, *extra))


def _cec_table(  # noqa: PLR0917  (a table has these six parts)
    index: int, axes: tuple[str, str], direction: int, positions: Floats, step: float, correction_um: Floats
) -> list[str]:
    """The lines of one table. axes: input and output axis; positions, step: mm; direction: 0 for both; correction_um: shape (n,)."""
    return [
        *_values(f"$AN_CEC[{index},{{}}]", correction_um),
        f"$AN_CEC_INPUT_AXIS[{index}]=({axes[0]})",
        f"$AN_CEC_OUTPUT_AXIS[{index}]=({axes[1]})",
        f"$AN_CEC_STEP[{index}]={step:.6f}",
        f"$AN_CEC_MIN[{index}]={positions[0]:.6f}",
        f"$AN_CEC_MAX[{index}]={positions[-1]:.6f}",
        f"$AN_CEC_DIRECTION[{index}]={direction}",
        f"$AN_CEC_MULT_BY_TABLE[{index}]=0",
        f"$AN_CEC_IS_MODULO[{index}]=0",
    ]


def _values(pattern: str, correction_um: Floats) -> list[str]:
    values = np.round(-correction_um / UM_PER_MM, 6) + 0.0
    return [f"{pattern.format(point)}={value:.6f}" for point, value in enumerate(values)]


def load(text: str, settings: SinumerikSettings = SinumerikSettings()) -> TableSet:
    """As `read`; the settings are not used, as the file holds everything."""
    return read(text)
