"""Local refinement of the non-linear parameters of many candidates at once by pattern search (variable projection: the
linear ones follow).

All trials of a round are one product.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Projection
from hil.diagnosis.search.candidates import Blocks, Stack, score
from hil.diagnosis.search.fit import Choice
from hil.effects import NonLinear

Floats = NDArray[np.float64]

ROUNDS = 6
FIRST = 0.6
"""First step, as a share of the grid spacing."""
OFFSETS = {1: (-1.0, -0.5, 0.0, 0.5, 1.0), 2: (-0.7, 0.0, 0.7)}
"""Trial offsets in steps, by number of parameters."""


class Trials:
    """Some choices with their columns, scored under several projections."""

    def __init__(self, choices: Sequence[Choice], campaign: CampaignRows) -> None:
        self.choices, self.blocks = choices, Blocks.of_choices(choices, campaign)
        self._stack: Stack | None = None

    def score(self, projection: Projection) -> tuple[Floats, list[Choice]]:
        """Gain of the choices under a projection, shape (c,), and the choices with the variance of the shrunk ones set."""
        if self._stack is None or self._stack.whitened is not projection.whitened:
            self._stack = Stack(projection.whitened, self.blocks)
        scores = score(projection, self._stack)
        return scores.gain, [
            replace(choice, variance=float(v)) if choice.form.shrunk else choice
            for choice, v in zip(self.choices, scores.variance, strict=True)
        ]


def score_choices(projection: Projection, choices: Sequence[Choice]) -> tuple[Floats, list[Choice]]:
    """Gain of some choices under one projection, shape (c,), and the choices with the variance of the shrunk ones
    set.
    """
    return Trials(choices, projection.whitened.campaign).score(projection)


def refine(projection: Projection, choices: Sequence[Choice], rounds: int = ROUNDS) -> list[tuple[Choice, float]]:
    """Each choice with its parameters at a local maximum of the evidence, and its gain there."""
    best = list(choices)
    steps = [[FIRST * step for step in choice.steps] for choice in choices]
    gains = np.full(len(best), -np.inf)
    open_ones = [i for i, step in enumerate(steps) if step]
    for turn in range(rounds):
        trials: list[Choice] = []
        owner: list[int] = []
        for i in range(len(best)) if turn == 0 else open_ones:
            for theta in _around(best[i], steps[i], centre=turn == 0):
                trials.append(replace(best[i], theta=theta))
                owner.append(i)
        if not trials:
            break
        found, trials = score_choices(projection, trials)
        owners = np.array(owner)
        for i in dict.fromkeys(owner):
            mine = np.flatnonzero(owners == i)
            top = mine[int(np.argmax(found[mine]))]
            if not steps[i]:
                best[i], gains[i] = trials[top], found[top]
                continue
            moved = trials[top].theta if found[top] > gains[i] else best[i].theta
            edge = [
                abs(a - b) > 0.99 * s
                for a, b, s in zip(_inward(best[i], moved), _inward(best[i], best[i].theta), steps[i], strict=True)
            ]
            if found[top] > gains[i]:
                best[i], gains[i] = trials[top], found[top]
            steps[i] = [s if at_edge else s * 0.4 for s, at_edge in zip(steps[i], edge, strict=True)]
    return [(choice, float(gain)) for choice, gain in zip(best, gains, strict=True)]


def _around(choice: Choice, steps: Sequence[float], *, centre: bool) -> list[tuple[float, ...]]:
    """Trial parameters on a small grid around a choice, inside the bounds; with its own where `centre` is set."""
    if not steps:
        return [choice.theta]
    middle = _inward(choice, choice.theta)
    offsets = OFFSETS[min(len(steps), 2)]
    out: list[tuple[float, ...]] = []
    for shift in itertools.product(offsets, repeat=len(steps)):
        if not centre and not any(shift):
            continue
        theta = tuple(
            min(max(_outward(p, c + s * step), p.lower), p.upper)
            for p, c, s, step in zip(choice.form.nonlinear, middle, shift, steps, strict=True)
        )
        if theta not in out:
            out.append(theta)
    return out


def _inward(choice: Choice, theta: Sequence[float]) -> list[float]:
    return [math.log(v) if p.logarithmic else v for p, v in zip(choice.form.nonlinear, theta, strict=True)]


def _outward(parameter: NonLinear, value: float) -> float:
    return math.exp(value) if parameter.logarithmic else value
