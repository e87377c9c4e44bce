"""Simulated time that follows real time, and an axis that moves to and fro by itself.

For readers in other processes `run_in_real_time` lets the SimClock, with everything attached to it, follow the wall clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.clock import NS_PER_S, Clock
from sim_backends.clock import SimClock
from sim_backends.servo import SimulatedServo


class Pace:
    """Simulated time that follows a real clock, however irregularly `catch_up` is called.

    After a suspension of the host at most a second is caught up with; the rest is dropped, so that the machine does
    not run through hours at once. sleep: advances simulated time instead of the clock's, where that takes a lock. Lasers on this
    clock need wait_for_arrival=False.
    """

    def __init__(self, sim: SimClock, wall: Clock, *, sleep: Callable[[int], None] | None = None) -> None:
        self.wall = wall
        self._sim = sim
        self._sleep = sim.sleep_until_ns if sleep is None else sleep
        self._offset_ns = sim.now_ns() - wall.now_ns()

    def catch_up(self) -> None:
        """Advance simulated time to the present."""
        due_ns = self.wall.now_ns() + self._offset_ns
        behind_ns = due_ns - self._sim.now_ns()
        if behind_ns > NS_PER_S:
            self._offset_ns -= behind_ns - NS_PER_S
            due_ns = self._sim.now_ns() + NS_PER_S
        self._sleep(due_ns)


def run_in_real_time(
    pace: Pace,
    *,
    keep_running: Callable[[], bool],
    idle: Callable[[float], None] | None = None,
) -> None:
    """Keep the pace until `keep_running()` returns False (called every 5 ms).

    idle: called with the seconds left until the next call, instead of sleeping; may return early.
    """
    wall, period_ns = pace.wall, 5_000_000
    next_ns = wall.now_ns()
    while keep_running():
        pace.catch_up()
        now_ns = wall.now_ns()
        if now_ns >= next_ns:
            next_ns = max(next_ns + period_ns, now_ns)
        if idle is None:
            wall.sleep_until_ns(next_ns)
        else:
            idle((next_ns - now_ns) / NS_PER_S)


@dataclass(frozen=True)
class ShuttleParameters:
    """Between two positions, in steps of step_counts, with a dwell at each; speeds in counts/s and counts/s²."""

    low_counts: int = 0
    high_counts: int = 50_000_000
    step_counts: int = 2_500_000
    dwell_s: float = 2.0
    velocity_counts_s: float = 5e6
    acceleration_counts_s2: float = 4e7


class Shuttle:
    """Attach `advance` to the clock after the servo's. Powers the servo on, once; a fault ends the motion."""

    def __init__(self, servo: SimulatedServo, parameters: ShuttleParameters | None = None) -> None:
        self.parameters = parameters or ShuttleParameters()
        self._servo = servo
        self._started = False
        self._target = self.parameters.low_counts
        self._step = self.parameters.step_counts
        self._rested_s = 0.0

    def advance(self, now_ns: int, dt_s: float) -> None:
        """Order the next step once the axis has rested long enough."""
        servo, p = self._servo, self.parameters
        if not self._started:
            self._started = True
            servo.power_on()
            self._order()
        if not servo.powered or not servo.target_reached:
            self._rested_s = 0.0
            return
        self._rested_s += dt_s
        if self._rested_s >= p.dwell_s:
            if not p.low_counts <= self._target + self._step <= p.high_counts:
                self._step = -self._step
            self._target += self._step
            self._order()

    def _order(self) -> None:
        self._rested_s = 0.0
        p = self.parameters
        self._servo.move_absolute(self._target, p.velocity_counts_s, p.acceleration_counts_s2)
