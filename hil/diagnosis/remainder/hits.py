"""Rows hit by something that follows the position and that no column announces: one row in ten, each tenth, at random.

Their mean is too small for the scan, and the limit of outliers takes them for noise. Noise of heavy tails has large rows too, but its
signs are drawn: given their sizes, every choice of signs is as likely. So waves along the position are fitted to the large rows, and
the clearest of them is compared with the clearest of the same rows with signs drawn at random. Other columns are not asked: twenty
rows do not carry a search over all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.policy import policy
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.scan import Variable

Floats = NDArray[np.float64]

MOST_PERIODS = 6.5
"""Most periods of a wave along a column."""
LEAST_HIT = 8
"""Fewest large rows: with fewer, one choice of signs in 2⁷ is like any other."""
DRAWS = 2000
"""Choices of signs that are drawn."""


@dataclass(frozen=True)
class Hits:
    """Columns along which large residuals of a few rows follow a wave, those rows, (m,), and the chance of as much in noise."""

    columns: tuple[str, ...]
    rows: NDArray[np.int64]
    probability: float


def hit_rows(null: Null, x: Variable, d: Floats | None) -> Hits | None:
    """The rows hit by a cause along the position x; None where chance does as much."""
    rest = null.best.rest
    size = np.abs(rest - np.median(rest))
    rows = np.flatnonzero(size > policy().hit * 1.4826 * float(np.median(size)))
    if len(rows) < LEAST_HIT:
        return None
    plain = x.waves(x.periods(MOST_PERIODS))[..., rows]  # (periods, 2, m)
    waves = (plain if d is None else np.concatenate([plain, plain * d[rows]])) * rest[rows]
    signs = np.where(np.random.default_rng(len(rows)).random((DRAWS, len(rows))) < 0.5, 1.0, -1.0)
    clear = np.sum(np.sum(waves, axis=2) ** 2, axis=1)
    by_chance = np.sum((signs @ waves.transpose(0, 2, 1)) ** 2, axis=2)  # (periods, draws)
    best = int(np.argmax(clear))
    probability = float(np.mean(np.max(by_chance, axis=0) >= clear[best]))
    if probability >= policy().false_hits:
        return None
    return Hits(("target_mm",) if best < len(plain) else ("target_mm", "direction"), rows.astype(np.int64), probability)
