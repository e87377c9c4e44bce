"""Pairs of effects: ranked as one fit of both ranks them, and found where neither shows alone."""

from __future__ import annotations

import numpy as np
import pytest
from study.grammar.judge import outcome
from study.grammar.machine import draw

from hil.diagnosis.campaign import prepare
from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Choice, Setting, start_noise
from hil.diagnosis.search.pairs import best_pairs
from hil.diagnosis.search.searcher import Searcher
from hil.effects import ALL
from hil.records.rows import Records

pytestmark = pytest.mark.outside


@pytest.fixture(scope="module")
def searcher() -> Searcher:
    """A machine with two causes of the study's generator, tuning seed, with every effect that varies as a candidate."""
    rows = prepare(Records.of(draw("pairs", 100_001).fit.records))
    effects = [effect for effect in ALL if not effect.is_table]
    return Searcher(Setting.free(rows), enumerate_candidates(rows, effects))


def worth(searcher: Searcher, noise: Noise, pair: tuple[Choice, Choice]) -> float:
    """Log evidence of both in one fit, under the noise model of the two for which it is higher."""
    calm = Noise(even=noise.even, odd=noise.odd, offset=0.25)
    return max(searcher.evidence(pair, trial) for trial in (noise, calm))


def test_the_best_pair_has_the_evidence_of_both_in_one_fit_and_no_other_pair_more(searcher: Searcher) -> None:
    """Judged by the evidence of the search itself, which takes any choices into one fit, for pairs drawn at random."""
    noise = searcher.fit_noise((), start_noise(searcher.linear.campaign))
    found = best_pairs(searcher, (), noise, -np.inf)
    values = [worth(searcher, noise, pair) for pair in found]
    assert values == sorted(values, reverse=True)
    assert len({tuple((one.form.name, one.form.inputs) for one in pair) for pair in found}) == len(found)
    rng = np.random.default_rng(1)
    free = [one for one in searcher.candidates.choices if not (one.effect.static or one.form.shrunk)]
    slow = [one for one in free if one.effect.slow or one.form.inputs == ("time_s",)]
    for _ in range(100):
        first, second = slow[rng.integers(len(slow))], free[rng.integers(len(free))]
        if first.effect.id != second.effect.id:
            assert worth(searcher, noise, (first, second)) <= values[0] + 1e-6


def test_no_pair_is_below_the_least_evidence(searcher: Searcher) -> None:
    noise = start_noise(searcher.linear.campaign)
    found = best_pairs(searcher, (), noise, -np.inf)
    assert found
    third, fourth = (worth(searcher, noise, pair) for pair in found[2:4])
    assert third > fourth
    assert best_pairs(searcher, (), noise, 0.5 * (third + fourth)) == found[:3]
    assert best_pairs(searcher, (), noise, np.inf) == []


@pytest.mark.parametrize(
    ("seed", "names"),
    [
        # neither is significant by itself: memory and offsets of the noise hold it
        (805592, {"dead_path", "datum_step"}),
        # an expansion and a drift, both of the time, stood for them
        (805571, {"air_index", "beam_drift"}),
        # half of the noise, where that was taken from a fit without the lost motion
        (805773, {"lost_motion", "beam_drift"}),
        # four effects fitted better than the two, by less than two cost
        (805844, {"thermal_expansion", "beam_drift"}),
    ],
)
def test_two_causes_that_were_missed_step_by_step(seed: int, names: set[str]) -> None:
    """Machines of the study's generator (reporting seeds, seen), whose causes a selection step by step does not find."""
    found = outcome("pairs", seed)
    assert {finding["effect"] for finding in found["said"]["findings"]} == names
    assert found["fresh_um"] < 1.1 * found["fresh_fitted_um"]
