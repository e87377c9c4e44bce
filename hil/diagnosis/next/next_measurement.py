"""The choice of the next measurement when the records leave more than one cause: the one that separates them best for
its machine time.

Every cause predicts the error in every feasible run; every rival is then refitted to that prediction together with the
existing rows, and the misfit counts, Σ(f₁ - f₂)²/σ² (T-optimality: Atkinson & Fedorov, Biometrika 62 (1975) 57). With
more than two causes the pairs are weighted by how likely they are (Box & Hill, Technometrics 9 (1967) 57).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.next.causes import LEAST, Hypothesis, weigh
from hil.diagnosis.next.continuation import Continuation
from hil.diagnosis.next.feasible import feasible_runs
from hil.diagnosis.next.planned_run import Means, PlannedRun
from hil.effects import ALL, Effect, Term
from hil.effects.model import Model
from hil.records.rows import Records

ENOUGH = 30.0
"""Discrimination Σ(f₁ - f₂)²/σ² beyond which two causes are separated and more has no value."""

DECIDED = 0.95
"""Weight of a cause from which no further run is made."""


def least_told() -> float:
    """Discrimination below which a run does not separate a pair: the log odds that it brings are half of it."""
    return 2.0 * USUAL.richer


@dataclass(frozen=True)
class Prospect:
    """The expected information of a run.

    pairs: discrimination of each pair of causes, the likelier first; worth: of all pairs together, per minute
    """

    run: PlannedRun
    pairs: Mapping[tuple[str, str], float]
    worth: float

    def tells(self, first: str, second: str) -> float:
        """Expected Σ(f₁ - f₂)²/σ² of a pair in either order; 0 for one that was not compared."""
        return self.pairs.get((first, second), self.pairs.get((second, first), 0.0))


@dataclass(frozen=True)
class Outlook:
    """The remaining causes, likeliest first, and the runs by their worth; `best` is None when no run separates them."""

    causes: tuple[Hypothesis, ...]
    prospects: tuple[Prospect, ...]

    @property
    def decided(self) -> bool:
        """One cause has enough weight."""
        return bool(self.causes) and self.causes[0].weight >= DECIDED

    @property
    def rivals(self) -> tuple[Hypothesis, ...]:
        """Every cause of at least the least weight, the likeliest first."""
        return tuple(cause for cause in self.causes if cause.weight >= LEAST)

    @property
    def best(self) -> Prospect | None:
        """The run of most worth, if any."""
        if self.decided or not self.prospects or self.prospects[0].worth <= 0.0:
            return None
        return self.prospects[0]

    def best_for(self, first: str, second: str) -> Prospect | None:
        """The run of most worth for one pair of causes."""
        usable = [p for p in self.prospects if p.tells(first, second) >= least_told()]
        return max(usable, key=lambda p: p.tells(first, second) / p.run.minutes, default=None)


def outlook(
    records: Records,
    declared: Model | None,
    means: Means,
    *,
    effects: Sequence[Effect] = ALL,
    beside: Sequence[Term] = (),
    persons: bool = True,
    made: Sequence[str] = (),
    seed: int = 0,
) -> Outlook:
    """Weighs the causes, and every run that could be made next.

    beside: effects known to be there; persons: a person can be asked to help; made: names of runs made already, which
    are left out
    Raises InputError for too few rows.
    """
    with threadpool_limits(1, "blas"):
        causes = weigh(records, declared, effects, beside)
        left = [cause for cause in causes if cause.weight >= LEAST]
        if len(left) < 2 or left[0].weight >= DECIDED:
            return Outlook(causes, ())
        runs = feasible_runs(means, first_run=int(np.max(records.run)) + 1, seed=seed)
        runs = tuple(run for run in runs if (persons or not run.person) and run.name not in made)
        continuation = Continuation(records, declared, left, means)
        prospects = [_prospect(continuation, left, run) for run in runs]
        return Outlook(causes, tuple(sorted(prospects, key=lambda p: -p.worth)))


def _prospect(continuation: Continuation, causes: Sequence[Hypothesis], run: PlannedRun) -> Prospect:
    apart = continuation.discrimination(run)
    pairs: dict[tuple[str, str], float] = {}
    worth = 0.0
    for i, j in itertools.combinations(range(len(causes)), 2):
        told = 0.5 * float(min(apart[i, j], ENOUGH) + min(apart[j, i], ENOUGH))
        pairs[causes[i].id, causes[j].id] = told
        if told >= least_told():
            worth += causes[i].weight * causes[j].weight * told
    return Prospect(run, pairs, worth / run.minutes)
