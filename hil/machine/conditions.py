"""What surrounds an axis and decides its error too: load, other axes' positions, a level on the table.

A procedure may ask for another load or another cross position; who fulfils it - a person, another axis, the bench - is behind this
abstraction. What is there to be read is part of every row.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from drivers.errors import CapabilityError

SET_UP = frozenset({"abbe_offset_mm", "setup"})
"""Changes of the instrument's optics that a person can be asked for at any time; afterwards its zero is another one."""


class Conditions(Protocol):
    """Columns beside the axis's own: which can be set to which levels, and what they read now.

    by_hand: somebody reaches into the machine for it, so that it has to be without power meanwhile
    """

    by_hand: bool

    @property
    def levels(self) -> Mapping[str, Sequence[float]]:
        """Column name -> levels it may be set to, such as {"load_kg": (0, 60, 120)}; empty where nothing can be varied."""

    def set(self, name: str, value: float) -> None:
        """Make a condition so; returns once it is. Raises CapabilityError for a column without levels."""

    def read(self) -> Mapping[str, float]:
        """Columns of this moment, set or measured."""


class NoConditions:
    """Nothing known and nothing to vary."""

    by_hand = False

    @property
    def levels(self) -> Mapping[str, Sequence[float]]:
        return {}

    def set(self, name: str, value: float) -> None:
        raise CapabilityError(f"condition {name} cannot be set to {value:g} here")

    def read(self) -> Mapping[str, float]:
        return {}


class AskedConditions:
    """Conditions that a person brings about: `ask(name, value)` returns once it is done.

    levels: those of the axis file; a change of the set-up (`SET_UP`) can be asked for beside them
    """

    by_hand = True

    def __init__(self, levels: Mapping[str, Sequence[float]], ask: Callable[[str, float], None]) -> None:
        self._levels = {name: tuple(values) for name, values in levels.items()}
        self._ask = ask
        self._now: dict[str, float] = {}

    @property
    def levels(self) -> Mapping[str, Sequence[float]]:
        return self._levels

    def set(self, name: str, value: float) -> None:
        if name not in self._levels and name not in SET_UP:
            raise CapabilityError(f"condition {name} is not in the axis file's [conditions]")
        if self._now.get(name) != value:
            self._ask(name, value)
            self._now[name] = value

    def read(self) -> Mapping[str, float]:
        return dict(self._now)
