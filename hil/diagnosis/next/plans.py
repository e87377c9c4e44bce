"""Plans as files: the rows of a campaign that is still to be measured, CSV like the records it will give.

Required: `run`, `direction`, `target_mm`. Optional, empty as usual: `overrun_mm` (how far beyond the target the axis turns),
`feed_mm_s`, `dwell_s`, `strokes_s` and `rest_s` (before the row), and what is set: `load_kg`, `pos_<axis>_mm`. Any other column is
an error.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drivers.errors import InputError
from drivers.files import read_text, table_rows
from drivers.limits import DriveLimits
from hil.diagnosis.next.planned_run import PlannedPoint
from hil.records.files import split_lines
from hil.records.rows import parse_number, shown

REQUIRED = ("run", "direction", "target_mm")
FIELDS = ("overrun_mm", "feed_mm_s", "dwell_s", "strokes_s", "rest_s")
SET = re.compile(r"load_kg|abbe_offset_mm|setup|pos_[a-z]\w*_mm")
USUAL_OVERRUN_MM = 1.0


def to_plan(points: Sequence[PlannedPoint], comment: str = "") -> str:
    """The text of a plan file."""
    levels = list(dict.fromkeys(name for point in points for name, _ in point.levels))
    out = io.StringIO()
    out.writelines(f"# {line}\n" for line in comment.splitlines())
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*REQUIRED, *FIELDS, *levels])
    for point in points:
        set_to = dict(point.levels)
        feed = "" if point.feed_mm_s is None else f"{point.feed_mm_s:g}"
        cells = [f"{point.overrun_mm:g}", feed, f"{point.dwell_s:g}", f"{point.strokes_s:.0f}", f"{point.rest_s:.0f}"]
        row = [str(point.run), f"{point.direction:+d}", f"{point.target_mm:.3f}", *cells]
        writer.writerow([*row, *(f"{set_to[name]:g}" if name in set_to else "" for name in levels)])
    return out.getvalue()


def read_plan(path: str | Path, limits: DriveLimits) -> tuple[PlannedPoint, ...]:
    """The rows of a plan file, each inside the limits with its reversal. Raises InputError naming file, line and
    value.
    """
    lines = list(table_rows(split_lines(read_text(path))))
    if not lines:
        raise InputError(f"holds no plan, expected a header with {', '.join(REQUIRED)}", path=path)
    header = lines[0][1]
    missing = [name for name in REQUIRED if name not in header]
    unknown = [name for name in header if name not in (*REQUIRED, *FIELDS) and not SET.fullmatch(name)]
    if missing or unknown or len(set(header)) < len(header):
        what = f"lacks {', '.join(missing)}" if missing else f"names {shown(', '.join(unknown) or 'a column twice')}"
        raise InputError(
            f"header {what}; expected {','.join((*REQUIRED, *FIELDS))} and what is set",
            path=path,
            line=lines[0][0],
        )
    if len(lines) < 2:
        raise InputError("holds no rows under its header", path=path)
    return tuple(_point(cells, header, limits, path, number) for number, cells in lines[1:])


def _point(cells: list[str], header: Sequence[str], limits: DriveLimits, path: str | Path, number: int) -> PlannedPoint:
    if len(cells) != len(header):
        raise InputError(f"row has {len(cells)} columns, expected {len(header)}", path=path, line=number)
    values: dict[str, float] = {}
    for name, cell in zip(header, cells, strict=True):
        if not cell and name not in REQUIRED:
            continue
        value = parse_number(cell)
        least = -math.inf if name == "target_mm" or SET.fullmatch(name) or name == "direction" else 0.0
        if value is None or not math.isfinite(value) or value < least:
            kind = "a number" if least < 0 else "a number >= 0"
            raise InputError(f"{name} is {shown(cell)}, expected {kind}", path=path, line=number)
        values[name] = value
    if values["direction"] not in (1.0, -1.0):
        raise InputError(f"direction is {values['direction']:g}, expected +1 or -1", path=path, line=number)
    if values["run"] != int(values["run"]):
        raise InputError(f"run is {values['run']:g}, expected a whole number", path=path, line=number)
    point = PlannedPoint(int(values["run"]), int(values["direction"]), values["target_mm"], USUAL_OVERRUN_MM)
    point = replace(
        point, levels=tuple((name, values[name]) for name in header if SET.fullmatch(name) and name in values)
    )
    given = {name: values[name] for name in FIELDS if name in values}
    point = replace(point, **given)  # type: ignore[arg-type]
    turn = point.target_mm - point.direction * point.overrun_mm
    for what, place in (("target_mm", point.target_mm), ("the turn before it", turn)):
        if not limits.travel_min_mm <= place <= limits.travel_max_mm:
            raise InputError(
                f"{what} is {place:g} mm, expected {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm",
                path=path,
                line=number,
            )
    if point.overrun_mm <= 0 or (point.feed_mm_s is not None and not 0 < point.feed_mm_s <= limits.max_velocity_mm_s):
        raise InputError(
            f"overrun_mm {point.overrun_mm:g} or feed_mm_s {point.feed_mm_s} is out of range, expected more than 0 and at most"
            f" {limits.max_velocity_mm_s:g} mm/s",
            path=path,
            line=number,
        )
    return point
