"""An axis on the bench whose drive holds a correction table itself, on every face, and stored tables for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.bench_axis import PASSWORDS, lay_out

from hil.axis.axis_file import AxisConfig, load_axis
from hil.correction.store import SealedStore
from hil.correction.tables import DirectionalTable, TableMode, TableSet

FACES = {
    "in process": 'face = "virtual"\ncorrection_table = "simulated_array"\n',
    "canopen, array": 'correction_table = "simulated_array"\n',
    "canopen, domain": 'correction_table = "simulated_domain"\n',
    "modbus tcp, error map": 'face = "modbus-tcp"\n',
    "modbus rtu, pitch table": 'face = "modbus-rtu"\nregister_map = "vendor_style"\n',
}
"""[drive] of the axis file."""


def lay_out_table_axis(directory: Path, face: str, *, backlash_um: float = 12.0) -> tuple[AxisConfig, TableSet]:
    """Axis file and keys; and tables of a lead error with some waviness that differ from the machine's errors, not stored yet."""
    path = lay_out(directory, machine="ideal")
    text = path.read_text().replace("seed = 5\n", f"seed = 5\n{FACES[face]}")
    path.write_text(text.replace("dwell_s = 0.3\nreading_s = 0.3", "dwell_s = 0.1\nreading_s = 0.1"))
    axis = load_axis(path)
    places = np.array(axis.measurement.targets_mm)
    plus = -0.08 * places + 3.0 * np.sin(places / 40.0)
    tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(places, plus, plus - backlash_um))
    return axis, tables


def store(axis: AxisConfig, tables: TableSet) -> None:
    """Seal them at the path that the axis's verbs read."""
    SealedStore.of(axis, PASSWORDS["HIL_PASSWORD"], PASSWORDS["HIL_KEY_PASSWORD"]).save_tables(tables)
