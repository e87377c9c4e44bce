"""Whether what an effect was taken for is explained better by a smooth function of other columns.

The search compares effects with one another and with polynomials; a bump along a pressure that passes it once resembles a jump of the
reading far more than any of those. Here the evidence of each effect meets that of the blocks, beside everything else that was found
and in the same noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder import block as blocks
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.scan import Variable, variables
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.searcher import Searcher


def beaten(searcher: Searcher, choices: Sequence[Choice], noise: Noise) -> dict[str, tuple[str, ...]]:
    """Effects that a smooth function of other columns beats, by id, with those columns."""
    if not choices:
        return {}
    campaign = searcher.linear.campaign
    columns = variables(campaign)
    whole = Null.of(LinearCampaign(campaign), searcher.y, searcher.extra(choices), noise)
    out = {}
    for name in dict.fromkeys(choice.effect.id for choice in choices):
        mine = [choice for choice in choices if choice.effect.id == name]
        others = searcher.extra([choice for choice in choices if choice.effect.id != name])
        s = whole.scale[:, None]
        null = replace(whole, beside=Extra(others.free / s, others.random / s)).best
        own = {"target_mm", "direction"}.union(*(choice.form.inputs for choice in mine))
        least = _evidence(null, mine, whole) + policy().beaten
        best = max(
            (
                (blocks.evidence_of(null, blocks.design_of(a, b, None) / s)[0], names)
                for names, a, b in _pairs(columns, own)
            ),
            default=(0.0, ()),
        )
        if best[0] > least:
            out[name] = best[1]
    return out


def _evidence(null: Projection, mine: Sequence[Choice], whole: Null) -> float:
    """Log evidence of the terms of one effect over none."""
    extra = Extra.none(len(whole.y))
    for choice in mine:
        extra = extra.plus(choice.extra(whole.linear.campaign))
    s = whole.scale[:, None]
    shrunk = blocks.evidence_of(null, extra.random / s)[0] if extra.random.shape[1] else 0.0
    return shrunk + null.gain(extra.free / s) + sum(choice.log_prior for choice in mine)


def _pairs(columns: Sequence[Variable], own: set[str]) -> Iterator[tuple[tuple[str, ...], Variable, Variable | None]]:
    """Names and columns of each block that reads a column which the effect does not: alone, with the position, with the time."""
    beside = [v for v in columns if v.name in ("target_mm", "time_s", "row_order")]
    for one in columns:
        if one.name not in own:
            yield (one.name,), one, None
            yield from (((one.name, other.name), one, other) for other in beside if other is not one)
