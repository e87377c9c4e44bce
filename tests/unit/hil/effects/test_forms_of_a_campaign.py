"""What a campaign lets each effect look like: forms, bounds and grids, and the facts and columns they are made from, by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from drivers.errors import InputError
from hil.effects import ALL, Action, Estimate, Form, NonLinear, Survey, Term, survey_of, term_from_json
from hil.effects.air import air_inputs
from hil.effects.cyclic import order_of_interference, period_grid
from hil.effects.history import complete, reversals, row_order, stand_ins, time_column
from hil.effects.survey import follows_way, varies

EFFECTS = {effect.id: effect for effect in ALL}
EVERY_COLUMN = {
    "direction": 0.0,
    "target_mm": 200.0,
    "time_s": 1800.0,
    "row_order": 20.0,
    "velocity_mm_s": -40.0,
    "since_reversal_mm": 30.0,
    "stroke_mm": 90.0,
    "load_kg": 50.0,
    "torque_percent": 12.0,
    "pitch_urad": 3.0,
    "yaw_urad": -2.0,
    "abbe_offset_mm": 25.0,
    "pos_y_mm": 100.0,
    "temp_screw_c": 22.0,
    "temp_head_c": 24.0,
    "air_temp_c": 20.5,
}


def campaign(**changes: object) -> Survey:
    """Targets 100 to 300 mm every 20 mm, an hour, a row every 30 s."""
    survey = Survey(
        rows=40,
        centre_mm=200.0,
        half_span_mm=100.0,
        spacing_mm=20.0,
        time_column="time_s",
        time_start=10.0,
        duration_s=3600.0,
        interval_s=30.0,
        varying=frozenset(EVERY_COLUMN),
        mean=EVERY_COLUMN,
        moments=(15.0, 45.0, 75.0),
    )
    return replace(survey, **changes)  # type: ignore[arg-type]


def with_only(*names: str) -> Survey:
    return campaign(varying=frozenset(names))


def forms(effect: str, survey: Survey | None = None) -> dict[tuple[str, str], Form]:
    """By name and first column."""
    return {(form.name, form.inputs[0]): form for form in EFFECTS[effect].forms(survey or campaign())}


def names(effect: str, survey: Survey | None = None) -> list[tuple[str, bool]]:
    """Name, and whether the first search tries it."""
    return [(form.name, form.scan) for form in EFFECTS[effect].forms(survey or campaign())]


TRAVEL = {"centre_mm": 200.0, "half_span_mm": 100.0}


def test_what_is_offered_and_what_only_refines() -> None:
    assert set(names("backlash")) == {("constant", True), ("changing with temperature", True)}
    assert names("backlash", with_only("direction")) == [("constant", True)]
    assert names("backlash_position") == [(n, True) for n in ("linear", "quadratic", "shape", "fine shape")]
    assert names("cosine") == [("scale", True)]
    assert names("cosine", with_only("target_mm", "setup")) == [("scale, gone since the realignment", True)]
    assert names("cross_axis") == [
        ("shift", True),
        ("growing along the travel", True),
        ("curved", True),
        ("shift and growth", False),
        ("curved and growing along the travel", False),
    ]
    simple = [
        "offset",
        "with direction",
        "with position",
        "with direction and position",
        "from a stiff point",
        "in a zone",
    ]
    refined = ["offset and with direction and position", "curved", "curved with direction"]
    assert names("load_deflection") == [*[(n, True) for n in simple], *[(n, False) for n in refined]] * 2
    assert names("load_deflection", with_only("torque_percent")) == [
        *[(n, True) for n in simple[:-1]],
        *[(n, False) for n in refined],
    ]
    assert names("abbe") == [
        ("tilt", True),
        ("tilt", True),
        ("arm changing along the travel", False),
        ("arm changing along the travel", False),
        ("straight tilt, two offsets", True),
        ("tilt, two offsets", True),
        ("wavy tilt, two offsets", True),
    ]
    assert names("cyclic") == [
        ("fundamental", True),
        ("with second harmonic", False),
        ("with third harmonic", False),
        ("amplitude changing along the travel", False),
        ("with second harmonic, amplitude changing along the travel", False),
        ("with third harmonic, amplitude changing along the travel", False),
        ("different in each direction", False),
    ]
    assert names("lost_motion") == [("exponential", True), ("tanh", True), ("two lengths", False)]
    assert names("velocity_lag") == [("proportional", True), ("with square", False), ("saturating", False)]
    zones = [("bump", True), ("bump with direction", True), ("bump in each direction", False)]
    richer = [(shape + name, False) for shape in ("flat ", "fading ", "rising ") for name, _ in zones]
    assert names("local_wear") == [*zones, *richer]
    shapes = [("bump", True), ("flat bump", False), ("fading bump", False), ("rising bump", False)]
    assert names("local_wear", with_only("target_mm")) == shapes
    assert names("pitch_shape") == [(n, True) for n in ("lead error", "bow", "shape", "fine shape")]
    warm = [("warming since the start", True), ("warming since the start through two lags", False)]
    temperatures = [("temperature", True)] * 2 + warm + [("lagged temperature", True)] * 2
    about_a_point = [(f"{name}, about a fixed point", scan) for name, scan in temperatures]
    from_sensors = ["temperature"] * 2 + ["lagged temperature"] * 2
    unlike = [(f"{name}, unlike along the travel, about a fixed point", False) for name in from_sensors]
    assert names("thermal_expansion") == [*temperatures, *about_a_point, *unlike]
    assert names("thermal_drift") == [*temperatures, ("warming since the start, unlike along the travel", True)]
    assert names("thermal_drift", with_only("time_s")) == warm
    assert names("thermal_drift", campaign(rows=3)) == [("temperature", True)] * 2
    assert len(names("thermal_drift", campaign(rows=4))) == 7
    assert names("thermal_drift", with_only("temp_screw_c", "target_mm")) == [("temperature", True)]
    assert names("beam_drift") == [("random walk", True), ("flicker", True)]
    assert names("datum_step") == [("step", True)]


@pytest.mark.parametrize(
    ("effect", "without"),
    [
        ("backlash", "direction"),
        ("backlash_position", "direction"),
        ("backlash_position", "target_mm"),
        ("cosine", "target_mm"),
        ("local_wear", "target_mm"),
        ("lost_motion", "since_reversal_mm"),
        ("lost_motion", "direction"),
        ("pitch_shape", "target_mm"),
        ("velocity_lag", "velocity_mm_s"),
        ("velocity_lag", "direction"),
    ],
)
def test_without_its_column_it_is_not_offered(effect: str, without: str) -> None:
    assert names(effect, campaign(varying=frozenset(EVERY_COLUMN) - {without})) == []


def test_without_moments_nothing_happened_at_one() -> None:
    assert names("datum_step", campaign(moments=())) == []
    assert names("beam_drift", campaign(moments=())) == []
    assert "straight tilt, two offsets" not in {name for name, _ in names("abbe", with_only("target_mm", "pitch_urad"))}


def test_air_stands_for_what_no_sensor_varies() -> None:
    """Pressure has a mean but does not vary; humidity has none and is standard air's 50 %."""
    survey = campaign(mean=EVERY_COLUMN | {"air_pressure_hpa": 990.0})
    inputs, constants = air_inputs(survey)
    assert inputs == ("air_temp_c",)
    assert constants == {"air_pressure_hpa": 990.0, "air_humidity_percent": 50.0}
    assert forms("air_index", survey)["air index", "air_temp_c"].inputs == ("air_temp_c", "target_mm")
    assert forms("dead_path", survey)["air index", "air_temp_c"].inputs == ("air_temp_c",)
    assert names("air_index", with_only("target_mm")) == names("dead_path", with_only("target_mm")) == []
    standard = air_inputs(campaign(varying=frozenset({"air_humidity_percent"}), mean={}))[1]
    assert standard == {"air_temp_c": 20.0, "air_pressure_hpa": 1013.25}  # ISO 1, one atmosphere


def test_constants_are_the_campaigns() -> None:
    assert forms("backlash_position")["quadratic", "target_mm"].constants == TRAVEL
    assert forms("pitch_shape")["bow", "target_mm"].constants == TRAVEL
    assert forms("cyclic")["amplitude changing along the travel", "target_mm"].constants == TRAVEL
    assert forms("abbe")["tilt, two offsets", "abbe_offset_mm"].constants == TRAVEL
    assert forms("load_deflection")["curved", "load_kg"].constants == TRAVEL | {"mean": 50.0}
    assert forms("cross_axis")["curved", "pos_y_mm"].constants == TRAVEL | {"mean_mm": 100.0}
    drift = forms("thermal_drift")["warming since the start, unlike along the travel", "time_s"]
    assert drift.constants == TRAVEL | {"first_row": 10.0, "last_row": 3610.0}
    wander = forms("beam_drift")["flicker", "time_s"]
    assert wander.constants == {"start": 10.0, "duration": 3600.0, "waves": 10.0}  # a wave for every four rows
    assert wander.shrunk
    assert forms("beam_drift", campaign(rows=4000))["flicker", "time_s"].constants["waves"] == 40.0


def bounds(parameter: NonLinear) -> tuple[float, float, bool]:
    return (parameter.lower, parameter.upper, parameter.logarithmic)


def test_a_step_is_tried_at_every_moment() -> None:
    step = forms("datum_step")["step", "time_s"]
    assert step.starts == ((15.0,), (45.0,), (75.0,))
    assert step.exhaustive
    assert bounds(step.nonlinear[0]) == (15.0, 75.0, False)


def test_an_arm_is_tried_on_both_sides() -> None:
    arm = forms("abbe")["tilt, two offsets", "abbe_offset_mm"]
    assert bounds(arm.nonlinear[0]) == (-600.0, 600.0, False)
    assert [value for (value,) in arm.starts] == [-400.0, -150.0, -60.0, 60.0, 150.0, 400.0]


def test_lengths_of_lost_motion_from_the_nearest_row_to_the_travel() -> None:
    """Where no row is nearer to a reversal than 20 / 8 = 2.5 mm from there, a quarter of that as the bound; 2 · 100 = 200 mm, half of
    that as the longest start. A row at 0.5 mm shows shorter ones, down to a thousandth of the travel; rows on the reversal none.
    """
    found = forms("lost_motion", campaign(ranges={"since_reversal_mm": (6.0, 180.0)}))
    single, pair = found["exponential", "since_reversal_mm"], found["two lengths", "since_reversal_mm"]
    assert bounds(single.nonlinear[0]) == (0.625, 200.0, True)
    assert [bounds(p) for p in pair.nonlinear] == [(0.625, 200.0, True)] * 2
    starts = [value for (value,) in single.starts]
    assert len(starts) == 12
    assert (starts[0], starts[-1]) == pytest.approx((2.5, 100.0))
    assert np.diff(np.log(starts)) == pytest.approx([math.log(40.0) / 11] * 11)
    every_third = starts[::3]  # each 2.73 times the one before: more than twice
    assert pair.starts == tuple((a, b) for i, a in enumerate(every_third) for b in every_third[i + 1 :])
    for nearest_mm, least_mm in ((0.5, 0.5), (0.01, 0.2), (0.0, 2.5)):
        near = forms("lost_motion", campaign(ranges={"since_reversal_mm": (nearest_mm, 180.0)}))
        assert near["exponential", "since_reversal_mm"].starts[0] == pytest.approx((least_mm,))


def test_shapes_of_lost_motion_that_remembers_short_strokes() -> None:
    short = campaign(ranges={"since_reversal_mm": (6.0, 180.0), "stroke_mm": (6.0, 180.0)})
    names = {form.name: form.scan for form in forms("lost_motion", short).values()}
    remembered = {f"{name}, strokes remembered" for name in ("exponential", "tanh", "Dahl")}
    assert names.keys() - {"exponential", "tanh", "two lengths"} == remembered
    assert not names["Dahl, strokes remembered"], "its exponent is free: only where a simpler shape was found"
    long = campaign(ranges={"since_reversal_mm": (6.0, 180.0), "stroke_mm": (150.0, 180.0)})
    assert not remembered & {name for name, _ in forms("lost_motion", long)}


def test_a_knee_about_the_usual_feed() -> None:
    knee = forms("velocity_lag")["saturating", "velocity_mm_s"]
    assert bounds(knee.nonlinear[0]) == (4.0, 1200.0, True)
    assert knee.starts == ((12.0,), (40.0,), (120.0,))
    back_faster = campaign(ranges={"velocity_mm_s": (-60.0, 20.0)})
    assert forms("velocity_lag", back_faster)["saturating", "velocity_mm_s"].constants == {"fastest_mm_s": 60.0}
    at_rest = forms("velocity_lag", campaign(mean=EVERY_COLUMN | {"velocity_mm_s": 0.0}))
    assert at_rest["saturating", "velocity_mm_s"].nonlinear[0].lower == pytest.approx(1e-4)


def test_time_constants_from_a_few_rows_to_three_campaigns() -> None:
    """4 rows of 30 s are 120 s, 3 hours 10800 s; beforehand in the middle, √(120 · 10800) = 1138.4 s, ln 90 / √12 = 1.2990."""
    settle = forms("thermal_drift")["warming since the start", "time_s"]
    assert bounds(settle.nonlinear[0]) == (60.0, 21600.0, True)
    assert settle.nonlinear[0].usual == pytest.approx((1138.4200, 1.2989829))
    starts = [value for (value,) in settle.starts]
    assert len(starts) == 12
    assert (starts[0], starts[-1]) == pytest.approx((120.0, 10800.0))
    uneven = forms("thermal_drift")["warming since the start, unlike along the travel", "time_s"]
    assert uneven.starts == settle.starts[::2]
    lag = forms("thermal_expansion")["lagged temperature", "temp_screw_c"]
    plain = [forms("thermal_drift")["temperature", f"temp_{name}_c"].log_odds for name in ("screw", "head")]
    assert plain == pytest.approx([math.log(0.5)] * 2)  # it follows one of the two
    assert forms("thermal_drift", with_only("temp_screw_c"))["temperature", "temp_screw_c"].log_odds == 0.0
    assert lag.log_odds == pytest.approx(math.log(0.5))  # that the lag is free is paid by its grid
    three = with_only(
        "target_mm", "temp_screw_c", "temp_head_c", "temp_nut_c"
    )  # the screw is what grows: half of the prior
    grows = [forms("thermal_expansion", three)["temperature", f"temp_{name}_c"].log_odds for name in ("screw", "nut")]
    assert grows == pytest.approx([math.log(0.5), math.log(0.25)])
    drifts = forms("thermal_drift", three)["temperature", "temp_screw_c"].log_odds
    assert drifts == pytest.approx(math.log(1 / 3))
    assert lag.inputs == ("temp_screw_c", "time_s", "target_mm")
    assert bounds(lag.nonlinear[0]) == (60.0, 3600.0, True)
    starts = [value for (value,) in lag.starts]
    assert len(starts) == 6
    assert (starts[0], starts[-1]) == pytest.approx((60.0, 1800.0))
    dense = forms("thermal_drift", campaign(interval_s=1.0))  # 3600 / 60 = 60 s, and 3600 / 300 = 12 s for a lag
    assert dense["warming since the start", "time_s"].starts[0] == pytest.approx((60.0,))
    assert dense["lagged temperature", "temp_head_c"].starts[0] == pytest.approx((12.0,))
    sparse = forms("thermal_drift", campaign(interval_s=1000.0))  # 4000 s, and four times that rather than 10800 s
    assert sparse["warming since the start", "time_s"].starts[-1] == pytest.approx((16000.0,))
    assert sparse["lagged temperature", "temp_head_c"].nonlinear[0].lower == 2000.0


def test_zones_of_wear_take_at_most_a_third_of_the_travel() -> None:
    """Four widths of 16.7 mm are 66.7 of 200 mm; from half of that in five steps of 2^¼, centres one width apart."""
    bump = forms("local_wear")["bump", "target_mm"]
    centre, width = bump.nonlinear
    assert bounds(centre) == (100.0, 300.0, False)
    assert bounds(width) == (pytest.approx(100.0 / 24.0), pytest.approx(100.0 / 6.0), True)
    widest = [
        forms("local_wear")[f"{shape} bump", "target_mm"].nonlinear[1].upper for shape in ("flat", "fading", "rising")
    ]
    assert widest == pytest.approx([25.0, 100.0 / 3.0, 100.0 / 3.0])
    assert width.usual == pytest.approx((100.0 / 12, 0.7))
    widths = sorted({w for _, w in bump.starts})
    assert widths == pytest.approx([8.3333, 9.9101, 11.7851, 14.0149, 16.6667], rel=1e-5)
    assert [sum(w == one for _, w in bump.starts) for one in widths] == [25, 21, 18, 15, 13]
    assert min(c for c, _ in bump.starts) == 100.0
    assert max(c for c, _ in bump.starts) == 300.0
    assert sorted(c for c, w in bump.starts if w == widths[-1])[:2] == pytest.approx([100.0, 116.66667])
    sparse = forms("local_wear", campaign(spacing_mm=80.0))["bump", "target_mm"]
    assert min(w for _, w in sparse.starts) == pytest.approx(100.0 / 12.0)  # a twelfth of the half span
    dense = forms("local_wear", campaign(spacing_mm=8.0))["bump", "target_mm"]  # half the spacing, and half of that
    assert (min(w for _, w in dense.starts), dense.nonlinear[1].lower) == pytest.approx((4.0, 2.0))
    wear = EFFECTS["local_wear"]
    assert [wear.is_exceeded(bump, (150.0, w)) for w in (6.0, 15.0, 16.6)] == [False, False, True]


def test_periods_are_even_in_frequency_and_hold_the_usual_ones() -> None:
    """Half span 70.3: longest period 70.3 mm; lines 1 / 421.8 mm apart up to 1 / 0.5 mm: 843.6 - 6, so 837 of them."""
    survey = campaign(half_span_mm=70.3, pitches_mm=(7.3, 300.0))
    grid = [period for (period,) in period_grid(survey)]
    usual = {0.5, 1.0, 2.0, 2.5, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0}
    known = usual | {7.3, 7.3 / 2}  # 300 and 150 mm are longer than half the travel
    assert known <= set(grid)
    assert grid == sorted(grid)
    even = 1 / np.array(sorted(set(grid) - known, reverse=True))
    assert len(even) == 837
    assert even[0] == pytest.approx(1 / 70.3)
    assert np.diff(even) == pytest.approx(1 / 421.8)
    fundamental = forms("cyclic", survey)["fundamental", "target_mm"]
    assert fundamental.starts == period_grid(survey)
    assert bounds(fundamental.nonlinear[0]) == (0.25, pytest.approx(70.3), True)


def test_a_long_axis_has_as_many_lines_as_are_affordable_and_a_short_one_down_to_a_twentieth() -> None:
    """Half span 500.3: 1500 lines 1 / 3001.8 mm apart. Travel of 1.4 mm: (20 - 2)·3 = 54 lines from 0.7 to 0.07 mm, and 0.5 mm; as
    many on half a wavelength. Travel of 10 mm: from 5 to 0.5 mm, the shortest of long axes too.
    """
    grid = {period for (period,) in period_grid(campaign(half_span_mm=500.3))}
    assert len(grid) == 1500 + 15
    assert min(grid - {0.5, 1.0}) == pytest.approx(1 / (1 / 500.3 + 1499 / 3001.8))  # 1.9946 mm, below 2
    for half_span_mm, usual in ((0.7, 1), (158e-6, 0)):
        short = period_grid(campaign(half_span_mm=half_span_mm))
        assert len(short) in (53 + usual, 54 + usual)  # the last one by rounding
        assert min(short)[0] == pytest.approx(half_span_mm / 10.0, rel=0.06)
    assert min(period_grid(campaign(half_span_mm=5.0)))[0] == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize(
    ("period_nm", "order"), [(316.5, 1), (158.2, 2), (79.99, 4), (39.6, 8), (200.0, None), (35.2, None), (500.0, None)]
)
def test_a_period_of_the_laser_is_the_interferometers(period_nm: float, order: int | None) -> None:
    """Half a wavelength is 316.5 nm, a whole part of it the interferometer's own; 35.2 nm is order 9, 500 nm a grating."""
    form = Form("cyclic", "fundamental", ("target_mm",), {}, (NonLinear("period_mm", 1e-6, 1.0),))
    term = Term(EFFECTS["cyclic"], form, (period_nm * 1e-6,), (1.0, 0.0), tuple(map(tuple, 1e-16 * np.eye(3))))
    assert order_of_interference(term) == order
    assert EFFECTS["cyclic"].action_for(term) is (Action.COMPENSATE if order is None else Action.FIX_SETUP)
    assert (f"order {order} of half the wavelength" in EFFECTS["cyclic"].explain(term)) is (order is not None)


def test_what_an_effect_is_called_in_the_model_file_and_what_follows_from_it() -> None:
    """Static: a table measured after it appeared holds it already."""
    assert {e.id for e in ALL if e.static} == {
        "backlash",
        "backlash_position",
        "cosine",
        "cyclic",
        "local_wear",
        "pitch_shape",
    }
    assert {e.id for e in ALL if e.is_table} == {"pitch_shape"}
    assert {e.id for e in ALL if e.several} == {"cyclic", "datum_step", "local_wear"}
    assert {e.id: e.mean_of for e in ALL if e.mean_of} == {"backlash": "backlash_position"}
    assert {e.id for e in ALL if e.action is Action.FIX_SETUP} == {"air_index", "beam_drift", "cosine", "dead_path"}
    assert {e.id for e in ALL if e.action is Action.RE_MEASURE} == {"datum_step"}
    assert {e.id: e.log_odds for e in ALL if e.log_odds} == {"cosine": 0.5, "beam_drift": -2.0}


STRAIGHT = {"temperature", "lagged temperature", "warming since the start", "warming since the start through two lags"}
STRAIGHT_FORMS = {
    "abbe": {"tilt", "arm changing along the travel"},
    "air_index": {"air index"},
    "backlash": {"constant", "changing with temperature"},
    "backlash_position": {"linear"},
    "beam_drift": {"random walk", "flicker"},
    "cosine": {"scale"},
    "cross_axis": {
        "shift",
        "growing along the travel",
        "curved",
        "shift and growth",
        "curved and growing along the travel",
    },
    "cyclic": set(),
    "datum_step": {"step"},
    "dead_path": {"air index"},
    "load_deflection": {
        "offset",
        "with direction",
        "with position",
        "with direction and position",
        "from a stiff point",
        "offset and with direction and position",
        "curved",
        "curved with direction",
    },
    "local_wear": set(),
    "lost_motion": {"exponential", "tanh", "two lengths"},
    "pitch_shape": set(),  # a lead error is held beyond the travel
    "thermal_drift": STRAIGHT,
    "thermal_expansion": STRAIGHT | {f"{name}, about a fixed point" for name in STRAIGHT},
    "velocity_lag": {"proportional", "with square", "saturating"},
}
"""Forms whose error is a straight line over the place at any one moment: a stream asks for two places instead of all."""


@pytest.mark.parametrize("effect", EFFECTS)
def test_which_forms_are_straight_along_the_axis(effect: str) -> None:
    found = EFFECTS[effect].forms(campaign())
    assert {form.name for form in found if EFFECTS[effect].is_straight(form)} == STRAIGHT_FORMS[effect]


def test_odds_of_a_value_beforehand() -> None:
    """2e against a usual 2 with spread ½ in the logarithm: -½ (1 / ½)² = -2."""
    usual = NonLinear("width_mm", 0.1, 100.0, usual=(2.0, 0.5))
    assert usual.log_prior(2 * math.e) == pytest.approx(-2.0)
    assert usual.log_prior(2 / math.e) == pytest.approx(-2.0)
    assert usual.log_prior(2.0) == 0.0
    assert NonLinear("length_mm", 0.1, 100.0).log_prior(50.0) == 0.0
    assert NonLinear("length_mm", 0.1, 100.0).logarithmic
    plain = Form("backlash", "constant", ("direction",))
    assert (plain.scan, plain.exhaustive, plain.shrunk, plain.starts) == (True, False, False, ((),))
    assert not EFFECTS["lost_motion"].is_exceeded(plain, ())
    assert EFFECTS["backlash"].implausible(Term(EFFECTS["backlash"], plain, (), (9e9,), ((1.0,),))) is None


def test_facts_of_a_campaign_by_hand() -> None:
    """Targets 10 12 60 60 52 20: steps 2 48 0 8 32, so (8 + 32)/2 mm between distinct ones; times 5 … 105 s."""
    columns = {
        "run": np.array([1.0, 1, 1, 2, 2, 2]),
        "target_mm": np.array([10.0, 12, 60, 60, 52, 20]),
        "direction": np.array([1.0, 1, 1, -1, -1, -1]),
        "time_s": np.array([5.0, 15, 25, 75, 75, 105]),
        "load_kg": np.array([50.0] * 6),
        "temp_screw_c": np.array([20.0, 21, 22, 23, math.nan, 24]),
        "temp_head_c": np.array([20.0, 21, 22, 23, 24, 25]),
        "pos_y_mm": np.array([0.0, 100, 0, 100, 0, 100]),
    }
    found = survey_of(columns, pitches_mm=(10.0,))
    assert (found.rows, found.centre_mm, found.half_span_mm, found.spacing_mm) == (6, 35.0, 25.0, 20.0)
    assert (found.time_column, found.time_start, found.duration_s, found.time_unit) == ("time_s", 5.0, 100.0, "s")
    assert found.interval_s == 20.0  # median of 10, 10, 50 and 30 s
    assert found.moments == (10.0, 20.0, 50.0, 90.0)
    assert found.varying == {"run", "target_mm", "direction", "time_s", "temp_head_c", "pos_y_mm"}
    assert found.mean["load_kg"] == 50.0
    assert found.mean["temp_head_c"] == 22.5
    assert "temp_screw_c" not in found.mean
    assert found.ranges["temp_head_c"] == (20.0, 25.0)
    assert found.ranges["target_mm"] == (10.0, 60.0)
    assert "temp_screw_c" not in found.ranges
    assert found.temperatures == ("temp_head_c",)
    assert found.other_axes == ("pos_y_mm",)
    assert found.pitches_mm == (10.0,)
    assert found.has("target_mm", "pos_y_mm")
    assert not found.has("target_mm", "load_kg")


@pytest.mark.parametrize(("small_mm", "spacing_mm"), [(0.0026, 25.0), (0.0024, 49.9976)])
def test_which_targets_are_distinct(small_mm: float, spacing_mm: float) -> None:
    """A step of more than 1e-4 of the half span, 25 mm: 2.5 µm."""
    columns = {name: np.zeros(3) for name in ("run", "direction", "row_order")}
    found = survey_of(columns | {"target_mm": np.array([10.0, 10.0 + small_mm, 60.0])})
    assert found.spacing_mm == pytest.approx(spacing_mm)


def test_facts_of_a_single_place() -> None:
    columns = {name: np.zeros(2) for name in ("run", "target_mm", "direction", "row_order")}
    found = survey_of(columns)
    assert (found.half_span_mm, found.duration_s, found.interval_s) == (1e-6, 1e-6, 1.0)
    assert found.spacing_mm == found.half_span_mm
    assert found.time_unit == "rows"
    assert found.moments == ()


def test_what_varies() -> None:
    """More than 1e-9 of its size, or of 1 for small values."""
    assert varies(np.array([1.0, 1.0 + 2e-9]))
    assert not varies(np.array([1.0, 1.0 + 0.5e-9]))
    assert varies(np.array([0.0, 2e-9]))
    assert not varies(np.array([0.0, 0.5e-9]))
    assert varies(np.array([1e6, 1e6 + 2e-3]))
    assert not varies(np.array([-1e6, -1e6 + 0.5e-3]))
    assert not varies(np.array([1.0, math.nan]))


def ways() -> dict[str, np.ndarray]:
    """26 ways to a target, each gone twice: half of them up, half down, with 0 to 100 mm since the reversal."""
    each = np.arange(26)
    once = {
        "run": np.ones(26),
        "direction": np.where(each % 2 == 0, 1.0, -1.0),
        "target_mm": (7.0 * each) % 26 * 10.0,
        "since_reversal_mm": np.r_[0.0, np.geomspace(0.01, 100.0, 25)][(11 * each) % 26],
        "stroke_mm": np.full(26, 300.0),
        "row_order": 1.0 * each,
    }
    return {name: np.tile(values, 2) for name, values in once.items()}


NOISE = np.repeat([1.0, -1.0], 26)
"""Opposite in the two times of each way, so that no function of the way holds any of it."""


@pytest.mark.parametrize(("noise", "follows"), [(0.0, True), (0.43, True), (0.44, False), (5.0, False)])
def test_a_reading_follows_the_way_up_to_a_hundredth_of_its_variance(noise: float, follows: bool) -> None:
    """20 ± 5 with the direction has the variance 25 + e²; of 52 rows and 13 coefficients 52/39·e² is left.

    4/3·0.43² = 0.2465 is below 0.2518, a hundredth of 25.185; 4/3·0.44² = 0.2581 is above 0.2519. A load is a cause all the same.
    """
    columns = ways()
    torque = 20.0 + 5.0 * columns["direction"] + noise * NOISE
    assert follows_way(torque, columns) is follows
    found = survey_of(columns | {"torque_percent": torque, "motor_mm": torque, "load_kg": torque}).varying
    assert ("torque_percent" in found, "motor_mm" in found, "load_kg" in found) == (not follows, not follows, True)


def test_the_way_is_target_and_travel_since_the_reversal_in_each_direction() -> None:
    """2 + 0.03 x + (1 + 2 d) ln s, s at least 1 µm: straight over the logarithm, so five pieces hold it. With x² it is none."""
    columns = ways()
    x, d, s = (columns[name] for name in ("target_mm", "direction", "since_reversal_mm"))
    since = np.log(np.maximum(s, 0.001))
    assert follows_way(2.0 + 0.03 * x + (1.0 + 2.0 * d) * since, columns)
    assert follows_way((1.0 + 2.0 * d) * since, columns)
    assert not follows_way((x - 125.0) ** 2, columns)


def test_as_many_coefficients_as_rows_follow_nothing() -> None:
    """One of the target and six nodes of the travel, twice: thirteen rows would be met exactly, whatever they hold."""
    columns = {name: values[:13] for name, values in ways().items()}
    assert not follows_way(20.0 + 5.0 * columns["direction"], columns)
    columns = {name: values[:7] for name, values in ways().items()}
    assert not follows_way(20.0 + 5.0 * columns["direction"], columns)


def test_in_a_long_campaign_moments_are_thinned_but_no_boundary_of_runs_is_lost() -> None:
    """1501 rows have 1500 intervals: every third is kept; runs change between rows 500 and 501, 1000 and 1001."""
    rows = 1501
    columns = {name: np.zeros(rows) for name in ("target_mm", "direction")}
    columns |= {"time_s": np.arange(rows) * 1.0, "run": 1.0 + (np.arange(rows) > 500) + (np.arange(rows) > 1000)}
    thinned = {3.0 * k + 0.5 for k in range(500)}
    assert set(survey_of(columns).moments) == thinned | {500.5, 1000.5}
    fewer = {name: values[:501] for name, values in columns.items()}
    assert len(survey_of(fewer).moments) == 500


def test_rows_stand_in_for_time() -> None:
    """(run - 1) · rows of that run + row within it; runs of 3, 2 and 3 rows, the third read with the others or alone."""
    run = np.array([1.0, 1, 1, 2, 2, 3, 3, 3])
    assert row_order(run).tolist() == [0, 1, 2, 2, 3, 6, 7, 8]
    assert row_order(run[5:]).tolist() == [6, 7, 8]
    assert row_order(np.array([1.0, 2, 1, 2])).tolist() == [0, 2, 1, 3]


def test_travel_since_the_reversal_and_the_stroke_before_it() -> None:
    """0 → 10 → 30 up; back to 25, 5: 5, 25 mm since, stroke 30 before; up to 8: 3 mm, stroke 25."""
    target = np.array([0.0, 10, 30, 25, 5, 8])
    direction = np.array([1.0, 1, 1, -1, -1, 1])
    since, stroke = reversals(target, direction)
    assert since.tolist() == [0, 10, 30, 5, 25, 3]
    assert stroke.tolist() == [1e6] * 3 + [30, 30, 25]
    assert [part.tolist() for part in reversals(np.zeros(0), np.zeros(0))] == [[], []]
    assert [part.tolist() for part in reversals(np.ones(1), np.ones(1))] == [[0.0], [1e6]]


def test_missing_columns_are_made_up_and_given_ones_kept() -> None:
    bare = {
        "run": np.array([1.0, 1, 1]),
        "target_mm": np.array([0.0, 10, 4]),
        "direction": np.array([1.0, 1, -1]),
    }
    full = complete(bare)
    assert full["command_mm"].tolist() == [0, 10, 4]
    assert full["row_order"].tolist() == [0, 1, 2]
    assert full["since_reversal_mm"].tolist() == [0, 10, 6]
    assert full["stroke_mm"].tolist() == [1e6, 1e6, 10]
    assert set(bare) == {"run", "target_mm", "direction"}  # what was given is not touched
    assert time_column(full) == "row_order"
    assert stand_ins(bare) == ("time_s", "since_reversal_mm", "stroke_mm")
    given = {
        "since_reversal_mm": np.array([7.0, 8, 9]),
        "stroke_mm": np.array([1.0, math.nan, 3]),
        "command_mm": np.ones(3),
        "row_order": np.array([5.0, 6, 7]),
        "time_s": np.array([1.0, 2, 3]),
    }
    full = complete(bare | given)
    assert full["since_reversal_mm"].tolist() == [7, 8, 9]
    assert full["stroke_mm"].tolist() == [1e6, 1e6, 10]  # one was empty
    assert full["command_mm"].tolist() == [1, 1, 1]
    assert full["row_order"].tolist() == [5, 6, 7]
    assert time_column(full) == "time_s"
    assert stand_ins(full) == ()
    stroke = {"stroke_mm": np.array([1.0, 2, 3]), "since_reversal_mm": np.array([1.0, math.nan, 3])}
    assert complete(bare | stroke)["since_reversal_mm"].tolist() == [0, 10, 6]
    assert complete(bare | {"stroke_mm": np.array([1.0, 2, 3])})["stroke_mm"].tolist() == [1, 2, 3]
    assert complete(bare | {"since_reversal_mm": np.array([1.0, math.nan, 3])})["since_reversal_mm"].tolist() == [
        0,
        10,
        6,
    ]


def plain_term() -> dict[str, object]:
    form = Form(
        "lost_motion", "exponential", ("since_reversal_mm", "direction"), {}, (NonLinear("length_mm", 0.1, 9.0),)
    )
    return Term(EFFECTS["lost_motion"], form, (3.0,), (5.0,), ((0.01, 0.0), (0.0, 0.04))).to_json()


def test_a_term_in_plain_values() -> None:
    assert plain_term() == {
        "effect": "lost_motion",
        "form": "exponential",
        "inputs": ["since_reversal_mm", "direction"],
        "constants": {},
        "nonlinear": {"length_mm": 3.0},
        "coefficients": [5.0],
        "covariance": [[0.01, 0.0], [0.0, 0.04]],
    }
    read = term_from_json(json.loads(json.dumps(plain_term())), ALL, "terms[0]")
    assert (read.theta, read.coefficients, read.nonlinear(0)) == ((3.0,), (5.0,), Estimate(3.0, 0.2))
    assert str(read.nonlinear(0)) == "3 ± 0.4"
    assert read.error_um({"since_reversal_mm": np.array([3.0]), "direction": np.array([-1.0])})[0] == pytest.approx(
        -1.839397
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"inputs": [1, 2]}, "inputs"),
        ({"inputs": ["direction", 2]}, "inputs"),
        ({"covariance": "none"}, "not 2 × 2"),
        ({"covariance": [[1.0, 0.0]]}, "not 2 × 2"),
        ({"covariance": [[1.0, 0.0], [1.0]]}, "not 2 × 2"),
        ({"covariance": [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]}, "not 2 × 2"),
        ({"coefficients": 1.0}, "not a list"),
        ({"coefficients": [True]}, "finite"),
        ({"coefficients": ["1"]}, "finite"),
        ({"coefficients": [math.nan]}, "finite"),
        ({"nonlinear": [3.0]}, "not an object"),
        ({"nonlinear": {"length_mm": math.inf}}, "finite"),
        ({"constants": None}, "not an object"),
        ({"coefficients": [1.0, 2.0], "covariance": [[0.0] * 3] * 3}, "2 coefficients, form 'exponential' has 1"),
    ],
)
def test_plain_values_that_are_no_term_are_refused(change: Mapping[str, object], said: str) -> None:
    with pytest.raises(InputError, match=rf"terms\[0\].*{said}"):
        term_from_json({**plain_term(), **change}, ALL, "terms[0]")
    with pytest.raises(InputError, match="is not an object"):
        term_from_json([plain_term()], ALL, "terms[0]")
