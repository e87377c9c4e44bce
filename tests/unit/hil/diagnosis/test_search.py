"""The search on small campaigns: what is there is taken once, what noise resembles is not, what no longer earns its place goes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import prepare
from hil.diagnosis.policy import policy
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Setting, start_noise
from hil.diagnosis.search.judge import FoldJudge, NullJudge
from hil.diagnosis.search.search import Selection, search
from hil.diagnosis.search.searcher import LIGHT, Searcher
from hil.diagnosis.search.select import drop
from hil.effects import Effect
from hil.effects.cyclic import Cyclic
from hil.effects.load_deflection import LoadDeflection
from hil.effects.thermal_drift import ThermalDrift
from hil.effects.velocity_lag import VelocityLag

Array = np.ndarray
EFFECTS: tuple[Effect, ...] = (Cyclic(), VelocityLag(), LoadDeflection(), ThermalDrift())


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    n = len(c["run"])
    return {
        "velocity_mm_s": rng.choice([10.0, 30.0, 90.0], n),
        "load_kg": rng.choice([0.0, 50.0, 100.0], n),
        "temp_screw_c": 20.0 + 3.0 * (1.0 - np.exp(-c["time_s"] / 200.0)) + rng.normal(0.0, 0.2, n),
        "since_reversal_mm": rng.uniform(1.0, 80.0, n),
        "stroke_mm": rng.uniform(100.0, 300.0, n),
    }


def searched(error_um: Callable[[dict[str, Array]], Array], seed: int = 1) -> tuple[Searcher, Selection]:
    prepared = prepare(
        campaign(lambda c: wavy(c) + error_um(c), runs=5, targets=10, travel_mm=80.0, sensors=sensors, seed=seed)
    )
    searcher = Searcher(Setting.free(prepared), enumerate_candidates(prepared, EFFECTS), None, LIGHT)
    return searcher, search(searcher, start_noise(prepared), NullJudge(0))


@pytest.fixture(scope="module")
def lagging() -> tuple[Searcher, Selection]:
    """A machine that lags, and nothing else."""
    return searched(lambda c: 0.02 * c["direction"] * c["velocity_mm_s"])


def names(selection: Selection) -> list[str]:
    return [choice.effect.id for choice in selection.choices]


def test_two_effects_at_once_are_taken_the_clearer_first() -> None:
    searcher, found = searched(
        lambda c: 0.02 * c["direction"] * c["velocity_mm_s"] + 0.6 * np.sin(2 * np.pi * c["target_mm"] / 5.3)
    )
    assert names(found) == ["velocity_lag", "cyclic"]
    fit = searcher.fit(found.choices, found.noise)
    lag, cyclic = fit.found
    assert lag.coefficients[0] == pytest.approx(0.02, abs=4 * np.sqrt(lag.covariance[0][0]))
    assert cyclic.parameters["period_mm"].value == pytest.approx(5.3, rel=0.01)
    assert fit.white_um == pytest.approx(0.3, rel=0.2)


def test_noise_is_left_alone() -> None:
    assert [names(searched(lambda c: 0.0 * c["run"], seed=seed)[1]) for seed in range(2)] == [[]] * 2


def test_a_term_that_no_longer_brings_anything_is_dropped_and_only_that(lagging: tuple[Searcher, Selection]) -> None:
    searcher, found = lagging
    idle = next(choice for choice in searcher.candidates.choices if choice.effect.id == "load_deflection")
    kept = drop(searcher, [*found.choices, idle], found.noise)
    assert kept == list(found.choices)
    assert drop(searcher, [idle, *found.choices], found.noise, fixed=1) == [idle, *found.choices]


def test_gains_of_the_whole_campaign_decide_in_the_folds(lagging: tuple[Searcher, Selection]) -> None:
    searcher, found = lagging
    gain = found.stages[0].ranking[0].evidence - found.stages[0].before
    for critical, taken in ((gain - 1.0, ["velocity_lag"]), (gain + 1.0, [])):
        searcher.limit_outliers((), found.noise)
        judge = FoldJudge(dict.fromkeys(("cyclic", "velocity_lag", "load_deflection", "thermal_drift"), critical))
        assert names(search(searcher, found.stages[0].ranking[0].noise, judge)) == taken


def test_the_gain_that_is_just_significant_is_where_its_chance_is_the_wanted_one(
    lagging: tuple[Searcher, Selection],
) -> None:
    searcher, found = lagging
    judge = NullJudge(0)
    judge.probability(found.stages[0], searcher, (), found.noise)
    assert judge.null is not None
    critical = judge.critical()
    assert set(critical) == {effect.id for effect in EFFECTS}
    for name, value in critical.items():
        below, at = (float(judge.null.probability(name, v)) for v in (value - 0.25, value))
        assert at < policy().false_findings / 4 <= below
    assert critical["cyclic"] > critical["velocity_lag"]
