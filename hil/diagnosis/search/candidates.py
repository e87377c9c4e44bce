"""All candidates of a catalogue for one campaign as one matrix, scored by a few matrix products. `refine` refines their
parameters.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Projection, Whitened, bayes_factor, evidence_of_random
from hil.diagnosis.policy import policy
from hil.diagnosis.search.fit import Choice, grid_choices
from hil.effects import Effect, Form

Floats = NDArray[np.float64]
Reals = NDArray[np.floating]
Ints = NDArray[np.int64]

MOST_BYTES = 120_000_000
"""Most bytes of whitened candidates that are cached."""
NOTHING = 1e-24
"""Squared norm below which a column counts as zero; single precision could not divide by it."""


@dataclass(frozen=True)
class Blocks:
    """Columns (n, J) in blocks: first column and width of each, whether its coefficients are shrunk, log prior odds,
    (c,).
    """

    columns: Floats
    first: Ints
    width: Ints
    shrunk: NDArray[np.bool_]
    log_prior: Floats

    @classmethod
    def of(cls, blocks: Sequence[Floats], rows: int) -> Blocks:
        """Blocks (n, k) of free coefficients with equal prior."""
        none = np.zeros(len(blocks))
        return cls._side_by_side(blocks, [block.shape[1] for block in blocks], rows, none > 0, none)

    @classmethod
    def of_choices(cls, choices: Sequence[Choice], campaign: CampaignRows) -> Blocks:
        parts: list[Floats] = []
        widths: list[int] = []
        for _, same in itertools.groupby(choices, lambda choice: (id(choice.effect), id(choice.form))):
            group = list(same)
            wide = group[0].effect.bases(group[0].form, [choice.theta for choice in group], campaign.columns)
            parts.append(wide)
            widths.extend([wide.shape[1] // len(group)] * len(group))
        shrunk = np.array([choice.form.shrunk for choice in choices], dtype=np.bool_)
        log_prior = np.array([choice.log_prior for choice in choices])
        return cls._side_by_side(parts, widths, len(campaign), shrunk, log_prior)

    @classmethod
    def _side_by_side(
        cls, parts: Sequence[Floats], widths: Sequence[int], rows: int, shrunk: NDArray[np.bool_], log_prior: Floats
    ) -> Blocks:
        """From the columns of all blocks in order, in parts of any width."""
        width = np.array(widths, dtype=np.int64)
        columns = np.hstack([np.zeros((rows, 0)), *parts])
        return cls(columns, (np.cumsum(width) - width).astype(np.int64), width, shrunk, log_prior)

    def block(self, index: int) -> Floats:
        """Columns of one block, shape (n, k)."""
        return self.columns[:, self.where(index)]

    def where(self, index: int) -> slice:
        """The columns of a block."""
        first = int(self.first[index])
        return slice(first, first + int(self.width[index]))

    def __len__(self) -> int:
        return len(self.width)


@dataclass(frozen=True)
class Candidates:
    """choices: the candidate of each block; effect: index of its effect in `effects`, shape (c,); forms: the blocks of
    each form

    refining: by effect, the forms that are not in the first search
    """

    choices: tuple[Choice, ...]
    blocks: Blocks
    effects: tuple[str, ...]
    effect: Ints
    forms: tuple[Ints, ...]
    refining: Mapping[str, tuple[Form, ...]]
    _stacks: dict[int, Stack] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.choices)

    def of_one_place(self, campaign: CampaignRows) -> Candidates:
        """The candidates of effects that refinement may make local, at the lowest of their parameters."""
        local = set()
        for index in self.forms:
            first = self.choices[int(index[0])]
            lowest = [parameter.lower for parameter in first.form.nonlinear]
            if first.effect.is_local(first.form, lowest, campaign.survey):
                local.add(first.effect.id)
        kept = [i for i, choice in enumerate(self.choices) if choice.effect.id in local]
        choices = tuple(self.choices[i] for i in kept)
        return Candidates(choices, Blocks.of_choices(choices, campaign), self.effects, self.effect[kept], (), {})

    def stack(self, whitened: Whitened) -> Stack:
        """The candidates whitened, made once per whitening."""
        key = id(whitened)
        if key not in self._stacks or self._stacks[key].whitened is not whitened:
            if len(self._stacks) * self.blocks.columns.nbytes >= MOST_BYTES:
                self._stacks.clear()
            self._stacks[key] = Stack(whitened, self.blocks)
        return self._stacks[key]


def enumerate_candidates(campaign: CampaignRows, effects: Sequence[Effect]) -> Candidates:
    """Every effect in every form of the first search that the records allow, at every grid point."""
    choices: list[Choice] = []
    forms: list[Ints] = []
    refining: dict[str, tuple[Form, ...]] = {}
    for effect in effects:
        known = effect.forms(campaign.survey)
        refining[effect.id] = tuple(form for form in known if not form.scan)
        for form in known:
            if form.scan:
                grid = grid_choices(effect, form)
                forms.append(np.arange(len(choices), len(choices) + len(grid)))
                choices.extend(grid)
    names = tuple(dict.fromkeys(choice.effect.id for choice in choices))
    index = np.array([names.index(choice.effect.id) for choice in choices], dtype=np.int64)
    return Candidates(tuple(choices), Blocks.of_choices(choices, campaign), names, index, tuple(forms), refining)


class Stack:
    """Blocks whitened under one (ar, rho), with their products that every projection uses."""

    def __init__(self, whitened: Whitened, blocks: Blocks) -> None:
        self.whitened, self.blocks = whitened, blocks
        self.w = whitened.whiten(blocks.columns)
        self.cross = whitened.table.T @ self.w
        self.raw = np.einsum("nj,nj->j", self.w, self.w)
        self.groups: list[tuple[Ints, Ints, Floats]] = []
        for size in np.unique(blocks.width[~blocks.shrunk]):
            which = np.flatnonzero((blocks.width == size) & ~blocks.shrunk)
            index = blocks.first[which][:, None] + np.arange(size)
            self.groups.append((which, index, inner_products(self.w, index)))

    @cached_property
    def _single(self) -> NDArray[np.float32]:
        return self.w.astype(np.float32)

    def seen_of_many(self, rest: Floats) -> Reals:
        """w'rest of many errors (n, b), shape (J, b), in single precision: they are simulated, and only their
        distribution is used.
        """
        return np.asarray(self._single.T @ rest.astype(np.float32))


@dataclass(frozen=True)
class Scores:
    """Per block: log Bayes factor (c,) or (c, b), remaining share of the norm (c,), variance ratio of a shrunk one
    (c,).
    """

    gain: Floats
    visible: Floats
    variance: Floats


def score(projection: Projection, stack: Stack, *, blind: float | None = None) -> Scores:
    """Scores every block by itself beside the projected columns. A block with less than `blind` of its norm remaining
    gets -inf; None: the policy's.
    """
    blind = policy().blind if blind is None else blind
    blocks = stack.blocks
    w = stack.w
    cross = stack.cross
    raw = stack.raw
    gone = w[:0] if projection.out is None else w[projection.out]
    if projection.out is not None:
        cross = cross - projection.whitened.table[projection.out].T @ gone
        raw = raw - np.einsum("nj,nj->j", gone, gone)
    if projection.beside.shape[1]:
        cross = np.concatenate([cross, projection.beside.T @ w])
    shadow = projection.solve_lower(cross)
    many = projection.y.ndim == 2
    zy: Reals = stack.seen_of_many(projection.rest) if many else (w.T @ projection.rest)[:, None]
    left = raw - np.einsum("pj,pj->j", shadow, shadow)
    explained = np.zeros((len(blocks), zy.shape[1]), dtype=zy.dtype)
    visible = np.zeros(len(blocks))
    for which, index, whole in stack.groups:
        scale = np.where(raw[index] > NOTHING, raw[index], 1.0)
        visible[which] = np.sqrt(np.clip(np.max(left[index] / scale, axis=1), 0.0, 1.0))
        size = index.shape[1]
        if size == 1:
            root = np.sqrt(np.maximum(left[index], 1e-9 * scale)).astype(zy.dtype)
            explained[which] = (zy[index[:, 0]] / root) ** 2
            continue
        inner = whole - inner_products(shadow, index) - inner_products(gone, index)
        if size == 2:
            explained[which] = _explained_by_pairs(left[index], inner, scale, zy[index])
        else:
            explained[which] = _explained_by_blocks(inner, scale, zy[index])
    rss = np.atleast_1d(projection.rss)
    gain = bayes_factor(explained, rss[None, :], projection.dof, blocks.width[:, None], projection.rows)
    variance = np.ones(len(blocks))
    for i in np.flatnonzero(blocks.shrunk):
        mine = blocks.where(int(i))
        normal = w[:, mine].T @ w[:, mine] - gone[:, mine].T @ gone[:, mine] - shadow[:, mine].T @ shadow[:, mine]
        values, ratios = evidence_of_random(normal, zy[mine], rss, projection.dof)
        gain[i], variance[i], visible[i] = values, float(ratios[0]), 1.0
    gain += blocks.log_prior[:, None]
    gain[visible < blind] = -np.inf
    return Scores(gain if many else gain[:, 0], visible, variance)


def inner_products(w: Floats, index: Ints) -> Floats:
    """z'z of each block of columns, shape (c, k, k); of blocks of two columns only the off-diagonal element, shape
    (c,).

    index: of the columns of the blocks, neighbours in w (n, J), shape (c, k)
    """
    if index.shape[1] == 1:
        return np.zeros((0,))
    if index.shape[1] == 2:  # of all neighbours: that is quicker than to pick the columns out
        return np.asarray(np.einsum("nj,nj->j", w[:, :-1], w[:, 1:])[index[:, 0]])
    z = w.T[index]
    return np.asarray(z @ z.transpose(0, 2, 1))


def _explained_by_pairs(left: Floats, inner: Floats, scale: Floats, b: Reals) -> Reals:
    """b'a⁻¹b of 2 × 2 blocks with diagonals left + 1e-9·scale, shape (c, 2), and `inner` (c,) off them; b (c, 2, m), shape (c, m)."""
    a = left + 1e-9 * scale
    determinant = np.maximum(a[:, 0] * a[:, 1] - inner**2, 1e-18 * scale[:, 0] * scale[:, 1])
    first, slope, second = (
        values[:, None].astype(b.dtype)
        for values in (1.0 / np.sqrt(a[:, 0]), inner / a[:, 0], np.sqrt(a[:, 0] / determinant))
    )
    return np.asarray((first * b[:, 0]) ** 2 + (second * (b[:, 1] - slope * b[:, 0])) ** 2)


def _explained_by_blocks(inner: Floats, scale: Floats, b: Reals) -> Floats:
    """The same of k × k blocks, `inner` whole, shape (c, k, k); b (c, k, m)."""
    root = np.sqrt(scale)
    normal = inner / (root[:, :, None] * root[:, None, :]) + 1e-9 * np.eye(inner.shape[1])
    scaled = b / root[:, :, None]
    return np.asarray(np.einsum("cib,cib->cb", scaled, np.linalg.solve(normal, scaled)))
