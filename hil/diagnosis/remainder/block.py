"""The evidence that a smooth function of one or two columns is left: one random effect of all products of their harmonics.

The scan asks for one wave; a hinge times a hinge spreads over many. Here they act together, with variances that fall with the
number of periods, so that the evidence (marginal likelihood) pays for what it uses and says which columns carry the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf

from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.scan import Group, Variable
from hil.diagnosis.search.structure_estimate import rms_of
from hil.effects import Estimate

Floats = NDArray[np.float64]

MOST_PERIODS = 2.5
FINE_POSITION = 6.5
"""Periods along the position up to which a function is resolved whose columns are to be named."""
RATIOS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Variances of the block tried, over that of the white noise."""
SMALL = 0.3
"""Squared norm, over the white noise's variance, below which a direction of a block is below a row's noise and is left out."""
PROCESS_PERIODS = 12
"""Periods over the campaign up to which a process in time is resolved."""
HALF_POWER = 3.0
"""Periods at which the power of such a process has fallen to half: a state that switches every tenth of the campaign has 3.2."""
FALLING = 3.0
"""Log evidence below the best at which larger variances are not tried."""


@dataclass(frozen=True)
class Block:
    """A function of some columns: its design (n, r) of falling variance, log evidence over none, and its variance ratio."""

    columns: tuple[str, ...]
    design: Floats
    evidence: float
    variance: float

    @property
    def scaled(self) -> Floats:
        """The design as random columns of unit variance ratio, (n, r)."""
        return np.asarray(self.design * np.sqrt(self.variance), dtype=np.float64)


@dataclass(frozen=True)
class Fitted:
    """What some columns carry beside the table: random columns of unit variance ratio, (n, r), and RMS over the rows, µm, with its
    uncertainty.
    """

    columns: Floats
    rms: Estimate


def harmonics(variable: Variable, most: float = MOST_PERIODS) -> tuple[Floats, Floats]:
    """A constant and the waves or steps along a column, (n, r), and the square of each one's periods, 0 for steps, (r,)."""
    periods = variable.periods(most)
    values = variable.waves(periods).reshape(-1, len(variable.u)).T
    fall = np.zeros(len(periods)) if variable.levels else periods**2
    return np.column_stack([np.ones(len(variable.u)), values]), np.concatenate([[0.0], np.repeat(fall, 2)])


def design_of(
    first: Variable,
    second: Variable | None,
    direction: Floats | None,
    waves: tuple[Group, ...] = (),
    *,
    fine: bool = False,
) -> Floats:
    """Columns of a block, (n, r): all products, times the direction where it is given, and some single groups of the scan.

    fine: whether the position is resolved to FINE_POSITION
    """
    most = [
        FINE_POSITION if fine and one is not None and one.name == "target_mm" else MOST_PERIODS
        for one in (first, second)
    ]
    values, falls = harmonics(first, most[0])
    if second is not None:
        other, more = harmonics(second, most[1])
        values = (values[:, :, None] * other[:, None, :]).reshape(len(values), -1)
        falls = (falls[:, None] + more[None, :]).ravel()
    scaled = (values / np.sqrt(1.0 + falls))[:, 1:]
    if direction is not None:
        scaled = scaled * direction[:, None]
    extra = [group.design(np.ones(len(values)) if direction is None else direction) for group in waves]
    return np.hstack([scaled, *extra])


def process_of(waves: Floats, time: Variable) -> Floats:
    """Columns of a process in time that multiplies some waves (n, w), (n, r): a state that nobody logs, which switches or wanders."""
    periods = np.arange(1.0, PROCESS_PERIODS + 1.0)
    course = time.waves(periods).reshape(-1, len(time.u)).T / np.repeat(np.hypot(1.0, periods / HALF_POWER), 2)
    course = np.column_stack([np.ones(len(course)), course])
    return np.asarray((waves[:, :, None] * course[:, None, :]).reshape(len(course), -1)[:, 1:], dtype=np.float64)


def evidence_of(projection: Projection, design: Floats) -> tuple[float, float]:
    """Log evidence of a design (n, r) as one random effect, and its best variance ratio."""
    w = projection.prepared(design)
    shadow = projection.shadow(w)
    normal = w.T @ w - shadow.T @ shadow
    b = w.T @ projection.rest
    wide = np.block([[normal, b[:, None]], [b[None, :], np.zeros((1, 1))]])
    best = (0.0, RATIOS[0])
    for ratio in RATIOS:
        gain = _gain(wide, ratio, float(projection.rss), projection.dof)
        if gain < best[0] - FALLING and ratio > RATIOS[1]:
            break
        best = max(best, (gain, ratio))
    return best


def _gain(wide: Floats, ratio: float, rss: float, dof: int) -> float:
    """Log evidence at one variance ratio, from the normal equations bordered by their right side, (r + 1, r + 1)."""
    r = len(wide) - 1
    bordered = np.asarray(ratio * wide, order="F")
    bordered[r] *= 1.0 / math.sqrt(ratio)
    bordered[:, r] *= 1.0 / math.sqrt(ratio)
    diagonal = np.einsum("ii->i", bordered)  # a view
    diagonal[:r] += 1.0
    diagonal[r] = rss
    factor, failed = dpotrf(bordered, lower=1, clean=0, overwrite_a=1)
    root = np.einsum("ii->i", factor)
    left = 1e-12 if failed else max(float(root[r]) ** 2 / rss, 1e-12)
    return -0.5 * dof * math.log(left) - float(np.log(root[:r]).sum())


def block(null: Null, columns: tuple[str, ...], design: Floats) -> Block:
    """The evidence of a design (n, r), under the best noise model."""
    return Block(columns, design, *evidence_of(null.best, design))


def sure_evidence(null: Null, found: Block) -> float:
    """The least evidence of a block under every noise model nearly as good."""
    return min([found.evidence, *(evidence_of(projection, found.design)[0] for projection in null.nearly_as_good)])


def share_by_signs(null: Null, found: Block) -> float:
    """Share of the draws of the signs of the rows in which a block of this variance has at least its evidence: few in even noise, many
    where it is made of a few rows that vary more than the others.
    """
    rest, rss = null.signs_anew
    w = null.best.prepared(found.scaled)
    shadow = null.best.shadow(w)
    factor = np.linalg.cholesky(w.T @ w - shadow.T @ shadow + np.eye(w.shape[1]))
    explained = np.sum(np.linalg.solve(factor, w.T @ rest) ** 2, axis=0)
    left = np.maximum(1.0 - explained / rss, 1e-12)
    odds = -0.5 * null.best.dof * np.log(left) - float(np.sum(np.log(np.diag(factor))))
    return float(np.mean(odds >= found.evidence))


def outside_table(null: Null, found: Block) -> Floats:
    """A block as few random columns of unit variance ratio, (n, r), without what the table can hold: that stays the table's."""
    table = null.linear.table
    width = table.table_width
    columns = table.stacked[:, :width]
    normal = columns.T @ columns + np.diag(table.ridge(null.noise)[:width]) + 1e-9 * np.eye(width)
    design = found.scaled
    rest = design - columns @ np.linalg.solve(normal, columns.T @ design)
    values, vectors = np.linalg.eigh(rest.T @ rest)
    kept = values > SMALL
    return np.asarray(rest @ vectors[:, kept])


def fitted(linear: LinearCampaign, y: Floats, beside: Extra, noise: Noise, parts: Sequence[Floats]) -> list[Fitted]:
    """Each set of random columns (n, r), estimated together from the errors y (n,) in µm, not limited.

    The null is made again with them: what they carry was in the scale of the rows, in their offsets and in their memory.
    """
    if not parts:
        return []
    null = Null.of(linear, y, Extra(beside.free, np.hstack([*parts, beside.random])), noise)
    alone = replace(null, beside=beside)
    ratios = [evidence_of(alone.best, part)[1] for part in parts]
    parts = [part * math.sqrt(ratio) for part, ratio in zip(parts, ratios, strict=True)]
    projection = alone.plus(np.hstack(parts)).best
    solution = projection.solve(np.zeros((len(y), 0)))
    posterior = projection.inverse_lower.T @ projection.inverse_lower * solution.variance
    ones = np.ones((len(y), 1))
    out = []
    start = projection.whitened.table.shape[1]
    for part in parts:
        place = slice(start, start + part.shape[1])
        rms = rms_of(part, solution.table[place], posterior[place, place], ones, shrunk=True)
        out.append(Fitted(part, rms))
        start += part.shape[1]
    return out
