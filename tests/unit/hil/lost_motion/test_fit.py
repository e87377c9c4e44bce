"""The fit: parameters that were put in come out, the right shape wins on strokes it has not seen, and a real geared arm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.places import SHARED_DATA as DATA
from support.wind_up import WindUp, moved_to

from drivers.errors import InputError
from hil.correction.published_rise import TwoTanh
from hil.correction.rise import (
    DEAD_ZONE,
    EXPONENTIAL,
    RUNNABLE,
    STRAIGHT_PIECES,
    TANH,
    TWO_TANH,
    Floats,
    Rise,
    RiseShape,
)
from hil.lost_motion.fit import Contender, MeasuredReversal, compete, fit

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA} (set HIL_SHARED_DATA)")

TRAVEL_MM = np.linspace(0.0, 12.0, 200)


def two_tanh_um(s: Floats) -> Floats:
    return np.asarray(8.0 * np.tanh(s / 0.6) + np.where(s > 1.5, 4.0 * np.tanh((s - 1.5) / 1.2), 0.0))


def exponential_um(s: Floats) -> Floats:
    return np.asarray(12.0 * (1.0 - np.exp(-s / 1.1)))


def dead_zone_um(s: Floats) -> Floats:
    return np.asarray(np.where(s < 1.7, 12.0 * s / 1.7, 12.0))


def measured(rise_um: Callable[[Floats], Floats], direction: int, seed: int, slope: float = 0.2) -> MeasuredReversal:
    """A stroke as a laser sees it: the error falls behind the motion, on top of a table that is off by a slope, and noise."""
    noise = np.random.default_rng(seed).normal(0.0, 0.05, len(TRAVEL_MM))
    noise[0] = 0.0
    return MeasuredReversal(direction, TRAVEL_MM, 3.0 - direction * (rise_um(TRAVEL_MM) + slope * TRAVEL_MM) + noise)


@pytest.mark.parametrize("direction", [1, -1])
def test_the_five_parameters_come_back(direction: int) -> None:
    fitted = fit(TWO_TANH, [measured(two_tanh_um, direction, seed) for seed in (1, 2)])
    form = fitted.rise.form
    assert form.amount_1_um == pytest.approx(8.0, abs=0.1)
    assert form.amount_2_um == pytest.approx(4.0, abs=0.1)
    assert form.rise_1_mm == pytest.approx(0.6, abs=0.03)
    assert form.rise_2_mm == pytest.approx(1.2, abs=0.08)
    assert form.onset_2_mm == pytest.approx(1.5, abs=0.05)
    assert fitted.table_um_per_mm == pytest.approx(0.2, abs=0.02)
    assert [form.risen_um(s) for s in (0.3, 1.0, 3.0)] == pytest.approx(
        two_tanh_um(np.array([0.3, 1.0, 3.0])), abs=0.05
    )


@pytest.mark.parametrize(
    ("rise_um", "winner"), [(two_tanh_um, TWO_TANH), (exponential_um, EXPONENTIAL), (dead_zone_um, DEAD_ZONE)]
)
def test_on_strokes_held_out_whole_the_shape_that_is_true_wins(
    rise_um: Callable[[Floats], Floats], winner: object
) -> None:
    contenders = compete([measured(rise_um, d, seed) for seed, d in enumerate((1, -1, 1))], block_mm=0.3)
    assert contenders[0].fitted.shape is winner
    assert contenders[0].held_out_rms_um < 0.06  # the noise is 0.05
    assert contenders[-1].held_out_rms_um > 3.0 * contenders[0].held_out_rms_um


def test_a_held_out_stroke_is_not_seen() -> None:
    """One stroke is of another machine: held out it is far off, although a fit to both would be between them."""
    contender = compete([measured(exponential_um, 1, 1), measured(lambda s: 2.0 * exponential_um(s), 1, 2)], 0.3)[0]
    assert contender.held_out_rms_um > 1.8 * contender.rms_um


def test_with_a_table_in_force_no_slope_is_looked_for() -> None:
    level = fit(TWO_TANH, [measured(two_tanh_um, 1, 1, slope=0.0)], table=False)
    assert level.table_um_per_mm == 0.0
    assert level.rise.form.amount_um == pytest.approx(12.0, abs=0.05)
    tilted = [measured(two_tanh_um, 1, 1, slope=0.1)]
    assert fit(TWO_TANH, tilted, table=False).rise.form.amount_um > 12.4  # what the slope is there to keep out
    assert fit(TWO_TANH, tilted).rise.form.amount_um == pytest.approx(12.0, abs=0.15)


def test_after_a_short_stroke_only_rows_within_it_count() -> None:
    """Beyond it the axis is back on the branch before, which in the running form has nothing left to give."""
    form = TwoTanh(8.0, 0.0, 2.0, 2.0)
    state, _ = moved_to(form, WindUp(0.0, 1), -3.0)
    start = state.correction_um(form)
    assert start > 0.5  # not wound up fully
    error_um = []
    for s in TRAVEL_MM.tolist():
        state, correction = moved_to(form, state, -3.0 + s)
        error_um.append(start - correction)
    known = MeasuredReversal(1, TRAVEL_MM, np.array(error_um), stroke_mm=3.0)
    assert len(known.rise[0]) == np.count_nonzero(TRAVEL_MM <= 3.0)
    assert float(np.ptp(known.rise[1])) == pytest.approx(8.0 * np.tanh(1.5), abs=0.05)


def test_only_tanh_terms_make_a_form() -> None:
    assert Rise(TANH, (8.0,), (0.5,)).form == TwoTanh(8.0, 0.0, 0.5, 0.5)
    with pytest.raises(InputError, match="exponential is no sum of tanh terms"):
        _ = Rise(EXPONENTIAL, (8.0,), (0.5,)).form


@pytest.mark.parametrize(
    ("direction", "travel_mm", "error_um", "stroke_mm"),
    [
        (0, TRAVEL_MM, TRAVEL_MM, np.inf),
        (1, TRAVEL_MM, TRAVEL_MM[1:], np.inf),
        (1, -TRAVEL_MM, TRAVEL_MM, np.inf),
        (1, TRAVEL_MM, TRAVEL_MM * np.nan, np.inf),
        (1, TRAVEL_MM, TRAVEL_MM, 0.1),
        (1, 0.0 * TRAVEL_MM, TRAVEL_MM, np.inf),
    ],
)
def test_what_is_no_reversal_is_refused(direction: int, travel_mm: Floats, error_um: Floats, stroke_mm: float) -> None:
    with pytest.raises(InputError):
        MeasuredReversal(direction, travel_mm, error_um, stroke_mm)


def test_nothing_to_fit_and_blocks_that_hold_nothing_out_are_refused() -> None:
    with pytest.raises(InputError, match="no reversal"):
        fit(TANH, [])
    for block_mm in (0.0, 12.0, np.nan):
        with pytest.raises(InputError, match="blocks of"):
            compete([measured(exponential_um, 1, 1)], block_mm)


WITHIN, ALL = "the rows within the stroke before", "all rows after the turning"


def arm_reversal(name: str, rows: str) -> MeasuredReversal:
    """The forward stroke of a log, in degrees and thousandths of a degree: out against the motor's + direction, then back.

    The way back is a little longer than the way out. WITHIN leaves the rows beyond it out, as the arm is back on an earlier branch
    there; ALL takes every row from the turning to the end of the log.
    """
    _, motor_deg, load_deg = np.loadtxt(DATA / f"arm_reversal_{name}.csv", delimiter=",", skiprows=2, unpack=True)
    turn = int(np.argmin(motor_deg))
    error_mdeg = 1000.0 * (load_deg - motor_deg)
    stroke_deg = float(motor_deg[0] - motor_deg[turn]) if rows == WITHIN else np.inf
    return MeasuredReversal(1, np.abs(motor_deg[turn:] - motor_deg[turn]), error_mdeg[turn:], stroke_deg)


@needs_data
@pytest.mark.parametrize(
    ("log", "count", "winner", "held_out_mdeg"),
    [
        (("zeropos_forw", WITHIN), 544, TWO_TANH, 0.43),
        (("10pos_forward", WITHIN), 701, TWO_TANH, 0.68),
        (("10pos_forward", ALL), 875, STRAIGHT_PIECES, 0.68),
    ],
)
def test_a_real_arm(
    log: tuple[str, str],
    count: int,
    winner: RiseShape,
    held_out_mdeg: float,
    record_property: Callable[[str, object], None],
) -> None:
    """Each log has one reversal, so blocks of 10 mdeg of travel are held out, a third of the length it rises over.

    Near 10°, on all rows, no smooth shape holds: two tanh 0.79 mdeg, exponential 0.77. Straight pieces do. (Near 0° all 699 rows give
    two tanh 0.28.)
    """
    name, rows = log
    reversal = arm_reversal(name, rows)
    assert len(reversal.rise[0]) == count
    contenders = compete([reversal], block_mm=0.010, shapes=RUNNABLE)
    by_shape: dict[str, Contender] = {c.fitted.shape.name: c for c in contenders}
    for shape, contender in by_shape.items():
        record_property(f"{name}, {rows}, {shape}, held out, mdeg", round(contender.held_out_rms_um, 3))
    assert contenders[0].fitted.shape is winner
    assert contenders[0].held_out_rms_um <= held_out_mdeg
    assert by_shape["dead zone"].held_out_rms_um > 2.5 * contenders[0].held_out_rms_um
