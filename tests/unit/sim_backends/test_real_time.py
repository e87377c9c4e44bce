"""What a simulated part served on a real interface does by itself: keeps pace with a wall clock, and goes to and fro."""

from contextlib import closing

from pymodbus.client import ModbusTcpClient

from drivers.clock import NS_PER_S, Clock
from sim_backends.bench import Bench
from sim_backends.clock import SimClock
from sim_backends.machine import modbus_face, modbus_server
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.parameters import ideal_axis
from sim_backends.serve import Pace, Shuttle, ShuttleParameters, run_in_real_time
from sim_backends.servo import SimulatedServo


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


def test_a_request_that_comes_while_a_server_catches_up_is_answered_by_the_present() -> None:
    """Else a drive tells of a moment before readings of its instrument that come later."""
    wall = PretendedWall()
    with (
        Bench(wait_for_arrival=False) as bench,
        modbus_server(bench, wall, {1: modbus_face(bench, "cia402")}, tcp=("127.0.0.1", 0)) as (_, place),
    ):
        bench.servo.power_on()
        bench.servo.move_absolute(1_000_000, 1e6, 1e7)
        wall.now += NS_PER_S // 2
        host, port = place.removeprefix("tcp://").split(":")
        with closing(ModbusTcpClient(host, port=int(port))) as client:
            client.connect()
            shown = client.read_holding_registers(0x2002, count=2, device_id=1).registers
    counts = shown[0] << 16 | shown[1]
    assert bench.clock.now_ns() == NS_PER_S // 2
    assert counts == bench.servo.position_actual_counts > 300_000


# -- an axis that goes to and fro ----------------------------------------------------------------------------------
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
