"""Noise that wanders looks a little like whatever changes slowly, on one machine in five: never surely, and never to its harm."""

import numpy as np
import pytest
from study.truth_machines import Machine, Plan

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import columns_of
from hil.diagnosis.model.policy import USUAL
from hil.records.rows import Records


@pytest.mark.parametrize("seed", [688361517, 351091739, 106, 117])
def test_noise_that_wanders_has_no_sure_name_and_what_is_put_into_force_does_little_harm(seed: int) -> None:
    machine = Machine(seed, (), (), "walk")
    said, fresh = (Records.of(machine.campaign(number, Plan())[0]) for number in (0, 1))
    found = diagnose(said)
    assert all(finding.confidence < USUAL.sure for finding in found.findings)
    assert not found.unexplained
    table_um, left_um = (
        np.std(fresh.uncorrected_error_um - model.error_um(columns_of(fresh)))
        for model in (found.declared, found.extended)
    )
    assert left_um < 1.1 * table_um  # 1.06 of the worst of these


def test_a_weak_effect_with_a_clear_name_is_a_finding() -> None:
    columns, _ = Machine(5, ("datum_step",), (0.6,), "normal").campaign(0, Plan())

    said = diagnose(Records.of(columns))

    assert [finding.effect for finding in said.findings] == ["datum_step"]
    assert 0.5 < said.findings[0].confidence < 0.9, "nor is it sure: what switches looks like a small jump"
