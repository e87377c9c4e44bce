"""The simulated drive's own correction table as objects of its dictionary: arrays or one domain.

Defines the objects, and what the drive refuses. The table can be changed only without power and switched off; an invalid one
is refused when it is switched on. Written without the master's table map.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from sim_backends.canopen_dictionary import (
    INVALID_VALUE,
    WRONG_LENGTH,
    WRONG_STATE,
    Dictionary,
    Item,
    Key,
    RefusedError,
)
from sim_backends.own_table import OwnTable, TableForm

SWITCH_A, COUNT, ORIGIN, STEP, RISING, FALLING, SHOWN_A = range(0x2310, 0x2317)
SWITCH_D, ALL, SHOWN_D = range(0x2320, 0x2323)
_POINT = struct.Struct("<ihh")  # position, rising, falling


def _number(index: int, subindex: int, code: str, name: str, *, access: str = "rw", high: int | None = None) -> Item:
    codec = struct.Struct(f"<{code}")
    return Item(index, subindex, name, access, codec, None, high, False, bytes(codec.size))


def table_items(form: TableForm) -> dict[Key, Item]:
    """The objects of a drive with such a table."""
    if form.explicit:
        items = [
            _number(SWITCH_D, 0, "B", "Error table active", high=1),
            Item(ALL, 0, "Error table", "rw", None, None, None, False, b""),
            _number(SHOWN_D, 0, "h", "Error corrected", access="ro"),
        ]
        return {item.key: item for item in items}
    items = [
        _number(SWITCH_A, 0, "B", "Pitch table active", high=1),
        _number(COUNT, 0, "H", "Pitch table points", high=form.points),
        _number(ORIGIN, 0, "i", "Pitch table origin"),
        _number(STEP, 0, "I", "Pitch table step"),
        _number(SHOWN_A, 0, "h", "Pitch correction", access="ro"),
    ]
    for index, name in ((RISING, "rising"), (FALLING, "falling")):
        items.append(_number(index, 0, "B", "Highest sub-index supported", access="const"))
        items += [_number(index, place, "h", f"Pitch correction {name} {place}") for place in range(1, form.points + 1)]
    return {item.key: item for item in items}


class TableObjects:
    """Connects the objects to an `OwnTable`, which takes its contents from the dictionary when it is switched on."""

    def __init__(self, dictionary: Dictionary, form: TableForm, powered: Callable[[], bool]) -> None:
        self._od = dictionary
        self._powered = powered
        self.table = OwnTable(form)
        self._switch = SWITCH_D if form.explicit else SWITCH_A
        dictionary.on_write(self._switch, 0, self._on_switch)
        dictionary.on_read(SHOWN_D if form.explicit else SHOWN_A, 0, self.table.shown)
        if form.explicit:
            dictionary.on_write_bytes(ALL, 0, self._on_domain)
            return
        for index, subindex in table_items(form):
            if index not in (SWITCH_A, SHOWN_A) and (index not in (RISING, FALLING) or subindex):
                dictionary.on_write(index, subindex, lambda _value: self._require_idle())

    def start(self) -> None:
        """At every start: load the stored table."""
        self.table.enabled = False
        if self._od.number(self._switch):
            self._take()

    def _require_idle(self) -> None:
        if self.table.enabled or self._powered():
            raise RefusedError(WRONG_STATE)

    def _on_switch(self, value: int) -> None:
        if self._powered():
            raise RefusedError(WRONG_STATE)
        if value:
            self._take()
        else:
            self.table.enabled = False

    def _on_domain(self, data: bytes) -> None:
        self._require_idle()
        if len(data) % _POINT.size or len(data) > _POINT.size * self.table.form.points:
            raise RefusedError(WRONG_LENGTH)

    def _take(self) -> None:
        """Take the contents from the dictionary. Raises RefusedError for an invalid table."""
        table, od = self.table, self._od
        if table.form.explicit:
            points = list(_POINT.iter_unpack(od.raw((ALL, 0))))
            places, rising, falling = ([point[column] for point in points] for column in range(3))
        else:
            count, origin, step = (od.number(index) for index in (COUNT, ORIGIN, STEP))
            places = [origin + number * step for number in range(count)]
            rising, falling = ([od.number(index, number + 1) for number in range(count)] for index in (RISING, FALLING))
        table.places, table.rising, table.falling = places, rising, falling
        if not table.usable():
            raise RefusedError(INVALID_VALUE)
        table.enabled = True
