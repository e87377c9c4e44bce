"""The protocol of an effect: how a physical cause shows in measurement records, and what to do about it.

What may go in: the values every effect file and the diagnosis share. An effect is linear in its coefficients and, at most, non-linear
in a few bounded parameters: error_um = basis(columns, theta) @ coefficients. It says which *forms* given records allow (which
temperature column, exponential or tanh …), and the diagnosis searches over forms and parameters.

Evaluation is vectorised and causal: a row depends on what is known when its set-point is issued. What depends on the past is
a column of its own (`time_s`, `since_reversal_mm`, `stroke_mm`; `hil.effects.history` makes those that can be made).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from hil.effects.survey import Survey

UM_PER_MM_PPM = 1e-3
"""µm in a mm times a ppm, or a mm times a µrad."""
Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]


class Action(Enum):
    """What follows from a finding."""

    COMPENSATE = "compensate"  # the machine does it and will do it again: add it to the correction
    FIX_SETUP = "fix-setup"  # the instrument or its mount does it: correct the set-up, never the machine
    RE_MEASURE = "re-measure"  # it happened once: measure again


@dataclass(frozen=True)
class Estimate:
    """A value with its standard uncertainty."""

    value: float
    std: float

    def __str__(self) -> str:
        return f"{self.value:.4g} ± {self.std:.2g}"


@dataclass(frozen=True)
class NonLinear:
    """A parameter that the basis depends on non-linearly, with the bounds of what can be."""

    name: str
    lower: float
    upper: float
    logarithmic: bool = True
    """Searched, and its spread stated, in its logarithm."""
    usual: tuple[float, float] | None = None
    """Where it lies beforehand, for records that say little of it: middle, and standard deviation of its logarithm."""

    def log_prior(self, value: float) -> float:
        """Log odds of a value against the usual one; 0 where nothing is known beforehand."""
        if self.usual is None:
            return 0.0
        middle, spread = self.usual
        return -0.5 * (math.log(value / middle) / spread) ** 2


@dataclass(frozen=True)
class Rival:
    """Another effect that can look the same, and the measurement that tells the two apart."""

    effect: str
    separate_by: str


@dataclass(frozen=True)
class Form:
    """One way in which an effect can show in given records.

    effect: id; name: of the variant ('temperature', 'tanh' …)
    inputs: the columns it reads, in the order the effect's basis expects
    constants: fixed numbers of the basis (centre and half span of the travel, a reference temperature …)
    nonlinear: bounded parameters; starts: grid of them to search from, shape (g, len(nonlinear))
    scan: whether it takes part in the first search; the others only refine an effect already found
    exhaustive: the grid holds every parameter value that makes a difference
    shrunk: many columns with one normal prior of unit variance ratio to be scaled, instead of free coefficients
    """

    effect: str
    name: str
    inputs: tuple[str, ...]
    constants: Mapping[str, float] = field(default_factory=dict)
    nonlinear: tuple[NonLinear, ...] = ()
    starts: tuple[tuple[float, ...], ...] = ((),)
    scan: bool = True
    exhaustive: bool = False
    shrunk: bool = False


class Effect(ABC):
    """One cause of error. Stateless; registered in an explicit tuple (`hil.effects.ALL`)."""

    id: ClassVar[str]
    title: ClassVar[str]
    action: ClassVar[Action]
    rivals: ClassVar[tuple[Rival, ...]] = ()
    static: ClassVar[bool] = False
    """A function of position and direction alone, which a table measured after it appeared holds already."""
    log_odds: ClassVar[float] = 0.0
    """Beforehand, against the other effects; it decides where the records cannot."""
    least_over_noise: ClassVar[float] = 0.0
    """RMS, over the noise's standard deviation, below which it is part of the noise and no finding."""

    @abstractmethod
    def forms(self, survey: Survey) -> tuple[Form, ...]:
        """The forms these records allow, the simplest first; empty where the columns are missing or do not vary."""

    @abstractmethod
    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        """Columns of the design matrix, shape (n, k), in µm per unit of each coefficient."""

    def bases(self, form: Form, thetas: Sequence[Sequence[float]], columns: Columns) -> Floats:
        """The bases of many parameters side by side, shape (n, g·k). To be overridden where all at once is quicker."""
        return np.hstack([self.basis(form, theta, columns) for theta in thetas])

    @abstractmethod
    def parameters(self, term: Term) -> dict[str, Estimate]:
        """The fitted parameters under the names people use, each with its standard uncertainty."""

    @abstractmethod
    def explain(self, term: Term) -> str:
        """One sentence: what it is, with figures and units."""

    def is_local(self, form: Form, theta: Sequence[float], survey: Survey) -> bool:
        """Whether with these parameters it is a feature of one place.

        A table that has to hold such a feature comes out rough everywhere, so it is tried beside smoother tables too.
        """
        del form, theta, survey
        return False

    def implausible(self, term: Term) -> str | None:
        """Why no machine does this (sign, range), or None. It lowers the weight of the effect, it does not forbid it."""
        del term
        return None


@dataclass(frozen=True)
class Term:
    """An effect with fitted parameters: what a model holds and the engine evaluates.

    theta: the non-linear parameters, in the order of form.nonlinear
    coefficients: shape (k,); covariance: of (coefficients, theta), shape (k + t, k + t)
    """

    effect: Effect
    form: Form
    theta: tuple[float, ...]
    coefficients: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]

    @property
    def needs(self) -> tuple[str, ...]:
        """The columns it reads."""
        return self.form.inputs

    def error_um(self, columns: Columns) -> Floats:
        """The error the effect causes, µm, shape (n,). Raises InputError when a column is missing or not a number."""
        for name in self.needs:
            if name not in columns:
                raise InputError(f"effect {self.effect.id} needs the column {name}, which is not there")
            if not np.all(np.isfinite(columns[name])):
                raise InputError(f"effect {self.effect.id} needs {name} in every row, but some are empty")
        basis = self.effect.basis(self.form, self.theta, columns)
        return np.asarray(basis @ np.array(self.coefficients), dtype=np.float64)

    @property
    def parameters(self) -> dict[str, Estimate]:
        return self.effect.parameters(self)

    def coefficient(self, index: int, scale: float = 1.0) -> Estimate:
        """One linear coefficient times `scale`."""
        return Estimate(
            self.coefficients[index] * scale, math.sqrt(max(self.covariance[index][index], 0.0)) * abs(scale)
        )

    def nonlinear(self, index: int) -> Estimate:
        """One non-linear parameter; its uncertainty is NaN where the fit gave none."""
        k = len(self.coefficients)
        return Estimate(self.theta[index], math.sqrt(max(self.covariance[k + index][k + index], 0.0)))

    def amplitude(self, i: int, j: int) -> Estimate:
        """hypot of two coefficients, with first-order uncertainty."""
        a, b = self.coefficients[i], self.coefficients[j]
        size = math.hypot(a, b)
        if size == 0.0:
            return Estimate(0.0, math.sqrt(max(self.covariance[i][i], 0.0)))
        c = self.covariance
        variance = (a * a * c[i][i] + 2 * a * b * c[i][j] + b * b * c[j][j]) / size**2
        return Estimate(size, math.sqrt(max(variance, 0.0)))

    def angle(self, i: int, j: int) -> Estimate:
        """atan2(coefficient j, coefficient i) in rad, with first-order uncertainty."""
        a, b = self.coefficients[i], self.coefficients[j]
        size2 = a * a + b * b
        if size2 == 0.0:
            return Estimate(0.0, math.pi)
        c = self.covariance
        variance = (b * b * c[i][i] - 2 * a * b * c[i][j] + a * a * c[j][j]) / size2**2
        return Estimate(math.atan2(b, a), math.sqrt(max(variance, 0.0)))

    def to_json(self) -> dict[str, Any]:
        """Plain values; `term_from_json` reads them."""
        return {
            "effect": self.effect.id,
            "form": self.form.name,
            "inputs": list(self.form.inputs),
            "constants": dict(self.form.constants),
            "nonlinear": {p.name: value for p, value in zip(self.form.nonlinear, self.theta, strict=True)},
            "coefficients": list(self.coefficients),
            "covariance": [list(row) for row in self.covariance],
        }
