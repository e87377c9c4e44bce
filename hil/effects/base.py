"""The protocol of an effect: how a physical cause shows in measurement records, and what to do about it.

An effect is linear in its coefficients and, at most, non-linear in a few bounded parameters:
error_um = basis(columns, theta) @ coefficients. It lists the *forms* that given records allow (which temperature
column, exponential or tanh …); the diagnosis searches over forms and parameters.

Evaluation is vectorised and causal: the error of a row depends only on what is known when its set-point is issued (of whole records
temperatures and air are known better, `hil.effects.thermometers`).
History enters as columns (`time_s`, `since_reversal_mm`, `stroke_mm`); `hil.effects.history` computes those that follow
from the rows.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from hil.effects.survey import Survey

UM_PER_MM_PPM = 1e-3
"""µm in a mm times a ppm, or in a mm times a µrad."""
MOST_UNSURE = 0.5
"""Relative standard deviation up to which a positive parameter is given as a value; beyond it its interval of two of them would
hold zero, and it is given as the bounds that the rows do determine.
"""
COVERS = 2.0
"""Standard uncertainties about the value that an interval at 95 % reaches, as of every expanded uncertainty here (k = 2)."""
SYMMETRIC = 0.25
"""Share of the expanded uncertainty by which an end of an interval may be elsewhere for it to be given as value ± uncertainty."""
POINT_KNOWN_TO = 3.0
"""Standard deviations by which what changes along the travel must differ from zero for the point where it is zero to be given."""
FARTHEST_POINT = 3.0
"""Distance of that point from mid-travel, in half travels, beyond which no machine holds its axis there: a travel past either end."""
_APART_MM = 1000.0
"""Distance of the two places that a straight error is taken at: of the size of a travel, so that its slope loses no digits."""
ASCENTS = 6
"""Steps towards the end of a quantity on an ellipsoid, each half way to its slope there; linear ones are there with the first."""
STEP = 1e-4
"""Relative step of a central difference: its error is the square of it."""
Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]
"""Column name -> values of shape (n,), rows in the order of time; the unit is the end of the name."""


class Action(Enum):
    """What is to be done about an effect that was found."""

    COMPENSATE = "compensate"  # the machine does it and will do it again: add it to the correction
    FIX_SETUP = "fix-setup"  # the instrument or its mount does it: correct the set-up, never the machine
    RE_MEASURE = "re-measure"  # it happened once: measure again


@dataclass(frozen=True)
class Estimate:
    """A value with its standard uncertainty (k = 1), both in the unit of the parameter's name; as text with the expanded (k = 2).

    profiled: its interval of profile likelihood at 95 %, where it was followed; as text where ± does not say as much
    """

    value: float
    std: float
    profiled: tuple[float, float] | None = None

    @property
    def interval(self) -> tuple[float, float]:
        """The interval at 95 %."""
        return self.profiled or (self.value - COVERS * self.std, self.value + COVERS * self.std)

    @property
    def is_symmetric(self) -> bool:
        """Whether ± twice the standard uncertainty says as much as the interval."""
        if self.profiled is None:
            return True
        sides = (self.value - self.interval[0], self.interval[1] - self.value)
        return all(abs(side - COVERS * self.std) <= SYMMETRIC * COVERS * self.std for side in sides)

    @property
    def size(self) -> Estimate:
        """Its absolute value."""
        ends = self.profiled
        if ends is not None:
            inner = 0.0 if ends[0] < 0.0 < ends[1] else min(map(abs, ends))
            ends = inner, max(map(abs, ends))
        return Estimate(abs(self.value), self.std, ends)

    def __str__(self) -> str:
        if not self.is_symmetric:
            return f"{self.value:.4g} ({self.interval[0]:.4g} to {self.interval[1]:.4g})"
        return f"{self.value:.4g} ± {float(f'{COVERS * self.std:.2g}'):g}"


@dataclass(frozen=True)
class NonLinear:
    """A parameter that the basis depends on non-linearly, with its bounds; unit as its name says."""

    name: str
    lower: float
    upper: float
    logarithmic: bool = True
    """Searched on a logarithmic scale; the spread is that of the logarithm."""
    usual: tuple[float, float] | None = None
    """Log-normal prior for records that determine the parameter badly: median, and standard deviation of the
    logarithm.
    """

    def log_prior(self, value: float) -> float:
        """Log of the prior density at a value, relative to that at the median; 0 without a prior."""
        if self.usual is None:
            return 0.0
        middle, spread = self.usual
        return -0.5 * (math.log(value / middle) / spread) ** 2


@dataclass(frozen=True)
class Wave:
    """at_um: an effect's error over the place in mm; steepest: its largest slope, µm/mm, infinite where it is not known."""

    at_um: Callable[[float], float]
    steepest: float


@dataclass(frozen=True)
class Straight:
    """An effect's error, straight over the place: at 0 mm, µm, and its slope, µm/mm."""

    at_zero_um: float
    slope: float


@dataclass(frozen=True)
class Rival:
    """Another effect that can look the same, and the measurement that separates the two."""

    effect: str
    separate_by: str


@dataclass(frozen=True)
class Form:
    """One way in which an effect can show in given records.

    effect: id; name: of the variant ('temperature', 'tanh' …)
    inputs: the columns it reads, in the order the effect's basis expects
    constants: fixed numbers of the basis (centre and half span of the travel, a reference temperature …)
    nonlinear: bounded parameters; starts: grid of starting values for them, shape (g, len(nonlinear))
    scan: part of the first search; the others only refine an effect already found
    exhaustive: the grid holds every parameter value that makes a difference
    shrunk: many coefficients with a common normal prior (ridge) instead of free ones
    log_odds: prior log odds, relative to the other forms; that its parameters are free is paid by the grid
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
    log_odds: float = 0.0

    def log_prior(self, theta: Sequence[float]) -> float:
        """Log of the prior density of the parameters, relative to that at their usual values; 0 where they have none."""
        return float(sum(p.log_prior(value) for p, value in zip(self.nonlinear, theta, strict=True)))


class Effect(ABC):
    """One cause of error. Stateless; registered in an explicit tuple (`hil.effects.ALL`).

    A new effect defines `id`, `title`, `action`, `forms`, `basis`, `parameters` and `explain`. Methods given a form of
    another effect raise KeyError.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    action: ClassVar[Action]
    rivals: ClassVar[tuple[Rival, ...]] = ()
    static: ClassVar[bool] = False
    """A function of position and direction alone: a table measured after the cause appeared contains it already."""
    is_table: ClassVar[bool] = False
    """A smooth shape over the whole travel, as a correction table is one: a fit cannot tell its share from the table's own."""
    mean_of: ClassVar[str] = ""
    """Id of an effect that varies along the axis, whose mean this one is: beside it, it is no cause of its own."""
    several: ClassVar[bool] = False
    """Whether a machine may have it more than once (two periods, two worn zones, two jumps). Two terms of any other effect are one
    course, of which only the sum is determined.
    """
    once: ClassVar[bool] = False
    """Happens once, as a jump does, or wanders at random: no run predicts it in another, so runs left out are not asked about it."""
    log_odds: ClassVar[float] = 0.0
    """Prior log odds, relative to the other effects; they decide where the records cannot."""

    @abstractmethod
    def forms(self, survey: Survey) -> tuple[Form, ...]:
        """The forms these records allow, the simplest first; empty where the columns are missing or do not vary."""

    @abstractmethod
    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        """Columns of the design matrix, shape (n, k), in µm per unit of each coefficient. Raises KeyError for an
        unknown form.
        """

    def bases(self, form: Form, thetas: Sequence[Sequence[float]], columns: Columns) -> Floats:
        """The bases of g parameter vectors side by side, shape (n, g·k). To be overridden where a joint evaluation is
        faster.
        """
        return np.hstack([self.basis(form, theta, columns) for theta in thetas])

    def action_for(self, term: Term) -> Action:
        """What to do about a term: `action`, where its parameters do not show that another part causes it."""
        del term
        return self.action

    def is_straight(self, form: Form) -> bool:
        """Whether the error is straight along the axis, everything but `target_mm` as it is. Then two places tell a stream of all."""
        return "target_mm" not in form.inputs

    def wave(
        self, form: Form, theta: Sequence[float], coefficients: Sequence[float], row: Mapping[str, float]
    ) -> Wave | None:
        """`basis` times coefficients as a function of the place, everything else as in the row; for streams. None: only `basis`
        can give it.
        """
        del form, theta, coefficients, row
        return None

    @abstractmethod
    def parameters(self, term: Term) -> dict[str, Estimate]:
        """The fitted parameters by their usual names, unit as the end of the name, each with its standard uncertainty. A certificate
        leaves out those of a user's effect whose names end in no unit that it knows.
        """

    @abstractmethod
    def explain(self, term: Term) -> str:
        """One sentence: the cause, with figures and units."""

    def explain_all(self, terms: Sequence[Term]) -> str:
        """Several terms of one effect, the largest first, in sentences."""
        return " ".join(map(self.explain, terms))

    def lag(self, form: Form, theta: Sequence[float]) -> tuple[str, float] | None:
        """The sensor's column that it reads through a lag, and the time constant, s: a correction has to know that sensor's course."""
        del form, theta
        return None

    def is_exceeded(self, form: Form, theta: Sequence[float]) -> bool:
        """Whether the records want more than the effect can be, at these parameters: then it is another effect, and is not
        ranked.
        """
        del form, theta
        return False

    def stands_for(self, form: Form) -> tuple[str, ...]:
        """Ids of other effects that a form is rich enough to imitate, so that its name is not sure beside theirs; usually none."""
        del form
        return ()

    def implausible(self, term: Term) -> str | None:
        """Why no machine behaves like this (sign, range), or None. The effect's weight is lowered and its name stays in doubt; it is
        not excluded.
        """
        del term
        return None


@dataclass(frozen=True)
class Likely:
    """The coefficients that are likely with these non-linear parameters: middle (k,) + root (k, k) @ each vector no longer than 1."""

    theta: tuple[float, ...]
    middle: Floats
    root: Floats

    def range_of(self, quantity: Callable[[Floats, Floats], float]) -> tuple[float, float]:
        """Least and largest value of a quantity of coefficients (k,) and parameters (t,): at the middle, and both ways along its
        slope.
        """
        theta = np.array(self.theta)

        def at(unit: Floats) -> float:
            return quantity(self.middle + self.root @ unit, theta)

        axes = np.eye(len(self.middle))
        found = [at(0.0 * axes[0])]
        for sign in (1.0, -1.0):
            unit = 0.0 * axes[0]
            for _ in range(ASCENTS):
                slope = np.array([at(unit + STEP * axis) - at(unit - STEP * axis) for axis in axes])
                if not np.any(slope):
                    break
                last, unit = unit, unit + sign * slope / np.linalg.norm(slope)
                unit = unit / max(float(np.linalg.norm(unit)), STEP)
                found.append(at(unit))
                if float(np.linalg.norm(unit - last)) < STEP:
                    break
        return min(found), max(found)

    def holds_zero(self, i: int, j: int) -> bool:
        """Whether coefficients i and j can both be zero."""
        rows = self.root[[i, j]]
        middle = self.middle[[i, j]]
        return bool(middle @ np.linalg.pinv(rows @ rows.T) @ middle <= 1.0)


@dataclass(frozen=True)
class Term:
    """An effect with fitted parameters: one part of a model, evaluated by the correction.

    theta: the non-linear parameters, in the order of form.nonlinear
    coefficients: shape (k,); covariance: of (coefficients, theta), shape (k + t, k + t)
    likely: the region of (coefficients, theta) within which no single quantity is less likely than at 95 %: the range of a quantity
    over it is its interval of profile likelihood; empty where it is not known, as of a term that was read
    """

    effect: Effect
    form: Form
    theta: tuple[float, ...]
    coefficients: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    likely: tuple[Likely, ...] = field(default=(), compare=False, repr=False)

    @property
    def needs(self) -> tuple[str, ...]:
        """The columns it reads."""
        return self.form.inputs

    @property
    def lag(self) -> tuple[str, float] | None:
        """See `Effect.lag`."""
        return self.effect.lag(self.form, self.theta)

    def error_um(self, columns: Columns) -> Floats:
        """The error the effect causes, µm, shape (n,). Raises InputError when a column is missing or not finite."""
        for name in self.needs:
            if name not in columns:
                raise InputError(f"effect {self.effect.id} needs the column {name}, which is not there")
            if not np.all(np.isfinite(columns[name])):
                raise InputError(f"effect {self.effect.id} needs {name} in every row, but some are empty")
        basis = self.effect.basis(self.form, self.theta, columns)
        return np.asarray(basis @ np.array(self.coefficients), dtype=np.float64)

    def along(self, row: Mapping[str, float]) -> Straight | Wave | None:
        """The error as a function of the place, everything else as in the row; None where only arrays can give it.

        Raises InputError as `error_um`.
        """
        columns = {name: np.full(2, value) for name, value in row.items()} | {"target_mm": np.array([0.0, _APART_MM])}
        at_zero_um, there_um = self.error_um(columns).tolist()
        if self.effect.is_straight(self.form):
            return Straight(at_zero_um, (there_um - at_zero_um) / _APART_MM)
        return self.effect.wave(self.form, self.theta, self.coefficients, row)

    @property
    def parameters(self) -> dict[str, Estimate]:
        """The effect's parameters by name, see `Effect.parameters`."""
        return self.effect.parameters(self)

    def coefficient(self, index: int, scale: float = 1.0) -> Estimate:
        """One linear coefficient times `scale`, with its standard uncertainty."""
        std = math.sqrt(max(self.covariance[index][index], 0.0)) * abs(scale)
        ends = [
            scale * (one.middle[index] + sign * float(np.linalg.norm(one.root[index])))
            for one in self.likely
            for sign in (1.0, -1.0)
        ]
        return Estimate(self.coefficients[index] * scale, std, (min(ends), max(ends)) if ends else None)

    def nonlinear(self, index: int) -> Estimate:
        """One non-linear parameter with its standard uncertainty, NaN where the fit gave none."""
        at = len(self.coefficients) + index
        values = [one.theta[index] for one in self.likely]
        std = math.sqrt(max(self.covariance[at][at], 0.0))
        return Estimate(self.theta[index], std, (min(values), max(values)) if values else None)

    def range_of(self, quantity: Callable[[Floats, Floats], float]) -> tuple[float, float] | None:
        """Least and largest likely value of a quantity of coefficients (k,) and parameters (t,); None where `likely` is not known."""
        ends = [one.range_of(quantity) for one in self.likely]
        return (min(low for low, _ in ends), max(high for _, high in ends)) if ends else None

    def positive(self, index: int, name: str) -> dict[str, Estimate]:
        """A positive non-linear parameter under its name, or what is known of it: "least_" and "most_", the ends of its interval of
        profile likelihood, or two standard deviations of its logarithm away; none beyond the range that was searched.
        """
        parameter, found = self.form.nonlinear[index], self.nonlinear(index)
        factor = math.exp(min(2.0 * found.std / found.value, 50.0))
        low, high = found.profiled or (found.value / factor, found.value * factor)
        widest = max(found.std, 0.25 * (high - low)) if found.profiled else found.std
        if widest <= MOST_UNSURE * found.value:
            return {name: found}
        inside = parameter.lower * (1.0 + STEP), parameter.upper * (1.0 - STEP)
        bounds = {f"least_{name}": low, f"most_{name}": high}
        return {key: Estimate(bound, 0.0) for key, bound in bounds.items() if inside[0] < bound < inside[1]}

    def positive_text(self, index: int, unit: str) -> str:
        """The same in words."""
        known = self.positive(index, "x")
        if "x" in known:
            return f"{known['x']} {unit}"
        words = {"least_x": "at least", "most_x": "at most"}
        said = " and ".join(f"{words[key]} {bound.value:.3g} {unit}" for key, bound in known.items())
        return said or f"an undetermined number of {unit}"

    def at(self, columns: Mapping[str, float]) -> Estimate:
        """The error of one row of these columns, µm, with its uncertainty to first order in coefficients and parameters."""
        row = {name: np.array([value]) for name, value in columns.items()}
        basis = self.effect.basis(self.form, self.theta, row)
        coefficients = np.array(self.coefficients)
        gradient = np.hstack([basis, slopes_of(row, self, coefficients)])[0]
        variance = float(gradient @ np.array(self.covariance) @ gradient)
        return Estimate(float(basis[0] @ coefficients), math.sqrt(max(variance, 0.0)))

    def derived(self, quantity: Callable[[Floats, Floats], float]) -> Estimate:
        """A quantity of coefficients (k,) and parameters (t,): first-order uncertainty, by central differences, and profile."""
        k = len(self.coefficients)
        values = np.array([*self.coefficients, *self.theta])
        gradient = np.zeros(len(values))
        for i, value in enumerate(values):
            step = np.zeros(len(values))
            step[i] = STEP * max(abs(value), 1e-9)
            sides = [quantity(shifted[:k], shifted[k:]) for shifted in (values + step, values - step)]
            gradient[i] = (sides[0] - sides[1]) / (2.0 * step[i])
        variance = float(gradient @ np.array(self.covariance) @ gradient)
        return Estimate(quantity(values[:k], values[k:]), math.sqrt(max(variance, 0.0)), self.range_of(quantity))

    def amplitude(self, i: int, j: int) -> Estimate:
        """√(a² + b²) of coefficients i and j, with first-order uncertainty."""
        a, b = self.coefficients[i], self.coefficients[j]
        size = math.hypot(a, b)
        if size == 0.0:
            return Estimate(0.0, math.sqrt(max(self.covariance[i][i], 0.0)))
        c = self.covariance
        variance = (a * a * c[i][i] + 2 * a * b * c[i][j] + b * b * c[j][j]) / size**2
        ends = self.range_of(lambda c, _: math.hypot(c[i], c[j]))
        if ends is not None and any(one.holds_zero(i, j) for one in self.likely):
            ends = 0.0, ends[1]
        return Estimate(size, math.sqrt(max(variance, 0.0)), ends)

    def angle(self, i: int, j: int) -> Estimate:
        """atan2(coefficient j, coefficient i) in rad, with first-order uncertainty."""
        a, b = self.coefficients[i], self.coefficients[j]
        size2 = a * a + b * b
        if size2 == 0.0:
            return Estimate(0.0, math.pi)
        c = self.covariance
        variance = (b * b * c[i][i] - 2 * a * b * c[i][j] + a * a * c[j][j]) / size2**2
        angle = math.atan2(b, a)
        ends = self.range_of(lambda k, _: angle + math.remainder(math.atan2(k[j], k[i]) - angle, 2.0 * math.pi))
        return Estimate(angle, math.sqrt(max(variance, 0.0)), ends)

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


class Parametrised(Protocol):
    """An effect in one form, with its non-linear parameters."""

    @property
    def effect(self) -> Effect: ...
    @property
    def form(self) -> Form: ...
    @property
    def theta(self) -> tuple[float, ...]: ...


def slopes_of(columns: Columns, one: Parametrised, coefficients: Floats) -> Floats:
    """Derivative of the effect's error to its non-linear parameters, shape (n, t)."""
    out = np.zeros((len(next(iter(columns.values()))), len(one.theta)))
    for i, value in enumerate(one.theta):
        step = STEP * max(abs(value), 1e-9)
        sides = []
        for shifted in (value + step, value - step):
            theta = (*one.theta[:i], shifted, *one.theta[i + 1 :])
            sides.append(one.effect.basis(one.form, theta, columns) @ coefficients)
        out[:, i] = (sides[0] - sides[1]) / (2 * step)
    return out
