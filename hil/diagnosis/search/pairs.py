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
from hil.diagnosis.search.candidates import Blocks, score
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.rank import score_choices
from hil.diagnosis.search.searcher import Searcher

Pair = tuple[Choice, Choice]

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
    found: list[tuple[float, Pair]] = []
    for trial in dict.fromkeys((noise, replace(noise, ar=0.0, rho=0.0, offset=CALM_OFFSET))):
        found += _of_free(searcher, rest, trial)
        found += _with_shrunk(searcher, rest, trial)
    best: dict[tuple[str, ...], Pair] = {}
    for value, pair in sorted(found, key=lambda one: -one[0]):
        if value <= least or len(best) == REFINED:
            break
        best.setdefault(_forms_of(pair), pair)
    return list(best.values())


def _forms_of(pair: Pair) -> tuple[str, ...]:
    return tuple(name for choice in pair for name in (choice.form.name, *choice.form.inputs))


def _with_shrunk(searcher: Searcher, rest: Sequence[Choice], noise: Noise) -> Iterator[tuple[float, Pair]]:
    """Log evidence of each shrunk candidate with its best partners."""
    candidates = searcher.candidates
    shrunk = [choice for choice in candidates.choices if choice.form.shrunk]
    partners = [
        index
        for index in candidates.forms
        if not (candidates.choices[index[0]].effect.static or candidates.choices[index[0]].form.shrunk)
    ]
    for one in score_choices(searcher.projection(noise, searcher.extra(rest)), shrunk)[1] if shrunk else ():
        projection = searcher.projection(noise, searcher.extra([*rest, one]))
        gains = score(projection, candidates.stack(projection.whitened)).gain
        tops = sorted((int(index[np.argmax(gains[index])]) for index in partners), key=lambda top: -gains[top])
        for top in tops[:PARTNERS]:
            beside = [*rest, candidates.choices[top]]
            gain, (again,) = score_choices(searcher.projection(noise, searcher.extra(beside)), [one])
            yield searcher.evidence(beside, noise) + float(gain[0]), (again, candidates.choices[top])


def _of_free(searcher: Searcher, rest: Sequence[Choice], noise: Noise) -> list[tuple[float, Pair]]:
    """Log evidence of pairs of free candidates, the best of each two forms."""
    choices = [choice for choice in searcher.candidates.choices if not (choice.effect.static or choice.form.shrunk)]
    first, second = _indices(choices, searcher.linear.campaign.survey.time_column)
    if not len(first):
        return []
    projection = searcher.projection(noise, searcher.extra(rest))
    blocks = Blocks.of_choices(choices, searcher.linear.campaign)
    normal, b = projection.normal(blocks.columns)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    normal, b = normal / np.outer(size, size) + 1e-9 * np.eye(len(b)), b / size
    value = np.empty(len(first))
    for widths in itertools.product(np.unique(blocks.width).tolist(), repeat=2):
        which = np.flatnonzero((blocks.width[first] == widths[0]) & (blocks.width[second] == widths[1]))
        index = np.hstack(
            [
                blocks.first[one[which]][:, None] + np.arange(width)
                for one, width in zip((first, second), widths, strict=True)
            ]
        )
        right = b[index]
        solved = np.linalg.solve(normal[index[:, :, None], index[:, None, :]], right[:, :, None])[:, :, 0]
        explained = np.sum(right * solved, axis=1)
        value[which] = bayes_factor(explained, projection.rss, projection.dof, index.shape[1], projection.rows)
    prior = np.array([choice.log_prior for choice in choices])
    value += prior[first] + prior[second] + searcher.evidence(rest, noise)
    best: dict[tuple[str, ...], tuple[float, Pair]] = {}
    listed = np.argpartition(-value, LISTED)[:LISTED] if len(value) > LISTED else np.arange(len(value))
    for at in listed[np.argsort(-value[listed])]:
        pair = choices[first[at]], choices[second[at]]
        best.setdefault(_forms_of(pair), (float(value[at]), pair))
    return list(best.values())


def _indices(choices: Sequence[Choice], time_column: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of the two choices of each pair of different effects, one of them slow or a course of time."""
    kind = np.unique([choice.effect.id for choice in choices], return_inverse=True)[1]
    course = np.array(
        [choice.effect.slow or choice.form.inputs == (time_column,) for choice in choices], dtype=np.bool_
    )
    first, second = np.triu_indices(len(choices), 1)
    kept = (kind[first] != kind[second]) & (course[first] | course[second])
    return first[kept].astype(np.int64), second[kept].astype(np.int64)
