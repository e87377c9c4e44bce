"""Refined parameters against a dense scan of least squares, and what a fit says of their uncertainty against the profile."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.search.candidates import enumerate_candidates, score
from hil.diagnosis.search.fit import Choice, Setting, joint_fit
from hil.diagnosis.search.rank import refine
from hil.effects import Effect
from hil.effects.cyclic import Cyclic
from hil.effects.lost_motion import LostMotion

STIFF = Noise(even=1e-7, odd=1e-7)
"""A table of straight lines, so that plain least squares says the same."""


def line(prepared: CampaignRows) -> np.ndarray:
    x = prepared.x / 300.0
    return np.column_stack([np.ones(len(x)), x, prepared.d, prepared.d * x])


def refined(prepared: CampaignRows, effect: Effect) -> tuple[Setting, Choice]:
    """The best grid point of an effect's first form, refined."""
    setting = Setting.free(prepared)
    candidates = enumerate_candidates(prepared, (effect,))
    projection = setting.linear.projection(STIFF, setting.error_um)
    gains = score(projection, candidates.stack(projection.whitened)).gain
    index = candidates.forms[0]
    top = candidates.choices[index[int(np.argmax(gains[index]))]]
    (choice, gain), *_ = refine(projection, [top])
    assert gain >= np.max(gains[index]) - 1e-9
    return setting, choice


def left(prepared: CampaignRows, columns: np.ndarray) -> np.ndarray:
    """Residual sums of squares of the error on lines and columns (n, m, k), for each of m: shape (m,)."""
    q, _ = np.linalg.qr(line(prepared))
    y = prepared.error_um - q @ (q.T @ prepared.error_um)
    z = columns - np.einsum("np,pmk->nmk", q, np.einsum("np,nmk->pmk", q, columns))
    b = np.einsum("nmk,n->mk", z, y)
    solved = np.linalg.solve(np.einsum("nmi,nmj->mij", z, z), b[:, :, None])[:, :, 0]
    return np.asarray(y @ y - np.sum(b * solved, axis=1))


def waves(x: np.ndarray, periods_mm: np.ndarray) -> np.ndarray:
    """Shape (n, m, 2)."""
    angle = 2 * np.pi * x[:, None] / periods_mm
    return np.stack([np.sin(angle), np.cos(angle)], axis=2)


def fades(prepared: CampaignRows, lengths_mm: np.ndarray) -> np.ndarray:
    """Shape (n, m, 1)."""
    since = prepared.columns["since_reversal_mm"][:, None]
    return (prepared.d[:, None] * np.exp(-since / lengths_mm))[:, :, None]


@pytest.mark.parametrize("period_mm", [3.37, 7.9, 16.43, 61.0])
def test_a_period_is_where_a_dense_scan_has_its_minimum(period_mm: float) -> None:
    prepared = prepare(campaign(lambda c: np.sin(2 * np.pi * c["target_mm"] / period_mm + 0.4), noise_um=0.4))
    _, choice = refined(prepared, Cyclic())
    near = period_mm * (1 + np.linspace(-0.5, 0.5, 401) * period_mm / 300.0)
    scan = left(prepared, waves(prepared.x, near))
    best = near[int(np.argmin(scan))]
    (found,) = left(prepared, waves(prepared.x, np.array(choice.theta)))
    variance = np.min(scan) / (len(prepared) - 7)
    assert found < np.min(scan) + 0.1 * variance  # within a third of a standard deviation of the minimum
    assert choice.theta[0] == pytest.approx(best, rel=0.3 * best / 300.0)


def test_a_length_of_lost_motion_is_where_a_dense_scan_has_its_minimum() -> None:
    def sensors(c: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
        since = rng.uniform(0.5, 60.0, len(c["run"]))
        return {"since_reversal_mm": since, "stroke_mm": np.full(len(c["run"]), 200.0) + rng.normal(size=len(c["run"]))}

    records = campaign(lambda c: 2.0 * c["direction"] * np.exp(-c["since_reversal_mm"] / 9.0), sensors=sensors)
    prepared = prepare(records)
    _, choice = refined(prepared, LostMotion())
    scan = left(prepared, fades(prepared, np.geomspace(3.0, 30.0, 400)))
    (found,) = left(prepared, fades(prepared, np.array(choice.theta)))
    assert found < np.min(scan) * (1 + 0.1 / len(prepared))


def test_the_uncertainty_of_a_period_is_that_of_scipy_and_of_the_profile() -> None:
    prepared = prepare(campaign(lambda c: 0.8 * np.sin(2 * np.pi * c["target_mm"] / 12.7) + wavy(c) / 1e3))
    setting, choice = refined(prepared, Cyclic())
    term = joint_fit(setting, STIFF, setting.error_um, [choice]).found[0]
    period = term.parameters["period_mm"]
    base = line(prepared)

    def residual(v: np.ndarray) -> np.ndarray:
        return np.asarray(base @ v[:4] + waves(prepared.x, v[6:])[:, 0] @ v[4:6] - prepared.error_um)

    fitted = least_squares(residual, [0, 0, 0, 0, 0.5, 0.5, choice.theta[0]], x_scale="jac", xtol=1e-14, ftol=1e-14)
    variance = 2 * fitted.cost / (len(prepared) - 7)
    covariance = np.linalg.inv(fitted.jac.T @ fitted.jac) * variance
    assert period.value == pytest.approx(fitted.x[6], abs=0.2 * np.sqrt(covariance[6, 6]))
    assert period.std == pytest.approx(np.sqrt(covariance[6, 6]), rel=0.05)
    assert term.parameters["amplitude_um"].value == pytest.approx(np.hypot(*fitted.x[4:6]), rel=0.01)
    periods = period.value + period.std * np.linspace(-4.0, 4.0, 801)
    rise = left(prepared, waves(prepared.x, periods)) / variance
    inside = periods[rise - np.min(rise) < 1.96**2]  # the profile's 95 % interval
    assert np.ptp(inside) == pytest.approx(2 * 1.96 * period.std, rel=0.05)
