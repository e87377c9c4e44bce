"""Tables as the CSV file that `hil.correction.manual` reads: to look at a controller's table, edit it and store it."""

from __future__ import annotations

import numpy as np

from drivers.errors import InputError
from hil.correction.tables import TableMode, TableSet
from hil.records.rows import Floats


def dump(tables: TableSet, comment: str = "") -> str:
    """The text of a manual table file: a row per node of any of the tables. comment: put before the header, each line after "# ".

    Raises InputError for a straightness table that corrects another axis: such a file holds one axis.
    """
    if tables.straightness is not None and tables.straightness_axis:
        raise InputError(
            f"the file holds a correction of axis {tables.straightness_axis} too, and a table file holds one axis; write JSON"
        )
    parts = [tables.pitch.position_mm]
    parts += [part.position_mm for part in (tables.backlash, tables.specified, tables.straightness) if part is not None]
    nodes = np.unique(np.concatenate(parts))
    columns: dict[str, Floats] = {"position_mm": nodes, "plus_um": tables.pitch.at(nodes, 1)}
    if tables.mode is not TableMode.UNIDIRECTIONAL_BACKLASH:
        columns["minus_um"] = tables.pitch.at(nodes, -1)
    if tables.mode is not TableMode.BIDIRECTIONAL and tables.backlash is not None:
        columns["backlash_um"] = tables.backlash.at(nodes)
    if tables.specified is not None:
        columns["specified_plus_um"] = tables.specified.at(nodes, 1)
        columns["specified_minus_um"] = tables.specified.at(nodes, -1)
    if tables.straightness is not None:
        alike = tables.straightness.is_alike
        for sign, name in (
            ((1, "straightness_um"),) if alike else ((1, "straightness_plus_um"), (-1, "straightness_minus_um"))
        ):
            columns[name] = tables.straightness.at(nodes, sign)
    lines = [f"# {line}" for line in comment.splitlines()]
    lines.append(",".join(columns))
    lines += [",".join(repr(float(value)) for value in row) for row in np.column_stack(list(columns.values()))]
    return "\n".join(lines) + "\n"
