"""Simulated time that follows a wall clock: keeps pace, catches up a little, forgets the rest."""

from drivers.clock import NS_PER_S, Clock
from sim_backends.clock import SimClock
from sim_backends.serve import Pace, run_in_real_time


class PretendedWall(Clock):
    """Sleeps at once; may be suspended in between."""

    def __init__(self) -> None:
        self.now = 17 * NS_PER_S
        self.suspend_ns = 0

    def check_interrupt(self) -> None:
        return

    def now_ns(self) -> int:
        return self.now

    def sleep_until_ns(self, time_ns: int) -> None:
        self.now = max(self.now, time_ns) + self.suspend_ns
        self.suspend_ns = 0


def test_simulated_time_keeps_pace() -> None:
    sim, wall = SimClock(), PretendedWall()
    sim.sleep_s(3.0)
    run_in_real_time(Pace(sim, wall), keep_running=lambda: wall.now < 19 * NS_PER_S)
    assert abs(sim.now_ns() - 5 * NS_PER_S) <= 10_000_000


def test_a_short_absence_is_caught_up_and_a_long_one_forgotten() -> None:
    sim, wall = SimClock(), PretendedWall()
    left = [100]

    def running() -> bool:
        left[0] -= 1
        if left[0] == 50:
            wall.suspend_ns = NS_PER_S // 2
        if left[0] == 20:
            wall.suspend_ns = 3600 * NS_PER_S
        return left[0] > 0

    run_in_real_time(Pace(sim, wall), keep_running=running)
    assert 1.9 * NS_PER_S < sim.now_ns() < 2.1 * NS_PER_S
