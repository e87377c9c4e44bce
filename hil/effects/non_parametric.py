"""A smooth function of columns without a physical cause, put into a model only on request.

It is not in the catalogue and never searched for: the diagnosis builds its form from a structure that it found and
cannot explain.

A column c is first scaled to v in -1 … 1 by its spread; P1 … P4 are the Legendre polynomials of v, d the direction.

  one column         P1(a) … P4(a)
  … with direction   P1(a) … P3(a), and the same times d
  two columns        P1 … P3 of each (none of the position, which the table holds), P1(a)P1(b), P2(a)P1(b), P1(a)P2(b),
  P2(a)P2(b)
  … with direction   and d·P1(a)P1(b), d·P1(a), d·P1(b)
  fine position      piecewise linear between nodes along the travel, closer than the table's nodes; or those times d

Every column is clipped to the range that was measured; nothing is extrapolated.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, Term
from hil.effects.survey import Survey

ONE, TWO, FINE = "one column", "two columns", "fine position"
WITH_DIRECTION = ", with direction"
NAMES = frozenset(kind + with_direction for kind in (ONE, TWO, FINE) for with_direction in ("", WITH_DIRECTION))
CAUSE_UNKNOWN = "the cause is unknown"
MIDDLE = (0.01, 0.99)
"""Quantiles of a column that become -1 and 1."""
BEYOND = 1.2
"""Limit of v: values outside ±`BEYOND` are clipped."""
MOST_PLACES = 1000
GRID = {ONE: 401, TWO: 41, FINE: 2001}
"""Points per column at which the smallest and the largest value are looked for."""


class NonParametric(Effect):
    """error_um = basis @ coefficients, a smooth function of one or two columns (see the module), each coefficient in
    µm.
    """

    id: ClassVar[str] = "non_parametric"
    title: ClassVar[str] = "a smooth function of columns, its cause unknown"
    action: ClassVar[Action] = Action.COMPENSATE

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        """None: it is never part of a search. See `smooth_form` and `fine_form`."""
        del survey
        return ()

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        if form.name not in NAMES:
            raise KeyError(form.name)
        names = _regressors(form)
        if form.name.startswith(FINE):
            first_mm, last_mm, places = (form.constants[name] for name in ("first_mm", "last_mm", "places"))
            if not (2 <= places <= MOST_PLACES and first_mm < last_mm):
                raise ValueError(f"{places:g} places from {first_mm:g} to {last_mm:g} mm")
            hats = _hats(_measured(names[0], form.constants, columns), first_mm, last_mm, int(places))
            return hats * columns["direction"][:, None] if form.name.endswith(WITH_DIRECTION) else hats
        polynomials = [powers(name, form.constants, columns) for name in names]
        d = columns["direction"][:, None] if form.name.endswith(WITH_DIRECTION) else None
        return _of_one(polynomials[0], d) if form.name.startswith(ONE) else _of_two(names, polynomials, d)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        """The smallest and the largest value over the ranges that were measured, µm."""
        basis = self.basis(term.form, (), _measured_grid(term.form))
        values = basis @ np.array(term.coefficients)
        found = {}
        for name, place in (("smallest_um", np.argmin(values)), ("largest_um", np.argmax(values))):
            row = basis[int(place)]
            variance = float(row @ np.array(term.covariance) @ row)
            found[name] = Estimate(float(values[int(place)]), float(np.sqrt(max(variance, 0.0))))
        return found

    def explain(self, term: Term) -> str:
        low, high = self.parameters(term).values()
        ranges = [
            f"{name} ({term.form.constants[f'{name}.least']:.4g} to {term.form.constants[f'{name}.most']:.4g})"
            for name in _regressors(term.form)
        ]
        if term.form.name.endswith(WITH_DIRECTION):
            ranges.append("direction")
        return (
            f"An error that follows {' and '.join(ranges)}: {CAUSE_UNKNOWN}. It is a smooth function with no physics in it, from"
            f" {low} to {high} µm; beyond the ranges measured it stays as it is at their ends."
        )


def spread_of(name: str, columns: Columns) -> dict[str, float]:
    """Constants of a column, shape (n,), in its own unit: the values scaled to -1 and 1, and the range that was
    measured.
    """
    low, high = np.quantile(columns[name], MIDDLE)
    return {f"{name}.low": float(low), f"{name}.high": float(high)} | _range(name, columns)


def smooth_form(names: Sequence[str], spreads: Sequence[Mapping[str, float]], *, with_direction: bool) -> Form:
    """The form of a smooth function of one or two columns with these spreads (`spread_of`), with or without the
    direction.
    """
    constants = {name: value for spread in spreads for name, value in spread.items()}
    kind = ONE if len(names) == 1 else TWO
    return _form(kind, names, constants, with_direction=with_direction)


def fine_form(first_mm: float, last_mm: float, places: int, columns: Columns, *, with_direction: bool) -> Form:
    """The form of a piecewise linear function of position between `places` evenly spaced nodes from first_mm to
    last_mm.
    """
    constants = {"first_mm": first_mm, "last_mm": last_mm, "places": float(places)} | _range("target_mm", columns)
    return _form(FINE, ("target_mm",), constants, with_direction=with_direction)


def powers(name: str, constants: Mapping[str, float], columns: Columns) -> Floats:
    """Legendre polynomials 1 to 4 of a column scaled to -1 … 1 by its spread, outliers clipped, shape (n, 4)."""
    low, high = constants[f"{name}.low"], constants[f"{name}.high"]
    v = (2 * _measured(name, constants, columns) - low - high) / max(high - low, 1e-300)
    return np.asarray(np.polynomial.legendre.legvander(np.clip(v, -BEYOND, BEYOND), 4)[:, 1:])


def without_cause(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Those of some terms whose cause is unknown."""
    return tuple(term for term in terms if term.effect.id == NonParametric.id)


def _form(kind: str, names: Sequence[str], constants: Mapping[str, float], *, with_direction: bool) -> Form:
    inputs = (*names, "direction") if with_direction else tuple(names)
    return Form(NonParametric.id, kind + (WITH_DIRECTION if with_direction else ""), inputs, constants)


def _range(name: str, columns: Columns) -> dict[str, float]:
    return {f"{name}.least": float(np.min(columns[name])), f"{name}.most": float(np.max(columns[name]))}


def _measured(name: str, constants: Mapping[str, float], columns: Columns) -> Floats:
    """A column clipped to the range that was measured."""
    return np.clip(columns[name], constants[f"{name}.least"], constants[f"{name}.most"])


def _regressors(form: Form) -> tuple[str, ...]:
    """The columns other than the direction."""
    return form.inputs[:-1] if form.name.endswith(WITH_DIRECTION) else form.inputs


def _of_one(p: Floats, d: Floats | None) -> Floats:
    return p if d is None else np.hstack([p[:, :3], p[:, :3] * d])


def _of_two(names: Sequence[str], polynomials: Sequence[Floats], d: Floats | None) -> Floats:
    a, b = polynomials
    mains = [p[:, :3] for name, p in zip(names, polynomials, strict=True) if name != "target_mm"]
    products = [a[:, :1] * b[:, :1], a[:, 1:2] * b[:, :1], a[:, :1] * b[:, 1:2], a[:, 1:2] * b[:, 1:2]]
    with_direction = [] if d is None else [a[:, :1] * b[:, :1] * d, a[:, :1] * d, b[:, :1] * d]
    return np.hstack([*mains, *products, *with_direction])


def _hats(x_mm: Floats, first_mm: float, last_mm: float, places: int) -> Floats:
    """Hat functions: 1 at one node and 0 at the others, linear between, shape (n, places)."""
    away_mm = np.abs(x_mm[:, None] - np.linspace(first_mm, last_mm, places))
    return np.asarray(np.maximum(0.0, 1.0 - away_mm * (places - 1) / (last_mm - first_mm)))


def _measured_grid(form: Form) -> dict[str, Floats]:
    """Rows on a grid over the measured ranges, in both directions."""
    names = _regressors(form)
    count = next(count for kind, count in GRID.items() if form.name.startswith(kind))
    along = [np.linspace(form.constants[f"{n}.least"], form.constants[f"{n}.most"], count) for n in names]
    rows = np.array([(*place, d) for place in itertools.product(*along) for d in (1.0, -1.0)])
    return dict(zip((*names, "direction"), rows.T, strict=True))
