"""The fitted model of an axis: a pitch table per direction, plus the effects that a table cannot hold.

Fitting is in `hil.diagnosis`. A model file is data and names no code.

Signs: `error_um` is the error of the uncorrected machine (actual - commanded), `correction_um` = -error is added to the
command.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.errors import InputError
from hil.effects import ALL, Effect, Term, term_from_json
from hil.effects.history import complete
from hil.effects.reading import numbers
from hil.records.files import parse_json

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]

FORMAT = "hil-model"
VERSION = 1


@dataclass(frozen=True)
class PitchTable:
    """Error of the machine at positions, per direction of arrival; linear between nodes, the end value beyond them.

    positions_mm: (m,), strictly ascending; forward_um, backward_um: (m,), direction +1 and -1
    nodes: indices of those positions that carry the uncertainty (the others are interpolated between them)
    covariance_um2: of (forward at nodes, backward at nodes), shape (2k, 2k); empty where it is not known
    Raises InputError for positions that do not ascend, or lengths that do not agree.
    """

    positions_mm: tuple[float, ...]
    forward_um: tuple[float, ...]
    backward_um: tuple[float, ...]
    nodes: tuple[int, ...] = ()
    covariance_um2: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        m = len(self.positions_mm)
        if m == 0 or np.any(np.diff(self.positions_mm) <= 0):
            raise InputError("table.positions_mm must hold at least one position, strictly ascending")
        for name in ("forward_um", "backward_um"):
            if len(getattr(self, name)) != m:
                raise InputError(f"table.{name} has {len(getattr(self, name))} values for {m} positions")
        if any(not 0 <= node < m for node in self.nodes):
            raise InputError("table.nodes names a position that is not there")
        size = 2 * len(self.nodes)
        if self.covariance_um2 and (
            len(self.covariance_um2) != size or any(len(row) != size for row in self.covariance_um2)
        ):
            raise InputError(f"table.covariance_um2 is not {size} × {size}")

    @classmethod
    def of(cls, positions_mm: ArrayLike, forward_um: ArrayLike, backward_um: ArrayLike) -> PitchTable:
        """From array-likes of shape (m,), mm and µm. Raises InputError as the class does."""
        positions, forward, backward = (
            tuple(float(v) for v in np.asarray(a).ravel()) for a in (positions_mm, forward_um, backward_um)
        )
        return cls(positions, forward, backward)

    def error_um(self, target_mm: Floats, direction: Floats) -> Floats:
        """Error at targets (mm) arrived at in a direction (+1, -1), both shape (n,): µm, shape (n,)."""
        forward = np.interp(target_mm, self.positions_mm, self.forward_um)
        backward = np.interp(target_mm, self.positions_mm, self.backward_um)
        return np.asarray(np.where(direction > 0, forward, backward), dtype=np.float64)

    def to_json(self) -> dict[str, Any]:
        """The table of a model file."""
        return {
            "positions_mm": list(self.positions_mm),
            "forward_um": list(self.forward_um),
            "backward_um": list(self.backward_um),
            "nodes": list(self.nodes),
            "covariance_um2": [list(row) for row in self.covariance_um2],
        }


@dataclass(frozen=True)
class Model:
    """The error of an axis as it was fitted.

    table: the bidirectional pitch table; terms: the effects beside it
    about: origin of the model (plain strings and numbers for people; never read by the program)
    """

    table: PitchTable
    terms: tuple[Term, ...] = ()
    about: Mapping[str, str | int | float] = field(default_factory=dict)

    @property
    def needs(self) -> frozenset[str]:
        """Columns the terms read beyond target and direction."""
        return frozenset(name for term in self.terms for name in term.needs) - {"target_mm", "direction"}

    @property
    def declared(self) -> list[str]:
        """The parts: 'pitch_table' and the effect ids."""
        return ["pitch_table", *dict.fromkeys(term.effect.id for term in self.terms)]

    def error_um(self, columns: Columns) -> Floats:
        """Error of the uncorrected machine, µm, shape (n,), from `target_mm`, `direction` and what the terms need.

        History columns that are missing are estimated from the rows where `run` is there
        (`hil.effects.history.complete`). Raises InputError when another column is missing.
        """
        if "run" in columns:
            columns = complete(columns)
        error = self.table.error_um(columns["target_mm"], columns["direction"])
        for term in self.terms:
            error = error + term.error_um(columns)
        return error

    def correction_um(self, columns: Columns) -> Floats:
        """The amount to add to the command, µm, shape (n,). Raises InputError as `error_um`."""
        return -self.error_um(columns)

    def with_terms(self, terms: Sequence[Term]) -> Model:
        """A copy with other effects beside the same table."""
        return replace(self, terms=tuple(terms))

    def to_json(self) -> str:
        """The text of a model file; the same model gives the same text."""
        obj = {
            "format": FORMAT,
            "version": VERSION,
            "about": dict(self.about),
            "table": self.table.to_json(),
            "terms": [term.to_json() for term in self.terms],
        }
        return json.dumps(obj, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str, path: str | Path = "model", effects: Sequence[Effect] = ALL) -> Model:
        """Read a model file's text. Raises InputError naming path, key and what was expected."""
        try:
            obj = parse_json(text)
        except ValueError as error:
            line = error.lineno if isinstance(error, json.JSONDecodeError) else None
            raise InputError(f"is not a model file: {getattr(error, 'msg', error)}", path=path, line=line) from error
        try:
            return cls._parse(obj, effects)
        except InputError as error:
            raise InputError(error.what, path=path) from error

    @classmethod
    def _parse(cls, obj: object, effects: Sequence[Effect]) -> Model:
        if not isinstance(obj, dict) or obj.get("format") != FORMAT:
            raise InputError(f'is not a model file: expected "format": "{FORMAT}"')
        if obj.get("version") != VERSION:
            raise InputError(f"is of version {obj.get('version')!r}, expected {VERSION}")
        expected = {"format", "version", "about", "table", "terms"}
        if set(obj) != expected:
            raise InputError(f"has the keys {sorted(obj)}, expected {sorted(expected)}")
        about, terms = obj["about"], obj["terms"]
        if not isinstance(about, dict) or not all(isinstance(v, (str, int, float)) for v in about.values()):
            raise InputError("about is not an object of plain values")
        if not isinstance(terms, list):
            raise InputError("terms is not a list")
        parsed = tuple(term_from_json(term, effects, f"terms[{i}]") for i, term in enumerate(terms))
        return cls(_parse_table(obj["table"]), parsed, about)


def _parse_table(obj: object) -> PitchTable:
    expected = {"positions_mm", "forward_um", "backward_um", "nodes", "covariance_um2"}
    if not isinstance(obj, dict) or set(obj) != expected:
        raise InputError(f"table must be an object with the keys {sorted(expected)}")
    rows = obj["covariance_um2"]
    nodes = numbers(obj["nodes"], "table.nodes")
    if not isinstance(rows, list):
        raise InputError("table.covariance_um2 is not a list")
    if any(node != int(node) for node in nodes):
        raise InputError("table.nodes holds a number that is not whole")
    return PitchTable(
        numbers(obj["positions_mm"], "table.positions_mm"),
        numbers(obj["forward_um"], "table.forward_um"),
        numbers(obj["backward_um"], "table.backward_um"),
        tuple(int(node) for node in nodes),
        tuple(numbers(row, "table.covariance_um2") for row in rows),
    )
