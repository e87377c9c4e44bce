"""What is left after the search, of whatever form: a null, a scan of waves and the evidence of blocks, in this order.

No family of causes is written down here; what carries the rest is named by its columns and given its size.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise
from hil.diagnosis.noise.noise_fit import robust_std
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder import block as blocks
from hil.diagnosis.remainder import scan as waves
from hil.diagnosis.remainder.block import Block
from hil.diagnosis.remainder.carriers import Carried, carried
from hil.diagnosis.remainder.hits import beside_the_bulk, every_so_many, gross_rows, hit_rows
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.one_run import in_one_run
from hil.diagnosis.remainder.scan import Variable
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.judge import Hit
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.search.structure_estimate import places_of
from hil.effects import Estimate
from hil.effects.base import slopes_of

Floats = NDArray[np.float64]

MOST_ROUNDS = 3
"""Most times that the rest is scanned again beside what was found in it."""


@dataclass(frozen=True)
class LeftOver:
    """Something is left: the columns that carry it, columns that move together with one of them, its size and its values.

    equivalent: by column; rms: beside the table, µm
    extra: its columns for a fit; probability: of as much in noise, of a wave with the number of waves, of a smooth function by itself
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
    beside = _beside(searcher, choices, noise, [hit.extra for hit in without])
    linear = LinearCampaign(campaign)
    null = Null.of(linear, searcher.y, beside, noise)
    d = campaign.d if campaign.survey.has("direction") else None
    x = next((v for v in columns if v.name == "target_mm" and not v.levels), None)
    found: dict[tuple[str, ...], list[Floats]] = {}
    sure: dict[tuple[str, ...], float] = {}
    equivalent: dict[tuple[str, ...], dict[str, tuple[str, ...]]] = {}
    for _ in range(MOST_ROUNDS):
        scanned = waves.scan(null, columns)
        best: Block | None = None
        chance = 10.0**-scanned.score
        if scanned.score < policy().scan_fires_at:
            best, chance = clearest_block(null, waves.variables(campaign, signed=True), x, d)
        carrier: Carried | None = None
        if scanned.score >= policy().scan_fires_at or best is not None:
            carrier = carried(null, columns, scanned, best, d)
        elif x is not None and not found:
            other = in_one_run(null, searcher.raw, x, d) or every_so_many(null, x, d)
            carrier, chance = (None, 1.0) if other is None else (Carried(other, {}), math.exp(-other.evidence))
        if carrier is None:
            break
        block = carrier.block
        own = blocks.outside_table(null, block)
        if not own.shape[1]:
            break
        name = next((one for one in found if is_part_of(one, equivalent[one], carrier)), block.columns)
        found.setdefault(name, []).append(own)
        sure.setdefault(name, chance)
        equivalent.setdefault(name, carrier.equivalent)
        null = null.plus(own)
    if not found:
        return _of_hit_rows(null, columns, d, searcher.raw)
    parts = {name: np.hstack(own) for name, own in found.items()}
    fitted = blocks.fitted(linear, searcher.raw, beside, noise, list(parts.values()))
    out = [
        LeftOver(
            name,
            equivalent[name],
            part.rms,
            Extra(part.columns[:, :0], part.columns),
            sure[name],
        )
        for name, part in zip(parts, fitted, strict=True)
    ]
    largest = max((one.rms.value for one in out), default=0.0)
    return tuple(
        sorted((one for one in out if one.rms.value >= policy().shape * largest), key=lambda one: -one.rms.value)
    )


def sized(
    searcher: Searcher, choices: Sequence[Choice], noise: Noise, left: Sequence[LeftOver]
) -> tuple[LeftOver, ...]:
    """What is left, among the searcher's nuisance columns, with its size beside some choices, largest first."""
    beside = _beside(searcher, choices, noise, [one.extra for one in left])
    parts = [one.extra.random for one in left]
    fitted = blocks.fitted(LinearCampaign(searcher.linear.campaign), searcher.raw, beside, noise, parts)
    again = (replace(one, rms=part.rms) for one, part in zip(left, fitted, strict=True))
    return tuple(sorted(again, key=lambda one: -one.rms.value))


def is_part_of(known: tuple[str, ...], equivalent: dict[str, tuple[str, ...]], carrier: Carried) -> bool:
    """Whether a carrier's columns are among those of one found before, or move with them: then both are parts of one cause."""
    columns = carrier.block.columns
    return any(
        all(
            one == other or one in equivalent.get(other, ()) or other in carrier.equivalent.get(one, ())
            for one, other in zip(columns, order, strict=True)
        )
        for order in itertools.permutations(known, len(columns))
    )


def _of_hit_rows(null: Null, columns: Sequence[Variable], d: Floats | None, raw: Floats) -> tuple[LeftOver, ...]:
    """What a part of the rows has and the others have not, with the rows as its columns; none where chance does as much."""
    off, size = beside_the_bulk(null, raw)
    hit = gross_rows(null, off, size, columns)
    if hit is None:
        x = next((v for v in columns if v.name == "target_mm" and not v.levels), None)
        hit = None if x is None else hit_rows(x, d, off, size)
    if hit is None:
        return ()
    off = off * null.scale
    rows = hit.rows
    usual_um = robust_std(np.delete(off, rows))
    rms = math.sqrt(max(float(np.sum(off[rows] ** 2)) - len(rows) * usual_um**2, 0.0) / len(raw))
    largest = float(np.max(np.abs(off[rows]))) / usual_um
    alone = np.zeros((len(raw), len(rows)))
    alone[rows, np.arange(len(rows))] = largest
    std = rms / math.sqrt(2.0 * len(rows))
    return (LeftOver(hit.columns, {}, Estimate(rms, std), Extra(alone[:, :0], alone), hit.probability),)


def _beside(searcher: Searcher, choices: Sequence[Choice], noise: Noise, without: Sequence[Extra]) -> Extra:
    """The columns of every fit and of the choices, with the slopes to their parameters: the effects are linearised there.

    without: columns among them that are left out
    """
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


def clearest_block(
    null: Null, columns: Sequence[Variable], x: Variable | None, d: Floats | None
) -> tuple[Block | None, float]:
    """The block of one column, of two or of a process that is farthest beyond the limit of its kind, under every noise model and
    beyond what the sizes of the rows alone make, with its probability in noise by itself; None and 1 where there is none.
    """
    time = next((v for v in columns if v.name == null.linear.campaign.survey.time_column and not v.levels), None)
    kinds = [(_smooth(columns, d), policy().block_fires_at), (_processes(time, x, None), policy().process_fires_at)]
    if d is not None:
        kinds.append((_processes(time, x, d), policy().directed_process_fires_at))
    best: list[tuple[float, Block, float]] = []
    for designs, limit in kinds:
        trials = (blocks.block(null, *one) for one in designs)
        clear = sorted((one for one in trials if one.evidence > limit), key=lambda one: -one.evidence)
        sure = ((one.evidence - limit, one, blocks.sure_evidence(null, one)) for one in clear)
        even = (one for one in sure if one[2] > limit and blocks.share_by_signs(null, one[1]) < policy().by_signs)
        best += itertools.islice(even, 1)
    if not best:
        return None, 1.0
    _, clearest, evidence = max(best, key=lambda one: one[0])
    return clearest, math.exp(-evidence)


def _smooth(columns: Sequence[Variable], d: Floats | None) -> Iterator[tuple[tuple[str, ...], Floats]]:
    """Names and design of each column, with the direction and without, and of each pair of columns."""
    for v in columns:
        if v.name != "target_mm":
            yield (v.name,), blocks.design_of(v, None, None)
            if d is not None and v.name != "velocity_mm_s":  # times the direction it is the speed
                yield (v.name, "direction"), blocks.design_of(v, None, d)
    for first, second in itertools.combinations(columns, 2):
        names = first.name, second.name
        yield names, blocks.design_of(first, second, None)
        if "target_mm" in names:
            yield names, blocks.design_of(first, second, None, fine=True)


def _processes(time: Variable | None, x: Variable | None, d: Floats | None) -> Iterator[tuple[tuple[str, ...], Floats]]:
    """Names and design of a process in time, alone and times each wave along the position; all times the direction d where given."""
    if time is None:
        return
    sign = np.ones(len(time.u)) if d is None else d
    more = () if d is None else ("direction",)
    yield (time.name, *more), blocks.process_of(sign[:, None], time)
    for wave in () if x is None else x.waves(x.periods(waves.FINE_POSITION)):
        yield ("target_mm", time.name, *more), blocks.process_of(wave.T * sign[:, None], time)
