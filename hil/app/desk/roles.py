"""What a person at the desk may do: an operator measures, a builder changes what is locked.

The builder's role is the builder's key, really opened with its password. Passwords are used and forgotten; what they opened is kept in
memory for as long as the same person holds control, and nowhere else.
"""

from __future__ import annotations

import threading
from enum import Enum

from drivers.errors import InputError, LocalError
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.correction.sealed import load_private_key
from hil.correction.store import SealedStore
from hil.probe.job import opened_store
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.store import RunOutStore


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
        self._probe_store: RunOutStore | None = None

    @property
    def role(self) -> Role:
        return self._role

    @property
    def store(self) -> SealedStore | None:
        """The axis's sealed store, as far as passwords were given: for reading, or with the builder's key for writing."""
        return self._store

    @property
    def probe_store(self) -> RunOutStore | None:
        """The sealed run-out of the machine's probe, as far as passwords were given: for reading, or with its builder's key."""
        return self._probe_store

    def open_probe(self, config: ProbeMachineConfig, reading_password: str, key_password: str = "") -> None:
        """Give the passwords of the probe's run-out, that of its builder's key if it is to be changed. Raises what opening raises."""
        store = opened_store(config, lambda: reading_password, (lambda: key_password) if key_password else None)
        if store.path.exists():
            store.load()
        with self._lock:
            self._probe_store = store

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
            self._role, self._store, self._probe_store = Role.OPERATOR, None, None

    def require(self, *, locked: bool, of_probe: bool = False) -> None:
        """Raise LockedError where something locked is to be changed by somebody who is not the builder.

        of_probe: it is the probe's run-out, which its own builder's key opens.
        """
        opened = self._probe_store
        is_builder = self._role is Role.BUILDER
        if of_probe:
            is_builder = opened is not None and opened.sealing is not None and opened.sealing.builder_key is not None
        if locked and not is_builder:
            raise LockedError(
                "this changes what is locked: it needs the builder, with the password of the builder's key"
            )

    def _measured_axis(self) -> AxisConfig:
        if not isinstance(self._axis, AxisConfig):
            raise InputError("names no instrument, so there are no tables of it", path=self._axis.path)
        return self._axis
