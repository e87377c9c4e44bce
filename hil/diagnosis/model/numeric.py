"""Numerics of small problems, written here because the start of SciPy takes as long as a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LEAF = 64
"""Size of a triangular matrix up to which its inverse is that of any matrix."""
LEAST_SLOPE = 1e-4
SHORTEST = 1.0 / 64.0
"""Share of a step at which a line search ends."""
LONGEST = 4.0
"""Most that one step may change a parameter."""


def inverse_of_lower(lower: Floats) -> Floats:
    """Inverse of a lower triangular matrix, by halves."""
    n = len(lower)
    if n <= LEAF:
        return np.asarray(np.linalg.inv(lower))
    half = n // 2
    out = np.zeros((n, n))
    out[:half, :half] = inverse_of_lower(lower[:half, :half])
    out[half:, half:] = inverse_of_lower(lower[half:, half:])
    out[half:, :half] = -out[half:, half:] @ (lower[half:, :half] @ out[:half, :half])
    return out


def log_sum_exp(values: Floats) -> float:
    """Log of the sum of exponentials."""
    top = float(np.max(values))
    return top + math.log(float(np.sum(np.exp(values - top))))


def ranks(values: Floats) -> Floats:
    """Ranks from 1, equal values at their mean rank."""
    _, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return np.asarray((last - 0.5 * (counts - 1))[index], dtype=np.float64)


def log_density_of_student(z: Floats, dof: float) -> Floats:
    """Log density of Student's t."""
    scale = math.lgamma((dof + 1.0) / 2.0) - math.lgamma(dof / 2.0) - 0.5 * math.log(dof * math.pi)
    return np.asarray(scale - 0.5 * (dof + 1.0) * np.log1p(z * z / dof))


def highest(
    value: Callable[[Floats], tuple[float, Floats]], start: Floats, lower: Floats, upper: Floats, steps: int
) -> tuple[float, Floats]:
    """Highest value of a function with its gradient within bounds, and where: BFGS on the parameters that are not at a bound."""
    x = np.clip(start, lower, upper)
    y, slope = value(x)
    curve = np.eye(len(x))
    for _ in range(steps):
        free = ~(((x <= lower) & (slope < 0.0)) | ((x >= upper) & (slope > 0.0)))
        if not np.any(free) or float(np.max(np.abs(slope[free]))) < LEAST_SLOPE:
            break
        step = np.where(free, np.linalg.solve(np.where(np.outer(free, free), curve, np.eye(len(x))), slope), 0.0)
        step *= min(1.0, LONGEST / float(np.max(np.abs(step))))
        share = 1.0
        while share > SHORTEST:
            to = np.clip(x + share * step, lower, upper)
            new, there = value(to)
            if new >= y + 1e-4 * float(slope @ (to - x)):
                break
            share *= 0.3
        if new <= y:
            break
        moved, bent, gained = to - x, slope - there, new - y
        if float(moved @ bent) > 1e-10:
            along = curve @ moved
            curve += np.outer(bent, bent) / float(moved @ bent) - np.outer(along, along) / float(moved @ along)
        x, y, slope = to, new, there
        if gained < 1e-4:
            break
    return y, x


def lowest_by_simplex(
    cost: Callable[[Floats], float], simplex: Floats, most: int, enough: float
) -> tuple[float, Floats]:
    """Lowest cost from a simplex, (k + 1, k), in so many evaluations, or until its corners differ by less than `enough`: Nelder and
    Mead, Computer Journal 7 (1965).
    """
    corners = [(cost(one), one) for one in simplex]
    used = len(corners)
    while used < most:
        corners.sort(key=lambda one: one[0])
        if corners[-1][0] - corners[0][0] < enough:
            break
        worst, second = corners[-1], corners[-2][0]
        middle = np.mean([one for _, one in corners[:-1]], axis=0)
        away = middle - worst[1]
        new = _at(cost, middle + away)
        used += 1
        if new[0] < corners[0][0]:
            further = _at(cost, middle + 2.0 * away)
            used += 1
            corners[-1] = min(new, further, key=lambda one: one[0])
        elif new[0] < second:
            corners[-1] = new
        else:
            outside = new[0] < worst[0]
            nearer = _at(cost, middle + (0.5 if outside else -0.5) * away)
            used += 1
            if nearer[0] <= (new[0] if outside else worst[0]):
                corners[-1] = nearer
            else:
                best = corners[0][1]
                corners[1:] = [_at(cost, best + 0.5 * (one - best)) for _, one in corners[1:]]
                used += len(corners) - 1
    return min(corners, key=lambda one: one[0])


def _at(cost: Callable[[Floats], float], x: Floats) -> tuple[float, Floats]:
    return cost(x), x
