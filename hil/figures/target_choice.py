"""What another choice of targets would change in a figure of ISO 230-2. No I/O.

A figure is the sum of the highest values along the axis of one or two curves (`Iso230.curves`); A is the highest of mean + 2s and of
−(mean − 2s). The targets were chosen, so the highest value is a matter of chance. How far the values of one neighbourhood scatter is
seen from each target against the mean of its two neighbours: the difference has 3/2 of the variance of one value. Another choice
puts any of these scatters, with either sign, on the course of the curve, the mean of each target and its neighbours (1 : 2 : 1). The
distribution of the highest value follows: its probability of being below x is the product of those of the targets.

What happens at one place between all targets is not seen. m targets have m − 2 degrees of freedom, by which Student's t widens U.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.records.rows import Floats

FEWEST = 3
"""Targets from which a scatter between neighbours is seen."""
_STEPS = 500
"""Steps in which the highest value is distributed."""
_TWO_SIGMA = 0.97725
"""Probability of a normal value below two standard deviations: k = 2."""


def highest_um(curves: Sequence[Floats]) -> float:
    """Expanded uncertainty (k = 2), µm, of the sum of the highest values of these curves, shape (m,) each, m ≥ `FEWEST`."""
    return _expanded_um(sum(map(_variance_of_highest, curves)), len(curves[0]))


def mean_um(values: Floats) -> float:
    """Expanded uncertainty (k = 2), µm, of the mean of a curve of shape (m,), m ≥ `FEWEST`."""
    return _expanded_um(float(np.mean(_scatter(values) ** 2)) / len(values), len(values))


def _expanded_um(variance: float, m: int) -> float:

    from scipy import special  # noqa: PLC0415  (a verb starts without it)

    return float(special.stdtrit(m - 2, _TWO_SIGMA)) * math.sqrt(variance)


def _scatter(values: Floats) -> Floats:
    """Each target but the first and last against its neighbours, with the standard deviation of one value."""
    return np.asarray((values[1:-1] - (values[:-2] + values[2:]) / 2.0) / math.sqrt(1.5))


def _variance_of_highest(values: Floats) -> float:
    scatter = np.sort(np.concatenate([_scatter(values), -_scatter(values)]))
    before, after = 2.0 * values[0] - values[1], 2.0 * values[-1] - values[-2]  # the ends go on straight
    around = np.concatenate([[before], values, [after]])
    course = (around[:-2] + 2.0 * around[1:-1] + around[2:]) / 4.0
    possible = float(np.max(course)) + np.linspace(scatter[0], scatter[-1], _STEPS)
    below = np.searchsorted(scatter, possible - course[:, None], side="right") / len(scatter)
    probability = np.diff(np.prod(below, axis=0), prepend=0.0)
    probability[-1] += 1.0 - float(np.sum(probability))  # rounding at the upper end
    mean = float(probability @ possible)
    return float(probability @ (possible - mean) ** 2)
