"""What is left after the search, of forms that no catalogue has, on campaigns run as in a workshop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from study.grammar.machine import draw
from support.workshop import TRAVEL_MM, Cause, Floats, workshop
from threadpoolctl import threadpool_limits

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import prepare
from hil.diagnosis.diagnose import exceeds_repeats, is_between_runs
from hil.diagnosis.noise.repeats import PureError
from hil.diagnosis.remainder import LeftOver, left_over
from hil.diagnosis.remainder.hits import hit_rows
from hil.diagnosis.remainder.null import Null, row_scale
from hil.diagnosis.remainder.scan import scan, variables
from hil.diagnosis.result import NoiseParts
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Setting, start_noise
from hil.diagnosis.search.searcher import Searcher
from hil.effects import Estimate
from hil.records.rows import Records

NOISE_UM = 0.5


def wave_by_load(c: dict[str, Floats]) -> Floats:
    return np.sin(2 * np.pi * 2.2 * c["target_mm"] / TRAVEL_MM) * (c["load_kg"] > 50.0)


def moving_only(c: dict[str, Floats]) -> Floats:
    return np.sin(2 * np.pi * 1.7 * c["target_mm"] / TRAVEL_MM + 0.4) * np.sign(c["velocity_mm_s"]) * c["direction"]


def beat(c: dict[str, Floats]) -> Floats:
    return np.sin(2 * np.pi * (c["target_mm"] / 45.0 + c["time_s"] / 400.0))


def two_hinges(c: dict[str, Floats]) -> Floats:
    warm = np.maximum(c["temp_screw_c"] - 20.8, 0.0)
    return warm * np.maximum(c["target_mm"] / TRAVEL_MM - 0.55, 0.0)


def worn_when_warm(c: dict[str, Floats]) -> Floats:
    return np.exp(-c["since_reversal_mm"] / 60.0) * (c["temp_screw_c"] - 20.0)


def state_nobody_logs(c: dict[str, Floats]) -> Floats:
    """Switches at random about every tenth of the campaign, and shows along a wave of the position."""
    rng = np.random.default_rng(3)
    edges = np.cumsum(rng.exponential(0.1 * np.ptp(c["time_s"]), 100))
    state = np.where(np.searchsorted(edges, c["time_s"] - c["time_s"][0]) % 2 == 0, 1.0, -1.0)
    return state * np.sin(2 * np.pi * 2.6 * c["target_mm"] / TRAVEL_MM)


def in_one_run(c: dict[str, Floats]) -> Floats:
    return np.sin(2 * np.pi * 4.6 * c["target_mm"] / TRAVEL_MM) * (c["run"] == 2)


CAUSES = (
    (state_nobody_logs, {"time_s", "target_mm"}),
    (in_one_run, {"run", "target_mm"}),
    (wave_by_load, {"load_kg", "target_mm"}),
    (moving_only, {"velocity_mm_s", "target_mm"}),
    (beat, {"time_s", "target_mm"}),
    (two_hinges, {"temp_screw_c", "target_mm"}),
    (worn_when_warm, {"since_reversal_mm", "temp_screw_c"}),
)


def rest_of(records: Records) -> tuple[LeftOver, ...]:
    """Of a campaign in which no effect was looked for."""
    campaign = prepare(records)
    searcher = Searcher(Setting.free(campaign), enumerate_candidates(campaign, ()))
    with threadpool_limits(1, "blas"):
        noise = searcher.fit_noise((), start_noise(campaign))
        searcher.limit_outliers((), noise)
        return left_over(searcher, (), noise)


@pytest.mark.parametrize(("cause", "columns"), CAUSES, ids=lambda value: getattr(value, "__name__", ""))
def test_the_columns_that_carry_any_form_are_named_with_its_size(cause: Cause, columns: set[str]) -> None:
    found = rest_of(workshop(11, cause, ratio=2.0, noise_um=NOISE_UM, warm_s=3000.0)[0])
    assert found
    largest = found[0]
    named = {
        next((wanted for wanted in columns if wanted in (name, *largest.equivalent.get(name, ()))), name)
        for name in largest.columns
    }
    assert named - {"direction"} == columns
    assert largest.probability < 1e-3
    assert largest.rms.value == pytest.approx(2.0 * NOISE_UM, rel=0.25)
    assert largest.rms.std < 0.2 * largest.rms.value


def both(c: dict[str, Floats]) -> Floats:
    """Two causes of other columns, of about the same size."""
    return 0.8 * wave_by_load(c) + worn_when_warm(c)


def test_a_second_cause_is_found_beside_the_first_and_a_fragment_is_none() -> None:
    found = rest_of(workshop(21, both, ratio=3.0, noise_um=NOISE_UM, warm_s=3000.0)[0])
    assert {"load_kg", "target_mm"} in [set(one.columns) - {"direction"} for one in found]
    assert len({frozenset(one.columns) for one in found}) >= 2
    alone = rest_of(workshop(11, wave_by_load, ratio=8.0, noise_um=NOISE_UM, warm_s=3000.0)[0])
    assert len(alone) == 1, "what the waves of one cause did not follow is not another"


def test_a_score_holds_under_every_noise_model_that_fits_nearly_as_well() -> None:
    campaign = prepare(workshop(11, beat, ratio=1.0, noise_um=NOISE_UM)[0])
    searcher = Searcher(Setting.free(campaign), enumerate_candidates(campaign, ()))
    with threadpool_limits(1, "blas"):
        null = Null.of(searcher.linear, searcher.y, searcher.always, start_noise(campaign))
        assert null.others
        columns = variables(campaign)
        worst, best_alone = (dict(scan(one, columns).best) for one in (null, replace(null, others=())))
    common = [group for group in worst if group in best_alone]
    assert common
    assert all(worst[group] <= best_alone[group] + 1e-6 for group in common)
    assert any(worst[group] < best_alone[group] - 1e-3 for group in common)


@pytest.mark.parametrize("tails", ["normal", "heavy", "faster"])
def test_nothing_is_left_of_noise(tails: str) -> None:
    for seed in range(4):
        assert rest_of(workshop(100 + seed, tails=tails)[0]) == (), seed


def test_the_scale_of_the_rows_is_that_of_their_noise() -> None:
    campaign = prepare(workshop(5, tails="faster")[0])
    fast = campaign.columns["velocity_mm_s"] > 50.0
    rng = np.random.default_rng(2)
    scale = row_scale(rng.normal(size=len(campaign)) * np.where(fast, 3.0, 1.0), campaign)
    assert np.mean(scale[fast]) / np.mean(scale[~fast]) == pytest.approx(3.0, rel=0.25)
    even = row_scale(rng.normal(size=len(campaign)), campaign)
    assert np.std(even) < 0.2
    assert np.sqrt(np.mean(even**2)) == pytest.approx(1.0)


def one_row_in_ten(c: dict[str, Floats]) -> Floats:
    hit = np.random.default_rng(8).random(len(c["target_mm"])) < 0.1
    return hit * np.sin(2 * np.pi * 2.2 * c["target_mm"] / TRAVEL_MM + 0.3)


def test_rows_hit_at_random_are_noticed_with_their_size() -> None:
    found = rest_of(workshop(31, one_row_in_ten, ratio=2.0, noise_um=NOISE_UM)[0])
    assert [set(one.columns) - {"direction"} for one in found] == [{"target_mm"}]
    assert found[0].rms.value == pytest.approx(2.0 * NOISE_UM, rel=0.25)


@pytest.mark.parametrize("draws", ["signs", "cauchy"])
def test_large_rows_of_random_sign_are_noise(draws: str) -> None:
    """Heavy tails alone: of fifty campaigns hardly one may be taken for more."""
    campaign = prepare(workshop(31, noise_um=NOISE_UM)[0])
    searcher = Searcher(Setting.free(campaign), enumerate_candidates(campaign, ()))
    noise = start_noise(campaign)
    (x,) = (variable for variable in variables(campaign) if variable.name == "target_mm")
    taken = 0
    for seed in range(50):
        rng = np.random.default_rng([seed, 9])
        large = rng.random(len(campaign)) < 0.1
        tails = (
            rng.standard_cauchy(len(campaign)) if draws == "cauchy" else 6.0 * np.sign(rng.normal(size=len(campaign)))
        )
        y = NOISE_UM * np.where(large, np.clip(tails, -15.0, 15.0), rng.normal(size=len(campaign)))
        null = Null.of(searcher.linear, y, searcher.always, noise)
        taken += hit_rows(null, x, campaign.d) is not None
    assert taken <= 2


def test_a_function_of_another_column_takes_the_place_of_the_effect_it_resembles() -> None:
    """A bump along the air's pressure, which passes it once: a jump of the reading fits well, and the bump far better."""
    drawn = draw("outside strong", 100_002)
    said = diagnose(Records.of(drawn.fit.records))
    assert said.unexplained
    assert not said.findings
    assert "air_pressure_hpa" in said.carriers[0].columns


def test_rows_that_vary_far_more_than_their_repeats_are_unexplained() -> None:
    noise = NoiseParts(1.0, 0.0, 0.0, 0.0)
    close, far = (PureError(Estimate(um, 0.1 * um), 8, True) for um in (0.6, 0.2))
    assert not exceeds_repeats(None, noise)
    assert not exceeds_repeats(close, noise), "eight degrees of freedom do not tell 0.6 from 1"
    assert exceeds_repeats(far, noise)


def test_a_jump_from_one_run_to_the_next_may_be_anything_that_was_set_there() -> None:
    campaign = prepare(workshop(31, noise_um=NOISE_UM)[0])
    assert is_between_runs((campaign.run >= 2) * 3.0, campaign)
    within = np.arange(len(campaign)) > np.flatnonzero(campaign.run == 2)[3]
    assert not is_between_runs(within * 3.0, campaign)
    assert not is_between_runs(np.arange(len(campaign)) * 0.1, campaign)


def test_a_cause_outside_the_catalogue_is_never_silent() -> None:
    """A wave along the travel that a load switches on: silent before, and no effect may take its name."""
    said = diagnose(workshop(12, wave_by_load, ratio=2.0, noise_um=NOISE_UM)[0])
    assert said.unexplained
    assert {"load_kg", "target_mm"} <= {name for carrier in said.carriers for name in carrier.columns}
    assert not [finding for finding in said.findings if finding.confidence > 0.9]
    assert said.to_json()["carried_by"][0]["rms_std_um"] > 0.0


def test_an_effect_that_runs_left_out_do_not_prove_is_named_with_doubt_where_its_rest_would_be_unexplained() -> None:
    """An offset that follows a temperature by far later: from run to run it cannot be told from the offsets of the runs."""
    said = diagnose(Records.of(draw("weak", 100_034).fit.records))
    (finding,) = said.findings
    assert finding.effect == "thermal_drift"
    assert 0.5 < finding.confidence < 0.7
    assert "unexplained" in {rival.effect for rival in finding.rivals}
    assert not said.unexplained
