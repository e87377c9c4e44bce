"""The sealed store: an axis's compensation as a file that a machine can use and only its builder can change.

Three entries per axis: `<axis>.tables`, `<axis>.effects` and, where it was measured, `<axis>.lost-motion`. Several axes may share a
file. Reading needs the builder's public key and the reading password; writing needs the builder's private key. A table may have a
password of its own: it is then an entry of its own, such as `<axis>.backlash`, and the header names it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from drivers.errors import InputError, StateError
from drivers.files import read_bytes, replace_file, sync_directory
from hil.correction import TABLES
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.compensation import Compensation
from hil.correction.rise import rise_from_json
from hil.correction.sealed import (
    Binding,
    SealedInfo,
    check,
    check_seen,
    load_private_key,
    load_public_key,
    open_sealed,
    remember,
    require_strong_new,
    reseal,
    seal,
)
from hil.correction.tables import FORMAT, TableSet
from hil.effects import ALL, Effect, Term, term_from_json
from hil.records.files import held, naming, parse_json
from hil.records.made_with import MadeWith, read_made_with
from hil.records.zero import Zero, read_zero

SEPARATE_FORMAT = "hil-tables/1, some apart"
"""Of an entry that lacks those tables: a program that would take them for missing ones refuses it."""


class _Keys(Protocol):
    @property
    def builder_public(self) -> Path: ...

    @property
    def builder_key(self) -> Path: ...


class _Bounded(Protocol):
    @property
    def bound(self) -> CorrectionBound: ...


class LocatesStore(Protocol):
    """The part of an axis file that says where its store is."""

    @property
    def name(self) -> str: ...

    @property
    def tables_path(self) -> Path: ...

    @property
    def store(self) -> _Keys: ...


class StatesStore(LocatesStore, Protocol):
    """The part of an axis file that concerns its store."""

    @property
    def zero_path(self) -> Path: ...

    @property
    def made_with_path(self) -> Path: ...

    @property
    def correction(self) -> _Bounded: ...


@dataclass(frozen=True)
class SealedStore:
    """The store of one axis's compensation.

    password: opens this axis's entries, but for the tables in `own`, by name (`TABLES`), which have passwords of their own
    builder_public: verifies the signature; builder_key: needed for saving
    bound: of the axis, a correction beyond it is neither saved nor loaded
    zero_path, made_with_path: of the axis's zero and the drive's parameters (`hil.records`), to which the contents are bound
    """

    path: Path
    axis: str
    password: str
    builder_public: Ed25519PublicKey
    builder_key: Ed25519PrivateKey | None = None
    bound: CorrectionBound = field(default=CAREFUL, kw_only=True)
    zero_path: Path | None = field(default=None, kw_only=True)
    made_with_path: Path | None = field(default=None, kw_only=True)
    own: Mapping[str, str] = field(default_factory=dict, kw_only=True)

    @classmethod
    def of(
        cls,
        axis: StatesStore,
        password: str,
        key_password: str | None = None,
        *,
        own: Mapping[str, str] = MappingProxyType({}),
    ) -> SealedStore:
        """The store an axis file names; with `key_password`, the builder's, it can be written. own: passwords of single tables;
        password: "" to take the axis's tables out of force only.

        Raises InputError when a key is missing or no half of a pair, WrongPasswordError for the key's password, and, where a store is
        to be written, the SealedError that says why the one there now is not this builder's, and InputError for a new password that is
        too weak (`require_strong`).
        """
        config = axis.store
        of_axis: dict[str, Any] = {
            "bound": axis.correction.bound,
            "zero_path": axis.zero_path,
            "made_with_path": axis.made_with_path,
            "own": own,
        }
        if unknown := [name for name in own if name not in TABLES]:
            raise InputError(f"a password is given for table {unknown[0]}, expected one of {', '.join(TABLES)}")
        if key_password is None:
            public = load_public_key(config.builder_public)
            return replace(cls(axis.tables_path, axis.name, password, public), **of_axis)
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
        store = replace(cls(axis.tables_path, axis.name, password, public, key), **of_axis)
        if password:
            store._check_passwords(read_bytes(store.path) if store.path.exists() else None)
        return store

    @property
    def seen_path(self) -> Path:
        """The note of the file that the axis used last (`sealed.seen`)."""
        return self.path.with_name(f"{self.axis}.seen.json")

    def accept(self) -> SealedInfo:
        """The builder's word that the present file is the axis's, whatever was used before.

        Raises StateError without the builder's key, and the SealedError that says why the file is not this builder's.
        """
        if self.builder_key is None:
            raise StateError(f"{self.path} is locked: accepting it needs the builder's private key")
        with held(self.path.parent, wait=True), naming(self.path):
            info = check(read_bytes(self.path), self.builder_key.public_key())
            remember(self.seen_path, info)
            return info

    @property
    def _names(self) -> tuple[str, str]:
        return f"{self.axis}.tables", f"{self.axis}.effects"

    def _passwords(self, names: Iterable[str]) -> dict[str, str]:
        """By entry; the axis's common password but for tables with one of their own."""
        own = {f"{self.axis}.{table}": password for table, password in self.own.items()}
        return {name: own.get(name, self.password) for name in names}

    def _check_passwords(self, present: bytes | None) -> None:
        """Raises InputError for a new password that is too weak, or where a table's own one is not given."""
        if present is not None:
            self._require_own(self._bound(present).separate)
        names = [self._names[0], *(f"{self.axis}.{table}" for table in self.own)]
        require_strong_new(self._passwords(names), present, self.builder_public)

    def _require_own(self, separate: Iterable[str]) -> None:
        if lacking := [table for table in separate if table not in self.own]:
            raise InputError(
                f"{self.path}: table {lacking[0]} of axis {self.axis} has a password of its own (--table-password {lacking[0]}=FILE)"
            )

    def _require_tables(self, entries: Iterable[str]) -> None:
        """Raises InputError where the file has only what other axes have there."""
        if self._names[0] not in entries:
            others = ", ".join(sorted({name.partition(".")[0] for name in entries}))
            raise InputError(f"holds no tables of axis {self.axis}, only of {others}: hil calibrate makes them")

    @property
    def _rise_name(self) -> str:
        return f"{self.axis}.lost-motion"

    def _rise_entry(self, data: bytes, builder_public: Ed25519PublicKey) -> tuple[str, ...]:
        """The entry's name where the file has one."""
        return tuple(name for name in check(data, builder_public).entries if name == self._rise_name)

    def save(self, compensation: Compensation, *, measured: bool = True) -> None:
        """Replace this axis's entries as a whole, others in the file kept.

        measured: made on the machine, so that what the drive had at the last measurement is what it was made with, unless it states it

        Raises StateError without the builder's key, CorrectionBoundError for a correction beyond the axis's bound, ReplacedError where
        the present file is not the one used before or a later one.
        """
        if self.builder_key is None:
            raise StateError(f"{self.path} is locked: changing it needs the builder's private key")
        compensation.check(self.bound, f"{self.path}: correction not stored")
        tables, effects = self._names
        form = compensation.tables.to_dict()
        changes = {f"{self.axis}.{table}": _dump(form[table]) for table in self.own}
        form |= {"format": SEPARATE_FORMAT, **dict.fromkeys(self.own)} if self.own else {}
        changes |= {tables: _dump(form), effects: _dump(_terms(compensation))}
        rise = {self._rise_name: _dump(_rise(compensation))}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with held(self.path.parent, wait=True):  # another axis may be about to change its own entries
            if self.path.exists():
                with naming(self.path):
                    before = read_bytes(self.path)
                    self._check_passwords(before)
                    there = self._rise_entry(before, self.builder_key.public_key())
                    changes |= rise if there or compensation.rise is not None else {}
                    info = check(before, self.builder_key.public_key())
                    check_seen(self.seen_path, info)
                    bound_to = self._bound_to(info.binding, compensation, measured)
                    data = reseal(before, changes, self._passwords(changes), self.builder_key, bound_to=bound_to)
            else:
                changes |= rise if compensation.rise is not None else {}
                self._check_passwords(None)
                bound_to = self._bound_to(None, compensation, measured)
                data = seal(changes, self._passwords(changes), self.builder_key, bound_to=bound_to)
            replace_file(self.path, data)
            remember(self.seen_path, check(data, self.builder_key.public_key()))

    def _bound_to(self, before: Binding | None, compensation: Compensation, measured: bool) -> dict[str, Any]:
        """This axis's entries to the zero that the axis has now and to the drive's parameters, the other axes' as they were."""
        of: Mapping[str, Any] = {} if before is None else before.of
        axes = dict(of.get("axes", {}))
        zero = None if self.zero_path is None else read_zero(self.zero_path)
        made_with = compensation.made_with
        if made_with is None and measured and self.made_with_path is not None:
            made_with = read_made_with(self.made_with_path)
        axes[self.axis] = {
            "zero": None if zero is None else zero.to_json(),
            "made_with": None if made_with is None else made_with.to_json(),
            "corrects_reversal": compensation.corrects_reversal,
        }
        if self.own:
            axes[self.axis]["separate"] = sorted(self.own)
        return {**of, "axes": axes}

    def _bound(self, data: bytes) -> BoundTables:
        return _bound(check(data, self.builder_public).binding, self.axis)

    def states(self) -> BoundTables | None:
        """What the present file states of this axis's tables; None without a file, or tables of the axis in it."""
        return _bound_in(self.path, self.axis, self.builder_public)

    def warning(self) -> str | None:
        """A warning about the present file, which can be opened nevertheless; None for no warning, or no file."""
        if not self.path.exists():
            return None
        with naming(self.path):
            found = self._bound(read_bytes(self.path))
        if found.zero is not None:
            return found.warning(f"{self.path}: ")
        return (
            f"{self.path}: states no zero of axis {self.axis}, its tables were made before, or without, one: that the axis is in the"
            " same cannot be shown (calibrate again to bind them)"
        )

    def withdraw(self) -> BoundTables:
        """Take this axis's entries out of the file, which puts its tables out of force; others in the file are kept. What they stated.

        Without other entries there is no file afterwards. Raises StateError without the builder's key, and where there are none.
        """
        if self.builder_key is None:
            raise StateError(f"{self.path} is locked: changing it needs the builder's private key")
        nothing = StateError(f"{self.path}: holds no tables of axis {self.axis}, nothing is in force")
        if not self.path.exists():
            raise nothing
        with held(self.path.parent, wait=True), naming(self.path):
            data = read_bytes(self.path)
            present = check(data, self.builder_key.public_key())
            check_seen(self.seen_path, present)
            ours = {
                *self._names,
                self._rise_name,
                *(f"{self.axis}.{table}" for table in TABLES),
            } & present.entries.keys()
            if not ours:
                raise nothing
            of: Mapping[str, Any] = {} if present.binding is None else present.binding.of
            left = {**of, "axes": {name: bound for name, bound in of.get("axes", {}).items() if name != self.axis}}
            if ours == present.entries.keys():
                number = 0 if present.binding is None else present.binding.counter
                gone = Binding(number + 1, present.binding.date if present.binding else "", {})
                remember(self.seen_path, replace(present, binding=gone))  # that file is not to come back
                self.path.unlink()
                sync_directory(self.path.parent)
            else:
                resealed = reseal(data, {}, {}, self.builder_key, bound_to=left, without=ours)
                replace_file(self.path, resealed)
                remember(self.seen_path, check(resealed, self.builder_key.public_key()))
            return _bound(present.binding, self.axis)

    def stored(self, effects: Sequence[Effect] = ALL) -> Compensation | None:
        """The stored compensation, None where the axis has none. Raises what `load` raises."""
        return None if self.states() is None else self.load(effects)

    def save_tables(self, tables: TableSet) -> None:
        """Replace this axis's entries with tables and no further effects."""
        self.save(Compensation(tables))

    def load(self, effects: Sequence[Effect] = ALL) -> Compensation:
        """The stored compensation. Raises SealedError or InputError, naming the file, where it cannot be opened or verified or is not
        the one used before or a later one (ReplacedError), and CorrectionBoundError where it exceeds the axis's bound."""
        with naming(self.path):
            data = read_bytes(self.path)
            info = check(data, self.builder_public)
            check_seen(self.seen_path, info)
            of = _bound(info.binding, self.axis)
            self._require_own(of.separate)
            self._require_tables(check(data, self.builder_public).entries)
            separate = {table: f"{self.axis}.{table}" for table in of.separate}
            names = [*self._names, *self._rise_entry(data, self.builder_public), *separate.values()]
            opened = open_sealed(data, self._passwords(names), self.builder_public, names=names)
            tables, terms = (_parse(opened[name], name) for name in self._names)
            if separate and isinstance(tables, dict) and tables.get("format") == SEPARATE_FORMAT:
                tables |= {"format": FORMAT, **{table: _parse(opened[name], name) for table, name in separate.items()}}
            rise = _parse(opened.get(self._rise_name, b"null"), self._rise_name)
            if not isinstance(terms, list):
                raise InputError(f"entry {self._names[1]} is not a list of effects")
            loaded = [term_from_json(term, effects, f"{self._names[1]}[{index}]") for index, term in enumerate(terms)]
            parsed = None if rise is None else rise_from_json(rise, self._rise_name)
            compensation = Compensation(
                TableSet.from_dict(tables), tuple(loaded), parsed, zero=of.zero, made_with=of.made_with
            )
        compensation.check(self.bound, f"{self.path}: correction not used")
        return compensation


@dataclass(frozen=True)
class BoundTables:
    """What a sealed file states of one axis's tables without a password; None where it does not state it.

    corrects_reversal: whether they take the reversal out, so that the drive must not do it too; separate: tables with a password of
    their own; lost_motion: whether one is stored beside them
    """

    axis: str
    zero: Zero | None = None
    made_with: MadeWith | None = None
    corrects_reversal: bool | None = None
    separate: tuple[str, ...] = ()
    lost_motion: bool = False

    def warning(self, where: str) -> str | None:
        """That the drive's parameters are not stated, None where they are."""
        if self.made_with is not None:
            return None
        return (
            f"{where}does not state which parameters the drive of axis {self.axis} had when its tables were made: that it has the same"
            " cannot be shown (calibrate again to bind them)"
        )


def bound_tables(axis: LocatesStore) -> BoundTables | None:
    """What the axis's store states of its tables, the builder's signature checked; None where the axis has none.

    Raises SealedError or InputError, naming the file, where the store or the builder's public key cannot be read.
    """
    if not axis.tables_path.exists():
        return None
    return _bound_in(axis.tables_path, axis.name, load_public_key(axis.store.builder_public))


def _bound_in(path: Path, axis: str, builder_public: Ed25519PublicKey) -> BoundTables | None:
    if not path.exists():
        return None
    with naming(path):
        info = check(read_bytes(path), builder_public)
        if f"{axis}.tables" not in info.entries:
            return None
        return replace(_bound(info.binding, axis), lost_motion=f"{axis}.lost-motion" in info.entries)


def _bound(binding: Binding | None, axis: str) -> BoundTables:
    try:
        of = {} if binding is None else dict(binding.of["axes"][axis])
    except (KeyError, TypeError, ValueError):
        of = {}
    try:
        zero, made_with = of.get("zero"), of.get("made_with")
        reversal = of.get("corrects_reversal")
        return BoundTables(
            axis,
            None if zero is None else Zero.from_json(zero),
            None if made_with is None else MadeWith.from_json(made_with),
            reversal if isinstance(reversal, bool) else None,
            tuple(table for table in TABLES if table in of.get("separate", ())),
        )
    except ValueError as error:
        raise InputError(f"header does not say what the tables of axis {axis} belong to") from error


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
        return parse_json(data)
    except ValueError as error:
        raise InputError(f"entry {name} is not JSON") from error
