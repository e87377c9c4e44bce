"""A session whose instrument or motor lies with a good status: the axis stops within a stated travel, and the figures are told."""

# ruff: noqa: PT012 - leaving the session is part of what raises, so whole sessions stand under raises()
from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace

import pytest
from support.toy_axis import MEASUREMENT, ToyDrive, ToyInstrument, ToyMachine, Trouble, toy_session

from drivers.clock import NS_PER_S
from drivers.drive import DriveState
from drivers.errors import MeasurementLostError, MotionTimeoutError, OverspeedError, SafetyError
from drivers.instrument import Reading, ReadingStatus
from drivers.instruments.ascii_values import AsciiDecoder, AsciiSettings
from drivers.instruments.gauge import Gauge
from drivers.instruments.serial_link import SerialLink
from drivers.instruments.umd_laser import UmdLaser
from drivers.set_points import SetPointSettings
from hil.axis.agreement import AgreementLimits
from hil.machine.instrument_check import Agreement
from hil.machine.motion_checks import Overspeed
from hil.machine.session import AxisSession
from hil.machine.time_out import Motion
from sim_backends.bench import Bench, BenchParameters
from sim_backends.plant.parameters import geometric_axis
from sim_backends.virtual_drive import VirtualDrive


def stopped_after_mm(
    trouble: Callable[[float], Trouble], words: str, error: type[SafetyError], *, speed: float = 50.0
) -> float:
    """A long move during which it begins: how far the motor went on."""
    machine = ToyMachine()
    with pytest.raises(error, match=words), toy_session(machine) as session:
        session.prepare()
        begins_s = machine.now_s + 0.5
        machine.trouble = trouble(begins_s)
        try:
            session.move_to(100.0, speed)
        finally:
            assert machine.told("quick stop"), "stopped before anybody hears of it"
            went_mm = machine.motor_mm - speed * 0.5
    assert machine.state is DriveState.SWITCH_ON_DISABLED
    return went_mm


def test_an_instrument_that_stands_still_while_the_motor_travels_is_lost() -> None:
    """Status good, samples counted: 0.7 mm allowed, and 0.35 s for what its moments are known to."""
    went_mm = stopped_after_mm(
        lambda at: Trouble(frozen_readings_at_s=at), "stands still, whatever", MeasurementLostError
    )
    assert 0.7 < went_mm < 0.7 + 0.35 * 50.0
    slowly_mm = stopped_after_mm(
        lambda at: Trouble(frozen_readings_at_s=at), "stands still, whatever", MeasurementLostError, speed=2.0
    )
    assert 0.7 < slowly_mm < 0.7 + 0.35 * 2.0


@pytest.mark.parametrize("jump_mm", [1580.0, -25.0, 6.0, -9.0])
def test_a_jump_is_told_at_once(jump_mm: float) -> None:
    went_mm = stopped_after_mm(
        lambda at: Trouble(jump_at_s=at, jump_mm=jump_mm), "changed by|jumped|runs against", MeasurementLostError
    )
    assert went_mm <= 0.06 * 50.0


def test_a_jump_at_rest_becomes_no_row() -> None:
    for jump_mm in (1.0, -1.0):
        machine = ToyMachine()
        with (
            pytest.raises(MeasurementLostError, match=r"jumped by -?1\.0\d\d mm.*: it saw"),
            toy_session(machine) as session,
        ):
            session.prepare()
            session.move_to(50.0)
            machine.trouble = Trouble(jump_at_s=machine.now_s + 0.15, jump_mm=jump_mm)
            session.read_position()


def test_a_jump_that_is_smaller_than_what_the_axis_file_states_is_let_pass_and_none_that_is_larger() -> None:
    for within_um, good in ((2000.0, True), (300.0, False)):
        machine = ToyMachine()
        limits = AgreementLimits(within_um, 50.0)
        session = AxisSession(ToyDrive(machine), ToyInstrument(machine), MEASUREMENT, agreement=limits)
        with session:
            session.prepare()
            machine.trouble = Trouble(jump_at_s=machine.now_s, jump_mm=0.25)
            session.move_to(50.0)
            if good:
                session.read_position()
            else:
                with pytest.raises(MeasurementLostError, match=r"travelled.* allowed is a difference of 0\.13\d mm"):
                    session.read_position()


def test_a_direction_that_is_the_wrong_way_round_is_caught_in_the_first_move_after_homing() -> None:
    machine = ToyMachine(trouble=Trouble(instrument_sense=-1))
    with (
        pytest.raises(MeasurementLostError, match=r"runs against the motor \(\[instrument\] direction"),
        toy_session(machine, reference_mm=60.0) as session,
    ):
        session.prepare()
    assert machine.motor_mm < -2.0 + 0.25 * 50.0, "the way to the reference had just begun"


@pytest.mark.parametrize(
    ("play_mm", "reversal_um", "words"),
    [(0.19, 200.0, ""), (0.6, 600.0, ""), (0.6, 200.0, "jumped by .* travelled"), (0.9, 200.0, "stands still")],
)
def test_play_within_the_stated_reversal_is_waited_for(play_mm: float, reversal_um: float, words: str) -> None:
    machine = ToyMachine(play_mm=play_mm, wave_um=0.0)
    limits = AgreementLimits(largest_reversal_um=reversal_um)
    session = AxisSession(ToyDrive(machine), ToyInstrument(machine), MEASUREMENT, agreement=limits)
    with pytest.raises(MeasurementLostError, match=words) if words else nullcontext(), session:
        session.prepare()
        session.move_to(50.0)
        session.move_to(20.0)
        session.read_position()
        session.move_to(19.9)
        session.move_to(20.1)
        session.read_position()


@pytest.mark.parametrize("jump_mm", [0.45, -0.45, 0.07])
@pytest.mark.parametrize("jump_after_s", [0.06, 0.13, 0.4])
def test_a_step_within_the_stated_difference_is_none_of_a_motor_that_stands(
    jump_mm: float, jump_after_s: float
) -> None:
    machine = ToyMachine()
    with pytest.raises(MeasurementLostError, match=r"jumped by .* stands"), toy_session(machine) as session:
        session.prepare()
        session.move_to(50.0)
        session.watch(0.2)
        machine.trouble = Trouble(jump_at_s=machine.now_s + jump_after_s, jump_mm=jump_mm)
        session.watch(jump_after_s + 0.25)


@pytest.mark.parametrize("readings", [1, 2, 3])
def test_few_readings_of_which_some_are_beside_the_others_become_no_row(readings: int) -> None:
    """No rule for outliers holds for eight readings; two of them would make 112 µm of 450."""
    machine = ToyMachine()
    beside = pytest.raises(MeasurementLostError, match=r"jumped by|readings of one position differ by 0\.450 mm")
    with beside, toy_session(machine, reading_s=0.08, dwell_s=0.3) as session:
        session.prepare()
        session.move_to(50.0)
        machine.trouble = Trouble(jump_at_s=machine.now_s + 0.385 - 0.01 * readings, jump_mm=0.45)
        session.read_position()


@pytest.mark.parametrize(("held_up_s", "jump_mm", "good"), [(0.3, 0.0, True), (0.0, 0.0, True), (0.3, 60.0, False)])
def test_a_host_that_is_held_up_makes_no_jump(held_up_s: float, jump_mm: float, good: bool) -> None:
    """A motor position that was there at once, and is dated only when the host comes round to it; 100 mm/s."""
    agreement = Agreement(AgreementLimits(latency_s=0.01), 100.0)

    def look(taken_s: float, dated_s: float, since_s: float, jump_mm: float = 0.0) -> str | None:
        agreement.motor_at(round(dated_s * NS_PER_S), 100.0 * taken_s, since_ns=round(taken_s * NS_PER_S))
        seen_s = dated_s - 0.02
        reading = Reading(
            round(dated_s * NS_PER_S), ReadingStatus.GOOD, 100.0 * seen_s + jump_mm, 1, 0, round(since_s * NS_PER_S)
        )
        return agreement.compare(reading, 100.0)

    for number in range(1, 20):
        assert look(0.05 * number, 0.05 * number, 0.05 * (number - 1)) is None
    assert (look(1.0, 1.0 + held_up_s, 0.95, jump_mm) is None) is good


class SlowTerminal:
    """A gauge's line on a computer whose kernel takes `takes_s` to hand on what has come, from `at_s` on; asked or unasked."""

    def __init__(self, machine: ToyMachine, *, asked: bool, takes_s: float, jump_mm: float) -> None:
        self.machine, self.asked, self.takes_s, self.jump_mm = machine, asked, takes_s, jump_mm
        self.at_s = math.inf
        self.requests = 0

    def open(self) -> None: ...
    def close(self) -> None: ...
    def write(self, _data: bytes) -> None:
        self.requests += 1

    def read_waiting(self) -> bytes:
        jump_mm = 0.0
        if self.machine.now_s >= self.at_s:
            self.machine.clock.sleep_s(self.takes_s)
            jump_mm = self.jump_mm
        came, self.machine.readings = self.machine.readings, []
        lines = [f"{(reading.position_mm or math.nan) + jump_mm:+.4f}\n".encode() for reading in came]
        if not self.asked:
            return b"".join(lines)
        answer = lines[-1:] if self.requests else []
        self.requests -= len(answer)
        return b"".join(answer)


@pytest.mark.parametrize(("takes_s", "jump_mm"), [(0.0, 0.0), (0.3, 0.0), (0.6, 0.0), (0.0, 40.0), (0.3, 80.0)])
@pytest.mark.parametrize("asked", [True, False])
def test_a_reading_is_as_late_as_the_kernel_hands_it_on(asked: bool, takes_s: float, jump_mm: float) -> None:
    """At 100 mm/s the axis moves 30 mm while this process waits in `read`: what it reads then is of the end of the wait."""
    machine = ToyMachine()
    line = SlowTerminal(machine, asked=asked, takes_s=takes_s, jump_mm=jump_mm)
    gauge = Gauge(line, machine.clock, AsciiDecoder(AsciiSettings(request=b"?" if asked else b"")))
    lost = pytest.raises(MeasurementLostError, match=r"changed by|does not follow|jumped") if jump_mm else nullcontext()
    with lost, AxisSession(ToyDrive(machine), gauge, MEASUREMENT) as session:
        session.prepare()
        line.at_s = machine.now_s + 0.5
        session.move_to(100.0, 100.0)
        line.at_s = math.inf


@pytest.mark.parametrize(("takes_s", "jumps"), [(0.3, False), (0.6, False), (0.3, True)])
def test_a_laser_s_reading_too(takes_s: float, jumps: bool) -> None:
    parameters = BenchParameters(plant=geometric_axis(3))
    how = replace(MEASUREMENT, targets_mm=(10.0, 200.0), reference_mm=10.0, velocity_mm_s=100.0)

    class Slow(SerialLink):
        until_s = 0.0

        def read_waiting(self) -> bytes:
            if bench.clock.now_ns() < self.until_s * NS_PER_S:
                bench.clock.sleep_s(takes_s)
            return super().read_waiting()

    with Bench(parameters) as bench:
        link = Slow(bench.laser_path)
        laser = UmdLaser(link, bench.clock)
        drive = VirtualDrive(bench.servo, parameters.scaling, parameters.limits, bench.clock)
        with AxisSession(drive, laser, how) as session:
            session.prepare()
            link.until_s = bench.clock.now_ns() / NS_PER_S + 1.0
            if jumps:
                laser.settings = replace(laser.settings, direction=-1)
            beside = pytest.raises(MeasurementLostError, match=r"changed by|jumped|runs against")
            with beside if jumps else nullcontext():
                session.move_to(150.0)


@pytest.mark.parametrize("seen_mm", [3.0, -2.0, 0.0, 60.0])
@pytest.mark.parametrize("look_s", [0.01, 0.05, 0.3])
def test_the_figures_told_are_of_one_comparison(seen_mm: float, look_s: float) -> None:
    """It saw, the motor travelled, allowed: the difference of the first two exceeds the third, and is that by which it jumped."""
    agreement = Agreement(AgreementLimits(latency_s=0.01), 100.0)
    told = None
    for look in range(1, 400):
        at_s = look * look_s
        agreement.motor_at(round(at_s * NS_PER_S), 10.0 * at_s)
        seen = 10.0 * at_s + (seen_mm - 10.0) * max(0.0, at_s - 2.0)
        reading = Reading(round(at_s * NS_PER_S), ReadingStatus.GOOD, seen, look, 0, round((at_s - look_s) * NS_PER_S))
        agreement.rate(reading, 10.0)
        told = agreement.compare(reading, 10.0)
        if told is not None:
            break
    assert told is not None
    figures = re.search(
        r"it saw (\S+) mm while the motor travelled about (\S+) mm, allowed is a difference of (\S+) mm", told
    )
    assert figures, told
    saw_mm, travelled_mm, allowed_mm = map(float, figures.groups())
    assert abs(saw_mm - travelled_mm) > allowed_mm - 0.001
    if told.startswith("jumped by"):
        assert float(told.split()[2]) == pytest.approx(saw_mm - travelled_mm, abs=0.0011)


@pytest.mark.parametrize(("silent", "held_up_s"), [(False, 0.7), (False, 1.5), (True, 0.0), (True, 0.7)])
def test_readings_that_are_handed_on_late_to_a_process_held_up_are_no_silence(silent: bool, held_up_s: float) -> None:
    """The first poll after the delay finds nothing yet; an instrument that sends no more is lost within the limit of watching."""
    machine = ToyMachine()

    class HandedOnLate(ToyInstrument):
        empty = False

        def poll(self) -> Sequence[Reading]:
            if self.empty:
                self.empty = False
                return ()
            return super().poll()

    instrument = HandedOnLate(machine)
    lost = pytest.raises(MeasurementLostError, match=r"no reading for 0\.[5-7]\d s") if silent else nullcontext()
    with lost, AxisSession(ToyDrive(machine), instrument, MEASUREMENT) as session:
        session.prepare()
        session.watch(0.5)
        began_s = machine.now_s
        if silent:
            machine.trouble = Trouble(silent_at_s=began_s)
        machine.clock.sleep_s(held_up_s)
        instrument.empty = True
        try:
            session.watch(1.0)
        finally:
            assert machine.now_s - began_s < 1.1 + held_up_s


def test_nor_is_a_step_on_the_way_from_one_rest_to_the_next() -> None:
    machine = ToyMachine()
    with pytest.raises(MeasurementLostError, match=r"jumped by .* travelled"), toy_session(machine) as session:
        session.prepare()
        machine.trouble = Trouble(jump_at_s=machine.now_s + 0.3, jump_mm=0.45)
        session.move_to(50.0)
        assert machine.now_s > machine.trouble.jump_at_s + 0.2, "it was on its way"
        session.read_position()


def test_what_drifts_slowly_while_the_motor_stands_is_heat() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        session.watch(0.5)
        for _ in range(20):
            machine.trouble.jump_at_s = machine.now_s
            machine.trouble.jump_mm += 0.01
            session.watch(0.4)


def test_whoever_reaches_into_the_machine_may_move_the_load() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        session.watch(0.5)
        with session.without_power():
            machine.trouble = Trouble(jump_at_s=machine.now_s, jump_mm=0.4)
            session.watch(0.5)
        session.read_position()


def test_many_small_jumps_are_one_large_one() -> None:
    machine = ToyMachine()
    with pytest.raises(MeasurementLostError, match=r"jumped|does not follow"), toy_session(machine) as session:
        session.prepare()
        for step in range(1, 12):
            machine.trouble = Trouble(jump_at_s=machine.now_s, jump_mm=0.1 * step)
            session.move_to(10.0 + step)
            session.read_position()
    assert machine.motor_mm < 21.0


def test_after_a_loss_that_was_acknowledged_travel_counts_anew() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        machine.trouble = Trouble(jump_at_s=machine.now_s, jump_mm=7.0)
        with pytest.raises(MeasurementLostError):
            session.move_to(50.0)
        session.drive.disable()
        session.drive.enable()
        with pytest.raises(MeasurementLostError):
            session.take_datum()
        session.acknowledge_loss()
        session.drive.disable()
        session.drive.enable()
        session.take_datum()
        session.move_to(50.0)


# -- speed -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("faster", "reach_mm"), [(10.0, 2.0), (2.0, 3.0), (1.4, 6.0)])
def test_a_motor_that_is_faster_than_it_was_told_is_stopped(faster: float, reach_mm: float) -> None:
    machine = ToyMachine()
    with (
        pytest.raises(OverspeedError, match=r"runs too fast: .* commanded 5 mm/s, allowed are 20 % more"),
        toy_session(machine) as session,
    ):
        session.prepare()
        machine.trouble = Trouble(faster=faster)
        session.move_to(100.0, 5.0)
    assert machine.motor_mm < reach_mm * 5.0
    assert machine.told("quick stop")
    assert machine.state is DriveState.SWITCH_ON_DISABLED


def test_a_short_move_that_is_over_between_two_looks_is_judged_by_its_mean_speed() -> None:
    """From the rest before the order, with nothing allowed for moments that are not known: 20 mm at 270 instead of 100 mm/s."""
    overspeed = Overspeed()
    overspeed.stood(0, 10.0)
    looks = [(5_000_000, 10.0), (75_000_000, 30.0)]
    wrong = [overspeed.look(time_ns, place_mm, 100.0, now_ns=time_ns + 5_000_000) for time_ns, place_mm in looks]
    assert wrong[0] is None
    assert wrong[1] == "runs too fast: 20.000 mm in 0.080 s, commanded 100 mm/s, allowed are 20 % more"


def test_a_host_that_was_held_up_finds_no_overspeed() -> None:
    """What it hears was asked for before it was held up, or after: the motor had no more time than it says."""
    overspeed = Overspeed()
    overspeed.stood(0, 10.0)
    assert overspeed.look(1_000_000, 30.0, 100.0, now_ns=210_000_000) is None
    assert overspeed.look(212_000_000, 31.0, 100.0, now_ns=213_000_000) is None


def test_a_position_that_a_host_dates_late_makes_no_overspeed_of_the_next() -> None:
    """Held up for 0.29 s between an answer and the reading of its clock: 0.6 mm at 2 mm/s are not 0.6 mm in 5 ms."""
    for faster, words in ((1.0, None), (2.5, "runs too fast: 1.475 mm in 0.005 s")):
        overspeed = Overspeed()
        assert overspeed.look(5_000_000, 10.0, 2.0, now_ns=6_000_000) is None
        assert overspeed.look(300_000_000, 10.01, 2.0, now_ns=301_000_000) is None
        wrong = overspeed.look(305_000_000, 10.01 + 0.59 * faster, 2.0, now_ns=306_000_000)
        assert wrong is None if words is None else wrong is not None and wrong.startswith(words)


def test_a_motor_that_is_ten_times_too_fast_is_told_at_the_second_look() -> None:
    overspeed = Overspeed()
    looks = [overspeed.look(10**7 * k, 0.5 * k, 5.0, now_ns=10**7 * k + 10**6) for k in range(8)]
    assert [wrong is not None for wrong in looks].index(True) == 1


@pytest.mark.parametrize(("arrived", "judged"), [(True, True), (False, False)])
def test_the_mean_speed_counts_from_a_rest_only(arrived: bool, judged: bool) -> None:
    """A motor that a move under way carries along is further after the order than its new speed explains."""
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        axis = session.axis
        found = replace(axis.drive.sample(), target_reached=arrived)
        with axis.moving(Motion("the move", 50.0, 1.0), found):
            machine.motor_mm += 0.13
            with pytest.raises(OverspeedError) if judged else nullcontext():
                axis.look()


def test_a_short_move_that_is_too_fast_is_stopped_at_the_first_look() -> None:
    machine = ToyMachine()
    with pytest.raises(OverspeedError, match=r"commanded 50 mm/s"), toy_session(machine) as session:
        session.prepare()
        session.move_to(50.0)
        machine.trouble = Trouble(faster=3.0)
        session.move_to(55.0, 50.0)


def test_an_overshoot_of_a_tenth_is_none() -> None:
    machine = ToyMachine()
    with toy_session(machine) as session:
        session.prepare()
        machine.trouble = Trouble(faster=1.1)
        session.move_to(100.0)


# -- not over in time --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        (lambda at: Trouble(stuck_at_s=at, torque_percent=180.0), "likely an end stop or a jam: it stands and pushes"),
        (lambda at: Trouble(stuck_at_s=at, limited=True), "likely an internal limit of the drive"),
        (lambda at: Trouble(stuck_at_s=at), "likely it stands, and the drive's set-point too"),
        (lambda at: Trouble(faster=0.05), r"likely still under way, slower than the 50 mm/s asked for"),
    ],
)
def test_a_move_that_is_not_over_in_time_says_what_is_likely(trouble: Callable[[float], Trouble], words: str) -> None:
    machine = ToyMachine()
    with pytest.raises(MotionTimeoutError, match=words) as caught, toy_session(machine) as session:
        session.prepare()
        machine.trouble = trouble(machine.now_s + 0.5)
        session.move_to(100.0)
    said = str(caught.value)
    assert "it says: operation enabled, at " in said
    assert said.count("\n") == 0
    assert machine.told("quick stop")
    assert machine.state is DriveState.SWITCH_ON_DISABLED


# -- streams -----------------------------------------------------------------------------------------------------------
class Frozen(UmdLaser):
    """From a moment on it repeats its position; status and count are as before."""

    at_s = math.inf

    def poll(self) -> list[Reading]:
        readings = []
        for reading in super().poll():
            if reading.time_ns / NS_PER_S < self.at_s:
                self.last = reading
            readings.append(replace(reading, position_mm=self.last.position_mm, status=self.last.status))
        return readings


@pytest.mark.parametrize("freezes", [True, False])
def test_a_stream_is_watched_as_a_move_is(freezes: bool) -> None:
    parameters = BenchParameters(plant=geometric_axis(3))
    how = replace(MEASUREMENT, targets_mm=(10.0, 200.0), reference_mm=10.0, velocity_mm_s=100.0)
    with Bench(parameters) as bench:
        laser = Frozen(SerialLink(bench.laser_path), bench.clock)
        drive = VirtualDrive(bench.servo, parameters.scaling, parameters.limits, bench.clock)
        seen: list[int] = []
        with AxisSession(drive, laser, how) as session:
            session.prepare()
            start_mm, feed_mm_s, period_s = session.commanded_mm, 20.0, 0.004
            path = [(start_mm + feed_mm_s * period_s * cycle, feed_mm_s) for cycle in range(1, 1000)]
            laser.at_s = bench.clock.now_ns() / NS_PER_S + 1.0 if freezes else math.inf
            expected = pytest.raises(MeasurementLostError, match="stands still, whatever") if freezes else nullcontext()
            with expected:
                session.stream_along(
                    path, SetPointSettings(period_s), lambda _stream: seen.append(len(session.readings()))
                )
            if freezes:
                assert drive.sample().state is DriveState.QUICK_STOP
                assert bench.plant.position_mm < start_mm + feed_mm_s * (1.0 + 0.35) + 0.7
            else:
                assert bench.plant.position_mm > start_mm + 79.0
                assert sum(seen) > 150
