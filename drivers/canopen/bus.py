"""One CAN bus as this project uses it: frames out, frames in, and a wait that is bounded.

What may go in: opening a python-can bus and dispatching its frames by identifier. There is no receiver thread: whoever waits
pumps the bus, so an exception in a handler surfaces in the call that was waiting (python-can's Notifier loses it with its
thread), several axes share one bus without locks between them, and a run in simulated time is repeatable.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Any, Self

import can

from drivers.clock import NS_PER_S, Clock
from drivers.errors import LinkLostError, StateError

FrameHandler = Callable[[int, bytes], None]
"""handler(time_ns, data): a frame of the subscribed identifier, with the clock's time when it was taken from the bus."""

# python-can's thread for periodic frames logs a bus that is gone, with its traceback; whoever waits here is told by an error
logging.getLogger("can").addHandler(logging.NullHandler())

_GONE = (can.CanError, OSError, ValueError)  # ValueError: python-can asks a socket that is closed for its number


class CanLink:
    """A python-can bus with its clock.

    bus: an open python-can bus of any interface; closed with the link.
    """

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        self.bus = bus
        self.clock = clock
        self.error_frames = 0
        self.frames_received = 0
        self._handlers: dict[int, tuple[FrameHandler, ...]] = {}
        self._any: tuple[Callable[[int, int, bytes], None], ...] = ()
        self._lock = threading.RLock()
        self._closed = False
        self._heartbeats: dict[int, tuple[float, Any]] = {}
        self._open_bus: Callable[[], can.BusABC] | None = None

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

        Raises LinkLostError when it cannot be had.
        """
        settings: dict[str, object] = dict(options or {})
        if bitrate is not None:
            settings["bitrate"] = bitrate

        def open_bus() -> can.BusABC:
            try:
                return can.Bus(channel=channel, interface=interface, **settings)  # type: ignore[arg-type]
            except _GONE as error:
                raise LinkLostError(f"CAN {interface} {channel} cannot be opened: {error}") from error

        link = cls(open_bus(), clock)
        link._open_bus = open_bus
        return link

    def reopen(self) -> None:
        """Open the bus anew after it was lost (an adapter pulled and put back, bus-off); subscriptions stay.

        Drives on it are to be closed before and opened after: nothing is known of what they did meanwhile. Raises StateError for a
        link that was given its bus, LinkLostError when it cannot be had; then it may be tried again.
        """
        if self._open_bus is None:
            raise StateError("this CAN link was given its bus and cannot open another")
        self.close()
        self.bus = self._open_bus()
        self._closed = False

    def close(self) -> None:
        """Close the bus; never raises for a bus that is already gone."""
        if self._closed:
            return
        self._closed = True
        self._heartbeats.clear()  # the bus stops its periodic frames itself
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
        with self._lock:
            self._handlers[cob_id] = (*self._handlers.get(cob_id, ()), handler)

    def unsubscribe(self, cob_id: int, handler: FrameHandler) -> None:
        """Undo one `subscribe`; nothing when it is not there."""
        with self._lock:
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
    def send(self, cob_id: int, data: bytes) -> None:
        """Send one frame with an 11-bit identifier. Raises LinkLostError when the bus does not take it."""
        self.send_message(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))

    def send_message(self, message: can.Message) -> None:
        """Send a message that the caller keeps for the next cycle; python-can's buses have done with it when they return."""
        try:
            self.bus.send(message)
        except _GONE as error:
            raise LinkLostError(f"CAN frame {message.arbitration_id:03X}h cannot be sent: {error}") from error

    def produce_heartbeat(self, node_id: int, period_s: float) -> None:
        """Send our own heartbeat (operational) from now until the link is closed; drives that consume it stop when we are gone.

        On SocketCAN the kernel's broadcast manager sends it, and stops when this process dies. Asked for twice, the shorter
        period holds.
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
            raise LinkLostError(f"heartbeat cannot be sent: {error}") from error
        self._heartbeats[node_id] = (period_s, self.send_periodically(message, period_s))

    def send_periodically(self, message: can.Message, period_s: float) -> Any:
        """Have the bus send it from now on, until `stop()` of what is returned; on SocketCAN the kernel does it, else a thread.

        Such a thread ends without a word when the bus is gone; whoever works with the bus is told. Raises LinkLostError.
        """
        try:
            task: Any = self.bus.send_periodic(message, period_s)
        except _GONE as error:
            raise LinkLostError(
                f"CAN frame {message.arbitration_id:03X}h cannot be sent periodically: {error}"
            ) from error
        if isinstance(task, can.broadcastmanager.ThreadBasedCyclicSendTask):
            task.on_error = lambda _error: False
        return task

    def poll(self) -> None:
        """Dispatch everything that has arrived, without waiting."""
        with self._lock:
            while self._receive(0.0):
                pass

    def wait(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Dispatch frames until `done()`; False when it did not come true within `timeout_s` seconds."""
        with self._lock:
            if done():
                return True
            left_s, now_ns = timeout_s, self.clock.now_ns
            start_ns = now_ns()
            while left_s > 0:
                # a bus that waited all the time that was left has spent it, even where the clock is not the bus's own
                if not self._receive(left_s):
                    return done()
                if done():
                    return True
                left_s = timeout_s - (now_ns() - start_ns) / NS_PER_S
            return False

    def _receive(self, timeout_s: float) -> bool:
        """Take and dispatch one frame; False when none came in time."""
        try:
            message = self.bus.recv(timeout_s)
        except _GONE as error:
            raise LinkLostError(f"CAN bus {self.bus.channel_info} is gone: {error}") from error
        if message is None:
            return False
        if message.is_error_frame or message.is_remote_frame or message.is_extended_id:
            self.error_frames += message.is_error_frame
            return True
        self.frames_received += 1
        now_ns, cob_id, data = self.clock.now_ns(), message.arbitration_id, bytes(message.data)
        for watcher in self._any:
            watcher(now_ns, cob_id, data)
        for handler in self._handlers.get(cob_id, ()):
            handler(now_ns, data)
        return True
