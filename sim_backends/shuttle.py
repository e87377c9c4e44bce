"""An axis that moves to and fro by itself, for a simulated instrument that runs as a process without a drive."""

from __future__ import annotations

from dataclasses import dataclass

from sim_backends.servo import SimulatedServo


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
