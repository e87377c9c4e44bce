"""An axis that goes to and fro by itself."""

from sim_backends.clock import SimClock
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.parameters import ideal_axis
from sim_backends.serve import Shuttle, ShuttleParameters
from sim_backends.servo import SimulatedServo


def test_it_visits_every_step_both_ways_and_rests_there() -> None:
    servo, clock = SimulatedServo(FeedAxis(ideal_axis())), SimClock()
    shuttle = Shuttle(servo, ShuttleParameters(0, 3_000_000, 1_000_000, dwell_s=1.0))
    clock.attach(servo.advance)
    clock.attach(shuttle.advance)
    visited: list[int] = []
    for _ in range(1600):
        clock.sleep_s(0.01)
        at = servo.position_actual_counts
        if servo.target_reached and at % 1_000_000 == 0 and (not visited or visited[-1] != at):
            visited.append(at)
    assert visited[:7] == [0, 1_000_000, 2_000_000, 3_000_000, 2_000_000, 1_000_000, 0]


def test_a_fault_ends_it() -> None:
    servo, clock = SimulatedServo(FeedAxis(ideal_axis())), SimClock()
    clock.attach(servo.advance)
    clock.attach(Shuttle(servo).advance)
    clock.sleep_s(5.0)
    servo.raise_fault(0x4210)
    clock.sleep_s(2.0)
    at = servo.position_actual_counts
    servo.reset_fault()
    clock.sleep_s(10.0)
    assert servo.position_actual_counts == at
