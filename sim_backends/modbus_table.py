"""The correction tables of the simulated Modbus drives themselves, as blocks of registers.

Defines the registers, and what the drive refuses. As over CANopen a table can be changed only without power and switched
off, and is taken over when it is switched on. Written without the client's register map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from sim_backends.modbus_registers import DEVICE_FAILURE, ILLEGAL_VALUE, Cell, RefusedRequestError, Value
from sim_backends.own_table import OwnTable, TableForm

ERROR_MAP = TableForm(points=128, explicit=True, value_counts=0.05, zero_outside=True)
"""Up to 128 nodes in µm with two curves in 0.05 µm, nothing outside."""
PITCH_STEPS = TableForm(points=256, explicit=False, stepped=True, curves=1)
"""Up to 256 equidistant values in counts, each valid until the next node, and a backlash."""


class BlockTable:
    """Registers and the table made of them. um_counts(): motor counts per unit of the form, read when it is switched on."""

    def __init__(self, form: TableForm, powered: Callable[[], bool], um_counts: Callable[[], float]) -> None:
        self._form = form
        self._powered = powered
        self._um_counts = um_counts
        self.own = OwnTable(form)
        self.numbers = {"count": 0, "origin": 0, "step": 0, "backlash": 0}
        self.columns = {name: [0] * form.points for name in ("places", "rising", "falling")}
        self.writes = 0  # number of values written, which some drives keep in EEPROM

    # -- cells ---------------------------------------------------------------------------------------------------------
    def map_cells(self) -> list[Cell]:
        """Cells of the drive that shows CiA-402 objects: high word first."""
        cells = [
            Cell(0x3000, "H", lambda: int(self.own.enabled), self._on_switch, 0, 1),
            self._number(0x3001, "H", "count", self._form.points),
            Cell(0x3002, "h", self.own.shown),
        ]
        for start, code, column in ((0x3100, "i", "places"), (0x3200, "h", "rising"), (0x3280, "h", "falling")):
            cells += self._block(start, code, column)
        return cells

    def pitch_cells(self) -> list[Cell]:
        """Cells of the drive with a vendor's own registers: low word first."""
        return [
            Cell(300, "H", lambda: int(self.own.enabled), self._on_switch, 0, 1),
            self._number(301, "H", "count", self._form.points),
            replace(self._number(302, "i", "origin"), low_word_first=True),
            replace(self._number(304, "I", "step"), low_word_first=True),
            self._number(306, "H", "backlash"),
            *self._block(310, "h", "rising"),
        ]

    def _number(self, address: int, code: str, name: str, high: int | None = None) -> Cell:
        def write(value: Value) -> None:
            self._require_idle()
            self.numbers[name] = int(value)

        return Cell(address, code, lambda: self.numbers[name], write, None if high is None else 0, high)

    def _block(self, start: int, code: str, column: str) -> list[Cell]:
        values = self.columns[column]

        def cell(index: int) -> Cell:
            def write(value: Value) -> None:
                self._require_idle()
                values[index] = int(value)
                self.writes += 1

            return Cell(start + index * (2 if code == "i" else 1), code, lambda: values[index], write)

        return [cell(index) for index in range(self._form.points)]

    # -- reactions of the drive ----------------------------------------------------------------------------------------
    def _require_idle(self) -> None:
        if self.own.enabled or self._powered():
            raise RefusedRequestError(DEVICE_FAILURE)

    def _on_switch(self, value: Value) -> None:
        if self._powered():
            raise RefusedRequestError(DEVICE_FAILURE)
        if not value:
            self.own.enabled = False
            return
        own, numbers, unit = self.own, self.numbers, self._um_counts()
        count = numbers["count"]
        form = self._form
        own.form = replace(form, place_counts=form.place_counts * unit, value_counts=form.value_counts * unit)
        if form.explicit:
            own.places = self.columns["places"][:count]
        else:
            own.places = [numbers["origin"] + index * numbers["step"] for index in range(count)]
        own.rising, own.falling = self.columns["rising"][:count], self.columns["falling"][:count]
        own.backlash = numbers["backlash"]
        if not own.usable():
            raise RefusedRequestError(ILLEGAL_VALUE)
        own.enabled = True
