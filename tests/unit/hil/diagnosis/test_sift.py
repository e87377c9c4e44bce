"""What is taken away again from what the search took, on machines of the generator written apart."""

from dataclasses import replace

import pytest
from study.grammar.machine import draw

from hil.diagnosis import diagnose, diagnosing
from hil.diagnosis.result import Diagnosis
from hil.diagnosis.verdict import sift
from hil.diagnosis.verdict.sift import Sifted
from hil.records.rows import Records

pytestmark = pytest.mark.outside


def sifted_of(monkeypatch: pytest.MonkeyPatch, lot: str, seed: int) -> tuple[Sifted, Diagnosis]:
    """What was sifted on a machine's rows, and its diagnosis."""
    found: list[Sifted] = []
    monkeypatch.setattr(diagnosing, "sift", lambda *said, **named: found.append(sift.sift(*said, **named)) or found[-1])
    said = diagnose(Records.of(draw(lot, seed).fit.records))
    return found[-1], said


def test_what_is_left_brings_an_unproven_effect_back(monkeypatch: pytest.MonkeyPatch) -> None:
    found, said = sifted_of(monkeypatch, "outside strong", 108_030)
    assert found.unproven == ("cyclic",)
    assert found.required == {"cyclic"}
    assert found.missing == ()
    assert found.opposed == {"thermal_expansion"}
    assert "cyclic" in {finding.effect for finding in said.findings}
    assert not any(note.startswith("cyclic fits these rows") for note in said.notes)
    assert any(note.startswith("thermal_expansion does little but undo") for note in said.notes)


def test_an_unproven_effect_stays_away_where_as_much_is_left_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    found, said = sifted_of(monkeypatch, "outside strong", 108_035)
    assert found.left
    assert found.required == frozenset()
    assert found.missing == found.unproven == ("cyclic",)
    assert any(note.startswith("cyclic fits these rows but does not help") for note in said.notes)


def test_an_effect_that_came_back_and_is_not_required_beside_the_rest_is_said_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, said = sifted_of(monkeypatch, "outside strong", 108_027)
    assert found.required == {"cyclic"}
    assert found.missing == ("cyclic",)
    assert found.unneeded == frozenset()
    assert [note for note in said.notes if note.startswith("cyclic")] == [
        "cyclic fits these rows but does not help on runs left out: not taken"
    ]
    again = replace(found, opposed=frozenset({"cyclic"}))
    assert not any(note.startswith("cyclic") for note in again.notes)


def test_what_is_not_required_beside_the_rest_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    found, said = sifted_of(monkeypatch, "outside strong", 108_036)
    assert found.unneeded == {"load_deflection"}
    assert found.left[0].columns == ("load_kg", "target_mm")
    assert "load_deflection" not in {finding.effect for finding in said.findings}
    assert "load_deflection is not required beside what is left unexplained: not taken" in said.notes
