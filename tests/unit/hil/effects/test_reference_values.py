"""Every effect against numbers from outside: hand-computed rows, published coefficients, a calculator's printed table.

Rows are x, d, v, … as columns; what is expected stands beside its arithmetic and uses no constant of the code.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest

from drivers.errors import InputError
from hil.effects import ALL, Estimate, Form, Term
from hil.effects.air import refractivity_ppm
from hil.effects.base import NonLinear, slopes_of
from hil.effects.cyclic import parts_that_turn
from hil.effects.history import BRANCH, lagged, with_branches

EFFECTS = {effect.id: effect for effect in ALL}
TRAVEL = {"centre_mm": 200.0, "half_span_mm": 100.0}
"""u = (x - 200) / 100."""
UNEVEN = "warming since the start, unlike along the travel"


def basis(
    effect: str,
    form: str,
    columns: Mapping[str, Sequence[float]],
    theta: Sequence[float] = (),
    constants: Mapping[str, float] | None = None,
) -> list[list[float]]:
    """The design matrix of a form whose inputs are the columns given, in their order."""
    what = Form(effect, form, tuple(columns), constants or {})
    given = {name: np.array(values, dtype=np.float64) for name, values in columns.items()}
    rows: list[list[float]] = EFFECTS[effect].basis(what, theta, given).tolist()
    return rows


LEAST, MOST = 0.01, 10_000.0
"""Range in which the non-linear parameters were searched."""


def term(
    effect: str,
    form: str,
    inputs: Sequence[str],
    coefficients: Sequence[float],
    theta: Sequence[float] = (),
    *,
    constants: Mapping[str, float] | None = None,
    stds: Sequence[float] = (),
) -> Term:
    """A fitted term with the given standard uncertainties of coefficients and theta, uncorrelated."""
    stds = stds or [0.1 * (i + 1) for i in range(len(coefficients) + len(theta))]
    covariance = tuple(tuple(s * s if i == j else 0.0 for j in range(len(stds))) for i, s in enumerate(stds))
    searched = tuple(NonLinear(f"parameter_{i}", LEAST, MOST) for i in range(len(theta)))
    what = Form(effect, form, tuple(inputs), constants or {}, searched)
    return Term(EFFECTS[effect], what, tuple(theta), tuple(coefficients), covariance)


def values(found: Mapping[str, Estimate]) -> dict[str, tuple[float, float]]:
    return {name: (round(one.value, 9), round(one.std, 9)) for name, one in found.items()}


@pytest.mark.parametrize(
    ("temp_c", "pressure_hpa", "humidity", "ppm", "within"),
    [
        # NIST Engineering Metrology Toolbox, printed values of its modified Edlén calculator at 633 nm: 1.000271799 and so on.
        (20.0, 1013.25, 0.0, 271.799, 0.002),
        (20.0, 600.0, 0.0, 160.920, 0.002),
        (20.0, 1200.0, 0.0, 321.918, 0.002),
        (50.0, 1000.0, 0.0, 243.270, 0.002),
        (5.0, 1000.0, 0.0, 282.750, 0.002),
        (20.0, 1000.0, 100.0, 267.394, 0.002),
    ],
)
def test_air_as_nist_prints_it(temp_c: float, pressure_hpa: float, humidity: float, ppm: float, within: float) -> None:
    found = refractivity_ppm(np.array([temp_c]), np.array([pressure_hpa]), np.array([humidity]))
    assert found[0] == pytest.approx(ppm, abs=within)


@pytest.mark.parametrize(
    ("temp_c", "pascal"),
    # saturation pressure of water in the steam tables (IAPWS): 0.6112, 2.3392, 5.629 kPa
    [(0.0, 611.2), (20.0, 2339.2), (35.0, 5629.0)],
)
def test_vapour_term_of_birch_and_downs(temp_c: float, pascal: float) -> None:
    """Δn = -p_v · (3.7345 - 0.0401 / λ²) · 1e-10: 1 / 0.6329912² = 2.49577, so 3.63442e-10 per Pa, 3.63442e-4 ppm.

    NIST's form scales it from 292.75 K, where Birch and Downs measured, to the temperature of the air.
    """
    t, p = np.array([temp_c]), np.array([1013.25])
    wet, dry = refractivity_ppm(t, p, np.array([60.0])), refractivity_ppm(t, p, np.array([0.0]))
    assert wet[0] - dry[0] == pytest.approx(-0.60 * pascal * 3.63442e-4 * 292.75 / (temp_c + 273.15), rel=2e-4)


def test_the_temperature_coefficient_of_the_density() -> None:
    """0.601 - 0.00972 t of Birch and Downs: at 1e5 Pa and 50 °C (1 + 1e-3 · 0.115) against (1 + 1e-3 · 0.601) at 0 °C."""
    p, dry = np.array([1000.0]), np.array([0.0])
    warm, cold = (refractivity_ppm(np.array([t]), p, dry)[0] for t in (50.0, 0.0))
    assert warm / cold == pytest.approx((1.000115 / 1.000601) / 1.18305, rel=1e-7)


AIR = {"air_temp_c": 20.0, "air_pressure_hpa": 1013.25, "air_humidity_percent": 0.0}


@pytest.mark.parametrize(
    ("name", "value", "excess"), [("air_pressure_hpa", 1200.0, 50.119), ("air_pressure_hpa", 600.0, -110.879)]
)
def test_air_effects_are_the_excess_times_a_length(name: str, value: float, excess: float) -> None:
    """From NIST's table at 0 %: 321.918 - 271.799 ppm; standard air is at 50 %, 0.424 ppm lower.

    Half of 2332.6 Pa · 3.63442e-4 ppm/Pa = 0.42388 ppm.
    """
    excess += 0.42388
    others = {key: v for key, v in AIR.items() if key != name}
    columns = {name: [value, value], "target_mm": [400.0, -100.0]}
    rows = basis("air_index", "air index", columns, constants=others)
    assert rows == [[pytest.approx(0.4 * excess, abs=2e-3)], [pytest.approx(-0.1 * excess, abs=2e-3)]]
    dead = basis("dead_path", "air index", {name: [value]}, constants=others)
    assert dead == [[pytest.approx(excess * 1e-3, abs=3e-6)]]  # µm per mm of dead path
    assert basis("dead_path", "air index", {name: [1013.25]}, constants=others | {"air_humidity_percent": 50.0}) == [
        [0.0]
    ]


def test_cosine_reads_short() -> None:
    """ppm of x: at 300 mm one ppm is 0.3 µm too short; after the realignment (setup 2) nothing."""
    assert basis("cosine", "scale", {"target_mm": [300.0, -100.0]}) == [[pytest.approx(-0.3)], [pytest.approx(0.1)]]
    columns = {"target_mm": [300.0, 300.0, 300.0], "setup": [1.0, 2.0, 3.0]}
    assert basis("cosine", "scale, gone since the realignment", columns) == [[pytest.approx(-0.3)], [0.0], [0.0]]


def test_cosine_error_of_one_milliradian_is_half_a_ppm() -> None:
    """θ²/2: 1 mrad gives 0.5 ppm; its uncertainty dθ = dscale/θ = 0.01e-6 / 1e-3 rad = 10 µrad."""
    found = term("cosine", "scale", ["target_mm"], [0.5], stds=[0.01])
    assert values(found.parameters) == {"scale_ppm": (0.5, 0.01), "angle_urad": (1000.0, 10.0)}
    assert EFFECTS["cosine"].implausible(found) is None
    long = term("cosine", "scale", ["target_mm"], [-0.5], stds=[0.01])
    assert values(long.parameters) == {"scale_ppm": (-0.5, 0.01), "most_angle_urad": (0.0, 0.0)}
    doubtful = term("cosine", "scale", ["target_mm"], [0.3], stds=[0.1 + 1e-9])
    assert values(doubtful.parameters)["angle_urad"] == pytest.approx((774.597, 129.099), rel=1e-5)
    for std, known in ((0.145, True), (0.155, False)):  # a scale of two standard deviations or more has an angle
        edge = term("cosine", "scale", ["target_mm"], [0.3], stds=[std])
        assert ("angle_urad" in edge.parameters) is known
    small = term("cosine", "scale", ["target_mm"], [0.1], stds=[0.2])  # θ² = 2·(0.1 + 2·0.2) ppm at most
    assert values(small.parameters) == {"scale_ppm": (0.1, 0.2), "most_angle_urad": (1000.0, 0.0)}
    assert "at most 1e+03 µrad" in small.effect.explain(small)
    assert "never long" in str(EFFECTS["cosine"].implausible(long))
    assert "lead error" in long.effect.explain(long)
    gone = term("cosine", "scale, gone since the realignment", ["target_mm", "setup"], [0.5], stds=[0.01])
    assert "took that away" in gone.effect.explain(gone)


def test_backlash_is_twice_the_coefficient_of_the_direction() -> None:
    """Forward 2 µm over the middle and backward 2 µm under it: 4 µm of backlash, twice the uncertainty."""
    assert basis("backlash", "constant", {"direction": [1.0, -1.0]}) == [[1.0], [-1.0]]
    found = term("backlash", "constant", ["direction"], [2.0], stds=[0.25])
    assert values(found.parameters) == {"backlash_um": (4.0, 0.5)}
    assert "differ by 4 ± 1 µm" in found.effect.explain(found)


def test_backlash_along_the_travel() -> None:
    """u = 0.5 at 250 mm; from u = -1 to 1 the directions' difference 2·c·u changes by 4 c; at the ends the bow adds 2 c."""
    columns = {"target_mm": [250.0, 150.0, 300.0], "direction": [1.0, 1.0, -1.0]}
    assert basis("backlash_position", "linear", columns, constants=TRAVEL) == [[0.5], [-0.5], [-1.0]]
    assert basis("backlash_position", "quadratic", columns, constants=TRAVEL) == [
        [0.5, 0.25],
        [-0.5, 0.25],
        [-1.0, -1.0],
    ]
    line = term("backlash_position", "linear", list(columns), [1.5], stds=[0.1])
    assert values(line.parameters) == {"change_um": (6.0, 0.4)}
    assert "changes by 6 ± 0.8 µm" in line.effect.explain(line)
    assert "bowed" not in line.effect.explain(line)
    bowed = term("backlash_position", "quadratic", list(columns), [1.5, -1.0], stds=[0.1, 0.2])
    assert values(bowed.parameters) == {"change_um": (6.0, 0.4), "bow_um": (-2.0, 0.4)}
    assert "changes by 6 ± 0.8 µm" in bowed.effect.explain(bowed)
    assert "bowed by -2 ± 0.8 µm" in bowed.effect.explain(bowed)


def test_backlash_along_the_travel_in_a_shape_of_its_own() -> None:
    """d·P_k(u), k from 1; beyond the travel u is held at 1.1; from end to end the odd orders change by 2, both ways: 4·(1 + 3 + 5)."""
    known = [0.5, -0.125, -0.4375, -0.2890625, 0.08984375, 0.3232421875]  # of u = 0.5
    columns = {"target_mm": [250.0, 250.0, 900.0, -900.0], "direction": [1.0, -1.0, 1.0, 1.0]}
    rows = basis("backlash_position", "shape", columns, constants=TRAVEL)
    assert rows[:2] == [pytest.approx(known), pytest.approx([-p for p in known])]
    assert [row[:2] for row in rows[2:]] == [
        pytest.approx([1.1, 1.315]),
        pytest.approx([-1.1, 1.315]),
    ]  # (3·1.21 - 1)/2
    fine = basis("backlash_position", "fine shape", columns, constants=TRAVEL)
    assert fine[0][:6] == pytest.approx(known)
    assert len(fine[0]) == 12
    found = term("backlash_position", "shape", list(columns), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    unsure = round(4.0 * math.sqrt(0.1**2 + 0.3**2 + 0.5**2), 9)
    assert values(found.parameters) == {"change_um": (36.0, unsure)}
    assert "changes by 36 ± 4.7 µm" in found.effect.explain(found)
    broken = replace(
        found, covariance=tuple(map(tuple, (-np.eye(6)).tolist()))
    )  # a variance that rounding made negative
    assert broken.parameters["change_um"] == Estimate(36.0, 0.0)


def test_lost_motion_fades_with_the_travel_since_the_reversal() -> None:
    """e^-1 = 0.36788, 1 - tanh(1) = 1 - 0.76159, e^-2 = 0.13534; with the direction."""
    columns = {"since_reversal_mm": [0.0, 3.0, 6.0], "direction": [1.0, -1.0, 1.0]}
    e1, e2 = 0.36787944, 0.13533528
    assert basis("lost_motion", "exponential", columns, (3.0,)) == [[1.0], [pytest.approx(-e1)], [pytest.approx(e2)]]
    assert basis("lost_motion", "tanh", columns, (3.0,)) == [
        [1.0],
        [pytest.approx(-0.23840584)],
        [pytest.approx(0.03597242)],  # 1 - tanh(2) = 1 - 0.96402758
    ]
    both = basis("lost_motion", "two lengths", columns, (3.0, 6.0))
    assert both == [[1.0, 1.0], pytest.approx([-e1, -0.60653066]), pytest.approx([e2, e1])]
    found = term("lost_motion", "two lengths", list(columns), [5.0, -1.0], (3.0, 6.0))
    assert values(found.parameters) == {  # of the amounts 5 ± 0.1 and -1 ± 0.2 the sum
        "amount_um": (4.0, pytest.approx(0.2236068)),
        "length_mm": (3.0, 0.3),
        "second_length_mm": (6.0, 0.4),
    }
    assert "off by 4 ± 0.45 µm" in found.effect.explain(found)
    assert "over 3 ± 0.6 mm" in found.effect.explain(found)
    remembered = {**columns, "stroke_mm": [1e6, 6.0, 3.0]}
    name = "exponential, short strokes remembered"
    assert basis("lost_motion", name, remembered, (3.0,)) == [[1.0], [pytest.approx(-(e1 - e2))], [0.0]]
    single = term("lost_motion", "tanh", list(columns), [5.0], (3.0,))
    assert values(single.parameters) == {"amount_um": (5.0, 0.1), "length_mm": (3.0, 0.2)}


@pytest.mark.parametrize("exponent", [-0.5, 0.5, 1.0, 2.0, 3.0])
def test_lost_motion_of_dahls_model_solves_its_equation(exponent: float) -> None:
    """dF/ds = (1 - F)^n / L from F = 0, in small steps up to where it ends or three lengths; the strokes before were long."""
    length, steps = 4.0, 30_000
    step, left, solved = 3.0 * length / steps, 1.0, []
    for _ in range(steps):
        half = max(left - 0.5 * step / length * left**exponent, 0.0) if left > 1e-3 else 0.0
        left = max(left - step / length * half**exponent, 0.0) if half > 1e-3 else 0.0
        solved.append(left)
    travel = step * np.arange(1, steps + 1)[::500]
    long = dict.fromkeys(BRANCH[1:], np.full(len(travel), 1e6))
    columns = {"since_reversal_mm": travel, "direction": np.ones(len(travel)), BRANCH[0]: travel, **long}
    shape = EFFECTS["lost_motion"].basis(
        Form("lost_motion", "Dahl, strokes remembered", ()), (length, exponent), columns
    )[:, 0]
    assert shape == pytest.approx(solved[::500], abs=0.003)


def test_dahls_exponent_is_a_parameter_whose_slope_goes_through_1_smoothly() -> None:
    """At n = 1 the derivative of e^(-z) to n is ½ z² e^(-z)."""
    travel = np.linspace(0.5, 12.0, 30)
    long = dict.fromkeys(BRANCH[1:], np.full(len(travel), 1e6))
    columns = {"since_reversal_mm": travel, "direction": np.ones(len(travel)), BRANCH[0]: travel, **long}
    z = travel / 4.0
    for exponent in (1.0 - 2e-6, 1.0, 1.0 + 1e-7, 1.0001):
        found = term("lost_motion", "Dahl, strokes remembered", list(columns), [10.0], (4.0, exponent))
        slope = slopes_of(columns, found, np.array([10.0]))[:, 1]
        assert slope == pytest.approx(5.0 * z**2 * np.exp(-z), abs=0.02)
        assert found.parameters["exponent"].value == exponent


def test_nearer_to_a_reversal_than_any_row_was_no_more_is_claimed_than_three_times_what_was_seen() -> None:
    """A length of 1.5 mm from rows at 6 mm and more would make e^4 times what they have."""
    columns = {"since_reversal_mm": np.array([0.0, 3.0, 5.5, 6.0, 7.5]), "direction": np.ones(5)}
    form = Form("lost_motion", "exponential", ("since_reversal_mm", "direction"), {"shortest_mm": 6.0})
    shape = EFFECTS["lost_motion"].basis(form, (1.5,), columns)[:, 0]
    seen = math.exp(-4.0)
    assert shape == pytest.approx([3.0 * seen, 3.0 * seen, math.exp(-5.5 / 1.5), seen, math.exp(-5.0)])


def test_short_strokes_are_remembered_as_a_stack_of_elements_that_stick_and_slip_does() -> None:
    """Elements that follow the path elastically and slip at ± half their widths, with weights whose sum rises as 1 - e^(-s/3)."""
    length, edges = 3.0, np.linspace(0.0, 40.0, 4001)
    slopes = np.diff(1.0 - np.exp(-edges / length)) / np.diff(edges)
    weights, widths = slopes - np.append(slopes[1:], 0.0), edges[1:]
    held, force, before = -widths / 2.0, [], 0.0
    turns = [(60.0, 1.0), (58.0, -1.0), (63.0, 1.0), (20.0, -1.0)]  # strokes of 60, 2, 5, 43 mm from a long one
    rows = []
    for turn, direction in turns:
        stroke = abs(turn - before)
        for travel in np.linspace(0.0, stroke, 21)[1:]:
            place = before + direction * travel
            rows.append((travel, direction, place))
        before = turn
    here = 0.0
    for _, _, place in rows:
        held = np.clip(held + place - here, -widths / 2.0, widths / 2.0)
        force.append(float(weights @ held))
        here = place
    travel, direction, _ = np.array(rows).T
    before_it = np.repeat([1e6, 60.0, 2.0, 5.0], 20)
    wound = float(weights @ widths) / 2.0
    lag = direction * wound - np.array(force)  # what is not wound up yet, of which all is 2 wound
    columns = {"since_reversal_mm": travel, "direction": direction, "stroke_mm": before_it}
    shape = basis("lost_motion", "exponential, short strokes remembered", columns, (length,))
    first_three = slice(0, 60)  # the fourth turns inside a loop that the third has closed
    assert np.array(shape)[first_three, 0] * 2.0 * wound == pytest.approx(lag[first_three], abs=0.004)


@pytest.mark.parametrize(
    "each", [1, 20, 33]
)  # rows of the path that are recorded: all, one a stroke, some strokes without any
def test_strokes_within_strokes_are_remembered_as_a_stack_of_elements_does(each: int) -> None:
    """Judged by elements that stick and slip, on forty strokes of 0.3 to 60 mm, nested as chance has it."""
    length, edges = 3.0, np.linspace(0.0, 60.0, 6001)
    slopes = np.diff(1.0 - np.exp(-edges / length)) / np.diff(edges)
    weights, widths = slopes - np.append(slopes[1:], 0.0), edges[1:]
    wound = float(weights @ widths) / 2.0
    rng = np.random.default_rng(3)
    strokes = [1e6, 200.0, *np.exp(rng.uniform(np.log(0.3), np.log(60.0), 40))]
    held, here, rows = -widths / 2.0, 0.0, []
    for before, stroke, direction in zip(strokes, strokes[1:], cycle((1.0, -1.0))):
        for travel in np.linspace(0.0, stroke, 21)[1:]:
            place = here + direction * stroke / 20.0
            held = np.clip(held + place - here, -widths / 2.0, widths / 2.0)
            here = place
            rows.append((travel, direction, before, here, direction * wound - float(weights @ held)))
    *recorded, lag = np.array(rows)[each - 1 :: each].T
    columns = dict(zip(("since_reversal_mm", "direction", "stroke_mm", "target_mm"), recorded, strict=True))
    shape = np.array(basis("lost_motion", "exponential, strokes remembered", columns, (length,)))[:, 0]
    assert len(shape) > 20
    assert shape * 2.0 * wound == pytest.approx(lag, abs=0.01 * 2.0 * wound)
    last = np.array(basis("lost_motion", "exponential, short strokes remembered", columns, (length,)))[:, 0]
    assert np.max(np.abs(last * 2.0 * wound - lag)) > 0.1 * 2.0 * wound, "the stroke before alone is not enough here"


def test_the_way_between_two_rows_that_do_not_join_is_taken_for_a_long_stroke() -> None:
    """Reversals at 10, 40 and 30 mm, the last two once more without a row; then a row whose last two are nowhere near."""
    columns = {
        "target_mm": [20.0, 35.0, 33.0, 80.0],
        "direction": [1.0, 1.0, 1.0, -1.0],
        "since_reversal_mm": [10.0, 5.0, 3.0, 4.0],
        "stroke_mm": [1e6, 10.0, 10.0, 6.0],
    }
    found = with_branches({name: np.array(values) for name, values in columns.items()})
    strokes = np.column_stack([found[name] for name in BRANCH]).tolist()
    assert strokes == [[10.0, 1e6, 1e6, 1e6], [5.0, 10.0, 30.0, 1e6], [3.0, 10.0, 30.0, 1e6], [4.0, 6.0, 1e6, 1e6]]


UP = (100.0, 1.0, 100.0, 1e6)
"""From 0 to 100 mm, after a long stroke: place, direction, travel since the reversal, stroke before it."""
NESTED = [UP, (20.0, -1.0, 80.0, 100.0), (40.0, 1.0, 20.0, 80.0)]
"""Back to 20, up to 40: three reversals that are remembered, at 0, 100 and 20 mm."""


@pytest.mark.parametrize(
    ("rows", "strokes"),
    [
        (NESTED, [20.0, 80.0, 100.0, 1e6]),
        # back to 30 and up to 45: past 40, where the loop of 10 mm closes; the row once more changes nothing
        ([*NESTED, (30.0, -1.0, 10.0, 20.0), (45.0, 1.0, 15.0, 10.0)], [25.0, 80.0, 100.0, 1e6]),
        ([*NESTED, (30.0, -1.0, 10.0, 20.0), *[(45.0, 1.0, 15.0, 10.0)] * 2], [25.0, 80.0, 100.0, 1e6]),
        # from 40, where it stood, back to 30 and up to 35 without a row between
        ([*NESTED, (35.0, 1.0, 5.0, 10.0)], [5.0, 10.0, 20.0, 80.0]),
        # back from 100 like the second row, but after a stroke from -30: not the one before, so nothing else is known
        ([UP, (20.0, -1.0, 80.0, 130.0), (40.0, 1.0, 20.0, 80.0)], [20.0, 80.0, 130.0, 1e6]),
        # 6 mm back and on again, then 5 mm on, 11 back and 6 on: twice at one place from one reversal, and not the same way
        ([UP, (100.0, 1.0, 6.0, 6.0), (100.0, 1.0, 6.0, 11.0)], [6.0, 11.0, 105.0, 1e6]),
        # past 70, where that stroke of 30 began: nothing is remembered any more
        ([(100.0, 1.0, 50.0, 1e6), (20.0, -1.0, 80.0, 30.0)], [1e6] * 4),
    ],
)
def test_reversals_that_are_remembered_from_row_to_row(
    rows: list[tuple[float, float, float, float]], strokes: list[float]
) -> None:
    names = ("target_mm", "direction", "since_reversal_mm", "stroke_mm")
    given = dict(zip(names, np.array(rows).T, strict=True))
    found = with_branches(given)
    assert [float(found[name][-1]) for name in BRANCH] == strokes
    one = with_branches({**given, BRANCH[0]: np.zeros(len(rows))})  # one alone is not enough: all four are made up
    assert [float(one[name][-1]) for name in BRANCH] == strokes
    stored = {name: np.full(len(rows), 7.0) for name in BRANCH}
    assert with_branches(stored) == stored


def test_a_lost_motion_is_stated_where_rows_saw_it() -> None:
    """Rows from 3 mm after the reversal on see e^-1 of it: 5 µm there are 1.839, with dL/L = 0.1 another 0.1·e^-1·5 of uncertainty."""
    far = term(
        "lost_motion",
        "exponential",
        ["since_reversal_mm", "direction"],
        [5.0],
        (3.0,),
        constants={"shortest_mm": 3.0},
        stds=[0.1, 0.3],
    )
    unsure = math.hypot(0.1, 5.0 * 0.1) * 0.36787944
    assert values(far.parameters) == {
        "amount_at_shortest_travel_um": (pytest.approx(1.8393972), pytest.approx(unsure, rel=1e-5)),
        "shortest_travel_mm": (3.0, 0.0),
        "length_mm": (3.0, 0.3),
    }
    assert "3 mm after it, the table is off by 1.839" in far.effect.explain(far)
    near = term(
        "lost_motion", "exponential", ["since_reversal_mm", "direction"], [5.0], (3.0,), constants={"shortest_mm": 0.3}
    )
    assert set(near.parameters) == {"amount_um", "length_mm"}, "e^-0.1 is 0.905: a tenth is extrapolated"


def test_a_positive_parameter_that_is_not_determined_is_given_as_its_bounds() -> None:
    """3 ± 3: the logarithm is ± 1, and two of that are a factor of e² = 7.389 either way, as far as was searched."""
    inputs = ["since_reversal_mm", "direction"]
    vague = term("lost_motion", "exponential", inputs, [5.0], (3.0,), stds=[0.1, 3.0])
    assert values(vague.parameters) == {
        "amount_um": (5.0, 0.1),
        "least_length_mm": (pytest.approx(3.0 / math.e**2), 0.0),
        "most_length_mm": (pytest.approx(3.0 * math.e**2), 0.0),
    }
    assert "over at least 0.406 mm and at most 22.2 mm of travel" in vague.effect.explain(vague)
    above = term("lost_motion", "exponential", inputs, [5.0], (3.0,), stds=[0.1, 12.0])  # e^-8 of 3 was never searched
    assert set(above.parameters) == {"amount_um", "most_length_mm"}
    nothing = term("lost_motion", "exponential", inputs, [5.0], (3.0,), stds=[0.1, 90.0])
    assert set(nothing.parameters) == {"amount_um"}
    assert "undetermined number of mm" in nothing.effect.explain(nothing)


def test_a_lag_that_only_fast_rows_show_is_stated_there() -> None:
    """200 ± 230 ms with a knee at 0.5 mm/s is 200·40/(1 + 80) = 98.8 µm at 40 mm/s, the fastest."""
    found = term(
        "velocity_lag",
        "saturating",
        ["velocity_mm_s", "direction"],
        [200.0],
        (0.5,),
        constants={"fastest_mm_s": 40.0},
        stds=[230.0, 0.4],
    )
    assert set(found.parameters) == {"error_at_fastest_um", "least_knee_mm_s", "most_knee_mm_s"}
    assert found.parameters["error_at_fastest_um"].value == pytest.approx(98.765, abs=1e-3)
    assert "do not determine" in found.effect.explain(found)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_amount_known_to_half_of_it_is_stated_whatever_its_sign(sign: float) -> None:
    """5 ± 2.4 is known to less than a half, 5 ± 2.6 is not: then the value is that of 0.3 mm and of 40 mm/s, which the rows hold."""
    for std, known in ((2.4, True), (2.6, False)):
        given = ["since_reversal_mm", "direction"]
        seen = {"shortest_mm": 0.3}
        lost = term("lost_motion", "exponential", given, [5.0 * sign], (3.0,), stds=[std, 0.1], constants=seen)
        assert ("amount_um" in lost.parameters) is known
        given, seen = ["velocity_mm_s", "direction"], {"fastest_mm_s": 40.0}
        lag = term("velocity_lag", "saturating", given, [5.0 * sign], (40.0,), stds=[std, 0.1], constants=seen)
        assert ("lag_ms" in lag.parameters) is known
        assert ("a lag in ms" in lag.effect.explain(lag)) is known
        assert ("to 100 ±" in lag.effect.explain(lag)) is (not known and sign > 0)  # 5·40 / (1 + 40/40)


def test_velocity_lag_takes_its_sign_from_the_direction_alone() -> None:
    """5 ms at 40 mm/s is 200 µm; with the knee at 40 mm/s half of that, at 120 mm/s 120 / 4 = 30."""
    columns = {"velocity_mm_s": [40.0, -40.0, 120.0], "direction": [1.0, -1.0, 1.0]}
    assert basis("velocity_lag", "proportional", columns) == [[40.0], [-40.0], [120.0]]
    assert basis("velocity_lag", "with square", columns) == [[40.0, 1600.0], [-40.0, -1600.0], [120.0, 14400.0]]
    assert basis("velocity_lag", "saturating", columns, (40.0,)) == [[20.0], [-20.0], [30.0]]
    whole = term("velocity_lag", "proportional", list(columns), [5.0])
    with pytest.raises(InputError, match="needs velocity_mm_s in every row"):
        whole.error_um({"velocity_mm_s": np.array([1.0, np.nan]), "direction": np.ones(2)})
    assert whole.error_um({k: np.array(v) for k, v in columns.items()}).tolist() == [200.0, -200.0, 600.0]
    assert values(whole.parameters) == {"lag_ms": (5.0, 0.1)}
    assert "direction of motion: 5 ± 0.2 µm per mm/s" in whole.effect.explain(whole)
    curved = term("velocity_lag", "with square", list(columns), [5.0, 0.5])
    assert values(curved.parameters) == {"lag_ms": (5.0, 0.1), "curvature_um_s2_per_mm2": (0.5, 0.2)}
    assert "(with square): 5 ± 0.2" in curved.effect.explain(curved)
    knee = term("velocity_lag", "saturating", list(columns), [5.0], (40.0,))
    assert values(knee.parameters) == {"lag_ms": (5.0, 0.1), "knee_mm_s": (40.0, 0.2)}


def test_load_gives_way_straight_or_bent() -> None:
    """F = 30 kg about a mean of 20: bend (30 - 20)² = 100; u = 0.5 at 250 mm."""
    columns = {"load_kg": [30.0, 15.0], "target_mm": [250.0, 150.0], "direction": [1.0, -1.0]}
    constants = TRAVEL | {"mean": 20.0}
    expected = {
        "offset": [[30.0], [15.0]],
        "with direction": [[30.0], [-15.0]],
        "with position": [[15.0], [-7.5]],
        "with direction and position": [[15.0], [7.5]],
        "from a stiff point": [[30.0, 15.0], [15.0, -7.5]],
        "offset and with direction and position": [[30.0, 15.0], [15.0, 7.5]],
        "curved": [[30.0, 100.0], [15.0, 25.0]],
        "curved with direction": [[30.0, 100.0], [-15.0, -25.0]],
    }
    for form, rows in expected.items():
        assert basis("load_deflection", form, columns, constants=constants) == rows, form
    names = {
        "offset": ["compliance_um_per_kg"],
        "with direction": ["compliance_with_direction_um_per_kg"],
        "with position": ["compliance_with_position_um_per_kg"],
        "with direction and position": ["compliance_with_direction_and_position_um_per_kg"],
        "offset and with direction and position": [
            "compliance_um_per_kg",
            "compliance_with_direction_and_position_um_per_kg",
        ],
        "curved": ["compliance_um_per_kg", "curvature_um_per_kg"],
        "curved with direction": ["compliance_with_direction_um_per_kg", "curvature_um_per_kg"],
    }
    for form, known in names.items():
        found = term("load_deflection", form, list(columns), [0.5, 0.25][: len(known)])
        assert [(n, e.value) for n, e in found.parameters.items()] == list(zip(known, [0.5, 0.25], strict=False))
        assert "0.5 ± 0.2 µm per kg." in found.effect.explain(found)
        assert (", " in found.effect.explain(found)) == (form != "offset")
    torque = term("load_deflection", "offset", ["torque_percent", "target_mm", "direction"], [0.5])
    assert list(torque.parameters) == ["compliance_um_per_percent"]
    assert "µm per %." in torque.effect.explain(torque)


def test_a_screw_gives_way_in_proportion_to_its_free_length() -> None:
    """0.5 and 0.25 µm/kg are nothing two half travels below mid-travel; σ² = (σ₀² + 2²·σ₁²)·(h/c₁)², σ 0.001 and 0.002."""
    given = {"constants": TRAVEL | {"mean": 20.0}, "stds": [0.001, 0.002]}
    found = term("load_deflection", "from a stiff point", ["load_kg", "target_mm", "direction"], [0.5, 0.25], **given)
    centre, half = TRAVEL["centre_mm"], TRAVEL["half_span_mm"]
    assert values(found.parameters) == {
        "compliance_at_mid_travel_um_per_kg": (0.5, 0.001),
        "compliance_with_position_um_per_kg": (0.25, 0.002),
        "stiff_point_mm": (centre - 2.0 * half, pytest.approx(half / 0.25 * math.hypot(0.001, 0.004), rel=1e-6)),
    }
    assert "held at" in found.effect.explain(found)
    vague = term("load_deflection", "from a stiff point", ["load_kg", "target_mm", "direction"], [0.5, 0.25])
    assert "stiff_point_mm" not in vague.parameters  # 0.25 ± 0.2
    far = term("load_deflection", "from a stiff point", ["load_kg", "target_mm", "direction"], [0.8, 0.25], **given)
    assert "stiff_point_mm" not in far.parameters  # more than a travel beyond the end
    assert "held at" not in vague.effect.explain(vague)


def test_abbe_is_arm_times_tilt() -> None:
    """4 µrad on 250 mm is 1 µm: 1e-3 µm per µrad and mm; u = 0.5 at 250 mm."""
    columns = {"pitch_urad": [4.0, -2.0], "target_mm": [250.0, 300.0]}
    assert basis("abbe", "tilt", {"pitch_urad": [4.0, -2.0]}) == [[pytest.approx(4e-3)], [pytest.approx(-2e-3)]]
    changing = basis("abbe", "arm changing along the travel", columns, constants=TRAVEL)
    assert changing == [pytest.approx([4e-3, 2e-3]), pytest.approx([-2e-3, -2e-3])]
    found = term("abbe", "tilt", ["pitch_urad"], [250.0])
    assert found.error_um({"pitch_urad": np.array([4.0])})[0] == pytest.approx(1.0)
    assert values(found.parameters) == {"arm_mm": (250.0, 0.1)}
    assert "on an arm of 250 ± 0.2 mm" in found.effect.explain(found)
    both = term("abbe", "arm changing along the travel", list(columns), [250.0, 30.0], constants=TRAVEL)
    assert values(both.parameters) == {"arm_mm": (250.0, 0.1), "arm_change_mm": (30.0, 0.2)}
    for arm, bad in ((4999.0, False), (5001.0, True), (-5001.0, True)):
        assert (EFFECTS["abbe"].implausible(term("abbe", "tilt", ["pitch_urad"], [arm])) is not None) is bad


def test_abbe_at_a_second_offset_of_the_measuring_line() -> None:
    """(arm + offset) · 1e-3 · P_k(u): arm 100, offsets 0 and 50 mm, u = 0.5: P = 1, 0.5, -0.125, -0.4375, -0.2891, 0.0898."""
    columns = {"abbe_offset_mm": [0.0, 50.0], "target_mm": [250.0, 250.0]}
    legendre = [1.0, 0.5, -0.125, -0.4375, -0.2890625, 0.08984375]
    for form, count in (("straight tilt, two offsets", 2), ("tilt, two offsets", 4), ("wavy tilt, two offsets", 6)):
        rows = basis("abbe", form, columns, (100.0,), TRAVEL)
        assert rows[0] == pytest.approx([0.10 * p for p in legendre[:count]])
        assert rows[1] == pytest.approx([0.15 * p for p in legendre[:count]])
    beyond = basis(
        "abbe", "straight tilt, two offsets", {"abbe_offset_mm": [0.0], "target_mm": [500.0]}, (100.0,), TRAVEL
    )
    assert beyond == [pytest.approx([0.10, 0.11])]  # held at 1.1 half spans
    before = basis(
        "abbe", "straight tilt, two offsets", {"abbe_offset_mm": [0.0], "target_mm": [-500.0]}, (100.0,), TRAVEL
    )
    assert before == [pytest.approx([0.10, -0.11])]
    found = term("abbe", "straight tilt, two offsets", list(columns), [1.0, 3.0], (100.0,))
    assert values(found.parameters) == {"arm_mm": (100.0, 0.3), "tilt_to_the_end_urad": (3.0, 0.2)}
    assert "an arm of 100 ± 0.6 mm" in found.effect.explain(found)
    assert EFFECTS["abbe"].implausible(found) is None
    far = term("abbe", "straight tilt, two offsets", list(columns), [1.0, 3.0], (-5001.0,))
    assert EFFECTS["abbe"].implausible(far) is not None


def test_cross_axis_is_per_metre_of_the_other_axis() -> None:
    """y = 500 mm is 0.5 m, 400 mm above its mean: (0.4 m)² = 0.16; u = 0.5."""
    columns = {"pos_y_mm": [500.0, -100.0], "target_mm": [250.0, 100.0]}
    constants = TRAVEL | {"mean_mm": 100.0}
    expected = {
        "shift": [[0.5], [-0.1]],
        "growing along the travel": [[0.25], [0.1]],
        "shift and growth": [[0.5, 0.25], [-0.1, 0.1]],
        "curved": [[0.5, 0.16], [-0.1, 0.04]],
        "curved and growing along the travel": [[0.5, 0.16, 0.25, 0.08], [-0.1, 0.04, 0.1, -0.04]],
    }
    names = {
        "shift": ["slope_um_per_m"],
        "growing along the travel": ["growth_um_per_m"],
        "shift and growth": ["slope_um_per_m", "growth_um_per_m"],
        "curved": ["slope_um_per_m", "curvature_um_per_m2"],
        "curved and growing along the travel": [
            "slope_um_per_m",
            "curvature_um_per_m2",
            "growth_um_per_m",
            "growth_of_curvature_um_per_m2",
        ],
    }
    amounts = [7.0, 8.0, 9.0, 10.0]
    for form, rows in expected.items():
        found = basis("cross_axis", form, columns, constants=constants)
        assert found == [pytest.approx(row) for row in rows], form
        fitted = term("cross_axis", form, list(columns), amounts[: len(rows[0])])
        assert [(n, e.value) for n, e in fitted.parameters.items()] == list(zip(names[form], amounts, strict=False))
        assert f"follows pos_y_mm ({form}): 7 ± 0.2 µm per metre" in fitted.effect.explain(fitted)
        assert (" µm per square metre" in fitted.effect.explain(fitted)) is form.startswith("curved")


def test_thermal_expansion_of_a_steel_screw() -> None:
    """11.5 ppm/K · 300 mm · (30 - 20) K = 34.5 µm; below 20 °C it is shorter."""
    columns = {"temp_screw_c": [30.0, 18.0, 20.0], "target_mm": [300.0, 300.0, 300.0]}
    steel = term("thermal_expansion", "temperature", list(columns), [11.5])
    assert steel.error_um({k: np.array(v) for k, v in columns.items()}) == pytest.approx([34.5, -6.9, 0.0])
    assert values(steel.parameters) == {"coefficient_ppm_per_k": (11.5, 0.1)}
    assert "position and temp_screw_c: 11.5 ± 0.2 ppm/K" in steel.effect.explain(steel)
    assert "lag" not in steel.effect.explain(steel)
    for ppm, bad in ((2.0, False), (35.0, False), (1.9, True), (36.0, True), (-11.5, True)):
        found = term("thermal_expansion", "temperature", list(columns), [ppm])
        assert (EFFECTS["thermal_expansion"].implausible(found) is not None) is bad, ppm
    lag = term("thermal_expansion", "lagged temperature", ["temp_screw_c", "time_s", "target_mm"], [11.5], (600.0,))
    assert values(lag.parameters) == {"coefficient_ppm_per_k": (11.5, 0.1), "lag_s": (600.0, 0.2)}
    assert "a lag of 600 ± 0.4 s" in lag.effect.explain(lag)


ABOUT_A_POINT = "temperature, about a fixed point"
WARM = ["temp_screw_c", "target_mm"]


def test_growth_about_a_fixed_point() -> None:
    """12.5 ppm/K and -3 µm/K: zero at 3 / 0.0125 = 240 mm. d/da = -240 / 12.5 = -19.2, d/db = -1 / 0.0125 = -80.

    With σ² 0.04 and 0.01, covariance -0.015: 19.2²·0.04 + 2·19.2·80·(-0.015) + 80²·0.01 = 14.7456 - 46.08 + 64 = 32.6656 mm².
    """
    about = term("thermal_expansion", ABOUT_A_POINT, WARM, [12.5, -3.0], constants=TRAVEL)
    about = replace(about, covariance=((0.04, -0.015), (-0.015, 0.01)))
    columns = {"temp_screw_c": np.array([30.0, 30.0]), "target_mm": np.array([240.0, 340.0])}
    assert about.error_um(columns) == pytest.approx([0.0, 12.5])  # 12.5 ppm/K · 100 mm · 10 K
    unsure = round(math.sqrt(32.6656), 9)
    assert values(about.parameters) == {"coefficient_ppm_per_k": (12.5, 0.2), "fixed_point_mm": (240.0, unsure)}
    assert "grows with position about a fixed point at 240 ± 11 mm and" in about.effect.explain(about)
    back = replace(about, coefficients=(-12.5, 3.0))  # the same point, of an axis that shrinks
    assert values(back.parameters)["fixed_point_mm"] == (240.0, unsure)
    broken = replace(about, covariance=((0.04, 0.0), (0.0, -1.0)))  # a variance that rounding made negative
    assert broken.parameters["fixed_point_mm"] == Estimate(240.0, 0.0)
    # both masses: the coefficients of the rise stand behind those of the growth, so the third is the offset
    form, rows = "warming since the start through two lags, about a fixed point", {"first_row": 0.0, "last_row": 6000.0}
    slow = term(
        "thermal_expansion", form, ["time_s", "target_mm"], [200.0, 9.0, -30.0, 7.0], (600.0,), constants=TRAVEL | rows
    )
    # 30 / 0.2 = 150 mm; d/db = 5, d/da = 150 / 200: √((5·0.3)² + (0.75·0.1)²)
    point = (150.0, round(math.hypot(1.5, 0.075), 9))
    assert values(slow.parameters) == {
        "expansion_ppm": (200.0, 0.1),
        "time_constant_s": (600.0, 0.5),
        "fixed_point_mm": point,
    }
    assert "since the start about a fixed point at 150 ± 3 mm, by" in slow.effect.explain(slow)


def test_growth_that_changes_along_the_travel() -> None:
    """Middle 200, half 100 mm. 12 ppm/K, 4 more at 300 mm: 10 K at 300 mm add 10⁻³·(12·300 - 2400 + 4·100²/200)·10 = 14 µm.

    Zero at 12 x - 2400 + 0.02 (x - 200)² = 0: x = 200; there the slope is 12, so 1 µm/K of the offset is 83.3 mm.
    """
    name = "temperature, unlike along the travel, about a fixed point"
    found = term("thermal_expansion", name, WARM, [12.0, -2.4, 4.0], constants=TRAVEL)
    columns = {"temp_screw_c": np.array([30.0, 30.0, 30.0]), "target_mm": np.array([200.0, 300.0, 100.0])}
    assert found.error_um(columns) == pytest.approx([0.0, 14.0, -10.0])
    said = values(found.parameters)
    assert (said["coefficient_ppm_per_k"][0], said["change_to_the_end_ppm_per_k"][0]) == (12.0, 4.0)
    assert said["fixed_point_mm"][0] == pytest.approx(200.0)
    stds = [math.sqrt(found.covariance[i][i]) for i in range(2)]
    assert said["fixed_point_mm"][1] == pytest.approx(math.hypot(200.0 * stds[0], 1000.0 * stds[1]) / 12.0)
    assert "12 ± 0.2 ppm/K in mid-travel, by 4 ±" in found.effect.explain(found)
    off = replace(found, coefficients=(12.0, -3.56, 4.0))  # -1160 + 12 q + 0.02 q² = 0, q = x - 200
    assert off.parameters["fixed_point_mm"].value == pytest.approx(
        200.0 + (-12.0 + math.sqrt(144.0 + 0.08 * 1160.0)) / 0.04
    )
    for ppm, change, bad in (
        (12.0, 9.9, False),
        (12.0, -10.1, True),
        (30.0, 5.1, True),
        (30.0, -4.9, False),
    ):  # 2 to 35 ppm/K
        ends = replace(found, coefficients=(ppm, -2.4, change))
        assert (found.effect.implausible(ends) is not None) is bad, (ppm, change)
    turning = replace(
        found, coefficients=(12.0, -1.2, 12.0)
    )  # it does not grow at 100 mm, where it is zero: no quotient by that
    assert "fixed_point_mm" not in turning.parameters
    away = replace(found, coefficients=(12.0, 9.0, 4.0))  # 11400 + 12 (x - 200) + 0.02 (x - 200)² is nowhere zero
    assert "fixed_point_mm" not in away.parameters


def test_a_fixed_point_is_stated_where_the_growth_is_three_standard_deviations_from_none() -> None:
    """Of 12.5 ppm/K a third is 4.17."""
    for std, known in ((4.1, True), (4.3, False)):
        found = term("thermal_expansion", ABOUT_A_POINT, WARM, [12.5, -3.0], stds=[std, 0.1], constants=TRAVEL)
        assert ("fixed_point_mm" in found.parameters) is known
        assert ("about a fixed point at 240 ±" in found.effect.explain(found)) is known
        assert ("about a point that these records do not determine and" in found.effect.explain(found)) is not known
    zero = term("thermal_expansion", "temperature", WARM, [12.5], constants=TRAVEL)
    assert set(zero.parameters) == {"coefficient_ppm_per_k"}
    assert "about" not in zero.effect.explain(zero)


@pytest.mark.parametrize(
    ("point_mm", "said"),
    [
        (499.0, None),
        (501.0, "a fixed point at 501 mm lies more than a travel outside"),
        (-99.0, None),
        (-101.0, "a fixed point at -101 mm lies more than a travel outside"),
    ],
)
def test_no_machine_holds_its_screw_farther_than_a_travel_away(point_mm: float, said: str | None) -> None:
    """The travel is 100 to 300 mm, so one more is -100 to 500; at 12.5 ppm/K the point is where -0.0125 µm/K per mm puts it."""
    found = term("thermal_expansion", ABOUT_A_POINT, WARM, [12.5, -0.0125 * point_mm], constants=TRAVEL)
    why = found.effect.implausible(found)
    assert why is None if said is None else str(why).startswith(said)
    since_start = "warming since the start, about a fixed point"
    ends = term("thermal_expansion", since_start, ["time_s", "target_mm"], [200.0, -0.2 * point_mm], (600.0,))
    ends = replace(ends, form=replace(ends.form, constants=TRAVEL))
    why = ends.effect.implausible(ends)  # 200 ppm in all, not per kelvin
    assert why is None if said is None else str(why).startswith(said)


def test_growth_that_no_material_has_says_which_way_it_is_wrong() -> None:
    for ppm, said in ((-0.5, "moves the axis back"), (0.5, "outside the 2 to 35 ppm/K"), (36.0, "outside the 2 to 35")):
        found = term("thermal_expansion", "temperature", WARM, [ppm])
        assert said in str(found.effect.implausible(found))
    none = term("thermal_expansion", ABOUT_A_POINT, WARM, [0.0, 1.0], constants=TRAVEL)  # a point at infinity
    assert str(none.effect.implausible(none)).startswith("0 ppm/K lies outside")


def test_warming_since_the_start() -> None:
    """1 - e^(-t/τ): 0.63212 at one time constant, and x·e^-x for the second mass; 20 ppm of 500 mm in the end are 10 µm."""
    columns = {"time_s": [0.0, 600.0, 1200.0], "target_mm": [500.0, 500.0, 500.0]}
    grown = basis("thermal_expansion", "warming since the start", columns, (600.0,))
    assert grown == [[0.0], [pytest.approx(0.5 * 0.63212056)], [pytest.approx(0.5 * 0.86466472)]]
    drift = basis("thermal_drift", "warming since the start", {"time_s": [0.0, 600.0]}, (600.0,))
    assert drift == [[0.0], [pytest.approx(0.63212056)]]
    slow = basis(
        "thermal_drift", "warming since the start through two lags", {"time_s": [0.0, 600.0, 1200.0]}, (600.0,)
    )
    assert slow == [[0.0, 0.0], pytest.approx([0.63212056, 0.36787944]), pytest.approx([0.86466472, 0.27067057])]
    for form, second in (("warming since the start", []), ("warming since the start through two lags", [-30.0])):
        tau_std = 0.3 if second else 0.2
        found = term("thermal_expansion", form, list(columns), [200.0, *second], (600.0,))
        assert values(found.parameters) == {"expansion_ppm": (200.0, 0.1), "time_constant_s": (600.0, tau_std)}
        assert "200 ± 0.2 ppm" in found.effect.explain(found)
        assert f"600 ± {2 * tau_std:g} s" in found.effect.explain(found)
        assert EFFECTS["thermal_expansion"].implausible(found) is None  # 200 ppm in all, not per kelvin
        moved = term("thermal_drift", form, ["row_order"], [4.0, *([-1.0] if second else [])], (60.0,))
        assert values(moved.parameters) == {"drift_um": (4.0, 0.1), "time_constant_rows": (60.0, tau_std)}
        assert "drifts by 4 ± 0.2 µm" in moved.effect.explain(moved)
        assert f"60 ± {2 * tau_std:g} rows" in moved.effect.explain(moved)


def test_what_rows_show_of_a_slow_warming_counts_both_masses() -> None:
    """From 0 to 600 s at τ = 3000 s: x = 0.2, 1 - e^-x = 0.181269, x·e^-x = 0.163746; 40·0.181269 - 20·0.163746 = 3.9758."""
    rows = {"first_row": 0.0, "last_row": 600.0}
    form = "warming since the start through two lags"
    found = term("thermal_drift", form, ["time_s"], [40.0, -20.0], (3000.0,), constants=rows, stds=[1.0, 1.0, 1e-9])
    shown = found.parameters["drift_over_the_rows_um"]
    assert shown.value == pytest.approx(3.97584, abs=1e-4)
    assert shown.std == pytest.approx(math.hypot(0.181269, 0.163746), rel=1e-4)
    known = term("thermal_drift", form, ["time_s"], [40.0, -20.0], (3000.0,), constants=rows, stds=[1e-9, 1e-9, 300.0])
    # dx/dτ = -x/τ: d(1 - e^-x) = -x·e^-x/τ, d(x·e^-x) = -x(1 - x)e^-x/τ: (-40·0.163746 + 20·0.130997)/3000 per s
    assert known.parameters["drift_over_the_rows_um"].std == pytest.approx(300.0 * 3.9299 / 3000.0, rel=1e-4)


def test_what_rows_show_of_a_warming_is_between_the_first_and_the_last() -> None:
    """From 600 to 1200 s at τ = 3000 s: e^-0.2 - e^-0.4 = 0.818731 - 0.670320 = 0.148411, of 40 µm 5.93643."""
    rows = {"first_row": 600.0, "last_row": 1200.0}
    for form, where in (("warming since the start", "as a whole"), (UNEVEN, "on average over the travel")):
        several = [1.0, 1.0, 1.0] if form == UNEVEN else []
        stds = [1.0] * (1 + len(several)) + [1e-9]
        given = [40.0, *several]
        found = term("thermal_drift", form, ["time_s", "target_mm"], given, (3000.0,), constants=rows, stds=stds)
        shown = found.parameters["drift_over_the_rows_um"]
        assert (shown.value, shown.std) == pytest.approx((5.936428, 0.148411), rel=1e-5)
        assert f"from the first row to the last, {where};" in found.effect.explain(found)


@pytest.mark.parametrize(
    ("amount", "stds", "stated"),
    [
        (40.0, (1.0, 1400.0), True),
        (-40.0, (1.0, 1400.0), True),
        (40.0, (1.0, 1600.0), False),
        (40.0, (21.0, 1400.0), False),
    ],
)
def test_where_a_warming_ends_is_stated_for_an_amount_and_a_time_known_to_half(
    amount: float, stds: tuple[float, float], stated: bool
) -> None:
    """Half of 40 µm is 20, half of 3000 s is 1500; from 0 to 6000 s is e^-2 short of all of it."""
    rows = {"first_row": 0.0, "last_row": 6000.0}
    form = "warming since the start"
    found = term("thermal_drift", form, ["time_s"], [amount], (3000.0,), constants=rows, stds=stds)
    assert ("drift_um" in found.parameters) is stated
    assert ("drift_over_the_rows_um" in found.parameters) is not stated


@pytest.mark.parametrize(
    ("effect", "inputs"), [("thermal_drift", ["time_s"]), ("thermal_expansion", ["time_s", "target_mm"])]
)
def test_a_time_constant_that_the_rows_do_not_bound_has_no_bound(effect: str, inputs: list[str]) -> None:
    """3000 ± 1500 s is at least 3000/e = 1104 s; of 3000 ± 9000 s two standard uncertainties are a factor of e^6 = 403."""
    rows = {"first_row": 0.0, "last_row": 600.0}
    for std, bound in ((1500.0, {"least_time_constant_s": pytest.approx(1103.6, abs=0.1)}), (9000.0, {})):
        found = term(effect, "warming since the start", inputs, [40.0], (3000.0,), constants=rows, stds=[1.0, std])
        known = {name: one.value for name, one in found.parameters.items() if name.startswith("least")}
        assert known == bound
        said = found.effect.explain(found)
        assert ("a time constant beyond 1.1e+03 s" in said) == bool(bound)
        assert ("and its time constant, these rows do not determine" in said) != bool(bound)


def test_drift_with_a_temperature_and_along_the_travel() -> None:
    assert basis("thermal_drift", "temperature", {"temp_head_c": [25.0, 19.0]}) == [[5.0], [-1.0]]
    plain = term("thermal_drift", "temperature", ["temp_head_c"], [2.0])
    assert values(plain.parameters) == {"coefficient_um_per_k": (2.0, 0.1)}
    assert "temp_head_c by 2 ± 0.2 µm/K" in plain.effect.explain(plain)
    for um_per_k, bad in ((59.0, False), (-61.0, True)):  # five metres of steel
        found = term("thermal_drift", "temperature", ["temp_head_c"], [um_per_k])
        assert (found.effect.implausible(found) is not None) is bad
    lag = term("thermal_drift", "lagged temperature", ["temp_head_c", "time_s"], [2.0], (90.0,))
    assert values(lag.parameters) == {"coefficient_um_per_k": (2.0, 0.1), "lag_s": (90.0, 0.2)}
    assert "a lag of 90 ± 0.4 s by 2 ± 0.2 µm/K" in lag.effect.explain(lag)
    # u = 0.5: P0 … P3 = 1, 0.5, -0.125, -0.4375, times 1 - e^-1; beyond the travel u is held at 1
    form, columns = UNEVEN, {"time_s": [60.0, 60.0], "target_mm": [250.0, 900.0]}
    rows = basis("thermal_drift", form, columns, (60.0,), TRAVEL)
    assert rows[0] == pytest.approx([0.63212056 * p for p in (1.0, 0.5, -0.125, -0.4375)])
    assert rows[1] == pytest.approx([0.63212056] * 4)
    before = basis("thermal_drift", form, {"time_s": [60.0], "target_mm": [-900.0]}, (60.0,), TRAVEL)
    assert before == [pytest.approx([0.63212056 * p for p in (1.0, -1.0, 1.0, -1.0)])]
    uneven = term("thermal_drift", form, list(columns), [4.0, 3.0, 2.0, 1.0], (60.0,))
    assert values(uneven.parameters) == {
        "drift_um": (4.0, 0.1),
        "time_constant_s": (60.0, 0.5),
        "along_the_travel_1_um": (3.0, 0.2),
        "along_the_travel_2_um": (2.0, 0.3),
        "along_the_travel_3_um": (1.0, 0.4),
    }
    assert "drifts by 4 ± 0.2 µm on average" in uneven.effect.explain(uneven)
    assert "60 ± 1 s" in uneven.effect.explain(uneven)


def test_a_temperature_through_a_lag() -> None:
    """y' = (v - y)/τ, straight between rows: a ramp of slope k from 0 has the answer k(t - τ(1 - e^(-t/τ))).

    Ramp 0 → 10 in 100 s, τ 50 s: 0.1·(100 - 50·(1 - e^-2)) = 5.67668; then held at 10 for 100 s: 10 - 4.32332·e^-2 = 9.41490.
    """
    out = lagged(np.array([0.0, 100.0, 200.0]), np.array([0.0, 10.0, 10.0]), 50.0)
    assert out == pytest.approx([0.0, 5.676676, 9.414902], abs=1e-6)
    assert lagged(np.array([0.0, 1.0]), np.array([3.0, 4.0]), 0.0).tolist() == [3.0, 4.0]  # no lag at all
    assert lagged(np.array([7.0]), np.array([3.0]), 50.0).tolist() == [3.0]
    assert lagged(np.array([0.0, 0.0]), np.array([3.0, 4.0]), 50.0).tolist() == [3.0, 3.0]  # no time passed
    columns = {"temp_screw_c": [20.0, 30.0, 30.0], "time_s": [0.0, 100.0, 200.0], "target_mm": [1000.0, 1000.0, 1000.0]}
    rows = basis("thermal_expansion", "lagged temperature", columns, (50.0,))
    assert [row[0] for row in rows] == pytest.approx([0.0, 5.676676, 9.414902], abs=1e-6)


def test_a_worn_zone_is_a_bell() -> None:
    """exp(-½ z²): 1 at the centre, 0.60653 one width off, 0.13534 two off; with the direction's sign."""
    columns = {"target_mm": [100.0, 110.0, 80.0], "direction": [1.0, -1.0, -1.0]}
    bell = [1.0, 0.60653066, 0.13533528]
    assert basis("local_wear", "bump", columns, (100.0, 10.0)) == [[pytest.approx(b)] for b in bell]
    turned = [bell[0], -bell[1], -bell[2]]
    assert basis("local_wear", "bump with direction", columns, (100.0, 10.0)) == [[pytest.approx(b)] for b in turned]
    at = {"target_mm": np.array([80.0, 95.0, 100.0, 105.0, 110.0]), "direction": np.ones(5)}
    shaped = {
        "flat bump": [math.exp(-8.0), math.exp(-1 / 32), 1.0, math.exp(-1 / 32), math.exp(-0.5)],  # ½ (2, ½, 0, ½, 1)⁴
        "fading bump": [
            math.exp(-72.0),
            math.exp(-4.5),
            1.0,
            math.exp(-0.5),
            math.exp(-1.0),
        ],  # steep side: ½ (6·2, 6·½)²
        "rising bump": [math.exp(-2.0), math.exp(-0.5), 1.0, math.exp(-4.5), math.exp(-18.0)],
    }
    for name, zone in shaped.items():
        assert basis("local_wear", name, at, (100.0, 10.0)) == [[pytest.approx(z)] for z in zone]
        back = at | {"direction": -np.ones(5)}
        turned_over = basis("local_wear", f"{name} with direction", back, (100.0, 10.0))
        assert turned_over == [[pytest.approx(-z)] for z in zone]
    both = basis("local_wear", "bump in each direction", columns, (100.0, 10.0))
    assert both == [pytest.approx([a, b]) for a, b in zip(bell, turned, strict=True)]
    found = term("local_wear", "bump in each direction", list(columns), [5.0, 2.0], (100.0, 10.0))
    assert values(found.parameters) == {
        "height_um": (5.0, 0.1),
        "centre_mm": (100.0, 0.3),
        "width_mm": (10.0, 0.4),
        "height_with_direction_um": (2.0, 0.2),
    }
    assert "Around 100 ± 0.6 mm, with a half width of 10 ± 0.8 mm" in found.effect.explain(found)
    assert "by 5 ± 0.2 µm, and with the direction by 2 ± 0.4 µm:" in found.effect.explain(found)
    opposed = term("local_wear", "bump with direction", list(columns), [5.0], (100.0, 10.0))
    assert "opposite sign" in opposed.effect.explain(opposed)
    assert list(opposed.parameters) == ["height_um", "centre_mm", "width_mm"]


def test_pitch_shape_in_legendre_polynomials() -> None:
    """u = 0.5: P1 … P6 = 0.5, -0.125, -0.4375, -0.28906, 0.08984, 0.32324; 1 µm at the end of a half span of 100 mm is 10 ppm."""
    known = [0.5, -0.125, -0.4375, -0.2890625, 0.08984375, 0.3232421875]
    for form, count in (("lead error", 1), ("bow", 3), ("shape", 6)):
        assert basis("pitch_shape", form, {"target_mm": [250.0]}, constants=TRAVEL) == [pytest.approx(known[:count])]
    fine = basis("pitch_shape", "fine shape", {"target_mm": [250.0, 300.0, 100.0]}, constants=TRAVEL)
    assert fine[0][:6] == pytest.approx(known)
    assert fine[1:] == [pytest.approx([1.0] * 12), pytest.approx([-1.0, 1.0] * 6)]
    assert basis("pitch_shape", "lead error", {"target_mm": [900.0, -900.0]}, constants=TRAVEL) == [
        [pytest.approx(1.1)],
        [pytest.approx(-1.1)],
    ]
    bow = term("pitch_shape", "bow", ["target_mm"], [3.0, 4.0, 12.0], constants=TRAVEL)
    assert values(bow.parameters) == {
        "lead_error_ppm": (30.0, 1.0),
        "order_2_um": (4.0, 0.2),
        "order_3_um": (12.0, 0.3),
    }
    assert "about 13 µm" in bow.effect.explain(bow)  # √(9 + 16 + 144)
    assert "30 ± 2 ppm" in bow.effect.explain(bow)


def test_cyclic_waves() -> None:
    """Period 8 mm: x = 1 is π/4 (0.70711 both), x = 2 is π/2; the second harmonic of π/4 is π/2."""
    columns = {"target_mm": [1.0, 2.0, -2.0], "direction": [1.0, -1.0, 1.0]}
    h = math.sqrt(0.5)
    first = [[h, h], [1.0, 0.0], [-1.0, 0.0]]

    def close(rows: list[list[float]]) -> list[object]:
        return [pytest.approx(row, abs=1e-12) for row in rows]

    assert basis("cyclic", "fundamental", {"target_mm": [1.0, 2.0, -2.0]}, (8.0,)) == close(first)
    second = [[1.0, 0.0], [0.0, -1.0], [0.0, -1.0]]
    joined = [a + b for a, b in zip(first, second, strict=True)]
    assert basis("cyclic", "with second harmonic", columns, (8.0,)) == close(joined)
    third = [[h, -h], [-1.0, 0.0], [1.0, 0.0]]  # three quarters of π, and three halves
    joined = [a + b for a, b in zip(first, third, strict=True)]
    assert basis("cyclic", "with third harmonic", columns, (8.0,)) == close(joined)
    u = {"centre_mm": -2.0, "half_span_mm": 4.0}  # u = 0.75, 1, 0
    both = [a + b + [f * v for v in a] for a, b, f in zip(first, second, (0.75, 1.0, 0.0), strict=True)]
    name = "with second harmonic, amplitude changing along the travel"
    assert basis("cyclic", name, columns, (8.0,), u) == close(both)
    joined = [row + [f * v for v in row] for row, f in zip(first, (0.75, 1.0, 0.0), strict=True)]
    assert basis("cyclic", "amplitude changing along the travel", columns, (8.0,), u) == close(joined)
    joined = [row + [f * v for v in row] for row, f in zip(first, (1.0, -1.0, 1.0), strict=True)]
    assert basis("cyclic", "different in each direction", columns, (8.0,)) == close(joined)


def test_cyclic_amplitude_and_phase() -> None:
    """3 sin + 4 cos = 5 sin(· + 0.9273); σ 0.1 and 0.2: amplitude √(9·0.01 + 16·0.04)/5 = 0.170880, phase √(16·0.01 + 9·0.04)/25."""
    found = term("cyclic", "fundamental", ["target_mm"], [3.0, 4.0], (8.0,))
    assert values(found.parameters) == {
        "period_mm": (8.0, 0.3),
        "amplitude_um": (5.0, round(math.sqrt(0.73) / 5, 9)),
        "phase": (round(math.atan2(4.0, 3.0), 9), round(math.sqrt(0.52) / 25, 9)),
    }
    assert "every 8 ± 0.6 mm of travel with an amplitude of 5 ± 0.34 µm:" in found.effect.explain(found)
    # along the travel the change of the amplitude, (3·5 + 4·12)/5; across it (3·12 - 4·5)/5 = 3.2, so σ² is 0.1²·(1 + 3.2²/5²)
    sizes = {"change_to_the_ends_um": (12.6, round(0.1 * math.hypot(1.0, 0.64), 9))}
    extra = {
        "with second harmonic": "second_harmonic_um",
        "with third harmonic": "third_harmonic_um",
        "amplitude changing along the travel": "change_to_the_ends_um",
        "different in each direction": "half_difference_um",
    }
    for form, name in extra.items():
        travel = {"centre_mm": 200.0, "half_span_mm": 200.0}
        given = [3.0, 4.0, 5.0, 12.0]
        more = term("cyclic", form, ["target_mm", "direction"], given, (8.0,), stds=[0.1] * 5, constants=travel)
        assert values(more.parameters)[name] == sizes.get(name, (13.0, 0.1))
        assert set(more.parameters) == {"period_mm", "amplitude_um", "phase", name}
        assert "amplitude of 5 ± 0.2 µm, " in more.effect.explain(more)


@pytest.mark.parametrize(
    ("std_um", "stated"), [(0.1, "5 ± 0.2 µm"), (4.0, "5 ± 8 µm"), (100.0, "at most 205 µm"), (6.0, "at most 17 µm")]
)
def test_of_an_amplitude_far_within_its_uncertainty_only_the_most_is_stated(std_um: float, stated: str) -> None:
    """3 sin + 4 cos, σ alike of both: the interval is 5 ± 2 σ."""
    found = term("cyclic", "fundamental", ["target_mm"], [3.0, 4.0], (8.0,), stds=[std_um, std_um, 0.1])
    name = "most_amplitude_um" if "most" in stated else "amplitude_um"
    assert set(found.parameters) == {"period_mm", name, "phase"}
    assert f"an amplitude of {stated}:" in found.effect.explain(found)


@pytest.mark.parametrize(
    ("periods", "parts"),
    [
        ((20.0, 10.0, 6.67), [[20.0, 10.0, 6.67]]),
        ((6.67, 20.0, 13.0), [[20.0, 6.67], [13.0]]),
        ((10.0, 10.05, 7.1), [[10.0, 10.05], [7.1]]),  # 400 mm do not tell the first two apart
        ((10.0, 9.73, 10.27, 5.0), [[10.0, 9.73, 10.27, 5.0]]),  # an amplitude with one wave over 370 mm
        ((10.0, 9.4, 10.6), [[10.6], [10.0], [9.4]]),
    ],
)
def test_harmonics_and_sidebands_are_of_one_part(periods: tuple[float, ...], parts: list[list[float]]) -> None:
    travel = (NonLinear("period_mm", 0.5, 200.0),)
    terms = []
    for period in periods:
        one = term("cyclic", "fundamental", ["target_mm"], [3.0, 4.0], (period,), stds=[0.1, 0.1, 0.01])
        terms.append(replace(one, form=replace(one.form, nonlinear=travel)))
    assert [[one.theta[0] for one in part] for part in parts_that_turn(terms)] == parts
    assert terms[0].effect.explain_all(terms).count("a part that turns") == len(parts)


@pytest.mark.parametrize(("order", "name"), [(2, "second"), (3, "third")])
def test_a_harmonic_beside_an_amplitude_that_changes(order: int, name: str) -> None:
    """3 sin + 4 cos + u (5 sin + 12 cos) as before, with 6 sin + 8 cos of the harmonic, which changes neither period nor phase."""
    travel = {"centre_mm": 1000.0, "half_span_mm": 100.0}
    changing = "amplitude changing along the travel"
    given, stds = [3.0, 4.0, 6.0, 8.0, 5.0, 12.0], [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1e-4]
    found = term(
        "cyclic", f"with {name} harmonic, {changing}", ["target_mm"], given, (8.3,), stds=stds, constants=travel
    )
    rest = {"stds": [*stds[:2], *stds[4:]], "constants": travel}
    alone = term("cyclic", changing, ["target_mm"], [*given[:2], *given[4:]], (8.3,), **rest)
    harmonic = (10.0, round(math.hypot(0.6 * 0.3, 0.8 * 0.4), 9))
    assert values(found.parameters) == values(alone.parameters) | {f"{name}_harmonic_um": harmonic}
    angle = 2.0 * math.pi * 1050.0 / 8.3  # half way from mid-travel to its end
    wave = 3.0 * math.sin(angle) + 4.0 * math.cos(angle) + 0.5 * (5.0 * math.sin(angle) + 12.0 * math.cos(angle))
    wave += 6.0 * math.sin(order * angle) + 8.0 * math.cos(order * angle)
    assert found.error_um({"target_mm": np.array([1050.0])})[0] == pytest.approx(wave)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_period_and_phase_of_a_wave_that_changes_along_the_travel(sign: float) -> None:
    """3 sin + 4 cos + u (5 sin + 12 cos): (3·12 - 4·5)/25 = 0.64 rad more over 100 mm, so 2π/8.3 + 0.0064 = 0.76341 rad/mm.

    At 0, which is 1000 mm before mid-travel: 0.92730 - 6.4, and a turn. With u against it all three changes are opposite.
    """
    travel = {"centre_mm": 1000.0, "half_span_mm": 100.0}
    given = [3.0, 4.0, 5.0 * sign, 12.0 * sign]
    found = term("cyclic", "amplitude changing along the travel", ["target_mm"], given, (8.3,), constants=travel)
    turned = 0.0064 * sign
    assert found.parameters["period_mm"].value == pytest.approx(2 * math.pi / (2 * math.pi / 8.3 + turned))
    whole = found.parameters["phase"].value
    assert whole == pytest.approx(math.atan2(4.0, 3.0) + (-6.4 + 2 * math.pi if sign > 0 else 6.4 - 2 * math.pi))
    assert found.parameters["change_to_the_ends_um"].value == pytest.approx(12.6)


def test_a_change_of_phase_along_the_travel_is_a_change_of_the_period() -> None:
    """1 + 0.3 u of sin(2πx/10 + 0.7), fitted with waves of 10.004 mm: period and phase of the wave itself come out."""
    x = np.linspace(0.0, 400.0, 900)
    u = (x - 200.0) / 200.0
    wave = 2.0 * (1.0 + 0.3 * u) * np.sin(2 * np.pi * x / 10.0 + 0.7)
    travel = {"centre_mm": 200.0, "half_span_mm": 200.0}
    form = Form("cyclic", "amplitude changing along the travel", ("target_mm",), travel)
    waves = EFFECTS["cyclic"].basis(form, (10.004,), {"target_mm": x})
    normal = waves.T @ waves
    fitted = tuple(np.linalg.solve(normal, waves.T @ wave).tolist())
    spread = tuple(tuple(row) for row in np.pad(np.linalg.inv(normal), (0, 1)).tolist())
    found = Term(EFFECTS["cyclic"], form, (10.004,), fitted, spread).parameters
    assert found["period_mm"].value == pytest.approx(10.0, abs=2e-4)
    assert found["phase"].value == pytest.approx(0.7, abs=0.02)
    assert found["amplitude_um"].value == pytest.approx(2.0, rel=0.02)
    # of a free period over N rows, σ = 1: std of the frequency √(6/N)/(π·travel·amplitude) (Rife & Boorstyn 1974)
    assert found["period_mm"].std == pytest.approx(100.0 * math.sqrt(6 / 900) / (math.pi * 400.0 * 2.0), rel=0.15)


def test_correlated_coefficients_in_amplitude_and_angle() -> None:
    """a 3, b 4, σ² 0.01 and 0.04, covariance 0.01: (9·0.01 + 2·12·0.01 + 16·0.04)/25 and (16·0.01 - 2·12·0.01 + 9·0.04)/625."""
    form = Form("cyclic", "fundamental", ("target_mm",))
    found = Term(EFFECTS["cyclic"], form, (), (3.0, 4.0), ((0.01, 0.01), (0.01, 0.04)))
    assert found.amplitude(0, 1).std == pytest.approx(math.sqrt(0.97 / 25))
    assert found.angle(0, 1).std == pytest.approx(math.sqrt(0.28 / 625))
    nothing = Term(EFFECTS["cyclic"], form, (), (0.0, 0.0), ((0.01, 0.0), (0.0, 0.04)))
    assert nothing.amplitude(0, 1) == Estimate(0.0, 0.1)
    assert nothing.angle(0, 1) == Estimate(0.0, math.pi)  # could be any angle
    assert found.coefficient(0, -2.0) == Estimate(-6.0, 0.2)
    broken = Term(EFFECTS["cyclic"], form, (1.0,), (3.0, 4.0), ((-0.01, 0, 0), (0, -0.04, 0), (0, 0, -1.0)))
    every = (broken.coefficient(0), broken.nonlinear(0), broken.amplitude(0, 1), broken.angle(0, 1))
    assert [one.std for one in every] == [0.0] * 4  # a variance that rounding made negative


def test_the_uncertainty_of_a_derived_figure_is_its_slope_times_that_of_the_parameter() -> None:
    """c³ has the slope 3c²: 3e-4 at 0.01; c² the slope 2c, -6 at -3. θ/(θ + v) at θ = v has the slope 1/(4v)."""
    small = term("velocity_lag", "saturating", ["velocity_mm_s", "direction"], [0.01], (-3.0,), stds=[0.1, 0.2])
    assert small.derived(lambda c, _: float(c[0]) ** 3).std == pytest.approx(0.1 * 3e-4, rel=1e-6)
    assert small.derived(lambda _, theta: float(theta[0]) ** 2).std == pytest.approx(0.2 * 6.0, rel=1e-6)
    slow = term("velocity_lag", "saturating", ["velocity_mm_s", "direction"], [8.0], (0.01,), stds=[1e-9, 0.001])
    at = slow.at({"velocity_mm_s": 0.01, "direction": 1.0})  # 8·v·θ/(θ + v) = 0.04, and 8·0.25·0.001
    assert (at.value, at.std) == pytest.approx((0.04, 0.002), rel=1e-6)
    arm = term("abbe", "straight tilt, two offsets", ["abbe_offset_mm", "target_mm"], [3.0, 0.0], (-400.0,))
    arm = replace(arm, form=replace(arm.form, constants=TRAVEL))
    at = arm.at({"abbe_offset_mm": 0.0, "target_mm": 200.0})  # 3 µrad · -400 mm; 0.4·0.1, 0 and 3e-3·0.3 µm
    assert (at.value, at.std) == pytest.approx((-1.2, math.hypot(0.04, 9e-4)), rel=1e-9)


def test_the_uncertainty_of_one_row_counts_every_parameter() -> None:
    """One width off the centre the bell is 0.60653, and its slope to the centre and to the width 0.060653 per mm, times 5 µm."""
    zone = term("local_wear", "bump", ["target_mm", "direction"], [5.0], (100.0, 10.0), stds=[0.1, 0.3, 0.4])
    at = zone.at({"target_mm": 110.0, "direction": 1.0})
    b = 0.60653066
    assert (at.value, at.std) == pytest.approx((5.0 * b, b * math.sqrt(0.1**2 + 0.15**2 + 0.2**2)), rel=1e-6)


def test_a_step_begins_after_its_moment() -> None:
    assert basis("datum_step", "step", {"time_s": [9.0, 10.0, 11.0]}, (10.0,)) == [[0.0], [0.0], [1.0]]
    for column, name, unit in (("time_s", "moment_s", "s"), ("row_order", "moment_rows", "rows")):
        found = term("datum_step", "step", [column], [3.0], (10.0,), constants={"interval": 3.0})
        between = pytest.approx(3.0 / math.sqrt(12.0))  # at any time between two rows
        assert values(found.parameters) == {"step_um": (3.0, 0.1), name: (10.0, between)}
        assert f"At 10 {unit} all readings jump by 3 ± 0.2 µm" in found.effect.explain(found)


def test_a_wandering_beam_in_cosines_of_time() -> None:
    """Phase 0, ½, 1 of 10 … 30 s: cos(kπ·phase) / k for a random walk, / √k for 1/f noise; held at both ends."""
    constants = {"start": 10.0, "duration": 20.0, "waves": 3.0}
    times = {"time_s": [10.0, 20.0, 30.0, 0.0, 99.0]}
    walk = basis("beam_drift", "random walk", times, constants=constants)
    ends = [[1.0, 0.5, 1 / 3], [-1.0, 0.5, -1 / 3]]
    assert walk == [pytest.approx(row, abs=1e-12) for row in (ends[0], [0.0, -0.5, 0.0], ends[1], ends[0], ends[1])]
    flicker = basis("beam_drift", "flicker", {"time_s": [10.0]}, constants=constants)
    assert flicker == [pytest.approx([1.0, 0.70710678, 0.57735027])]
    # RMS of Σ c_k cos over whole half waves: √(Σ c²/2); c = 3, 8/2 = 4 → √12.5; dRMS = √(Σ c²σ²)/(2 RMS), σ 0.1 and 0.2/2
    found = term("beam_drift", "random walk", ["time_s"], [3.0, 8.0])
    assert values(found.parameters) == {
        "wander_rms_um": (round(math.sqrt(12.5), 9), round(0.5 / (2 * math.sqrt(12.5)), 9))
    }
    assert "by 3.536 ± 0.14 µm RMS" in found.effect.explain(found)


def test_air_effects_say_their_size_and_know_their_bounds() -> None:
    share = term("air_index", "air index", ["air_temp_c", "target_mm"], [0.9])
    assert values(share.parameters) == {"uncompensated_share": (0.9, 0.1)}
    assert "0.9 ± 0.2 of the full effect" in share.effect.explain(share)
    path = term("dead_path", "air index", ["air_temp_c"], [300.0])
    assert values(path.parameters) == {"dead_path_mm": (300.0, 0.1)}
    assert "fixed length of 300 ± 0.2 mm" in path.effect.explain(path)
    for effect, size, bad in (
        ("air_index", 3.0, False),
        ("air_index", 3.1, True),
        ("air_index", -3.1, True),
        ("dead_path", 20e3, False),
        ("dead_path", 21e3, True),
        ("dead_path", -21e3, True),
    ):
        said = EFFECTS[effect].implausible(term(effect, "air index", ["air_temp_c", "target_mm"], [size]))
        assert (said is not None) is bad, (effect, size)
    said = EFFECTS["dead_path"].implausible(term("dead_path", "air index", ["air_temp_c"], [-21e3]))
    assert str(said).startswith("a dead path of 21 m ")
