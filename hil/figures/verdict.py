"""The verdict on an axis: its accuracy A of ISO 230-2 with the uncertainty of its measurement, against a limit.

Terminal, JSON, screen and report show this object, so that they cannot differ. No I/O.

U is the expanded uncertainty at k = 2 by ISO/TR 230-9 (`uncertainty.budget`), the rule is that of `uncertainty.conformity`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.figures import target_choice
from hil.figures.iso230 import TARGET_RESOLUTION_MM, Iso230, iso230
from hil.figures.uncertainty import CONFORMITY_RULE, Contribution, UncertaintyInputs, budget, conformity
from hil.records.rows import Records

K = 2
PLUS_MINUS = "± is the expanded uncertainty U (k = 2, about 95 %)"
"""What ± means in every output of figures; single standard deviations and standard uncertainties are named where they are shown."""

FITTED_PLUS_MINUS = "± of a fitted value is twice its standard uncertainty (k = 2, about 95 %)"


class At(Enum):
    """The targets of a pass, compared with those that the tables were made at."""

    OTHER = "at other targets"
    CALIBRATED = "at the calibrated targets"
    MIXED = "partly at the calibrated targets"
    UNCORRECTED = "uncorrected"
    UNKNOWN = "at targets that may be the tables' own (an axis file says)"


class Decision(Enum):
    """The outcome of the decision rule. NOT_JUDGED: these rows prove nothing about the axis between the tables' targets."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"
    NO_LIMIT = "no limit"
    NOT_JUDGED = "not judged"


@dataclass(frozen=True)
class Mean:
    """Mean error of all targets, µm, and by how much another choice of targets would change it (k = 2)."""

    value_um: float
    U_um: float


@dataclass(frozen=True)
class Accuracy:
    """The accuracy A of one pass, µm.

    A_um: None where the rows cannot give it; U_um: expanded uncertainty (k = 2), None where nothing is stated of the instrument;
    limit_um: largest A that is allowed, None without one; missing: why A or U is None, else ""; parts: of U, their squares add up;
    mean: None for too few targets
    """

    A_um: float | None
    U_um: float | None
    limit_um: float | None
    at: At
    missing: str = ""
    parts: tuple[Contribution, ...] = ()
    mean: Mean | None = None

    @property
    def decision(self) -> Decision:
        """By `CONFORMITY_RULE`. Nothing is decided by rows at the tables' own targets."""
        if self.at not in (At.OTHER, At.UNCORRECTED):
            return Decision.NOT_JUDGED
        if self.limit_um is None:
            return Decision.NO_LIMIT
        if self.A_um is None:
            return Decision.UNDECIDED
        return Decision(conformity(self.A_um, self.U_um, self.limit_um).value)

    @property
    def good(self) -> bool:
        """Not shown to be bad: passed, or there is no limit to hold it against."""
        return self.decision in (Decision.PASS, Decision.NO_LIMIT)

    @property
    def value(self) -> str:
        """A ± U as text, µm, "–" where it is not known."""
        if self.A_um is None:
            return "–"
        return f"{self.A_um:.2f}" if self.U_um is None else f"{self.A_um:.2f} ± {self.U_um:.2f}"

    @property
    def reason(self) -> str:
        """Why the decision is what it is, in one clause."""
        limit = f"limit {self.limit_um:g} µm" if self.limit_um is not None else "no limit given"
        match self.decision:
            case Decision.PASS:
                return f"{limit}: pass, A + U ≤ limit"
            case Decision.FAIL:
                return f"{limit}: fail, A − U > limit"
            case Decision.UNDECIDED if self.A_um is None or self.U_um is None:
                return f"{limit}: undecided, {self.missing}"
            case Decision.UNDECIDED:
                return f"{limit}: undecided, it lies within A ± U"
            case Decision.NO_LIMIT:
                return f"{limit}, so neither pass nor fail"
        return "not judged: the verdict is of other targets"

    def __str__(self) -> str:
        return f"A = {self.value} µm {self.at.value}; {self.reason}"

    def explained(self) -> tuple[str, ...]:
        """Sentences below the verdict: what ± is and from what or why there is none, whether the mean has moved, and the rule where it
        was used."""
        known = (f"no U: {self.missing}",) if self.U_um is None or self.A_um is None else (PLUS_MINUS, *self._made_of())
        ruled = self.decision in (Decision.PASS, Decision.FAIL, Decision.UNDECIDED)
        return (*known, *self._moved(), *((f"decision rule: {CONFORMITY_RULE}",) if ruled else ()))

    def _made_of(self) -> tuple[str, ...]:
        """The parts of U, the largest first and with its source."""
        shown = sorted((one for one in self.parts if round(one.expanded_um, 2)), key=lambda one: -one.expanded_um)
        told = [f"{one.name} {one.expanded_um:.2f}" for one in shown]
        if not told:
            return ()
        told[0] += f" ({shown[0].how})"
        return (f"U in µm from {', '.join(told)}; their squares add up",)

    @property
    def moved(self) -> bool:
        """Whether the mean of a verification differs from zero by more than another choice of targets would change."""
        return self.at is At.OTHER and self.mean is not None and abs(self.mean.value_um) > self.mean.U_um

    def _moved(self) -> tuple[str, ...]:
        if self.mean is None or not self.moved:
            return ()
        where = f"the mean is {self.mean.value_um:+.2f} ± {self.mean.U_um:.2f} µm from the tables' zero"
        return (f"{where}: the datum drifted or the axis expanded; A, a range, does not contain it",)

    def as_json(self) -> dict[str, Any]:
        """Plain JSON form, µm: A_um, U_um, k, limit_um, targets (see `At`), decision, rule, missing, mean_um, mean_U_um, and
        parts_um, those of U by name."""
        return {
            "A_um": self.A_um,
            "U_um": self.U_um,
            "k": K,
            "limit_um": self.limit_um,
            "targets": self.at.name.lower(),
            "decision": self.decision.value,
            "rule": CONFORMITY_RULE,
            "missing": self.missing,
            "mean_um": None if self.mean is None else self.mean.value_um,
            "mean_U_um": None if self.mean is None else self.mean.U_um,
            "parts_um": {one.name: one.expanded_um for one in self.parts},
        }


def accuracy(
    records: Records,
    inputs: UncertaintyInputs | None,
    limit_um: float | None,
    calibrated_mm: Sequence[float] | None,
    *,
    corrected: bool | None = None,
) -> Accuracy:
    """The accuracy of one pass. inputs: on instrument and room, None where the axis file states none.

    calibrated_mm: targets of the tables, None where they are not known; corrected: whether a correction was in force, None: by the
    rows, where some command differs from its target
    """
    at = targets_of(records, calibrated_mm, corrected=corrected)
    try:
        figures = iso230(records)
    except InputError as error:
        return Accuracy(None, None, limit_um, at, error.what)
    known = Accuracy(figures.A, None, limit_um, at, mean=_mean(figures))
    if figures.A is None:
        return replace(known, missing="; ".join(figures.notes[:1]))
    if inputs is None:
        return replace(known, missing="the axis file has no [uncertainty] of instrument and room")
    try:
        found = budget(inputs, figures, records)
    except InputError as error:
        return replace(known, missing=error.what)
    return replace(known, U_um=found.figures_um["A"], parts=found.contributions)


def _mean(figures: Iso230) -> Mean | None:
    means = next((one for one in (figures.mean, figures.mean_up, figures.mean_down) if one is not None), None)
    if means is None or len(means) < target_choice.FEWEST:
        return None
    return Mean(float(np.mean(means)), target_choice.mean_um(means))


def targets_of(records: Records, calibrated_mm: Sequence[float] | None, *, corrected: bool | None = None) -> At:
    """Where these rows were measured; arguments as for `accuracy`."""
    if corrected is None:
        corrected = bool(np.any(np.abs(records.command_mm - records.target_mm) > TARGET_RESOLUTION_MM))
    if not corrected:
        return At.UNCORRECTED
    if not calibrated_mm:
        return At.UNKNOWN
    targets = np.unique(np.round(records.target_mm, 6))
    own = np.min(np.abs(targets[:, None] - np.asarray(calibrated_mm)[None, :]), axis=1) <= TARGET_RESOLUTION_MM
    return At.CALIBRATED if np.all(own) else At.MIXED if np.any(own) else At.OTHER
