"""The size of an unexplained structure: its interval holds the true one, and the structure as a term says what the fit said."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import prepare
from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Setting
from hil.diagnosis.search.judge import hit_of
from hil.diagnosis.search.searcher import LIGHT, Searcher
from hil.diagnosis.search.structure import structures
from hil.diagnosis.search.structure_estimate import (
    StructureEstimate,
    places_of,
    rms_of,
    sizes,
    structure_estimates,
)
from hil.effects import Estimate

Array = np.ndarray
SMOOTH = Noise(even=300.0, odd=300.0)
NOISE_UM = 0.3


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    n = len(c["run"])
    return {name: rng.uniform(-1.0, 1.0, n) for name in ("coolant_l_min", "load_kg")}


def found(
    error_um: Callable[[dict[str, Array]], Array], seed: int, *structure: tuple[str, ...]
) -> list[tuple[StructureEstimate, Estimate]]:
    """What follows the columns of these structures, each known beforehand to be there, and its size."""
    prepared = prepare(campaign(lambda c: wavy(c) + error_um(c), sensors=sensors, noise_um=NOISE_UM, runs=5, seed=seed))
    searcher = Searcher(Setting.free(prepared), enumerate_candidates(prepared, ()), None, LIGHT)
    by_columns = {one.columns: one for one in structures(prepared).structures}
    hits = []
    for columns in structure:
        hits.append(hit_of(searcher.projection(SMOOTH), by_columns[columns], 40.0, 0.001))
        searcher.add_nuisance(hits[-1].extra)
    noise = searcher.fit_noise((), SMOOTH)
    return list(zip(structure_estimates(searcher, hits, (), noise), sizes(searcher, hits, (), noise), strict=True))


KNOWN: list[tuple[Callable[[dict[str, Array]], Array], tuple[str, ...]]] = [
    (lambda c: 0.5 * c["coolant_l_min"], ("coolant_l_min",)),
    (lambda c: 0.9 * c["direction"] * c["coolant_l_min"] ** 2, ("coolant_l_min", "direction")),
    (lambda c: 0.9 * c["coolant_l_min"] * c["load_kg"], ("coolant_l_min", "load_kg")),
]
"""Each about as large as the noise."""


def stated_over_true(seeds: int) -> tuple[Array, Array]:
    """Of each known error in so many campaigns: the stated size over the true one, and how far off it is in stated deviations.

    The true one is over the rows of that campaign, beside a straight line in each direction.
    """
    ratio, off = [], []
    for seed in range(seeds):
        for error_um, columns in KNOWN:
            ((one, rms),) = found(error_um, seed, columns)
            values = one.structures[0].values
            made = error_um(dict(values))
            line = np.column_stack([np.ones(len(made)), values["target_mm"]])
            table = np.hstack([line, line * values["direction"][:, None]])
            true = float(np.std(made - table @ np.linalg.lstsq(table, made, rcond=None)[0]))
            ratio.append(rms.value / true)
            off.append((rms.value - true) / rms.std)
    return np.array(ratio), np.array(off)


def test_the_interval_of_the_size_holds_the_true_one() -> None:
    ratio, off = stated_over_true(14)
    assert 0.88 <= np.mean(np.abs(off) <= 1.96) <= 1.0
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.3
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.06)


def test_two_structures_on_the_same_columns_have_one_size_together() -> None:
    """Each alone holds what the other may hold too; only their sum is known."""
    ((one, rms),) = found(
        lambda c: 0.9 * c["coolant_l_min"] * c["load_kg"],
        3,
        ("coolant_l_min", "load_kg"),
        ("coolant_l_min", "load_kg", "direction"),
    )
    assert one.columns == ("coolant_l_min", "load_kg", "direction")
    assert len(one.terms) == 2
    assert rms.value == pytest.approx(0.3, abs=3 * rms.std)
    assert rms.std < 0.06


def test_a_structure_that_is_seen_twice_has_one_size() -> None:
    ((one, rms),) = found(lambda c: 0.9 * c["coolant_l_min"], 5, ("coolant_l_min",), ("coolant_l_min",))
    assert len(one.terms) == 2
    assert rms.value == pytest.approx(0.9 / np.sqrt(3.0), abs=3 * rms.std)
    assert float(np.std(one.error_um(one.structures[0].values))) == pytest.approx(rms.value, abs=0.05)


def test_what_two_structures_share_counts_for_the_first() -> None:
    """An error of the coolant alone, seen with the load first: the structure with the travel has nothing of it."""
    first, second = found(
        lambda c: 0.9 * c["coolant_l_min"], 3, ("coolant_l_min", "load_kg"), ("coolant_l_min", "target_mm")
    )
    assert first[1].value == pytest.approx(0.9 / np.sqrt(3.0), abs=3 * first[1].std)
    assert first[1].std < 0.06
    assert second[1].value < 0.2


def test_as_a_term_it_says_what_the_fit_said_and_nothing_new_beyond_the_range() -> None:
    ((one, _),) = found(lambda c: 1.5 * c["coolant_l_min"], 4, ("coolant_l_min",))
    values = one.structures[0].values
    np.testing.assert_allclose(one.error_um(values), one.structures[0].whole @ one.coefficients, atol=1e-12)
    ends = {"coolant_l_min": np.array([np.min(values["coolant_l_min"]), np.max(values["coolant_l_min"])])}
    far = {"coolant_l_min": np.array([-50.0, 50.0])}
    np.testing.assert_array_equal(one.error_um(far), one.error_um(ends))
    assert float(np.diff(one.error_um(ends))[0]) == pytest.approx(
        1.5 * float(np.diff(ends["coolant_l_min"])[0]), rel=0.15
    )


def test_the_size_of_a_known_normal_estimate_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(8)
    design = rng.normal(size=(60, 4)) @ rng.normal(size=(4, 4))
    middle = np.array([1.0, -0.6, 0.3, 0.8])
    root = 0.15 * rng.normal(size=(4, 4))
    drawn = middle + rng.normal(size=(4000, 4)) @ root.T
    sizes = np.std(design @ drawn.T, axis=0)
    stated = rms_of(design, middle, root @ root.T, np.ones((60, 1)), shrunk=True)
    assert stated.value == pytest.approx(float(np.sqrt(np.mean(sizes**2))), rel=0.02)
    assert stated.std == pytest.approx(float(np.std(sizes)), rel=0.1)
    squares = [rms_of(design, one, root @ root.T, np.ones((60, 1))).value ** 2 for one in drawn[:2000]]
    assert np.mean(squares) == pytest.approx(float(np.var(design @ middle)), rel=0.02), (
        "a free estimate's excess is taken out"
    )


def test_structures_are_found_among_the_columns_of_a_fit_in_any_order_and_each_once() -> None:
    prepared = prepare(campaign(wavy, sensors=sensors, noise_um=NOISE_UM, runs=5, seed=3))
    projection = Searcher(Setting.free(prepared), enumerate_candidates(prepared, ()), None, LIGHT).projection(SMOOTH)
    by_columns = {one.columns: one for one in structures(prepared).structures}
    first, second = (hit_of(projection, by_columns[name,], 40.0, 0.001) for name in ("coolant_l_min", "load_kg"))
    columns = np.hstack([second.extra.random, first.extra.random, second.extra.random])
    width = second.extra.random.shape[1]
    where = places_of(columns, [first.extra, second.extra, second.extra])
    assert [place[0] for place in where] == [width, 0, columns.shape[1] - width]
    assert all(
        np.array_equal(columns[:, place], hit.extra.random)
        for place, hit in zip(where, (first, second, second), strict=True)
    )
    with pytest.raises(LookupError):
        places_of(columns, [first.extra, first.extra])
