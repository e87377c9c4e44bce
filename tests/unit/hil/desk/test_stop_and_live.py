"""The stop and the pace below the desk's clocks, what is kept of the live signals, and what an interruption left behind."""

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from drivers.clock import NS_PER_S, WallClock
from drivers.drive import DriveSample, DriveState, ServoDrive
from drivers.errors import InputError
from drivers.instrument import Reading, ReadingStatus
from drivers.parameters import DriveParameters, ParameterInfo, ParameterKind, ParameterValue
from hil.desk.axis_thread import limits_of
from hil.desk.live import Board, Live, SignalLimits, of_sample
from hil.desk.stop import CameToRest, MeasuredStop, Pacing, Stop, StoppedByOperator
from sim_backends.clock import BEAT_NS, SimClock


# -- stop ------------------------------------------------------------------------------------------------------------------
def test_a_stop_wakes_a_real_wait_at_once() -> None:
    stop = Stop()
    clock = WallClock(Pacing(stop))
    begun_ns = clock.now_ns()
    threading.Timer(0.05, stop.press).start()
    with pytest.raises(StoppedByOperator):
        clock.sleep_s(3600.0)
    assert clock.now_ns() - begun_ns < 20 * NS_PER_S
    stop.rearm()
    clock.sleep_s(0.0)


@pytest.mark.parametrize("simulated", [False, True])
def test_a_stop_is_heard_where_input_or_output_asks_for_it(simulated: bool) -> None:
    stop = Stop()
    clock = SimClock(0.001, Pacing(stop, 0.0)) if simulated else WallClock(Pacing(stop))
    clock.check_interrupt()
    stop.press()
    with pytest.raises(StoppedByOperator):
        clock.check_interrupt()
    stop.press()
    clock.check_interrupt()  # the first is being carried out
    stop.rearm()
    with pytest.raises(StoppedByOperator):
        clock.check_interrupt()


def test_simulated_time_goes_no_further_than_a_beat_beyond_a_stop() -> None:
    stop = Stop()
    clock = SimClock(0.001, Pacing(stop, 0.0))
    settled = []
    clock.attach(
        lambda now_ns, _dt_s: stop.press() if now_ns == 500_000_000 else None, settle=lambda: settled.append(1)
    )
    with pytest.raises(StoppedByOperator):
        clock.sleep_s(3600.0)
    assert clock.now_ns() - 500_000_000 < BEAT_NS
    assert settled == [1]  # what was on its way is on the wire


def test_a_clock_that_is_held_back_advances_by_the_same_steps() -> None:
    """So that a run on the screen is the run of the command line."""

    def steps(clock: SimClock) -> list[int]:
        seen: list[int] = []
        clock.attach(lambda now_ns, _dt_s: seen.append(now_ns), bearable=lambda _now_ns: 2_500_000)
        for duration_s in (0.02, 0.005, 0.1):
            clock.sleep_s(duration_s)
        return seen

    assert steps(SimClock(0.005, Pacing(Stop(), 0.0))) == steps(SimClock(0.005))


def test_it_is_raised_once_and_not_while_it_is_carried_out() -> None:
    stop = Stop()
    stop.press()
    with pytest.raises(StoppedByOperator):
        stop.check()
    stop.press()
    stop.check()
    stop.wait_s(0.0)
    assert stop.pressed
    stop.rearm()
    with pytest.raises(StoppedByOperator):
        stop.wait_s(0.0)


def seen_braking(pressed_at_s: float, speed_mm_s: float = 20.0) -> CameToRest | None:
    """An axis that moves until 1 s and then brakes by 100 mm/s², looked at every 10 ms."""
    standstill, position_mm = MeasuredStop(), 0.0
    for look in range(200):
        time_s = look / 100.0
        if time_s >= pressed_at_s:
            standstill.pressed(round(pressed_at_s * NS_PER_S))
            pressed_at_s = 1e9
        standstill.look(DriveSample(round(time_s * NS_PER_S), DriveState.ENABLED, position_mm, False))
        position_mm += max(0.0, speed_mm_s - 100.0 * max(0.0, time_s - 1.0)) / 100.0
    return standstill.found


def test_how_an_axis_came_to_rest_is_seen() -> None:
    found = seen_braking(0.99)
    assert found is not None
    assert found.after_s == pytest.approx(0.01 + 0.9 * 0.2, abs=0.021)  # a tenth of the speed is left by then
    assert found.way_mm == pytest.approx(0.2 + 20.0**2 / 200.0, abs=0.25)
    assert seen_braking(1.5) is None  # it stood


def test_no_procedure_takes_it_for_an_error_to_get_over() -> None:
    assert not issubclass(StoppedByOperator, Exception)


def test_the_pace_holds_simulated_time_back() -> None:
    clock, wall = SimClock(0.01, Pacing(Stop(), 4.0)), WallClock()
    begun_ns = wall.now_ns()
    clock.sleep_s(0.4)
    assert wall.now_ns() - begun_ns >= 0.09 * NS_PER_S


# -- live ------------------------------------------------------------------------------------------------------------------
def test_the_trace_is_bounded_and_asked_for_by_number() -> None:
    now = [0.0]
    board = Board(lambda: now[0])
    for index in range(3000):
        now[0] += 0.05
        sample = DriveSample(index * NS_PER_S, DriveState.ENABLED, float(index), False)
        board.publish(of_sample(board.live, sample, 3000.0))
    points = board.trace()
    assert len(points) == 1200
    assert [points[0].number, points[-1].number] == [1801, 3000]
    assert [one.position_load_mm for one in board.trace(since=2998)] == [2998.0, 2999.0]
    assert board.trace(since=3000) == ()
    assert board.live.remaining_mm == 1.0


def test_looks_in_quick_succession_make_points_at_the_rate() -> None:
    now = [1000.0]
    board = Board(lambda: now[0])
    for _ in range(1000):
        now[0] += 0.01
        board.publish(Live(connected=True))
    assert len(board.trace()) == pytest.approx(200, abs=2)


def test_looks_that_come_unevenly_are_all_points() -> None:
    """Early by turns and late by turns, as a busy host makes them."""
    now_s = 0.0
    board = Board(lambda: now_s)
    for look in range(200):
        now_s = 1000.0 + 0.05 * look + (0.02 if look % 2 else 0.0)
        board.publish(Live(connected=True))
    assert len(board.trace()) >= 198


def test_the_curve_of_the_instrument_is_in_the_loads_frame_alone() -> None:
    now = [0.0]
    board = Board(lambda: now[0])
    good, lost = Reading(0, ReadingStatus.GOOD, 0.003, 1), Reading(0, ReadingStatus.BEAM_LOST, None, 2)
    for reading, in_load_mm in ((good, None), (good, 20.003), (lost, None), (good, 20.003), (good, None)):
        now[0] += 0.05
        board.heard([reading], {reading: in_load_mm}.get)
        board.publish(replace(board.live, connected=True))
        assert board.live.on_datum is (in_load_mm is not None or reading is lost)  # a lost beam is no other frame
    assert [one.instrument_load_mm for one in board.trace()] == [None, 20.003, None, 20.003, None]


def test_what_is_not_told_is_not_made_up() -> None:
    live = of_sample(Live(), DriveSample(0, DriveState.READY, 5.0, True), None)
    assert (live.following_error_um, live.torque_percent, live.velocity_mm_s, live.remaining_mm) == (None,) * 4


# -- what the drive allows -----------------------------------------------------------------------------------------------
class Told(DriveParameters):
    """Parameters of a drive that tells what is given, (unit, value) by name."""

    def __init__(self, **told: tuple[str, float | str]) -> None:
        self.told = told

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.told)

    def describe(self, name: str) -> ParameterInfo:
        if name not in self.told:
            raise InputError(f"no parameter {name}")
        return ParameterInfo(name, ParameterKind.INTEGER, self.told[name][0])

    def read(self, name: str) -> ParameterValue:
        return self.told[name][1]

    def write(self, name: str, value: ParameterValue) -> bool:
        raise AssertionError("nothing is written")


@pytest.mark.parametrize(
    ("told", "torque_percent", "following_error_um"),
    [
        # 6072h is in thousandths of the rated torque and 6065h in position units, by CiA 402; the axis has 100 counts per µm
        ({"max_torque": ("0.1 %", 3000), "following_error_window": ("counts", 20_000)}, 300.0, 200.0),
        ({"max_torque": ("percent", 150.0)}, 150.0, None),
        ({"following_error_window": ("counts", 0xFFFF_FFFF)}, None, None),  # supervises nothing
        ({"following_error_window": ("counts", 0)}, None, None),
        ({"following_error_window": ("rev", 2), "max_torque": ("Nm", 3)}, None, None),  # in units that say nothing here
        ({}, None, None),
    ],
)
def test_limits_are_those_that_the_drive_tells(
    told: dict[str, tuple[str, float | str]], torque_percent: float | None, following_error_um: float | None
) -> None:
    drive = SimpleNamespace(parameters=Told(**told), scaling=SimpleNamespace(counts_per_load_mm=-100_000))
    assert limits_of(cast(ServoDrive, drive)) == SignalLimits(torque_percent, following_error_um)
