"""A stop that is posted to a serial line on which a request is under way: when it leaves, and that it is a frame of its own."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from drivers.listening import Listening
from drivers.modbus import ports
from drivers.modbus.ports import SerialPort

pytestmark = pytest.mark.outside

REQUEST, REPLY, STOP = b"\x01\x03\x00\x00\x00\x02\xc4\x0b", b"\x01\x03\x04\x00\x00\x00\x00\xfa\x33", b"the stop"
TIMEOUT_S = 2.0


class Stopped(KeyboardInterrupt): ...


@dataclass
class Line:
    """The far end of a pseudo-terminal: notes what comes in and when; answers a request as it is told to."""

    port: SerialPort
    far: int
    came: list[tuple[float, bytes]] = field(default_factory=list)
    answer: Callable[[], None] = lambda: None
    interrupt: bool = False
    ended: bool = False

    def listen(self) -> None:
        while not self.ended:
            data = os.read(self.far, 256)
            self.came.append((time.monotonic(), data))
            if REQUEST in data:
                self.answer()

    def reply_after(self, delay_s: float) -> None:
        def reply() -> None:
            time.sleep(delay_s)
            os.write(self.far, REPLY)
            self.came.append((time.monotonic(), b"reply"))

        self.answer = reply

    def check(self) -> None:
        if self.interrupt:
            raise Stopped

    def broken_off(self) -> float:
        """A request whose wait hears the operator at once, then the stop; when the request was sent."""
        with pytest.raises(Stopped), self.port.exchange():  # noqa: PT012 - both halves of the exchange
            self.port.send(REQUEST)
            sent_s = time.monotonic()
            self.interrupt = True
            self.port.receive(Listening(TIMEOUT_S))
        self.port.post([STOP])
        return sent_s

    def frames(self) -> list[bytes]:
        until_s = time.monotonic() + 1.0
        while not any(STOP in data for _, data in self.came) and time.monotonic() < until_s:
            time.sleep(0.001)
        return [data for _, data in self.came]

    def stop_came_s(self) -> float:
        self.frames()
        return next(when for when, data in self.came if STOP in data)


def _line(baud: int) -> Iterator[Line]:
    far, near = os.openpty()
    tty.setraw(near)
    line: Line
    port = SerialPort(os.ttyname(near), baud, parity="N", stop_bits=1, timeout_s=1.0, check=lambda: line.check())  # noqa: PLW0108
    line = Line(port, far)
    port.open(1.0)
    thread = threading.Thread(target=line.listen, daemon=True)
    thread.start()
    yield line
    line.ended = True
    os.write(near, b"end")
    thread.join()
    port.close()
    os.close(near)
    os.close(far)


@pytest.fixture
def line() -> Iterator[Line]:
    yield from _line(19200)


@pytest.fixture
def slow_line() -> Iterator[Line]:
    yield from _line(1200)


def test_a_stop_is_sent_after_the_reply_under_way(line: Line) -> None:
    line.reply_after(0.012)
    line.broken_off()
    assert line.frames() == [REQUEST, b"reply", STOP]


def test_a_stop_waits_for_no_time_out_of_a_dead_unit(line: Line) -> None:
    sent_s = line.broken_off()
    assert line.frames() == [REQUEST, STOP]
    assert 0.02 <= line.stop_came_s() - sent_s < 0.2


def test_a_stop_waits_until_the_request_has_left_a_slow_line(slow_line: Line) -> None:
    """Eight characters of 1200 baud: 73 ms, within which the port has long taken the bytes."""
    sent_s = slow_line.broken_off()
    assert slow_line.frames() == [REQUEST, STOP]
    assert slow_line.stop_came_s() - sent_s >= 8 * 11 / 1200


@pytest.mark.parametrize("delay_s", [0.0, 0.012, None])
def test_a_stop_from_another_thread_leaves_while_a_reply_is_awaited(line: Line, delay_s: float | None) -> None:
    if delay_s is not None:
        line.reply_after(delay_s)
    sent: list[float] = []

    def ask() -> None:
        with line.port.exchange():
            line.port.send(REQUEST)
            sent.append(time.monotonic())
            line.port.receive(Listening(TIMEOUT_S))

    thread = threading.Thread(target=ask)
    thread.start()
    while not sent:
        time.sleep(0.001)
    line.port.post([STOP])
    assert line.stop_came_s() - sent[0] < 0.2
    thread.join()
    if delay_s is not None:
        assert line.frames()[:3] == [REQUEST, b"reply", STOP]


def test_a_stop_is_heard_where_select_of_an_empty_terminal_hangs(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    """As it does for a kernel thread where all cores are busy."""
    wait = select.select

    def hanging(*lists: list[int]) -> tuple[list[int], ...]:
        found = wait(*lists[:3], 0.0)
        if not any(found):
            time.sleep(0.5)
        return found

    monkeypatch.setattr(select, "select", hanging)
    pressed: list[float] = []

    def press() -> None:
        time.sleep(0.1)
        line.interrupt = True
        pressed.append(time.monotonic())

    thread = threading.Thread(target=press)
    thread.start()
    with pytest.raises(Stopped):
        line.port.receive(Listening(TIMEOUT_S))
    heard_s = time.monotonic()
    thread.join()
    assert heard_s - pressed[0] < 0.2


def test_a_free_line_carries_a_stop_at_once(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "_TURNAROUND_S", 1.0)
    line.reply_after(0.0)
    with line.port.exchange():
        line.port.send(REQUEST)
        assert line.port.receive(Listening(TIMEOUT_S))
    began_s = time.monotonic()
    line.port.post([STOP])
    assert time.monotonic() - began_s < 0.5
    assert line.frames()[-1] == STOP
