"""Structure with no physics in it: what is there is found under the names of its columns, what is not there is not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise
from hil.diagnosis.noise.noise_fit import fit_noise
from hil.diagnosis.search.fit import start_noise
from hil.diagnosis.search.judge import Hit, StructureSearch, clearest
from hil.diagnosis.search.structure import structures

Array = np.ndarray


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    n = len(c["run"])
    return {name: rng.normal(size=n) for name in ("load_kg", "coolant_l_min")} | {
        "since_reversal_mm": rng.uniform(1.0, 80.0, n),
        "stroke_mm": rng.uniform(100.0, 300.0, n),
    }


def found(
    error_um: Callable[[dict[str, Array]], Array], *, runs: int = 4, scatter: float = 0.5, seed: int = 1
) -> tuple[CampaignRows, Hit | None]:
    """A campaign of this error, and the structure that is seen in it beside a smooth table."""
    prepared = prepare(
        campaign(lambda c: wavy(c) + error_um(c), sensors=sensors, runs=runs, scatter=scatter, seed=seed)
    )
    linear = LinearCampaign(prepared)
    y = prepared.error_um
    noise = fit_noise(linear, y, Extra.none(len(y)), start_noise(prepared), correlations=((0.0, 0.0),))
    return prepared, StructureSearch(structures(prepared), seed=0)(linear.projection(noise, y), linear)


@pytest.mark.parametrize(
    ("error_um", "columns"),
    [
        (lambda c: np.tanh(c["coolant_l_min"]), {"coolant_l_min"}),
        (lambda c: 0.7 * c["direction"] * np.abs(c["coolant_l_min"]), {"coolant_l_min", "direction"}),
        (lambda c: 0.6 * c["coolant_l_min"] * c["load_kg"], {"coolant_l_min", "load_kg"}),
        (lambda c: c["coolant_l_min"] * np.cos(c["target_mm"] / 95.0), {"coolant_l_min", "target_mm"}),
    ],
    ids=["one column", "with direction", "two columns", "with position"],
)
def test_a_dependence_is_found_under_the_names_of_its_columns(
    error_um: Callable[[dict[str, Array]], Array], columns: set[str]
) -> None:
    _, hit = found(error_um)
    assert hit is not None
    assert set(hit.structure.columns) == columns
    assert hit.probability < 0.002


def test_position_finer_than_the_table_is_a_structure_of_its_own() -> None:
    """A zone narrower than the distance of the knots, in both directions alike."""
    _, hit = found(lambda c: 6.0 * np.exp(-(((c["target_mm"] - 140.0) / 5.0) ** 2)), runs=6)
    assert hit is not None
    assert hit.structure.columns == ("target_mm",)


def test_noise_has_no_structure() -> None:
    assert [hit for seed in range(3) if (hit := found(lambda c: 0.0 * c["run"], seed=seed)[1]) is not None] == []


def test_where_targets_repeat_nothing_is_asked_between_them() -> None:
    prepared, _ = found(lambda c: 0.0 * c["run"], scatter=0.0)
    assert structures(prepared).fine == ()


def test_the_clearest_structure_is_the_one_of_the_highest_gain() -> None:
    prepared, _ = found(lambda c: 0.8 * c["load_kg"])
    catalogue = structures(prepared)
    projection = LinearCampaign(prepared).projection(Noise(even=100.0, odd=10.0), prepared.error_um)
    gains = [projection.gain(s.design) for s in catalogue.structures]
    best = clearest(projection, catalogue)
    assert best is not None
    assert best[0] is catalogue.structures[int(np.argmax(gains))]
    assert best[0].columns == ("load_kg",)
    assert best[1] == pytest.approx(max(gains), abs=1e-3)
