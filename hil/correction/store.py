"""The sealed store: an axis's compensation as a file that a machine can use and only its builder can change.

Three entries per axis: `<axis>.tables`, `<axis>.effects` and, where it was measured, `<axis>.lost-motion`. Several axes may share a
file. Reading needs the builder's public key and the reading password; writing needs the builder's private key.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from drivers.errors import InputError, StateError
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.compensation import Compensation
from hil.correction.rise import rise_from_json
from hil.correction.sealed import Binding, check, load_private_key, load_public_key, open_sealed, reseal, seal
from hil.correction.tables import TableSet
from hil.effects import ALL, Effect, Term, term_from_json
from hil.records.files import held, naming, read_bytes, replace_file
from hil.records.zero import Zero, read_zero


class _Keys(Protocol):
    @property
    def builder_public(self) -> Path: ...

    @property
    def builder_key(self) -> Path: ...


class _Bounded(Protocol):
    @property
    def bound(self) -> CorrectionBound: ...


class StatesStore(Protocol):
    """The part of an axis file that concerns its store."""

    @property
    def name(self) -> str: ...

    @property
    def tables_path(self) -> Path: ...

    @property
    def zero_path(self) -> Path: ...

    @property
    def store(self) -> _Keys: ...

    @property
    def correction(self) -> _Bounded: ...


@dataclass(frozen=True)
class SealedStore:
    """The store of one axis's compensation.

    password: opens this axis's entries; builder_public: verifies the signature; builder_key: needed for saving
    bound: of the axis, a correction beyond it is neither saved nor loaded; zero_path: of the axis's zero (`hil.records.zero`), to
    which the contents are bound
    """

    path: Path
    axis: str
    password: str
    builder_public: Ed25519PublicKey
    builder_key: Ed25519PrivateKey | None = None
    bound: CorrectionBound = field(default=CAREFUL, kw_only=True)
    zero_path: Path | None = field(default=None, kw_only=True)

    @classmethod
    def of(cls, axis: StatesStore, password: str, key_password: str | None = None) -> SealedStore:
        """The store an axis file names; with `key_password`, the builder's, it can be written.

        Raises InputError when a key is missing or no half of a pair, WrongPasswordError for the key's password, and, where a store is
        to be written, the SealedError that says why the one there now is not this builder's.
        """
        config = axis.store
        if key_password is None:
            public = load_public_key(config.builder_public)
            bound = axis.correction.bound
            return cls(axis.tables_path, axis.name, password, public, bound=bound, zero_path=axis.zero_path)
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
        return cls(
            axis.tables_path, axis.name, password, public, key, bound=axis.correction.bound, zero_path=axis.zero_path
        )

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
        """Replace this axis's entries as a whole, others in the file kept.

        Raises StateError without the builder's key, CorrectionBoundError for a correction beyond the axis's bound.
        """
        if self.builder_key is None:
            raise StateError(f"{self.path} is locked: changing it needs the builder's private key")
        compensation.check(self.bound, f"{self.path}: correction not stored")
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
                    bound_to = self._bound_to(check(before, self.builder_key.public_key()).binding)
                    data = reseal(before, changes, self.password, self.builder_key, bound_to=bound_to)
            else:
                changes |= rise if compensation.rise is not None else {}
                data = seal(changes, self.password, self.builder_key, bound_to=self._bound_to(None))
            replace_file(self.path, data)

    def _bound_to(self, before: Binding | None) -> dict[str, Any]:
        """This axis's entries to the zero that the axis has now, the other axes' as they were."""
        of: Mapping[str, Any] = {} if before is None else before.of
        axes = dict(of.get("axes", {}))
        zero = None if self.zero_path is None else read_zero(self.zero_path)
        axes[self.axis] = {"zero": None if zero is None else zero.to_json()}
        return {**of, "axes": axes}

    def _zero(self, data: bytes) -> Zero | None:
        """The zero that this axis's entries are bound to; None where the file names none."""
        binding = check(data, self.builder_public).binding
        try:
            form = None if binding is None else binding.of["axes"][self.axis]["zero"]
            return None if form is None else Zero.from_json(form)
        except (KeyError, TypeError):
            return None
        except ValueError as error:
            raise InputError(f"header does not say what zero axis {self.axis} has") from error

    def warning(self) -> str | None:
        """A warning about the present file, which can be opened nevertheless; None for no warning, or no file."""
        if not self.path.exists():
            return None
        with naming(self.path):
            if self._zero(read_bytes(self.path)) is not None:
                return None
        return (
            f"{self.path}: states no zero of axis {self.axis}, its tables were made before, or without, one: that the axis is in the"
            " same cannot be shown (calibrate anew to bind them)"
        )

    def save_tables(self, tables: TableSet) -> None:
        """Replace this axis's entries with tables and no further effects."""
        self.save(Compensation(tables))

    def load(self, effects: Sequence[Effect] = ALL) -> Compensation:
        """The stored compensation. Raises SealedError or InputError, naming the file, where it cannot be opened or verified, and
        CorrectionBoundError where it exceeds the axis's bound."""
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
            compensation = Compensation(TableSet.from_dict(tables), tuple(loaded), parsed, zero=self._zero(data))
        compensation.check(self.bound, f"{self.path}: correction not used")
        return compensation


def compensation_in_force(compensation: Compensation) -> dict[str, Any]:
    """Identity of a compensation in a campaign: rows measured with different ones do not belong together."""
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
