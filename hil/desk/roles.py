"""Roles at the desk: an operator measures, a builder also changes locked tables and parameters.

The builder's role requires the builder's key, opened with its password. Passwords are not kept; what they opened is kept in memory
only, while the same person holds control.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from enum import Enum
from typing import Protocol

from drivers.errors import InputError, LocalError
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.correction.sealed import load_private_key
from hil.correction.store import SealedStore


class Role(Enum):
    """Role of the person in control."""

    OPERATOR = "operator"
    BUILDER = "builder"


class LockedError(LocalError):
    """The action needs the builder's role."""


class OpenedStore(Protocol):
    """A sealed store beside the axis's tables, opened for reading or with its own builder's key."""

    @property
    def by_builder(self) -> bool:
        """Whether it was opened with its builder's key."""


class Rights:
    """Role and opened stores of the person in control, for any thread."""

    def __init__(self, axis: DriveAxis) -> None:
        self._axis = axis
        self._lock = threading.Lock()
        self._role = Role.OPERATOR
        self._store: SealedStore | None = None
        self._others: dict[str, OpenedStore] = {}

    @property
    def role(self) -> Role:
        """The present role."""
        return self._role

    @property
    def store(self) -> SealedStore | None:
        """The axis's opened store: for reading, or with the builder's key for writing; None if not opened."""
        return self._store

    def other(self, name: str) -> OpenedStore | None:
        """The opened store of this name; None if not opened."""
        return self._others.get(name)

    def open_other(self, name: str, opening: Callable[[], OpenedStore]) -> None:
        """Open a store beside the axis's. Raises what `opening` raises, as WrongPasswordError."""
        store = opening()
        with self._lock:
            self._others[name] = store

    def read_tables(self, password: str) -> None:
        """Open the tables for reading. Raises WrongPasswordError, and InputError for missing or damaged tables."""
        store = SealedStore.of(self._measured_axis(), password)
        store.load()
        with self._lock:
            if self._role is Role.OPERATOR:
                self._store = store

    def become_builder(self, key_password: str, reading_password: str = "") -> None:
        """Open the builder's key. reading_password: of the tables; without it only jobs that need no tables are possible.

        Raises WrongPasswordError, and InputError where there is no builder's key.
        """
        store: SealedStore | None = None
        if isinstance(self._axis, AxisConfig) and reading_password:
            store = SealedStore.of(self._axis, reading_password, key_password)
            store.stored()
        else:
            key = self._axis.store.builder_key
            if not key.exists():
                raise InputError(
                    "is not there; `hil sign --new-key builder` makes the builder's pair of keys", path=key
                )
            load_private_key(key, key_password)
        with self._lock:
            self._role, self._store = Role.BUILDER, store or self._store

    def forget(self) -> None:
        """Return to the operator's role, with no store opened."""
        with self._lock:
            self._role, self._store = Role.OPERATOR, None
            self._others.clear()

    def require(self, *, locked: bool, store: str = "") -> None:
        """Raises LockedError for a locked change without the builder's role.

        store: name of the other store that is changed, which has a builder's key of its own; "" for the axis's
        """
        is_builder = self._role is Role.BUILDER
        if store:
            opened = self._others.get(store)
            is_builder = opened is not None and opened.by_builder
        if locked and not is_builder:
            raise LockedError(
                "this changes what is locked: it needs the builder, with the password of the builder's key"
            )

    def _measured_axis(self) -> AxisConfig:
        if not isinstance(self._axis, AxisConfig):
            raise InputError("names no instrument, so there are no tables of it", path=self._axis.path)
        return self._axis
