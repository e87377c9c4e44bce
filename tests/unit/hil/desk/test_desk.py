"""The desk in simulated time: who may do what, what a stop does, what is shown of a job, and what a fault leaves behind."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from support import bench_axis
from support.backlash_axis import BenchBehind, lay_out, look_behind

from drivers.clock import NS_PER_S, Waiting
from drivers.drive import DriveState
from drivers.errors import LinkLostError, StateError
from drivers.instrument import ReadingStatus
from hil.axis.axis_file import DriveAxis, load_axis, load_drive_axis
from hil.desk import axis_thread
from hil.desk.axis_thread import DeskConnection, to_axis
from hil.desk.control import NotInControlError
from hil.desk.desk import BusyError, Desk
from hil.desk.job import Job, Workplace
from hil.desk.plan import Plan
from hil.desk.progress import Phase, Progress
from hil.desk.roles import LockedError
from hil.machine.bench_wiring import bench_parameters, running_bench
from hil.machine.events import Event, Measured, Point
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import connected
from sim_backends.clock import BEAT_NS
from sim_backends.faults import Fault, FaultKind

Until = Callable[[Callable[[], bool], str], None]
SPEED_MM_S, END_MM = 30.0, 100.0


@dataclass
class Watched:
    """A desk at work, its token, and the machine behind it."""

    desk: Desk
    token: str
    behind: BenchBehind
    until: Until

    def job(self, work: Callable[[Workplace], object], *, locked: bool = False) -> Job:
        return Job("test", Plan(self.desk.name, "bench", locked=locked), work)

    def run(self, work: Callable[[Workplace], object]) -> Progress:
        """Run it to its end."""
        self.desk.run(self.token, self.job(work))
        return self.ended()

    def ended(self) -> Progress:
        self.until(lambda: not self.now().running, "the job is over")
        return self.now()

    def now(self) -> Progress:
        job = self.desk.job()
        assert job is not None
        return job


def axis_of(directory: Path, face: str = "virtual", name: str = "X") -> DriveAxis:
    directory.mkdir(exist_ok=True)
    path = lay_out(directory, face)
    path.write_text(path.read_text(encoding="utf-8").replace('name = "X"', f'name = "{name}"'), encoding="utf-8")
    return load_drive_axis(path)


@contextmanager
def watched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Until, face: str = "virtual", **how: object
) -> Iterator[Watched]:
    behind = look_behind(monkeypatch)
    with Desk(axis_of(tmp_path, face), pace=0.0, **how) as desk:  # type: ignore[arg-type]
        until(lambda: desk.live.connected, "the axis is connected")
        yield Watched(desk, desk.control.take("test"), behind, until)


@pytest.fixture
def at_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Until) -> Iterator[Watched]:
    with watched(tmp_path, monkeypatch, until) as one:
        yield one


def long_way(place: Workplace) -> None:
    with Supervisor([WatchedAxis(place.drive)]) as axis:
        axis.get_ready(home=False)
        axis.move(END_MM, SPEED_MM_S)


# -- stop ------------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("face", ["virtual", "canopen", "modbus-tcp", "modbus-rtu"])
def test_holds_within_50_ms_of_a_stop_in_motion(
    face: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Until
) -> None:
    """Clicked at 30 mm/s, for which the machine's own ramp (1000 mm/s²) needs 30 ms; the drive is told within a beat of the clock."""
    with watched(tmp_path, monkeypatch, until, face) as at_work:
        servo, seen = at_work.behind.bench.servo, _Seen()

        def look(now_ns: int, _dt_s: float) -> None:
            speed_mm_s = abs(servo.velocity_actual_counts_s) / at_work.desk.axis.scaling.counts_per_load_mm
            if not seen.clicked_ns and speed_mm_s > 0.99 * SPEED_MM_S:
                seen.clicked_ns = now_ns
                at_work.desk.stop()
            elif seen.clicked_ns and servo.stopping:
                seen.braking_ns = seen.braking_ns or now_ns
                if servo.position_demand_counts == seen.demand_counts and speed_mm_s < 0.1 * SPEED_MM_S:
                    seen.held_ns = seen.held_ns or now_ns
            seen.demand_counts = servo.position_demand_counts

        at_work.behind.bench.clock.attach(look, bearable=lambda _now_ns: 1_000_000)
        assert at_work.run(long_way).phase is Phase.STOPPED
        assert 0 < seen.braking_ns - seen.clicked_ns <= BEAT_NS + 3_000_000
        assert 0 < seen.held_ns - seen.clicked_ns <= 50_000_000
        told = at_work.desk.came_to_rest
        assert told is not None
        assert -0.001 <= told.after_s - (seen.held_ns - seen.clicked_ns) / NS_PER_S <= 0.015  # looks are 10 ms apart
        until(lambda: at_work.desk.live.state is not DriveState.ENABLED, "the axis is as it was found")


@dataclass
class _Seen:
    clicked_ns: int = 0
    braking_ns: int = 0
    held_ns: int = 0
    demand_counts: int = 0


def test_a_stop_while_it_computes_is_shown_and_comes_with_the_next_wait(at_work: Watched) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def compute(place: Workplace) -> None:
        begun.set()
        assert go_on.wait(20.0)
        place.drive.clock.sleep_s(3600.0)

    at_work.desk.run(at_work.token, at_work.job(compute))
    assert begun.wait(20.0)
    at_work.desk.stop()
    assert at_work.now().stopping
    go_on.set()
    assert at_work.ended().phase is Phase.STOPPED
    assert not at_work.now().stopping


def test_a_second_stop_does_not_disturb_what_the_first_puts_in_order(at_work: Watched) -> None:
    put_back = []

    def settings(place: Workplace) -> None:
        clock = place.drive.clock
        try:
            at_work.desk.stop()
            clock.sleep_s(3600.0)
        finally:
            at_work.desk.stop()
            clock.sleep_s(1.0)
            put_back.append(clock.now_ns())

    assert at_work.run(settings).phase is Phase.STOPPED
    assert len(put_back) == 1


def test_a_stop_of_an_axis_that_is_enabled_and_idle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Until
) -> None:
    axis = axis_of(tmp_path)

    @contextmanager
    def enabled(waiting: Waiting) -> Iterator[DeskConnection]:
        with to_axis(axis)(waiting) as connection:
            connection.drive.enable()
            yield connection

    with watched(tmp_path, monkeypatch, until, connect=enabled) as at_work:
        until(lambda: at_work.desk.live.state is DriveState.ENABLED, "enabled")
        at_work.desk.stop()
        until(lambda: at_work.desk.live.state is DriveState.QUICK_STOP, "held by a quick stop")
        at_work.desk.power_off(at_work.token)
        until(lambda: at_work.desk.live.state is DriveState.SWITCH_ON_DISABLED, "without power")


def test_a_stop_before_a_job_has_begun_cancels_it(at_work: Watched) -> None:
    """Whatever the thread is at when the stop comes."""
    for _ in range(20):
        at_work.desk.run(at_work.token, at_work.job(long_way))
        at_work.desk.stop()
        assert at_work.ended().phase is Phase.STOPPED


@pytest.mark.parametrize("face", ["virtual", "canopen", "modbus-tcp"])
@pytest.mark.parametrize("error", [None, StateError("something is wrong")], ids=["done", "failed"])
def test_a_stop_while_the_axis_is_put_back_does_not_leave_it_under_power(
    face: str, error: Exception | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Until
) -> None:
    """Pressed in a job's last moment: it would break off what takes the power off."""
    with watched(tmp_path, monkeypatch, until, face) as at_work:

        def work(place: Workplace) -> None:
            place.drive.enable()
            place.drive.start_move(END_MM, SPEED_MM_S)
            place.drive.clock.sleep_s(0.2)
            at_work.desk.stop()
            if error is not None:
                raise error

        at_work.run(work)
        until(lambda: at_work.desk.live.state is DriveState.SWITCH_ON_DISABLED, "without power")


def test_an_error_while_a_stop_is_carried_out_does_not_deafen_the_next_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Until
) -> None:
    monkeypatch.setattr(axis_thread, "RETRY_S", 0.0)
    axis, connecting, tries = axis_of(tmp_path), threading.Event(), []

    @contextmanager
    def fails_when_stopped(waiting: Waiting) -> Iterator[DeskConnection]:
        tries.append(waiting)
        if len(tries) == 1:
            try:
                connecting.set()
                waiting.real(3600.0)
            finally:
                raise LinkLostError("nor could it be let go")
        with to_axis(axis)(waiting) as connection:
            yield connection

    with Desk(axis, pace=0.0, connect=fails_when_stopped) as desk:
        assert connecting.wait(60.0)
        desk.stop()
        until(lambda: desk.live.connected, "connected after all")
        desk.run(
            desk.control.take("test"), Job("test", Plan("X", "bench"), lambda place: place.drive.clock.sleep_s(1e9))
        )
        desk.stop()
        until(lambda: not desk.job().running, "stopped")  # type: ignore[union-attr]
        assert desk.job().phase is Phase.STOPPED  # type: ignore[union-attr]


def test_what_was_seen_is_not_shown_while_a_job_has_the_axis_to_itself(at_work: Watched) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def work(_place: Workplace) -> None:
        begun.set()
        assert go_on.wait(60.0)

    at_work.desk.run(at_work.token, Job("test", Plan("X", "bench"), work, connects=True))
    assert begun.wait(60.0)
    assert (at_work.desk.live.connected, at_work.desk.live.position_load_mm) == (False, None)
    go_on.set()
    at_work.until(lambda: at_work.desk.live.connected, "seen again")


def test_closing_stops_the_job_and_lets_the_axis_go(at_work: Watched) -> None:
    at_work.desk.run(at_work.token, at_work.job(lambda place: place.drive.clock.sleep_s(1e9)))
    at_work.desk.close()
    assert at_work.now().phase is Phase.STOPPED
    assert not at_work.desk.live.connected


# -- jobs --------------------------------------------------------------------------------------------------------------------
def test_what_a_job_says_and_measures_is_shown_and_bounded(at_work: Watched) -> None:
    def say(place: Workplace) -> str:
        for index in range(3000):
            place.listener(Event("stage", f"{index}", index, 3000, Point("curve", index, -index)))
            place.listener(Event("stage", f"{index}", index, 3000, Measured("figure", index, "µm")))
            place.tell(f"message {index}")
        return "came of it"

    shown = at_work.run(say)
    assert (shown.phase, shown.result, shown.stage, shown.done) == (Phase.DONE, "came of it", "stage", 2999)
    assert len(shown.figures) == 200
    assert shown.messages[-1] == "message 2999"
    assert len(shown.messages) == 100
    graph = at_work.desk.graph("test")
    assert graph.points == 3000
    assert graph.series["curve"][0] == (1000, -1000)
    assert at_work.desk.graph("test", since=2998).series["curve"] == [(2998, -2998), (2999, -2999)]


def test_what_is_found_of_a_drive_in_a_job_is_a_message_of_the_job(at_work: Watched) -> None:
    def work(place: Workplace) -> None:
        assert place.connected is not None
        place.connected.notes = [*place.connected.notes, "it does not take 6084h"]

    assert at_work.run(work).messages == ("it does not take 6084h",)
    assert at_work.run(lambda _: None).messages == ()  # once


def test_the_axis_is_shown_while_a_job_moves_it(at_work: Watched) -> None:
    """Looks of the procedure itself, in its own time."""
    seen = []

    def watching(place: Workplace) -> None:
        shown = place.drive.on_look
        assert shown is not None
        place.drive.on_look = lambda sample: (shown(sample), seen.append(at_work.desk.live))  # type: ignore[func-returns-value, assignment]
        long_way(place)

    assert at_work.run(watching).phase is Phase.DONE
    moving = [live for live in seen if live.moving]
    assert len(moving) > 50
    for live in moving[1:]:
        assert live.position_load_mm + live.remaining_mm == pytest.approx(END_MM, abs=1e-3)


def test_a_job_that_fails_says_why_and_the_axis_stays(at_work: Watched) -> None:
    def wrong(_place: Workplace) -> None:
        raise LinkLostError("two\nlines")

    def mistaken(_place: Workplace) -> None:
        raise ZeroDivisionError

    assert (at_work.run(wrong).phase, at_work.now().error) == (Phase.FAILED, "two lines")
    log = at_work.desk.errors.path
    failed = (at_work.run(mistaken).phase, at_work.now().error)
    assert failed == (Phase.FAILED, f"ZeroDivisionError; the traceback is in {log}")
    assert "raise ZeroDivisionError" in log.read_text()
    assert at_work.run(long_way).phase is Phase.DONE


def test_a_drive_fault_ends_the_job_is_shown_and_is_not_got_over(at_work: Watched) -> None:
    bench = at_work.behind.bench
    bench.clock.attach(lambda now_ns, _dt_s: bench.servo.raise_fault(0x2310) if now_ns > trip_ns else None)
    trip_ns = bench.clock.now_ns() + 2 * NS_PER_S
    shown = at_work.run(long_way)
    assert shown.phase is Phase.FAILED
    assert "2310" in shown.error
    at_work.until(lambda: at_work.desk.live.state is DriveState.FAULT, "the fault is shown")
    assert at_work.desk.live.fault_code == 0x2310
    assert at_work.run(long_way).phase is Phase.FAILED
    assert at_work.desk.live.state is DriveState.FAULT


def test_one_job_at_a_time_and_only_for_whoever_holds_control(at_work: Watched) -> None:
    go_on = threading.Event()
    job = at_work.job(lambda _place: go_on.wait(20.0))
    with pytest.raises(NotInControlError):
        at_work.desk.run(None, job)
    with pytest.raises(NotInControlError):
        at_work.desk.run("x" * 43, job)
    at_work.desk.run(at_work.token, job)
    with pytest.raises(BusyError, match="axis X is busy: test"):
        at_work.desk.run(at_work.token, job)
    go_on.set()
    assert at_work.ended().phase is Phase.DONE


def test_what_is_locked_is_refused_to_an_operator(at_work: Watched) -> None:
    with pytest.raises(LockedError):
        at_work.desk.run(at_work.token, at_work.job(lambda _place: None, locked=True))
    assert at_work.desk.job() is None


# -- coming and going --------------------------------------------------------------------------------------------------------
def test_an_axis_that_does_not_answer_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Until
) -> None:
    axis, tries = axis_of(tmp_path), []
    troubles: list[str] = []
    monkeypatch.setattr(axis_thread, "RETRY_S", 0.05)

    @contextmanager
    def at_the_third_time(waiting: Waiting) -> Iterator[DeskConnection]:
        tries.append(waiting)
        if len(tries) < 3:
            raise LinkLostError("nobody there")
        with to_axis(axis)(waiting) as connection:
            yield connection

    with Desk(axis, pace=0.0, connect=at_the_third_time) as desk:
        until(lambda: troubles.append(desk.live.trouble) or desk.live.connected, "connected at last")  # type: ignore[func-returns-value]
    assert "nobody there" in troubles
    assert len(tries) == 3


def test_two_axes_for_one_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Until) -> None:
    """The desks let go of their axes for a job that connects both; a stop at either ends it; then both have theirs again."""
    look_behind(monkeypatch)
    axes = [axis_of(tmp_path / name, name=name) for name in ("X", "Y")]
    with Desk(axes[0], pace=0.0) as x, Desk(axes[1], pace=0.0) as y:
        until(lambda: x.live.connected and y.live.connected, "both connected")
        tokens = [desk.control.take("test") for desk in (x, y)]

        def both(place: Workplace) -> None:
            with to_axis(axes[0])(place.waiting) as first, to_axis(axes[1])(place.waiting) as second:
                place.watch("Y", second.drive, None)
                second.drive.looked_at(second.drive.sample())
                first.drive.clock.sleep_s(1e9)

        job = Job("both", Plan("X", "bench"), both, connects=True)
        with pytest.raises(NotInControlError):
            x.run(tokens[0], job, {y: None})
        x.run(tokens[0], job, {y: tokens[1]})
        until(lambda: y.live.connected and y.job() is not None, "Y is shown by X's job")
        with pytest.raises(BusyError, match="lent to a job of axis X"):
            y.run(tokens[1], Job("test", Plan("Y", "bench"), lambda _place: None))
        y.stop()
        until(lambda: not x.job().running and x.live.connected and y.live.connected, "each has its axis again")  # type: ignore[union-attr]
        assert x.job().phase is Phase.STOPPED  # type: ignore[union-attr]
        y.run(tokens[1], Job("test", Plan("Y", "bench"), long_way))
        until(lambda: not y.job().running, "Y's own job")  # type: ignore[union-attr]
        assert y.job().phase is Phase.DONE  # type: ignore[union-attr]


# -- a lost beam ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("face", ["canopen", pytest.param("modbus-tcp", marks=pytest.mark.outside)])
def test_after_a_lost_beam_nothing_goes_on_until_a_person_begins_a_job(face: str, tmp_path: Path, until: Until) -> None:
    """A hand through the beam: the laser counts from another zero afterwards. The job that is begun then takes it anew."""
    path = bench_axis.lay_out(tmp_path, sections=4)
    text = path.read_text(encoding="utf-8").replace("[drive]\n", f'[drive]\nface = "{face}"\n')
    path.write_text(text, encoding="utf-8")
    axis = load_axis(path)
    loss = Fault(FaultKind.BEAM_LOST, at_s=45.0, duration_s=0.3)
    bench = replace(bench_parameters(axis), laser_faults=(loss,))

    @contextmanager
    def connect(waiting: Waiting) -> Iterator[DeskConnection]:
        with (
            running_bench([axis], [bench], waiting) as running,
            connected(axis, running, waiting=waiting) as machine,
        ):
            yield DeskConnection(machine.session.drive, machine.session)

    def measured(place: Workplace) -> float:
        session = place.machine().session
        session.prepare()
        while session.clock.now_ns() < 46 * NS_PER_S:
            for target_mm in axis.measurement.targets_mm[:2]:
                session.move_to(target_mm)
        session.move_to(axis.measurement.reference_mm)
        return session.read_position().position_load_mm - axis.measurement.reference_mm

    with Desk(axis, pace=0.0, connect=connect) as desk:
        until(lambda: desk.live.connected, "the axis is connected")
        at = Watched(desk, desk.control.take("test"), BenchBehind(), until)
        ended = at.run(measured)
        assert ended.phase is Phase.FAILED
        assert "beam lost" in ended.error
        until(lambda: desk.live.instrument_status is ReadingStatus.LOST_BEFORE, "the beam is back")
        lost_s = desk.silence.instrument_lost_s
        until(lambda: desk.silence.instrument_lost_s > lost_s + 0.2, "it is told since when there is no position")
        assert not desk.live.moving
        assert desk.live.state is not DriveState.ENABLED
        again = at.run(measured)
        assert again.phase is Phase.DONE, again.error
        assert abs(again.result) < 0.05
        until(lambda: desk.live.instrument_status is ReadingStatus.GOOD, "the signal is shown again")
        assert desk.silence.instrument_lost_s < lost_s
