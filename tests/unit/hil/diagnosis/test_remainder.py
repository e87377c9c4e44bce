"""What is left after the search, of forms that no catalogue has, on campaigns run as in a workshop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.workshop import TRAVEL_MM, Cause, Floats, workshop
from threadpoolctl import threadpool_limits

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import prepare
from hil.diagnosis.remainder import LeftOver, left_over
from hil.diagnosis.remainder.null import Null, row_scale
from hil.diagnosis.remainder.scan import scan, variables
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Setting, start_noise
from hil.diagnosis.search.searcher import Searcher
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


CAUSES = (
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


def test_a_cause_outside_the_catalogue_is_never_silent() -> None:
    """A wave along the travel that a load switches on: silent before, and no effect may take its name."""
    said = diagnose(workshop(12, wave_by_load, ratio=2.0, noise_um=NOISE_UM)[0])
    assert said.unexplained
    assert {"load_kg", "target_mm"} <= {name for carrier in said.carriers for name in carrier.columns}
    assert not [finding for finding in said.findings if finding.confidence > 0.9]
    assert said.to_json()["carried_by"][0]["rms_std_um"] > 0.0
