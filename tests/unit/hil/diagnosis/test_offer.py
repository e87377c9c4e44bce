"""A correction without a cause: only where something is unexplained, its columns are known in time, and it helps on runs left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis import Diagnosis, diagnose
from hil.diagnosis.result import Carrier, Figures, Finding, NoiseParts, RivalFound
from hil.diagnosis.search.structure import Structure
from hil.diagnosis.search.structure_estimate import StructureEstimate
from hil.diagnosis.verdict.held_out import HeldOut
from hil.diagnosis.verdict.offer import offered
from hil.effects import Effect, Estimate
from hil.effects.load_deflection import LoadDeflection
from hil.effects.model import Model, PitchTable
from hil.effects.non_parametric import smooth_form, spread_of
from hil.effects.velocity_lag import VelocityLag
from hil.records.rows import Records

Array = np.ndarray
EFFECTS: tuple[Effect, ...] = (VelocityLag(), LoadDeflection())


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    n = len(c["run"])
    return {"coolant_l_min": rng.uniform(3.0, 7.0, n), "load_kg": rng.uniform(0.0, 90.0, n)}


def measured(error_um: Callable[[dict[str, Array]], Array], seed: int) -> Records:
    return campaign(lambda c: wavy(c) + error_um(c), sensors=sensors, runs=5, seed=seed)


def hidden(c: dict[str, Array]) -> Array:
    return 1.2 * np.sin(1.5 * c["coolant_l_min"])


def rms_um(model: Model, records: Records) -> float:
    return Figures.of(records.uncorrected_error_um - model.error_um(records.columns)).rms_um


def test_it_is_offered_never_used_and_brings_a_fresh_campaign_down() -> None:
    said = diagnose(measured(hidden, 1), effects=EFFECTS)
    assert said.unexplained
    assert said.extended.terms == (), "never without being asked for"
    (carrier,) = said.carriers
    assert carrier.columns == ("coolant_l_min",)
    assert abs(carrier.rms.value - np.std(hidden(dict(measured(hidden, 1).columns)))) < 3 * carrier.rms.std
    (note,) = (note for note in said.notes if "--non-parametric" in note)
    assert "coolant_l_min" in note
    assert "the cause is unknown" in note

    taken = said.non_parametric
    assert isinstance(taken, Diagnosis)
    assert taken.unexplained, "a correction is no explanation"
    assert [term.effect.id for term in taken.extended.terms] == ["non_parametric"]
    assert "the cause is unknown" in str(taken.extended.about["non_parametric"])
    assert taken.after.rms_um < 0.5 * said.after.rms_um
    assert Figures.of(taken.residual_um).rms_um < 0.5 * Figures.of(said.residual_um).rms_um
    fresh = measured(hidden, 2)
    assert rms_um(said.extended, fresh) > 0.8
    assert rms_um(taken.extended, fresh) < 0.4, "the noise is 0.3"
    form = taken.to_json()
    assert [one["columns"] for one in form["non_parametric"]] == [["coolant_l_min"]]
    assert said.to_json()["non_parametric"] == []
    assert form["carried_by"][0]["rms_std_um"] == carrier.rms.std


ROWS = 40
COLUMNS = {"coolant_l_min": np.linspace(3.0, 7.0, ROWS), "torque_percent": np.linspace(-9.0, 9.0, ROWS)}


def left(*columns: str) -> StructureEstimate:
    form = smooth_form(columns, [spread_of(name, COLUMNS) for name in columns], with_direction=False)
    structure = Structure(columns, np.zeros((ROWS, 1)), form, COLUMNS)
    return StructureEstimate((structure,), np.array([1.0, 0, 0, 0]), np.zeros((4, 4)), 0.001)


def a_diagnosis(*, unexplained: bool = True) -> tuple[Diagnosis, HeldOut]:
    """Something that the held-out rows show too: what is left of each is 1 µm, and all of it is what is carried."""
    model = Model(PitchTable.of([0.0, 1.0], [0.0, 0.0], [0.0, 0.0]))
    one = np.tile([1.0, -1.0], ROWS // 2)
    carriers = (Carrier(("coolant_l_min",), Estimate(0.6, 0.1), 0.001),) if unexplained else ()
    noise = NoiseParts(0.1, 0.0, 0.0, 0.0)
    said = Diagnosis(
        None, noise, model, model, (), unexplained, carriers, (), one, one, one, one, "leave-one-run-out", True
    )
    return said, HeldOut(
        one,
        one,
        one,
        one,
        {},
        np.ones(4),
        0.9 * one,
        np.array([9.0, 8.0, 9.0, 10.0]),
        np.arange(4),
        "leave-one-run-out",
    )


def test_where_everything_is_explained_there_is_none_and_no_word_of_it() -> None:
    said, left_out = a_diagnosis(unexplained=False)
    told = offered(said, (), left_out, np.zeros(ROWS), Figures(9.0, 9.0), bare=said.extended)
    assert told.non_parametric == "nothing is left unexplained"
    assert told.notes == ()


def test_it_is_had_where_every_condition_is_met() -> None:
    said, left_out = a_diagnosis()
    told = offered(said, [left("coolant_l_min")], left_out, np.zeros(ROWS), Figures(9.0, 9.0), bare=said.extended)
    assert isinstance(told.non_parametric, Diagnosis)
    assert told.non_parametric.after.rms_um == pytest.approx(0.1)


def refused(said: Diagnosis, structures: list[StructureEstimate], left_out: HeldOut) -> str:
    told = offered(said, structures, left_out, np.zeros(ROWS), Figures(9.0, 9.0), bare=said.extended)
    assert isinstance(told.non_parametric, str)
    assert told.extended == said.extended
    assert told.notes == (f"no correction without a known cause either (--non-parametric): {told.non_parametric}",)
    return told.non_parametric


def test_a_column_that_is_read_after_the_motion_cannot_correct_it() -> None:
    said, left_out = a_diagnosis()
    assert refused(said, [left("torque_percent")], left_out) == "torque_percent is not known when a command is issued"


@pytest.mark.parametrize(("gain", "carried_um"), [([9.0, -8.0, 9.0, -10.0], 0.9), ([9.0, 8.0, 9.0, 10.0], -0.1)])
def test_what_does_not_help_on_runs_left_out_is_refused(gain: list[float], carried_um: float) -> None:
    said, left_out = a_diagnosis()
    left_out = replace(left_out, structure_term_um=carried_um * left_out.bare, structure_term_gain=np.array(gain))
    assert "on runs left out it does not help" in refused(said, [left("coolant_l_min")], left_out)


def test_what_follows_no_column_is_refused() -> None:
    said, left_out = a_diagnosis()
    assert "follows no column" in refused(said, [], left_out)


def test_what_a_doubtful_name_corrects_already_is_refused() -> None:
    said, left_out = a_diagnosis()
    term = replace(left("coolant_l_min").terms[0], effect=VelocityLag())
    finding = Finding(term, 0.3, (RivalFound("unexplained", 0.7, ""),), 1.0)
    assert "corrected already as velocity_lag" in refused(replace(said, findings=(finding,)), [], left_out)
