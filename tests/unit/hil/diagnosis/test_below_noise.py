"""Noise that wanders looks a little like whatever changes slowly: suspected, never a finding."""

from dataclasses import replace

import pytest
from study.truth_machines import Machine, Plan
from support.workshop import workshop

from hil.diagnosis import diagnose
from hil.diagnosis.result import Finding
from hil.diagnosis.verdict.held_out import is_below_noise, suspected_note
from hil.effects import ALL, Term, survey_of
from hil.effects.history import complete
from hil.records.rows import Records


@pytest.mark.parametrize("seed", [688361517, 351091739])
def test_noise_that_wanders_is_no_finding_and_not_corrected(seed: int) -> None:
    columns, _ = Machine(seed, (), (), "walk").campaign(0, Plan())

    said = diagnose(Records.of(columns))

    assert not said.findings
    assert not said.unexplained
    assert said.extended.terms == ()


def test_a_small_drift_of_no_clear_name_is_below_noise_and_said_so() -> None:
    drift = next(effect for effect in ALL if effect.id == "thermal_drift")
    form = next(form for form in drift.forms(survey_of(complete(workshop(1)[0].columns))) if form.name == "temperature")
    term = Term(drift, form, (), (0.1,), ((0.0004,),))
    small = Finding(term, 0.4, rms_um=0.2)
    assert is_below_noise(small, 0.5)
    assert "noise that wanders may make as much" in suspected_note(small)
    assert not is_below_noise(small, 0.3)  # large against the noise
    assert not is_below_noise(replace(small, confidence=0.6), 0.5)  # likelier than all its rivals


def test_a_weak_effect_with_a_clear_name_is_a_finding() -> None:
    columns, _ = Machine(5, ("datum_step",), (0.6,), "normal").campaign(0, Plan())

    said = diagnose(Records.of(columns))

    assert [finding.effect for finding in said.findings] == ["datum_step"]
    assert 0.5 < said.findings[0].confidence < 0.9, "nor is it sure: what switches looks like a small jump"
