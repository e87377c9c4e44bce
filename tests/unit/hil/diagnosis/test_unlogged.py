"""Causes that look alike because nobody logged a column: which are rivals, by physics, and what is then said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from support.workshop import Floats

from drivers.edlen import refractivity
from hil.diagnosis import diagnose
from hil.diagnosis.model.rivals import PPM_PER_UNIT, is_within_a_pass, not_told_apart, separating
from hil.diagnosis.result import Finding
from hil.effects import ALL, Form, Term
from hil.effects.warming import WARMING
from hil.records.rows import Records

NOISE_UM = 0.5
WAY_ONLY = ("run", "direction", "target_mm", "time_s")
KNOWN = {one.id: one for one in ALL}
START = {"begin": 0.0, "duration": 3000.0}


def finding_of(
    effect: str, form: str, inputs: Sequence[str], coefficients: Sequence[float] = (1.0,), theta: Sequence[float] = ()
) -> Finding:
    constants = START if form == WARMING else {}
    term = Term(
        KNOWN[effect],
        Form(effect, form, tuple(inputs), constants),
        tuple(theta),
        tuple(coefficients),
        tuple(map(tuple, np.eye(len(coefficients) + len(theta)) * 0.01)),
    )
    return Finding(term, 0.99, (), 1.0, 0.1, 2.0)


def rows(**columns: Floats) -> dict[str, Floats]:
    """Four passes up and down 500 mm in 3000 s, and further columns by the time from 0 to 1."""
    place = np.linspace(0.0, 500.0, 11)
    time = np.linspace(0.0, 1.0, 44)
    return {
        "run": np.repeat([1.0, 2.0], 22),
        "direction": np.tile(np.repeat([1.0, -1.0], 11), 2),
        "target_mm": np.tile(np.concatenate([place, place[::-1]]), 2),
        "time_s": 3000.0 * time,
        **columns,
    }


T = np.linspace(0.0, 1.0, 44)
BY_LOAD = finding_of("load_deflection", "offset", ["load_kg"])
BY_TORQUE = finding_of("load_deflection", "offset", ["torque_percent"])
LAG = finding_of("velocity_lag", "offset", ["velocity_mm_s"])


def drift(um_per_k: float, column: str = "temp_bed_c") -> Finding:
    return finding_of("thermal_drift", "temperature", [column], [um_per_k])


def growth(ppm_per_k: float, column: str = "temp_bed_c") -> Finding:
    return finding_of("thermal_expansion", "temperature", [column, "target_mm"], [ppm_per_k])


def by_time(effect: str, size: float) -> Finding:
    more = ["target_mm"] if effect == "thermal_expansion" else []
    return finding_of(effect, WARMING, ["time_s", *more], [size], [800.0])


def test_what_the_torque_cannot_tell_apart_where_speed_or_load_is_not_recorded_stays_a_rival() -> None:
    whole = ("torque_percent", "load_kg", "velocity_mm_s", "pitch_urad", "yaw_urad")
    some = rows(load_kg=T, torque_percent=T, velocity_mm_s=T)
    assert not_told_apart([BY_TORQUE], ("torque_percent", "load_kg"), some) == {"load_deflection": ("velocity_lag",)}
    assert not_told_apart([BY_TORQUE], whole, some) == {}
    assert not_told_apart([BY_LOAD, LAG], whole, some) == {}
    without_torque = [name for name in whole if name != "torque_percent"]
    assert not_told_apart([BY_LOAD, LAG], without_torque, some) == {"velocity_lag": ("load_deflection",)}
    assert not_told_apart([BY_TORQUE, LAG], ("torque_percent", "velocity_mm_s"), some) == {
        "velocity_lag": ("load_deflection",)
    }
    assert not_told_apart([LAG], ("velocity_mm_s", "load_kg"), some) == {}
    assert not_told_apart([LAG], ("velocity_mm_s",), some) == {"velocity_lag": ("load_deflection",)}


def test_a_tilt_that_nobody_recorded_is_a_rival_of_what_goes_with_it() -> None:
    angles = ("pitch_urad", "yaw_urad")
    whole = (*angles, "load_kg", "torque_percent", "velocity_mm_s", "air_temp_c", "temp_bed_c")
    some = rows(load_kg=T, torque_percent=T, pitch_urad=T, temp_bed_c=T)
    assert not_told_apart([BY_LOAD, drift(1.0)], whole, some) == {}
    without_yaw = [name for name in whole if name != "yaw_urad"]
    assert not_told_apart([BY_LOAD, drift(1.0)], without_yaw, some) == {
        "load_deflection": ("abbe",),
        "thermal_drift": ("abbe",),
    }
    assert not_told_apart([BY_LOAD], without_yaw, some) == {"load_deflection": ("abbe",)}, "a load tilts a carriage"
    reversing = finding_of("load_deflection", "with direction", ["load_kg"])
    for stiff in (BY_TORQUE, reversing):
        assert not_told_apart([stiff], without_yaw, some) == {}, "no tilt turns with the direction of motion"
    arm = finding_of("abbe", "arm", ["pitch_urad"])
    assert not_told_apart([arm], whole, some) == {}
    assert not_told_apart([arm], [name for name in whole if name != "load_kg"], some) == {"abbe": ("load_deflection",)}


STILL = ["air_temp_c", "temp_bed_c"]


# -- the air: 0.93 ppm/K and 0.27 ppm/hPa (Edlén); a shop's 3 K and 10 hPa are 5.5 ppm, 11 µm on 2 m of dead path -------------------
@pytest.mark.parametrize(
    ("finding", "recorded", "moved", "rivals"),
    [
        # with a thermometer of the machine, and none of the air, which goes with it
        (growth(11.5), ["temp_bed_c"], {"temp_bed_c": 0.4}, ("air_index",)),  # 4.6 ppm
        (growth(11.5), ["temp_bed_c"], {"temp_bed_c": 0.6}, ()),  # 6.9 ppm
        (growth(1.0), ["temp_bed_c"], {"temp_bed_c": 8.0}, ("air_index",)),  # no material; air that went along does 0.93
        (growth(11.5), ["temp_bed_c", "air_temp_c"], {"temp_bed_c": 0.4, "air_temp_c": 0.4}, ()),
        (drift(3.0), ["temp_bed_c"], {"temp_bed_c": 3.0}, ("dead_path",)),
        (drift(3.0), ["temp_bed_c"], {"temp_bed_c": 10.0}, ()),  # 30 µm, where 10 K and 10 hPa of air make 24
        (drift(5.0), ["temp_bed_c"], {"temp_bed_c": 8.0}, ()),
        # all of the air logged, and no thermometer of the machine: what the air did is known
        (growth(11.7, "air_temp_c"), ["air_temp_c", "air_pressure_hpa"], {"air_temp_c": 0.5, "air_pressure_hpa": 0.2}, ()),
        (drift(1.0, "air_temp_c"), ["air_temp_c", "air_pressure_hpa"], {"air_temp_c": 2.0, "air_pressure_hpa": 0.2}, ("dead_path",)),
        (drift(4.0, "air_temp_c"), ["air_temp_c", "air_pressure_hpa"], {"air_temp_c": 2.0, "air_pressure_hpa": 0.2}, ()),
        # courses of time: no thermometer at all; a barometer missing; a thermometer that shows nothing of it
        (by_time("thermal_drift", 15.0), [], {}, ("beam_drift", "dead_path")),
        (by_time("thermal_drift", 30.0), [], {}, ("beam_drift",)),
        (by_time("thermal_expansion", 9.0), [], {}, ("air_index",)),
        (by_time("thermal_expansion", 60.0), [], {}, ()),
        (by_time("thermal_drift", 4.0), STILL, dict.fromkeys(STILL, 0.1), ("beam_drift", "dead_path")),
        (by_time("thermal_drift", 9.0), STILL, dict.fromkeys(STILL, 0.1), ("beam_drift",)),
        (by_time("thermal_expansion", 2.0), STILL, dict.fromkeys(STILL, 0.1), ("air_index",)),
        (by_time("thermal_expansion", 5.0), STILL, dict.fromkeys(STILL, 0.1), ()),
    ],
)  # fmt: skip
def test_a_drift_or_an_expansion_may_be_the_airs_by_its_size(
    finding: Finding, recorded: Sequence[str], moved: Mapping[str, float], rivals: tuple[str, ...]
) -> None:
    some = rows(**{name: 20.0 + by * T for name, by in moved.items()})
    assert not_told_apart([finding], [*WAY_ONLY, *recorded], some) == ({finding.effect: rivals} if rivals else {})


def test_what_the_air_does_is_edlens() -> None:
    """Of dry air; at 50 % the vapour that warmer air holds adds 0.03 ppm/K."""
    warmer, denser = refractivity(20.5, 1013.25, 0.0), refractivity(20.0, 1013.75, 0.0)
    colder, thinner = refractivity(19.5, 1013.25, 0.0), refractivity(20.0, 1012.75, 0.0)
    assert PPM_PER_UNIT["air_temp_c"] == pytest.approx((colder - warmer) * 1e6, rel=0.01)
    assert PPM_PER_UNIT["air_pressure_hpa"] == pytest.approx((denser - thinner) * 1e6, rel=0.01)


@pytest.mark.parametrize(("kelvin", "hpa", "may_be"), [(2.0, 0.5, True), (0.1, 7.0, False)])
def test_what_the_air_did_may_be_the_machines_unless_the_pressure_did_it(
    kelvin: float, hpa: float, may_be: bool
) -> None:
    """No part of a machine follows a barometer."""
    air = ("air_temp_c", "air_pressure_hpa")
    found = [finding_of("dead_path", "offset", air), finding_of("air_index", "share", (*air, "target_mm"))]
    some = rows(air_temp_c=20.0 + kelvin * T, air_pressure_hpa=1013.0 + hpa * T)
    expected = {"dead_path": ("thermal_drift",), "air_index": ("thermal_expansion",)}
    assert not_told_apart(found, (*WAY_ONLY, *air), some) == (expected if may_be else {})
    assert not_told_apart(found, (*WAY_ONLY, *air, "temp_bed_c"), some) == {}


# -- reversals, jumps --------------------------------------------------------------------------------------------------------
def worn(centre_mm: float, up: float, down: float) -> Finding:
    """A zone of these heights in the two directions, µm."""
    size = ((up + down) / 2.0, (up - down) / 2.0)
    return finding_of("local_wear", "bump in each direction", ["target_mm", "direction"], size, [centre_mm, 30.0])


@pytest.mark.parametrize(
    ("finding", "may_be"),
    [
        (worn(10.0, 4.0, -4.0), True),
        (worn(10.0, 4.0, 0.0), True),  # upwards from the lower end: after the reversal
        (worn(10.0, 0.0, 4.0), False),  # the whole travel after the reversal
        (worn(495.0, 0.0, 4.0), True),
        (worn(495.0, 4.0, 0.0), False),
        (worn(495.0, 4.0, 4.0), False),  # alike in both directions, which no lost motion is
        (worn(250.0, 4.0, -4.0), False),
        (worn(455.0, 0.0, 4.0), False),  # 2 % of it where the axis turns, at 500
    ],
)
def test_wear_at_an_end_may_be_lost_motion_where_the_way_since_the_reversal_was_not_recorded(
    finding: Finding, may_be: bool
) -> None:
    expected = {"local_wear": ("lost_motion",)} if may_be else {}
    assert not_told_apart([finding], WAY_ONLY, rows()) == expected
    assert not_told_apart([finding], (*WAY_ONLY, "since_reversal_mm"), rows()) == {}
    if may_be:
        said = separating(finding.term.effect, "lost_motion")
        assert said == "approach the same targets after travels of other lengths"


def test_runs_turn_at_places_of_their_own_near_an_end() -> None:
    """The second run turns at 455 mm, where the zone is; the first one beyond it, at 500."""
    some = rows()
    shorter = {**some, "target_mm": np.where(some["run"] == 2.0, 0.91, 1.0) * some["target_mm"]}
    assert not_told_apart([worn(455.0, 0.0, 4.0)], WAY_ONLY, shorter) == {"local_wear": ("lost_motion",)}


def jump(row: int) -> Finding:
    step = Form("datum_step", "step", ("time_s",), {"interval": 70.0})
    between = 3000.0 * (T[row] + T[row + 1]) / 2.0
    return Finding(Term(KNOWN["datum_step"], step, (between,), (5.0,), ((0.01, 0), (0, 1.0))), 0.99, (), 1.0, 0.1, 2.0)


def test_a_jump_may_be_a_load_that_was_put_on_or_another_axis_that_moved_where_these_were_not_recorded() -> None:
    between_passes = jump(10)
    assert not_told_apart([between_passes], (*WAY_ONLY, "load_kg", "pos_y_mm"), rows()) == {}
    assert not_told_apart([between_passes], (*WAY_ONLY, "pos_z_mm"), rows()) == {"datum_step": ("load_deflection",)}
    alike = not_told_apart([between_passes], (*WAY_ONLY, "load_kg"), rows())
    assert alike == {"datum_step": ("cross_axis",)}
    alike = not_told_apart([between_passes], WAY_ONLY, rows())
    assert alike == {"datum_step": ("load_deflection", "cross_axis")}


def test_nobody_puts_a_load_on_between_two_rows_of_one_automatic_pass() -> None:
    assert not_told_apart([jump(5)], WAY_ONLY, rows()) == {}
    some = rows()
    assert is_within_a_pass((some["time_s"] > some["time_s"][5]) * 1.0, some)
    waited = {**some, "time_s": some["time_s"] + 600.0 * (np.arange(44) > 5)}
    assert not is_within_a_pass((np.arange(44) > 5) * 1.0, waited), "ten minutes are enough for that"
    assert not is_within_a_pass((np.arange(44) > 21) * 1.0, some), "between two runs"


# -- whole files -------------------------------------------------------------------------------------------------------------
def test_a_jump_that_may_be_a_load_is_explained_all_the_same() -> None:
    """A jump predicts no run that was left out, and what it may be instead has the same course: nothing without a cause is left."""
    rng = np.random.default_rng(5)
    place = np.linspace(0.0, 400.0, 21)
    target = np.tile(np.concatenate([place, place[::-1]]), 5)
    n = len(target)
    time = np.arange(n) * 7.0 + 300.0 * (np.arange(n) > 105)  # somebody was at the machine within the third run
    error = 4.0 * np.sin(target / 90.0) + 6.0 * (np.arange(n) > 105) + rng.normal(0.0, 0.4, n)
    records = Records.of(
        {
            "run": np.repeat(np.arange(1.0, 6.0), 42),
            "direction": np.tile(np.repeat([1.0, -1.0], 21), 5),
            "target_mm": target,
            "measured_mm": target + error / 1000.0,
            "time_s": time,
        }
    )
    said = diagnose(records)
    assert [finding.effect for finding in said.findings] == ["datum_step"]
    assert said.findings[0].confidence < 0.7
    assert {rival.effect for rival in said.findings[0].rivals} >= {"load_deflection", "cross_axis"}
    assert not said.unexplained
