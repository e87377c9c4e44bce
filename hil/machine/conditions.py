"""Conditions of a measurement that the axis itself does not set: load, positions of other axes, angles of a level on the table.

A procedure sets a condition; an implementation of `Conditions` fulfils it by a person, by another axis or by the bench. The present
values are columns of every row.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from drivers.errors import CapabilityError

SET_UP = frozenset({"abbe_offset_mm", "setup"})
"""Changes of the instrument's optics, made by a person. Each gives the instrument another zero."""


class Conditions(Protocol):
    """Record columns besides the axis's own: the levels each can be set to, and the present values.

    by_hand: a person changes them inside the machine, so that the axis is without power meanwhile.
    """

    by_hand: bool

    @property
    def levels(self) -> Mapping[str, Sequence[float]]:
        """Column name -> levels it may be set to, such as {"load_kg": (0, 60, 120)}; empty where nothing can be varied."""

    def set(self, name: str, value: float) -> None:
        """Bring a condition to a value, in the unit of its column; returns once it is there.

        Raises CapabilityError for a column that cannot be set.
        """

    def read(self) -> Mapping[str, float]:
        """Column name -> present value, set or measured."""


class NoConditions:
    """No condition can be set or read."""

    by_hand = False

    @property
    def levels(self) -> Mapping[str, Sequence[float]]:
        return {}

    def set(self, name: str, value: float) -> None:
        """Raises CapabilityError."""
        raise CapabilityError(f"condition {name} cannot be set to {value:g} here")

    def read(self) -> Mapping[str, float]:
        return {}


class AskedConditions:
    """Conditions that a person sets on request.

    levels: of the axis file; besides these, columns of `SET_UP` can be set. ask(name, value): returns once the person has done it.
    """

    by_hand = True

    def __init__(self, levels: Mapping[str, Sequence[float]], ask: Callable[[str, float], None]) -> None:
        self._levels = {name: tuple(values) for name, values in levels.items()}
        self._ask = ask
        self._now: dict[str, float] = {}

    @property
    def levels(self) -> Mapping[str, Sequence[float]]:
        """Column name -> levels of the axis file."""
        return self._levels

    def set(self, name: str, value: float) -> None:
        """Ask for a value unless it was the last one set. Raises CapabilityError for a column without levels that is not in
        `SET_UP`."""
        if name not in self._levels and name not in SET_UP:
            raise CapabilityError(f"condition {name} is not in the axis file's [conditions]")
        if self._now.get(name) != value:
            self._ask(name, value)
            self._now[name] = value

    def read(self) -> Mapping[str, float]:
        """The values set so far."""
        return dict(self._now)
