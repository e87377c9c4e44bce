"""One selection from start to end: structure beside the terms is their shape, another cause, or what they were a part of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import prepare
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Setting, start_noise
from hil.diagnosis.search.judge import NullJudge, StructureSearch
from hil.diagnosis.search.searcher import LIGHT, Searcher
from hil.diagnosis.search.select import Selected, select
from hil.diagnosis.search.structure import structures
from hil.effects.load_deflection import LoadDeflection
from hil.effects.velocity_lag import VelocityLag

Array = np.ndarray


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    n = len(c["run"])
    return {
        "velocity_mm_s": rng.uniform(10.0, 90.0, n),
        "coolant_l_min": rng.normal(size=n),
        "since_reversal_mm": rng.uniform(1.0, 80.0, n),
        "stroke_mm": rng.uniform(100.0, 300.0, n),
    }


def selected(error_um: Callable[[dict[str, Array]], Array]) -> Selected:
    prepared = prepare(campaign(lambda c: wavy(c) + error_um(c), sensors=sensors))
    candidates = enumerate_candidates(prepared, (VelocityLag(), LoadDeflection()))
    searcher = Searcher(Setting.free(prepared), candidates, None, LIGHT)
    return select(searcher, StructureSearch(structures(prepared), 0), NullJudge(0), start_noise(prepared))


def names(found: Selected) -> list[str]:
    return [choice.effect.id for choice in found.choices]


def lag(c: dict[str, Array]) -> Array:
    return 0.03 * c["direction"] * c["velocity_mm_s"]


def test_an_effect_and_a_cause_outside_the_catalogue_are_both_seen_for_what_they_are() -> None:
    found = selected(lambda c: lag(c) + np.tanh(c["coolant_l_min"]))
    assert names(found) == ["velocity_lag"]
    assert [hit.structure.columns for hit in found.hits] == [("coolant_l_min",)]


def test_a_small_bend_of_an_effect_is_its_shape_and_not_another_cause() -> None:
    found = selected(lambda c: lag(c) * (1.12 - 0.12 * (c["velocity_mm_s"] / 50.0) ** 2))
    assert names(found) == ["velocity_lag"]
    assert found.hits == ()


def test_nothing_is_selected_from_noise() -> None:
    found = selected(lambda c: np.zeros(len(c["run"])))
    assert names(found) == []
    assert found.hits == found.shapes == ()
