"""A Modbus line that several drives may share: retries, back-off, silence and doubt, each decided in the open.

- Reads are repeated a stated number of times. A write that was not answered is in doubt: it is read back, and repeated only when that
  proves that it did not happen.
- A unit that does not answer is asked again only after a back-off that doubles, so that one dead drive does not stall the others.
- On a serial line a frame is preceded by the silent interval, and after a time-out by a longer quiet in which a late reply dies out.
  RTU replies carry no number: where a reply still to come could be taken for that of the next request, a read of another length comes
  between.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum

from drivers.clock import NS_PER_S, Clock
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
from drivers.modbus.wire import BUSY, Endpoint, Function, PymodbusWire, Request, RtuEndpoint, Wire

_SILENCE_S = 0.01  # real time without a byte, after which a serial line is believed to be quiet


@dataclass(frozen=True)
class LinkPolicy:
    """How patient a link is. Times in s; `*_retries` are repeats after the first attempt.

    quiet_s: silence on a serial line after a time-out.
    """

    read_retries: int = 2
    write_retries: int = 1
    urgent_retries: int = 2
    busy_retries: int = 5
    busy_pause_s: float = 0.02
    backoff_first_s: float = 0.25
    backoff_max_s: float = 8.0
    quiet_s: float = 0.05


class Doubt(Enum):
    """What to do about a write that was not answered."""

    READ_BACK = "read back"  # compare, and repeat only what did not happen
    REPEAT = "repeat"  # harmless to do twice, and urgent
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


class ModbusLink:
    """Use `open` and `close` in pairs: the wire is let go when the last user closes. Calls are serialised by one lock.

    clock: the wire's time; simulated time too, which then passes while the line has to be silent.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        clock: Clock,
        *,
        policy: LinkPolicy | None = None,
        make_wire: Callable[[Endpoint], Wire] = PymodbusWire,
    ) -> None:
        self.endpoint = endpoint
        self.clock = clock
        self.policy = policy or LinkPolicy()
        self.statistics = LinkStatistics()
        self._serial = isinstance(endpoint, RtuEndpoint)
        self._silence_ns = (
            round(silent_interval_s(endpoint.baud) * NS_PER_S) if isinstance(endpoint, RtuEndpoint) else 0
        )
        self._make_wire = make_wire
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
        with self._lock:
            if self._wire is None:
                self._wire = self._make_wire(self.endpoint)
            try:
                self._connect(self._wire, urgent=True)
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

    def _connect(self, wire: Wire, *, urgent: bool) -> None:
        if wire.connected:
            return
        self._respect_backoff(self._line, f"Modbus {self.endpoint}", LinkLostError, urgent=urgent)
        try:
            wire.connect()
        except LinkLostError:
            self._missed(self._line)
            raise
        self._heard(self._line)
        self._count(connects=1)
        for unit in self._units.values():
            unit.pending = None  # a new connection carries no old replies

    # -- reading and writing -----------------------------------------------------------------------------------------
    def read(self, unit: int, table: Table, span: Span, *, urgent: bool = False) -> tuple[int, ...]:
        """Registers (or bits as 0 and 1), shape (span.count,).

        urgent: ask even a unit in back-off. Raises NoAnswerError, LinkLostError, AbortError, ProtocolError.
        """
        request = Request.read(table, span)
        with self._lock:
            return self._read(unit, request, urgent=urgent)

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
        with self._lock:
            # nothing is in doubt while nothing was sent
            self._respect_backoff(self._unit(unit), f"Modbus {self.endpoint} unit {unit}", NoAnswerError, urgent=urgent)
            self._connect(self._opened(), urgent=urgent)
            if doubt is Doubt.READ_BACK:
                self._write_resolved(unit, request, table)
                return
            repeats = self.policy.urgent_retries if doubt is Doubt.REPEAT else 0
            try:
                self._attempts(unit, request, repeats, urgent=True, blamed=doubt is Doubt.REPEAT)
            except (TransportError, ProtocolError) as error:
                raise NoAnswerError(f"{error}; whether it was carried out is unknown") from error

    def _read(self, unit: int, request: Request, *, urgent: bool) -> tuple[int, ...]:
        return self._attempts(unit, request, self.policy.read_retries, urgent=urgent)

    def _write_resolved(self, unit: int, request: Request, table: Table) -> None:
        seen: tuple[int, ...] = ()
        for attempt in range(self.policy.write_retries + 1):
            if attempt > 0:
                self._count(repeats=1)
            try:
                self._attempts(unit, request, 0, urgent=True, blamed=False)
                return
            except (TransportError, ProtocolError) as error:
                try:
                    seen = self._read(unit, Request.read(table, Span(request.address, request.count)), urgent=True)
                except BridgeError as second:
                    raise NoAnswerError(f"{error}; in doubt, as reading it back failed: {second}") from second
            if seen == request.values:
                self._count(resolved_writes=1)
                return
        raise NoAnswerError(
            f"Modbus {self.endpoint} unit {unit}, {request}: not answered {self.policy.write_retries + 1} times,"
            f" not carried out: reads {_listed(seen)}, expected {_listed(request.values)}"
        )

    def _attempts(
        self, unit: int, request: Request, repeats: int, *, urgent: bool, blamed: bool = True
    ) -> tuple[int, ...]:
        """blamed: failing starts the unit's back-off. A single lost write does not: what became of it is asked next."""
        state = self._unit(unit)
        self._respect_backoff(state, f"Modbus {self.endpoint} unit {unit}", NoAnswerError, urgent=urgent)
        busy = self.policy.busy_retries
        while True:
            try:
                values = self._exchange(unit, state, request, urgent=urgent)
            except AbortError as error:
                self._heard(state)
                if error.code != BUSY or busy == 0:
                    raise
                busy -= 1
                self.clock.sleep_s(self.policy.busy_pause_s)
            except (TransportError, ProtocolError) as error:
                if repeats == 0:
                    if blamed and isinstance(error, NoAnswerError):
                        self._missed(state)
                    raise
                repeats -= 1
                self._count(repeats=1)
            else:
                self._heard(state)
                return values

    # -- one exchange --------------------------------------------------------------------------------------------------
    def _exchange(self, unit: int, state: _Unit, request: Request, *, urgent: bool) -> tuple[int, ...]:
        wire = self._opened()
        self._connect(wire, urgent=urgent)
        if state.pending is not None and state.pending.echo == request.echo:
            self._resynchronise(wire, unit, state, request)
        return self._send(wire, unit, state, request)

    def _send(self, wire: Wire, unit: int, state: _Unit, request: Request) -> tuple[int, ...]:
        self.clock.sleep_until_ns(self._free_ns)
        if self._unclean:
            wire.discard(_SILENCE_S)
            self._unclean = False
        self._count(requests=1)
        try:
            values = wire.exchange(unit, request)
        except NoAnswerError:
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
        self._end_of_exchange(state)
        if not request.function.is_write:
            state.answered[request.echo] = request
        return values

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
