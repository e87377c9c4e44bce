"""The fitted wind-up against curves made by hand, whose meeting point is known; against machines see the study beside it."""

from __future__ import annotations

import numpy as np
import pytest

from hil.backlash.result import Reversal, fitted_lost_motion, mean_um
from hil.backlash.torque_fit import fit_wind_up
from hil.backlash.trace import ReversalTrace

LEVEL = 8.0
HIDDEN_SHARE, HIDDEN_UM = 0.006, 0.3
"""What torque cannot show, by the study of machines with known guideways."""


def made(
    lost_um: float, *, direction: int = 1, end_um: float = 90.0, noise: float = 0.05, seed: int = 1
) -> ReversalTrace:
    """From −8 % straight up, past 8 % at `lost_um` to 8.6 %, down to 8 % within 3 µm. Noise in % of one reading, four each."""
    x = np.arange(0.0, end_um + 0.5)
    slope = 2.0 * LEVEL / lost_um
    peak_um = lost_um + 0.6 / slope
    t = np.where(x <= peak_um, -LEVEL + slope * x, LEVEL + 0.6 * np.exp(-(x - peak_um) / 1.5))
    readings = t[:, None] + np.random.default_rng(seed).normal(0.0, noise, (len(x), 4))
    return ReversalTrace(direction, 100.0 + direction * x / 1000.0, direction * readings)


@pytest.mark.parametrize("lost_um", [22.0, 36.0, 53.0, 60.0])
@pytest.mark.parametrize("direction", [1, -1])
def test_it_finds_where_flank_and_level_meet_and_not_the_peak(lost_um: float, direction: int) -> None:
    fit = fit_wind_up(made(lost_um, direction=direction))
    assert fit is not None
    assert fit.lost_motion_um == pytest.approx(lost_um, abs=3.0 * fit.chance_um)
    assert fit.chance_um < 0.2, "noise, and the rounding of 6077h, which it cannot know to be absent here"
    assert fit.peak_um > lost_um
    assert fit.level_percent == pytest.approx(LEVEL, abs=0.05)
    assert fit.u_um == pytest.approx(
        np.sqrt(fit.chance_um**2 + (HIDDEN_SHARE * fit.lost_motion_um) ** 2 + HIDDEN_UM**2)
    )
    assert float(fit.flank_percent(np.array([lost_um]))[0]) == pytest.approx(LEVEL, abs=0.2)


def test_its_chance_is_what_it_really_scatters_by() -> None:
    fits = [fit for seed in range(80) if (fit := fit_wind_up(made(45.0, noise=0.12, seed=seed))) is not None]
    assert len(fits) == 80
    scatter = float(np.std([fit.lost_motion_um for fit in fits]))
    assert float(np.mean([fit.chance_um for fit in fits])) == pytest.approx(scatter, rel=0.35)


@pytest.mark.parametrize(
    ("what", "trace"),
    [
        ("it has not broken away yet", made(53.0, end_um=50.0)),
        ("too little sliding to know its level", made(53.0, end_um=62.0)),
        ("three places", made(53.0, end_um=3.0)),
        ("one place", made(53.0, end_um=0.0)),
        (
            "a clearance without torque",
            ReversalTrace(1, np.arange(60) / 1000.0, np.vstack([np.full((1, 2), -LEVEL), np.full((59, 2), 0.1)])),
        ),
        ("torque that only falls", ReversalTrace(1, np.arange(60) / 1000.0, np.linspace(9, 5, 60)[:, None])),
    ],
)
def test_without_a_wind_up_that_ends_in_sliding_it_finds_nothing(what: str, trace: ReversalTrace) -> None:
    assert fit_wind_up(trace) is None, what


def test_noise_alone_is_no_wind_up() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        trace = ReversalTrace(1, np.arange(100) / 1000.0, rng.normal(0.0, 0.1, (100, 4)))
        assert fit_wind_up(trace) is None


def test_a_reversal_keeps_what_it_was_given() -> None:
    trace = made(53.0)
    before = trace.torque_percent.copy(), trace.position_load_mm.copy()
    fit_wind_up(trace)
    assert np.array_equal(trace.torque_percent, before[0])
    assert np.array_equal(trace.position_load_mm, before[1])


def test_the_mean_is_that_of_the_directions_measured_and_needs_each_of_their_values() -> None:
    up = [Reversal.of(1, made(50.0)), Reversal.of(2, made(52.0, seed=2))]
    down = [Reversal.of(1, made(40.0, direction=-1))]
    for method in ("fitted", "four-sample"):
        one_way = [mean_um(up + down, method, [direction]) for direction in (1, -1)]
        assert mean_um(up + down, method) == pytest.approx(np.mean([value for value in one_way if value is not None]))
    assert mean_um(up + down, "fitted") == pytest.approx(45.5, abs=0.3)
    assert mean_um(up, "fitted") is None
    assert mean_um(up, "fitted", [1]) == mean_um(up + down, "fitted", [1]) is not None
    alone, both = fitted_lost_motion(up, [1]), fitted_lost_motion(up + down)
    assert alone is not None
    assert both is not None
    assert alone.u95_um > both.u95_um
    assert mean_um([*up, *down, Reversal.of(3, made(53.0, end_um=30.0))], "fitted") is None


def test_runs_that_scatter_more_than_their_fits_say_count_for_more() -> None:
    calm = [Reversal.of(run, made(50.0, direction=d, seed=run)) for run in (1, 2, 3) for d in (1, -1)]
    wild = [Reversal.of(run, made(50.0 + 4 * (run - 2), direction=d, seed=run)) for run in (1, 2, 3) for d in (1, -1)]
    found = [fitted_lost_motion(each) for each in (calm, wild)]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].mean_um == pytest.approx(50.0, abs=found[0].u95_um)
    assert found[0].u95_um == pytest.approx(1.96 * np.hypot(HIDDEN_SHARE * 50.0, HIDDEN_UM), rel=0.1)
    assert found[1].u95_um > 4.0 * found[0].u95_um
