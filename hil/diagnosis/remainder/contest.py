"""Whether what an effect was taken for is explained better by a smooth function of other columns.

The search compares effects with one another and with polynomials; a bump along a pressure that passes it once resembles a jump of the
reading far more than any of those. Here the evidence of each effect meets that of the blocks, beside everything else that was found
and in the same noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder import block as blocks
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.scan import Variable, variables
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.search.select import is_of_a_wander
from hil.diagnosis.table import DeclaredShape


def beaten(searcher: Searcher, choices: Sequence[Choice], noise: Noise) -> set[str]:
    """Ids of the effects that a smooth function of other columns beats."""
    if not choices:
        return set()
    campaign = searcher.linear.campaign
    whole = Null.of(LinearCampaign(campaign), searcher.y, searcher.extra(choices), noise)
    time = campaign.survey.time_column
    designs = {names: blocks.design_of(a, b, None) for names, a, b in _blocks(variables(campaign, signed=True), time)}
    out = set()
    for name in dict.fromkeys(choice.effect.id for choice in choices):
        mine = [choice for choice in choices if choice.effect.id == name]
        if mine[0].effect.static and isinstance(searcher.linear.shape, DeclaredShape):
            continue  # the table of these rows, which is free here, holds what a declared one lacks
        others = searcher.extra([choice for choice in choices if choice.effect.id != name])
        null = replace(whole, beside=others).best
        if float(whole.best.rss) < (1.0 - policy().nearly_all) * float(null.rss):
            continue
        # a smooth function of the time is any slow course, and so no other cause by itself
        own = {"target_mm", "direction", time}.union(*(choice.form.inputs for choice in mine))
        worth = {names: blocks.evidence_of(null, design)[0] for names, design in designs.items()}
        its_own = {names for names in worth if set(names) <= own or is_of_a_wander(names, mine, campaign.survey)}
        of_others = max([value for names, value in worth.items() if names not in its_own], default=-math.inf)
        # a form that is not quite the machine's loses to functions of its own columns, and is no other cause
        of_its_own = max([value for names, value in worth.items() if names in its_own], default=0.0)
        if of_others > max(_evidence(null, mine, whole), of_its_own) + policy().strong:
            out.add(name)
    return out


def _evidence(null: Projection, mine: Sequence[Choice], whole: Null) -> float:
    """Log evidence of the terms of one effect over none."""
    extra = Extra.none(len(whole.y))
    for choice in mine:
        extra = extra.plus(choice.extra(whole.linear.campaign))
    shrunk = blocks.evidence_of(null, extra.random)[0] if extra.random.shape[1] else 0.0
    return shrunk + null.gain(extra.free) + sum(choice.log_prior for choice in mine)


def _blocks(columns: Sequence[Variable], time: str) -> Iterator[tuple[tuple[str, ...], Variable, Variable | None]]:
    """Names and columns of each block: every column but the position alone, with the position, with the time."""
    beside = [v for v in columns if v.name in ("target_mm", time)]
    for one in columns:
        if one.name != "target_mm":
            yield (one.name,), one, None
            yield from (((one.name, other.name), one, other) for other in beside if other is not one)
