"""The joint fit: table and terms by generalised least squares under a noise model, as a model of the axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection, Solution
from hil.diagnosis.noise.noise_fit import fit_noise
from hil.diagnosis.table import SplineShape, StaticPart
from hil.effects import Action, Effect, Form, Term
from hil.effects.base import slopes_of
from hil.effects.model import Model, PitchTable
from hil.records.rows import Records

Floats = NDArray[np.float64]

START_ROUGHNESS = 300.0
"""Variance ratio of the table's roughness at which a noise fit starts."""
ABSORBING = ((START_ROUGHNESS, 0.0), (START_ROUGHNESS, 1.0), (1.0, 0.0), (1e-3, 0.0))
"""(roughness, run offset) of the tables that a declared one may be: rough with offsets and without, smooth, a straight line."""
SAME_PART = 0.02
"""Singular value, over the largest, below which two of them have absorbed the same."""


@dataclass(frozen=True)
class Choice:
    """An effect in one form with its non-linear parameters chosen.

    variance: ratio of the prior's variance to the white noise's, for a form that is shrunk
    steps: grid spacing of each parameter (in the logarithm where that is searched), for the refinement
    """

    effect: Effect
    form: Form
    theta: tuple[float, ...]
    variance: float = 1.0
    steps: tuple[float, ...] = field(default=(), compare=False)

    def columns(self, campaign: CampaignRows) -> Floats:
        """Design columns, shape (n, k)."""
        return self.effect.basis(self.form, self.theta, campaign.columns)

    def extra(self, campaign: CampaignRows) -> Extra:
        """Its columns in a fit: free, or random and scaled to unit variance ratio."""
        columns = self.columns(campaign)
        none = columns[:, :0]
        return Extra(none, columns * math.sqrt(self.variance)) if self.form.shrunk else Extra(columns, none)

    @property
    def log_prior(self) -> float:
        """Log prior odds of its form and parameters."""
        return self.form.log_odds + sum(
            p.log_prior(value) for p, value in zip(self.form.nonlinear, self.theta, strict=True)
        )

    def as_term(self, coefficients: Floats, covariance: Floats | None = None) -> Term:
        """The term with coefficients (k,), and the covariance (k + t, k + t) of coefficients and parameters where it is
        known.
        """
        size = len(coefficients) + len(self.theta)
        known = np.zeros((size, size)) if covariance is None else covariance
        return Term(
            self.effect,
            self.form,
            tuple(float(v) for v in self.theta),
            tuple(float(v) for v in coefficients),
            tuple(tuple(float(v) for v in row) for row in known),
        )


def grid_choices(effect: Effect, form: Form) -> list[Choice]:
    """A form at each point of its grid."""
    if not form.nonlinear or form.exhaustive:
        return [Choice(effect, form, theta) for theta in form.starts]
    grid = np.array(form.starts, dtype=np.float64)
    for i, parameter in enumerate(form.nonlinear):
        if parameter.logarithmic:
            grid[:, i] = np.log(grid[:, i])
    steps = np.empty_like(grid)
    for i in range(grid.shape[1]):
        values, index = np.unique(grid[:, i], return_inverse=True)
        gaps = np.diff(values) if len(values) > 1 else np.array([0.2])
        nearest = np.minimum(np.append(gaps, np.inf), np.append(np.inf, gaps)) if len(values) > 1 else gaps
        steps[:, i] = nearest[index]
    if grid.shape[1] == 2 and form.nonlinear[1].logarithmic and not form.nonlinear[0].logarithmic:
        steps[:, 0] = np.exp(grid[:, 1])  # a zone is searched in steps of its width
    return [
        Choice(effect, form, theta, steps=tuple(step)) for theta, step in zip(form.starts, steps.tolist(), strict=True)
    ]


def start_noise(campaign: CampaignRows) -> Noise:
    """Start of the noise fit: a free table on repeated targets, a smooth one elsewhere."""
    if campaign.repeated:
        return Noise()
    return Noise(even=START_ROUGHNESS, odd=START_ROUGHNESS)


def fit_model(records: Records) -> Model:
    """The declared model of records: a bidirectional table, smoothed as far as the repeats allow, nothing else.

    Raises InputError when there are too few rows.
    """
    setting = Setting.free(prepare(records))
    y = setting.error_um
    start = Noise(even=START_ROUGHNESS, odd=START_ROUGHNESS)
    noise = fit_noise(setting.linear, y, Extra.none(len(y)), start, correlations=((0.0, 0.0),))
    return joint_fit(setting, noise, y, ()).extended


@dataclass(frozen=True)
class Known:
    """The declared model's terms as a prior of the fit.

    terms: the declared terms; roots: square root of each one's coefficient covariance over the noise variance, (k, k)
    extra: their columns times those roots, random with unit variance
    """

    terms: tuple[Term, ...]
    roots: tuple[Floats, ...]
    extra: Extra

    @classmethod
    def none(cls, rows: int) -> Known:
        """No declared terms."""
        return cls((), (), Extra.none(rows))

    @classmethod
    def of(cls, model: Model, campaign: CampaignRows, noise_um: float) -> Known:
        """The terms of a declared model; noise_um: standard deviation of the white noise."""
        roots, columns = [], []
        for term in model.terms:
            k = len(term.coefficients)
            values, vectors = np.linalg.eigh(np.array(term.covariance)[:k, :k])
            root = np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)) / noise_um)
            roots.append(root)
            columns.append(term.effect.basis(term.form, term.theta, campaign.columns) @ root)
        none = np.zeros((len(campaign), 0))
        return cls(model.terms, tuple(roots), Extra(none, np.hstack([none, *columns])))

    def updated(self, coefficients: Floats) -> list[Term]:
        """The declared terms moved by the fitted coefficients of `extra`, shape (s,)."""
        out, at = [], 0
        for term, root in zip(self.terms, self.roots, strict=True):
            k = len(root)
            moved = np.array(term.coefficients) + root @ coefficients[at : at + k]
            out.append(replace(term, coefficients=tuple(float(v) for v in moved)))
            at += k
        return out


@dataclass(frozen=True)
class JointFit:
    """Table and terms estimated together.

    whole: with every term, the declared ones first; bare: with the terms a machine is compensated for; of what instrument and set-up
    did, and will not do in a later campaign, its table holds the mean alone, as the zero does not move; extended: the same, whose
    table keeps what it can hold of the nuisance columns: their mean over these rows predicts other rows better than nothing
    found: the terms of the choices; white_um: standard deviation of the white noise
    nuisance_um: fitted value of the nuisance columns on every row, shape (n,)
    """

    whole: Model
    extended: Model
    bare: Model
    found: tuple[Term, ...]
    white_um: float
    nuisance_um: Floats

    def with_terms(self, terms: Sequence[Term]) -> JointFit:
        """The same fit with other terms of the choices."""
        new = {id(term): other for term, other in zip(self.found, terms, strict=True)}

        def of(model: Model) -> Model:
            return replace(model, terms=tuple(new.get(id(term), term) for term in model.terms))

        return replace(self, whole=of(self.whole), extended=of(self.extended), bare=of(self.bare), found=tuple(terms))

    def with_covariances(self, covariances: Sequence[Floats]) -> JointFit:
        """The same fit with other covariances of the terms of the choices, (k + t, k + t) each."""
        return self.with_terms(
            [
                replace(term, covariance=tuple(tuple(row) for row in one.tolist()))
                for term, one in zip(self.found, covariances, strict=True)
            ]
        )


@dataclass(frozen=True)
class Setting:
    """The data of a joint fit.

    linear: campaign and shape of the table; error_um: to be explained by table and terms, shape (n,)
    known: declared terms; static: part of the choices that the declared table may have absorbed, free in the fit
    """

    linear: LinearCampaign
    error_um: Floats
    known: Known
    static: StaticPart | None = None

    @classmethod
    def free(cls, campaign: CampaignRows) -> Setting:
        """The table fitted from the records themselves, nothing declared."""
        return cls(LinearCampaign(campaign), campaign.error_um, Known.none(len(campaign)))

    @property
    def always(self) -> Extra:
        """The columns that are in every fit."""
        campaign = self.linear.campaign
        if self.static is None:
            return self.known.extra
        columns = self.static.at(campaign.x, campaign.d)
        return self.known.extra.plus(Extra(columns, columns[:, :0]))


def joint_fit(
    setting: Setting,
    noise: Noise,
    y: Floats,
    choices: Sequence[Choice],
    *,
    out: NDArray[np.bool_] | None = None,
    nuisance: Extra | None = None,
    uncertain: bool = True,
) -> JointFit:
    """Estimates table and terms under a noise model, from the (outlier-limited) errors y (n,) of the rows not left out.

    nuisance: further random columns in the fit; uncertain: whether covariances are computed, see `joint_terms`
    """
    linear = setting.linear
    campaign = linear.campaign
    solved = joint_terms(setting, noise, y, choices, out=out, nuisance=nuisance, uncertain=uncertain)
    projection, solution, posterior, terms = solved
    none = np.zeros((len(campaign), 0))
    unnamed = none if nuisance is None else nuisance.random
    p, w = linear.table.stacked.shape[1], linear.table.table_width
    white = float(np.sqrt(solution.variance))
    about = {"rows": projection.rows, "runs": campaign.runs, "white_noise_um": white}
    middle = p + projection.extra.random.shape[1] - unnamed.shape[1]  # the random columns end with the unnamed ones
    start = middle - setting.known.extra.random.shape[1]
    declared = setting.known.updated(solution.table[start:middle])
    nuisance_um = np.asarray(unnamed @ solution.table[middle : middle + unnamed.shape[1]])

    def table_of(coefficients: Floats) -> PitchTable:
        table = linear.shape.tabulate(coefficients, None if posterior is None else posterior[:w, :w])
        if setting.static is not None:
            q = projection.extra.free.shape[1]
            table = setting.static.added_to(table, solution.table[len(solution.table) - q :])
        return table

    whole = Model(table_of(solution.table[:w]), (*declared, *terms), about)
    machine = tuple(term for term in whole.terms if term.effect.action_for(term) is Action.COMPENSATE)
    foreign = [term for term in terms if term.effect.action_for(term) is not Action.COMPENSATE]
    of_machine = solution.table[:w].copy()
    # the first column of a table is the constant
    of_machine[0] += sum(float(np.mean(term.error_um(campaign.columns))) for term in foreign)
    bare = extended = Model(table_of(of_machine) if foreign else whole.table, machine, about)
    if np.any(nuisance_um):
        share = linear.projection(noise, nuisance_um, None, out).solve(none).table[:w]
        extended = replace(bare, table=table_of(of_machine + share))
    return JointFit(whole, extended, bare, tuple(terms), white, nuisance_um)


def joint_terms(
    setting: Setting,
    noise: Noise,
    y: Floats,
    choices: Sequence[Choice],
    *,
    out: NDArray[np.bool_] | None = None,
    nuisance: Extra | None = None,
    uncertain: bool = True,
) -> tuple[Projection, Solution, Floats | None, list[Term]]:
    """The terms alone, as `joint_fit` estimates them, with what they come from: projection, solution, covariance of its table part.

    The covariance of a term is that of its coefficients and non-linear parameters together, linearised at the estimate
    (Gauss-Newton), with the table and all other terms free.
    """
    linear = setting.linear
    campaign = linear.campaign
    none = np.zeros((len(campaign), 0))
    extras = [choice.extra(campaign) for choice in choices]
    always = setting.always.plus(Extra(none, none) if nuisance is None else nuisance)
    random = np.hstack([none, *(extra.random for extra in extras), always.random])
    projection = linear.projection(noise, y, Extra(always.free, random), out)
    solution = projection.solve(np.hstack([none, *(extra.free for extra in extras)]))
    posterior = projection.inverse_lower.T @ projection.inverse_lower * solution.variance if uncertain else None
    return projection, solution, posterior, _terms(campaign, projection, solution, choices, posterior)


def _terms(
    campaign: CampaignRows,
    projection: Projection,
    solution: Solution,
    choices: Sequence[Choice],
    posterior: Floats | None,
) -> list[Term]:
    """The terms of the choices, from a solution with their free columns solved for and their random ones next to the table.

    posterior: covariance of the solution's table part, µm²; without it the terms get none
    """
    extras = [choice.extra(campaign) for choice in choices]
    first_random = projection.whitened.table.shape[1]
    parts: list[Floats] = []
    at_free, at_random = 0, first_random
    for choice, extra in zip(choices, extras, strict=True):
        width = extra.free.shape[1] + extra.random.shape[1]
        if choice.form.shrunk:
            parts.append(solution.table[at_random : at_random + width] * math.sqrt(choice.variance))
            at_random += width
        else:
            parts.append(solution.coefficients[at_free : at_free + width])
            at_free += width
    if posterior is None:
        return [choice.as_term(part) for choice, part in zip(choices, parts, strict=True)]
    slopes = [slopes_of(campaign.columns, choice, part) for choice, part in zip(choices, parts, strict=True)]
    normal, _ = projection.normal(np.hstack([np.zeros((len(campaign), 0)), *(extra.free for extra in extras), *slopes]))
    covariance = np.linalg.pinv(normal, rcond=1e-13, hermitian=True) * solution.variance
    terms: list[Term] = []
    at_slope, at_free, at_random = at_free, 0, first_random
    for choice, part, slope in zip(choices, parts, slopes, strict=True):
        width = len(part)
        if choice.form.shrunk:
            index = np.arange(at_random, at_random + width)
            terms.append(choice.as_term(part, np.asarray(posterior[np.ix_(index, index)] * choice.variance)))
            at_random += width
        else:
            index = np.array([*range(at_free, at_free + width), *range(at_slope, at_slope + slope.shape[1])])
            terms.append(choice.as_term(part, covariance[np.ix_(index, index)]))
            at_free += width
        at_slope += slope.shape[1]
    return terms


def static_part(linear: LinearCampaign, choices: Sequence[Choice], plain: Noise | None = None) -> StaticPart | None:
    """What a declared table may have absorbed of some choices, as orthogonal columns; None without choices.

    Of one that varies besides position and direction: its parts in a table of these rows, however smooth that was fitted and with
    run offsets or without; `plain` is the noise of the table that a fit of these rows without the choices makes. Of a static one only
    its part in a rough table: the rest of it is in any table of its kind. Of one that is a table itself nothing: it and its share
    would grow without bound against each other.
    """
    free = [choice for choice in choices if not choice.form.shrunk and not choice.effect.is_table]
    if not free or not isinstance(linear.shape, SplineShape):
        return None
    w = linear.table.table_width
    none = np.zeros((len(linear.campaign), 0))
    tables = [Noise(even=roughness, odd=roughness, offset=offset) for roughness, offset in ABSORBING]
    tables += [] if plain is None else [plain]
    parts = [
        linear.projection(noise, column).solve(none).table[:w]
        for choice in free
        for column in choice.columns(linear.campaign).T
        for noise in (tables[:1] if choice.effect.static else tables)
    ]
    at_rows = linear.table.stacked[:, :w] @ np.column_stack(parts)
    _, size, directions = np.linalg.svd(
        at_rows / np.maximum(np.linalg.norm(at_rows, axis=0), 1e-300), full_matrices=False
    )
    kept = directions[size > SAME_PART * size[0]].T
    return StaticPart(linear.shape, np.column_stack(parts) / np.maximum(np.linalg.norm(at_rows, axis=0), 1e-300) @ kept)
