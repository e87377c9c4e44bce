"""The in-process drive's own correction table: `CorrectionTable` directly over the stage of the servo, without a wire."""

from __future__ import annotations

from collections.abc import Callable

from drivers.correction_table import (
    CorrectionTable,
    Directions,
    Interpolation,
    Nodes,
    Outside,
    Quantity,
    RawTable,
    TableDescription,
)
from drivers.errors import StateError
from sim_backends.own_table import OwnTable, TableForm

_I16, _I32, _U32 = (-32768, 32767), (-(2**31), 2**31 - 1), (0, 2**32 - 1)


class VirtualCorrectionTable(CorrectionTable):
    """Can be changed only without power and switched off, as on a wire. Positions and values are in motor counts. Raises
    StateError."""

    def __init__(self, drive: str, form: TableForm, powered: Callable[[], bool]) -> None:
        self.drive = drive
        self._powered = powered
        self._raw = RawTable()
        self.own = OwnTable(form)
        places = Quantity("counts", form.place_counts, *_I32)
        self.description = TableDescription(
            name="error table" if form.negated else "pitch table",
            points=form.points,
            nodes=Nodes.EXPLICIT if form.explicit else Nodes.EQUIDISTANT,
            interpolation=Interpolation.STEP if form.stepped else Interpolation.LINEAR,
            outside=Outside.ZERO if form.zero_outside else Outside.HOLD,
            directions=Directions.BOTH if form.curves == 2 else Directions.BACKLASH,
            sign=-1 if form.negated else 1,
            position=places,
            value=Quantity("counts", form.value_counts, *_I16),
            step=Quantity("counts", form.place_counts, *_U32),
            backlash=Quantity("counts", form.value_counts, *_I16),
            shows_applied=True,
        )

    def read(self) -> RawTable:
        return self._raw

    def _write(self, table: RawTable, present: RawTable | None) -> None:
        if self.own.enabled or self._powered():
            raise StateError(f"drive {self.drive}: its table is changed switched off and without power only")
        self._raw = table

    def enabled(self) -> bool:
        return self.own.enabled

    def _switch(self, on: bool) -> None:
        if self._powered():
            raise StateError(f"drive {self.drive}: its table is switched without power only")
        raw, own = self._raw, self.own
        own.places, own.rising, own.falling, own.backlash = raw.nodes, raw.plus, raw.minus, raw.backlash
        if on and not own.usable():
            raise StateError(f"drive {self.drive}: its table of {len(raw.plus)} points is none to correct by")
        own.enabled = on

    def applied(self) -> int:
        return self.own.shown()
