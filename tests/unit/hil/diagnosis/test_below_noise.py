"""Noise that wanders looks a little like whatever changes slowly: suspected, never a finding."""

import pytest
from study.truth_machines import Machine, Plan

from hil.diagnosis import diagnose
from hil.records.rows import Records


@pytest.mark.parametrize("seed", [688361517, 351091739])
def test_noise_that_wanders_is_suspected_and_not_corrected(seed: int) -> None:
    columns, _ = Machine(seed, (), (), "walk").campaign(0, Plan())

    said = diagnose(Records.of(columns))

    assert not said.findings
    assert not said.unexplained
    assert said.extended.terms == ()
    assert any("noise that wanders may make as much" in note for note in said.notes)


def test_a_weak_effect_with_a_clear_name_is_a_finding() -> None:
    columns, _ = Machine(5, ("datum_step",), (0.6,), "normal").campaign(0, Plan())

    said = diagnose(Records.of(columns))

    assert [finding.effect for finding in said.findings] == ["datum_step"]
    assert said.findings[0].confidence > 0.75
