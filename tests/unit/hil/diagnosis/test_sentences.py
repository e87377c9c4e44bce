"""What a diagnosis says in every language: each effect and form of the catalogue, what separates rivals, and the next measurement."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from support.campaigns import campaign

from hil.diagnosis.follow_up import ALONE_MIN
from hil.diagnosis.model.rivals import separating, to_switch
from hil.diagnosis.next.feasible import feasible_runs
from hil.diagnosis.next.planned_run import Means
from hil.diagnosis.page import parameter, sentence
from hil.diagnosis.page_data import ShownFinding, read_shown
from hil.diagnosis.report import diagnosis as diagnosis_part
from hil.diagnosis.result import OUTSIDE, Finding, RivalFound
from hil.diagnosis.stored import stored_beside
from hil.effects import ALL, Effect, Form, Term, survey_of
from hil.effects.history import complete
from hil.effects.non_parametric import NonParametric, fine_form, smooth_form, spread_of
from hil.ui.report.data import NamedCampaign
from hil.ui.screen.campaigns import Measurement
from hil.ui.screen.texts import LANGUAGES, Texts

FIGURE = re.compile(r"-?[\d.]+ ± [\d.]+")
LATIN = re.compile(r"[A-Za-z]{4,}")
RIVALS = (RivalFound("abbe", 0.21, ""), RivalFound("thermal_drift", 0.2, ""))
OURS = {"setup", "abbe_offset_mm"}
"""Names of columns that are to be typed."""
SENSORS = ("load_kg", "torque_percent", "pitch_urad", "yaw_urad", "pos_y_mm", "air_temp_c", "temp_screw_c")


def columns(*beside: str, rows: int = 40) -> dict[str, np.ndarray]:
    """Everything that any effect reads, in every row."""
    rng = np.random.default_rng(8)
    names = ["temp_screw_c", "pitch_urad", "pos_y_mm", "load_kg", "torque_percent", *beside]
    names += ["air_temp_c", "air_pressure_hpa", "air_humidity_percent", "abbe_offset_mm", "velocity_mm_s"]
    base = {
        "run": np.repeat([1.0, 2.0], rows // 2),
        "direction": np.tile([1.0, -1.0], rows // 2),
        "target_mm": rng.uniform(0.0, 300.0, rows),
        "measured_mm": rng.normal(size=rows),
        "time_s": np.cumsum(rng.uniform(2.0, 9.0, rows)),
    }
    return complete(base | {name: 20.0 + rng.normal(size=rows) for name in names})


def forms(effect: Effect) -> Iterator[tuple[Form, dict[str, np.ndarray]]]:
    """Every form there is, with rows it fits."""
    plain = columns()
    if isinstance(effect, NonParametric):
        spread = spread_of("temp_screw_c", plain)
        yield smooth_form(["temp_screw_c"], [spread], with_direction=True), plain
        yield fine_form(0.0, 300.0, 12, plain, with_direction=False), plain
        return
    for given in (plain, columns("setup")):
        yield from ((form, given) for form in effect.forms(survey_of(given)))


def term(effect: Effect, form: Form, given: dict[str, np.ndarray]) -> Term:
    theta = form.starts[len(form.starts) // 2]
    k = effect.basis(form, theta, given).shape[1]
    covariance = np.diag(np.linspace(0.01, 0.02, k + len(theta)))
    return Term(effect, form, theta, tuple(np.linspace(1.2, 2.3, k)), tuple(map(tuple, covariance)))


def found(effect: Effect, form: Form, given: dict[str, np.ndarray]) -> ShownFinding:
    """As a screen gets it."""
    fitted = term(effect, form, given)
    parameters = tuple((name, one.value, one.std) for name, one in fitted.parameters.items())
    said = effect.explain(fitted)
    return ShownFinding(effect.id, 0.9, effect.action.value, said, parameters, (), None, form.name, fitted.needs, 1.5)


@pytest.mark.parametrize("effect", [*ALL, NonParametric()], ids=lambda effect: effect.id)
def test_every_form_of_the_catalogue_has_its_sentence_with_the_figures_of_the_terminals(effect: Effect) -> None:
    seen = 0
    for form, given in forms(effect):
        seen += 1
        finding = found(effect, form, given)
        figures = set(FIGURE.findall(finding.explanation))
        assert figures
        for language in LANGUAGES:
            t = Texts(language)
            said = sentence(t, finding)
            assert said != finding.explanation or language == "en", form.name
            plain = said.replace("−", "-").replace(",", ".") if language == "de" else said.replace("−", "-")
            assert figures <= set(FIGURE.findall(plain)), (language, form.name, said)
            names = [parameter(t, name) for name, _, _ in finding.parameters]
            assert not any("_" in name for name in names), names
            if language == "zh":
                assert LATIN.findall(said) == []
    assert seen


def test_a_finding_that_is_not_determined_is_said_in_every_language_too() -> None:
    form = "exponential"
    vague = (
        ("amount_at_shortest_travel_um", 1.84, 0.2),
        ("shortest_travel_mm", 3.0, 0.0),
        ("most_length_mm", 22.2, 0.0),
    )
    inputs = ("since_reversal_mm", "direction")
    for parameters, figures in ((vague, ("84", "22")), ((("rms_um", 1.46, 0.03),), ("46",)), ((), ("46",))):
        finding = ShownFinding("lost_motion", 0.9, "compensate", "English.", parameters, (), None, form, inputs, 1.46)
        for language in LANGUAGES:
            t = Texts(language)
            said = sentence(t, finding)
            assert said != "English."
            assert all(figure in said for figure in figures), said
            assert "± 0 " not in said
            assert not any("_" in parameter(t, name) for name, _, _ in parameters)
            if language == "zh":
                assert LATIN.findall(said) == []


def test_what_no_coefficient_tells_is_not_stated_and_the_size_is() -> None:
    """Growth about a point that the rows do not show, 0.55 ± 14 ppm once, of 1.75 µm; what may be 0 and is known well is stated."""
    effect = next(one for one in ALL if one.id == "thermal_expansion")
    given = columns()
    form = next(one for one in effect.forms(survey_of(given)) if one.name == "lagged temperature, about a fixed point")
    fitted = replace(term(effect, form, given), covariance=tuple(map(tuple, np.diag([9.0, 9.0, 0.01]))))
    for vague in (False, True):
        finding = Finding(fitted, 0.9, rms_um=1.46, rms_std_um=0.1, peak_um=4.0, vague=vague)
        assert ("coefficient_ppm_per_k" in finding.parameters) is not vague
        assert (
            "1.46 ± 0.2 µm RMS over these rows and 4 µm at most; these rows do not determine its coefficients"
            in finding.explanation
        ) is vague
    sure = Finding(term(effect, form, given), 0.9, rms_um=1.46, rms_std_um=0.1, vague=True)
    assert "coefficient_ppm_per_k" in sure.parameters, "not 0 at least"
    cyclic = next(one for one in ALL if one.id == "cyclic")
    wave = next(iter(cyclic.forms(survey_of(given))))
    wide = replace(term(cyclic, wave, given), covariance=tuple(map(tuple, np.diag([99.0, 99.0, 0.01]))))
    assert set(Finding(wide, 0.9, vague=True).parameters) == {"most_amplitude_um"}, "its period is no strength"


def test_a_users_own_effect_without_parameters_keeps_its_sentence() -> None:
    for parameters in ((), (("least_size_um", 3.0, 0.0),)):
        shown = ShownFinding("mine", 0.9, "compensate", "Mine.", parameters, (), None, "plain", ("target_mm",), 1.46)
        assert {sentence(Texts(language), shown) for language in LANGUAGES} == {"Mine."}


def test_a_load_on_an_axis_whose_stiff_point_is_not_known_is_said_in_every_language() -> None:
    vague = (("compliance_at_mid_travel_um_per_kg", 0.52, 0.02), ("compliance_with_position_um_per_kg", 0.011, 0.01))
    inputs = ("load_kg", "target_mm", "direction")
    finding = ShownFinding(
        "load_deflection", 0.9, "compensate", "English.", vague, (), None, "from a stiff point", inputs, 1.46
    )
    for language in LANGUAGES:
        said = sentence(Texts(language), finding)
        assert said != "English."
        assert "52" in said
        assert "011" in said


def test_a_users_own_effect_speaks_for_itself() -> None:
    own = ShownFinding("sticky_gearbox", 0.9, "compensate", "It sticks.", (("stick_um", 1.0, 0.1),), (), None, "f", ())
    for language in LANGUAGES:
        assert sentence(Texts(language), own) == "It sticks."
        assert parameter(Texts(language), "stick_um") == "stick_um"
    older = ShownFinding("cosine", 0.9, "fix-setup", "It is short.", (), (), None)
    assert sentence(Texts("de"), older) == "It is short."


def runs() -> Iterator[str]:
    levels = {"load_kg": (0.0, 60.0), "pos_y_mm": (0.0, 100.0)}
    for assumed in (frozenset[str](), frozenset(levels)):
        means = Means(0.0, 300.0, levels=levels, assumed=assumed, feeds_mm_s=(5.0, 20.5))
        yield from (run.describe() for run in feasible_runs(means))
    yield from (run.describe() for run in feasible_runs(Means(0.0, 300.0, levels=levels, by_itself=frozenset(levels))))


def test_what_separates_rivals_and_the_next_measurement_are_said_in_every_language() -> None:
    said = {rival.separate_by for effect in ALL for rival in effect.rivals} | {ALONE_MIN, *runs()}
    said |= {separating(ALL[0], "some other"), *(separating(effect, OUTSIDE) for effect in ALL)}
    for text in said:
        assert Texts("en").said(text) == text
        german = Texts("de").said(text)
        assert german != text
        assert not re.search(r"\d\.\d|somebody| rows| the ", german), german
        assert set(LATIN.findall(Texts("zh").said(text).replace("abbe_offset_mm", ""))) <= OURS, text


def test_what_to_record_is_said_in_every_language() -> None:
    text = separating(ALL[0], "some other", SENSORS)
    assert Texts("en").said(text).startswith("record one of these in every row: load; torque; pitch")
    assert Texts("de").said(text).startswith("eines davon in jeder Zeile aufzeichnen: Last; Drehmoment; ")
    assert set(LATIN.findall(Texts("zh").said(text))) <= OURS
    assert Texts("de").said(separating(ALL[0], "some other", SENSORS[:1])) == "in jeder Zeile aufzeichnen: Last"
    assert Texts("de").said(to_switch("load_kg")).endswith("was mit ihr schaltet, kommt wieder: Last")
    assert set(LATIN.findall(Texts("zh").said(to_switch("load_kg")))) <= OURS


def test_parts_of_what_is_said_are_said_too() -> None:
    de = Texts("de")
    assert de.said("before-3 warming") == "Erkundung 3 Erwärmen"
    assert de.said("12.345 mm") == "12,345 mm"
    assert de.said("abbe is not corrected: runs left out are no better with it than without").startswith(
        "Abbe-Fehler wird"
    )
    assert de.said("since_reversal_mm is missing: made up from the row order").startswith("Weg seit der Umkehr fehlt")
    assert de.said("temp_screw_c × target_mm; load_kg") == "Temperatur Spindel × Position; Last"
    assert de.said("temp_screw_c") == "Temperatur Spindel"
    assert de.said("Temp screw, °C") == "Temperatur Spindel, °C"
    suspected = (
        "abbe is suspected (posterior 0.31): noise may make as much, so it is no finding; the extended model holds that share"
        " of it. An arm."
    )
    assert de.said(suspected).startswith("Verdacht auf „Abbe-Fehler“ (Wahrscheinlichkeit 0,31): ")
    assert Texts("zh").said("the drive said 0.5 things") == "the drive said 0.5 things"


def test_figures_to_so_many_digits() -> None:
    de, en = Texts("de"), Texts("en")
    assert (de.significant(-1234.56), de.significant(12345.6), de.significant(1.2e-5)) == ("−1235", "12350", "0,000012")
    assert de.estimate(0.5, 0.012, "µm") == "0,5 ± 0,024 µm"  # expanded, k = 2
    assert en.estimate(0.5, None) == "0.5"
    assert en.estimate(0.5, float("nan"), "mm") == "0.5 mm"
    assert en.estimate(None, None) == "–"


@pytest.mark.parametrize(
    ("ends", "panel", "report"),
    [
        ({"low": 4.1, "high": 5.3}, "4.7 ± 0.6 µm", "4.7 ± 0.6 µm"),
        ({"low": 4.2, "high": 5.9}, "4.7 (4.2 … 5.9) µm", "4.7 (4.2 to 5.9) µm"),
        ({}, "4.7 ± 0.6 µm", "4.7 ± 0.6 µm"),  # of an older version
    ],
)
def test_screen_and_report_say_the_ends_where_plus_minus_does_not_say_as_much(
    ends: dict[str, float], panel: str, report: str, tmp_path: Path
) -> None:
    told = {
        "effect": "thermal_drift",
        "parameters": {"drift_um": {"value": 4.7, "std": 0.3, **ends}},
        "explanation": "It drifts.",
    }
    rows_file = tmp_path / "x.csv"
    rows_file.touch()
    drawn = {"forms": [{"name": "warming since the start", "inputs": ["time_s"]}]}
    stored_beside([rows_file]).write_text(json.dumps({"findings": [told], "drawn": drawn}))
    (shown,) = read_shown(cast(Measurement, SimpleNamespace(paths=(rows_file,)))).findings
    ((name, value, std),) = shown.parameters
    said = Texts("en").estimate(value, std, "µm", shown.intervals.get(name))
    assert said == panel
    rows = NamedCampaign("a", campaign(runs=2))
    assert f"(drift {report}" in diagnosis_part.opening({"findings": [told]}, rows, rows)
