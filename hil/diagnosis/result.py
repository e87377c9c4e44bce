"""The result of a diagnosis as frozen values, and its JSON form."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from hil.diagnosis.repeats import PureError
from hil.effects import Action, Estimate, Term
from hil.effects.model import Model
from hil.effects.non_parametric import without_cause
from hil.figures.error_figures import rms
from hil.records.rows import Floats

OUTSIDE = "unexplained"
"""Name among the rivals for a dependence on other columns that no effect of the catalogue has."""


BOUNDS = ("least_", "most_")
"""How the names of parameters begin of which only a bound is known."""


def pooled(name: str, parts: Sequence[tuple[Estimate, float]]) -> Estimate:
    """Mean and standard uncertainty of estimates with their shares: the spread between them counts (law of total variance). Of bounds
    ("least_", "most_") the outermost.
    """
    if name.startswith(BOUNDS):
        return (min if name.startswith("least_") else max)((one for one, _ in parts), key=lambda one: one.value)
    if len(parts) == 1:
        return parts[0][0]
    whole = sum(share for _, share in parts)
    mean = sum(one.value * share for one, share in parts) / whole
    variance = sum((one.std**2 + (one.value - mean) ** 2) * share for one, share in parts) / whole
    return Estimate(mean, math.sqrt(variance))


@dataclass(frozen=True)
class RivalFound:
    """An effect that explains the residual almost as well: its share of the weight, and the measurement that separates
    them.
    """

    effect: str
    confidence: float
    separate_by: str


@dataclass(frozen=True)
class Finding:
    """An effect the declared model lacks.

    confidence: share of the weight among all causes, 0 … 1
    rms_um, rms_std_um, peak_um: what the effect contributes to these rows about its mean: RMS, its standard uncertainty, largest; of
        several terms that are one course beside a table of these rows, without what that table holds
    more: further terms of the same effect
    follows: the same effect by other columns that fit nearly as well, each with its share, and the share of the column of `term`
    beside_any_table: it was found beside a table fitted from the rows; else only because the declared table lacks it
    vague: the rows determine its course and none of its coefficients
    """

    term: Term
    confidence: float
    rivals: tuple[RivalFound, ...] = ()
    rms_um: float = 0.0
    rms_std_um: float = 0.0
    peak_um: float = 0.0
    more: tuple[Term, ...] = ()
    beside_any_table: bool = True
    follows: tuple[tuple[Term, float], ...] = ()
    vague: bool = False

    @property
    def terms(self) -> tuple[Term, ...]:
        return (self.term, *self.more)

    @property
    def rms(self) -> Estimate:
        """What it contributes to these rows, RMS, µm."""
        return Estimate(self.rms_um, self.rms_std_um)

    @property
    def summed(self) -> bool:
        """Whether several terms are one course, of which only the sum is determined: then no parameter is stated but its size."""
        return bool(self.more) and not self.term.effect.several

    @property
    def explanation(self) -> str:
        """The cause in a sentence with figures."""
        course = f"{self.term.effect.title}: a course of {' and '.join(self.term.needs)}"
        size = f"{self.rms} µm RMS over these rows and {self.peak_um:.3g} µm at most"
        if self.summed:
            only = f"{len(self.terms)} forms together fit it, so none has a coefficient of its own"
            return f"{course} that no single form of the catalogue has, {size}; {only}."
        told = self.term.effect.explain_all(self.terms)
        if self.is_unstated:
            told = f"{course}, {size}; these rows do not determine its coefficients."
        either = " or ".join(f"{term.needs[0]} ({share:.2f})" for term, share in self.follows)
        return f"{told} These rows do not tell which it follows: {either}." if either else told

    @property
    def effect(self) -> str:
        return self.term.effect.id

    @property
    def is_implausible(self) -> bool:
        """Whether no machine behaves like this; nothing is known of the parts where only their sum is determined."""
        return not self.summed and any(term.effect.implausible(term) for term in self.terms)

    @property
    def action(self) -> Action:
        """What to do about it."""
        return self.term.effect.action_for(self.term)

    @property
    def parameters(self) -> dict[str, Estimate]:
        """The effect's parameters by name, as far as the rows determine them; where they do not tell which column it follows, with
        the difference between those columns in the uncertainty. Bounds alone where no coefficient is determined.
        """
        if self.summed:
            return {"rms_um": self.rms}
        if not self.is_unstated:
            return self._fitted
        return {name: one for name, one in self._fitted.items() if name.startswith(BOUNDS)}

    @property
    def is_unstated(self) -> bool:
        """Whether no coefficient is determined and the first parameter that they make may be 0: it is not stated then."""
        of_theta = tuple(one.name for one in self.term.form.nonlinear)
        made = (one for name, one in self._fitted.items() if not name.startswith((*BOUNDS, *of_theta)))
        first = next(made, None)
        return self.vague and first is not None and abs(first.value) < 2.0 * first.std

    @cached_property
    def _fitted(self) -> dict[str, Estimate]:
        own = self.term.parameters
        every = [(term.parameters, share) for term, share in self.follows] or [(own, 1.0)]
        return {
            name: pooled(name, [(known[name], share) for known, share in every if name in known] or [(own[name], 1.0)])
            for name in own
        }


@dataclass(frozen=True)
class Carrier:
    """Columns that an unexplained residual follows, and the probability of as much in noise.

    rms: of the part that follows them over the rows, µm: as far as a smooth function of the columns represents it,
    beside table and effects; equivalent: columns that moved together with one of these, so that either may carry it
    """

    columns: tuple[str, ...]
    rms: Estimate
    probability: float
    equivalent: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __str__(self) -> str:
        alike = {name: f" (or equivalent: {', '.join(names)})" for name, names in self.equivalent.items() if names}
        named = " × ".join(name + alike.get(name, "") for name in self.columns)
        return f"{named}, {self.rms} µm RMS"

    def to_json(self) -> dict[str, Any]:
        return {
            "columns": list(self.columns),
            "or_equivalent": {name: list(alike) for name, alike in self.equivalent.items()},
            "rms_um": self.rms.value,
            "rms_std_um": self.rms.std,
            "probability": self.probability,
        }


@dataclass(frozen=True)
class Figures:
    """RMS and largest magnitude of an error, µm."""

    rms_um: float
    peak_um: float

    @classmethod
    def of(cls, error_um: Floats) -> Figures:
        """Of errors in µm, shape (n,)."""
        return cls(rms(error_um), float(np.max(np.abs(error_um))))


@dataclass(frozen=True)
class NoiseParts:
    """The noise as its model has it, standard deviations in µm: from row to row, with memory (over `memory_rows` rows), and of
    the offsets of the runs. A cause that nothing explains is in these figures; it is not in the pure error.
    """

    white_um: float
    memory_um: float
    memory_rows: float
    run_offset_um: float

    @property
    def within_run_um(self) -> float:
        return math.hypot(self.white_um, self.memory_um)

    def to_json(self) -> dict[str, float]:
        return {
            "white_um": self.white_um,
            "memory_um": self.memory_um,
            "memory_rows": self.memory_rows,
            "run_offset_um": self.run_offset_um,
            "within_run_um": self.within_run_um,
        }


@dataclass(frozen=True)
class Blind:
    """An effect this campaign cannot show, and why."""

    effect: str
    reason: str


@dataclass(frozen=True)
class Diagnosis:
    """The result.

    pure_error: the noise floor, from true repeats; None where the records have none; noise: as the model has it
    declared: the model before (fitted from the records or given); extended: with the effects found, refitted jointly
    before_um, after_um: held-out residual of each row with either model, shape (n,)
    setup_um: after, with the instrument effects removed too
    residual_um: of the extended model and the instrument effects on the rows it was fitted to, shape (n,)
    non_parametric: the diagnosis with a correction of the unexplained part, used only on request; or the reason why
    there is none
    """

    pure_error: PureError | None
    noise: NoiseParts
    declared: Model
    extended: Model
    findings: tuple[Finding, ...]
    unexplained: bool
    carriers: tuple[Carrier, ...]
    blind: tuple[Blind, ...]
    before_um: Floats
    after_um: Floats
    setup_um: Floats
    residual_um: Floats
    held_out: str
    recommended: bool
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    non_parametric: Diagnosis | str = "nothing is left unexplained"

    @property
    def before(self) -> Figures:
        """Figures of the held-out residual with the declared model."""
        return Figures.of(self.before_um)

    @property
    def after(self) -> Figures:
        """Figures of the held-out residual with the extended model."""
        return Figures.of(self.after_um)

    @property
    def unexplained_sentence(self) -> str:
        """What is left that nothing explains, and what carries it."""
        carried = "; ".join(map(str, self.carriers))
        known = f"carried by {carried}" if carried else "and no column that was recorded carries it"
        return f"structure is left that nothing in the catalogue explains, {known}"

    def to_json(self) -> dict[str, Any]:
        """The JSON object of `hil diagnose`, plain values."""
        floor = self.pure_error
        return {
            "noise_floor_um": None if floor is None else floor.std_um.value,
            "noise_floor_std_um": None if floor is None else floor.std_um.std,
            "noise_floor_dof": 0 if floor is None else floor.dof,
            "noise_floor_from": None if floor is None else floor.how,
            "noise": self.noise.to_json(),
            "declared": self.declared.declared,
            "findings": [_finding(finding) for finding in self.findings],
            "unexplained": self.unexplained,
            "carried_by": [carrier.to_json() for carrier in self.carriers],
            "non_parametric": [
                {"columns": list(term.needs), "explanation": term.effect.explain(term)}
                for term in without_cause(self.extended.terms)
            ],
            "blind_to": [{"effect": b.effect, "reason": b.reason} for b in self.blind],
            "before": _figures(self.before),
            "after": _figures(self.after),
            "after_setup_fixed": _figures(Figures.of(self.setup_um)),
            "held_out": {"how": self.held_out, "rows": len(self.before_um)},
            "recommended": self.recommended,
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def _figures(figures: Figures) -> dict[str, float]:
    return {"rms_um": figures.rms_um, "peak_um": figures.peak_um}


def _estimate(one: Estimate) -> dict[str, float]:
    """Value, standard uncertainty, and the ends of the interval at 95 %; a bound, which has no uncertainty, has none."""
    ends = dict(zip(("low", "high"), one.interval, strict=True)) if one.std > 0.0 else {}
    return {"value": one.value, "std": one.std, **ends}


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "effect": finding.effect,
        "parameters": {name: _estimate(one) for name, one in finding.parameters.items()},
        "follows": {term.needs[0]: share for term, share in finding.follows},
        "confidence": finding.confidence,
        "action": finding.action.value,
        "explanation": finding.explanation,
        "rms_um": finding.rms_um,
        "rms_std_um": finding.rms_std_um,
        "peak_um": finding.peak_um,
        "rivals": [
            {"effect": r.effect, "confidence": r.confidence, "separate_by": r.separate_by} for r in finding.rivals
        ],
    }
