"""What is taken away again from what the search took, on machines of the generator written apart."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from study.grammar.machine import draw

from hil.diagnosis import diagnose, diagnosing
from hil.diagnosis.noise.evidence import Extra
from hil.diagnosis.remainder import LeftOver
from hil.diagnosis.result import Diagnosis
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.search.searcher import Searcher
from hil.diagnosis.verdict import sift
from hil.diagnosis.verdict.sift import Sifted
from hil.effects import Estimate
from hil.records.rows import Records


def sifted_of(monkeypatch: pytest.MonkeyPatch, lot: str, seed: int) -> tuple[Sifted, Diagnosis]:
    """What was sifted on a machine's rows, and its diagnosis."""
    found: list[Sifted] = []
    monkeypatch.setattr(diagnosing, "sift", lambda *said, **named: found.append(sift.sift(*said, **named)) or found[-1])
    said = diagnose(Records.of(draw(lot, seed).fit.records))
    return found[-1], said


def opposed_when_put_back(monkeypatch: pytest.MonkeyPatch, *effects: str) -> list[Sifted]:
    """Lets `without_opposed` name these at its second call, which is with the unproven effects put back; what it was asked."""
    real, asked = sift.without_opposed, list[Sifted]()

    def one_more(before: Sifted) -> Sifted:
        asked.append(before)
        found = real(before)
        return replace(found, opposed=found.opposed | {*effects}) if len(asked) == 2 else found

    monkeypatch.setattr(sift, "without_opposed", one_more)
    return asked


def test_what_is_left_brings_an_unproven_effect_back(monkeypatch: pytest.MonkeyPatch) -> None:
    found, said = sifted_of(monkeypatch, "outside strong", 108_030)
    assert found.unproven == ("cyclic",)
    assert found.required == {"cyclic"}
    assert found.missing == ()
    assert found.opposed == {"thermal_expansion"}
    assert "cyclic" in {finding.effect for finding in said.findings}
    assert not any(note.startswith("cyclic fits these rows") for note in said.notes)
    assert any(note.startswith("thermal_expansion does little but undo") for note in said.notes)
    asked = opposed_when_put_back(monkeypatch, "cosine", "cyclic")
    found, said = sifted_of(monkeypatch, "outside strong", 108_030)
    assert len(asked) >= 2
    assert found.required == frozenset(), "it only undoes something else"
    assert found.missing == ("cyclic",)


@pytest.mark.slow
def test_what_only_undoes_an_effect_that_came_back_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    opposed_when_put_back(monkeypatch, "cosine")
    found, said = sifted_of(monkeypatch, "outside strong", 108_030)
    assert found.required == {"cyclic"}
    assert found.opposed == {"thermal_expansion", "cosine"}
    assert any(note.startswith("cosine does little but undo") for note in said.notes)


def test_an_unproven_effect_stays_away_where_as_much_is_left_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    found, said = sifted_of(monkeypatch, "outside strong", 108_035)
    assert found.left
    assert found.required == frozenset()
    assert found.missing == found.unproven == ("cyclic",)
    assert any(note.startswith("cyclic fits these rows but does not help") for note in said.notes)


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_misfit_of_an_effect_that_went_is_left_in_the_fit_and_sized(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rest of 108036 is taken for a misfit of load_deflection, which goes beside a second rest that reads another column."""
    usual, _ = sifted_of(monkeypatch, "outside strong", 108_036)
    (rest,) = usual.left
    second = replace(rest, columns=("temp_bed_c",), rms=Estimate(0.1, 0.01))
    real_rest, real_misfit, searchers = sift.left_over, sift._is_misfit, list[Searcher]()

    def two(searcher: Searcher, *said: Any) -> tuple[LeftOver, ...]:
        searchers.append(searcher)
        noise = np.random.default_rng(1).normal(size=(len(searcher.y), 1))
        extra = Extra(noise[:, :0], noise * 1e-3)
        return (*real_rest(searcher, *said), replace(second, extra=extra))

    def dropped(searcher: Searcher, choices: Sequence[Choice], *said: Any) -> list[Choice]:
        return [choice for choice in choices if choice.effect.id != "load_deflection"]

    monkeypatch.setattr(sift, "left_over", two)
    monkeypatch.setattr(sift, "drop", dropped)
    monkeypatch.setattr(sift, "_is_misfit", lambda one, chosen: one.columns == rest.columns or real_misfit(one, chosen))
    found, said = sifted_of(monkeypatch, "outside strong", 108_036)
    assert found.misfits == ()
    assert [one.columns for one in found.left] == [rest.columns, second.columns], "largest first"
    assert found.left[0].rms.value == pytest.approx(rest.rms.value, rel=0.2)
    assert found.unneeded == {"load_deflection"}
    assert said.unexplained
    columns = searchers[0].nuisance.random
    assert any(np.allclose(columns[:, -one.extra.random.shape[1] :], one.extra.random) for one in found.left[:1])


def test_what_a_function_of_other_columns_explains_better_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    _, usual = sifted_of(monkeypatch, "strong", 100_000)
    (finding,) = usual.findings
    monkeypatch.setattr(sift, "beaten", lambda searcher, choices, noise: {finding.effect})
    found, said = sifted_of(monkeypatch, "strong", 100_000)
    assert found.outdone == {finding.effect}
    assert finding.effect not in {one.effect for one in said.findings}
    assert f"{finding.effect} is explained better by a function of other columns: not taken" in said.notes
