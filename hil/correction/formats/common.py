"""Shared by the controller formats: tables as the two curves that a controller applies, and their interpolation onto its points.

A controller has one correction per direction, given at its points: linear between them and constant beyond the ends. The functions
here convert tables and numbers, do no I/O, and hold nothing that is true of one format only.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from drivers.files import DELIMITERS, SEPARATOR, is_row, without_empty_end
from hil.correction.compensation import Compensation, ErrorTerm
from hil.correction.fold import folded
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet
from hil.effects import Term
from hil.records.rows import UM_PER_MM, Floats, Records, parse_number, refuse_other_units, repeats, shown

LENGTH_MM = {
    "nm": 1e-6,
    "um": 1e-3,
    "micron": 1e-3,
    "microns": 1e-3,
    "µm": 1e-3,
    "μm": 1e-3,
    "mm": 1.0,
    "cm": 10.0,
    "m": 1000.0,
    "in": 25.4,
    "inch": 25.4,
    "inches": 25.4,
    "uin": 25.4e-6,
    "µin": 25.4e-6,
    "μin": 25.4e-6,
}
"""Unit of a length -> mm."""
_NAMED_UNIT = re.compile(r"(?:[\[(]|\bin |_|/ ?)([a-zµμ]+)[\])]?$", re.IGNORECASE)
"""The unit at the end of a heading: `Ist [µm]`, `error_mm`, `deviation in um`."""


@dataclass(frozen=True)
class Export:
    """A controller's file, with its deviation from the tables.

    text: the file's contents
    points: interpolation points per direction
    deviation_um: largest difference, at any position and in either direction, between the correction in the file and that of the
        tables less `shift_um`, µm: resampling and rounding together, found by reading the file back
    shift_um: constant subtracted from the correction, as the format needs zero at the reference point, µm
    notes: what has to be set on the controller besides loading the file
    """

    text: str
    points: int
    deviation_um: float
    shift_um: float = 0.0
    notes: tuple[str, ...] = ()


def tables_only(compensation: Compensation, *, leave_out_effects: bool) -> TableSet:
    """The tables of a correction, with those fitted effects added to them that depend on position and direction alone.

    leave_out_effects: whether effects that no table can hold are left out; otherwise InputError is raised for them.
    """
    whole = folded(compensation)
    held_by_none = [*dict.fromkeys(_name(term) for term in whole.terms)]
    if whole.rise is not None:
        held_by_none.append("the rise of the lost motion after a reversal")
    if held_by_none and not leave_out_effects:
        raise InputError(
            f"what is in force holds {', '.join(held_by_none)}, and a controller's table holds none of that; leave it out"
            " (--tables-only) to export the tables alone: the axis is then corrected less than it was proven"
        )
    return whole.tables


def _name(term: ErrorTerm) -> str:
    return term.effect.id if isinstance(term, Term) else type(term).__name__


def both_directions(tables: TableSet, *, cross_axis: bool = False) -> DirectionalTable:
    """The whole correction at rest, per direction, as one table on the nodes of all parts.

    cross_axis: whether the caller exports a straightness table that corrects another axis by itself; otherwise InputError is raised
    for such a table.
    """
    if tables.straightness is not None and tables.straightness_axis and not cross_axis:
        raise InputError(
            f"the straightness table corrects axis {tables.straightness_axis}, and this format holds one axis; export it"
            " as SINUMERIK CEC, or leave the straightness out"
        )
    nodes = tables.nodes_mm
    return DirectionalTable(nodes, tables.correction_um(nodes, 1), tables.correction_um(nodes, -1))


def largest_difference_um(first: DirectionalTable, second: DirectionalTable) -> float:
    """The largest difference of two tables at any position, µm. Both are linear between nodes, so it lies on a node of one of them."""
    nodes = np.union1d(first.position_mm, second.position_mm)
    return max(float(np.max(np.abs(first.at(nodes, sign) - second.at(nodes, sign)))) for sign in (1, -1))


def shifted(table: DirectionalTable, by_um: float) -> DirectionalTable:
    """The table with a constant, µm, added in both directions."""
    return DirectionalTable(table.position_mm, table.plus_um + by_um, table.minus_um + by_um)


def anchored(
    table: DirectionalTable, reference_mm: float, direction: int, *, allow_shift: bool, tolerance_um: float
) -> tuple[DirectionalTable, float]:
    """The table less its value at the reference point `reference_mm`, arrived at in `direction` (+1, -1), and that value, µm.

    allow_shift: whether that value may be more than `tolerance_um`; otherwise InputError is raised. The shift moves the whole axis,
    and it cancels a specified accuracy that is a constant.
    """
    value = float(table.at(reference_mm, direction))
    if abs(value) > tolerance_um and not allow_shift:
        raise InputError(
            f"the correction at the reference point {reference_mm:g} mm is {value:.3f} µm and the format needs zero there;"
            f" name a reference where it is zero (reference_mm), or allow the shift (allow_shift): the axis as a whole then stands"
            f" {-value:+.3f} µm elsewhere"
        )
    return shifted(table, -value), value


def enough(deviation_um: float) -> str:
    """A deviation as text with three decimals, rounded up: as a tolerance it is accepted."""
    return f"{np.ceil(1000.0 * deviation_um) / 1000.0:.3f}"


def one_directional(table: DirectionalTable, tolerance_um: float) -> tuple[SingleTable, float]:
    """A two-directional table as one curve, of the + direction, and one backlash, µm.

    The backlash is the middle between the largest and the smallest difference plus - minus; the rest of the difference is divided
    equally between the directions. Raises InputError when a direction would deviate by more than `tolerance_um`.
    """
    difference = table.plus_um - table.minus_um
    low, high = float(difference.min()), float(difference.max())
    if (high - low) / 4 > tolerance_um:
        raise InputError(
            f"the two directions differ by {low:.3f} to {high:.3f} µm along the axis, and one table with one backlash holds a"
            f" constant; export both directions where the format has two tables, or allow a deviation (tolerance_um) of"
            f" {enough((high - low) / 4)} and what points and rounding add"
        )
    backlash = (low + high) / 2
    return SingleTable(table.position_mm, (table.plus_um + table.minus_um + backlash) / 2), backlash


def two_directional(single: SingleTable, backlash_um: float) -> DirectionalTable:
    """The correction, per direction, of a controller with one table and a backlash, µm: the - direction is table less backlash."""
    return DirectionalTable(single.position_mm, single.value_um, single.value_um - backlash_um)


def rounded_nodes(table: DirectionalTable, resolution_mm: float) -> DirectionalTable:
    """The table on its own nodes, rounded to a format's resolution, mm. Nodes that are equal after rounding become one."""
    nodes = np.unique(np.round(table.position_mm / resolution_mm)) * resolution_mm
    return on_nodes(table, nodes)


def on_nodes(table: DirectionalTable, nodes: Floats) -> DirectionalTable:
    """The curves sampled at other nodes, mm, shape (n,)."""
    return DirectionalTable(nodes, table.at(nodes, 1), table.at(nodes, -1))


def _lost_on_nodes_um(table: DirectionalTable, nodes: Floats) -> float:
    """The largest difference of the table and `on_nodes` of it, µm: zero on the new nodes, so the table's own are looked at."""
    at = table.position_mm
    return max(
        float(np.max(np.abs(np.interp(at, nodes, np.interp(nodes, at, one_um)) - one_um)))
        for one_um in (table.plus_um, table.minus_um)
    )


def equidistant(
    table: DirectionalTable,
    step_mm: float | None,
    *,
    resolution_mm: float,
    max_points: int,
    tolerance_um: float,
    origin_mm: float | None = None,
) -> tuple[DirectionalTable, float]:
    """The table on a grid of equal steps that covers it, and the step, mm.

    step_mm: the step; None: the widest one with which the grid deviates from the table by no more than `tolerance_um`
    resolution_mm: the step is a whole multiple of it
    origin_mm: a position that lies on the grid; None: the grid begins at the first node
    Raises InputError for a step that is no such multiple, needs more than `max_points`, or deviates by more than `tolerance_um`; and
    for a table with a single position.
    """
    first, last = float(table.position_mm[0]), float(table.position_mm[-1])
    if origin_mm is not None:
        first, last = min(first, origin_mm), max(last, origin_mm)
    origin = first if origin_mm is None else origin_mm
    span = last - first
    if span <= 0:
        raise InputError(f"the table holds one position, {first:g} mm, and this format needs at least two")
    if step_mm is not None:
        given = round(step_mm / resolution_mm) * resolution_mm
        if step_mm <= 0 or abs(given - step_mm) > 1e-9:
            raise InputError(f"the step is {step_mm:g} mm, expected a multiple of {resolution_mm:g} mm above zero")
        grid = _grid(origin, first, last, given)
        if len(grid) > max_points:
            raise InputError(
                f"a step of {given:g} mm needs {len(grid)} points, and at most {max_points} fit; widen the step to"
                f" {span / max(max_points - 2, 1):.3f} mm or more"
            )
        _check_resampling(_lost_on_nodes_um(table, grid), given, tolerance_um)
        return on_nodes(table, grid), given
    best, best_step, best_points = np.inf, 0.0, 0
    tried = None
    for intervals in range(1, max_points):
        step = float(np.ceil(span / intervals / resolution_mm - 1e-9)) * resolution_mm
        if step in (tried, 0.0):
            continue
        tried = step
        grid = _grid(origin, first, last, step)
        if len(grid) > max_points:
            continue
        deviation = _lost_on_nodes_um(table, grid)
        if deviation <= tolerance_um:
            return on_nodes(table, grid), step
        if deviation < best:
            best, best_step, best_points = deviation, step, len(grid)
    raise InputError(
        f"no equal step with at most {max_points} points keeps the table within {tolerance_um:g} µm; the best,"
        f" {best_step:g} mm with {best_points} points, deviates by {enough(best)} µm: allow a"
        " larger deviation (tolerance_um), or more points (max_points)"
    )


def _grid(origin: float, first: float, last: float, step: float) -> Floats:
    below = int(np.ceil((origin - first) / step - 1e-9))
    above = int(np.ceil((last - origin) / step - 1e-9))
    return np.asarray(origin + np.arange(-below, above + 1) * step, dtype=np.float64)


def _check_resampling(deviation_um: float, step_mm: float, tolerance_um: float) -> None:
    if deviation_um > tolerance_um:
        raise InputError(
            f"with a step of {step_mm:g} mm the table deviates by {enough(deviation_um)} µm, more than {tolerance_um:g} µm;"
            " allow a larger deviation (tolerance_um), or narrow the step"
        )


def thinned(table: DirectionalTable, max_points: int, tolerance_um: float) -> DirectionalTable:
    """The table on at most `max_points` of its nodes, deviating from it by no more than `tolerance_um` at any position.

    Begins with the two ends and adds the node with the largest deviation until the tolerance is kept (method of Ramer, Douglas and
    Peucker). Raises InputError when that needs more points.
    """
    if len(table.position_mm) <= max_points:
        return table
    kept = [0, len(table.position_mm) - 1]
    while True:
        candidate = DirectionalTable(table.position_mm[kept], table.plus_um[kept], table.minus_um[kept])
        off = np.maximum(
            np.abs(candidate.at(table.position_mm, 1) - table.plus_um),
            np.abs(candidate.at(table.position_mm, -1) - table.minus_um),
        )
        worst = int(np.argmax(off))
        if off[worst] <= tolerance_um:
            return candidate
        if len(kept) == max_points:
            raise InputError(
                f"the table has {len(table.position_mm)} points, and at most {max_points} fit; with that many it deviates by"
                f" {enough(off[worst])} µm: allow that (tolerance_um), or measure fewer sections"
            )
        kept = sorted({*kept, worst})


GROWS = 0.1
"""Change of a correction with the position, mm/mm, that no machine needs: ten times the default of `max_slope_um_per_mm`."""


def refuse_positions(tables: TableSet, remedy: str) -> None:
    """Raises InputError, with the remedy, for a correction that grows as the position does: its values are positions, in another unit,
    or of the other type.
    """
    table = both_directions(tables, cross_axis=True)
    slopes = [_slope(table.position_mm, curve / UM_PER_MM) for curve in (table.plus_um, table.minus_um)]
    steepest = max(slopes, key=abs)
    if abs(steepest) > GROWS:
        raise InputError(
            f"the correction would change by {steepest:.3g} mm per mm of position, more than any axis needs; {remedy}"
        )


def refuse_errors_as_positions(records: Records, remedy: str) -> None:
    """Raises InputError, with the remedy, for errors that grow as the target does, in mm or as their number in µm, and as
    `refuse_other_units`.
    """
    try:
        refuse_other_units(records)
    except InputError as error:
        raise InputError(f"{error.what}; {remedy}") from error
    target, error_um = records.target_mm, records.error_um
    if repeats(target, error_um):
        raise InputError(f"the errors in µm repeat the targets in mm: they are positions; {remedy}")


def refuse_turned(records: Records) -> None:
    """Raises InputError where every way along the axis, in both directions, runs against its direction."""
    follows = (np.diff(records.run) == 0) & (np.diff(records.direction) == 0)
    along = (np.diff(records.target_mm) * records.direction[1:])[follows]
    signs = set(records.direction[1:][follows][along != 0].tolist())
    if signs == {1.0, -1.0} and np.all(along <= 0):
        raise InputError(
            "the targets fall in direction + and rise in -: exchange the directions, or put the rows in the order of time"
        )


def _slope(x: Floats, y: Floats) -> float:
    from_middle = x if len(x) == 1 else x - np.mean(x)  # a single point: against zero
    square = float(from_middle @ from_middle)
    return float(from_middle @ y) / square if square else 0.0


def check_written(written: TableSet, wanted: DirectionalTable, *, limit_um: float) -> float:
    """Deviation of a file that was read back from the wanted table, µm. Raises InputError above `limit_um`."""
    deviation = largest_difference_um(both_directions(written), wanted)
    if deviation > limit_um:
        raise InputError(
            f"the file would deviate from the tables by {deviation:.3f} µm, more than {limit_um:.3f} µm; allow a"
            " larger deviation (tolerance_um), or choose finer points"
        )
    return deviation


def evenly(first: float, step: float, count: int) -> Floats:
    """`count` positions with equal steps, the first at `first`, shape (count,)."""
    return np.asarray(first + step * np.arange(count), dtype=np.float64)


def table_set(positions: Floats, plus_um: Floats, minus_um: Floats) -> TableSet:
    """A bidirectional set from the curves of both directions: positions, mm, and corrections, µm, shape (n,) each."""
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(positions, plus_um, minus_um))


def one_directional_set(positions: Floats, plus_um: Floats, backlash_um: float) -> TableSet:
    """A one-directional set from the curve of the + direction (positions, mm, and corrections, µm, shape (n,)) and a backlash, µm."""
    backlash = SingleTable(positions, np.full(len(positions), backlash_um))
    return TableSet(
        TableMode.UNIDIRECTIONAL_BACKLASH, DirectionalTable(positions, plus_um, plus_um - backlash_um), backlash
    )


def numbered_lines(text: str) -> Iterator[tuple[int, str]]:
    """The lines, stripped, with their numbers, which count from 1; empty lines too. Line ends are LF, CR or both."""
    yield from ((number, line.strip()) for number, line in enumerate(_LINE_END.split(text), start=1))


_LINE_END = re.compile(r"\r\n|\n|\r")


Rows = list[tuple[int, list[str]]]
"""Number and cells of each row of a file."""


def delimited_rows(text: str, delimiter: str, share: Callable[[list[str]], float]) -> Rows:
    """The header and the rows below it; where no row is a whole header, the one that is most of it, alone.

    delimiter: "" for the one that a line `sep=` names, else the first of tab, semicolon and comma with which the header is one. Empty
    cells behind the header's last are left out. share: how much of a header the cells of a row are; 1 for a whole one, the first of
    which is taken. Raises InputError with the line for a row of another width, and for a table without a row below the header.
    """
    lines = list(enumerate(_LINE_END.split(text), start=1))  # not stripped: a row may begin with empty cells
    found_mark = SEPARATOR.fullmatch(lines[0][1].strip(" "))
    named = "" if found_mark is None else found_mark[1]
    rows = [(number, line) for number, line in _joined(lines) if is_row(line)]
    if len(rows) < 2:
        raise InputError("holds no table, expected a header and at least one row")
    candidates = (delimiter or named,) if delimiter or named else DELIMITERS
    best, first, found = 0.0, 0, ""
    for place, each in ((place, each) for place, (_, line) in enumerate(rows) for each in candidates if each in line):
        here = share(_cells(rows[place], each))
        if not found or here > best:
            best, first, found = here, place, each
        if best >= 1.0:
            break
    if named and not delimiter and not best:
        raise InputError(
            f"names the delimiter {named!r}, and no row parted by it is a header; name it (delimiter)", line=1
        )
    if not found:
        has = f"{candidates[0]!r}" if len(candidates) == 1 else "tab, semicolon or comma"
        raise InputError(
            f"the header has no {has} to part its columns; name the delimiter (delimiter)", line=rows[0][0]
        )
    header = without_empty_end(_cells(rows[first], found))
    table = [(rows[first][0], header)]
    if best < 1.0:
        return table
    if first + 1 == len(rows):
        raise InputError("holds no row below its header", line=rows[first][0])
    for row in rows[first + 1 :]:
        cells = without_empty_end(_cells(row, found), len(header))
        if len(cells) != len(header):
            raise InputError(f"row has {len(cells)} columns, expected {len(header)} (parted by {found!r})", line=row[0])
        table.append((row[0], cells))
    return table


_OPEN = re.compile(r'(?:^|[\t;,|]) *"[^"]*$')
"""A line that ends within a cell in quotation marks."""
_MOST_LINES = 5
"""Of a cell, whose lines a heading of a spreadsheet has."""


def _joined(lines: list[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """The lines, those of one cell in quotation marks joined by a blank; the number is that of the first."""
    at = 0
    while at < len(lines):
        number, line = lines[at]
        end = at + 1
        while _OPEN.search(line) and end < min(len(lines), at + _MOST_LINES):
            line, end = f"{line} {lines[end][1]}", end + 1
        if _OPEN.search(line):
            line, end = lines[at][1], at + 1
        yield number, line
        at = end


def _cells(row: tuple[int, str], delimiter: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([row[1]], delimiter=delimiter))]
    except csv.Error as error:
        raise InputError(f"is no row of a table: {error}", line=row[0]) from error


def without_unit_row(table: Rows, units: Mapping[int, str], remedy: str) -> Rows:
    """The rows below a header, less a first one of units: a unit of length, or nothing, in each column of `units`.

    units: column -> the unit that is taken for it, "" where it was stated.
    Raises InputError with the line, and the remedy, where it or the end of a heading names another unit; and where no row is left.
    """
    (header_line, header), (line, cells), *below = table
    headings = {place: found[1] for place in units if (found := _NAMED_UNIT.search(header[place]))}
    _check_units(headings, units, remedy, header_line)
    named = {place: cells[place].strip("[]()").lower().removeprefix("in ") for place in units if cells[place]}
    if not named or not all(unit in LENGTH_MM for unit in named.values()):
        return table[1:]
    _check_units(named, units, remedy, line)
    if not below:
        raise InputError("holds no row below that of the units", line=line)
    return below


def _check_units(named: Mapping[int, str], units: Mapping[int, str], remedy: str, line: int) -> None:
    for place, unit in named.items():
        factor = LENGTH_MM.get(unit.lower())
        if factor is not None and units[place] and factor != LENGTH_MM[units[place]]:
            raise InputError(f"column {place + 1} is in {unit}, taken is {units[place]}; {remedy}", line=line)


def number(text: str, what: str, line: int, decimal: str = "") -> float:
    """A finite number from a file; U+2212 is a minus sign too. Raises InputError with the line.

    decimal: the decimal mark, "" where the format has no choice and it is the point.

    The other mark is refused in a number, also between thousands: "1,234" is 1.234 or 1234.
    """
    value = _number(text, decimal)
    if value is None or not np.isfinite(value):
        other = "." if decimal == "," else ","
        is_one = decimal and value is None and _number(text, other) is not None
        hint = f"; with another decimal mark (decimal {other}) it is one" if is_one else ""
        raise InputError(f"{what} is {shown(text)}, expected a number{hint}", line=line)
    return value


def _number(text: str, decimal: str) -> float | None:
    typed = text.replace("\N{MINUS SIGN}", "-")
    if decimal == ",":
        typed = typed.replace(".", "?").replace(",", ".")
    return parse_number(typed)


def require(condition: bool, complaint: str) -> None:
    """Raise InputError with this complaint about a setting unless the condition holds."""
    if not condition:
        raise InputError(complaint)
