"""What is taken away again from what the search took, on machines of the generator written apart."""

from dataclasses import replace

import pytest
from study.grammar.machine import draw

from hil.diagnosis import diagnose, diagnosing
from hil.diagnosis.result import Diagnosis
from hil.diagnosis.verdict import sift
from hil.diagnosis.verdict.sift import Sifted
from hil.effects import ALL
from hil.records.rows import Records


def sifted_of(monkeypatch: pytest.MonkeyPatch, lot: str, seed: int) -> tuple[Sifted, Diagnosis]:
    """What was sifted on a machine's rows, and its diagnosis."""
    found: list[Sifted] = []
    monkeypatch.setattr(diagnosing, "sift", lambda *said, **named: found.append(sift.sift(*said, **named)) or found[-1])
    said = diagnose(Records.of(draw(lot, seed).fit.records))
    return found[-1], said


def test_what_is_left_brings_an_unproven_effect_back_and_takes_what_only_undoes_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
    assert [note.startswith("cyclic fits these rows but does not help") for note in said.notes if "cyclic" in note] == [
        True
    ]


def test_what_is_not_required_beside_the_rest_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    found, said = sifted_of(monkeypatch, "outside strong", 108_036)
    assert found.unneeded == {"load_deflection"}
    assert found.left[0].columns == ("load_kg", "target_mm")
    assert "load_deflection" not in {finding.effect for finding in said.findings}
    assert "load_deflection is not required beside what is left unexplained: not taken" in said.notes


def test_a_misfit_of_an_effect_that_is_gone_is_nobodys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a second rest, load_deflection goes: what was a misfit of it then is left like any other."""
    usual, _ = sifted_of(monkeypatch, "outside strong", 108_036)
    asked: list[Sifted] = []

    def is_misfit(left: object, chosen: object) -> bool:
        asked.append(usual)
        return len(asked) == 1  # of the first choice only

    monkeypatch.setattr(sift, "_is_misfit", is_misfit)
    real = sift.beside_the_rest
    names = {effect.id for effect in ALL}
    monkeypatch.setattr(sift, "beside_the_rest", lambda before: gone(real(before)))

    def gone(after: Sifted) -> Sifted:
        return replace(after, chosen=sift.refitted_without(after.chosen, names, after.chosen.last.noise))

    found, said = sifted_of(monkeypatch, "outside strong", 108_036)
    assert found.misfits == ()
    assert found.unexplained
    assert said.unexplained
    assert len(found.left) == len(usual.left)
