"""Two axes of one machine that stream together, on every wire: both are where they were sent, and what stops one stops both."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from support.two_axes import lay_out_axes

from drivers.canopen.stream import CyclicStream
from drivers.drive import Capability, DriveState, ServoDrive
from drivers.errors import CapabilityError, InputError, LimitError, StateError
from drivers.set_points import SetPointSettings
from hil.axis.axis_file import AxisConfig, load_axis
from hil.lost_motion.circle.figures import Circle
from hil.lost_motion.circle.job import BEFORE, run_circle
from hil.lost_motion.circle.procedure import check_axes, drive_circle, prepare
from hil.machine.axes_wiring import connected_axes
from hil.machine.bench_wiring import running_bench
from hil.machine.events import Event, Listener
from hil.machine.machine import Machine
from sim_backends.bench import Bench, BenchParameters
from sim_backends.plant.parameters import ideal_axis
from sim_backends.virtual_drive import VirtualDrive

IDEAL = (BenchParameters(plant=ideal_axis()), BenchParameters(plant=ideal_axis()))


def axes_of(directory: Path, face: str) -> tuple[AxisConfig, AxisConfig]:
    x, y = lay_out_axes(directory, face, machine="ideal")
    return load_axis(x), load_axis(y)


@contextmanager
def connected_ideal(axes: tuple[AxisConfig, AxisConfig]) -> Iterator[tuple[Machine, ...]]:
    with running_bench(axes, IDEAL) as running, connected_axes(axes, running) as machines:
        yield machines


@pytest.mark.parametrize(
    ("face", "period_s"), [("virtual", 0.01), ("canopen", 0.01), ("modbus-tcp", 0.02), ("modbus-rtu", 0.05)]
)
def test_both_axes_follow_their_own_path(tmp_path: Path, face: str, period_s: float) -> None:
    with connected_ideal(axes_of(tmp_path, face)) as machines:
        drives = [machine.session.drive for machine in machines]
        for drive in drives:
            drive.enable()
        start = [drive.sample().position_load_mm for drive in drives]
        with drives[0].stream(SetPointSettings(period_s), drives[1:]) as stream:
            for index in range(1, 26):
                share = 0.5 * (1.0 - math.cos(math.pi * min(1.0, index / 20)))
                stream.cycle([start[0] + 2.0 * share, start[1] - 1.0 * share])
            assert stream.missed_cycles == 0
        ends = [drive.sample().position_load_mm for drive in drives]
        assert ends == pytest.approx([start[0] + 2.0, start[1] - 1.0], abs=1e-3)
        assert all(drive.sample().state is DriveState.ENABLED for drive in drives)


def test_axes_on_one_line_need_its_time_one_after_the_other(tmp_path: Path) -> None:
    """54 characters of 11 bits at 115,200 baud, four silent intervals of 1.75 ms and two answers of 1 ms: 14.2 ms an axis."""
    with connected_ideal(axes_of(tmp_path, "modbus-rtu")) as machines:
        drives = [machine.session.drive for machine in machines]
        for drive in drives:
            drive.enable()
        with drives[0].stream(SetPointSettings(0.02)) as stream:
            stream.cycle([drives[0].sample().position_load_mm])
        with (
            pytest.raises(
                InputError, match=r"stream of X, Y: stream period is 20 ms, set-points and answers take 28\.3 ms"
            ),
            drives[0].stream(SetPointSettings(0.02), drives[1:]),
        ):
            pytest.fail("entered")


def test_an_axis_that_was_left_is_not_stopped_again_with_the_other(tmp_path: Path) -> None:
    """Nothing is said of a drive that may still move: it was stopped, disabled and closed."""

    def fail() -> None:
        with connected_ideal(axes_of(tmp_path, "canopen")) as machines:
            for machine in machines:
                machine.session.drive.enable()
            raise InputError("an error that no supervisor sees")

    with pytest.raises(InputError) as caught:
        fail()
    assert not getattr(caught.value, "__notes__", [])


def _stream(drives: list[ServoDrive], set_points: list[list[float]]) -> None:
    with drives[0].stream(SetPointSettings(0.01), drives[1:]) as stream:
        for positions in set_points:
            stream.cycle(positions)


@pytest.mark.parametrize("face", ["virtual", "canopen"])
def test_a_set_point_that_one_axis_must_not_have_stops_both_before_either_has_it(tmp_path: Path, face: str) -> None:
    with connected_ideal(axes_of(tmp_path, face)) as machines:
        drives = [machine.session.drive for machine in machines]
        for drive in drives:
            drive.enable()
        start = [drive.sample().position_load_mm for drive in drives]
        with pytest.raises(LimitError, match="outside the travel"):
            _stream(drives, [start, [start[0] + 0.01, 1000.0]])
        machines[0].clock.sleep_s(0.5)
        for drive, at in zip(drives, start, strict=True):
            assert drive.sample().position_load_mm == pytest.approx(at, abs=2e-3)
            assert drive.sample().state is not DriveState.ENABLED


def test_a_fault_of_the_axis_beside_is_seen_while_this_one_moves(tmp_path: Path) -> None:
    with connected_ideal(axes_of(tmp_path, "virtual")) as (first, second):
        first.session.await_instrument()
        second.session.await_instrument()
        assert second.bench is not None
        second.bench.servo.raise_fault(0x8611)
        with pytest.raises(Exception, match="drive Y went into fault"):
            first.session.prepare()
        assert first.session.drive.sample().state is not DriveState.ENABLED


def test_what_a_drive_cannot_do_is_said_before_anything_moves(tmp_path: Path) -> None:
    with connected_ideal(axes_of(tmp_path, "virtual")) as machines:
        sessions = [machine.session for machine in machines]
        drive = sessions[1].drive
        assert isinstance(drive, VirtualDrive)
        with pytest.raises(LimitError, match="with its run-in"):
            check_axes(sessions, Circle((120.0, 5.0)), 0.004)
        with pytest.raises(InputError, match="expected more than 0 and at most a tenth of radius over feed"):
            check_axes(sessions, Circle((120.0, 120.0)), 2.0)
        drive.settings.missing = frozenset({Capability.STREAMING})
        with pytest.raises(CapabilityError, match="drive Y cannot do: cyclic synchronous position"):
            drive_circle(sessions, Circle((120.0, 120.0)), (None, None))
        assert all(session.drive.sample().state is not DriveState.ENABLED for session in sessions)


def _circle(axes: tuple[AxisConfig, AxisConfig], listener: Listener, benches: list[Bench | None]) -> None:
    with connected_ideal(axes) as machines:
        benches += [machine.bench for machine in machines]
        sessions = [machine.session for machine in machines]
        prepare(sessions)
        drive_circle(sessions, Circle((40.0, 40.0), radius_mm=5.0), (None, None), period_s=0.02, listener=listener)


@pytest.mark.parametrize("face", ["virtual", "canopen", pytest.param("modbus-tcp", marks=pytest.mark.outside)])
def test_an_interrupt_in_the_circle_stops_both_and_leaves_them_as_they_were(tmp_path: Path, face: str) -> None:
    def interrupt(_event: Event) -> None:
        raise KeyboardInterrupt

    benches: list[Bench | None] = []
    with pytest.raises(KeyboardInterrupt):
        _circle(axes_of(tmp_path, face), interrupt, benches)
    assert len(benches) == 2
    for bench in benches:
        assert bench is not None
        assert not bench.servo.powered
        assert bench.servo.velocity_actual_counts_s == 0


@pytest.mark.parametrize("stated", [False, True])
def test_an_instrument_that_is_late_is_dated_by_what_its_axis_file_states(tmp_path: Path, stated: bool) -> None:
    """y seen τ late is y - v·τ·cos φ at the angle φ: the radius is off by v·τ·sin 2φ / 2, from peak to peak by v·τ."""
    late_s, feed_mm_s = 0.02, 5.0
    x, y = lay_out_axes(tmp_path, machine="ideal")
    if stated:
        y.write_text(y.read_text().replace("[instrument]", f"[instrument]\nlatency_s = {late_s}"))
    first, second = IDEAL
    late = replace(second, laser=replace(second.laser, latency_s=late_s))
    axes = (load_axis(x), load_axis(y))
    with running_bench(axes, (first, late)) as running, connected_axes(axes, running) as machines:
        driven = run_circle(machines, Circle((40.0, 40.0), 5.0, feed_mm_s), (None, None), period_s=0.02)
    trace = driven.traces[BEFORE]
    if stated:
        assert trace.roundness_um < 0.5  # the laser's noise, 0.03 µm a reading
        assert trace.floor_um < 0.5
    else:
        assert trace.roundness_um == pytest.approx(1000.0 * feed_mm_s * late_s, rel=0.01)


def test_axes_that_nothing_paces_together_are_refused(tmp_path: Path) -> None:
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    with (
        connected_ideal(axes_of(ours, "canopen")) as first,
        connected_ideal(axes_of(theirs, "canopen")) as second,
    ):
        one, other = first[0].session.drive, second[0].session.drive
        with pytest.raises(CapabilityError, match="not all on one CAN bus"):
            one.stream(SetPointSettings(0.01), [other])
        with pytest.raises(CapabilityError, match="not all on one CAN bus"):
            CyclicStream([one, other], SetPointSettings(0.01))
    with connected_ideal(axes_of(tmp_path / "more", "virtual")) as machines:
        stream = machines[0].session.drive.stream(SetPointSettings(0.01), [machines[1].session.drive])
        with pytest.raises(StateError, match="cannot stream"):
            stream.__enter__()


def test_the_same_axis_twice_or_on_two_kinds_of_machine_is_refused(tmp_path: Path) -> None:
    x, y = axes_of(tmp_path, "virtual")
    with pytest.raises(InputError, match="a file and a name for each"), connected_axes((x, x)):
        pass
    other = replace(y, drive=replace(y.drive, face="canopen"))
    with pytest.raises(InputError, match="expected all alike"), connected_axes((x, other)):
        pass
