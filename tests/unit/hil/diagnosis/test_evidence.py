"""Evidence from cross products against the same written out with whole covariance matrices (REML of Patterson & Thompson)."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import CampaignRows, campaign_of, prepare
from hil.diagnosis.diagnosing import beyond_noise, predicted_um
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection, bayes_factor, random_gain
from hil.diagnosis.noise.noise_fit import fit_noise, noise_with_speed
from hil.diagnosis.noise.repeats import PureError
from hil.diagnosis.result import NoiseParts
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.choose import of_equal_rows
from hil.diagnosis.search.fit import Setting
from hil.diagnosis.search.searcher import Searcher
from hil.effects import Estimate
from hil.effects.history import complete

CAMPAIGN = prepare(campaign(wavy, runs=4, targets=8))
BENCH = LinearCampaign(CAMPAIGN)
Y = CAMPAIGN.error_um
N = len(Y)
NOISES = [
    Noise(even=200.0, odd=50.0),
    Noise(ar=0.7, rho=0.9, even=100.0, odd=10.0),
    Noise(ar=1.2, rho=0.5, offset=0.5, even=300.0, odd=300.0),
]
COLUMNS = np.column_stack([np.sin(CAMPAIGN.x / 5.0), CAMPAIGN.d * np.cos(CAMPAIGN.x / 9.0)])


def correlation(noise: Noise) -> np.ndarray:
    """White noise and AR(1) within each pass, shape (n, n)."""
    lag = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    same = np.equal.outer(CAMPAIGN.sweep, CAMPAIGN.sweep)
    return np.eye(N) + noise.ar**2 * np.where(same, noise.rho ** lag.astype(float), 0.0)


def dense(noise: Noise, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the errors over the white variance, and the free columns, of some rows."""
    table, d = BENCH.table.shape, CAMPAIGN.d
    even = CAMPAIGN.basis.penalised(CAMPAIGN.x)
    odd = even * d[:, None]
    runs = np.equal.outer(CAMPAIGN.run, CAMPAIGN.run)
    v = correlation(noise) + noise.even * even @ even.T + noise.odd * odd @ odd.T + noise.offset**2 * runs
    return v[np.ix_(rows, rows)], table.free[rows]


def reml(v: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Restricted log likelihood with the variance profiled out, up to a constant; generalised residual sum of squares."""
    inverse = np.linalg.inv(v)
    xvx = x.T @ inverse @ x
    rest = y - x @ np.linalg.solve(xvx, x.T @ inverse @ y)
    rss = float(rest @ inverse @ rest)
    dof = len(y) - x.shape[1]
    return -0.5 * (np.linalg.slogdet(v)[1] + np.linalg.slogdet(xvx)[1] + dof * math.log(rss)), rss


@pytest.mark.parametrize("noise", NOISES)
def test_whitened_rows_are_uncorrelated_and_colouring_is_the_way_back(noise: Noise) -> None:
    whitened = BENCH.whitened(noise)
    w = whitened.whiten(np.eye(N))
    np.testing.assert_allclose(w @ correlation(noise) @ w.T, np.eye(N), atol=1e-9)
    np.testing.assert_allclose(whitened.colour(whitened.whiten(Y)), Y, atol=1e-9)


@pytest.mark.parametrize("out", [None, CAMPAIGN.run == 2], ids=["all rows", "without a run"])
def test_evidence_of_noise_models_and_residuals_are_those_of_the_whole_matrices(out: np.ndarray | None) -> None:
    rows = np.arange(N) if out is None else np.flatnonzero(~out)
    projections = [BENCH.projection(noise, Y, None, out) for noise in NOISES]
    expected = [reml(*dense(noise, rows), Y[rows]) for noise in NOISES]
    values = [
        float(projection.log_null) - noise.log_prior() for projection, noise in zip(projections, NOISES, strict=True)
    ]
    if out is None:  # with a run left out its random columns stay in the fit, where they add nothing to compare
        np.testing.assert_allclose(np.diff(values), np.diff([value for value, _ in expected]), atol=1e-5)
    np.testing.assert_allclose([float(f.rss) for f in projections], [rss for _, rss in expected], rtol=1e-6)


@pytest.mark.parametrize("noise", NOISES)
def test_columns_are_estimated_by_generalised_least_squares(noise: Noise) -> None:
    y = Y + COLUMNS @ [0.7, -1.1]
    solution = BENCH.projection(noise, y).solve(COLUMNS)
    v, x = dense(noise, np.arange(N))
    x = np.hstack([COLUMNS, x])
    inverse = np.linalg.inv(v)
    covariance = np.linalg.inv(x.T @ inverse @ x)
    expected = covariance @ (x.T @ inverse @ y)
    rest = y - x @ expected
    variance = float(rest @ inverse @ rest) / (N - x.shape[1])
    np.testing.assert_allclose(solution.coefficients, expected[:2], rtol=1e-5)
    assert solution.variance == pytest.approx(variance, rel=1e-5)
    np.testing.assert_allclose(solution.covariance, variance * covariance[:2, :2], rtol=1e-5)


def test_a_run_left_out_is_a_run_that_was_never_there() -> None:
    """Whatever stands in its rows."""
    out = CAMPAIGN.run == 1
    spoilt = Y + np.where(out, 1e3, 0.0)
    for noise in NOISES:
        a, b = (BENCH.projection(noise, y, None, out) for y in (Y, spoilt))
        assert float(a.rss) == pytest.approx(float(b.rss), rel=1e-9)
        assert a.gain(COLUMNS) == pytest.approx(b.gain(COLUMNS), abs=1e-9)
        assert a.rows == np.count_nonzero(~out)


def test_columns_beside_are_as_good_as_solved_for() -> None:
    beside = BENCH.projection(NOISES[1], Y, Extra(COLUMNS[:, :1], COLUMNS[:, :0]))
    together = BENCH.projection(NOISES[1], Y).solve(COLUMNS)
    assert beside.solve(COLUMNS[:, 1:]).coefficients[0] == pytest.approx(together.coefficients[1], rel=1e-6)


@given(st.floats(0.0, 0.999), st.integers(1, 5), st.integers(20, 400))
@settings(max_examples=50, deadline=None)
def test_the_bayes_factor_is_that_of_the_g_prior_with_unit_information_or_more(
    share: float, width: int, rows: int
) -> None:
    """(1 + g)^((dof - k) / 2) / (1 + g (1 - R²))^(dof / 2) (Liang et al. 2008, eq. 6); g = n, but g (1 - R²) at least 10."""
    dof = rows - 4
    value = float(bayes_factor(np.array(share), np.array(1.0), dof, width, rows))
    g = max(rows, 10 / (1 - share))
    expected = (dof - width) / 2 * math.log(1 + g) - dof / 2 * math.log(1 + g * (1 - share))
    assert value == pytest.approx(expected, abs=1e-9)
    assert float(bayes_factor(np.array(0.0), np.array(1.0), dof, width, rows)) < 0.0


def test_what_is_left_beside_a_strong_cause_counts_in_full() -> None:
    """Half as much left beside 10 000 times the noise's power is worth (dof - k) / 2 · ln 2 more; with g = n a hundredth of that."""
    dof, width = 96, 2
    left = np.array([1e-4, 5e-5])
    worse, better = bayes_factor(1.0 - left, np.array(1.0), dof, width, 100)
    assert better - worse == pytest.approx((dof - width) / 2 * math.log(2.0), rel=0.01)


def test_a_random_effect_gains_what_its_marginal_likelihood_does() -> None:
    """Its variance ratio enters the covariance; one nat is taken for having chosen it."""
    design = np.column_stack([np.sin(CAMPAIGN.columns["time_s"] / 60.0 * k) for k in range(1, 7)])
    y = Y + design @ [0.4, -0.3, 0.5, 0.1, -0.2, 0.3]
    noise = NOISES[0]
    projection: Projection = BENCH.projection(noise, y)
    gain, variance = random_gain(projection, design)
    v, x = dense(noise, np.arange(N))
    with_it, _ = reml(v + float(variance) * design @ design.T, x, y)
    without, _ = reml(v, x, y)
    assert float(gain) == pytest.approx(with_it - without - 1.0, abs=1e-4)
    assert float(gain) > 5.0


@pytest.mark.parametrize("noise", NOISES)
def test_rows_whose_noise_is_larger_weigh_less(noise: Noise) -> None:
    """White and correlated noise over the scale of each row; table and offsets of the runs as they are."""
    rng = np.random.default_rng(5)
    scale = rng.uniform(0.5, 2.0, N)
    weighted = LinearCampaign(replace(CAMPAIGN, scale=scale))
    worth = []
    for linear, s in ((BENCH, np.ones(N)), (weighted, scale)):
        whole, x = dense(noise, np.arange(N))
        v = whole - correlation(noise) + np.outer(s, s) * correlation(noise)
        both = np.hstack([x, COLUMNS])
        inverse = np.linalg.inv(v)
        expected = np.linalg.solve(both.T @ inverse @ both, both.T @ inverse @ Y)[x.shape[1] :]
        projection = linear.projection(noise, Y)
        assert projection.estimate(COLUMNS) == pytest.approx(expected, rel=1e-6)
        assert projection.solve(COLUMNS).coefficients == pytest.approx(expected, rel=1e-6)
        worth.append((float(projection.log_null), reml(v, x, Y)[0]))
    assert worth[1][0] - worth[0][0] == pytest.approx(worth[1][1] - worth[0][1], rel=1e-6)
    white = weighted.whitened(noise)
    np.testing.assert_allclose(white.colour(white.whiten(COLUMNS)), COLUMNS, atol=1e-12)
    assert white.whiten(COLUMNS.astype(np.float32)).dtype == np.float32
    covariance = np.outer(scale, scale) * correlation(noise)
    w = white.whiten(np.eye(N))
    np.testing.assert_allclose(w @ covariance @ w.T, np.eye(N), atol=1e-9)


def at_speeds(speed_mm_s: np.ndarray) -> CampaignRows:
    """A campaign whose rows were taken at these speeds."""
    rows = len(speed_mm_s)
    columns = {"run": np.repeat([1.0, 2.0], rows // 2), "direction": np.ones(rows), "velocity_mm_s": speed_mm_s}
    columns["target_mm"] = np.resize(np.linspace(0.0, 300.0, 40), rows)
    return campaign_of(complete(columns), np.zeros(rows))


def test_noise_that_grows_with_the_speed_is_found_with_its_size() -> None:
    """Three times as large at 100 mm/s: 1, 2, 3 at 0, 50, 100 mm/s, over their root mean square, √(14/3)."""
    speed = np.tile([0.0, 50.0, -100.0], 80)
    left = np.random.default_rng(2).normal(size=240) * (1.0 + 2.0 * np.abs(speed) / 100.0)
    scale = noise_with_speed(left, at_speeds(speed))
    assert scale is not None
    assert scale[:3] == pytest.approx(np.array([1.0, 2.0, 3.0]) / math.sqrt(14 / 3), rel=0.15)
    assert np.mean(scale**2) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(5))
def test_noise_that_does_not_is_left(seed: int) -> None:
    rng, speed = np.random.default_rng(seed), np.tile([0.0, 50.0, -100.0], 80)
    assert noise_with_speed(rng.normal(size=240), at_speeds(speed)) is None
    far = rng.standard_t(3, 240)
    far[2] = 30.0  # one row at the highest speed far off
    assert noise_with_speed(far, at_speeds(speed)) is None
    assert noise_with_speed(rng.normal(size=240) * (1.0 + np.arange(240)), at_speeds(np.zeros(240))) is None


def test_sizes_in_um_count_every_row_alike_and_repeats_by_their_own_noise() -> None:
    """Rows at rest are repeated, half of all; at speed the noise is f times as large: the whole is √((1 + f²) / 2) of that at rest."""
    scale = np.where(np.arange(N) % 2, 5.0, 1.0)
    scale = scale / np.sqrt(np.mean(scale**2))
    weighted = replace(CAMPAIGN, scale=scale)
    chosen = [
        SimpleNamespace(
            last=SimpleNamespace(searcher=Searcher(Setting.free(rows), enumerate_candidates(rows, [])), noise=NOISES[0])
        )
        for rows in (CAMPAIGN, weighted)
    ]
    course = COLUMNS[:, :1]
    alike = [of_equal_rows(one).rms_left(course[:, 0]) for one in chosen]
    assert alike[1] == pytest.approx(alike[0])
    of_rest = 1.0 / math.sqrt((1.0 + 25.0) / 2.0)
    parts = NoiseParts(2.0, 0.0, 0.0, 0.0)  # all rows
    floor = PureError(Estimate(2.0 * of_rest, 0.01), 30, "repeats", np.arange(30))
    assert predicted_um(floor, parts, 300, 0.0, alike=of_rest) == pytest.approx(2.0)
    assert not list(beyond_noise(floor, parts, 2.0, 2.0, 300, alike=of_rest))
    assert len(list(beyond_noise(floor, parts, 2.0, 2.0, 300))) == 1


def test_the_noise_model_found_is_the_best_of_its_neighbourhood() -> None:
    """No small step of any parameter improves its evidence, and the search does better than where it started."""
    start = Noise(even=300.0, odd=300.0)
    noise = fit_noise(BENCH, Y, Extra.none(N), start, correlations=((0.0, 0.0),))

    def evidence(trial: Noise) -> float:
        v, x = dense(trial, np.arange(N))
        return reml(v, x, Y)[0] + trial.log_prior()

    best = evidence(noise)
    assert best >= evidence(start)
    for name in ("even", "odd"):
        for factor in (0.3, 3.0):
            trial = Noise(**{**vars(noise), name: getattr(noise, name) * factor})
            assert evidence(trial) < best + 0.3
