"""Where a Modbus drive's own correction table stands among its registers: data, no reading.

    [drive.correction_table]     name, points, nodes, interpolation, outside, directions, sign
                                 position, plus, minus: the register of the first value; the others follow it without a gap
                                 count, origin, step, backlash, applied: registers, as far as the drive has them
    [drive.correction_table.enable]   register, on, off

Units, scales, types, orders, limits and memory are those of the registers named; one that stands first is that of all its column.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.correction_table import Quantity, TableDescription
from drivers.modbus.register_map import Register


@dataclass(frozen=True)
class TableBlocks:
    """columns: the first register of each; scalars: count, origin, step, backlash and applied, by what they are."""

    description: TableDescription
    columns: Mapping[str, Register]
    scalars: Mapping[str, Register]
    enable: Register
    on: int
    off: int

    def names(self) -> frozenset[str]:
        """Every register of the table; none of them is a parameter of its own."""
        found = [*self.columns.values(), *self.scalars.values(), self.enable]
        return frozenset(register.name for register in found)


def quantity_of(register: Register) -> Quantity:
    """What a register's raw numbers stand for, and how far they go."""
    low, high = register.layout.type.bounds
    if register.minimum is not None:
        low = max(low, math.ceil(register.minimum / register.scale - 1e-9))
    if register.maximum is not None:
        high = min(high, math.floor(register.maximum / register.scale + 1e-9))
    return Quantity(register.unit, register.scale, low, high)
