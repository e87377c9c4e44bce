"""The sealed store: what is in force on an axis, as a file that a machine can run with and only its builder can change.

Three entries per axis: `<axis>.tables`, `<axis>.effects` and, where it was measured, `<axis>.lost-motion`. Several axes may share a
file. Reading needs the builder's public key and the reading password; writing needs the builder's private key.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from drivers.errors import InputError, StateError
from hil.axis import AxisConfig
from hil.compensation import Compensation
from hil.effects import ALL, Effect, Term, term_from_json
from hil.files import held, naming, read_bytes, replace_file
from hil.lost_motion.shapes import rise_from_json
from hil.sealed import check, load_private_key, load_public_key, open_sealed, reseal, seal
from hil.tables import TableSet


@dataclass(frozen=True)
class SealedStore:
    """Where one axis's compensation is kept.

    password: opens this axis's entries; builder_public: whose signature is believed; builder_key: only where tables are made
    """

    path: Path
    axis: str
    password: str
    builder_public: Ed25519PublicKey
    builder_key: Ed25519PrivateKey | None = None

    @classmethod
    def of(cls, axis: AxisConfig, password: str, key_password: str | None = None) -> SealedStore:
        """The store an axis file names; with `key_password`, the builder's, it can be written.

        Raises InputError when a key is missing or no half of a pair, WrongPasswordError for the key's password, and, where a store is
        to be written, the SealedError that says why the one there now is not this builder's.
        """
        config = axis.store
        if key_password is None:
            return cls(axis.tables_path, axis.name, password, load_public_key(config.builder_public))
        if not config.builder_key.exists():
            raise InputError(
                "is not there; tables are stored sealed, `hil sign --new-key builder` makes the builder's pair of keys",
                path=config.builder_key,
            )
        key = load_private_key(config.builder_key, key_password)
        public = key.public_key()
        if config.builder_public.exists():
            stated = load_public_key(config.builder_public)
            if stated.public_bytes_raw() != public.public_bytes_raw():
                raise InputError(f"is not the public half of {config.builder_key}", path=config.builder_public)
        if axis.tables_path.exists():  # said now, not after hours of measuring
            with naming(axis.tables_path):
                check(read_bytes(axis.tables_path), public)
        return cls(axis.tables_path, axis.name, password, public, key)

    @property
    def _names(self) -> tuple[str, str]:
        return f"{self.axis}.tables", f"{self.axis}.effects"

    @property
    def _rise_name(self) -> str:
        return f"{self.axis}.lost-motion"

    def _rise_entry(self, data: bytes, builder_public: Ed25519PublicKey) -> tuple[str, ...]:
        """The entry's name where the file has one."""
        return tuple(name for name in check(data, builder_public).entries if name == self._rise_name)

    def save(self, compensation: Compensation) -> None:
        """Replace this axis's entries as a whole, others in the file kept. Raises StateError without the builder's key."""
        if self.builder_key is None:
            raise StateError(f"{self.path} is locked: changing it needs the builder's private key")
        tables, effects = self._names
        changes = {tables: _dump(compensation.tables.to_dict()), effects: _dump(_terms(compensation))}
        rise = {self._rise_name: _dump(_rise(compensation))}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with held(self.path.parent, wait=True):  # another axis may be about to change its own entries
            if self.path.exists():
                with naming(self.path):
                    before = read_bytes(self.path)
                    there = self._rise_entry(before, self.builder_key.public_key())
                    changes |= rise if there or compensation.rise is not None else {}
                    data = reseal(before, changes, self.password, self.builder_key)
            else:
                changes |= rise if compensation.rise is not None else {}
                data = seal(changes, self.password, self.builder_key)
            replace_file(self.path, data)

    def save_tables(self, tables: TableSet) -> None:
        """Replace this axis's entries with tables and no further effects."""
        self.save(Compensation(tables))

    def load(self, effects: Sequence[Effect] = ALL) -> Compensation:
        """What was saved last. Raises the SealedError or InputError that says why it cannot be believed, naming the file."""
        with naming(self.path):
            data = read_bytes(self.path)
            names = [*self._names, *self._rise_entry(data, self.builder_public)]
            opened = open_sealed(data, self.password, self.builder_public, names=names)
            tables, terms = (_parse(opened[name], name) for name in self._names)
            rise = _parse(opened.get(self._rise_name, b"null"), self._rise_name)
            if not isinstance(terms, list):
                raise InputError(f"entry {self._names[1]} is not a list of effects")
            loaded = [term_from_json(term, effects, f"{self._names[1]}[{index}]") for index, term in enumerate(terms)]
            parsed = None if rise is None else rise_from_json(rise, self._rise_name)
            return Compensation(TableSet.from_dict(tables), tuple(loaded), parsed)


def compensation_in_force(compensation: Compensation) -> dict[str, Any]:
    """By what a campaign names it: rows measured with another one do not belong to the same."""
    form: dict[str, Any] = {"tables": compensation.tables.digest(), "effects": _terms(compensation)}
    return form if compensation.rise is None else {**form, "lost_motion": _rise(compensation)}


def _rise(compensation: Compensation) -> dict[str, Any] | None:
    return None if compensation.rise is None else compensation.rise.to_json()


def _terms(compensation: Compensation) -> list[dict[str, Any]]:
    forms = []
    for term in compensation.terms:
        if not isinstance(term, Term):
            raise TypeError(f"{type(term).__name__} is no fitted effect and cannot be stored")
        forms.append(term.to_json())
    return forms


def _dump(value: object) -> bytes:
    return json.dumps(value, sort_keys=True, allow_nan=False).encode()


def _parse(data: bytes, name: str) -> Any:
    try:
        return json.loads(data)
    except ValueError as error:
        raise InputError(f"entry {name} is not JSON") from error
