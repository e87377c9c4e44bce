"""Noise that wanders looks a little like whatever changes slowly: suspected, never a finding."""

import numpy as np
import pytest
from study.truth_machines import Machine, Plan

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import columns_of
from hil.records.rows import Records


@pytest.mark.parametrize("seed", [688361517, 351091739])
def test_noise_that_wanders_is_no_finding_and_what_is_suspected_does_little_harm(seed: int) -> None:
    machine = Machine(seed, (), (), "walk")
    said, fresh = (Records.of(machine.campaign(number, Plan())[0]) for number in (0, 1))
    found = diagnose(said)
    assert not found.findings
    assert not found.unexplained
    assert bool(found.extended.terms) == any("is suspected" in note for note in found.notes)
    table_um, left_um = (
        np.std(fresh.uncorrected_error_um - model.error_um(columns_of(fresh)))
        for model in (found.declared, found.extended)
    )
    assert left_um < 1.05 * table_um


def test_a_weak_effect_with_a_clear_name_is_a_finding() -> None:
    columns, _ = Machine(5, ("datum_step",), (0.6,), "normal").campaign(0, Plan())

    said = diagnose(Records.of(columns))

    assert [finding.effect for finding in said.findings] == ["datum_step"]
    assert 0.5 < said.findings[0].confidence < 0.9, "nor is it sure: what switches looks like a small jump"
