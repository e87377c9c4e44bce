"""One selection from start to end: structure beside the terms is their shape, another cause, or what they were a part of."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from study.grammar.judge import outcome
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import prepare
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Setting, start_noise
from hil.diagnosis.search.judge import NullJudge, StructureSearch
from hil.diagnosis.search.searcher import LIGHT, Searcher
from hil.diagnosis.search.select import Selected, select
from hil.diagnosis.search.structure import structures
from hil.effects import Effect
from hil.effects.beam_drift import BeamDrift
from hil.effects.load_deflection import LoadDeflection
from hil.effects.velocity_lag import VelocityLag

Array = np.ndarray
Sensors = Callable[[dict[str, Array], np.random.Generator], dict[str, Array]]


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    n = len(c["run"])
    return {
        "velocity_mm_s": rng.uniform(10.0, 90.0, n),
        "coolant_l_min": rng.normal(size=n),
        "since_reversal_mm": rng.uniform(1.0, 80.0, n),
        "stroke_mm": rng.uniform(100.0, 300.0, n),
    }


def selected(
    error_um: Callable[[dict[str, Array]], Array],
    effects: Sequence[Effect] = (VelocityLag(), LoadDeflection()),
    sensors: Sensors = sensors,
) -> Selected:
    prepared = prepare(campaign(lambda c: wavy(c) + error_um(c), sensors=sensors))
    candidates = enumerate_candidates(prepared, effects)
    searcher = Searcher(Setting.free(prepared), candidates, None, LIGHT)
    return select(searcher, StructureSearch(structures(prepared), 0), NullJudge(0), start_noise(prepared))


def thermometers(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    """One that warms and cools again and one that warms, and air that does neither, as the coolant."""
    t = c["time_s"] / c["time_s"][-1]
    warm = {"temp_motor_c": 22.0 + 2.0 * np.sin(3.0 * np.pi * t), "temp_bed_c": 20.0 + t**2}
    return warm | {"coolant_l_min": 5.0 + np.cos(5.0 * np.pi * t**1.3)}


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


def test_a_reading_that_wanders_keeps_its_name_beside_what_changes_with_the_time() -> None:
    """A product of the time and a temperature may be that; one of the time and the flow of the coolant is another cause."""

    def times_time(column: str) -> Selected:
        def course(c: dict[str, Array]) -> Array:
            return 1.2 * (c["time_s"] / c["time_s"][-1] - 0.5) * (c[column] - np.mean(c[column]))

        return selected(course, (BeamDrift(),), thermometers)

    wanders, flows = times_time("temp_motor_c"), times_time("coolant_l_min")
    assert names(wanders) == ["beam_drift"]
    assert "coolant_l_min" in wanders.foreign["beam_drift"].columns
    assert names(flows) == []
    assert [hit.structure.columns for hit in flows.hits] == [("coolant_l_min", "time_s")]


def test_a_reading_that_wanders_is_no_function_of_a_temperature_that_happens_to_go_with_it() -> None:
    """Six temperatures follow the time, and one of them fits a little better than a random course does."""
    assert outcome("strong", 802636)["named_first"]
