"""What is left after the search, of whatever form: a null, a scan of waves and the evidence of blocks, in this order.

No family of causes is written down here; what carries the rest is named by its columns and given its size.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder import block as blocks
from hil.diagnosis.remainder import scan as waves
from hil.diagnosis.remainder.block import Block
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.scan import Group, Scan, Variable
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.judge import Hit
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.search.structure_estimate import places_of
from hil.effects import Estimate
from hil.effects.base import slopes_of

Floats = NDArray[np.float64]

MOST_ROUNDS = 3
"""Most times that the rest is scanned again beside what was found in it."""
CONTENDING = 6
"""Sets of columns of the best groups that are compared by their evidence."""


@dataclass(frozen=True)
class LeftOver:
    """Something is left: the columns that carry it, columns that move together with one of them, its size and its values.

    equivalent: by column; rms: beside the table, µm; values_um: the same at the rows, (n,)
    extra: its columns for a fit; probability: of as much in noise, with the number of tests
    """

    columns: tuple[str, ...]
    equivalent: dict[str, tuple[str, ...]]
    rms: Estimate
    values_um: Floats
    extra: Extra
    probability: float


def left_over(
    searcher: Searcher, choices: Sequence[Choice], noise: Noise, without: Sequence[Hit] = ()
) -> tuple[LeftOver, ...]:
    """What is left beside some choices and everything else in the searcher's fits and is more than noise, largest first.

    without: structures among the searcher's nuisance columns that are to be found again and sized here
    """
    campaign = searcher.linear.campaign
    columns = waves.variables(campaign)
    if not columns:
        return ()
    beside = _beside(searcher, choices, noise, without)
    linear = LinearCampaign(campaign)
    null = Null.of(linear, searcher.y, beside, noise)
    d = campaign.d if campaign.survey.has("direction") else None
    found: dict[tuple[str, ...], list[Floats]] = {}
    sure: dict[tuple[str, ...], float] = {}
    for _ in range(MOST_ROUNDS):
        scanned = waves.scan(null, columns)
        best = _clearest_block(null, columns) if scanned.score < policy().scan_fires_at else None
        if scanned.score < policy().scan_fires_at and best is None:
            break
        carried = _carried(null, columns, scanned, best, d)
        probability = min(10.0**-scanned.score, math.exp(-max(carried.evidence, 0.0)))
        own = blocks.outside_table(null, carried)
        if not own.shape[1]:
            break
        found.setdefault(carried.columns, []).append(own)
        sure.setdefault(carried.columns, probability)
        null = null.plus(own)
    parts = {name: np.hstack(own) for name, own in found.items()}
    fitted = blocks.fitted(linear, searcher.raw, beside, noise, list(parts.values()))
    out = [
        LeftOver(
            name,
            {one: alike for one in name if (alike := _equivalent(one, columns))},
            part.rms,
            part.values_um,
            Extra(part.columns[:, :0], part.columns),
            sure[name],
        )
        for name, part in zip(parts, fitted, strict=True)
    ]
    largest = max((one.rms.value for one in out), default=0.0)
    return tuple(
        sorted((one for one in out if one.rms.value >= policy().minor * largest), key=lambda one: -one.rms.value)
    )


def _beside(searcher: Searcher, choices: Sequence[Choice], noise: Noise, without: Sequence[Hit]) -> Extra:
    """The columns of every fit and of the choices, with the slopes to their parameters: the effects are linearised there."""
    campaign = searcher.linear.campaign
    extra = searcher.extra(choices)
    if without:
        gone = np.concatenate(places_of(extra.random, without))
        extra = Extra(extra.free, np.delete(extra.random, gone, axis=1))
    fit = searcher.fit(choices, noise, uncertain=False)
    for choice, term in zip(choices, fit.found, strict=True):
        if choice.theta and not choice.form.shrunk:
            slopes = slopes_of(campaign.columns, choice, np.array(term.coefficients))
            size = np.linalg.norm(slopes, axis=0)
            slopes = slopes[:, size > 0.0] / size[size > 0.0]
            extra = extra.plus(Extra(slopes, slopes[:, :0]))
    return extra


def _clearest_block(null: Null, columns: Sequence[Variable]) -> Block | None:
    """The block of highest evidence, of one column or of two, if that is beyond noise under every noise model."""
    best: Block | None = None
    alone = [(v, None) for v in columns if v.name != "target_mm"]
    for first, second in [*alone, *itertools.combinations(columns, 2)]:
        names = (first.name,) if second is None else (first.name, second.name)
        trial = blocks.block(null, names, blocks.design_of(first, second, None))
        if trial.evidence > policy().block_fires_at and (best is None or trial.evidence > best.evidence):
            best = trial
    if best is None:
        return None
    sure = blocks.block(null, best.columns, best.design, surely=True)
    return best if sure.evidence > policy().block_fires_at else None


def _carried(null: Null, columns: Sequence[Variable], found: Scan, best: Block | None, d: Floats | None) -> Block:
    """The set of columns of highest evidence among those of the best groups, and the block that fired."""
    named = {v.name: v for v in columns}
    sets: dict[tuple[str, ...], list[Group]] = {}
    for group, _ in found.best:
        sets.setdefault(group.columns, []).append(group)
    trials = [] if best is None else [best]
    for names, groups in list(sets.items())[:CONTENDING]:
        plain = [named[name] for name in names if name != "direction"]
        directed = d if "direction" in names else None
        design = blocks.design_of(plain[0], plain[1] if len(plain) > 1 else None, directed, (groups[0],))
        trials.append(blocks.block(null, names, design))
    if best is not None:
        trials += [
            blocks.block(null, (name,), blocks.design_of(named[name], None, None))
            for name in best.columns
            if name in named and name != "target_mm"
        ]
    return max(trials, key=lambda trial: trial.evidence - policy().simpler * len(trial.columns))


def _equivalent(name: str, columns: Sequence[Variable]) -> tuple[str, ...]:
    """Other columns of which this one is a smooth function."""
    mine = next((v.u for v in columns if v.name == name), None)
    if mine is None or name == "target_mm":
        return ()
    out = []
    for other in columns:
        if other.name in (name, "target_mm"):
            continue
        cubic = np.vander(np.clip(other.u, -0.5, 1.5), 4)
        rest = mine - cubic @ np.linalg.lstsq(cubic, mine, rcond=None)[0]
        if np.var(rest) < (1.0 - policy().equivalent) * np.var(mine):
            out.append(other.name)
    return tuple(out)
