"""A display or gauge on a serial line as a `DistanceInstrument`: port + protocol + clock + direction.

An instrument that answers requests has one request open at a time: the next one is sent when a poll finds the answer to the last
one, or none within ANSWER_S on a quiet line. A reading is no older than its request; of an instrument that sends by itself, no
older than the poll before it. After a fault or a lost port the zero may have changed: positions stay withheld until
`acknowledge_loss()`.
"""

from __future__ import annotations

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError, LinkLostError
from drivers.instrument import DistanceInstrument, Environment, Reading, ReadingStatus
from drivers.instruments.link import AskedLink
from drivers.instruments.values import BadLine, Fault, Value, ValueProtocol

ANSWER_S = 0.5
"""Time a display is given for its answer, s."""


class Gauge(DistanceInstrument):
    """The instrument. direction: +1 or −1, motion of the load for rising values. `poll` returns at once; there is no thread.

    Raises InputError for another direction."""

    def __init__(
        self, link: AskedLink, clock: Clock, protocol: ValueProtocol, *, direction: int = 1, name: str = "gauge"
    ) -> None:
        if direction not in (1, -1):
            raise InputError(f"{name} direction is {direction}, expected 1 or -1")
        self.name = name
        self.answers_when_asked = bool(protocol.request)
        self._link = link
        self._clock = clock
        self._protocol = protocol
        self._direction = direction
        self._sequence = 0
        self._latched = False
        self._looked_ns = clock.now_ns()
        self._asked_ns: int | None = None
        self._quiet = False  # whether bytes left over on the line have been discarded
        self.bad_lines = 0

    def open(self) -> None:
        self._link.open()
        self._start_anew()

    def close(self) -> None:
        self._link.close()

    def _start_anew(self) -> None:
        self._protocol.restart()
        self._asked_ns, self._quiet = None, False
        self._looked_ns = self._clock.now_ns()

    def poll(self) -> list[Reading]:
        began_ns = self._clock.now_ns()
        try:
            readings = self._look()
        except LinkLostError:
            self._start_anew()
            self._latched = True
            raise
        self._looked_ns = began_ns
        return readings

    def _look(self) -> list[Reading]:
        data = self._link.read_waiting()
        now_ns = self._clock.now_ns()  # after it: the kernel may take its time to hand on what has arrived
        if not self.answers_when_asked:
            return self._readings(data, now_ns, self._looked_ns)
        readings: list[Reading] = []
        if self._asked_ns is None:  # no request is open: what comes is unrequested
            self._quiet = not data
        else:
            readings = self._readings(data, now_ns, self._asked_ns)
            if readings:
                self._asked_ns = None
            elif now_ns - self._asked_ns > ANSWER_S * NS_PER_S:
                self._asked_ns, self._quiet = None, False
        if self._asked_ns is None and self._quiet:
            self._protocol.restart()
            self._link.write(self._protocol.request)
            self._asked_ns = now_ns
        return readings

    def _readings(self, data: bytes, now_ns: int, since_ns: int) -> list[Reading]:
        readings = []
        for event in self._protocol.feed(data) if data else ():
            if isinstance(event, BadLine):
                self.bad_lines += 1
            else:
                readings.append(self._reading(event, now_ns, since_ns))
        return readings

    def _reading(self, event: Value | Fault, now_ns: int, since_ns: int) -> Reading:
        self._sequence += 1
        if isinstance(event, Fault):
            self._latched = True
        if self._latched or isinstance(event, Fault):
            status = ReadingStatus.HEAD_ERROR if isinstance(event, Fault) else ReadingStatus.LOST_BEFORE
            return Reading(now_ns, status, None, self._sequence, since_ns=since_ns)
        position_mm = self._direction * event.position_mm
        return Reading(now_ns, ReadingStatus.GOOD, position_mm, self._sequence, since_ns=since_ns)

    def acknowledge_loss(self) -> bool:
        latched, self._latched = self._latched, False
        return latched

    def environment(self) -> Environment:
        """Empty: none of these instruments measures the air."""
        return Environment(self._looked_ns)

    @property
    def sample_rate_hz(self) -> float | None:
        """None: none of these instruments states its rate."""
        return None
