"""All the candidates of a catalogue for one campaign, as one matrix, so that a search is a few matrix products.

What may go in: enumeration and scoring of fixed columns. Refinement of the non-linear parameters is `refine`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import Campaign
from hil.diagnosis.evidence import Frame, Whitened, bayes_factor, random_gain
from hil.diagnosis.fit import Choice, grid_choices
from hil.effects import Effect

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_BYTES = 120_000_000
"""Of whitened candidates kept."""
BLIND = 0.01
"""Share of a candidate's norm that must be left beside the table for the campaign to show it at all."""


@dataclass(frozen=True)
class Blocks:
    """Columns (n, J) in blocks: first column and width of each, whether its coefficients are shrunk, log odds beforehand, (c,)."""

    columns: Floats
    first: Ints
    width: Ints
    shrunk: NDArray[np.bool_]
    log_prior: Floats

    @classmethod
    def of(cls, blocks: Sequence[Floats], rows: int) -> Blocks:
        """Blocks (n, k) of free coefficients, none likelier than another."""
        width = np.array([block.shape[1] for block in blocks], dtype=np.int64)
        first = (np.cumsum(width) - width).astype(np.int64)
        columns = np.hstack(blocks) if blocks else np.zeros((rows, 0))
        return cls(columns, first, width, np.zeros(len(blocks), dtype=np.bool_), np.zeros(len(blocks)))

    @classmethod
    def of_choices(cls, choices: Sequence[Choice], campaign: Campaign) -> Blocks:
        parts: list[Floats] = []
        for _, same in itertools.groupby(choices, lambda choice: (id(choice.effect), id(choice.form))):
            group = list(same)
            wide = group[0].effect.bases(group[0].form, [choice.theta for choice in group], campaign.columns)
            parts.extend(np.split(wide, len(group), axis=1))
        blocks = cls.of(parts, len(campaign))
        shrunk = np.array([choice.form.shrunk for choice in choices], dtype=np.bool_)
        return replace(blocks, shrunk=shrunk, log_prior=np.array([choice.log_prior for choice in choices]))

    def block(self, index: int) -> Floats:
        """Columns of one block, shape (n, k)."""
        first = int(self.first[index])
        return self.columns[:, first : first + int(self.width[index])]

    def __len__(self) -> int:
        return len(self.width)


@dataclass(frozen=True)
class Candidates:
    """choices: what each block is; effect: index of its effect in `effects`, shape (c,); forms: the blocks of each form."""

    choices: tuple[Choice, ...]
    blocks: Blocks
    effects: tuple[str, ...]
    effect: Ints
    forms: tuple[Ints, ...]
    _stacks: dict[int, Stack] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.choices)

    def stack(self, whitened: Whitened) -> Stack:
        """The candidates whitened, made once per whitening."""
        key = id(whitened)
        if key not in self._stacks or self._stacks[key].whitened is not whitened:
            if len(self._stacks) * self.blocks.columns.nbytes >= MOST_BYTES:
                self._stacks.clear()
            self._stacks[key] = Stack(whitened, self.blocks)
        return self._stacks[key]


def enumerate_candidates(campaign: Campaign, effects: Sequence[Effect]) -> Candidates:
    """Every effect in every form of the first search that the records allow, at every grid point."""
    choices: list[Choice] = []
    forms: list[Ints] = []
    for effect in effects:
        for form in effect.forms(campaign.survey):
            if form.scan:
                grid = grid_choices(effect, form)
                forms.append(np.arange(len(choices), len(choices) + len(grid)))
                choices.extend(grid)
    names = tuple(dict.fromkeys(choice.effect.id for choice in choices))
    index = np.array([names.index(choice.effect.id) for choice in choices], dtype=np.int64)
    return Candidates(tuple(choices), Blocks.of_choices(choices, campaign), names, index, tuple(forms))


class Stack:
    """Blocks whitened under one (ar, rho), with what every frame of it needs."""

    def __init__(self, whitened: Whitened, blocks: Blocks) -> None:
        self.whitened, self.blocks = whitened, blocks
        self.w = whitened.whiten(blocks.columns)
        self.cross = whitened.table.T @ self.w
        self.raw = np.einsum("nj,nj->j", self.w, self.w)
        self.groups: list[tuple[Ints, Ints, Floats]] = []
        for size in np.unique(blocks.width[~blocks.shrunk]):
            which = np.flatnonzero((blocks.width == size) & ~blocks.shrunk)
            index = blocks.first[which][:, None] + np.arange(size)
            self.groups.append((which, index, block_gram(self.w, index) if size > 1 else np.zeros((0, 1, 1))))

    @cached_property
    def _single(self) -> NDArray[np.float32]:
        return self.w.astype(np.float32)

    def seen_of_many(self, rest: Floats) -> Floats:
        """w'rest of many errors (n, b), shape (J, b), in single precision: they are simulated, and only their distribution counts."""
        return np.asarray(self._single.T @ rest.astype(np.float32), dtype=np.float64)


@dataclass(frozen=True)
class Scores:
    """Per block: log Bayes factor (c,) or (c, b), share of the norm left (c,), variance ratio of a shrunk one (c,)."""

    gain: Floats
    visible: Floats
    variance: Floats


def score(frame: Frame, stack: Stack, *, blind: float = BLIND) -> Scores:
    """Score every block on its own beside what the frame projects out. A block left with less than `blind` of its norm gets -inf."""
    blocks = stack.blocks
    w = stack.w
    cross = stack.cross
    raw = stack.raw
    if frame.out is not None:
        gone = w[frame.out]
        cross = cross - frame.whitened.table[frame.out].T @ gone
        raw = raw - np.einsum("nj,nj->j", gone, gone)
    if frame.beside.shape[1]:
        cross = np.concatenate([cross, frame.beside.T @ w])
    shadow = frame.solve_lower(cross)
    many = frame.y.ndim == 2
    zy = stack.seen_of_many(frame.rest) if many else (w.T @ frame.rest)[:, None]
    left = raw - np.einsum("pj,pj->j", shadow, shadow)
    explained = np.zeros((len(blocks), zy.shape[1]))
    visible = np.zeros(len(blocks))
    for which, index, whole in stack.groups:
        scale = np.maximum(raw[index], 1e-300)
        visible[which] = np.sqrt(np.clip(np.max(left[index] / scale, axis=1), 0.0, 1.0))
        if index.shape[1] == 1:
            explained[which] = zy[index[:, 0]] ** 2 / np.maximum(left[index], 1e-9 * scale)
            continue
        gram = whole - block_gram(shadow, index)
        if frame.out is not None:
            gram = gram - block_gram(w[frame.out], index)
        root = np.sqrt(scale)
        normal = gram / (root[:, :, None] * root[:, None, :]) + 1e-9 * np.eye(index.shape[1])
        b = zy[index] / root[:, :, None]
        if index.shape[1] == 2:
            explained[which] = _pair(normal, b)
        else:
            explained[which] = np.einsum("cib,cib->cb", b, np.linalg.solve(normal, b))
    rss = np.atleast_1d(frame.rss)
    gain = bayes_factor(explained, rss[None, :], frame.dof, blocks.width[:, None], frame.rows)
    variance = np.ones(len(blocks))
    for i in np.flatnonzero(blocks.shrunk):
        values, ratios = random_gain(frame, blocks.block(int(i)))
        gain[i], variance[i], visible[i] = values, float(np.ravel(ratios)[0]), 1.0
    gain += blocks.log_prior[:, None]
    gain[visible < blind] = -np.inf
    return Scores(gain if many else gain[:, 0], visible, variance)


def _pair(normal: Floats, b: Floats) -> Floats:
    """b'a⁻¹b of 2 × 2 blocks, shape (c, m)."""
    a00, a01, a11 = normal[:, 0, 0, None], normal[:, 0, 1, None], normal[:, 1, 1, None]
    determinant = np.maximum(a00 * a11 - a01**2, 1e-18)
    b0, b1 = b[:, 0], b[:, 1]
    return np.asarray((a11 * b0**2 - 2 * a01 * b0 * b1 + a00 * b1**2) / determinant)


def block_gram(w: Floats, index: Ints) -> Floats:
    """Z'Z of each block of columns, shape (c, k, k)."""
    c, size = index.shape
    gram = np.empty((c, size, size))
    parts = [w[:, index[:, i]] for i in range(size)]
    for i in range(size):
        for j in range(i, size):
            gram[:, i, j] = gram[:, j, i] = np.einsum("nc,nc->c", parts[i], parts[j])
    return gram
