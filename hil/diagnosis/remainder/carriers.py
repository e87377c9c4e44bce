"""Which columns carry what is left: functions of many sets of columns are compared by their evidence, and those that the rows do not
tell from the best are named as equivalent.

What changes slowly may act late or with hysteresis: a mass that warms through, a joint that slips. So a slow column also stands for
what it was before: through a lag, through a play, and through a relay, of which any hysteresis is a sum (Preisach; Prandtl and
Ishlinskii).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder import block as blocks
from hil.diagnosis.remainder.block import Block
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.scan import Group, Scan, Variable, scaled
from hil.effects.history import lagged

Floats = NDArray[np.float64]

CONTENDING = 12
"""Sets of columns of the best groups that are compared by their evidence."""
LAGS = (0.03, 0.08, 0.2)
"""Lags of a slow column, over the duration of the campaign: shorter ones are hardly seen, longer ones are a course of the time."""
PLAYS = (0.1, 0.2, 0.3)
"""Half widths of a play, over the range of the column."""
RELAYS = ((0.25, 0.6), (0.33, 0.67), (0.4, 0.75))
"""Values of the column, over its range, below which a relay falls and above which it rises."""
SLOW = 0.1
"""Mean square of the steps from row to row over the variance, up to which a column is slow: 2 for values that are drawn anew."""


@dataclass(frozen=True)
class Carried:
    """The function of some columns that carries what is left, and by column the others that the rows do not tell from it."""

    block: Block
    equivalent: dict[str, tuple[str, ...]]


def carried(null: Null, columns: Sequence[Variable], found: Scan, best: Block | None, d: Floats | None) -> Carried:
    """The function of highest evidence among those of the columns of the best groups, the block that fired, and what was before."""
    named = {v.name: v for v in columns}
    trials = [] if best is None else [best]
    for groups in found.by_columns[:CONTENDING]:
        trials.append(_trial(null, named, groups[0].columns, d, groups))
    if best is not None:
        trials += [_trial(null, named, (name,), d) for name in best.columns if name in named and name != "target_mm"]
    top = _even(null, trials)
    slow = (
        [v for v in columns if is_slow(v)] if _may_remember(top, named, null.linear.campaign.survey.time_column) else []
    )
    late = [one for v in slow for one in _late(null, named, top, _remembered(v, null.linear.campaign), d)]
    top = _even(null, [top, *late])
    return Carried(top, _equivalent(null, named, top, [*trials, *late], d))


def is_slow(v: Variable) -> bool:
    """Whether a column changes little from row to row."""
    return bool(not v.levels and np.mean(np.diff(v.u) ** 2) < SLOW * np.var(v.u))


def _even(null: Null, trials: Sequence[Block]) -> Block:
    """The function of highest evidence that is not made of a few uneven rows; that of highest evidence where all are."""
    ordered = sorted(trials, key=_worth, reverse=True)
    return next((one for one in ordered if blocks.share_by_signs(null, one) < policy().by_signs), ordered[0])


def _worth(trial: Block) -> float:
    return trial.evidence - policy().simpler * len(trial.columns)


def _trial(
    null: Null,
    named: dict[str, Variable],
    names: Sequence[str],
    d: Floats | None,
    groups: Sequence[Group] = (),
) -> Block:
    plain = [named[name] for name in names if name in named]
    directed = d if "direction" in names else None
    pair = plain[0], plain[1] if len(plain) > 1 else None
    designs = [blocks.design_of(*pair, directed, tuple(groups))]
    if "target_mm" in names:  # a fine one spends variance on waves that a coarse cause has not
        designs.append(blocks.design_of(*pair, directed, fine=True))
    return max((blocks.block(null, tuple(names), design) for design in designs), key=lambda trial: trial.evidence)


def _may_remember(top: Block, named: dict[str, Variable], time: str) -> bool:
    return any(name == time or (name in named and is_slow(named[name])) for name in top.columns)


def _late(
    null: Null, named: dict[str, Variable], top: Block, memories: Sequence[Variable], d: Floats | None
) -> Iterator[Block]:
    """What a slow column was before, in place of each slow column of the best block."""
    price = math.log(len(LAGS) + len(PLAYS) + len(RELAYS))
    slow = [one for one in top.columns if one in named and is_slow(named[one])]
    for gone, memory in itertools.product(slow, memories):
        if gone != memory.name and memory.name in top.columns:
            continue
        names = _in_place(top.columns, gone, memory.name)
        trial = _trial(null, {**named, memory.name: memory}, names, d)
        yield Block(trial.columns, trial.design, trial.evidence - price, trial.variance)


def _in_place(columns: Sequence[str], gone: str, other: str) -> tuple[str, ...]:
    """The names of a block with another column in place of one."""
    names = {*columns} - {gone, "direction"} | {other}
    return (*sorted(names), *("direction",) * ("direction" in columns))


def _remembered(v: Variable, campaign: CampaignRows) -> tuple[Variable, ...]:
    """A slow column through lags, plays and relays."""
    time = campaign.columns[campaign.survey.time_column]
    span = float(np.ptp(time))
    late = [lagged(time, v.u, share * span) for share in LAGS]
    late += [v.u - play(v.u, width) for width in PLAYS]
    late += [relay(v.u, low, high) for low, high in RELAYS]
    return tuple(scaled(v.name, one) for one in late if np.ptp(one) > 0.0)


def play(u: Floats, width: float) -> Floats:
    """What follows a course (n,) with so much play on either side."""
    at, out = float(u[0]), []
    for value in u.tolist():
        at = min(max(at, value - width), value + width)
        out.append(at)
    return np.array(out)


def relay(u: Floats, low: float, high: float) -> Floats:
    """1 from where a course (n,) exceeds `high` until it falls below `low`, else 0."""
    on, out = 0.0, []
    for value in u.tolist():
        on = 1.0 if value > high else 0.0 if value < low else on
        out.append(on)
    return np.array(out)


def _equivalent(
    null: Null, named: dict[str, Variable], top: Block, trials: Sequence[Block], d: Floats | None
) -> dict[str, tuple[str, ...]]:
    """By column, other columns in whose place the evidence is nearly as high, those of which it is a smooth function, and slow ones
    that keep most of a slow one's evidence: the cause may act late, and in what form is not known.
    """
    tried = {one.columns: one.evidence for one in sorted(trials, key=lambda one: one.evidence)}
    out: dict[str, tuple[str, ...]] = {}
    for name in [one for one in top.columns if one in named]:
        alike = set(_same_course(named[name], named.values()))
        for other in [one for one in named if one not in top.columns and one not in alike]:
            names = _in_place(top.columns, name, other)
            if names not in tried:
                tried[names] = _trial(null, named, names, d).evidence
            late = is_slow(named[name]) and is_slow(named[other]) and tried[names] > policy().slow_alike * top.evidence
            if late or tried[names] > top.evidence - policy().very_strong:
                alike.add(other)
        if alike:
            out[name] = tuple(sorted(alike))
    return out


def _same_course(mine: Variable, columns: Iterable[Variable]) -> Iterator[str]:
    """Other columns of which this one is a smooth function."""
    for other in columns:
        if "target_mm" in (mine.name, other.name) or other.name == mine.name:
            continue
        cubic = np.vander(np.clip(other.u, -0.5, 1.5), 4)
        rest = mine.u - cubic @ np.linalg.lstsq(cubic, mine.u, rcond=None)[0]
        if np.var(rest) < (1.0 - policy().equivalent) * np.var(mine.u):
            yield other.name
