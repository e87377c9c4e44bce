"""A stream's corrections are those of single commands: whatever is in force, however the axis moves, and what is refused too."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import BridgeError, CorrectionBoundError, InputError, StateError
from hil.correction.bound import CorrectionBound
from hil.correction.compensation import Columns, Compensation, MotionHistory
from hil.correction.rise import DEAD_ZONE, EXPONENTIAL, STRAIGHT_PIECES, TANH, TWO_TANH, Rise
from hil.correction.streamed import StreamedCorrection
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet
from hil.effects import ALL, Form, NonLinear, Term
from hil.effects.cyclic import FORMS, FUNDAMENTAL, MODULATED, PER_DIRECTION
from hil.records.rows import Floats

BY_ID = {effect.id: effect for effect in ALL}
TRAVEL = {"centre_mm": 50.0, "half_span_mm": 50.0}
KNOWN = {"temp_screw_c": 24.5, "time_s": 10.0, "velocity_mm_s": 40.0, "pitch_urad": 7.0}
LOOSE = CorrectionBound(1e6, 1e6)
SAME_MM = 1e-12
ENDS_MM = np.array([0.0, 100.0])


def term(
    effect: str, form: str, inputs: tuple[str, ...], coefficients: tuple[float, ...], period_mm: float | None = None
) -> Term:
    theta = () if period_mm is None else (period_mm,)
    size = len(coefficients) + len(theta)
    nonlinear = () if period_mm is None else (NonLinear("period_mm", 0.1, 500.0),)
    return Term(
        BY_ID[effect], Form(effect, form, inputs, TRAVEL, nonlinear), theta, coefficients, ((0.0,) * size,) * size
    )


@dataclass(frozen=True)
class OfTheMotion:
    """A term of a user's own: time, feed, travel and stroke."""

    needs: tuple[str, ...] = ("target_mm", "direction", "time_s", "velocity_mm_s", "since_reversal_mm", "stroke_mm")

    def error_um(self, columns: Columns) -> Floats:
        winding = columns["direction"] * np.tanh(columns["since_reversal_mm"] / (1.0 + columns["stroke_mm"]))
        return winding + 1e-3 * columns["velocity_mm_s"] + 0.01 * columns["time_s"] + 1e-3 * columns["target_mm"]


TERMS = (
    term("cyclic", FUNDAMENTAL, ("target_mm",), (1.2, -0.5), 10.0),
    term("cyclic", "with second harmonic", ("target_mm",), (1.2, -0.5, 0.3, 0.7), 4.0),
    term("cyclic", MODULATED, ("target_mm",), (1.2, -0.5, 0.3, 0.7), 16.0),
    term("cyclic", PER_DIRECTION, ("target_mm", "direction"), (1.2, -0.5, 0.3, 0.7), 5.0),
    term("thermal_expansion", "temperature", ("temp_screw_c", "target_mm"), (11.0,)),
    term("backlash", "constant", ("direction",), (2.5,)),
    term("backlash_position", "linear", ("target_mm", "direction"), (1.5,)),
    term("backlash_position", "quadratic", ("target_mm", "direction"), (1.5, 0.4)),
    term("abbe", "tilt", ("pitch_urad",), (40.0,)),
    term("velocity_lag", "proportional", ("velocity_mm_s", "direction"), (0.1,)),
    OfTheMotion(),
    term("cyclic", "with third harmonic", ("target_mm",), (1.2, -0.5, 0.3, 0.7), 4.0),
    *(
        term("cyclic", name, ("target_mm",), (1.2, -0.5, 0.3, 0.7, 0.2, -0.1), 4.0)
        for name, both in FORMS.items()
        if all(both)
    ),
)
AMOUNTS, KNOTS = (5.0, 3.0), tuple(0.01 * 1.5**k for k in range(16))
RISES = (
    None,
    Rise(TWO_TANH, AMOUNTS, (0.2, 1.0, 0.5)),
    Rise(TWO_TANH, (0.0, 0.0), (0.2, 1.0, 0.5)),
    Rise(TANH, (6.0,), (0.3,)),
    Rise(EXPONENTIAL, (6.0,), (0.3,)),
    Rise(DEAD_ZONE, (6.0,), (0.3,)),
    Rise(STRAIGHT_PIECES, (0.5,) * 16, KNOTS),
)


@st.composite
def corrections(draw: st.DrawFn) -> Compensation:
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    mode = draw(st.sampled_from(list(TableMode)))

    def nodes() -> Floats:
        return np.unique(np.round(rng.uniform(0.0, 100.0, draw(st.integers(1, 8))), 3))

    def values(places: Floats) -> Floats:
        return rng.normal(0.0, 5.0, len(places))

    at = [nodes() for _ in range(4)]
    tables = TableSet(
        mode,
        DirectionalTable(at[0], values(at[0]), values(at[0])),
        SingleTable(at[1], values(at[1])),
        DirectionalTable(at[2], values(at[2]), values(at[2])) if draw(st.booleans()) else None,
        DirectionalTable(at[3], values(at[3]), values(at[3])) if draw(st.booleans()) else None,
    )
    terms = draw(st.lists(st.sampled_from(TERMS), max_size=3))
    return Compensation(tables, tuple(terms), draw(st.sampled_from(RISES)))


targets = st.lists(
    st.one_of(st.floats(-20.0, 120.0), st.integers(-20, 120).map(float), st.floats(49.9, 50.1)), min_size=1, max_size=40
)
bounds = st.one_of(st.just(LOOSE), st.builds(CorrectionBound, st.floats(1.0, 60.0), st.floats(0.5, 30.0)))


def outcome(compute: object) -> tuple[str, float]:
    """The words of what was raised, or a command."""
    try:
        return "", compute()  # type: ignore[operator]
    except BridgeError as error:
        return f"{type(error).__name__}: {error}", math.nan


@settings(max_examples=100)
@given(corrections(), targets, bounds, st.data())
def test_every_set_point_is_that_of_a_single_command(
    compensation: Compensation, targets_mm: list[float], bound: CorrectionBound, data: st.DataObject
) -> None:
    """Also after commands that were refused or not issued, and while the lost motion rises with the actual position."""
    history = MotionHistory(50.0, data.draw(st.sampled_from([-1, 0, 1]))).moved_to(
        data.draw(st.sampled_from([50.0, 60.0]))
    )
    by_estimate = data.draw(st.booleans())
    known = dict(KNOWN)
    points = StreamedCorrection(compensation, history, history.position_mm, known, bound, by_estimate=by_estimate)
    for number, target_mm in enumerate(targets_mm):
        known["time_s"] = 10.0 + number
        said, command_mm = outcome(lambda at=target_mm: points.command_mm(at))
        words, reference = outcome(
            lambda at=target_mm, so_far=history: (
                compensation.command(at, so_far, known, bound, points.actual).command_mm
            )
        )
        assert said == words
        if said or number % 7 == 5:  # not issued
            continue
        assert command_mm == pytest.approx(reference, rel=0, abs=SAME_MM)
        points.issued()
        history = history.moved_to(target_mm)
        assert points.history.turns_mm == history.turns_mm
        assert points.history.direction == history.direction
        assert points.history.position_mm == target_mm
        assert points.history.since_reversal_mm == pytest.approx(history.since_reversal_mm, abs=1e-9)
        assert points.history.stroke_or_long_mm == pytest.approx(history.stroke_or_long_mm, abs=1e-9)
        assert points.commanded_mm == pytest.approx(command_mm, rel=0, abs=SAME_MM)
        if by_estimate:
            points.actual = (points.actual or history).moved_to(target_mm - 0.01 * history.direction)


@settings(max_examples=30)
@given(corrections(), st.integers(0, 2**32))
def test_a_motion_in_fine_steps(compensation: Compensation, seed: int) -> None:
    """Strokes of all lengths, in each of which a thousand set-points are computed along one branch."""
    rng = np.random.default_rng(seed)
    known, history = dict(KNOWN), MotionHistory(50.0, 1)
    points = StreamedCorrection(compensation, history, 50.0, known, LOOSE)
    place_mm, sign = 50.0, 1.0
    for _ in range(6):
        sign = -sign
        for _ in range(rng.integers(1, 40)):
            place_mm += sign * float(rng.choice([0.003, 0.05, 0.7]))
            found_mm = points.command_mm(place_mm)
            wanted = compensation.command(place_mm, history, known, LOOSE)
            assert found_mm == pytest.approx(wanted.command_mm, rel=0, abs=SAME_MM)
            points.issued()
            history = wanted.history


def test_turns_that_no_motion_makes_wind_up_no_further_than_the_ends() -> None:
    """A loop of 30 mm within one of 0.1 mm: its rises add up to less than nothing."""
    tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(ENDS_MM, np.full(2, 6.0), np.zeros(2)))
    rising, history = (
        Compensation(tables, (), Rise(TANH, (6.0,), (0.3,))),
        MotionHistory(20.05, 1, 0.05, 30.1, (50.0, 50.1, 20.0)),
    )
    points = StreamedCorrection(rising, history, 20.05, {}, LOOSE)
    for target_mm in (20.1, 20.2, 21.0, 30.0):
        assert points.command_mm(target_mm) == rising.command(target_mm, history, {}, LOOSE).command_mm
    assert points.command_mm(20.1) == 20.1


@pytest.mark.parametrize("rise", RISES[1:], ids=lambda rise: rise.shape.name)
def test_a_settled_rise_is_its_amount_to_the_last_bit(rise: Rise) -> None:
    for travel_mm in (rise.settled_mm, rise.settled_mm * 1.01, 1e6):
        assert rise.risen_um(travel_mm) == rise.amount_um


# -- refused -----------------------------------------------------------------------------------------------------------


def level(um: float) -> TableSet:
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable.constant(ENDS_MM, um))


def stream(
    compensation: Compensation | None, known: dict[str, float] | None = None, direction: int = 1
) -> StreamedCorrection:
    return StreamedCorrection(
        compensation, MotionHistory(50.0, direction), 50.0, {} if known is None else known, CorrectionBound(10.0, 5.0)
    )


def test_what_a_stream_lacks_or_has_no_value_of_is_refused_before_it_begins() -> None:
    warm = Compensation(level(0.0), (TERMS[4],))
    with pytest.raises(StateError, match="temp_screw_c"):
        stream(warm)
    with pytest.raises(InputError, match="temp_screw_c"):
        stream(warm, {"temp_screw_c": math.nan})


def test_a_feed_that_is_no_number_is_refused_at_its_set_point() -> None:
    known = dict(KNOWN)
    points = stream(Compensation(level(0.0), (TERMS[9],)), known)
    assert points.follows_motion
    points.command_mm(50.1)
    known["velocity_mm_s"] = math.nan
    with pytest.raises(InputError, match="velocity_mm_s"):
        points.command_mm(50.2)


def test_along_a_branch_too_nothing_beyond_the_bound_is_commanded() -> None:
    """1 µm/mm from 8 µm at 50 mm: 10 µm, the bound, at 52 mm."""
    rising = DirectionalTable(ENDS_MM, np.array([-42.0, 58.0]), np.array([-42.0, 58.0]))
    points = stream(Compensation(TableSet(TableMode.BIDIRECTIONAL, rising)))
    for target_mm in (50.5, 51.0, 51.999):
        points.command_mm(target_mm)
        points.issued()
    with pytest.raises(CorrectionBoundError, match=r"\+10\.5 µm at 52\.5 mm"):
        points.command_mm(52.5)
    assert points.history.position_mm == 51.999


def test_a_wave_steeper_than_the_bound_is_refused_where_it_is_steep() -> None:
    """2.9 sin(π x) µm: 5.8 µm between half a millimetre before and after 52 mm."""
    wave = Compensation(level(0.0), (term("cyclic", FUNDAMENTAL, ("target_mm",), (2.9, 0.0), 2.0),))
    points = stream(wave)
    with pytest.raises(CorrectionBoundError, match=r"changes by 5\.8 µm"):
        points.command_mm(52.0)


@pytest.mark.parametrize("target_mm", [math.nan, math.inf, -math.inf])
def test_a_target_that_is_no_position_is_refused(target_mm: float) -> None:
    points = stream(Compensation(level(1.0)))
    with pytest.raises(InputError, match="finite"):
        points.command_mm(target_mm)


def test_an_unknown_direction_is_refused_unless_nothing_is_corrected() -> None:
    with pytest.raises(StateError, match="direction of arrival"):
        stream(Compensation(level(1.0)), direction=0).command_mm(50.0)
    uncorrected = stream(None, direction=0)
    assert uncorrected.command_mm(50.0) == 50.0
    uncorrected.issued()
    assert uncorrected.history == MotionHistory(50.0)
    assert uncorrected.command_mm(51.25) == 51.25


def test_what_another_axis_adds_is_part_of_the_motion_and_of_the_bound() -> None:
    points = stream(Compensation(level(6.0)))
    assert points.command_mm(60.0, 3.0) == pytest.approx(60.009)
    assert points.command_mm(60.0, -12.0) == pytest.approx(59.994)
    with pytest.raises(CorrectionBoundError, match=r"straightness not commanded: \+10\.5 µm at 60\.0045 mm"):
        points.command_mm(60.0, 4.5)


def test_an_ended_stream_gives_no_command_also_when_one_was_on_its_way() -> None:
    for target_mm in (51.0, 49.0):
        points = stream(Compensation(level(1.0)))
        points.command_mm(target_mm)
        points.end()
        points.issued()
        with pytest.raises(StateError, match="has ended"):
            points.command_mm(2.0 * target_mm - 50.0)
