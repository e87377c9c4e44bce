"""Streaming on a bus with real frame lengths, in simulated time: whether it fits, and what happens when something is missing."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.stream import CyclicStream
from drivers.drive import DriveState
from drivers.errors import (
    BridgeError,
    DriveFaultError,
    FollowingErrorError,
    InputError,
    LimitError,
    LinkLostError,
    NoAnswerError,
    SafetyError,
    StateError,
)
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind

LIMITS = DriveLimits(-300.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
SCALING = AxisScaling(100_000, 10.0)
MEGABIT = 1_000_000
K = CanFaultKind


@dataclass
class Rig:
    bench: CanBench
    drives: list[CanOpenDrive]

    def now_s(self) -> float:
        return self.bench.clock.now_ns() / 1e9

    def assert_safe(self) -> None:
        """Every axis at rest, and none still following set-points."""
        self.bench.clock.sleep_s(2.0)
        for node_id, servo in self.bench.servos.items():
            assert servo.velocity_actual_counts_s == 0, node_id
            assert self.bench.slaves[node_id].profile.state is not DriveState.ENABLED, node_id


def _rig(
    stack: ExitStack, axes: int, bitrate: int | None = MEGABIT, faults: dict[int, list[CanFault]] | None = None
) -> Rig:
    node_ids = tuple(range(1, axes + 1))
    bench = CanBench(node_ids, bitrate, faults or {})
    link = stack.enter_context(CanLink(bench.port(), bench.clock, bitrate or MEGABIT))
    drives = []
    for node_id in node_ids:
        drive = CanOpenDrive(
            f"axis {node_id}",
            SCALING,
            LIMITS,
            bench.clock,
            link=link,
            node_id=node_id,
            settings=CanOpenSettings(heartbeat_s=0.5, sdo_timeout_s=0.05),
        )
        stack.enter_context(drive)
        drive.enable()
        drives.append(drive)
    return Rig(bench, drives)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def _sine(time_s: float, number: int) -> float:
    return (5.0 + number) * (1 - math.cos(2 * math.pi * (1.0 + 0.2 * number) * time_s))


@pytest.mark.parametrize(("axes", "period_s"), [(1, 0.001), (2, 0.001), (5, 0.002)])
def test_published_cycles_fit_without_a_miss(
    stack: ExitStack, axes: int, period_s: float, record_property: Callable[[str, object], None]
) -> None:
    """Two axes at 1 ms and five at 2 ms: within 70 % of the bus, no cycle missed, no feedback late."""
    rig = _rig(stack, axes)
    settings = SetPointSettings(period_s, following_error_mm=2.0)
    cycles = 1000 // axes
    with CyclicStream(rig.drives, settings) as stream:
        busy_ns, start_ns = rig.bench.wire.busy_ns, rig.bench.clock.now_ns()
        worst_mm = 0.0
        for cycle in range(cycles):
            targets = [_sine(cycle * period_s, number) for number in range(axes)]
            stream.cycle(targets)
            worst_mm = max(
                worst_mm, *(abs(seen[1] - target) for seen, target in zip(stream.found, targets, strict=True))
            )
        load = rig.bench.wire.load(busy_ns, start_ns)
        elapsed_ns = rig.bench.clock.now_ns() - start_ns
    record_property("bus_load", load)
    print(f"{axes} axes at {1e3 * period_s:g} ms: {100 * load:.1f} % of the bus")
    assert stream.cycles == cycles
    assert (stream.missed_cycles, stream.late_feedback) == (0, 0)
    assert load <= 0.70
    assert elapsed_ns == pytest.approx(cycles * period_s * 1e9, rel=0.01)
    assert worst_mm < 2.0
    assert all(drive.sample().state is DriveState.ENABLED for drive in rig.drives)


def _cycles(rig: Rig, values: list[float], settings: SetPointSettings | None = None) -> CyclicStream:
    with CyclicStream(rig.drives, settings or SetPointSettings(0.001)) as stream:
        for value in values:
            stream.cycle([value])
    return stream


@pytest.mark.parametrize(("wrong", "match"), [(300.1, "outside the travel"), (math.nan, "outside"), (1.0, "step of")])
def test_the_set_points_are_refused_before_the_wire(stack: ExitStack, wrong: float, match: str) -> None:
    rig = _rig(stack, 1)
    with pytest.raises(LimitError, match=match):
        _cycles(rig, [0.0, wrong])
    rig.assert_safe()
    assert rig.bench.servo.position_actual_counts == 0


def test_a_cycle_that_cannot_fit_is_refused_before_anything_is_written(stack: ExitStack) -> None:
    """4 × (95 bits of a set-point + 115 of its answer, stuffing at its worst) + 55 of SYNC, at 1 Mbit/s."""
    rig = _rig(stack, 4)
    frames = rig.bench.wire.frames
    with (
        pytest.raises(InputError, match="90 % of the bus, at most 70 %"),
        CyclicStream(rig.drives, SetPointSettings(0.001)),
    ):
        pytest.fail("entered")
    assert rig.bench.wire.frames == frames


@pytest.mark.parametrize(
    ("bitrate", "period_s", "share"), [(500_000, 0.0007, 76), (250_000, 0.0015, 71), (125_000, 0.003, 71)]
)
def test_a_cycle_is_held_against_the_bit_rate_of_the_bus(
    stack: ExitStack, bitrate: int, period_s: float, share: int
) -> None:
    """95 bits of a set-point, 115 of its answer and 55 of SYNC, stuffing at its worst; half of that load is kept."""
    rig = _rig(stack, 1, bitrate)
    frames = rig.bench.wire.frames
    with (
        pytest.raises(InputError, match=f"{share} % of the bus, at most 70 %"),
        CyclicStream(rig.drives, SetPointSettings(period_s)),
    ):
        pytest.fail("entered")
    assert rig.bench.wire.frames == frames
    with CyclicStream(rig.drives, SetPointSettings(2 * period_s)) as stream:
        for cycle in range(100):
            stream.cycle([0.01 * cycle])
    assert (stream.missed_cycles, stream.late_feedback) == (0, 0)


def _stream_until_it_stops(
    rig: Rig, settings: SetPointSettings, seconds: float = 1.0
) -> tuple[BridgeError, CyclicStream]:
    stream = CyclicStream(rig.drives, settings)
    try:
        with stream:
            start_s = rig.now_s()
            for cycle in range(round(seconds / settings.period_s)):
                stream.cycle([20.0 * cycle * settings.period_s] * len(rig.drives))
            pytest.fail(f"nothing stopped the stream in {rig.now_s() - start_s} s")
    except BridgeError as error:
        return error, stream


def _late_faults(kind: CanFaultKind, **how: float) -> list[CanFault]:
    """From 0.5 s on: opening and enabling are through by then."""
    return [CanFault(kind, at_s=0.5, **how)]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("faults", "error", "match"),
    [
        (_late_faults(K.TPDO_LOST), NoAnswerError, "axis 2: no feedback for 4 cycles of 1 ms"),
        (_late_faults(K.TPDO_LATE, size=0.0007), NoAnswerError, "no feedback"),
        (_late_faults(K.NODE_DEAD), NoAnswerError, "axis 2: no feedback"),
        (_late_faults(K.SYNC_LOST), BridgeError, "axis 2"),
        (_late_faults(K.DRIVE_FAULT, size=0x3210), DriveFaultError, "axis 2 went into fault"),
        (_late_faults(K.SAFE_TORQUE_OFF), StateError, "axis 2 left operation enabled"),
        (_late_faults(K.FOREIGN_CONTROLWORD, size=0x0000), StateError, "axis 2 left operation enabled"),
        (
            _late_faults(K.STATUS_IMPOSSIBLE, duration_s=1.0),
            StateError,
            "axis 2 left operation enabled while streaming: unknown",
        ),
        (_late_faults(K.NMT_STOPPED), BridgeError, "axis 2"),
        (_late_faults(K.REBOOT), BridgeError, "axis 2"),
        (_late_faults(K.RPDO_LOST), FollowingErrorError, "axis 2: .* mm from its set-point"),
    ],
    ids=lambda value: value[0].kind.name.lower() if isinstance(value, list) else None,
)
def test_what_goes_wrong_stops_all_axes(
    stack: ExitStack, faults: list[CanFault], error: type[BridgeError], match: str
) -> None:
    rig = _rig(stack, 2, faults={2: faults})
    caught, _ = _stream_until_it_stops(rig, SetPointSettings(0.001, following_error_mm=0.5))
    assert isinstance(caught, error)
    assert re.search(match, str(caught)), caught
    rig.assert_safe()


def test_a_heartbeat_that_stops_while_feedback_goes_on_ends_the_stream(stack: ExitStack) -> None:
    rig = _rig(stack, 1, faults={1: _late_faults(K.HEARTBEAT_STOPS)})
    caught, stream = _stream_until_it_stops(rig, SetPointSettings(0.005), seconds=3.0)
    assert isinstance(caught, LinkLostError)
    assert re.search("axis 1: no heartbeat of node 1", str(caught))
    assert stream.late_feedback == 0
    rig.assert_safe()


def test_frames_that_come_twice_are_not_taken_for_the_next_cycles(stack: ExitStack) -> None:
    rig = _rig(stack, 1, faults={1: _late_faults(K.DUPLICATES)})
    with CyclicStream(rig.drives, SetPointSettings(0.002)) as stream:
        for cycle in range(350):
            stream.cycle([0.02 * cycle])  # 10 mm/s: one cycle is 20 µm
            present_mm = rig.bench.servo.position_actual_counts / 10_000
            assert abs(present_mm - stream.found[0][1]) < 0.012, cycle
    assert present_mm > 6.5


@pytest.mark.parametrize("kind", [K.TPDO_LOST, K.TPDO_LATE])
def test_a_few_late_answers_are_counted_and_lived_with(stack: ExitStack, kind: CanFaultKind) -> None:
    fault = CanFault(kind, at_s=0.3, size=0.0012, count=3)
    rig = _rig(stack, 1, faults={1: [fault]})
    with CyclicStream(rig.drives, SetPointSettings(0.001)) as stream:
        for cycle in range(600):
            stream.cycle([20.0 * cycle * 0.001])
        assert 1 <= stream.late_feedback <= 3
        assert stream.cycles == 600


def test_the_first_cycle_without_feedback_finds_the_axis_where_it_stands(stack: ExitStack) -> None:
    rig = _rig(stack, 1, faults={1: [CanFault(K.TPDO_LATE, size=0.0009)]})
    (drive,) = rig.drives
    drive.start_move(3.0, 100.0)
    drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
    with CyclicStream(rig.drives, SetPointSettings(0.001)) as stream:
        entered_ns = rig.bench.clock.now_ns()
        stream.cycle([3.0])
        ((seen_ns, place_mm),) = stream.found
    assert stream.late_feedback == 1
    assert place_mm == pytest.approx(3.0, abs=1e-3)
    assert entered_ns - 20_000_000 < seen_ns <= entered_ns


def test_a_host_that_is_late_now_and_then_is_counted(stack: ExitStack) -> None:
    rig = _rig(stack, 1)
    with CyclicStream(rig.drives, SetPointSettings(0.001, missed_limit=3)) as stream:
        for cycle in range(100):
            if cycle % 10 == 5:
                rig.bench.clock.sleep_s(0.0025)  # the caller thinks for two and a half cycles
            stream.cycle([0.0])
        assert stream.missed_cycles == 10
        assert stream.cycles == 100


def test_a_host_that_stays_away_is_stopped(stack: ExitStack) -> None:
    rig = _rig(stack, 1)
    stream = stack.enter_context(CyclicStream(rig.drives, SetPointSettings(0.001)))
    stream.cycle([0.0])
    rig.bench.clock.sleep_s(0.0049)
    with pytest.raises(SafetyError, match="missed in a row"):
        stream.cycle([0.0])
    rig.assert_safe()


def test_a_master_that_dies_while_streaming_leaves_a_safe_axis(stack: ExitStack) -> None:
    """Nothing is sent any more, not even a stop: the drive misses SYNC (1006h) and faults by itself."""
    rig = _rig(stack, 1)
    stream = CyclicStream(rig.drives, SetPointSettings(0.001))
    stream.__enter__()
    for cycle in range(200):
        stream.cycle([0.1 * cycle])
    rig.bench.clock.sleep_s(0.05)
    assert rig.bench.slave.profile.state in (DriveState.FAULT, DriveState.FAULT_REACTION)
    assert rig.bench.servo.fault_code == 0x8700
    with pytest.raises(BridgeError):
        stream.cycle([20.0])
    stream.__exit__(None, None, None)
    rig.assert_safe()


def test_two_streams_cannot_share_a_drive(stack: ExitStack) -> None:
    rig = _rig(stack, 1)
    settings = SetPointSettings(0.001)
    with CyclicStream(rig.drives, settings) as stream:
        stream.cycle([0.0])
        with pytest.raises(StateError, match="streaming already"), CyclicStream(rig.drives, settings):
            pytest.fail("entered")
        stream.cycle([0.0])  # the first goes on
