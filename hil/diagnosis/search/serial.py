"""Noise with more memory than ordinary noise: the residual is correlated from row to row, and follows none of the
columns.

Noise models whose correlated part exceeds the white one are compared with those of ordinary noise. A cause that
switches or settles faster than any column shows is found only here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.searcher import Searcher
from hil.effects import Estimate

ORDINARY = tuple(product((0.35, 0.6, 0.85), (0.3, 0.5, 0.7, 0.85, 0.95)))
STRONG = tuple(product((1.2, 1.7, 2.5, 4.0), (0.5, 0.7, 0.85)))
"""(ar, rho): standard deviation of the correlated part over that of the white one, and its correlation one row
later.
"""
AROUND = tuple(product(np.geomspace(0.7, 8.0, 12).tolist(), (0.4, 0.55, 0.7, 0.8, 0.9)))
"""The same, on a grid fine enough for the uncertainty of the strength."""
BEYOND = 6.0
"""Log odds of a strong correlation against every ordinary one from which it is not noise."""


@dataclass(frozen=True)
class Memory:
    """noise: the strongly correlated model; log_odds: against ordinary noise; rms_um: of the correlated part"""

    noise: Noise
    log_odds: float
    rms_um: Estimate


def memory(searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> Memory | None:
    """The strong correlation in the residual of some terms, if it is beyond that of noise."""
    if noise.ar == 0.0:
        return None

    def best(points: Sequence[tuple[float, float]]) -> tuple[float, Noise]:
        trials = [replace(noise, ar=ar, rho=rho) for ar, rho in points]
        return max(((searcher.evidence(chosen, t) - t.log_prior(), t) for t in trials), key=lambda pair: pair[0])

    ordinary, (strong, model) = best(ORDINARY)[0], best(STRONG)
    if strong <= ordinary + BEYOND:
        return None
    return Memory(model, strong - ordinary, _strength_um(searcher, chosen, noise))


def _strength_um(searcher: Searcher, chosen: Sequence[Choice], noise: Noise) -> Estimate:
    """Standard deviation of the correlated part in µm, averaged over noise models by their evidence."""
    extra = searcher.extra(chosen)
    odds, values = np.zeros(len(AROUND)), np.zeros(len(AROUND))
    for i, (ar, rho) in enumerate(AROUND):
        projection = searcher.projection(replace(noise, ar=ar, rho=rho), extra)
        odds[i] = float(projection.log_null) - projection.noise.log_prior()
        values[i] = ar * float(np.sqrt(projection.rss / projection.dof))
    weight = np.exp(odds - np.max(odds))
    weight /= np.sum(weight)
    mean = float(weight @ values)
    return Estimate(mean, float(np.sqrt(weight @ (values - mean) ** 2)))
