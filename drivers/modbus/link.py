"""A Modbus line that several drives may share: retries, back-off, silence and doubt, each decided in the open.

- Reads are repeated a stated number of times. A write is never sent twice. One that was not answered is in doubt: it is read back
  whole, and where that does not show the value its fate is told in the error. A register may be one that acts when it is written, and
  a request that was delayed may still arrive. The exception is an order that stops the axis or takes its power: twice does what once
  does, and an axis that goes on is worse.
- A unit that does not answer is asked again only after a back-off that doubles, so that one dead drive does not stall the others.
- On a serial line a frame is preceded by the silent interval, and after a time-out by a longer quiet in which a late reply dies out.
  RTU replies carry no number: where a reply still to come could be taken for that of the next request, a read of another length comes
  between. An exchange that the operator's stop breaks off is treated like one that timed out.
- A stop is posted: it passes by the lock, the back-off, the silence and the replies still to come.

Every call ends, whatever the units do: an exchange takes the time-out at most (see `PymodbusWire`), and a call no more exchanges than
its repeats, the repeats for a busy unit, and one before each that parts it from a late reply.
On a drive's way out it is fewer and shorter: as its `WayOut` leaves time for.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from enum import Enum

from drivers.clock import IO_SLICE_S, NS_PER_S, Clock
from drivers.errors import (
    AbortError,
    BridgeError,
    InputError,
    LinkLostError,
    NoAnswerError,
    ProtocolError,
    TransportError,
)
from drivers.modbus.plan import Span, Table, WireCost, silent_interval_s
from drivers.modbus.way_out import WayOut
from drivers.modbus.wire import ACKNOWLEDGE, BUSY, Endpoint, Function, PymodbusWire, Request, RtuEndpoint, Wire

_SILENCE_S = 0.01  # real time without a byte, after which a serial line is believed to be quiet


@dataclass(frozen=True)
class LinkPolicy:
    """How patient a link is. Times in s; `*_retries` are repeats after the first attempt.

    quiet_s: silence on a serial line after a time-out. turn_s: how long the others who share the line may keep it from us, in real
    time; by default as long as three writes that are read back, each attempt of which is waited out with 0.5 s.
    """

    read_retries: int = 2
    stop_retries: int = 2
    busy_retries: int = 5
    busy_pause_s: float = 0.02
    backoff_first_s: float = 0.25
    backoff_max_s: float = 8.0
    quiet_s: float = 0.05
    turn_s: float = 30.0


class Doubt(Enum):
    """What to do about a write that was not answered."""

    READ_BACK = "read back"  # compare
    STOP = (
        "stop"  # an order that stops the axis or takes its power: sent again until it is answered, the only one that is
    )
    RAISE = "raise"  # cannot be read back (a start bit that the drive takes back); the caller looks for other evidence


@dataclass(frozen=True)
class LinkStatistics:
    """Counts since the link was made."""

    requests: int = 0
    no_answers: int = 0
    repeats: int = 0
    resolved_writes: int = 0
    discarded_replies: int = 0
    connects: int = 0
    refused_in_backoff: int = 0


@dataclass
class _Unit:
    failures: int = 0
    not_before_ns: int = 0
    pending: Request | None = None  # timed out; its reply may still come
    answered: dict[tuple[object, ...], Request] = field(default_factory=dict)  # reads that were, by their echo
    way_out: WayOut | None = None  # what limits its requests on the way out

    def reply_s(self) -> float:
        return math.inf if self.way_out is None else self.way_out.reply_s()


class ModbusLink:
    """Use `open` and `close` in pairs: the wire is let go when the last user closes. Calls are serialised by one lock.

    clock: the wire's time; simulated time too, which then passes while the line has to be silent. Every wait hears its
    `check_interrupt`.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        clock: Clock,
        *,
        policy: LinkPolicy | None = None,
        make_wire: Callable[[Endpoint], Wire] | None = None,
    ) -> None:
        self.endpoint = endpoint
        self.clock = clock
        self.policy = policy or LinkPolicy()
        self.statistics = LinkStatistics()
        self._serial = isinstance(endpoint, RtuEndpoint)
        self._silence_ns = (
            round(silent_interval_s(endpoint.baud) * NS_PER_S) if isinstance(endpoint, RtuEndpoint) else 0
        )
        self._make_wire = make_wire or (lambda place: PymodbusWire(place, clock.check_interrupt))
        self._wire: Wire | None = None
        self._users = 0
        self._units: dict[int, _Unit] = {}
        self._line = _Unit()  # the connection itself has a back-off too
        self._free_ns = 0
        self._unclean = False  # something may still come in that nobody asked for
        self._lock = threading.RLock()

    @property
    def cost(self) -> WireCost:
        """What requests cost on this wire, for planning."""
        return self.endpoint.cost

    # -- connection ------------------------------------------------------------------------------------------------
    def open(self) -> None:
        """Connect, or join those who are. Raises LinkLostError."""
        with self._turn(self.policy.turn_s):
            if self._wire is None:
                self._wire = self._make_wire(self.endpoint)
            try:
                self._connect(self._wire, urgent=True, within_s=math.inf)
            except TransportError:
                if not self._users:
                    self._wire = None
                raise
            self._users += 1

    def close(self) -> None:
        """Leave; the last one out disconnects. Never raises."""
        with self._lock:
            self._users = max(0, self._users - 1)
            if self._users == 0 and self._wire is not None:
                self._wire.disconnect()
                self._wire = None

    def heed(self, unit: int, way_out: WayOut) -> None:
        """Requests to this unit keep to the time that is left for its way out."""
        self._unit(unit).way_out = way_out

    def _connect(self, wire: Wire, *, urgent: bool, within_s: float) -> None:
        if wire.connected:
            return
        self._respect_backoff(self._line, f"Modbus {self.endpoint}", LinkLostError, urgent=urgent)
        try:
            wire.connect(within_s)
        except LinkLostError:
            self._missed(self._line)
            raise
        self._heard(self._line)
        self._count(connects=1)
        for unit in self._units.values():
            unit.pending = None  # a new connection carries no old replies

    def _turn_of(self, unit: int) -> AbstractContextManager[None]:
        return self._turn(min(self.policy.turn_s, self._unit(unit).reply_s()))

    @contextmanager
    def _turn(self, within_s: float) -> Iterator[None]:
        """The line is ours inside; waiting for it hears the operator."""
        end_s = time.monotonic() + within_s
        while not self._lock.acquire(timeout=IO_SLICE_S):
            self.clock.check_interrupt()
            if time.monotonic() > end_s:
                raise NoAnswerError(
                    f"Modbus {self.endpoint} was in use by others for {within_s:.3g} s, nothing was sent"
                )
        try:
            yield
        finally:
            self._lock.release()

    # -- stopping ----------------------------------------------------------------------------------------------------
    def post(self, unit: int, requests: Sequence[Request]) -> None:
        """Put requests on the wire at once without waiting for replies or for anyone: stops, and nothing that must not come twice.

        From any thread and from a signal handler. What no longer has a connection is not sent, on a serial line.
        """
        wire = self._wire
        if wire is not None:
            self._unclean = self._serial  # their replies will come in
            wire.post(unit, requests)

    # -- reading and writing -----------------------------------------------------------------------------------------
    def read(
        self, unit: int, table: Table, span: Span, *, urgent: bool = False, repeats: int | None = None
    ) -> tuple[int, ...]:
        """Registers (or bits as 0 and 1), shape (span.count,).

        urgent: ask even a unit in back-off; repeats: instead of the policy's. Raises NoAnswerError, LinkLostError, AbortError,
        ProtocolError.
        """
        request = Request.read(table, span)
        with self._turn_of(unit):
            return self._read(unit, request, urgent=urgent, repeats=repeats)

    def write(
        self,
        unit: int,
        table: Table,
        start: int,
        values: tuple[int, ...],
        *,
        doubt: Doubt = Doubt.READ_BACK,
        single: bool = True,
        urgent: bool = False,
    ) -> None:
        """Write neighbouring registers or bits in one request; returns when it is certain that it was carried out.

        single: one value may go with function 5 or 6. Raises as `read`; a NoAnswerError says whether the write is in doubt.
        """
        request = Request.write(table, start, values, single=single)
        with self._turn_of(unit):
            state = self._unit(unit)
            # nothing is in doubt while nothing was sent
            self._respect_backoff(state, f"Modbus {self.endpoint} unit {unit}", NoAnswerError, urgent=urgent)
            self._connect(self._opened(), urgent=urgent, within_s=state.reply_s())
            if doubt is Doubt.READ_BACK:
                self._write_resolved(unit, request, table)
                return
            repeats = self.policy.stop_retries if doubt is Doubt.STOP else 0
            try:
                self._attempts(unit, request, repeats, urgent=True, blamed=doubt is Doubt.STOP)
            except (TransportError, ProtocolError, AbortError) as error:
                if isinstance(error, AbortError) and error.code != ACKNOWLEDGE:
                    raise
                if isinstance(error, AbortError) and doubt is Doubt.STOP:
                    return  # it was taken, and whoever stops looks at what the axis does
                raise NoAnswerError(f"{error}; whether it was carried out is unknown") from error

    def _read(self, unit: int, request: Request, *, urgent: bool, repeats: int | None = None) -> tuple[int, ...]:
        if repeats is None:
            return self._attempts(unit, request, self.policy.read_retries, urgent=urgent)
        return self._attempts(unit, request, repeats, urgent=urgent, blamed=repeats > 0)

    def _write_resolved(self, unit: int, request: Request, table: Table) -> None:
        """Sent once. Busy (exception 6) is a refusal: nothing was carried out, and the standard has the client ask again."""
        try:
            self._attempts(unit, request, 0, urgent=True, blamed=False)
            return
        except AbortError as error:
            if error.code != ACKNOWLEDGE:
                raise
            self._await_carried_out(unit, request, table, error)
            return
        except (TransportError, ProtocolError) as error:
            lost = error
        seen = self._read_back(unit, request, table, lost)
        if seen != request.values:
            raise NoAnswerError(
                f"{lost}; not carried out, and not sent again: reads {_listed(seen)}, expected {_listed(request.values)}"
            ) from lost
        self._count(resolved_writes=1)

    def _read_back(self, unit: int, request: Request, table: Table, error: BridgeError) -> tuple[int, ...]:
        try:
            return self._read(unit, Request.read(table, Span(request.address, request.count)), urgent=True)
        except BridgeError as second:
            raise NoAnswerError(f"{error}; in doubt, as reading it back failed: {second}") from second

    def _await_carried_out(self, unit: int, request: Request, table: Table, error: AbortError) -> None:
        """A write that the unit has taken and still works on is not sent again, only looked for."""
        for _ in range(self._repeats(unit, self.policy.busy_retries) + 1):
            self.clock.sleep_s(self.policy.busy_pause_s)
            seen = self._read_back(unit, request, table, error)
            if seen == request.values:
                self._count(resolved_writes=1)
                return
        raise NoAnswerError(f"{error}; still reads {_listed(seen)}, expected {_listed(request.values)}")

    def _attempts(
        self, unit: int, request: Request, repeats: int, *, urgent: bool, blamed: bool = True
    ) -> tuple[int, ...]:
        """blamed: failing starts the unit's back-off. A single lost write or look does not: it is asked about next."""
        state = self._unit(unit)
        self._respect_backoff(state, f"Modbus {self.endpoint} unit {unit}", NoAnswerError, urgent=urgent)
        tried = busy = 0
        while True:
            try:
                values = self._exchange(unit, state, request, urgent=urgent)
            except AbortError as error:
                self._heard(state)
                asked_again = error.code == BUSY or (error.code == ACKNOWLEDGE and not request.function.is_write)
                if not asked_again or busy >= self._repeats(unit, self.policy.busy_retries):
                    raise
                busy += 1
                self.clock.sleep_s(self.policy.busy_pause_s)
            except (TransportError, ProtocolError) as error:
                if tried >= self._repeats(unit, repeats):
                    if blamed and isinstance(error, NoAnswerError):
                        self._missed(state)
                    raise
                tried += 1
                self._count(repeats=1)
            else:
                self._heard(state)
                return values

    def _repeats(self, unit: int, own: int) -> int:
        state = self._unit(unit)
        silent = bool(state.failures or self._line.failures)
        return own if state.way_out is None else state.way_out.repeats(own, silent=silent)

    # -- one exchange --------------------------------------------------------------------------------------------------
    def _exchange(self, unit: int, state: _Unit, request: Request, *, urgent: bool) -> tuple[int, ...]:
        wire, began_s = self._opened(), time.monotonic()
        try:
            self._connect(wire, urgent=urgent, within_s=state.reply_s())
        except LinkLostError:
            self._waited(state, began_s)
            raise
        if state.pending is not None and state.pending.echo == request.echo:
            self._resynchronise(wire, unit, state, request)
        return self._send(wire, unit, state, request)

    def _send(self, wire: Wire, unit: int, state: _Unit, request: Request) -> tuple[int, ...]:
        self.clock.sleep_until_ns(self._free_ns)
        if self._unclean:
            self._unclean = False  # before: a stop may be posted meanwhile
            wire.discard(_SILENCE_S)
        self.clock.check_interrupt()  # nothing is in doubt yet
        self._count(requests=1)
        began_s = time.monotonic()
        try:
            values = wire.exchange(unit, request, state.reply_s())
        except NoAnswerError:
            self._waited(state, began_s)
            self._count(no_answers=1)
            self._expect_late_reply(state, request)
            raise
        except ProtocolError:
            self._count(discarded_replies=1)
            self._expect_late_reply(state, request)
            raise
        except AbortError:
            self._end_of_exchange(state)
            raise
        except LinkLostError:
            self._waited(state, began_s)
            raise
        except BaseException:  # the operator's stop
            self._expect_late_reply(state, request)
            raise
        self._end_of_exchange(state)
        if not request.function.is_write:
            state.answered[request.echo] = request
        return values

    @staticmethod
    def _waited(state: _Unit, began_s: float) -> None:
        if state.way_out is not None:
            state.way_out.unanswered(time.monotonic() - began_s)

    def _end_of_exchange(self, state: _Unit) -> None:
        state.pending = None  # a unit answers in the order in which it was asked
        self._free_ns = self.clock.now_ns() + self._silence_ns

    def _expect_late_reply(self, state: _Unit, request: Request) -> None:
        """TCP numbers its replies; a late one is recognised there without our help."""
        if self._serial:
            state.pending = request
            self._unclean = True
            self._free_ns = self.clock.now_ns() + max(self._silence_ns, round(self.policy.quiet_s * NS_PER_S))

    def _resynchronise(self, wire: Wire, unit: int, state: _Unit, request: Request) -> None:
        """Exchange something whose reply cannot be mistaken for the one that is late; any answer to it shows that the line is ours."""
        known = (each for echo, each in state.answered.items() if echo != request.echo)
        probe = next(known, None) or _other_length(request)  # a refusal would not show whose it is
        try:
            self._send(wire, unit, state, probe)
        except AbortError:
            return  # refused, but that was the refusal of this request
        except ProtocolError:
            return  # the late reply itself; the probe's own is still to come, but is of another length than the request's

    # -- back-off ------------------------------------------------------------------------------------------------------
    def _respect_backoff(self, state: _Unit, who: str, kind: type[TransportError], *, urgent: bool) -> None:
        left_ns = state.not_before_ns - self.clock.now_ns()
        if state.failures and left_ns > 0 and not urgent:
            self._count(refused_in_backoff=1)
            raise kind(f"{who} failed {state.failures} times, not tried again for another {left_ns / NS_PER_S:.2f} s")

    def _missed(self, state: _Unit) -> None:
        delay_s = min(self.policy.backoff_max_s, self.policy.backoff_first_s * 2.0 ** min(state.failures, 30))
        state.failures += 1
        state.not_before_ns = self.clock.now_ns() + round(delay_s * NS_PER_S)

    @staticmethod
    def _heard(state: _Unit) -> None:
        state.failures = 0

    # -- small things --------------------------------------------------------------------------------------------------
    def _opened(self) -> Wire:
        if self._wire is None:
            raise LinkLostError(f"Modbus {self.endpoint} is not open")
        return self._wire

    def _unit(self, unit: int) -> _Unit:
        highest, lowest = (247, 1) if self._serial else (255, 0)
        if not lowest <= unit <= highest:
            raise InputError(f"unit id is {unit}, expected {lowest} to {highest}")
        return self._units.setdefault(unit, _Unit())

    def _count(self, **more: int) -> None:
        now = self.statistics
        self.statistics = replace(now, **{name: getattr(now, name) + count for name, count in more.items()})


def _other_length(request: Request) -> Request:
    """A read near the request's own place whose reply has another function or length."""
    if request.function.is_write:
        function = Function.READ_COILS if request.function.is_bits else Function.READ_HOLDING
        return Request(function, request.address, 1)
    if request.function.is_bits:
        count = request.count - 8 if request.count > 8 else request.count + 8
    else:
        count = request.count - 1 if request.count > 1 else 2
    address = min(request.address, 0x10000 - count)
    return Request(request.function, address, count)


def _listed(values: tuple[int, ...]) -> str:
    return ", ".join(str(value) for value in values)
