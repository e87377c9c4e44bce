"""Rows hit by something that no column announces: each tenth row, or one in ten at random.

Their mean is too small for the scan, and the limit of outliers takes them for noise. Rows that come back every so many rows are
tested as groups of the scan are, each on its own rows alone. Of rows at random noise of heavy tails has large ones too. More rows
beyond six standard deviations than Student's t with three degrees of freedom has are no noise, whatever their signs (`gross_rows`).
Smaller ones are known by their signs, which noise draws: given the sizes, every choice of signs is as likely. So a wave along the
position on a few rows is compared with the mean of itself over all choices of signs. That ratio has the mean 1 in noise of any
symmetric distribution, and so has its average over many waves. The chance of as large an average is the share of choices of signs
that reach it, of which DRAWS are drawn; it is at most the inverse of the average (Markov's inequality), so that most are not drawn.
That is exact for independent rows; beside a table it is nearly so.
Other columns are not asked there: twenty rows do not carry a search over all of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, fdtrc, logsumexp

from hil.diagnosis.noise.noise_fit import robust_std
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
AGAINST = (0.0, 0.15)
"""Share of the rows that are hit which have the other sign: a table bent by the rows that were hit turns some over."""
DRAWS = 1999
"""Choices of signs drawn: a chance of 0.005 is then known to a third of it."""
WORTH_DRAWING = 5.0
"""Average ratio from which the choices are drawn: of 16 machines of the study hit at random those of a chance below 0.01 have 7."""
HEAVIEST = 0.0075
"""Share far off (`far_off` of the policy, 6) of the heaviest tails that are taken for noise: Student's t with three degrees of
freedom, the fewest that have a variance, where the scale is that of the rows inside `outlier_limit`, 3.2.
"""
TRIMMINGS = 4
MOST_SHARE = 0.35
"""Of the rows, beyond which those outside are not the few."""


@dataclass(frozen=True)
class Hits:
    """Columns that residuals of a few rows follow, those rows, (m,), and the chance of as much in noise."""

    columns: tuple[str, ...]
    rows: NDArray[np.int64]
    probability: float


def every_so_many(null: Null, x: Variable, d: Floats | None) -> Block | None:
    """The clearest wave along the position x on rows that come back every 2nd to 12th row; None where noise does as much."""
    n = len(x.u)
    waves = _waves(x, d)
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
    if score < policy().every_fires_at:
        return None
    directed = d is not None and top >= len(waves) // 2
    names = ("row_order", "target_mm", "direction") if directed else ("row_order", "target_mm")
    return Block(names, design.T, score * np.log(10.0), RATIOS[-1])


def beside_the_bulk(null: Null, raw: Floats) -> tuple[Floats, float]:
    """Errors raw (n,) in µm less what the bulk of the rows gives the null, over the scale of each row, and their robust size."""
    out = np.zeros(len(raw), dtype=np.bool_)
    off, size = raw, 0.0
    for _ in range(TRIMMINGS):
        off = null.linear.projection(null.noise.calm(), raw, null.beside, out).unexplained
        size = robust_std(off[~out] - np.median(off[~out]))
        again = np.abs(off) > policy().outlier_limit * size
        if np.mean(again) > MOST_SHARE:
            break
        out = again
    return off, size


def gross_rows(null: Null, off: Floats, size: float, columns: Sequence[Variable]) -> Hits | None:
    """The rows that lie far off the others, from what `beside_the_bulk` returns; None where heavy tails do as much."""
    if size <= 0.0:
        return None
    far = np.flatnonzero(np.abs(off) > policy().far_off * size).astype(np.int64)
    probability = float(bdtrc(len(far) - 1, len(off), HEAVIEST)) if len(far) else 1.0
    if probability >= policy().false_findings:
        return None
    campaign = null.linear.campaign
    d = campaign.d if campaign.survey.has("direction") else None
    return Hits(_followed(off[far], far, columns, d), far, probability)


def _followed(off: Floats, rows: NDArray[np.int64], columns: Sequence[Variable], d: Floats | None) -> tuple[str, ...]:
    """The column that the residuals (m,) of some rows follow most clearly, with the direction or without; the row order if none.

    Angles are functions of the position: another column must be clearer than that by far.
    """
    best: tuple[float, tuple[str, ...]] = (policy().false_findings, ("row_order",))
    for v in columns:
        waves = v.waves(v.periods(1.0))[:, :, rows].reshape(-1, len(rows)).T
        for sign, names in ((None, (v.name,)), (d, (v.name, "direction"))):
            if sign is None and names[-1] == "direction":
                continue
            ones = np.ones(len(rows)) if sign is None else sign[rows]
            design = np.column_stack([ones, waves * ones[:, None]])
            design = design[:, np.ptp(design, axis=0) + np.abs(design[0]) > 0.0]
            rest = len(rows) - np.linalg.matrix_rank(design)
            if rest < 3:
                continue
            left = off - design @ np.linalg.lstsq(design, off, rcond=None)[0]
            width = len(rows) - rest
            explained = float(off @ off - left @ left)
            ratio = explained / width / max(float(left @ left) / rest, 1e-300)
            chance = float(fdtrc(width, rest, ratio)) * (1 if v.name == "target_mm" else 2 * len(columns))
            best = min(best, (chance, names))
    return best[1]


def hit_rows(x: Variable, d: Floats | None, off: Floats, size: float) -> Hits | None:
    """The rows hit at random by a cause along the position x, from what `beside_the_bulk` returns; None where chance does as much."""
    if size <= 0.0:
        return None
    z = np.clip(off / size, -AMPLITUDES[-1], AMPLITUDES[-1])
    signs, prior = _sign_waves(x, d)
    trials = tuple(itertools.product(AMPLITUDES, SHARES, AGAINST))
    log_ratio = log_ratios(np.abs(z), np.sign(z)[:, None], signs, trials)[:, :, 0]
    average = float(logsumexp(log_ratio, b=prior)) - np.log(len(trials))
    probability = min(float(np.exp(-average)), 1.0)
    if average > np.log(WORTH_DRAWING):
        probability = min(probability, chance_by_signs(z, signs, prior, trials, average))
    if probability >= policy().false_findings:
        return None
    which, best = np.unravel_index(int(np.argmax(log_ratio + np.log(prior))), log_ratio.shape)
    amplitude, share, _ = trials[which]
    odds = share / (1.0 - share) * np.exp(amplitude * signs[best] * z - 0.5 * amplitude**2)
    directed = d is not None and best >= len(signs) // 2
    rows = np.flatnonzero(odds > 1.0).astype(np.int64)
    return Hits(("target_mm", "direction") if directed else ("target_mm",), rows, probability) if len(rows) else None


def log_ratios(size: Floats, sign: Floats, waves: Floats, trials: Sequence[tuple[float, float, float]]) -> Floats:
    """Log likelihood of each wave of ±1 (k, n) on some rows over its mean over all choices of the rows' signs, (trials, k, m).

    size: of the residuals in standard deviations, (n,); sign: m choices of their signs, (n, m); a trial is the amplitude, the share
    of the rows that are hit, and the share of these that have the other sign
    """
    out = np.empty((len(trials), len(waves), sign.shape[1]))
    for i, (amplitude, share, against) in enumerate(trials):
        bare = share * np.exp(-0.5 * amplitude**2)
        mean = np.log1p(bare * np.cosh(amplitude * size) - share)
        wave = np.exp(amplitude * size)
        along = np.log1p(bare * ((1.0 - against) * wave + against / wave) - share) - mean
        opposite = np.log1p(bare * ((1.0 - against) / wave + against * wave) - share) - mean
        out[i] = 0.5 * np.sum(along + opposite) + waves @ (0.5 * (along - opposite)[:, None] * sign)
    return out


def chance_by_signs(
    z: Floats, waves: Floats, prior: Floats, trials: Sequence[tuple[float, float, float]], average: float
) -> float:
    """Chance that the average ratio of residuals z (n,) with signs drawn anew is as large as their own, itself among the draws."""
    drawn = np.sign(z)[:, None] * np.random.default_rng(0).choice((-1.0, 1.0), size=(len(z), DRAWS))
    each = [logsumexp(log_ratios(np.abs(z), drawn, waves, [trial])[0], b=prior[:, None], axis=0) for trial in trials]
    by_signs = logsumexp(np.array(each), axis=0) - np.log(len(trials))
    rounding = 1e-9
    return float((1 + np.sum(by_signs >= average - rounding)) / (1 + DRAWS))


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
