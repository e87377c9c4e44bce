"""SINUMERIK compensation tables: EEC (leadscrew/measuring system error, one table and MD32450) and CEC (two, by direction).

Source: SINUMERIK 840D sl/828D Function Manual Extended Functions, K3 Compensations (6FC5397-1BP40): measuring system error
compensation and its example, sag compensation with $AN_CEC_DIRECTION, direction-dependent leadscrew compensation. **A positive value
moves the axis in the negative direction**, so a value is -correction, in mm; the table is to be zero at the reference point.
Between points the control interpolates, beyond the ends the end values hold. EEC knows no direction: its table is that of the
direction in which the reference point is approached, and MD32450 BACKLASH, positive where the encoder leads the table, is put in at a
reversal and taken out at the next one, so that - direction = + direction - backlash either way. A comment in our files says backlash
and direction. A CEC table also serves a straightness correction of another axis: input axis this one, output axis the other, for both
directions.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import (
    Export,
    anchored,
    both_directions,
    check_written,
    equidistant,
    one_directional,
    require,
    two_directional,
)
from hil.correction.formats.sinumerik_reading import DOWNWARDS, read
from hil.correction.tables import DirectionalTable, TableSet
from hil.records.rows import UM_PER_MM, Floats

RESOLUTION_MM = 1e-6
VALUE_QUANTUM_UM = 1e-3  # six decimals of a mm


@dataclass(frozen=True)
class SinumerikSettings:
    """table: "cec" (two directions) or "eec" (one, with MD32450)

    axis: the machine axis, such as X1 or AX1; index: first CEC table index, or the encoder of an EEC table
    reference_mm, reference_direction: where, and arrived at from which direction, the value is zero
    allow_shift: take the correction at the reference point out of the whole table
    step_mm: distance of the points, None for the widest that keeps tolerance_um; max_points: MD38000 (EEC) or MD18342 (CEC)
    cross_axis: the machine axis a cross-axis straightness table corrects (CEC), by default its name in the tables
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
    """The INI file of these tables. Raises InputError for what it cannot hold."""
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


def dump(tables: TableSet, settings: SinumerikSettings = SinumerikSettings()) -> str:
    """The text of `export`."""
    return export(tables, settings).text


def _resampled(table: DirectionalTable, settings: SinumerikSettings) -> tuple[DirectionalTable, float]:
    return equidistant(
        table,
        settings.step_mm,
        resolution_mm=RESOLUTION_MM,
        max_points=settings.max_points,
        tolerance_um=settings.tolerance_um,
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
            two_directional(tables.straightness, 0.0),
            settings.reference_mm,
            1,
            allow_shift=settings.allow_shift,
            tolerance_um=VALUE_QUANTUM_UM / 2,
        )
        other, other_step = _resampled(cross, settings)
        other_axis = settings.cross_axis or tables.straightness_axis
        lines += _cec_table(index + 2, (axis, other_axis), 0, other.position_mm, other_step, other.plus_um)
        used.append(index + 2)
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


def _cec_table(  # noqa: PLR0917  (a table is these six things)
    index: int, axes: tuple[str, str], direction: int, positions: Floats, step: float, correction_um: Floats
) -> list[str]:
    """One table: its index, (input axis, output axis), direction, grid and values."""
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
    """The tables of an EEC or CEC file with one axis in it. The settings are not needed: the file says all.

    Raises InputError with the line for lines that are not understood, tables that do not fit together, more than one axis.
    """
    return read(text)
