"""What one who knows the true cause and the noise would reach: the table fitted beside it, and a test for a cause's
presence.

The free table is a cubic B-spline of 22 intervals per direction, unpenalised: what it holds nobody can attribute. The
reference table has the same splines, mean and half difference of the directions, with a second-difference penalty
each, chosen by residual likelihood under the true covariance of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2
from study.grammar.environment import Floats, State

INTERVALS = 22
_GRID = np.geomspace(1e-4, 1e3, 8)
"""Variances (µm²) of the second differences of the spline coefficients that the reference table may have."""


def splines(state: State) -> Floats:
    """Cubic B-splines over the travel and its overrun, shape (n, INTERVALS + 3)."""
    margin = 0.03 * state.axis.travel_mm
    inner = np.linspace(-margin, state.axis.travel_mm + margin, INTERVALS + 1)
    step = inner[1] - inner[0]
    knots = np.concatenate([inner[0] - step * np.arange(3, 0, -1), inner, inner[-1] + step * np.arange(1, 4)])
    return np.asarray(BSpline.design_matrix(np.clip(state.x_mm, inner[0], inner[-1]), knots, 3).toarray())


def free_table(state: State) -> Floats:
    """Columns of a table per direction, shape (n, 2 (INTERVALS + 3))."""
    basis = splines(state)
    up = (state.direction > 0)[:, None]
    return np.hstack([basis * up, basis * ~up])


def left_beside(values: Floats, columns: Floats) -> Floats:
    """What least squares leaves of values, shape (n,) or (n, k), beside columns, shape (n, m)."""
    solution = np.linalg.lstsq(columns, values, rcond=1e-9)[0]
    return np.asarray(values - columns @ solution)


def outside_um(values: Floats, state: State) -> float:
    """RMS of what a free table of position and direction cannot hold, µm."""
    return float(np.sqrt(np.mean(left_beside(values, free_table(state)) ** 2)))


@dataclass(frozen=True)
class Reference:
    """The table fitted to errors without the cause, shape (n,), with the covariance of the noise, shape (n, n)."""

    state: State
    error_um: Floats
    covariance: Floats

    @cached_property
    def _parts(self) -> tuple[Floats, Floats, Floats]:
        """Straight lines per direction; rough parts of mean and of half difference, scaled to independent
        coefficients.
        """
        return _table_parts(self.state)

    @cached_property
    def _chosen(self) -> tuple[float, float]:
        lines, mean, half = self._parts
        # diagonalise once per mean variance is not possible with two penalties: the grid is small enough to solve outright
        scored = []
        kernels = mean @ mean.T, half @ half.T
        for a in _GRID:
            for b in _GRID[::2]:
                scored.append(
                    (
                        _residual_likelihood(self.covariance + a * kernels[0] + b * kernels[1], lines, self.error_um),
                        (a, b),
                    )
                )
        return max(scored)[1]

    @cached_property
    def _total(self) -> Floats:
        _, mean, half = self._parts
        a, b = self._chosen
        return np.asarray(self.covariance + a * mean @ mean.T + b * half @ half.T)

    def table_um(self, state: State) -> Floats:
        """The best linear prediction of the table at the rows of another campaign, µm."""
        none = np.zeros((len(self.state), 0)), np.zeros((len(state), 0))
        return self.model_um(state, *none)

    def model_um(self, state: State, here_um: Floats, there_um: Floats) -> Floats:
        """The same with multiples of causes, shapes (n, k) and (n', k), fitted beside the table: what is still to be added to them."""
        lines, mean, half = self._parts
        fixed = np.hstack([lines, here_um])
        factor = cho_factor(self._total)
        weighted = cho_solve(factor, fixed)
        beta = np.linalg.lstsq(fixed.T @ weighted, weighted.T @ self.error_um)[0]
        rest = cho_solve(factor, self.error_um - fixed @ beta)
        there_lines, there_mean, there_half = _table_parts(state)
        a, b = self._chosen
        there = np.hstack([there_lines, there_um])
        return np.asarray(there @ beta + a * there_mean @ (mean.T @ rest) + b * there_half @ (half.T @ rest))

    def test(self, cause_um: Floats, error_um: Floats, table: bool = True) -> float:
        """p of the generalised-least-squares test that error, shape (n,), has a multiple of the cause in it; 1 when
        the table holds it.

        Without `table` the pitch is known (an older table has it) and only a line per direction is fitted beside the
        cause.
        """
        lines = self._parts[0]
        factor = cho_factor(self._total if table else self.covariance)
        weighted = cho_solve(factor, np.column_stack([lines, cause_um, error_um]))
        inner = np.linalg.solve(lines.T @ weighted[:, : lines.shape[1]], lines.T @ weighted[:, lines.shape[1] :])
        clean = weighted[:, lines.shape[1] :] - weighted[:, : lines.shape[1]] @ inner
        information = float(cause_um @ clean[:, 0])
        if information <= 1e-9 * float(cause_um @ weighted[:, lines.shape[1]]):
            return 1.0
        return float(chi2.sf(float(cause_um @ clean[:, 1]) ** 2 / information, 1))


def _table_parts(state: State) -> tuple[Floats, Floats, Floats]:
    basis = splines(state)
    difference = np.diff(np.eye(basis.shape[1]), n=2, axis=0)
    rough = basis @ difference.T @ np.linalg.inv(difference @ difference.T)
    d = state.direction[:, None]
    lines = np.column_stack([np.ones(len(state)), state.u, state.direction, state.direction * state.u])
    return lines, rough, rough * d


def _residual_likelihood(covariance: Floats, fixed: Floats, values: Floats) -> float:
    factor = cho_factor(covariance)
    weighted = cho_solve(factor, np.column_stack([fixed, values]))
    k = fixed.shape[1]
    inner = fixed.T @ weighted[:, :k]
    beta = np.linalg.solve(inner, fixed.T @ weighted[:, k])
    rest = values - fixed @ beta
    squares = float(rest @ (weighted[:, k] - weighted[:, :k] @ beta))
    logs = 2.0 * float(np.sum(np.log(np.diag(factor[0])))) + float(np.linalg.slogdet(inner)[1])
    return -0.5 * (squares + logs)
