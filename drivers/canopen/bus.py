"""CanLink: one CAN bus with its clock: frames out, frames in, and waits with a time limit.

There is no receiver thread: the first thread that waits dispatches the frames, those of other waiting threads too. An exception in a
handler is raised by the call that dispatches, and several axes share one bus without a thread each. Sending takes none of this
module's locks, so that a stop can be sent from any thread while another one receives.
"""

from __future__ import annotations

import logging
import select
import threading
from collections.abc import Callable, Mapping
from typing import Any, Self

import can

from drivers.canopen.adapters import (
    READ_ERRORS,
    SEND_S,
    drop_undecoded,
    is_gone,
    open_adapter,
    place_of,
)
from drivers.canopen.sync import CLAIM_S, SYNC, YIELD_S, Sync
from drivers.clock import IO_SLICE_S, NS_PER_S, Clock
from drivers.errors import LinkLostError, StateError
from drivers.listening import Listening
from drivers.system_errors import told_with_remedy

FASTEST = 1_000_000
"""The highest bit rate of CAN, bit/s: what does not fit it fits no bus."""
POLL_S = 0.05
"""Longest time that `poll` dispatches, s. A frame takes about 30 µs, so this empties a socket's default receive buffer (about 280
frames) five times over; an endless stream brings a frame every 47 µs at most (1 Mbit/s, no data)."""
FrameHandler = Callable[[int, bytes], None]
"""handler(time_ns, data): a frame of the subscribed identifier, with the clock's time at which it was taken from the bus."""

# python-can's thread for periodic frames logs a lost bus with its traceback; here the waiting call raises LinkLostError instead
logging.getLogger("can").addHandler(logging.NullHandler())

_GONE = (can.CanError, OSError, ValueError)  # ValueError: python-can asks a closed socket for its number

STOP_SEND_S = 0.01
"""As `SEND_S`, for the frame of a stop, s: half of the 20 ms allowed from a stop to its frame."""
MOST_FAILED = 50
"""Number of reads that fail one after the other, with neither a frame nor silence between them, after which an adapter counts as gone:
more than a burst of noise brings, and over within `POLL_S` where every read fails at once."""

FOLLOW_S = 0.0005
"""While another thread dispatches: interval at which a waiting one looks whether its frame was among those, s."""

_SLICE_NS = round(IO_SLICE_S * NS_PER_S)


class _BusyError(Exception):
    """Another thread dispatches."""


class _Turn:
    """A thread's turn to dispatch, which comes within a time, s, or `_BusyError` is raised. A class, as a signal is handled
    between a call of `acquire` and a `try` after it, but not in `__enter__`; without a state, as every cycle of a stream takes two.
    """

    def __init__(self, lock: threading.RLock, within_s: float) -> None:
        self._lock, self._within_s = lock, within_s

    def __enter__(self) -> None:
        if not self._lock.acquire(True, self._within_s):
            raise _BusyError

    def __exit__(self, *exc_info: object) -> None:
        self._lock.release()


def _selectable(bus: can.BusABC) -> bool:
    """Whether the interface has a descriptor, which shows that something waits."""
    try:
        return bus.fileno() >= 0
    except (*_GONE, NotImplementedError):
        return False


class CanLink:
    """A python-can bus with its clock.

    bus: an open python-can bus of any interface; closed with the link. bitrate: of the bus, bit/s; by default the fastest of CAN.
    """

    def __init__(self, bus: can.BusABC, clock: Clock, bitrate: int = FASTEST) -> None:
        self.bus = bus
        self.clock = clock
        self.bitrate = bitrate
        self.place = place_of(bus)  # in errors
        self._channel: str | int = self.place
        self.takes_frames = True  # the last one that was sent
        self._failed = 0  # reads that failed since the last frame or silence
        self._handlers: dict[int, tuple[FrameHandler, ...]] = {}
        self._selectable = _selectable(bus)
        self._any: tuple[Callable[[int, int, bytes], None], ...] = ()
        self._subscribing = threading.Lock()
        self._dispatching = threading.RLock()
        self._turn_now, self._turn_soon = _Turn(self._dispatching, 0.0), _Turn(self._dispatching, FOLLOW_S)
        self.talking = threading.RLock()
        """Held during an SDO access: threads that share the link take turns."""
        self._closed = False
        self._heartbeats: dict[int, tuple[float, Any]] = {}
        self._checked_ns = 0  # last call of check_interrupt while dispatching
        self._taken_ns = 0  # when the last frame, or piece of one, was taken
        self.sync = Sync(clock)
        self.subscribe(SYNC, self.sync.heard)

    @classmethod
    def open(
        cls,
        clock: Clock,
        *,
        interface: str,
        channel: str | int,
        bitrate: int | None = None,
        options: Mapping[str, object] | None = None,
    ) -> Self:
        """Open a bus by python-can's interface name; options are the interface's own (host and port of a socketcand, say).

        Raises LinkLostError when it cannot be opened.
        """
        settings: dict[str, object] = dict(options or {})
        if bitrate is not None:
            settings["bitrate"] = bitrate
        link = cls(open_adapter(interface, channel, settings), clock, bitrate or FASTEST)
        link._channel, link.place = channel, f"{interface} {channel}"
        return link

    def close(self) -> None:
        """Close the bus; never raises for a bus that is already lost."""
        if self._closed:
            return
        self._closed = True
        self._heartbeats.clear()  # python-can stops the periodic frames with the bus
        try:
            self.bus.shutdown()
        except _GONE:
            return

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    # -- dispatch --------------------------------------------------------------------------------------------------
    def subscribe(self, cob_id: int, handler: FrameHandler) -> None:
        """Call the handler for each frame of an identifier; several handlers may share one."""
        with self._subscribing:
            self._handlers[cob_id] = (*self._handlers.get(cob_id, ()), handler)

    def unsubscribe(self, cob_id: int, handler: FrameHandler) -> None:
        """Undo one `subscribe`; nothing when it is not there."""
        with self._subscribing:
            handlers = list(self._handlers.get(cob_id, ()))
            if handler in handlers:
                handlers.remove(handler)
            if handlers:
                self._handlers[cob_id] = tuple(handlers)
            else:
                self._handlers.pop(cob_id, None)

    def watch(self, handler: Callable[[int, int, bytes], None]) -> None:
        """Call handler(time_ns, cob_id, data) for every data frame, before the subscribers."""
        self._any = (*self._any, handler)

    def unwatch(self, handler: Callable[[int, int, bytes], None]) -> None:
        """Undo one `watch`."""
        self._any = tuple(watcher for watcher in self._any if watcher != handler)

    # -- frames ----------------------------------------------------------------------------------------------------
    def send(self, cob_id: int, data: bytes, timeout_s: float = SEND_S) -> None:
        """Send one frame with an 11-bit identifier; raises as `send_message`."""
        self.send_message(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False), timeout_s)

    def send_message(self, message: can.Message, timeout_s: float = SEND_S) -> None:
        """Send a message object that the caller reuses for the next cycle; python-can's buses no longer use it when they return.

        For any thread. Raises LinkLostError when the bus does not take it within `timeout_s` seconds.
        """
        self.takes_frames = False
        try:
            self.bus.send(message, timeout_s)
        except _GONE as error:
            raise self._lost(f"frame {message.arbitration_id:03X}h cannot be sent", error) from error
        self.takes_frames = True

    def produce_heartbeat(self, node_id: int, period_s: float) -> None:
        """Send our own heartbeat (operational) every `period_s` seconds until the link is closed; drives that consume it stop when
        it ends.

        On SocketCAN the kernel's broadcast manager sends it, and stops when this process dies. Requested twice, the shorter
        period holds. Raises LinkLostError.
        """
        present = self._heartbeats.get(node_id)
        if present is not None:
            if present[0] <= period_s:
                return
            present[1].stop()
        message = can.Message(arbitration_id=0x700 + node_id, data=b"\x05", is_extended_id=False)
        try:
            self.bus.send(message)
        except _GONE as error:
            raise self._lost("heartbeat cannot be sent", error) from error
        self._heartbeats[node_id] = (period_s, self.send_periodically(message, period_s))

    def request_periodically(self, cob_id: int, period_s: float) -> Any:
        """Ask for the data of an identifier by remote frames, at once and every `period_s` seconds until `stop()` of the task.

        Raises LinkLostError."""
        message = can.Message(arbitration_id=cob_id, is_remote_frame=True, is_extended_id=False, dlc=1)
        self.send_message(message)
        return self.send_periodically(message, period_s)

    def send_periodically(self, message: can.Message, period_s: float) -> Any:
        """Send it every `period_s` seconds until `stop()` of the returned task; on SocketCAN the kernel does it, elsewhere a thread.

        Such a thread ends silently when the bus is lost; calls that use the bus then raise. Raises LinkLostError.
        """
        try:
            task: Any = self.bus.send_periodic(message, period_s)
        except _GONE as error:
            raise self._lost(f"frame {message.arbitration_id:03X}h cannot be sent periodically", error) from error
        if isinstance(task, can.broadcastmanager.ThreadBasedCyclicSendTask):
            task.on_error = lambda _error: False
        return task

    def listen(self) -> None:
        """Before the first SYNC of this link: listen whether another producer sends it (`Sync.unheard_s`). Raises LinkLostError."""
        if self.sync.unheard_s:
            self.wait(lambda: self.sync.taken, self.sync.unheard_s)

    def claim_sync(self, stream: object) -> None:
        """Make a stream of this link the owner of SYNC. A link that only samples yields to the SYNC sent here; another stream does
        not.

        Raises StateError when another stream sends SYNC, on this link or on another one; LinkLostError.
        """
        self.listen()
        self.poll()
        if not self.sync.streaming and self.sync.taken:
            self.send(SYNC, b"")
            self.wait(lambda: False, YIELD_S)
            self.sync.reset()
            if self.wait(lambda: self.sync.foreign_runs, CLAIM_S):
                raise StateError("another program streams on this bus: it sends SYNC and did not yield to ours")
        self.sync.take(stream)

    def poll(self) -> None:
        """Dispatch what has arrived, without waiting; on a flooded bus for `POLL_S` at most. Nothing while another thread dispatches.
        Raises LinkLostError."""
        try:
            with self._turn_now:
                if not self._received():
                    return  # as in nearly every cycle of a stream
                over, heard = self.clock.deadline(POLL_S), self.clock.deadline(IO_SLICE_S)
                while not over.expired:
                    if heard.expired:
                        self.clock.check_interrupt()
                        heard = self.clock.deadline(IO_SLICE_S)
                    if not self._received():
                        return
        except _BusyError:
            return

    def wait(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Dispatch frames until `done()`, or let another thread that waits; False when it did not come true within `timeout_s` seconds
        of listening (`Listening`). Raises LinkLostError.

        Every wait for a frame goes through here. The operator's stop ends it within `IO_SLICE_S`: see `Clock.check_interrupt`.
        """
        if done():
            return True
        listening = Listening(timeout_s, self.clock.now_ns)
        while True:
            try:
                with self._turn_soon:  # the thread before may have dispatched it
                    return done() or self._dispatch_until(done, listening)
            except _BusyError:
                if done():
                    return True
                if not listening.next_slice_s():
                    return False
                self.clock.check_interrupt()

    def _dispatch_until(self, done: Callable[[], bool], listening: Listening) -> bool:
        received = True
        while slice_s := listening.next_slice_s(in_vain=not received):
            received = self._receive(slice_s)
            if done():
                return True
            if not received or self._taken_ns - self._checked_ns >= _SLICE_NS:
                self._checked_ns = self.clock.now_ns()
                self.clock.check_interrupt()
        self.poll()  # frames that came in time may be in the receive buffer
        return done()

    def _received(self) -> bool:
        """Dispatch a frame that has arrived; False when nothing waits. Raises LinkLostError.

        To python-can an adapter's line that is no frame, such as an acknowledgement, is silence: more may wait behind it."""
        if self._receive(0.0):
            return True
        try:
            return self._selectable and bool(select.select([self.bus], [], [], 0.0)[0])
        except _GONE:  # a lost bus raises when it is received from
            return False

    def _receive(self, timeout_s: float) -> bool:
        """Take and dispatch one frame; False when none came in time. A piece that is no frame is left out. Raises
        LinkLostError."""
        try:
            message = self.bus.recv(timeout_s)
        except READ_ERRORS as error:
            self._leave_out(error)
            return True
        self._failed = 0
        if message is None:
            return False
        now_ns = self._taken_ns = self.clock.now_ns()
        if message.is_error_frame or message.is_remote_frame or message.is_extended_id or message.is_fd:
            return True
        # cut short, too long, or with an identifier of more bits
        if len(message.data) != message.dlc or message.dlc > 8 or message.arbitration_id > 0x7FF:
            return True
        cob_id, data = message.arbitration_id, bytes(message.data)
        for watcher in self._any:
            watcher(now_ns, cob_id, data)
        for handler in self._handlers.get(cob_id, ()):
            handler(now_ns, data)
        return True

    def _leave_out(self, error: Exception) -> None:
        """Count a failed read. Raises LinkLostError where it shows that the adapter is gone."""
        self._failed += 1
        self._taken_ns = self.clock.now_ns()
        if self._closed or is_gone(error):
            raise self._lost("is gone", error) from error
        if self._failed >= MOST_FAILED:
            raise self._lost(f"is gone: {self._failed} reads in a row failed", error) from error
        try:
            drop_undecoded(self.bus)
        except READ_ERRORS as second:
            raise self._lost("is gone", second) from second

    def _lost(self, what: str, error: Exception) -> LinkLostError:
        return LinkLostError(f"CAN {self.place}: {what}: {told_with_remedy(error, self._channel)}")
