"""The firmware: moves, stops, homes, supervises, faults; and does it the same for any step of simulated time."""

import numpy as np
import pytest

from drivers.errors import InputError
from sim_backends.bench import BenchParameters
from sim_backends.clock import SimClock
from sim_backends.faults import Fault, FaultKind
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.hysteresis import Backlash
from sim_backends.plant.parameters import PlantParameters, ideal_axis
from sim_backends.servo import FAULT_FOLLOWING_ERROR, ServoParameters, SimulatedServo

REV = 1_000_000


class Rig:
    """A servo on a clock."""

    def __init__(self, parameters: ServoParameters | None = None, *faults: Fault, step_s: float = 0.005) -> None:
        self.plant = FeedAxis(ideal_axis())
        self.servo = SimulatedServo(self.plant, parameters, faults)
        self.clock = SimClock(step_s)
        self.clock.attach(self.servo.advance)

    def until(self, name: str, limit_s: float = 60.0) -> float:
        start = self.clock.now_ns()
        while not getattr(self.servo, name):
            assert self.clock.now_ns() - start < limit_s * 1e9, f"{name} not within {limit_s} s"
            self.clock.sleep_s(0.01)
        return (self.clock.now_ns() - start) / 1e9


@pytest.mark.parametrize("step_s", [0.001, 0.005, 0.01])
def test_a_move_arrives_exactly_and_in_its_time(step_s: float) -> None:
    rig = Rig(step_s=step_s)
    rig.servo.power_on()
    rig.servo.move_absolute(10 * REV, 5.0 * REV, 20.0 * REV)
    assert not rig.servo.target_reached
    took_s = rig.until("target_reached")
    assert rig.servo.position_actual_counts == pytest.approx(10 * REV, abs=3)
    assert took_s == pytest.approx(2.25 + 0.15, abs=0.15)  # profile, then the lag's decay and the window
    rig.clock.sleep_s(1.0)
    assert rig.servo.position_actual_counts == 10 * REV
    assert rig.plant.motor_mm == 100.0
    assert rig.servo.velocity_actual_counts_s == 0


def test_following_error_is_the_lag_of_the_loop() -> None:
    rig = Rig(ServoParameters(position_gain_per_s=50.0, feed_forward=0.8))
    rig.servo.power_on()
    rig.servo.move_velocity(2.0 * REV, 50.0 * REV)
    rig.clock.sleep_s(1.0)
    assert rig.servo.target_reached
    assert rig.servo.velocity_actual_counts_s == pytest.approx(2.0 * REV, rel=1e-9)
    assert rig.servo.following_error_counts == pytest.approx(0.2 * 2.0 * REV / 50.0, abs=2)


def test_unpowered_takes_no_orders_and_demand_follows() -> None:
    rig = Rig()
    rig.servo.move_absolute(REV, REV, REV)
    rig.clock.sleep_s(1.0)
    assert rig.servo.position_actual_counts == 0
    rig.servo.power_on()
    rig.servo.move_velocity(2.0 * REV, 50.0 * REV)
    rig.clock.sleep_s(0.5)
    rig.servo.power_off()
    assert rig.servo.torque_actual_permille == 0
    at = rig.servo.position_actual_counts
    rig.clock.sleep_s(1.0)
    coasted = rig.servo.position_actual_counts - at
    assert coasted == pytest.approx(2.0**2 / 2 / 8.0 * REV, rel=0.05)  # it does not stop on the spot
    assert rig.servo.position_demand_counts == rig.servo.position_actual_counts
    rig.servo.power_on()
    rig.clock.sleep_s(0.5)
    assert rig.servo.position_actual_counts - at == coasted  # and does not jump back


def test_quick_stop_holds_until_resumed() -> None:
    rig = Rig()
    rig.servo.power_on()
    rig.servo.move_absolute(40 * REV, 10.0 * REV, 50.0 * REV)
    rig.clock.sleep_s(1.0)
    demand = rig.servo.position_demand_counts
    rig.servo.quick_stop(100.0 * REV)
    rig.clock.sleep_s(0.5)
    assert rig.servo.position_demand_counts - demand == pytest.approx(0.5 * REV, abs=2)
    rig.servo.move_absolute(0, REV, REV)
    rig.clock.sleep_s(0.5)
    assert rig.servo.stopping
    assert rig.servo.position_demand_counts - demand == pytest.approx(0.5 * REV, abs=2)
    rig.servo.resume()
    rig.servo.move_absolute(0, 10.0 * REV, 50.0 * REV)
    rig.until("target_reached")
    assert rig.servo.position_actual_counts == pytest.approx(0, abs=3)


@pytest.mark.parametrize(
    ("method", "home_counts"),
    [
        (1, 0.0),  # first index after leaving the negative limit switch at −0.5 rev
        (2, 50.0 * REV),
        (5, 0.0),
        (17, -0.5 * REV),
        (18, 50.5 * REV),
        (21, -0.2 * REV),
        (33, 3.0 * REV),
        (34, 4.0 * REV),
    ],
)
@pytest.mark.parametrize("step_s", [0.002, 0.01])
def test_homing_finds_its_edge_whatever_the_step(method: int, home_counts: float, step_s: float) -> None:
    rig = Rig(ServoParameters(start_counts=3.3 * REV), step_s=step_s)
    rig.servo.power_on()
    rig.servo.start_homing(method, 5.0 * REV, 0.2 * REV, 1234)
    assert not rig.servo.target_reached
    rig.until("homed", 120.0)
    assert rig.servo.target_reached
    shaft = rig.plant.motor_mm / 10.0 * REV
    assert rig.servo.position_actual_counts == pytest.approx(shaft - home_counts + 1234, abs=1)
    assert abs(shaft - home_counts) < 0.3 * REV  # and rests nearby


def test_a_switch_trips_a_little_elsewhere_each_time_and_an_index_pulse_does_not() -> None:
    rig = Rig(ServoParameters(start_counts=3.3 * REV, switch_spread_counts=1e-4 * REV))
    rig.servo.power_on()
    found: dict[int, list[float]] = {17: [], 1: []}
    for method in [17] * 30 + [1] * 3:
        rig.servo.start_homing(method, 5.0 * REV, 0.5 * REV, 0)
        rig.until("homed", 60.0)
        found[method].append(rig.plant.motor_mm / 10.0 * REV - rig.servo.position_actual_counts)
    assert np.mean(found[17]) == pytest.approx(-0.5 * REV, abs=0.6e-4 * REV)
    assert np.std(found[17]) == pytest.approx(1e-4 * REV, rel=0.4)
    assert found[1] == pytest.approx([0.0] * 3, abs=1.0)


@pytest.mark.parametrize("method", [1, 2, 5, 17, 18, 21])
def test_a_bench_leaves_its_builder_homing_to_its_nominal_zero(method: int) -> None:
    parameters = BenchParameters(homing_method=method)
    rig = Rig(ServoParameters(start_counts=3.3 * REV))
    rig.servo.power_on()
    objects = parameters.objects
    rig.servo.start_homing(objects[0x6098, 0], 5.0 * REV, 0.5 * REV, objects[0x607C, 0])
    rig.until("homed", 120.0)
    assert rig.servo.position_actual_counts == pytest.approx(rig.plant.motor_mm / 10.0 * REV, abs=1)
    assert parameters.vendor_settings["origin_offset"] == objects[0x607C, 0]


def test_homing_from_within_the_switch_only_leaves_it() -> None:
    rig = Rig(ServoParameters(start_counts=-0.3 * REV))
    rig.servo.power_on()
    assert rig.servo.home_switch
    rig.servo.start_homing(21, 5.0 * REV, 0.2 * REV, 0)
    assert rig.until("homed") < 3.0


def test_homing_here_and_now() -> None:
    rig = Rig(ServoParameters(start_counts=3.3 * REV))
    rig.servo.power_on()
    rig.servo.start_homing(37, REV, REV, 500)
    rig.until("homed")
    assert rig.servo.position_actual_counts == 500
    rig.servo.move_absolute(1500, REV, 10 * REV)
    rig.until("target_reached")
    assert rig.plant.motor_mm == pytest.approx((3.3 * REV + 1000) / 1e5, abs=1e-4)


def test_homing_on_a_switch_that_never_comes_is_an_error() -> None:
    rig = Rig(ServoParameters(start_counts=3.3 * REV))
    rig.servo.power_on()
    rig.servo.start_homing(19, 20.0 * REV, 0.2 * REV, 0)  # seeks upwards; the switch lies below
    rig.until("homing_error")
    rig.clock.sleep_s(1.0)
    assert not rig.servo.homed
    assert rig.servo.velocity_actual_counts_s == 0
    rig.servo.start_homing(99, REV, REV, 0)
    assert rig.servo.homing_error


def test_a_limit_switch_stops_the_axis_and_lets_it_back() -> None:
    rig = Rig(ServoParameters(start_counts=49.0 * REV))
    rig.servo.power_on()
    rig.servo.move_absolute(60 * REV, 5.0 * REV, 50.0 * REV)
    rig.clock.sleep_s(3.0)
    assert rig.servo.positive_limit_switch
    assert rig.servo.position_actual_counts < 50.7 * REV
    assert not rig.servo.target_reached
    assert rig.servo.fault_code == 0
    rig.servo.cyclic_position(52 * REV)
    rig.clock.sleep_s(0.1)
    assert rig.servo.position_actual_counts < 50.7 * REV
    rig.servo.move_absolute(49 * REV, 5.0 * REV, 50.0 * REV)
    rig.until("target_reached")
    assert not rig.servo.positive_limit_switch


def test_a_stream_is_followed_in_straight_lines() -> None:
    rig = Rig(step_s=0.001)
    rig.servo.power_on()
    for i in range(1, 501):
        rig.servo.cyclic_position(i * 2000)
        rig.clock.sleep_s(0.002)
    assert rig.servo.position_demand_counts == 1_000_000
    assert rig.servo.velocity_actual_counts_s == pytest.approx(1_000_000, rel=0.01)
    rig.clock.sleep_s(0.5)
    assert rig.servo.position_actual_counts == 1_000_000


def test_a_jam_ends_in_a_following_error_and_a_reset_leaves_it_off() -> None:
    rig = Rig(None, Fault(FaultKind.JAM, at_s=0.5, duration_s=10.0))
    rig.servo.power_on()
    rig.servo.move_absolute(40 * REV, 10.0 * REV, 50.0 * REV)
    rig.until("fault_code")
    assert rig.servo.fault_code == FAULT_FOLLOWING_ERROR
    assert not rig.servo.powered
    rig.servo.power_on()
    assert not rig.servo.powered
    rig.servo.reset_fault()
    assert rig.servo.fault_code == 0
    assert not rig.servo.powered


def test_a_drive_fault_comes_once_at_its_time_even_at_rest() -> None:
    rig = Rig(None, Fault(FaultKind.DRIVE_FAULT, at_s=2.0, size=0x4210))
    rig.servo.power_on()
    rig.clock.sleep_s(1.9)
    assert rig.servo.fault_code == 0
    rig.clock.sleep_s(0.2)
    assert rig.servo.fault_code == 0x4210
    rig.servo.reset_fault()
    rig.servo.power_on()
    rig.clock.sleep_s(5.0)
    assert rig.servo.powered


def test_torque_drives_a_free_motor() -> None:
    rig = Rig()
    rig.servo.power_on()
    rig.servo.cyclic_torque(300)
    rig.clock.sleep_s(0.2)
    assert rig.servo.velocity_actual_counts_s > REV
    rig.servo.cyclic_torque(-300)
    rig.clock.sleep_s(0.1)
    assert rig.servo.velocity_actual_counts_s < 20 * REV
    rig.servo.quick_stop(100 * REV)
    rig.clock.sleep_s(1.0)
    assert rig.servo.velocity_actual_counts_s == 0


def test_torque_shows_where_the_table_breaks_away() -> None:
    """Steps of 1 µm after a reversal: |torque| is largest about at the lost motion (CN103561904's principle)."""
    plant = FeedAxis(PlantParameters(backlash=Backlash(53.0)))
    servo = SimulatedServo(plant, ServoParameters(torque_noise_permille=0.0, cogging_permille=0.0))
    clock = SimClock()
    clock.attach(servo.advance)
    servo.power_on()
    servo.move_absolute(5 * REV, 5 * REV, 20 * REV)
    clock.sleep_s(3.0)
    torques = []
    for um in range(1, 81):
        servo.move_absolute(5 * REV - um * 100, REV // 100, REV)
        clock.sleep_s(0.3)
        torques.append(abs(servo.torque_actual_permille))
    peak = max(range(80), key=lambda i: torques[i]) + 1
    assert abs(peak - 53) <= 2
    assert min(torques) <= 3


def test_torque_never_exceeds_what_the_current_limit_allows() -> None:
    """However short a step of time a busy host leaves between two looks: a face has 16 bits for it."""
    rig = Rig(ServoParameters(position_gain_per_s=2000.0))
    rig.servo.power_on()
    rig.servo.move_velocity(10.0 * REV, 400.0 * REV)
    seen = []
    for number in range(40):
        rig.clock.sleep_s(1e-7 if number % 2 else 2e-3)
        seen.append(rig.servo.torque_actual_permille)
    assert max(map(abs, seen)) == 3000


def test_nonsense_parameters_are_refused() -> None:
    with pytest.raises(InputError, match="position_gain_per_s"):
        ServoParameters(position_gain_per_s=0.0)


def test_torque_noise_comes_and_goes() -> None:
    rig = Rig(None, Fault(FaultKind.TORQUE_NOISE, at_s=10.0, duration_s=10.0, size=20.0))
    rig.servo.power_on()
    spreads = []
    for _ in range(3):
        seen = []
        for _ in range(500):
            rig.clock.sleep_s(0.019)
            seen.append(rig.servo.torque_actual_permille)
        rig.clock.sleep_s(0.5)
        spreads.append(max(seen) - min(seen))
    assert spreads[0] < 12
    assert spreads[1] > 60
    assert spreads[2] < 12
