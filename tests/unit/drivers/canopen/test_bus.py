"""The link: dispatch, bounded waits, errors in the caller, and coming back after the bus was lost."""

from __future__ import annotations

import subprocess
import sys
import uuid
from collections.abc import Iterator

import can
import pytest

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.clock import WallClock
from drivers.drive import DriveLimits, DriveState
from drivers.errors import LinkLostError, StateError
from drivers.scaling import AxisScaling
from sim_backends.canopen_bench import SMALL_SERVO, BareShaft, CanBench
from sim_backends.canopen_drive import served
from sim_backends.servo import SimulatedServo


@pytest.fixture
def channel() -> str:
    return uuid.uuid4().hex


@pytest.fixture
def pair(channel: str) -> Iterator[tuple[CanLink, can.BusABC]]:
    with (
        CanLink.open(WallClock(), interface="virtual", channel=channel) as link,
        can.Bus(interface="virtual", channel=channel) as other,
    ):
        yield link, other


Pair = tuple[CanLink, can.BusABC]


def _message(cob_id: int, data: bytes = b"", **how: bool) -> can.Message:
    return can.Message(arbitration_id=cob_id, data=data, **{"is_extended_id": False, **how})  # type: ignore[arg-type]


def test_each_handler_gets_its_own_frames(pair: Pair) -> None:
    link, other = pair
    first: list[bytes] = []
    second: list[bytes] = []
    watched: list[int] = []

    def to_first(_time_ns: int, data: bytes) -> None:
        first.append(data)

    link.subscribe(0x185, to_first)
    link.subscribe(0x185, lambda _time_ns, data: second.append(data))
    link.watch(lambda _time_ns, cob_id, _data: watched.append(cob_id))
    for cob_id in (0x185, 0x186):
        other.send(_message(cob_id, b"\x01"))
    link.poll()
    link.unsubscribe(0x185, to_first)
    link.unsubscribe(0x999, to_first)
    other.send(_message(0x185, b"\x02"))
    link.poll()
    assert first == [b"\x01"]
    assert second == [b"\x01", b"\x02"]
    assert watched == [0x185, 0x186, 0x185]
    assert link.frames_received == 3


def test_frames_that_are_not_ours_are_passed_over(pair: Pair) -> None:
    link, other = pair
    seen: list[bytes] = []
    link.subscribe(0x185, lambda _time_ns, data: seen.append(data))
    other.send(_message(0x185, is_extended_id=True))
    other.send(_message(0x185, is_remote_frame=True))
    other.send(_message(0x185, is_error_frame=True))
    link.poll()
    assert seen == []
    assert link.error_frames == 1


def test_a_wait_is_bounded(pair: Pair) -> None:
    link, other = pair
    start_ns = link.clock.now_ns()
    assert not link.wait(lambda: False, 0.05)
    assert 0.045e9 < link.clock.now_ns() - start_ns < 5e9
    other.send(_message(0x185))
    assert link.wait(lambda: link.frames_received == 1, 5.0)


def test_a_closed_link_says_so(channel: str) -> None:
    link = CanLink.open(WallClock(), interface="virtual", channel=channel)
    link.close()
    link.close()
    with pytest.raises(LinkLostError, match="cannot be sent"):
        link.send(0x080, b"")
    with pytest.raises(LinkLostError, match="is gone"):
        link.poll()


def test_an_interface_that_is_not_there_says_so() -> None:
    with pytest.raises(LinkLostError, match="CAN nonsense can0 cannot be opened"):
        CanLink.open(WallClock(), interface="nonsense", channel="can0")


def test_a_link_that_was_given_its_bus_cannot_open_another() -> None:
    bench = CanBench((5,))
    with CanLink(bench.port(), bench.clock) as link, pytest.raises(StateError, match="was given its bus"):
        link.reopen()


def test_back_after_the_bus_was_lost(channel: str) -> None:
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    limits = DriveLimits(-100.0, 100.0, 100.0, 1000.0)
    with (
        served(servo, WallClock(), channel=channel, node_id=5),
        CanLink.open(WallClock(), interface="virtual", channel=channel) as link,
    ):
        drive = CanOpenDrive("X", AxisScaling(100_000, 10.0), limits, link.clock, link=link, node_id=5)
        drive.open()
        link.bus.shutdown()  # the adapter is pulled
        with pytest.raises(LinkLostError):
            drive.sample()
        drive.close()
        link.reopen()
        with drive:
            assert drive.sample().state is DriveState.SWITCH_ON_DISABLED


HEARTBEAT_OF_A_DEAD_BUS = """
import time, can
from drivers.canopen.bus import CanLink
from drivers.clock import WallClock

class Dying(can.BusABC):
    channel_info, sent = "dying", 0
    def __init__(self):
        super().__init__(channel=None)
    def send(self, msg, timeout=None):
        self.sent += 1
        if self.sent > 2:
            raise can.CanOperationError("the adapter is gone")
    def recv(self, timeout=None):
        return None

bus = Dying()
link = CanLink(bus, WallClock())
link.produce_heartbeat(127, 0.01)
deadline = time.monotonic() + 20.0
while bus.sent < 3 and time.monotonic() < deadline:
    time.sleep(0.01)
time.sleep(0.05)
link.close()
print(bus.sent)
"""


def test_a_heartbeat_on_a_dead_bus_ends_without_a_word_on_the_terminal() -> None:
    """Its sender is a thread of python-can's; who works with the bus is told by an error, in one line."""
    run = subprocess.run([sys.executable, "-c", HEARTBEAT_OF_A_DEAD_BUS], capture_output=True, text=True, check=True)
    assert (run.stdout, run.stderr) == ("3\n", "")
