"""What is left after the search, of whatever form: a null, a scan of waves and the evidence of blocks, in this order.

No family of causes is written down here; what carries the rest is named by its columns and given its size.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder import block as blocks
from hil.diagnosis.remainder import scan as waves
from hil.diagnosis.remainder.block import Block
from hil.diagnosis.remainder.hits import every_so_many, hit_rows
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.one_run import in_one_run
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

    equivalent: by column; rms: beside the table, µm
    extra: its columns for a fit; probability: of as much in noise, with the number of tests
    """

    columns: tuple[str, ...]
    equivalent: dict[str, tuple[str, ...]]
    rms: Estimate
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
    x = next((v for v in columns if v.name == "target_mm" and not v.levels), None)
    found: dict[tuple[str, ...], list[Floats]] = {}
    sure: dict[tuple[str, ...], float] = {}
    for _ in range(MOST_ROUNDS):
        scanned = waves.scan(null, columns)
        best = _clearest_block(null, columns, x, d) if scanned.score < policy().scan_fires_at else None
        carried: Block | None = None
        if scanned.score >= policy().scan_fires_at or best is not None:
            carried = _carried(null, columns, scanned, best, d)
        elif x is not None and not found:
            carried = in_one_run(null, searcher.raw, x, d) or every_so_many(null, x, d)
        if carried is None:
            break
        probability = min(10.0**-scanned.score, math.exp(-max(carried.evidence, 0.0)))
        own = blocks.outside_table(null, carried)
        if not own.shape[1]:
            break
        found.setdefault(carried.columns, []).append(own)
        sure.setdefault(carried.columns, probability)
        null = null.plus(own)
    if not found:
        return () if x is None else _of_hit_rows(null, x, d, searcher.raw)
    parts = {name: np.hstack(own) for name, own in found.items()}
    fitted = blocks.fitted(linear, searcher.raw, beside, noise, list(parts.values()))
    out = [
        LeftOver(
            name,
            {one: alike for one in name if (alike := _equivalent(one, columns))},
            part.rms,
            Extra(part.columns[:, :0], part.columns),
            sure[name],
        )
        for name, part in zip(parts, fitted, strict=True)
    ]
    largest = max((one.rms.value for one in out), default=0.0)
    return tuple(
        sorted((one for one in out if one.rms.value >= policy().minor * largest), key=lambda one: -one.rms.value)
    )


def _of_hit_rows(null: Null, x: Variable, d: Floats | None, raw: Floats) -> tuple[LeftOver, ...]:
    """What a part of the rows has and the others have not, with the rows as its columns; none where chance does as much."""
    hit = hit_rows(null, x, d)
    if hit is None:
        return ()
    rows = hit.rows
    white = null.linear.projection(null.noise, raw / null.scale, null.beside).rest * null.scale
    usual_um = 1.4826 * float(np.median(np.abs(np.delete(white, rows))))
    rms = math.sqrt(max(float(np.sum(white[rows] ** 2)) - len(rows) * usual_um**2, 0.0) / len(raw))
    size = float(np.max(np.abs(white[rows]))) / usual_um
    alone = np.zeros((len(raw), len(rows)))
    alone[rows, np.arange(len(rows))] = size
    std = rms / math.sqrt(2.0 * len(rows))
    return (LeftOver(hit.columns, {}, Estimate(rms, std), Extra(alone[:, :0], alone), hit.probability),)


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


def _clearest_block(null: Null, columns: Sequence[Variable], x: Variable | None, d: Floats | None) -> Block | None:
    """The block of highest evidence, of one column, of two or of a process, if that is beyond noise under every noise model."""
    best: Block | None = None
    time = next((v for v in columns if v.name == null.linear.campaign.survey.time_column and not v.levels), None)
    processes = () if time is None else _processes(time, x, d)
    for names, design in itertools.chain(_smooth(columns), processes):
        trial = blocks.block(null, names, design)
        if trial.evidence > policy().block_fires_at and (best is None or trial.evidence > best.evidence):
            best = trial
    if best is None:
        return None
    sure = blocks.block(null, best.columns, best.design, surely=True)
    return best if sure.evidence > policy().block_fires_at else None


def _smooth(columns: Sequence[Variable]) -> Iterator[tuple[tuple[str, ...], Floats]]:
    """Names and design of each column and of each pair of columns."""
    for v in columns:
        if v.name != "target_mm":
            yield (v.name,), blocks.design_of(v, None, None)
    for first, second in itertools.combinations(columns, 2):
        yield (first.name, second.name), blocks.design_of(first, second, None)


def _processes(time: Variable, x: Variable | None, d: Floats | None) -> Iterator[tuple[tuple[str, ...], Floats]]:
    """The same of a process in time that multiplies the direction, or a wave along the position, with the direction or without."""
    yield (time.name,), blocks.process_of(np.ones((len(time.u), 1)), time)
    if d is not None:
        yield (time.name, "direction"), blocks.process_of(d[:, None], time)
    for wave in () if x is None else x.waves(x.periods(waves.FINE_POSITION)):
        yield ("target_mm", time.name), blocks.process_of(wave.T, time)
        if d is not None:
            yield ("target_mm", time.name, "direction"), blocks.process_of(wave.T * d[:, None], time)


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
