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

COURSES = {"time_s", "row_order"}
"""Columns of which a smooth function is any slow course, and so no other cause by itself."""


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
        if float(whole.best.rss) < (1.0 - policy().nearly_all) * float(null.rss):
            continue
        own = {"target_mm", "direction"}.union(*(choice.form.inputs for choice in mine))
        worth = {
            names: blocks.evidence_of(null, blocks.design_of(a, b, None) / s)[0] for names, a, b in _blocks(columns)
        }
        theirs = {names: value for names, value in worth.items() if not set(names) <= own | COURSES}
        if not theirs:
            continue
        best = max(theirs, key=lambda names: theirs[names])
        # a form that is not quite the machine's loses to functions of its own columns, and is no other cause
        mine_best = max([value for names, value in worth.items() if names not in theirs], default=0.0)
        if theirs[best] > max(_evidence(null, mine, whole), mine_best) + policy().beaten:
            out[name] = best
    return out


def _evidence(null: Projection, mine: Sequence[Choice], whole: Null) -> float:
    """Log evidence of the terms of one effect over none."""
    extra = Extra.none(len(whole.y))
    for choice in mine:
        extra = extra.plus(choice.extra(whole.linear.campaign))
    s = whole.scale[:, None]
    shrunk = blocks.evidence_of(null, extra.random / s)[0] if extra.random.shape[1] else 0.0
    return shrunk + null.gain(extra.free / s) + sum(choice.log_prior for choice in mine)


def _blocks(columns: Sequence[Variable]) -> Iterator[tuple[tuple[str, ...], Variable, Variable | None]]:
    """Names and columns of each block: every column but the position alone, with the position, with the time."""
    beside = [v for v in columns if v.name in ("target_mm", *COURSES)]
    for one in columns:
        if one.name != "target_mm":
            yield (one.name,), one, None
            yield from (((one.name, other.name), one, other) for other in beside if other is not one)
