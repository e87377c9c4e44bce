"""Rows as workshops bring them, made here by hand: a coarse readout, a clock's time, one run, one place, a cell left empty."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from drivers.errors import InputError
from hil.diagnosis import diagnose, fit_model
from hil.diagnosis.campaign import coarse_step_mm, unread_um
from hil.diagnosis.follow_up import as_shares, diagnosed
from hil.diagnosis.result import Finding, RivalFound
from hil.effects import ALL, Form, Term
from hil.effects.history import complete
from hil.effects.survey import survey_of
from hil.records.rows import Records, refuse_other_units

Floats = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def iso_test(
    runs: int = 5, targets: int = 11, noise_um: float = 0.3, *, travel_mm: float = 500.0, seed: int = 1
) -> Records:
    """A positioning test: `runs` times up and down, a row each 6 s, with a table's own errors and a screw that warms by 3 K."""
    rng = np.random.default_rng(seed)
    way = np.linspace(0.0, travel_mm, targets)
    target = np.tile(np.concatenate([way, way[::-1]]), runs)
    direction = np.tile(np.repeat([1.0, -1.0], targets), runs)
    time_s = 6.0 * np.arange(len(target))
    pitch_um = 4.0 * np.sin(target / 110.0) + 1.5 * direction + noise_um * rng.normal(size=len(target))
    return Records.of(
        {
            "run": np.repeat(np.arange(1.0, runs + 1), 2 * targets),
            "direction": direction,
            "target_mm": target,
            "measured_mm": target + pitch_um / 1e3,
            "time_s": time_s,
            "temp_screw_c": 20.0 + 3.0 * (1.0 - np.exp(-time_s / 500.0)),
        }
    )


def with_error(records: Records, error_um: Floats) -> Records:
    return records.with_column("measured_mm", records.measured_mm + error_um / 1e3)


@pytest.mark.parametrize("step_um", [0.1, 1.0])
def test_a_readout_coarser_than_the_noise_leaves_nothing_unexplained(step_um: float) -> None:
    fine = iso_test(noise_um=0.1 * step_um)
    coarse = fine.with_column("measured_mm", np.round(fine.measured_mm / (step_um / 1e3)) * step_um / 1e3)
    assert coarse_step_mm(fine) is None
    assert coarse_step_mm(coarse) == pytest.approx(step_um / 1e3)
    drawn = unread_um(len(coarse), coarse_step_mm(coarse))
    assert np.max(np.abs(drawn)) <= 0.5 * step_um
    assert np.std(drawn) == pytest.approx(step_um / np.sqrt(12.0), rel=0.1)
    found = diagnose(coarse)
    assert not found.findings
    assert not found.unexplained
    assert any(f"in steps of {step_um:g} µm" in note for note in found.notes)
    left_um = fine.uncorrected_error_um + found.extended.correction_um(fine.columns)
    assert np.sqrt(np.mean(left_um**2)) < step_um / np.sqrt(12.0) * 1.5


def test_errors_that_are_all_zero_are_no_cause() -> None:
    nothing = iso_test().with_column("measured_mm", iso_test().target_mm)
    found = diagnose(nothing)
    assert not found.findings
    assert not found.unexplained


@pytest.mark.parametrize("targets", [11, 26])
def test_one_run_is_neither_unexplained_nor_judged_by_its_own_quarters(targets: int) -> None:
    found = diagnose(iso_test(1, targets))
    assert not found.findings
    assert not found.unexplained
    assert any(note.startswith("one run only") for note in found.notes)
    assert not any("not recommended" in note or "from run to run" in note for note in found.notes)


@pytest.mark.parametrize("start_s", [0.0, 900.0, 32400.0, 1.7e9])
def test_a_drift_is_the_same_whenever_the_clock_began(start_s: float) -> None:
    """6 µm with a time constant of 200 s, that no thermometer shows."""
    rows = iso_test()
    rows = with_error(rows, 6.0 * (1.0 - np.exp(-rows["time_s"] / 200.0)))
    rows = Records.of({name: values for name, values in rows.columns.items() if name != "temp_screw_c"})
    late = rows.with_column("time_s", rows["time_s"] + start_s)
    found = diagnose(late)
    (drift,) = found.findings
    assert drift.effect == "thermal_drift"
    assert drift.rms_um == pytest.approx(np.std(6.0 * np.exp(-rows["time_s"] / 200.0)), rel=0.15)
    assert drift.rms_std_um < 0.2 * drift.rms_um
    assert found.after.rms_um < 0.6 * found.before.rms_um
    for again in (late, rows):  # the same day, and another on which the clock begins at 0
        left_um = again.uncorrected_error_um + found.extended.correction_um(again.columns)
        assert np.std(left_um) < 0.5


@pytest.mark.parametrize("seed", [1, 4])
def test_a_cause_of_28_times_the_noise_is_all_there_is(seed: int) -> None:
    """11.5 ppm/K about a bearing 100 mm before the travel, in one warm-up by 6 K: no drift of the beam beside it. Without the cold
    first run nothing predicts it, which says nothing against its cause.
    """
    rows = iso_test(seed=seed, noise_um=0.2)
    rows = rows.with_column("temp_screw_c", 20.0 + 6.0 * (1.0 - np.exp(-rows["time_s"] / 900.0)))
    rows = with_error(rows, 11.5e-3 * (rows["temp_screw_c"] - 20.0) * (rows.target_mm + 100.0))
    found = diagnose(rows)
    (expansion,) = found.findings
    assert expansion.effect == "thermal_expansion"
    assert not found.unexplained
    for name, true in (("coefficient_ppm_per_k", 11.5), ("fixed_point_mm", -100.0)):
        stated = expansion.parameters[name]
        assert stated.value == pytest.approx(true, abs=3.0 * stated.std)
        assert stated.std < 0.1 * abs(true)


def machine_in_a_hall(first_s: float, seed: int) -> tuple[Records, Floats]:
    """A machine that follows the air of its hall with a time constant of 15 min, with what its expansion of 11.5 ppm/K adds, µm.

    The air's is the only thermometer; it swings by 3 K with the gate, a row each 30 s.
    """
    rows = iso_test(seed=seed, noise_um=0.2)
    time_s = 5.0 * rows["time_s"]
    air_k = 3.0 * np.sin(2.0 * np.pi * (time_s + first_s) / 4000.0) + 0.5
    machine_k = np.full(len(rows), air_k[0])
    for i in range(1, len(rows)):
        machine_k[i] = machine_k[i - 1] + (air_k[i - 1] - machine_k[i - 1]) * (time_s[i] - time_s[i - 1]) / 900.0
    added_um = 11.5e-3 * machine_k * rows.target_mm
    rows = Records.of({name: values for name, values in rows.columns.items() if name != "temp_screw_c"})
    rows = rows.with_column("time_s", time_s).with_column("air_temp_c", 20.0 + air_k)
    return with_error(rows, added_um), added_um


@pytest.mark.parametrize("seed", [1, 2])
def test_where_no_other_temperature_is_logged_the_machine_may_follow_the_air(seed: int) -> None:
    rows, _ = machine_in_a_hall(0.0, seed)
    found = diagnose(rows)
    assert found.findings[0].effect == "thermal_expansion"
    assert found.findings[0].term.form.inputs[0] == "air_temp_c"
    assert not found.unexplained
    assert found.findings[0].parameters["coefficient_ppm_per_k"].value == pytest.approx(11.5, rel=0.05)
    again, added_um = machine_in_a_hall(2000.0, seed + 10)
    left_um = again.uncorrected_error_um + found.extended.correction_um(again.columns)
    assert np.std(left_um) < 0.2 * np.std(added_um)


def test_a_thermometer_on_the_machine_is_followed_before_the_air() -> None:
    rows, _ = machine_in_a_hall(0.0, 1)
    survey = survey_of(complete(rows.columns))
    assert survey.warmth == ("air_temp_c",)
    steady = rows.with_column("temp_screw_c", np.full(len(rows), 20.0))
    assert survey_of(complete(steady.columns)).warmth == ()
    warms = rows.with_column("temp_screw_c", rows["air_temp_c"] + 1.0)
    assert survey_of(complete(warms.columns)).warmth == ("temp_screw_c",)


@pytest.mark.parametrize(
    ("column", "scale", "offset", "said"),
    [
        ("measured_mm", 1000.0, 0.0, "measured_mm changes by 1e+03 mm per mm of target_mm"),
        ("measured_mm", -1.0, 0.0, "counts the other way"),
        ("temp_screw_c", 1.0, 273.15, "looks like kelvin"),
        ("air_temp_c", 1.0, 273.15, "looks like kelvin"),
        ("air_pressure_hpa", 100.0, 0.0, "looks like Pa"),
        ("air_pressure_hpa", 0.1, 0.0, "looks like kPa"),
    ],
)
def test_another_unit_is_refused_before_it_is_fitted(column: str, scale: float, offset: float, said: str) -> None:
    rows = iso_test(targets=6)
    rows = rows.with_column("air_temp_c", rows["temp_screw_c"] + 0.5)
    rows = rows.with_column("air_pressure_hpa", 1010.0 + 0.01 * rows["time_s"])
    diagnose(rows)
    other = rows.with_column(column, scale * rows[column] + offset)
    for job in (diagnose, fit_model):
        with pytest.raises(InputError, match=re.escape(said)):
            job(other)


def test_errors_as_large_as_the_travel_are_no_other_unit() -> None:
    """One place with targets that scatter or are written with another last digit; 20 µm of travel while 12 µm of drift go by."""
    rng = np.random.default_rng(3)
    drift_mm = np.linspace(0.0, 0.012, 44)
    for target in (
        np.where(np.arange(44) == 7, 0.3, 0.1 * 3),
        0.3 + 1e-4 * rng.normal(size=44),
        np.linspace(0.3, 0.32, 44),
    ):
        measured = target + drift_mm + 5e-4 * rng.normal(size=44)
        ones = np.ones(44)
        refuse_other_units(Records.of({"run": ones, "direction": ones, "target_mm": target, "measured_mm": measured}))


def test_errors_in_place_of_positions_are_refused() -> None:
    rows = iso_test(targets=6)
    with pytest.raises(InputError, match="holds the error"):
        diagnose(rows.with_column("measured_mm", rows.error_um / 1e3))


def test_at_one_place_nothing_grows_along_the_travel_and_no_run_is_planned() -> None:
    rows = iso_test(travel_mm=0.0)
    rows = with_error(rows, 2.0 * (rows["temp_screw_c"] - 20.0))
    follow = diagnosed(rows, None)
    assert [finding.effect for finding in follow.diagnosis.findings] == ["thermal_drift"]
    assert "thermal_expansion" not in [
        rival.effect for finding in follow.diagnosis.findings for rival in finding.rivals
    ]
    assert follow.run is None


def test_a_column_with_an_empty_cell_is_said_to_be_left_out() -> None:
    rows = iso_test()
    temperature = rows["temp_screw_c"].copy()
    temperature[7] = np.nan
    found = diagnose(rows.with_column("temp_screw_c", temperature))
    assert f"temp_screw_c is missing in 1 of {len(rows)} rows: the column is not used" in found.notes


def test_a_time_that_goes_back_is_said() -> None:
    rows = iso_test()
    again = rows.with_column("time_s", np.where(rows.run > 2, rows["time_s"] - 200.0, rows["time_s"]))
    assert any(note.startswith("time_s goes back once") for note in diagnose(again).notes)
    assert not any("goes back" in note for note in diagnose(rows).notes)


def test_a_finding_and_its_rivals_share_1() -> None:
    """0.5 is left to two rivals said with 0.9 and 0.6: 0.3 and 0.2. One that two digits would show as 0.00 is none."""
    known = {one.id: one for one in ALL}["thermal_drift"]
    term = Term(known, Form(known.id, "temperature", ("temp_screw_c",)), (), (1.0,), ((0.01,),))
    many = Finding(term, 0.5, (RivalFound("abbe", 0.9, ""), RivalFound("cyclic", 0.6, "")), 1.0)
    assert [rival.confidence for rival in as_shares(many).rivals] == pytest.approx([0.3, 0.2])
    few = replace(many, rivals=(RivalFound("abbe", 0.3, ""), RivalFound("cyclic", 0.003, "")))
    assert [rival.confidence for rival in as_shares(few).rivals] == [0.3]
