"""The evidence by one Cholesky factor against the same written out with whole covariance matrices, and by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.campaigns import campaign, wavy
from support.docs import PAGES

from hil.diagnosis.campaign import prepare
from hil.diagnosis.model.candidates import Catalogue
from hil.diagnosis.model.evidence import Fit, Noise, Part, Profile, log_bayes, score
from hil.diagnosis.model.rows import EVEN, LEFT_OUT, ODD, OFFSET, ModelRows, NoiseMemory
from hil.effects import ALL

CAMPAIGN = prepare(campaign(wavy, runs=4, targets=8))
ROWS = ModelRows(CAMPAIGN)
N = ROWS.n
RANDOM = np.random.default_rng(3)
NOISES = [
    Noise(NoiseMemory(0.0, 0.0), np.array([2.0, 1.0, -2.0])),
    Noise(NoiseMemory(0.7, 0.8), np.array([1.0, 3.0, -1.0])),
    Noise(NoiseMemory(1.1, 0.6), np.array([-2.0, 0.5, -0.5])),
]


def part(free: int = 0, random: int = 0, absorbed: int = 0) -> Part:
    """A part of smooth random columns."""
    wide = np.cumsum(RANDOM.normal(size=(N, free + random + absorbed)), axis=0)
    return Part("p", (), wide[:, :free], wide[:, free : free + random], wide[:, free + random :])


def dense(noise: Noise, parts: list[Part], scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the errors over the white variance, and the columns without a prior, written out row by row."""
    same = np.equal.outer(CAMPAIGN.run, CAMPAIGN.run)
    apart = np.abs(np.subtract.outer(np.arange(N), np.arange(N))).astype(float)
    v = np.outer(scale, scale) * (np.eye(N) + noise.memory.ar**2 * same * noise.memory.rho**apart)
    even = CAMPAIGN.basis.penalised(CAMPAIGN.x)
    odd = even * CAMPAIGN.d[:, None]
    sd = np.exp(noise.log_sd)
    v += sd[EVEN] ** 2 * even @ even.T + sd[ODD] ** 2 * odd @ odd.T + sd[OFFSET] ** 2 * same
    v += sum((one.random @ one.random.T for one in parts), np.zeros((N, N)))
    x = np.hstack([CAMPAIGN.basis.free(CAMPAIGN.x, CAMPAIGN.d), *(one.absorbed for one in parts)])
    return v, x


def restricted(v: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Log likelihood with a flat prior on x, the variance integrated out, without what depends on x alone; squares left."""
    inverse = np.linalg.inv(v)
    xvx = x.T @ inverse @ x
    left = y @ (inverse - inverse @ x @ np.linalg.solve(xvx, x.T @ inverse)) @ y
    logs = np.linalg.slogdet(v)[1] + np.linalg.slogdet(xvx)[1]
    return float(-0.5 * (logs + (len(y) - x.shape[1]) * math.log(left))), float(left)


@pytest.mark.parametrize("noise", NOISES)
def test_the_evidence_is_that_of_whole_matrices(noise: Noise) -> None:
    out = np.arange(N) % 7 == 3
    rows, scale = ROWS.without(out), np.where(out, LEFT_OUT, 1.0)
    for parts in ([], [part(random=3)], [part(random=2), part(random=2)]):
        v, x = dense(noise, parts, scale)
        expected = restricted(v, x, ROWS.y)[0] + noise.log_prior
        assert Profile(rows, parts, noise.memory).value(noise.log_sd)[0] == pytest.approx(expected)


@pytest.mark.parametrize("absorbed", [0, 1])
@pytest.mark.parametrize("noise", NOISES)
def test_columns_with_a_g_prior_have_the_bayes_factor_of_whole_matrices(noise: Noise, absorbed: int) -> None:
    """Those that a declared table has absorbed as well."""
    effect = part(free=2 - absorbed, absorbed=absorbed)
    columns = np.hstack([effect.free, effect.absorbed])
    v, x = dense(noise, [], np.ones(N))
    without, squares = restricted(v, x, ROWS.y)
    left = restricted(v, np.hstack([x, columns]), ROWS.y)[1] / squares
    g, dof = max(N, 10.0 / left), N - x.shape[1]
    # Liang et al., JASA 103 (2008), eq. 6: (1 + g)^((n - 1 - k) / 2) (1 + g (1 - R²))^(-(n - 1) / 2)
    factor = 0.5 * (dof - 2) * math.log(1 + g) - 0.5 * dof * math.log(1 + g * left)
    value = Profile(ROWS, [effect], noise.memory).value(noise.log_sd)[0]
    assert value == pytest.approx(without + factor + noise.log_prior)
    assert Fit(ROWS, [], noise).gain(columns) == pytest.approx(factor, rel=1e-5)


@pytest.mark.parametrize("noise", NOISES)
def test_the_gradient_is_that_of_differences(noise: Noise) -> None:
    for parts in ([], [part(free=2), part(random=3)], [part(free=1, absorbed=1)]):
        profile = Profile(ROWS, parts, noise.memory)
        for i, step in enumerate(1e-4 * np.eye(3)):
            ends = [profile.value(noise.log_sd + sign * step)[0] for sign in (1.0, -1.0)]
            assert profile.value(noise.log_sd)[1][i] == pytest.approx((ends[0] - ends[1]) / 2e-4, abs=1e-3)


def test_a_random_part_gains_what_it_adds_to_the_evidence() -> None:
    noise = NOISES[1]
    block = part(random=4)
    gain, ratio = Fit(ROWS, [], noise).random_gain(block.random)
    scaled = replace(block, random=block.random * math.sqrt(ratio))
    apart = Fit(ROWS, [scaled], noise).log_p - Fit(ROWS, [], noise).log_p
    assert gain == pytest.approx(apart, abs=1e-6)
    both = np.hstack([block.random, part(random=4).random]).astype(np.float32)
    assert Fit(ROWS, [], noise).random_gains(both.T, 4, "both")[0] == pytest.approx(gain, abs=0.05)


def test_the_factor_of_one_column_by_hand() -> None:
    """n = 3 rows about their mean, y = (-1, 0, 1) + (0.1, -0.2, 0.1), one column (-1, 0, 1): R² = 2² / (2 · 2.06), ν = 2."""
    left = 1.0 - 4.0 / (2.0 * 2.06)
    g = 10.0 / left  # more than n
    by_hand = 0.5 * (2 - 1) * math.log(1 + g) - 0.5 * 2 * math.log(1 + 10.0)
    assert by_hand == pytest.approx(0.5 * math.log(344.3333) - math.log(11.0), abs=1e-4)
    assert float(log_bayes(np.array(left), 2, 1, 3)) == pytest.approx(by_hand)
    page = PAGES["model"].read_text(encoding="utf-8")
    assert f"left = {left:.4f}" in page
    assert f"½ log {1 + g:.1f} - log 11 = {by_hand:.2f}" in page


def test_an_effect_has_the_mean_of_the_evidence_over_its_grid_with_the_prior_of_its_parameters() -> None:
    rows = ModelRows(prepare(campaign(lambda c: wavy(c) - np.exp(-c["time_s"] / 30.0), runs=4, targets=8)))
    fit = Fit(rows, [], NOISES[0])
    (drift,) = (effect for effect in ALL if effect.id == "thermal_drift")
    by_form = {one.candidate.form.name: one for one in Catalogue(rows, [drift]).ranked([fit])}
    found = by_form["warming since the start"]
    form = found.candidate.form
    middle, spread = form.nonlinear[0].usual or (1.0, 1.0)
    prior = np.array([-0.5 * (math.log(theta / middle) / spread) ** 2 for (theta,) in form.starts])
    gains = np.array([fit.gain(drift.basis(form, theta, rows.campaign.columns)) for theta in form.starts])
    mean = math.log(np.sum(np.exp(gains + prior)) / np.sum(np.exp(prior)))
    assert found.gain == pytest.approx(mean, abs=0.03)  # in single precision
    assert abs(mean - math.log(np.mean(np.exp(gains)))) > 0.1


def test_the_best_noise_is_found_again_from_rows_that_have_it() -> None:
    """The standard deviation within a run, in the mean over twelve draws."""
    found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        memory = NoiseMemory(0.7, 0.8)
        apart = np.abs(np.subtract.outer(np.arange(N), np.arange(N))).astype(float)
        same = np.equal.outer(CAMPAIGN.run, CAMPAIGN.run)
        root = np.linalg.cholesky(np.eye(N) + memory.ar**2 * same * memory.rho**apart)
        rows = ModelRows(replace(CAMPAIGN, error_um=2.0 * root @ rng.normal(size=N) + 3.0 * CAMPAIGN.d))
        best = score(rows, [])[0]
        found.append(Fit(rows, [], best.noise).sigma * math.hypot(1.0, best.noise.memory.ar))
    assert np.mean(found) == pytest.approx(2.0 * math.hypot(1.0, 0.7), rel=0.15)
