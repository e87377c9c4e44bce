"""The link: dispatch, bounded waits, errors in the caller, and coming back after the bus was lost."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
import tty
import uuid
from collections.abc import Iterator
from itertools import pairwise

import can
import pytest
from support.can_bench import CanBench

from drivers.canopen.adapters import SEND_S, bound_sending
from drivers.canopen.bus import POLL_S, STOP_SEND_S, CanLink
from drivers.canopen.sync import SYNC_SILENCE_S, SYNC_STEP_S, Sync
from drivers.clock import IO_SLICE_S, WallClock
from drivers.errors import LinkLostError
from sim_backends.clock import SimClock


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


def _heard(link: CanLink) -> list[int]:
    """Identifiers of the frames that it receives from now on."""
    heard: list[int] = []
    link.watch(lambda _time_ns, cob_id, _data: heard.append(cob_id))
    return heard


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


def test_frames_that_are_not_ours_are_passed_over(pair: Pair) -> None:
    link, other = pair
    seen: list[bytes] = []
    link.subscribe(0x185, lambda _time_ns, data: seen.append(data))
    other.send(_message(0x185, is_extended_id=True))
    other.send(_message(0x185, is_remote_frame=True))
    other.send(_message(0x185, is_error_frame=True))
    link.poll()
    assert seen == []


@pytest.mark.outside
@pytest.mark.parametrize("before", [b"", b"z\r", b"\r\rz\rz\r", b"z\r" * 30])
def test_lines_of_an_adapter_that_are_no_frames_hide_none(before: bytes) -> None:
    """An slcan adapter acknowledges every frame that is sent; what came meanwhile waits behind that."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        bus = can.Bus(os.ttyname(slave), interface="slcan", sleep_after_open=0.0)
        with CanLink(bus, WallClock()) as link:
            heard = _heard(link)
            os.write(master, before + b"t1852AABB\r" + before + b"t705105\r")
            link.poll()
            assert heard == [0x185, 0x705]
    finally:
        os.close(master)
        os.close(slave)


def test_a_handlers_error_is_raised_in_the_call_that_waits_and_the_link_goes_on(pair: Pair) -> None:
    """Where python-can's own Notifier loses its thread, and who sends never learns."""
    link, other = pair

    def handler(_time_ns: int, _data: bytes) -> None:
        raise RuntimeError("a handler's mistake")

    link.subscribe(0x181, handler)
    heard = _heard(link)
    other.send(_message(0x181))
    with pytest.raises(RuntimeError, match="a handler's mistake"):
        link.wait(lambda: False, 1.0)
    other.send(_message(0x182))
    assert link.wait(lambda: heard == [0x181, 0x182], 5.0)


def test_a_wait_is_bounded(pair: Pair) -> None:
    link, other = pair
    heard = _heard(link)
    start_ns = link.clock.now_ns()
    assert not link.wait(lambda: False, 0.05)
    assert 0.045e9 < link.clock.now_ns() - start_ns < 5e9
    other.send(_message(0x185))
    assert link.wait(lambda: heard == [0x185], 5.0)


class _Operator:
    """Presses the stop when it is asked for the third time, however late on a busy computer; real time passes as it does."""

    def __init__(self) -> None:
        self._left = 3

    def real(self, duration_s: float) -> None:
        self._left -= 1
        if not self._left:
            raise KeyboardInterrupt
        time.sleep(duration_s)

    def simulated(self, now_ns: int) -> None:
        raise NotImplementedError


@pytest.mark.parametrize("flood", [False, True], ids=["dead-node", "flood"])
def test_the_operator_is_heard_while_frames_are_waited_for(channel: str, flood: bool) -> None:
    """A node that does not answer, alone or beside one that never falls silent."""
    operator = _Operator()
    with (
        CanLink.open(WallClock(operator), interface="virtual", channel=channel) as link,
        can.Bus(interface="virtual", channel=channel) as other,
    ):
        if flood:
            link.watch(lambda *_: other.send(_message(0x181)))  # each frame brings the next
            other.send(_message(0x181))
        start_s = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            link.wait(lambda: False, 30.0)
        assert time.monotonic() - start_s < 5.0


def test_a_flood_ends_neither_a_wait_nor_a_look_late(pair: Pair) -> None:
    link, other = pair
    heard = _heard(link)
    link.watch(lambda *_: other.send(_message(0x181)))
    other.send(_message(0x181))
    start_ns = link.clock.now_ns()
    link.poll()
    assert not link.wait(lambda: False, 0.05)
    assert link.clock.now_ns() - start_ns < 5e9
    assert len(heard) > 10


def test_the_operator_is_asked_in_every_slice_of_a_wait_in_simulated_time() -> None:
    """And a wait lasts as long as without."""
    asked: list[int] = []

    class Watching:
        def real(self, duration_s: float) -> None:
            raise NotImplementedError

        def simulated(self, now_ns: int) -> None:
            asked.append(now_ns)

    bench = CanBench((5,))
    bench.clock._waiting = Watching()
    with CanLink(bench.port(), bench.clock) as link:
        start_ns = bench.clock.now_ns()
        assert not link.wait(lambda: False, 0.1)
        assert bench.clock.now_ns() - start_ns == 100_000_000
    gaps = [after - before for before, after in pairwise([start_ns, *asked])]
    assert max(gaps) <= IO_SLICE_S * 1e9


def test_a_bus_that_takes_nothing_holds_a_frame_up_for_a_moment_only(pair: Pair) -> None:
    link, _ = pair
    asked: list[float | None] = []

    def full(_message: can.Message, timeout: float | None = None) -> None:
        asked.append(timeout)
        raise can.CanOperationError("Transmit buffer full")

    link.bus.send = full  # type: ignore[method-assign]
    with pytest.raises(LinkLostError, match="Transmit buffer full"):
        link.send(0x305, b"\x02\x00", STOP_SEND_S)
    with pytest.raises(LinkLostError, match="Transmit buffer full"):
        link.send(0x205, b"\x0f\x00")
    assert asked == [STOP_SEND_S, SEND_S]
    assert STOP_SEND_S <= 0.02


def test_a_server_that_no_longer_reads_does_not_hold_a_frame_up_for_ever() -> None:
    """Behind a TCP connection python-can ignores the time-out; the socket itself is given one."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()  # and never reads

        class OverTcp(can.BusABC):
            channel_info = "over TCP"

            def __init__(self) -> None:
                super().__init__(channel=None)

            def fileno(self) -> int:
                return ours.fileno()

            def send(self, msg: can.Message, timeout: float | None = None) -> None:
                del msg, timeout
                ours.sendall(bytes(65536))

        bus = OverTcp()
        bound_sending(bus)
        with ours, theirs, CanLink(bus, WallClock()) as link:

            def fill() -> None:
                for _ in range(10_000):
                    link.send(0x305, b"\x02\x00")

            with pytest.raises(LinkLostError, match="cannot be sent"):
                fill()


class _Follower:
    specs = ()

    def __init__(self, node_id: int) -> None:
        self.node_id = node_id

    def leave_sync(self) -> bool:
        return True


def test_of_two_that_wait_for_the_same_silence_one_takes_sync_up_first() -> None:
    """Both heard each other at the same moment: the link with the lower node id is first by more than a look takes."""
    clock = SimClock()
    low, high = Sync(clock), Sync(clock)
    low.followers += [_Follower(9), _Follower(5)]
    high.followers += [_Follower(6)]
    for sync in (low, high):
        sync.heard(clock.now_ns(), b"")
    clock.sleep_s(SYNC_SILENCE_S)
    assert (low.taken, high.taken) == (True, True)
    clock.sleep_s(SYNC_STEP_S * 5 + 0.001)
    assert (low.taken, high.taken) == (False, True)
    clock.sleep_s(SYNC_STEP_S)
    assert high.taken is False


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


HEARTBEAT_OF_A_DEAD_BUS = """
import time, can
from drivers.canopen.bus import CanLink
from drivers.clock import IO_SLICE_S, WallClock

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


@pytest.mark.outside
def test_a_heartbeat_on_a_dead_bus_ends_without_a_word_on_the_terminal() -> None:
    """Its sender is a thread of python-can's; who works with the bus is told by an error, in one line."""
    run = subprocess.run([sys.executable, "-c", HEARTBEAT_OF_A_DEAD_BUS], capture_output=True, text=True, check=True)
    assert (run.stdout, run.stderr) == ("3\n", "")


class Endless(can.BusABC):
    """There is always another frame; each takes `takes_s` to dispatch."""

    channel_info = "endless"

    def __init__(self, clock: SimClock, takes_s: float) -> None:
        super().__init__(channel=None)
        self._clock = clock
        self._takes_s = takes_s

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self._clock.sleep_s(self._takes_s)
        return _message(0x185)


def test_frames_without_end_do_not_keep_poll() -> None:
    clock = SimClock()
    link = CanLink(Endless(clock, 3e-5), clock)
    heard = _heard(link)
    link.poll()
    assert clock.now_ns() == pytest.approx(POLL_S * 1e9, abs=1e5)
    assert len(heard) == pytest.approx(POLL_S / 3e-5, abs=2)
    link.close()


def test_the_operator_is_heard_while_frames_without_end_are_polled() -> None:
    class Stopping(SimClock):
        def check_interrupt(self) -> None:
            raise KeyboardInterrupt

    clock = Stopping()
    link = CanLink(Endless(clock, 3e-5), clock)
    with pytest.raises(KeyboardInterrupt):
        link.poll()
    assert clock.now_ns() <= 1.1 * IO_SLICE_S * 1e9
    link.close()


def test_a_thread_whose_frame_another_one_dispatched_returns_with_it() -> None:
    """Both wait, and the frame of the one that does not dispatch comes first: it does not listen for a further one."""
    channel, after_ms = uuid.uuid4().hex, []
    with (
        CanLink.open(WallClock(), interface="virtual", channel=channel) as link,
        can.Bus(interface="virtual", channel=channel) as other,
    ):
        heard = dict.fromkeys((0x181, 0x182), 0)
        for cob_id in heard:
            link.subscribe(cob_id, lambda time_ns, _data, cob_id=cob_id: heard.__setitem__(cob_id, time_ns))  # type: ignore[misc]

        def waits(cob_id: int, looks: threading.Semaphore) -> None:
            def done() -> bool:
                looks.release()
                return heard[cob_id] > 0

            assert link.wait(done, 5.0)
            if cob_id == 0x181:
                after_ms.append((link.clock.now_ns() - heard[cob_id]) / 1e6)

        for _ in range(10):
            heard.update(dict.fromkeys(heard, 0))
            threads = []
            for cob_id in (0x182, 0x181):  # the first one dispatches
                looks = threading.Semaphore(0)
                threads.append(threading.Thread(target=waits, args=(cob_id, looks)))
                threads[-1].start()
                for _ in range(2):  # before its turn, and in it or instead of it
                    assert looks.acquire(timeout=5.0)
            for cob_id in (0x181, 0x182):
                other.send(can.Message(arbitration_id=cob_id, is_extended_id=False))
            for thread in threads:
                thread.join()
    assert min(after_ms) < 3.0  # it listened for 5 ms
