"""Numerics of small problems, written here because the start of SciPy takes as long as a diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

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


def inverse_of_lower(lower: NDArray[np.floating[Any]]) -> Floats:
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
