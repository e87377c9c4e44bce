"""The nearest table that a drive can hold to the bridge's tables, and its deviation.

A table that the drive cannot hold is refused with what to change; values are never clipped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.correction_table import Directions, Interpolation, Nodes, Outside, RawFormat, RawTable, TableDescription
from drivers.errors import InputError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.compensation import Compensation
from hil.correction.formats.common import (
    both_directions,
    equidistant,
    on_nodes,
    one_directional,
    rounded_nodes,
    tables_only,
    thinned,
)
from hil.correction.tables import DirectionalTable
from hil.drive_table import DEVIATION_UM
from hil.drive_table.curve import DriveCurve, check_curve, largest_deviation_um
from hil.records.rows import UM_PER_MM, Floats

_ROUNDING_SLACK_UM = 1e-6


@dataclass(frozen=True)
class DriveTable:
    """A table for a drive, and its deviation from the bridge's.

    deviation_um: largest difference between the two corrections, over the travel and both directions: fewer nodes and
    rounding together. rounding_um: of the values alone. largest_um: the largest correction, for comparison.
    """

    curve: DriveCurve
    deviation_um: float
    rounding_um: float
    largest_um: float

    @property
    def raw(self) -> RawTable:
        """The numbers to be written."""
        return self.curve.raw


def wanted_of(compensation: Compensation, *, leave_out_effects: bool = False) -> DirectionalTable:
    """The table that would replace the bridge's compensation. Raises InputError for parts that no table holds: effects,
    another axis.
    """
    return both_directions(tables_only(compensation, leave_out_effects=leave_out_effects))


def drive_table(
    wanted: DirectionalTable,
    description: TableDescription,
    scaling: AxisScaling,
    limits: DriveLimits,
    *,
    deviation_um: float = DEVIATION_UM,
    bound: CorrectionBound = CAREFUL,
) -> DriveTable:
    """A table for the drive within `deviation_um` of the bridge's: on the bridge's nodes where it fits, else on as few
    as suffice.

    Raises InputError where there is none, naming the change needed, and CorrectionBoundError where the drive's
    correction exceeds the axis's bound.
    """
    value_um, place_um = description.value.um(scaling), description.position.um(scaling)
    budget_um = deviation_um - value_um / 2
    if budget_um <= 0:
        raise InputError(
            f"{description.name} keeps values in steps of {value_um:g} µm, which alone may be {value_um / 2:g} µm off; allow a"
            f" deviation (deviation_um) of more than that, or scale the drive's table finer"
        )
    there = _in_drive_frame(wanted, scaling.direction)
    if description.outside is Outside.ZERO:
        there = _as_far_as(there, limits, scaling.direction, place_um / UM_PER_MM)
    curves, backlash_um = _directions(there, description, budget_um)
    left_um = budget_um - _off_um(curves, there)
    sampled = _sampled(curves, description, place_um / UM_PER_MM, max(left_um, _ROUNDING_SLACK_UM))
    raw, rounding_um = _rounded(sampled, backlash_um, description, scaling)
    curve = DriveCurve(description, raw, scaling)
    check_curve(curve, limits, bound)
    found_um = largest_deviation_um(curve, wanted, limits.travel_min_mm, limits.travel_max_mm)
    if found_um > deviation_um + _ROUNDING_SLACK_UM:
        raise InputError(
            f"{description.name} would deviate from ours by {found_um:.3f} µm, more than {deviation_um:g} µm;"
            " allow a larger deviation (deviation_um)"
        )
    largest_um = max(float(np.max(np.abs(curve_um))) for curve_um in (wanted.plus_um, wanted.minus_um))
    return DriveTable(curve, found_um, rounding_um, largest_um)


# -- into the drive's frame --------------------------------------------------------------------------------------------
def _in_drive_frame(wanted: DirectionalTable, direction: int) -> DirectionalTable:
    """Positions and corrections in the sense of the motor's counts; `plus_um` is for rising counts."""
    if direction > 0:
        return wanted
    return DirectionalTable(-wanted.position_mm[::-1], -wanted.minus_um[::-1], -wanted.plus_um[::-1])


def _as_far_as(table: DirectionalTable, limits: DriveLimits, direction: int, place_mm: float) -> DirectionalTable:
    """The same with nodes at the ends of the travel, beyond which a drive that adds nothing outside would stop
    correcting.
    """
    low, high = sorted((direction * limits.travel_min_mm, direction * limits.travel_max_mm))
    ends = np.array([low - place_mm, high + place_mm])
    return on_nodes(table, np.union1d(table.position_mm, ends))


def _directions(
    table: DirectionalTable, description: TableDescription, budget_um: float
) -> tuple[DirectionalTable, float]:
    """Both curves as far as the drive distinguishes directions, and the amount by which the falling one is less."""
    if description.directions is Directions.BOTH:
        return table, 0.0
    if description.directions is Directions.BACKLASH:
        curve, backlash_um = one_directional(table, budget_um)
        return DirectionalTable(curve.position_mm, curve.value_um, curve.value_um - backlash_um), backlash_um
    half_um = (table.plus_um - table.minus_um) / 2
    worst_um = float(np.max(np.abs(half_um)))
    if worst_um > budget_um:
        raise InputError(
            f"{description.name} has one curve for both directions, and ours differ by up to {2 * worst_um:.3f} µm: take the"
            " reversal out by the drive's backlash parameter first, or keep the correction in the bridge"
        )
    return DirectionalTable(table.position_mm, table.plus_um - half_um, table.plus_um - half_um), 0.0


def _off_um(curves: DirectionalTable, wanted: DirectionalTable) -> float:
    """Deviation already caused by distinguishing the directions less well: equal in both; both are on the same nodes."""
    return float(np.max(np.abs(curves.plus_um - wanted.plus_um)))


# -- onto its nodes ----------------------------------------------------------------------------------------------------
def _sampled(
    table: DirectionalTable, description: TableDescription, place_mm: float, budget_um: float
) -> DirectionalTable:
    if description.interpolation is Interpolation.STEP:
        return _stepped(table, description, place_mm, budget_um)
    if description.nodes is Nodes.EXPLICIT:
        return thinned(rounded_nodes(table, place_mm), description.points, budget_um)
    origin = math.floor(table.position_mm[0] / place_mm + 1e-9) * place_mm
    return equidistant(
        table, None, resolution_mm=place_mm, max_points=description.points, tolerance_um=budget_um, origin_mm=origin
    )[0]


def _stepped(
    table: DirectionalTable, description: TableDescription, place_mm: float, budget_um: float
) -> DirectionalTable:
    """Equal steps; each value is that of the middle of its step, so that the deviation is equal at both ends."""
    first = math.floor(table.position_mm[0] / place_mm + 1e-9) * place_mm
    span = float(table.position_mm[-1]) - first
    best_um, best = math.inf, 0
    most = description.points - 1
    for intervals in sorted({round(count) for count in np.geomspace(1, max(most, 1), 80)}):
        step = math.ceil(span / intervals / place_mm - 1e-9) * place_mm
        nodes = first + step * np.arange(math.ceil(span / step - 1e-9) + 1)
        if len(nodes) > description.points:
            continue
        middles = np.append(nodes[:-1] + step / 2, nodes[-1])
        found = DirectionalTable(nodes, table.at(middles, 1), table.at(middles, -1))
        off_um = _stairs_off_um(found, table)
        if off_um <= budget_um:
            return found
        if off_um < best_um:
            best_um, best = off_um, len(nodes)
    raise InputError(
        f"{description.name} holds a value until the next node, and with the {best} points that suit it best it is"
        f" {best_um:.3f} µm off; allow a larger deviation (deviation_um), or keep the correction in the bridge"
    )


def _stairs_off_um(stairs: DirectionalTable, table: DirectionalTable) -> float:
    """Deviation of values held until the next node from straight lines; the largest is at an end of a step or on a
    node.
    """
    places = np.union1d(table.position_mm, stairs.position_mm)
    worst = 0.0
    for values, sign in ((stairs.plus_um, 1), (stairs.minus_um, -1)):
        for side in ("left", "right"):
            at = np.maximum(np.searchsorted(stairs.position_mm, places, side=side) - 1, 0)
            worst = max(worst, float(np.max(np.abs(values[at] - table.at(places, sign)))))
    return worst


# -- into whole numbers ------------------------------------------------------------------------------------------------
def _rounded(
    table: DirectionalTable, backlash_um: float, description: TableDescription, scaling: AxisScaling
) -> tuple[RawTable, float]:
    """The raw table, and the largest change of a value by rounding, µm."""
    value_um, place_um = description.value.um(scaling), description.position.um(scaling)
    places = [round(place * UM_PER_MM / place_um) for place in table.position_mm]
    _require_inside(
        places, description.position, f"{description.name}: a node stands", place_um, "shorten the axis, or "
    )
    curves = [_whole(table.plus_um, description, value_um)]
    if description.directions is Directions.BOTH:
        curves.append(_whole(table.minus_um, description, value_um))
    rounding_um = max(
        float(np.max(np.abs(description.sign * value_um * np.array(curve) - values)))
        for curve, values in zip(curves, (table.plus_um, table.minus_um), strict=False)
    )
    raw = RawTable(plus=tuple(curves[0]), minus=tuple(curves[1]) if len(curves) > 1 else ())
    if description.directions is Directions.BACKLASH and description.backlash is not None:
        own_um = description.backlash.um(scaling)
        amount = round(description.sign * backlash_um / own_um)
        _require_inside([amount], description.backlash, f"{description.name}: the backlash is", own_um, "")
        raw = RawTable(plus=raw.plus, backlash=amount)
        rounding_um = max(rounding_um, abs(description.sign * amount * own_um - backlash_um))
    if description.nodes is Nodes.EXPLICIT:
        return RawTable(raw.plus, raw.minus, tuple(places), backlash=raw.backlash), rounding_um
    step = places[1] - places[0]
    if description.step is not None:
        _require_inside([step], description.step, f"{description.name}: the nodes stand apart", place_um, "")
    return RawTable(raw.plus, raw.minus, (), places[0], step, raw.backlash), rounding_um


def _whole(values_um: Floats, description: TableDescription, value_um: float) -> list[int]:
    raw = [round(description.sign * value / value_um) for value in values_um]
    _require_inside(
        raw,
        description.value,
        f"{description.name}: a value is",
        value_um,
        "take a constant out of the tables (specified accuracy), or ",
    )
    return raw


def _require_inside(raw: Sequence[int], quantity: RawFormat, what: str, unit_um: float, advice: str) -> None:
    for number in raw:
        if not quantity.low <= number <= quantity.high:
            raise InputError(
                f"{what} {number * unit_um:.6g} µm, and the drive holds {quantity.low * unit_um:.6g} to"
                f" {quantity.high * unit_um:.6g} µm there; {advice}scale the drive's table coarser"
            )
