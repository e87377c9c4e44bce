"""Reads a fitted term from a model or sealed file: plain values in, a `Term` out, a one-line error for anything else.

A file is data: it names an effect by its id, and only loaded effects are known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.errors import InputError
from hil.effects.base import Effect, Form, NonLinear, Term
from hil.effects.non_parametric import NonParametric

NEVER_SEARCHED: tuple[Effect, ...] = (NonParametric(),)
"""Effects that every reader knows and no search uses: a model holds one only where it was asked for."""
LOADED_BY = "--effects FILE.py, or the package that brings it installed"


def term_from_json(obj: object, effects: Sequence[Effect], where: str) -> Term:
    """A term from plain values. Raises InputError naming `where` for a missing or extra key, an effect not in
    `effects`, or values that do not fit its form.
    """
    if not isinstance(obj, dict):
        raise InputError(f"{where} is not an object")
    expected = {"effect", "form", "inputs", "constants", "nonlinear", "coefficients", "covariance"}
    if set(obj) != expected:
        raise InputError(f"{where} has the keys {sorted(obj)}, expected {sorted(expected)}")
    known = {effect.id: effect for effect in (*NEVER_SEARCHED, *effects)}
    if not isinstance(obj["effect"], str) or obj["effect"] not in known:
        raise InputError(
            f"{where} names the effect {obj['effect']!r}, which is not loaded; one of your own needs {LOADED_BY}"
        )
    coefficients = numbers(obj["coefficients"], f"{where}.coefficients")
    constants = _named_numbers(obj["constants"], f"{where}.constants")
    nonlinear = _named_numbers(obj["nonlinear"], f"{where}.nonlinear")
    inputs = obj["inputs"]
    if not isinstance(inputs, list) or not all(isinstance(name, str) for name in inputs):
        raise InputError(f"{where}.inputs is not a list of column names")
    covariance = obj["covariance"]
    size = len(coefficients) + len(nonlinear)
    if not isinstance(covariance, list) or len(covariance) != size:
        raise InputError(f"{where}.covariance is not {size} × {size}")
    rows = tuple(numbers(row, f"{where}.covariance") for row in covariance)
    if any(len(row) != size for row in rows):
        raise InputError(f"{where}.covariance is not {size} × {size}")
    form = Form(
        effect=obj["effect"],
        name=str(obj["form"]),
        inputs=tuple(inputs),
        constants=constants,
        nonlinear=tuple(NonLinear(name, -math.inf, math.inf) for name in nonlinear),
    )
    term = Term(known[obj["effect"]], form, tuple(nonlinear.values()), coefficients, rows)
    _try_out(term, where)
    return term


def _try_out(term: Term, where: str) -> None:
    """Evaluates one row of ones: this shows a form that the effect does not know, or a wrong number of coefficients."""
    columns = {name: np.ones(1) for name in term.form.inputs}
    try:
        width = term.effect.basis(term.form, term.theta, columns).shape[1]
    except (KeyError, IndexError, ValueError) as error:
        raise InputError(f"{where}: effect {term.effect.id} does not know the form {term.form.name!r}") from error
    if width != len(term.coefficients):
        raise InputError(f"{where}: {len(term.coefficients)} coefficients, form {term.form.name!r} has {width}")


def numbers(obj: object, where: str) -> tuple[float, ...]:
    """A list of finite numbers, shape (n,). Raises InputError naming `where` for anything else."""
    if not isinstance(obj, list):
        raise InputError(f"{where} is not a list")
    for value in obj:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise InputError(f"{where} holds {value!r}, expected a finite number")
    return tuple(float(value) for value in obj)


def _named_numbers(obj: object, where: str) -> dict[str, float]:
    if not isinstance(obj, dict):
        raise InputError(f"{where} is not an object")
    return dict(zip(obj, numbers(list(obj.values()), where), strict=True))
