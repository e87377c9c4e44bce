"""Noise with more memory than noise has: what remains hangs together from row to row, and follows none of the columns.

What may go in: the comparison of noise models whose correlated part is larger than the white one with those of ordinary noise. What
switches, wanders or settles faster than any column says shows here, and only here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from hil.diagnosis.evidence import Noise
from hil.diagnosis.fit import Choice
from hil.diagnosis.searcher import Searcher

ORDINARY = tuple(product((0.35, 0.6, 0.85), (0.3, 0.5, 0.7, 0.85, 0.95)))
STRONG = tuple(product((1.2, 1.7, 2.5, 4.0), (0.5, 0.7, 0.85)))
"""(ar, rho): standard deviation of the correlated part over that of the white one, and what is left of it one row later."""
BEYOND = 6.0
"""Log odds of a strong correlation against every ordinary one from which it is no noise."""


@dataclass(frozen=True)
class Memory:
    """noise: the strongly correlated model; log_odds: against ordinary noise"""

    noise: Noise
    log_odds: float


def memory(searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> Memory | None:
    """The strong correlation in what some terms leave, if it is beyond that of noise."""
    if noise.ar == 0.0:
        return None

    def best(points: Sequence[tuple[float, float]]) -> tuple[float, Noise]:
        trials = [replace(noise, ar=ar, rho=rho) for ar, rho in points]
        return max(((searcher.evidence(chosen, t) - t.log_prior(), t) for t in trials), key=lambda pair: pair[0])

    ordinary, (strong, model) = best(ORDINARY)[0], best(STRONG)
    return Memory(model, strong - ordinary) if strong > ordinary + BEYOND else None
