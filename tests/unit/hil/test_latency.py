"""The estimate of a latency on rows that are made up here: what it finds, how sure it says it is, and when it refuses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from drivers.errors import InputError
from hil.latency import DELAY, Latency, TimeShift, latency_at_edges, time_shift
from hil.records import Records


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
                    self._pass(rng, run, feed, way, np.linspace(start, start + 60.0, n)[::way]) for way in (1, -1)
                ]
        return Records.of({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})

    def _pass(
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


def test_lost_motion_is_no_latency() -> None:
    found = time_shift(Truth(late_s=0.0, lost_um=30.0).rows(1))
    assert abs(found.shift_s) < 2e-6
    assert found.lost_motion_um == pytest.approx(30.0, abs=0.3)


def test_what_rises_otherwise_than_in_proportion_shows() -> None:
    bent, straight = (time_shift(Truth(late_s=0.001, drag_um=drag).rows(3, runs=4)).straight for drag in (6.0, 0.0))
    assert (bent, straight) == (False, True)
    assert time_shift(Truth().rows(3, feeds=(20.0, 110.0))).straight is None


@pytest.mark.parametrize("feeds", [(60.0,), (60.0, 70.0)])
def test_one_feed_tells_nothing(feeds: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="cannot tell a latency from lost motion"):
        time_shift(Truth().rows(1, feeds=feeds))


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


def test_few_passes_are_worth_less() -> None:
    few, many = TimeShift(0.0, 1e-6, 1, 0.0), TimeShift(0.0, 1e-6, 30, 0.0)
    assert few.within_s > 6 * many.within_s


def test_it_says_what_it_holds() -> None:
    assert Latency(-1e-8, 2e-6, at_edges=False).describe() == (
        "latency 0.000 ± 0.002 ms (95 %), by passes up and down; a lag of the table behind its motor would be in it"
    )
    at_edges = Latency(0.02, 3e-6, at_edges=True, lag_s=2e-4, lag_within_s=1e-6)
    assert "the table is 0.200 ± 0.001 ms behind its motor" in at_edges.describe()
    assert at_edges.to_json()["lag_s"] == 2e-4
    assert set(Latency(0.02, 3e-6, at_edges=False).to_json()) == {"latency_s", "within_s", "at_edges"}
