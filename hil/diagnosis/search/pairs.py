"""Pairs of effects that explain most together, at the grid points of a search; one of them is slow or a course of time.

All pairs of free candidates come from one matrix of cross products; a shrunk one is put in the fit, and its variance estimated
again beside each partner.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import Noise, bayes_factor
from hil.diagnosis.search.candidates import score
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.rank import score_choices
from hil.diagnosis.search.searcher import Searcher

Pair = tuple[Choice, Choice]
Indices = NDArray[np.int64]

REFINED = 6
"""Most pairs that are worth a refinement."""
CALM_OFFSET = 0.25
"""Run offsets of the second noise model under which pairs are ranked, without memory: as fitted, noise holds what the pair should."""
PARTNERS = 3
"""Partners of a shrunk candidate, the best of their forms, beside which its variance is estimated again."""
LISTED = 2000
"""Best pairs of free candidates among which those of different forms are looked for: a form has some 300 grid points."""


def best_pairs(searcher: Searcher, rest: Sequence[Choice], noise: Noise, least: float) -> list[Pair]:
    """The pairs of different effects of highest evidence beside some choices, one of each two forms, of more than a least
    evidence.
    """
    free = np.array([not (one.effect.static or one.form.shrunk) for one in searcher.candidates.choices], dtype=np.bool_)
    first, second = _indices(searcher, np.flatnonzero(free))
    found: list[tuple[float, Pair]] = []
    for trial in dict.fromkeys((noise, replace(noise, ar=0.0, rho=0.0, offset=CALM_OFFSET))):
        found += _of_free(searcher, rest, trial, first, second)
        found += _with_shrunk(searcher, rest, trial, free)
    best: dict[tuple[str, ...], Pair] = {}
    for value, pair in sorted(found, key=lambda one: -one[0]):
        if value <= least or len(best) == REFINED:
            break
        best.setdefault(_forms_of(pair), pair)
    return list(best.values())


def _forms_of(pair: Pair) -> tuple[str, ...]:
    return tuple(name for choice in pair for name in (choice.form.name, *choice.form.inputs))


def _with_shrunk(
    searcher: Searcher, rest: Sequence[Choice], noise: Noise, free: NDArray[np.bool_]
) -> Iterator[tuple[float, Pair]]:
    """Log evidence of each shrunk candidate with its best partners among those that are free."""
    candidates = searcher.candidates
    shrunk = [choice for choice in candidates.choices if choice.form.shrunk]
    partners = [index for index in candidates.forms if free[index[0]]]
    for one in score_choices(searcher.projection(noise, searcher.extra(rest)), shrunk)[1] if shrunk else ():
        projection = searcher.projection(noise, searcher.extra([*rest, one]))
        gains = score(projection, candidates.stack(projection.whitened)).gain
        tops = sorted((int(index[np.argmax(gains[index])]) for index in partners), key=lambda top: -gains[top])
        for top in tops[:PARTNERS]:
            beside = [*rest, candidates.choices[top]]
            gain, (again,) = score_choices(searcher.projection(noise, searcher.extra(beside)), [one])
            yield searcher.evidence(beside, noise) + float(gain[0]), (again, candidates.choices[top])


def _of_free(
    searcher: Searcher, rest: Sequence[Choice], noise: Noise, first: Indices, second: Indices
) -> Iterator[tuple[float, Pair]]:
    """Log evidence of the pairs of candidates `first` and `second`, the best ones."""
    choices, blocks = searcher.candidates.choices, searcher.candidates.blocks
    projection = searcher.projection(noise, searcher.extra(rest))
    used = np.zeros(len(blocks), dtype=np.bool_)
    used[first] = used[second] = True
    normal, b = projection.normal(blocks.columns[:, np.repeat(used, blocks.width)])
    start = np.cumsum(blocks.width * used) - blocks.width
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    normal, b = normal / np.outer(size, size) + 1e-9 * np.eye(len(b)), b / size
    value = np.empty(len(first))
    for widths in itertools.product(np.unique(blocks.width[used]).tolist(), repeat=2):
        which = np.flatnonzero((blocks.width[first] == widths[0]) & (blocks.width[second] == widths[1]))
        index = np.hstack(
            [start[one[which]][:, None] + np.arange(width) for one, width in zip((first, second), widths, strict=True)]
        )
        right = b[index]
        solved = np.linalg.solve(normal[index[:, :, None], index[:, None, :]], right[:, :, None])[:, :, 0]
        explained = np.sum(right * solved, axis=1)
        value[which] = bayes_factor(explained, projection.rss, projection.dof, index.shape[1], projection.rows)
    value += blocks.log_prior[first] + blocks.log_prior[second] + searcher.evidence(rest, noise)
    listed = np.argpartition(-value, LISTED)[:LISTED] if len(value) > LISTED else np.arange(len(value))
    return ((float(value[at]), (choices[first[at]], choices[second[at]])) for at in listed)


def _indices(searcher: Searcher, free: Indices) -> tuple[Indices, Indices]:
    """Of the two candidates of each pair of different effects among the free ones, one of them slow or a course of time."""
    candidates, time_column = searcher.candidates, searcher.linear.campaign.survey.time_column
    course = np.array(
        [one.effect.slow or one.form.inputs == (time_column,) for one in candidates.choices], dtype=np.bool_
    )
    first, second = (free[side] for side in np.triu_indices(len(free), 1))
    kept = (candidates.effect[first] != candidates.effect[second]) & (course[first] | course[second])
    return first[kept], second[kept]
