"""The usual ways to choose among candidate columns, given the same columns as the diagnosis, and a black box.

Forward selection by BIC, the lasso with whole runs left out (scikit-learn), and sequentially thresholded least squares (pysindy's
STLSQ, where it is installed). A smoothing spline per direction, the declared table, is taken out of errors and candidates first; every
column then has unit size. The black box is a sum of boosted trees of the recorded columns, beside the same table. Written apart from
`hil.diagnosis`, of which only the candidate columns are used.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import lasso_path

from hil.diagnosis.campaign import prepare
from hil.diagnosis.model.evidence import Candidate
from hil.effects import ALL, Action
from hil.effects.history import complete
from hil.records.rows import Records

try:
    from pysindy import STLSQ
except ImportError:
    STLSQ = None

Array = np.ndarray

MOST_TERMS = 5
"""Largest number of candidates of forward selection, as in the diagnosis."""
LASSO_ALPHAS = np.geomspace(1.0, 0.05, 20)
"""Penalties of the lasso, relative to the one at which the first column enters."""
THRESHOLDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Thresholds of STLSQ, relative to the standard deviation of the errors."""
STIFFNESSES = np.geomspace(1e-4, 1e2, 13)
"""Stiffnesses of the table's spline, tried by generalised cross-validation."""
ALL_OF_IT = slice(None)
FOLDS = 4
"""Number of folds: every run is left out once, two of the eight at a time."""
RIDGE = 0.05
"""STLSQ's own, its default."""


BLACK_BOX = "boosted trees"
TREES = (0, 10, 30, 100, 300)
"""Numbers of trees tried on runs left out; 0 is the table alone."""
MEASURED = ("run", "measured_mm")
"""Columns that a correction cannot know."""


@dataclass(frozen=True)
class Data:
    """One campaign as columns.

    target_mm, direction, error_um, run (n,); columns (n, J) of the candidates
    choices: what the candidates are; owner: index of the candidate of each column, (J,)
    """

    target_mm: Array
    direction: Array
    error_um: Array
    run: Array
    columns: Array
    choices: tuple[Candidate, ...]
    owner: Array

    @classmethod
    def of(cls, records: Records) -> Data:
        campaign = prepare(records)
        found = [
            Candidate(effect, form, theta)
            for effect in ALL
            for form in effect.forms(campaign.survey)
            if form.scan and not form.shrunk
            for theta in form.starts
        ]
        columns = [one.effect.basis(one.form, one.theta, campaign.columns) for one in found]
        owner = np.repeat(np.arange(len(found)), [one.shape[1] for one in columns])
        return cls(campaign.x, campaign.d, campaign.error_um, campaign.run, np.hstack(columns), tuple(found), owner)


class Table:
    """A smoothing spline per direction, f(x) + d·g(x), with the stiffness of generalised cross-validation."""

    def __init__(self, target_mm: Array, direction: Array, y: Array) -> None:
        per_pass = len(y) / max(1, np.count_nonzero(np.diff(direction)) + 1)
        self.knots = np.quantile(target_mm, np.linspace(0.0, 1.0, int(np.clip(per_pass, 4, 40))))
        even = np.linspace(self.knots[0], self.knots[-1], 4 * len(self.knots))
        bends = np.diff(self._part(even), 2, axis=0) * len(even) ** 1.5
        self.bends = np.kron(np.eye(2), np.linalg.qr(bends)[1])
        columns = self.columns(target_mm, direction)
        scores = []
        for stiffness in STIFFNESSES:
            q = np.linalg.qr(np.vstack([columns, stiffness * self.bends]))[0][: len(y)]
            left = y - q @ (q.T @ y)
            scores.append(left @ left / (len(y) - np.sum(q**2)) ** 2)
        self.rows = STIFFNESSES[int(np.argmin(scores))] * self.bends

    def columns(self, target_mm: Array, direction: Array) -> Array:
        part = self._part(target_mm)
        return np.hstack([part, part * direction[:, None]])

    def _part(self, x: Array) -> Array:
        """Natural spline through 1 at one knot and 0 at the others, straight beyond the ends."""
        spline = CubicSpline(self.knots, np.eye(len(self.knots)), bc_type="natural")
        inside = np.clip(x, self.knots[0], self.knots[-1])
        return spline(inside) + (x - inside)[:, None] * spline(inside, 1)


class Beside:
    """Errors and columns of some rows after the table is taken out: the residuals, the columns of unit size."""

    def __init__(self, data: Data, rows: Array) -> None:
        self.table = Table(data.target_mm[rows], data.direction[rows], data.error_um[rows])
        wide = np.vstack([self.table.columns(data.target_mm[rows], data.direction[rows]), self.table.rows])
        padding = len(self.table.rows)
        y = np.concatenate([data.error_um[rows], np.zeros(padding)])
        z = np.vstack([data.columns[rows], np.zeros((padding, data.columns.shape[1]))])
        q, r = np.linalg.qr(wide)
        inverse = np.linalg.pinv(r)
        self.of_y, self.of_z = inverse @ (q.T @ y), inverse @ (q.T @ z)
        self.y, z = y - q @ (q.T @ y), z - q @ (q.T @ z)
        self.n = int(rows.sum())
        size = np.linalg.norm(z, axis=0)
        blind = size <= 0.01 * np.linalg.norm(data.columns[rows], axis=0)
        self.scale = np.where(blind, np.inf, size) / np.sqrt(self.n)
        self.z = np.asfortranarray(z / self.scale, dtype=np.float32)  # a third of the time, and enough to choose by

    def predicted(
        self, target_mm: Array, direction: Array, columns: Array, b: Array, which: Array = ALL_OF_IT
    ) -> Array:
        """Errors at other rows, (m,) or (m, p), from coefficients b (J,) or (J, p) of `z`; of the columns `which` alone."""
        table = self.table.columns(target_mm, direction)
        base, scale = table @ self.of_y, self.scale[which]
        if b.ndim == 2:
            base, scale = base[:, None], scale[:, None]
        return base + (columns - table @ self.of_z[:, which]) @ (b[which] / scale)


@dataclass(frozen=True)
class Verdict:
    """names: the effects found, the largest first; fresh_um: RMS left of a new campaign, machine effects corrected, µm."""

    names: tuple[str, ...]
    fresh_um: float


def forward_bic(data: Data) -> Array:
    """Candidates one by one while BIC falls; a candidate costs its columns and its non-linear parameters."""
    beside = Beside(data, np.ones(len(data.error_um), dtype=bool))
    first = np.flatnonzero(np.diff(data.owner, prepend=-1))
    width = np.bincount(data.owner)
    chosen: list[int] = []
    y, z = beside.y, beside.z.astype(np.float64)
    for _ in range(MOST_TERMS):
        explained = np.zeros(len(width))
        for k in np.unique(width):
            which = np.flatnonzero(width == k)
            index = first[which][:, None] + np.arange(k)
            a = np.einsum("nci,ncj->cij", z[:, index], z[:, index]) + 1e-6 * len(y) * np.eye(k)
            b = np.einsum("nci,n->ci", z[:, index], y)
            explained[which] = np.einsum("ci,ci->c", b, np.linalg.solve(a, b[:, :, None])[:, :, 0])
        cost = (width + [len(choice.theta) for choice in data.choices]) * np.log(beside.n)
        gain = -beside.n * np.log(np.maximum(1.0 - explained / (y @ y), 1e-12)) - cost
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] <= 0.0:
            break
        chosen.append(best)
        q, _ = np.linalg.qr(z[:, data.owner == best])
        y, z = y - q @ (q.T @ y), z - q @ (q.T @ z)
    coefficients = np.zeros(z.shape[1])
    mine = np.isin(data.owner, chosen)
    coefficients[mine] = np.linalg.lstsq(beside.z[:, mine], beside.y, rcond=1e-10)[0]
    return coefficients


def lasso_by_runs(data: Data) -> Array:
    """The sparsest lasso within one standard error of the best on runs left out."""

    def path(beside: Beside) -> Array:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            alphas = LASSO_ALPHAS * np.max(np.abs(beside.z.T @ beside.y)) / len(beside.y)
            return lasso_path(beside.z, beside.y.astype(np.float32), alphas=alphas, max_iter=100, tol=1e-3)[1]

    return _by_runs(data, path)


def stlsq_by_runs(data: Data) -> Array:
    """STLSQ with the threshold that is best on runs left out, the largest within one standard error. Raises ModuleNotFoundError."""
    if STLSQ is None:
        raise ModuleNotFoundError("pysindy is not installed: pip install -e .[test]")

    def path(beside: Beside) -> Array:
        spread = float(np.std(beside.y))
        y = (beside.y[:, None] / spread).astype(np.float32)
        gram = beside.z @ beside.z.T
        shortest = beside.z.T @ np.linalg.lstsq(gram, y, rcond=1e-5)[0]  # where STLSQ starts, found faster
        out = []
        for threshold in reversed(THRESHOLDS):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that a threshold leaves nothing, or that the ridge is ill-conditioned
                model = STLSQ(threshold=threshold, alpha=RIDGE, max_iter=20, initial_guess=shortest.T)
                out.append(np.ravel(model.fit(beside.z, y).coef_) * spread)
        return np.column_stack(out)

    return _by_runs(data, path)


def folds(run: Array) -> Array:
    """The fold of each row, (n,): runs by turns, or quarters of the rows where there are fewer runs than folds."""
    number = np.unique(run, return_inverse=True)[1]
    return number % FOLDS if number.max() + 1 >= FOLDS else np.arange(len(run)) * FOLDS // len(run)


def _by_runs(data: Data, path: Callable[[Beside], Array]) -> Array:
    """The coefficients of a path, sparsest first, chosen by leaving out runs with everything repeated, and one standard error."""
    everything = np.ones(len(data.error_um), dtype=bool)
    scores = []
    apart = folds(data.run)
    for fold in range(FOLDS):
        rows = apart != fold
        beside = Beside(data, rows)
        left = beside.predicted(data.target_mm[~rows], data.direction[~rows], data.columns[~rows], path(beside))
        scores.append(np.mean((data.error_um[~rows][:, None] - left) ** 2, axis=0))
    score = np.mean(scores, axis=0)
    best = int(np.argmin(score))
    limit = score[best] + np.std(scores, axis=0, ddof=1)[best] / np.sqrt(len(scores))
    return path(Beside(data, everything))[:, int(np.flatnonzero(score <= limit)[0])]


METHODS: dict[str, Callable[[Data], Array]] = {
    "forward BIC": forward_bic,
    "lasso, runs left out": lasso_by_runs,
    "STLSQ (pysindy)": stlsq_by_runs,
}


def available() -> dict[str, Callable[[Data], Array]]:
    """The methods that can run here."""
    return {name: method for name, method in METHODS.items() if method is not stlsq_by_runs or STLSQ is not None}


def judge(data: Data, coefficients: Array, fresh: Records) -> Verdict:
    """The effects of a choice of coefficients, and the RMS left of fresh records when the effects of the machine are corrected."""
    beside = Beside(data, np.ones(len(data.error_um), dtype=bool))
    names = [choice.effect.id for choice in data.choices]
    sizes: dict[str, Array] = {}
    for index in dict.fromkeys(data.owner[coefficients != 0]):
        mine = data.owner == index
        sizes[names[index]] = sizes.get(names[index], 0.0) + beside.z[:, mine] @ coefficients[mine]
    found = sorted(sizes, key=lambda name: -float(np.std(sizes[name])))
    machine = [
        i for i in np.unique(data.owner[coefficients != 0]) if data.choices[i].effect.action is Action.COMPENSATE
    ]
    rows = complete(fresh.columns)
    bases = [data.choices[i].effect.basis(data.choices[i].form, data.choices[i].theta, rows) for i in machine]
    columns = np.hstack([np.zeros((len(fresh), 0)), *bases])
    which = np.flatnonzero(np.isin(data.owner, machine))
    predicted = beside.predicted(rows["target_mm"], rows["direction"], columns, coefficients, which)
    return Verdict(tuple(found), float(np.sqrt(np.mean((fresh.uncorrected_error_um - predicted) ** 2))))


def boosted(first: Records, fresh: Records) -> float:
    """RMS left of fresh records by the table and gradient-boosted trees of all recorded columns, µm; as many trees as are best on runs
    left out.
    """
    names = [name for name in first.columns if name not in MEASURED and name in fresh.columns]
    features, later = (np.column_stack([one.columns[name] for name in names]) for one in (first, fresh))
    error, apart = first.uncorrected_error_um, folds(first.run)

    def predicted(rows: Array, at: Array, trees: int, records: Records) -> Array:
        x, d = first.target_mm[rows], first["direction"][rows]
        table = Table(x, d, error[rows])
        fit = np.vstack([table.columns(x, d), table.rows])
        b = np.linalg.lstsq(fit, np.concatenate([error[rows], np.zeros(len(table.rows))]), rcond=None)[0]
        here, there = table.columns(x, d) @ b, table.columns(records.target_mm, records["direction"]) @ b
        if not trees:
            return there
        model = HistGradientBoostingRegressor(max_iter=trees, learning_rate=0.1, early_stopping=False, random_state=0)
        return there + model.fit(features[rows], error[rows] - here).predict(at)

    def left(trees: int) -> float:
        squares = []
        for fold in range(FOLDS):
            out = apart == fold
            squares.append((error[out] - predicted(~out, features[out], trees, first.where(out))) ** 2)
        return float(np.mean(np.concatenate(squares)))

    best = min(TREES, key=left)
    everything = np.ones(len(error), dtype=bool)
    off = fresh.uncorrected_error_um - predicted(everything, later, best, fresh)
    return float(np.sqrt(np.mean(off**2)))
