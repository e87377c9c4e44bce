"""The socket or serial port of a Modbus wire. Every wait is cut into slices, can be interrupted between them, and ends in real time.

A stop is *posted*: it is sent without waiting for a reply and without any lock. On TCP it goes beside the exchange in progress, as
replies are numbered there. A serial line carries one frame at a time, and two frames without silence between them are lost: a stop
waits until the request in progress is sent and for its reply, but for no time-out. A unit that has not begun to reply `_TURNAROUND_S`
after the request may be dead; the stop is then sent, and, during an exchange, once more at its end, as a late reply may have
destroyed it.
"""

from __future__ import annotations

import queue
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

import serial

from drivers.clock import IO_SLICE_S
from drivers.listening import Listening
from drivers.modbus.plan import silent_interval_s
from drivers.serial_writing import write_now

Check = Callable[[], None]
"""check(): raises the error that ends the present wait, such as the operator's stop (`Clock.check_interrupt`)."""

_LONGEST_FRAME = 256  # bytes of the longest RTU frame (Modbus over serial line V1.02, 2.3)
_BITS_PER_CHARACTER = 11  # 2.5.1
_TURNAROUND_S = 0.02
"""Time a stop waits for a reply to begin, s: most drives take 1 to 20 ms. The standard
leaves the time-out to the master (2.4.1)."""


def slices(within: Listening, check: Check) -> Iterator[float]:
    """Durations to block next, s, until the time-out is over; `check` is called before each. The last one is 0.0.

    Before and not after: while bytes come in all the time no second slice is taken.
    """
    while slice_s := within.next_slice_s():
        check()
        yield slice_s
    yield 0.0


class Port(ABC):
    """Bytes to and from one line. Every method raises OSError when the line is lost, and what `check` raises."""

    rest_of_frame_s = 0.0  # extra time for a reply that has begun within the time-out, s

    @property
    @abstractmethod
    def is_open(self) -> bool: ...

    @abstractmethod
    def open(self, within_s: float) -> None:
        """Connect. within_s: used instead of the time-out if it is less, s."""

    @abstractmethod
    def close(self) -> None:
        """Close the line; never raises."""

    @abstractmethod
    def send(self, frame: bytes) -> None: ...

    @abstractmethod
    def receive(self, within: Listening) -> bytes:
        """The bytes that have arrived, as soon as there are any; b"" when there are none within the time-out."""

    @abstractmethod
    def discard(self, silence_s: float) -> None:
        """Read and discard until nothing has come for silence_s; a line that never falls silent is not waited for."""

    @abstractmethod
    def post(self, frames: Sequence[bytes]) -> None:
        """Send without waiting for replies, from any thread and from a signal handler."""

    @contextmanager
    def exchange(self) -> Iterator[None]:
        """Context of one exchange: a request is sent and its reply awaited inside."""
        yield


# -- TCP ---------------------------------------------------------------------------------------------------------------
class TcpPort(Port):
    """A connection to a server; timeout_s: for connecting, s."""

    def __init__(self, host: str, port: int, timeout_s: float, check: Check) -> None:
        self._place = (host, port)
        self._peer: tuple[str, int] | None = None  # the same, with the name resolved
        self._timeout_s = timeout_s
        self._check = check
        self._socket: socket.socket | None = None

    @property
    def is_open(self) -> bool:
        """False once the server has closed the connection, as idle ones do: a write would be lost there, and is sent only once."""
        return self._socket is not None and not _hung_up(self._socket)

    def open(self, within_s: float) -> None:
        self.close()
        connection = _dialled(self._place, min(self._timeout_s, within_s), self._check)
        # without it a posted stop waits until the request before it is acknowledged (Nagle's algorithm)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._peer = connection.getpeername()[:2]
        self._socket = connection

    def close(self) -> None:
        connection, self._socket = self._socket, None
        if connection is not None:
            with suppress(OSError):
                connection.close()

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise ConnectionError("not connected")
        return self._socket

    def send(self, frame: bytes) -> None:
        connection = self._opened()
        connection.settimeout(IO_SLICE_S)  # the buffer fills up only where the server does not read
        connection.sendall(frame)

    def receive(self, within: Listening) -> bytes:
        connection = self._opened()
        for slice_s in slices(within, self._check):
            connection.settimeout(slice_s)
            with suppress(TimeoutError, BlockingIOError):
                data = connection.recv(4096)
                if not data:
                    raise ConnectionResetError("connection lost")
                return data
        return b""

    def discard(self, silence_s: float) -> None:
        """Nothing to do: replies are numbered, so that an old one is recognised."""

    def post(self, frames: Sequence[bytes]) -> None:
        data, connection = b"".join(frames), self._socket
        if connection is not None and not _hung_up(connection):
            with suppress(OSError):
                if connection.send(data) == len(data):
                    return
        # in a thread, so that an unreachable server does not delay other stops
        threading.Thread(target=self._post_anew, args=(data,), name="modbus stop", daemon=True).start()

    def _post_anew(self, data: bytes) -> None:
        with suppress(OSError), socket.create_connection(self._peer or self._place, self._timeout_s) as connection:
            connection.sendall(data)


def _hung_up(connection: socket.socket) -> bool:
    """Whether the server has closed it, so that what is sent now would be lost."""
    try:
        connection.setblocking(False)  # with a time-out set, Python waits for it whatever the flags of `recv` are
        return connection.recv(1, socket.MSG_PEEK) == b""
    except (BlockingIOError, TimeoutError):
        return False
    except OSError:
        return True


def _dialled(place: tuple[str, int], timeout_s: float, check: Check) -> socket.socket:
    """A new connection, made in a thread, because resolving a name cannot be waited for in slices. Raises OSError."""
    done: queue.SimpleQueue[socket.socket | OSError] = queue.SimpleQueue()
    given_up = threading.Event()

    def hang_up() -> None:
        with suppress(queue.Empty):
            late = done.get_nowait()
            if isinstance(late, socket.socket):
                late.close()

    def dial() -> None:
        try:
            done.put(socket.create_connection(place, timeout_s))
        except (OSError, ValueError) as error:  # ValueError: a host name that cannot be one
            done.put(error if isinstance(error, OSError) else OSError(str(error)))
        if given_up.is_set():
            hang_up()

    threading.Thread(target=dial, name="modbus connect", daemon=True).start()
    try:
        for slice_s in slices(Listening(timeout_s), check):
            with suppress(queue.Empty):
                found = done.get(timeout=slice_s)
                if isinstance(found, OSError):
                    raise found
                return found
        raise TimeoutError(f"not connected within {timeout_s:g} s")
    finally:
        given_up.set()
        hang_up()


# -- serial lines --------------------------------------------------------------------------------------------------------
def _serial_errors() -> tuple[type[Exception], ...]:
    """Errors of pyserial besides OSError: TypeError for a port closed during a call, and termios.error where there are terminals."""
    try:
        import termios  # noqa: PLC0415
    except ImportError:
        return (ValueError, TypeError)
    return (ValueError, TypeError, termios.error)


_SERIAL_ERRORS = _serial_errors()


@contextmanager
def _as_os_error() -> Iterator[None]:
    try:
        yield
    except _SERIAL_ERRORS as error:
        raise OSError(str(error)) from error


_LOOK_S = 0.0005  # interval of checks for a byte, s
_MOST_SILENCES = 64  # `discard` ends after this many times the silence asked for


class SerialPort(Port):
    """A serial line; timeout_s: for a port that takes no bytes, s."""

    def __init__(self, device: str, baud: int, *, parity: str, stop_bits: int, timeout_s: float, check: Check) -> None:
        self._device = device
        self._settings = (baud, serial.EIGHTBITS, parity, stop_bits)
        self._timeout_s = timeout_s
        self._check = check
        self._silence_s = silent_interval_s(baud)
        self._character_s = _BITS_PER_CHARACTER / baud
        self.rest_of_frame_s = _LONGEST_FRAME * self._character_s
        self._serial: serial.Serial | None = None
        self._posted: deque[bytes] = deque()  # stops that wait for the exchange in progress
        self._early = 0  # number of them that were sent during it already
        self._exchanging = False
        self._reply_due_s = 0.0  # time by which the reply to the last frame must have begun, 0.0: none is awaited

    @property
    def is_open(self) -> bool:
        return self._serial is not None

    def open(self, within_s: float) -> None:
        del within_s  # a local device is opened at once
        with _as_os_error():
            self._serial = serial.Serial(
                self._device, *self._settings, timeout=IO_SLICE_S, write_timeout=self._timeout_s, exclusive=True
            )

    def close(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            with suppress(OSError), _as_os_error():  # a lost port is as good as closed
                port.close()

    def _opened(self) -> serial.Serial:
        if self._serial is None:
            raise ConnectionError("port is not open")
        return self._serial

    def send(self, frame: bytes) -> None:
        port = self._opened()
        _taken(port)  # discard replies that are no longer awaited
        self._expect_reply(frame)  # before sending: a stop may be posted meanwhile
        self._put(port, frame, self._check)
        self._expect_reply(frame)

    def _expect_reply(self, frame: bytes) -> None:
        self._reply_due_s = time.monotonic() + len(frame) * self._character_s + _TURNAROUND_S

    def _put(self, port: serial.Serial, frame: bytes, check: Check) -> None:
        for slice_s in slices(Listening(self._timeout_s), check):
            frame = frame[write_now(port, frame) :]
            if not frame:
                return
            time.sleep(slice_s)
        raise TimeoutError("the port accepts no bytes")

    def receive(self, within: Listening) -> bytes:
        port = self._opened()
        for slice_s in slices(within, self._check):
            if data := _taken(port, wait=slice_s > 0.0):
                self._reply_due_s = 0.0
                return data
            self._send_early(port)
        return b""

    def discard(self, silence_s: float) -> None:
        port = self._opened()
        silent_s = time.monotonic() + silence_s
        for _ in slices(Listening((1 + _MOST_SILENCES) * silence_s), self._check):
            if _taken(port, wait=True):
                silent_s = time.monotonic() + silence_s
            elif time.monotonic() >= silent_s:
                return

    # -- stops -------------------------------------------------------------------------------------------------------
    def post(self, frames: Sequence[bytes]) -> None:
        self._posted.extend(frames)
        if not self._exchanging:  # else the thread that awaits the reply sends them
            self._send_posted()

    @contextmanager
    def exchange(self) -> Iterator[None]:
        self._exchanging = True
        try:
            yield
        finally:
            self._exchanging = False
            self._early = 0
            self._send_posted()

    def _send_early(self, port: serial.Serial) -> None:
        waiting = tuple(self._posted)
        if len(waiting) > self._early and time.monotonic() >= self._reply_due_s:
            self._send_stop(port, waiting[self._early])
            self._early += 1

    def _send_posted(self) -> None:
        with suppress(IndexError, OSError), _as_os_error():  # IndexError: the queue is empty
            while True:
                self._send_stop(self._opened(), self._posted.popleft())

    def _send_stop(self, port: serial.Serial, frame: bytes) -> None:
        with _as_os_error():
            self._await_quiet(port)
            self._put(port, frame, lambda: None)
        self._expect_reply(frame)

    def _await_quiet(self, port: serial.Serial) -> None:
        """Wait until a reply to the last frame has begun in its time, and no byte has come for the silent interval; at most the
        time of the longest frame."""
        while time.monotonic() < self._reply_due_s and not port.in_waiting:
            time.sleep(0.001)
        end_s = time.monotonic() + self.rest_of_frame_s
        seen = -1
        while port.in_waiting != seen and time.monotonic() < end_s:
            seen = port.in_waiting
            time.sleep(self._silence_s)


def _taken(port: serial.Serial, *, wait: bool = False) -> bytes:
    """The bytes that have come in; wait: for the first byte, `IO_SLICE_S` at most.

    The count of waiting bytes is read: `select` on a terminal without input waits in Linux for a kernel thread
    (`tty_buffer_flush_work`), which takes up to 0.8 s where other programs keep all cores busy, whatever its time-out.
    """
    end_s = time.monotonic() + IO_SLICE_S
    with _as_os_error():
        while wait and not port.in_waiting and time.monotonic() < end_s:
            time.sleep(_LOOK_S)
        data: bytes = port.read(port.in_waiting)
        return data
