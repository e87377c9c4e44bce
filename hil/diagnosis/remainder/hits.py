"""Rows hit by something that follows the position and that no column announces: each tenth row, or one in ten at random.

Their mean is too small for the scan, and the limit of outliers takes them for noise. Rows that come back every so many rows are
tested as groups of the scan are, each on its own rows alone. Of rows at random noise of heavy tails has large ones too, but its signs
are drawn: given the sizes, every choice of signs is as likely. So a wave along the position on a few rows is compared with the mean
of itself over all choices of signs. That ratio has the mean 1 in noise of any symmetric distribution, and so has its average over
many waves; it exceeds 1 / p with a chance of p at most (Markov's inequality). Other columns are not asked: twenty rows do not carry a
search over all of them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from hil.diagnosis.policy import policy
from hil.diagnosis.remainder.block import RATIOS, Block
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.scan import Variable, log10_probability

Floats = NDArray[np.float64]

MOST_PERIODS = 6.5
"""Most periods of a wave along a column."""
MOST_EVERY = 12
"""Most rows from one hit row to the next: a rack of a dozen places, a pole pair, a shift's rhythm."""
PHASES = 12
SHARES = (0.03, 0.1, 0.3)
"""Parts of the rows that may be hit."""
AMPLITUDES = (2.0, 3.0, 4.5)
"""Amplitudes of a wave on them, in standard deviations of the noise; sizes of residuals beyond the largest count as that."""


@dataclass(frozen=True)
class Hits:
    """Columns along which residuals of a few rows follow a wave, those rows, (m,), and the chance of as much in noise."""

    columns: tuple[str, ...]
    rows: NDArray[np.int64]
    probability: float


def every_so_many(null: Null, x: Variable, d: Floats | None) -> Block | None:
    """The clearest wave along the position x on rows that come back every 2nd to 12th row; None where noise does as much."""
    n = len(x.u)
    waves = _waves(x, d) / null.scale
    every = [(k, first) for k in range(2, MOST_EVERY + 1) for first in range(k)]
    scores = np.empty((len(every), len(waves)))
    for i, (k, first) in enumerate(every):
        on = (np.arange(n) % k == first).astype(np.float64)
        designs = (waves * on).astype(np.float32)
        scores[i] = -log10_probability(null.best, designs)
    best, top = np.unravel_index(int(np.argmax(scores)), scores.shape)
    k, first = every[best]
    design = waves[top] * (np.arange(n) % k == first)
    others = [-float(log10_probability(model, design[None].astype(np.float32))[0]) for model in null.nearly_as_good]
    score = min([float(scores[best, top]), *others]) - float(np.log10(scores.size))
    if score < policy().scan_fires_at:
        return None
    directed = d is not None and top >= len(waves) // 2
    names = ("row_order", "target_mm", "direction") if directed else ("row_order", "target_mm")
    return Block(names, design.T * null.scale[:, None], score * np.log(10.0), RATIOS[-1])


def hit_rows(null: Null, x: Variable, d: Floats | None) -> Hits | None:
    """The rows hit at random by a cause along the position x; None where chance does as much."""
    rest = null.best.rest
    size = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
    if size <= 0.0:
        return None
    z = np.clip(rest / size, -AMPLITUDES[-1], AMPLITUDES[-1])
    signs, prior = _sign_waves(x, d)
    trials, ratios = tuple(itertools.product(AMPLITUDES, SHARES)), []
    for amplitude, share in trials:
        wave = amplitude * signs
        bare = share * np.exp(-0.5 * amplitude**2)
        hit = np.log1p(bare * np.exp(wave * z) - share) - np.log1p(bare * np.cosh(amplitude * z) - share)
        ratios.append(np.sum(hit, axis=1))
    log_ratio = np.array(ratios)
    probability = float(np.exp(min(np.log(len(ratios)) - logsumexp(log_ratio, b=prior), 0.0)))
    if probability >= policy().false_hits:
        return None
    which, best = np.unravel_index(int(np.argmax(log_ratio + np.log(prior))), log_ratio.shape)
    amplitude, share = trials[which]
    odds = share / (1.0 - share) * np.exp(amplitude * signs[best] * z - 0.5 * amplitude**2)
    directed = d is not None and best >= len(signs) // 2
    rows = np.flatnonzero(odds > 1.0).astype(np.int64)
    return Hits(("target_mm", "direction") if directed else ("target_mm",), rows, probability) if len(rows) else None


def _sign_waves(x: Variable, d: Floats | None) -> tuple[Floats, Floats]:
    """Square waves of ±1 along the position at PHASES phases, then the same with the direction, (k, n), and the prior of each, (k,).

    The first number of periods is none at all. A wave of many periods is less likely, as the square of their number.
    """
    periods = np.concatenate([[0.0], x.periods(MOST_PERIODS)])
    turns = periods[:, None, None] * x.u - np.arange(PHASES)[None, :, None] / PHASES
    plain = np.where(np.cos(2.0 * np.pi * turns) >= 0.0, 1.0, -1.0).reshape(-1, len(x.u))
    prior = np.repeat(1.0 / (1.0 + periods**2), PHASES)
    signs, prior = (plain, prior) if d is None else (np.concatenate([plain, plain * d]), np.tile(prior, 2))
    return signs, prior / np.sum(prior)


def _waves(x: Variable, d: Floats | None) -> Floats:
    """Cosine and sine of each number of periods, then the same with the direction, (k, 2, n)."""
    plain = x.waves(x.periods(MOST_PERIODS))
    return np.asarray(plain if d is None else np.concatenate([plain, plain * d]), dtype=np.float64)
