"""ModbusLink: one Modbus line that several drives may share, with retries, back-off, silence and lost answers handled in one place.

- Reads are repeated a stated number of times. A write is never sent twice. One that was not answered is in doubt: all of it is read
  back, and where that does not show the value, the error says so. A register may act when it is written, and
  a request that was delayed may still arrive. The exception is an order that stops the axis or takes its power: sent twice it has the
  same effect, and an axis that moves on is worse.
- A unit that does not answer is asked again only after a back-off that doubles, so that one dead drive does not stall the others.
- On a serial line a frame is preceded by the silent interval, and after a time-out by a longer silence in which a late reply ends.
  RTU replies carry no number: where a late reply could be taken for that of the next request, a read of another length is sent
  in between. An exchange that the operator's stop interrupts is treated like one that timed out.
- A stop is posted: it does not wait for the lock, the back-off, the silence or late replies.

Every call ends, whatever the units do: an exchange takes at most the time-out (see `PymodbusWire`), and a call at most the
exchanges of its repeats, of the time for a busy unit, and one before each of them that separates it from a late reply.
While a drive is shut down they are fewer and shorter, within the time of its `WayOut`.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from enum import Enum

from drivers.clock import IO_SLICE_S, NS_PER_S, Clock
from drivers.errors import (
    AbortError,
    BridgeError,
    InputError,
    LinkLostError,
    NoAnswerError,
    OtherAnswerError,
    ProtocolError,
    TransportError,
)
from drivers.modbus.endpoint import Endpoint, RtuEndpoint
from drivers.modbus.plan import AddressSpace, Span, WireCost, silent_interval_s
from drivers.modbus.wire import ACKNOWLEDGE, BUSY, NO_PATH, NO_TARGET, Function, PymodbusWire, Request, Wire
from drivers.way_out import WayOut

_SILENCE_S = 0.01  # real time without a byte after which a serial line counts as quiet, s


@dataclass(frozen=True)
class LinkPolicy:
    """Time-outs and repeats of a link. Times in s; `*_retries` are repeats after the first attempt.

    busy_s: longest time that a busy unit, or one that a gateway does not reach, is asked again: as long as a change of state may
    take by most register maps, and about as long as a silent unit is waited for on TCP. While a unit is shut down it is the time
    that is left for that.
    quiet_s: silence on a serial line after a time-out. turn_s: longest wait for the line while other users have it, in real
    time; by default the time of three writes that are read back, with 0.5 s for each attempt.
    """

    read_retries: int = 2
    stop_retries: int = 2
    busy_s: float = 3.0
    busy_pause_s: float = 0.02
    backoff_first_s: float = 0.25
    backoff_max_s: float = 8.0
    quiet_s: float = 0.05
    turn_s: float = 30.0


class Doubt(Enum):
    """Treatment of a write that was not answered."""

    READ_BACK = "read back"  # compare with the value read back
    STOP = (
        "stop"  # an order that stops the axis or takes its power: the only one that is sent again until it is answered
    )
    RAISE = (
        "raise"  # cannot be read back (a start bit that the drive clears itself); the caller checks the axis instead
    )


@dataclass
class _Unit:
    failures: int = 0
    not_before_ns: int = 0
    pending: Request | None = None  # timed out; its reply may still come
    answered: dict[tuple[object, ...], Request] = field(default_factory=dict)  # answered reads, by their echo
    way_out: WayOut | None = None  # limits its requests while it is shut down


class ModbusLink:
    """Use `open` and `close` in pairs: the wire is closed when the last user closes. One lock serialises the calls.

    clock: the time of the wire; simulated time passes while the line has to be silent. Every wait calls its
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
        self._serial = isinstance(endpoint, RtuEndpoint)
        self._silence_ns = (
            round(silent_interval_s(endpoint.baud) * NS_PER_S) if isinstance(endpoint, RtuEndpoint) else 0
        )
        self._make_wire = make_wire or (lambda place: PymodbusWire(place, clock.check_interrupt))
        self._wire: Wire | None = None
        self._users = 0
        self._units: dict[int, _Unit] = {}
        self._line = _Unit()  # back-off of the connection itself
        self._free_ns = 0
        self._unclean = False  # unrequested bytes may still come in
        self._lock = threading.RLock()

    @property
    def cost(self) -> WireCost:
        """The cost of requests on this wire, for planning."""
        return self.endpoint.cost

    # -- connection ------------------------------------------------------------------------------------------------
    def open(self) -> None:
        """Connect, or join the present users. Raises LinkLostError."""
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
        """Leave; the last user disconnects. Never raises."""
        with self._lock:
            self._users = max(0, self._users - 1)
            if self._users == 0 and self._wire is not None:
                self._wire.disconnect()
                self._wire = None

    def limit_by(self, unit: int, way_out: WayOut) -> None:
        """Limit requests to this unit to the time that is left for shutting it down."""
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
        for unit in self._units.values():
            unit.pending = None  # a new connection carries no old replies

    def _turn_of(self, unit: int) -> AbstractContextManager[None]:
        return self._turn(min(self.policy.turn_s, self._reply_s(self._unit(unit))))

    @contextmanager
    def _turn(self, within_s: float) -> Iterator[None]:
        """Hold the line inside; the wait for it can be interrupted. Raises NoAnswerError after `within_s`."""
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
        """Send requests at once without waiting for replies or for the lock: stops, and nothing that must not come twice.

        From any thread and from a signal handler. On a serial line without a connection nothing is sent.
        """
        wire = self._wire
        if wire is not None:
            self._unclean = self._serial  # their replies will come in
            wire.post(unit, requests)

    # -- reading and writing -----------------------------------------------------------------------------------------
    def read(
        self,
        unit: int,
        table: AddressSpace,
        span: Span,
        *,
        urgent: bool = False,
        repeats: int | None = None,
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
        table: AddressSpace,
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
            # nothing was sent, so nothing is in doubt
            self._respect_backoff(state, f"Modbus {self.endpoint} unit {unit}", NoAnswerError, urgent=urgent)
            self._connect(self._opened(), urgent=urgent, within_s=self._reply_s(state))
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
                    return  # it was accepted; the caller then checks the axis
                raise NoAnswerError(f"{error}; whether it was carried out is unknown") from error

    def _read(self, unit: int, request: Request, *, urgent: bool, repeats: int | None = None) -> tuple[int, ...]:
        own = self.policy.read_retries if repeats is None else repeats
        return self._attempts(unit, request, own, urgent=urgent, blamed=repeats != 0)

    def _write_resolved(self, unit: int, request: Request, table: AddressSpace) -> None:
        """Send it once. Busy (exception 6) is a refusal: nothing was carried out, and the standard has the client ask again."""
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

    def _read_back(self, unit: int, request: Request, table: AddressSpace, error: BridgeError) -> tuple[int, ...]:
        try:
            return self._read(unit, Request.read(table, Span(request.address, request.count)), urgent=True)
        except BridgeError as second:
            raise NoAnswerError(f"{error}; in doubt, as reading it back failed: {second}") from second

    def _await_carried_out(self, unit: int, request: Request, table: AddressSpace, error: AbortError) -> None:
        """Wait for a write that the unit has accepted and is still processing; it is not sent again."""
        deadline = self.clock.deadline(self._busy_s(unit))
        while True:
            self.clock.sleep_s(self.policy.busy_pause_s)
            seen = self._read_back(unit, request, table, error)
            if seen == request.values:
                return
            if deadline.expired:
                break
        raise NoAnswerError(f"{error}; still reads {_listed(seen)}, expected {_listed(request.values)}")

    def _attempts(
        self, unit: int, request: Request, repeats: int, *, urgent: bool, blamed: bool = True
    ) -> tuple[int, ...]:
        """blamed: failing starts the unit's back-off. A single lost write or read does not: it is followed by another request."""
        state, who = self._unit(unit), f"Modbus {self.endpoint} unit {unit}"
        self._respect_backoff(state, who, NoAnswerError, urgent=urgent)
        if not urgent and state.way_out is not None and state.way_out.gives_up(silent=self._silent(state)):
            raise NoAnswerError(f"{who} was not tried: it has ceased to answer")
        tried, busy_s = 0, self._busy_s(unit)
        busy = self.clock.deadline(busy_s)
        while True:
            try:
                values = self._exchange(unit, state, request, urgent=urgent)
            except AbortError as error:
                by_gateway = error.code in (NO_PATH, NO_TARGET)
                if not by_gateway:
                    self._heard(state)
                again = _is_asked_again(error.code, request, repeats)
                if again and not busy.expired:
                    self.clock.sleep_s(self.policy.busy_pause_s)
                    continue
                text = f"{error}, asked again for {busy_s:.3g} s" if again and busy_s else f"{error}"
                if not by_gateway:
                    raise AbortError(text, error.code) from error
                if blamed:
                    self._missed(state)
                raise NoAnswerError(text) from error
            except (TransportError, ProtocolError) as error:
                if tried >= self._repeats(unit, repeats):
                    if blamed and isinstance(error, NoAnswerError) and not isinstance(error, OtherAnswerError):
                        self._missed(state)
                    raise
                tried += 1
            else:
                self._heard(state)
                return values

    def _busy_s(self, unit: int) -> float:
        """Longest time that a busy unit is asked again, s."""
        way_out = self._unit(unit).way_out
        return self.policy.busy_s if way_out is None else way_out.busy_s(self.policy.busy_s)

    def _repeats(self, unit: int, own: int) -> int:
        state = self._unit(unit)
        return own if state.way_out is None else state.way_out.repeats(own, silent=self._silent(state))

    def _reply_s(self, state: _Unit) -> float:
        return math.inf if state.way_out is None else state.way_out.reply_s(silent=self._silent(state))

    def _silent(self, state: _Unit) -> bool:
        return bool(state.failures or self._line.failures)

    # -- one exchange --------------------------------------------------------------------------------------------------
    def _exchange(self, unit: int, state: _Unit, request: Request, *, urgent: bool) -> tuple[int, ...]:
        wire, began_s = self._opened(), time.monotonic()
        try:
            self._connect(wire, urgent=urgent, within_s=self._reply_s(state))
        except LinkLostError:
            self._waited(state, began_s)
            raise
        if state.pending is not None and state.pending.echo == request.echo:
            self._resynchronise(wire, unit, state, request)
        return self._send(wire, unit, state, request)

    def _send(self, wire: Wire, unit: int, state: _Unit, request: Request) -> tuple[int, ...]:
        self.clock.sleep_until_ns(self._free_ns)
        if self._unclean:
            self._unclean = False  # before sending: a stop may be posted meanwhile
            wire.discard(_SILENCE_S)
        self.clock.check_interrupt()  # before anything is in doubt
        began_s = time.monotonic()
        try:
            values = wire.exchange(unit, request, self._reply_s(state))
        except NoAnswerError:
            self._waited(state, began_s)
            self._expect_late_reply(state, request)
            raise
        except ProtocolError:
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
        state.pending = None  # a unit answers in the order of the requests
        self._free_ns = self.clock.now_ns() + self._silence_ns

    def _expect_late_reply(self, state: _Unit, request: Request) -> None:
        """Keep a request whose reply may come late. TCP numbers its replies, so that late ones are recognised there."""
        if self._serial:
            state.pending = request
            self._unclean = True
            self._free_ns = self.clock.now_ns() + max(self._silence_ns, round(self.policy.quiet_s * NS_PER_S))

    def _resynchronise(self, wire: Wire, unit: int, state: _Unit, request: Request) -> None:
        """Exchange a request whose reply differs from the late one; any answer to it shows that the line is in step again."""
        known = (each for echo, each in state.answered.items() if echo != request.echo)
        probe = next(known, None) or _other_length(request)  # a refusal would not show to which request it belongs
        try:
            self._send(wire, unit, state, probe)
        except AbortError:
            return  # refused, but that was the refusal of this request
        except ProtocolError:
            return  # the late reply itself; the probe's own is still to come, but has another length than the request's

    # -- back-off ------------------------------------------------------------------------------------------------------
    def _respect_backoff(self, state: _Unit, who: str, kind: type[TransportError], *, urgent: bool) -> None:
        left_ns = state.not_before_ns - self.clock.now_ns()
        if state.failures and left_ns > 0 and not urgent:
            raise kind(f"{who} failed {state.failures} times, not tried again for another {left_ns / NS_PER_S:.2f} s")

    def _missed(self, state: _Unit) -> None:
        delay_s = min(self.policy.backoff_max_s, self.policy.backoff_first_s * 2.0 ** min(state.failures, 30))
        state.failures += 1
        state.not_before_ns = self.clock.now_ns() + round(delay_s * NS_PER_S)

    @staticmethod
    def _heard(state: _Unit) -> None:
        state.failures = 0

    # -- helpers -------------------------------------------------------------------------------------------------------
    def _opened(self) -> Wire:
        if self._wire is None:
            raise LinkLostError(f"Modbus {self.endpoint} is not open")
        return self._wire

    def _unit(self, unit: int) -> _Unit:
        highest, lowest = (247, 1) if self._serial else (255, 0)
        if not lowest <= unit <= highest:
            raise InputError(f"unit id is {unit}, expected {lowest} to {highest}")
        return self._units.setdefault(unit, _Unit())


def _is_asked_again(code: int, request: Request, repeats: int) -> bool:
    """Whether an exception is answered by the same request: one that was not carried out, or may be carried out twice."""
    if code in (BUSY, NO_PATH):
        return True
    twice = not request.function.is_write or (code == NO_TARGET and repeats > 0)
    return twice and code in (ACKNOWLEDGE, NO_TARGET)


def _other_length(request: Request) -> Request:
    """A read near the request's own address whose reply has another function or length."""
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
