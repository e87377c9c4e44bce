"""The correction table that a simulated drive holds and applies itself, in its own units, in whole numbers as firmware does.

The contents, their value at a position, and the stage between servo and shaft that adds it. The faces define how the contents are
shown on a wire.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

_FINE = 256  # number of steps into which the firmware divides one of the table's
_HYSTERESIS_COUNTS = 2.0  # a demand that comes back by less has not reversed
_SETTLE_S = 0.02  # time in which the largest value comes into force at standstill


@dataclass(frozen=True)
class TableForm:
    """The form of a table.

    place_counts, value_counts: motor counts per raw position and per raw value. explicit: a position for each value,
    else origin and step. stepped: a value holds up to the next node. zero_outside: nothing is added beyond the ends. curves: two, one
    for each direction, or one. negated: values are errors, their negative is added.
    """

    points: int
    explicit: bool
    place_counts: float = 1.0
    value_counts: float = 1.0
    stepped: bool = False
    zero_outside: bool = False
    curves: int = 2
    negated: bool = False


ARRAY = TableForm(points=200, explicit=False)
"""Two curves of up to 200 equidistant values, all in counts."""


def error_domain(counts_per_um: float) -> TableForm:
    """Up to 2000 nodes in counts with the axis's error in 0.1 µm."""
    return TableForm(points=2000, explicit=True, value_counts=0.1 * counts_per_um, negated=True)


def known_table(name: str, counts_per_um: float) -> TableForm | None:
    """A simulated drive's table by the name of its map, None for another name."""
    return {"simulated_array": ARRAY, "simulated_domain": error_domain(counts_per_um)}.get(name)


@dataclass
class OwnTable:
    """Contents and switch, raw. backlash: amount by which one curve is less for falling demands."""

    form: TableForm
    enabled: bool = False
    places: Sequence[int] = ()
    rising: Sequence[int] = ()
    falling: Sequence[int] = ()
    backlash: int = 0
    added_counts: float = field(default=0.0, init=False)  # added at present, by `TableStage`

    def usable(self) -> bool:
        """Whether the drive accepts it: at least two nodes, ascending, and as many values."""
        curves = (self.rising, self.falling) if self.form.curves == 2 else (self.rising,)
        ascending = all(first < second for first, second in zip(self.places, self.places[1:], strict=False))
        return (
            2 <= len(self.places) <= self.form.points and ascending and all(len(c) == len(self.places) for c in curves)
        )

    def added(self, demand_counts: float, upwards: bool) -> float:
        """The amount added to a demand, motor counts."""
        if not self.enabled:
            return 0.0
        form = self.form
        place = int(demand_counts * _FINE / form.place_counts)
        values = self.rising if upwards or form.curves == 1 else self.falling
        fine = self._between(place, values)
        if form.curves == 1 and not upwards:
            fine -= self.backlash * _FINE
        return (-fine if form.negated else fine) * form.value_counts / _FINE

    def _between(self, place: int, values: Sequence[int]) -> int:
        """The value at this position, in 256ths."""
        places, form = self.places, self.form
        if place < places[0] * _FINE:
            return 0 if form.zero_outside else values[0] * _FINE
        if place >= places[-1] * _FINE:
            beyond = place > places[-1] * _FINE
            return 0 if beyond and form.zero_outside else values[-1] * _FINE
        after = bisect_right(places, place // _FINE)
        low, high = values[after - 1], values[after]
        if form.stepped:
            return low * _FINE
        way = place - places[after - 1] * _FINE
        return low * _FINE + (high - low) * way // (places[after] - places[after - 1])

    def shown(self) -> int:
        """The amount added at present, as the drive shows it: in the table's unit and sign."""
        raw = self.added_counts / self.form.value_counts
        return round(-raw if self.form.negated else raw)


class TableStage:
    """Adds a table to the demand of the shaft; without one it adds nothing.

    The direction is that of the demand, upwards until it first reverses. Without power nothing changes; without a home position
    nothing is corrected.
    """

    def __init__(self) -> None:
        self._table: OwnTable | None = None
        self._upwards = True
        self._furthest: float | None = None
        self._largest = 1.0

    def follow(self, table: OwnTable) -> None:
        """Use the drive's table from now on."""
        self._table = table

    def step(self, demand_counts: Callable[[], float], *, powered: bool, homed: bool, dt_s: float) -> float:
        """The amount added after dt_s seconds at this demand (in the frame that the drive shows), motor counts."""
        table = self._table
        if table is None:
            return 0.0
        demand = demand_counts()
        self._look_where_it_goes(demand)
        if powered:
            wanted = table.added(demand, self._upwards) if homed else 0.0
            self._largest = max(self._largest, abs(wanted))
            most = self._largest * dt_s / _SETTLE_S
            table.added_counts += max(-most, min(most, wanted - table.added_counts))
        return table.added_counts

    def _look_where_it_goes(self, demand: float) -> None:
        if self._furthest is None:
            self._furthest = demand
        gone = demand - self._furthest if self._upwards else self._furthest - demand
        if gone >= 0.0:
            self._furthest = demand
        elif gone <= -_HYSTERESIS_COUNTS:
            self._upwards = not self._upwards
            self._furthest = demand
