"""The null distribution of the maximum: chances stated for noise come true on noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import prepare
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise
from hil.diagnosis.search.candidates import enumerate_candidates, score
from hil.diagnosis.search.judge import CAMPAIGNS, null_maxima, simulate, tail_probability
from hil.diagnosis.search.rank import smoother
from hil.effects import Effect
from hil.effects.cyclic import Cyclic
from hil.effects.datum_step import DatumStep
from hil.effects.local_wear import LocalWear
from hil.effects.lost_motion import LostMotion
from hil.effects.velocity_lag import VelocityLag


def sensors(c: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    n = len(c["run"])
    return {
        "velocity_mm_s": rng.choice([10.0, 30.0, 90.0], n),
        "since_reversal_mm": rng.uniform(1.0, 80.0, n),
        "stroke_mm": rng.uniform(100.0, 300.0, n),
    }


CAMPAIGN = prepare(campaign(wavy, runs=5, targets=10, travel_mm=60.0, sensors=sensors))
BENCH = LinearCampaign(CAMPAIGN)
N = len(CAMPAIGN)
NOISE = Noise(ar=0.6, rho=0.6, offset=0.3, even=100.0, odd=30.0)
EFFECTS: tuple[Effect, ...] = (Cyclic(), DatumStep(), LostMotion(), VelocityLag())


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.id)
def test_chances_of_the_best_candidate_are_uniform_on_noise(effect: Effect) -> None:
    """Four distributions of 300 campaigns each, judged on 800 others."""
    candidates = enumerate_candidates(CAMPAIGN, (effect,))
    offsets = np.full(CAMPAIGNS, NOISE.offset)
    projection = BENCH.projection(NOISE, simulate(BENCH, NOISE, np.full(800, NOISE.offset), seed=12))
    fresh = np.max(score(projection, candidates.stack(projection.whitened)).gain, axis=0)
    nulls = [null_maxima(BENCH, candidates, (NOISE,), offsets, Extra.none(N), seed=seed) for seed in range(4)]
    chances = np.concatenate([null.probability(effect.id, fresh) for null in nulls])
    for level in (0.01, 0.05, 0.2):
        share, error = np.mean(chances < level), np.sqrt(level / 800)
        assert 0.5 * level - 2 * error < share < 1.4 * level + 3 * error
    sample = np.concatenate([null.maxima[effect.id] for null in nulls])
    assert stats.ks_2samp(sample, fresh).pvalue > 0.003  # the maxima themselves are those of other noise


def test_a_search_over_more_candidates_goes_farther_in_noise() -> None:
    candidates = enumerate_candidates(CAMPAIGN, EFFECTS)
    null = null_maxima(BENCH, candidates, (NOISE,), np.full(CAMPAIGNS, 0.3), Extra.none(N), seed=1)
    far = {name: float(np.quantile(values, 0.95)) for name, values in null.maxima.items()}
    assert far["cyclic"] + 1.0 > far["velocity_lag"]
    assert far["datum_step"] > far["velocity_lag"]
    for name, values in null.maxima.items():
        assert np.min(values) >= null.floor[name] - 1e-6
        assert np.all(np.diff(null.probability(name, np.linspace(-3.0, 30.0, 50))) <= 1e-12)


def test_only_what_may_be_a_feature_of_one_place_is_profiled_over_smoother_tables() -> None:
    candidates = enumerate_candidates(CAMPAIGN, (Cyclic(), LocalWear()))
    offsets, smooth = np.full(CAMPAIGNS, 0.3), smoother(NOISE)
    rough, both, all_in_both = (
        null_maxima(BENCH, candidates, noises, offsets, Extra.none(N), seed=1, smooth=more).maxima
        for noises, more in (((NOISE,), ()), ((NOISE,), smooth), ((NOISE, *smooth), ()))
    )
    np.testing.assert_array_equal(both["cyclic"], rough["cyclic"])
    np.testing.assert_allclose(both["local_wear"], all_in_both["local_wear"], atol=1e-3)
    assert np.quantile(np.abs(both["local_wear"] - rough["local_wear"]), 0.9) > 0.1


def test_simulated_campaigns_have_the_covariance_of_their_noise() -> None:
    y = simulate(BENCH, NOISE, np.full(4000, 0.3), seed=3)
    even = CAMPAIGN.basis.penalised(CAMPAIGN.x)
    odd = even * CAMPAIGN.d[:, None]
    lag = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    same = np.equal.outer(CAMPAIGN.sweep, CAMPAIGN.sweep)
    expected = np.eye(N) + 0.36 * np.where(same, 0.6 ** lag.astype(float), 0.0) + 100.0 * even @ even.T
    expected += 30.0 * odd @ odd.T + 0.09 * np.equal.outer(CAMPAIGN.run, CAMPAIGN.run)
    got = y @ y.T / 4000
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(got - expected) / size) < 5.5 / np.sqrt(4000)


@given(st.floats(0.3, 5.0), st.floats(0.2, 3.0), st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_a_tail_is_a_chance_that_falls_and_covers_the_sample(shape: float, scale: float, seed: int) -> None:
    """Between 0 and 1, falling, and past nine tenths of a gamma sample no less than a third of what is there."""
    sample = np.random.default_rng(seed).gamma(shape, scale, 300)
    values = np.linspace(0.0, 8.0 * scale * shape, 60)
    tail = tail_probability(sample, 0.0, values)
    assert np.all((tail >= 0.0) & (tail <= 1.0))
    assert np.all(np.diff(tail) <= 1e-12)
    assert float(tail_probability(sample, 0.0, float(np.quantile(sample, 0.9)))) > 0.033
