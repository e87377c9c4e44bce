"""What a person at the desk may do: an operator measures, a builder changes what is locked.

The builder's role is the builder's key, really opened with its password. Passwords are used and forgotten; what they opened is kept in
memory for as long as the same person holds control, and nowhere else.
"""

from __future__ import annotations

import threading
from enum import Enum

from drivers.errors import InputError, LocalError
from hil.axis import AxisConfig, DriveAxis
from hil.sealed import load_private_key
from hil.store import SealedStore


class Role(Enum):
    OPERATOR = "operator"
    BUILDER = "builder"


class LockedError(LocalError):
    """Only the builder may do this."""


class Rights:
    """Of whoever holds control at present. For any thread."""

    def __init__(self, axis: DriveAxis) -> None:
        self._axis = axis
        self._lock = threading.Lock()
        self._role = Role.OPERATOR
        self._store: SealedStore | None = None

    @property
    def role(self) -> Role:
        return self._role

    @property
    def store(self) -> SealedStore | None:
        """The axis's sealed store, as far as passwords were given: for reading, or with the builder's key for writing."""
        return self._store

    def read_tables(self, password: str) -> None:
        """Give the tables' reading password. Raises what opening them raises."""
        store = SealedStore.of(self._measured_axis(), password)
        store.load()
        with self._lock:
            if self._role is Role.OPERATOR:
                self._store = store

    def become_builder(self, key_password: str, reading_password: str = "") -> None:
        """Open the builder's key. reading_password: of the tables, without it only what needs no tables can be changed.

        Raises WrongPasswordError, and InputError where there is no builder's key.
        """
        store: SealedStore | None = None
        if isinstance(self._axis, AxisConfig) and reading_password:
            store = SealedStore.of(self._axis, reading_password, key_password)
            if store.path.exists():
                store.load()
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
        """Back to an operator who has given no password."""
        with self._lock:
            self._role, self._store = Role.OPERATOR, None

    def require(self, *, locked: bool) -> None:
        """Raise LockedError where something locked is to be changed by somebody who is not the builder."""
        if locked and self._role is not Role.BUILDER:
            raise LockedError(
                "this changes what is locked: it needs the builder, with the password of the builder's key"
            )

    def _measured_axis(self) -> AxisConfig:
        if not isinstance(self._axis, AxisConfig):
            raise InputError("names no instrument, so there are no tables of it", path=self._axis.path)
        return self._axis
