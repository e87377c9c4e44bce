"""A simulated drive served on a python-can interface by a thread of its own."""

from __future__ import annotations

import select
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

import can
from can.interfaces.virtual import VirtualBus

from drivers.clock import NS_PER_S, Clock, WallClock
from sim_backends.canopen_drive import SUPERVISION_NS, CanOpenSlave
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_station import Station
from sim_backends.clock import SimClock
from sim_backends.own_table import TableForm
from sim_backends.servo import SimulatedServo


@contextmanager
def served(
    servo: SimulatedServo,
    clock: Clock,
    *,
    channel: str | int,
    interface: str = "virtual",
    node_id: int = 1,
    bitrate: int | None = None,
    parameters: Mapping[tuple[int, int], int] | None = None,
    faults: Iterable[CanFault] = (),
    options: Mapping[str, object] | None = None,
    step_s: float = 0.001,
    table: TableForm | None = None,
) -> Iterator[CanOpenSlave]:
    """Serve a drive on any python-can interface in a thread of its own, until the block ends. Raises what the thread raised.

    options: the interface's own settings, such as host and port of a socketcand.

    With a SimClock the thread answers at once in real time, and simulated time moves when its owner sleeps: frames sent before
    are handled before time moves on. With a WallClock the thread also advances the servo, every `step_s` seconds.
    """
    settings: dict[str, object] = {**(options or {})} if bitrate is None else {**(options or {}), "bitrate": bitrate}
    bus = can.Bus(channel=channel, interface=interface, **settings)  # type: ignore[arg-type]
    try:
        service = _Service(bus, clock, servo, node_id, parameters=parameters, faults=faults, step_s=step_s, table=table)
        try:
            yield service.slave
        finally:
            service.stop()
    finally:
        bus.shutdown()


class _Service:
    """The thread of `served`, and the lock that makes receive-and-handle one step."""

    def __init__(
        self,
        bus: can.BusABC,
        clock: Clock,
        servo: SimulatedServo,
        node_id: int,
        *,
        parameters: Mapping[tuple[int, int], int] | None,
        faults: Iterable[CanFault],
        step_s: float,
        table: TableForm | None,
    ) -> None:
        self._station = Station(bus, clock, servo, node_id, parameters=parameters, faults=faults, table=table)
        self.slave = self._station.slave
        self._bus = bus
        self._clock = clock
        self._servo = servo
        self._step_ns = round(step_s * NS_PER_S)
        self._advanced_ns = clock.now_ns()
        self._lock = threading.RLock()
        self._stopping = threading.Event()
        self._error: BaseException | None = None
        if isinstance(clock, SimClock):
            clock.attach(self._on_simulated_time, bearable=self._bearable)
        self._thread = threading.Thread(target=self._run, name=f"canopen drive {node_id}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; raises the error that ended it."""
        self._stopping.set()
        if isinstance(self._bus, VirtualBus):
            with self._bus.queue.not_empty:
                self._bus.queue.not_empty.notify_all()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _handle(self, timeout_s: float) -> bool:
        message = self._bus.recv(timeout_s)
        if message is None:
            return False
        self._station.deliver(message)
        return True

    def _run(self) -> None:
        try:
            if isinstance(self._clock, WallClock):
                self._run_in_real_time()
            else:
                self._run_on_request()
        except BaseException as error:
            self._error = error
            raise

    def _run_on_request(self) -> None:
        while not self._stopping.is_set():
            if self._readable(0.05):
                with self._lock:
                    self._handle(0.0)

    def _readable(self, timeout_s: float) -> bool:
        """Wait until a frame can be taken, and leave it there: taking and handling must be one step under the lock."""
        if isinstance(self._bus, VirtualBus):
            frames = self._bus.queue
            with frames.not_empty:
                return frames.not_empty.wait_for(lambda: bool(frames.queue) or self._stopping.is_set(), timeout_s)
        return bool(select.select([self._bus.fileno()], [], [], timeout_s)[0])

    def _run_in_real_time(self) -> None:
        while not self._stopping.is_set():
            left_ns = self._advanced_ns + self._step_ns - self._clock.now_ns()
            # on a slow host advancing the servo may take longer than a step: one frame is answered in each all the same
            if self._handle(max(0, left_ns) / NS_PER_S) and left_ns > 0:
                continue
            now_ns = self._clock.now_ns()
            self._servo.advance(now_ns, (now_ns - self._advanced_ns) / NS_PER_S)
            self._advanced_ns = now_ns
            self._station.layer.tick(now_ns)

    def _bearable(self, now_ns: int) -> int:
        return SUPERVISION_NS if self._stopping.is_set() else self._station.bearable(now_ns)

    def _on_simulated_time(self, now_ns: int, _dt_s: float) -> None:
        if self._stopping.is_set():
            return
        with self._lock:
            while self._handle(0.0):
                pass
            self._station.layer.tick(now_ns)
