"""The estimate of a latency on rows that are made up here: what it finds, how sure it says it is, and when it refuses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from drivers.errors import InputError
from hil.figures.latency import DELAY, Latency, TimeShift, check_feeds, latency_at_edges, latency_by_passes, time_shift
from hil.records.rows import Records


@dataclass(frozen=True)
class Truth:
    """An axis, sampled in passes up and down. late_s: its readings; trail_s: the table; lost_um: at a reversal; drag_um: more of that
    at 100 mm/s, rising with the square of the feed; clock_s: doubt of each pass's dates."""

    late_s: float = 0.02
    trail_s: float = 0.0
    lost_um: float = 8.0
    drag_um: float = 0.0
    noise_um: float = 0.1
    clock_s: float = 0.0

    def rows(self, seed: int, feeds: tuple[float, ...] = (20.0, 60.0, 110.0), runs: int = 3, n: int = 30) -> Records:
        rng = np.random.default_rng(seed)
        parts = []
        for run in range(1, runs + 1):
            for feed in feeds:
                start = rng.uniform(20.0, 400.0)
                parts += [
                    self.one_pass(rng, run, feed, way, np.linspace(start, start + 60.0, n)[::way]) for way in (1, -1)
                ]
        return Records.of({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})

    def one_pass(
        self, rng: np.random.Generator, run: int, feed: float, way: int, motor_mm: np.ndarray
    ) -> dict[str, np.ndarray]:
        """What is read when the drive is found at these places."""
        n = len(motor_mm)
        off_s = rng.normal(0.0, self.clock_s) if self.clock_s else 0.0
        then_mm = motor_mm - way * feed * (self.late_s + off_s)
        error_um = 12.0 * np.sin(then_mm / 45.0) + 1.5 * np.sin(then_mm * 2.0 * np.pi / 10.0)
        error_um -= way * (self.lost_um / 2.0 + 1000.0 * feed * self.trail_s + self.drag_um * (feed / 100.0) ** 2)
        measured_mm = then_mm + (error_um + rng.normal(0.0, self.noise_um, n)) / 1000.0
        return {
            "run": np.full(n, float(run)),
            "direction": np.full(n, float(way)),
            "target_mm": motor_mm,
            "measured_mm": measured_mm,
            "motor_mm": motor_mm,
            "velocity_mm_s": np.full(n, feed),
            DELAY: np.full(n, self.late_s + off_s),
        }


@pytest.mark.parametrize("late_s", [-0.001, 0.0, 0.02])
def test_a_latency_is_found_as_closely_as_is_said(late_s: float) -> None:
    found = [time_shift(Truth(late_s=late_s, clock_s=2e-5).rows(seed)) for seed in range(30)]
    off = np.array([one.shift_s for one in found]) - late_s
    inside = np.mean([abs(error) <= one.within_s for error, one in zip(off, found, strict=True)])
    assert inside >= 0.8, "95 % are said, of 30"
    assert np.median([one.within_s for one in found]) < 5e-5, "and what is said is worth something"
    assert abs(off.mean()) < 5e-6


def test_what_rises_otherwise_than_in_proportion_shows() -> None:
    bent, straight = (time_shift(Truth(late_s=0.001, drag_um=drag).rows(3, runs=4)).straight for drag in (6.0, 0.0))
    assert (bent, straight) == (False, True)
    assert time_shift(Truth().rows(3, feeds=(20.0, 110.0))).straight is None


def test_a_table_that_trails_is_one_with_the_latency_on_the_fly_and_apart_from_it_at_edges() -> None:
    trailing = Truth(late_s=0.02, trail_s=0.0004)
    assert time_shift(trailing.rows(1)).shift_s == pytest.approx(0.0204, abs=2e-5)
    at_edges = Truth(late_s=0.0, trail_s=0.0004).rows(1)
    rng = np.random.default_rng(5)
    delays = np.repeat(rng.normal(0.02, 1e-4, len(at_edges) // 30), 30)
    found = latency_at_edges(Records.of({**at_edges.columns, DELAY: delays}))
    assert abs(found.latency_s - 0.02) <= found.within_s < 2e-4
    assert abs(found.lag_s - 0.0004) <= max(found.lag_within_s, 1e-6)
    assert "behind its motor" in found.describe()


def passes(halves_um: dict[tuple[int, float], float], rows: int = 3) -> Records:
    """Passes from 0 to 100 mm, up ahead of the motor by half_um and down behind it by as much."""
    columns: dict[str, list[float]] = {
        name: [] for name in ("run", "direction", "target_mm", "measured_mm", "motor_mm", "velocity_mm_s")
    }
    for (run, feed), half_um in halves_um.items():
        for way in (1.0, -1.0):
            for place in np.linspace(0.0, 100.0, rows)[:: int(way)]:
                values = (run, way, place, place + way * half_um / 1000.0, place, feed)
                for name, value in zip(columns, values, strict=True):
                    columns[name].append(value)
    return Records.of(columns)


def test_the_line_over_feeds_by_hand() -> None:
    """Halves -4 -8 -9 -13 µm at 10 20 30 40 mm/s. About the means 25 and -8.5: Σff = 500, Σfh = -67.5 - 2.5 - 2.5 - 67.5 = -140.

    Slope -0.28 µm per mm/s: 0.28 ms late; at rest -8.5 + 7 = -1.5, so 3 µm lost. Residuals 0.3 -0.9 0.9 -0.3, squares 1.8;
    slope's σ as if all were equal √(1.8/2/500) = 0.0424264; with leverage .7 .3 .3 .7 removed, own squares 1 1.65306 1.65306 1:
    √(Σ (f-25)²·own)/500 = √(225·2 + 25·3.30612)/500 = 0.0461586. The larger counts. 2 degrees of freedom: 4.30265 of it.
    """
    found = time_shift(passes({(1, 10.0): -4.0, (1, 20.0): -8.0, (1, 30.0): -9.0, (1, 40.0): -13.0}))
    assert found.shift_s == pytest.approx(0.28e-3)
    assert found.lost_motion_um == pytest.approx(3.0)
    assert (found.freedom, found.straight) == (2, True)
    assert found.std_s == pytest.approx(0.0461586e-3, rel=1e-4)
    assert found.within_s == pytest.approx(4.30265 * 0.0461586e-3, rel=1e-4)


def test_where_equal_weights_say_more() -> None:
    """Halves -3 -7 -3 at 10 20 30: slope 0; residuals 4/3 -8/3 4/3, squares 10.667; √(10.667/1/200) = 0.23094.

    Leverage 5/6 1/3 5/6: own squares 64 and 16 and 64 at ±10: √(128·100)/200 = 0.5657, the larger; feeds three, pairs three:
    whether they lie on a line cannot be told, a parabola goes through all.
    """
    found = time_shift(passes({(1, 10.0): -3.0, (1, 20.0): -7.0, (1, 30.0): -3.0}))
    assert (found.shift_s, found.lost_motion_um) == (pytest.approx(0.0, abs=1e-12), pytest.approx(26 / 3))
    assert found.std_s == pytest.approx(0.565685e-3, rel=1e-4)
    assert (found.freedom, found.straight) == (1, None)
    # halves -1 -3 -1 -3 at 10 10 30 30: no slope, residuals ±1: √(4/2/400) = 0.070711; own 1/(1/2)² = 4: √(4·4·100)/400 = 0.1
    found = time_shift(passes({(1, 10.0): -1.0, (2, 10.0): -3.0, (1, 30.0): -1.0, (2, 30.0): -3.0}))
    assert found.std_s == pytest.approx(0.1e-3)
    assert found.straight is None  # two feeds


def test_the_scatter_at_the_middle_feed_says_nothing_of_the_slope_by_itself() -> None:
    """0 and 0 at 10 and 30 mm/s, ±1 µm at 20: Σff = 200, Σr² = 2 over 2 degrees: √(1/200) = 0.0707107 as if all were equal."""
    found = time_shift(passes({(1, 10.0): 0.0, (1, 30.0): 0.0, (1, 20.0): 1.0, (2, 20.0): -1.0}))
    assert found.std_s == pytest.approx(0.0707107e-3, rel=1e-5)


@pytest.mark.parametrize(("bend_um", "straight"), [(1.7, True), (1.85, False)])
def test_where_a_bend_begins(bend_um: float, straight: bool) -> None:
    """Bend times f² for f = 1 … 5, and -1 2 0 -2 1 tenths of a µm that no parabola follows. Leverage .885714 .371429 .485714 …

    Own squares 1/.114286² = 76.5625 and 4/.628571² = 10.1240 tenths²: √((2·4·76.5625 + 2·10.1240)/14²) = 1.79687 tenths;
    t(2) at 0.995 is 9.92484: up to 1.78337 µm.
    """
    off = (-0.1, 0.2, 0.0, -0.2, 0.1)
    assert time_shift(passes({(1, 10.0 * f): bend_um * f * f + off[f - 1] for f in range(1, 6)})).straight is straight


def test_pairs_that_cannot_be_compared_are_left_out() -> None:
    """A pass of one row, a stretch that only one way covers, and a feed that was gone one way only."""
    good = {(1, 10.0): -4.0, (1, 20.0): -8.0, (1, 40.0): -16.0}
    whole = passes(good)
    assert time_shift(whole).shift_s == pytest.approx(0.4e-3)
    lone = passes({(2, 30.0): 99.0})
    for left in (
        lone.where((lone.direction > 0) | (lone["motor_mm"] == 0.0)),  # one row back
        lone.where(lone.direction > 0),
        lone.where(
            ((lone.direction > 0) & (lone["motor_mm"] < 60)) | ((lone.direction < 0) & (lone["motor_mm"] >= 50))
        ),
    ):
        both = Records.of({name: np.concatenate([whole[name], left[name]]) for name in whole.columns})
        assert time_shift(both).shift_s == pytest.approx(0.4e-3)
    barely = lone.where(lone["motor_mm"] <= 50.0)  # two rows each way are enough
    both = Records.of({name: np.concatenate([whole[name], barely[name]]) for name in whole.columns})
    # -4 -8 99 -16 at 10 20 30 40: Σfh about 25 mm/s = 60 + 40 + 495 - 240 = 355, / 500
    assert time_shift(both).shift_s == pytest.approx(-0.71e-3)


def test_feeds_that_tell_something() -> None:
    check_feeds([20.0, 20.0, 30.0])
    for feeds in ([20.0, 30.0], [20.0, 20.0, 29.9]):
        with pytest.raises(InputError, match="cannot tell"):
            check_feeds(feeds)


def test_latency_at_edges_by_hand() -> None:
    """Delays 19 21 20 20 20 20 20 20 ms by pass: mean 20, s = √(2/7) = 0.534522 ms; t(7) = 2.36462: ± 2.36462·0.534522/√8 ms."""
    rows = passes({(1, 10.0): -4.0, (1, 20.0): -8.0, (1, 30.0): -12.0, (1, 40.0): -16.0})
    delays = np.repeat([0.019, 0.021, 0.02, 0.02, 0.02, 0.02, 0.02, 0.02], 3)
    found = latency_at_edges(Records.of({**rows.columns, DELAY: delays}))
    assert found.latency_s == pytest.approx(0.020)
    assert found.within_s == pytest.approx(0.446876e-3, rel=1e-5)
    assert found.at_edges
    assert found.lag_s == pytest.approx(0.4e-3)
    assert found.straight is True
    steady = latency_at_edges(Records.of({**rows.columns, DELAY: np.full(24, 0.02)}))
    assert steady.within_s == pytest.approx(2e-6, rel=1e-3)  # no closer was the arrival looked for
    one = rows.where((rows.direction > 0) & (rows["velocity_mm_s"] == 10.0))
    with pytest.raises(InputError, match="1 pass"):
        latency_at_edges(Records.of({**one.columns, DELAY: np.full(3, 0.02)}))


def test_what_was_left_is_added_to_what_rows_were_dated_by() -> None:
    """t(4) = 2.77645 of 1 µs, with 2 µs for the arrival: √(2.77645² + 4) = 3.42181 µs."""
    found = latency_by_passes(0.020, TimeShift(-0.003, 1e-6, 4, 0.0, straight=False))
    assert found.latency_s == pytest.approx(0.017)
    assert found.within_s == pytest.approx(3.42181e-6, rel=1e-5)
    assert (found.at_edges, found.straight) == (False, False)
    assert "0.017" not in found.describe()
    assert found.describe().startswith("latency 17.000 ± 0.003 ms")


def test_it_says_what_it_holds() -> None:
    assert Latency(-1e-8, 2e-6, at_edges=False).describe() == (
        "latency 0.000 ± 0.002 ms (95 %), by passes up and down; a lag of the table behind its motor would be in it"
    )
    at_edges = Latency(0.02, 3e-6, at_edges=True, lag_s=2e-4, lag_within_s=1e-6)
    assert "the table is 0.200 ± 0.001 ms behind its motor" in at_edges.describe()
    assert at_edges.to_json()["lag_s"] == 2e-4
    assert set(Latency(0.02, 3e-6, at_edges=False).to_json()) == {"latency_s", "within_s", "at_edges"}
