"""Base of every misbehaving peer, and a kind of misbehaviour as data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Any

from sim_backends.clock import SimClock
from sim_backends.servo import SimulatedServo


@dataclass(frozen=True)
class Kind:
    """A kind of misbehaviour. begin: called at its time with the peer of its wire; errors: a verb that meets it ends by one of them.

    passes: the verb may also complete with correct results. stop_after_s: the operator presses the stop so long after it, s.
    unreachable: no frame reaches the drive any more, which has to stop by itself. coasts: the drive loses its power in
    motion. at_start: begins with the verb, as it concerns homing. disobeys_mm: the drive moves without an order; travel beyond the
    limits, until it is stopped, that is allowed.
    """

    name: str
    begin: Callable[[Any], None]
    errors: tuple[type[BaseException], ...]
    passes: bool = False
    stop_after_s: float | None = None
    unreachable: bool = False
    coasts: bool = False
    at_start: bool = False
    disobeys_mm: float = 0.0


class Kinds(dict[str, Kind]):
    """Kinds by name. `@kinds("name", Error, …)` registers the decorated function as its begin."""

    def __call__(
        self, name: str, *errors: type[BaseException], **more: Any
    ) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
        def keep(begin: Callable[[Any], None]) -> Callable[[Any], None]:
            self[name] = Kind(name, begin, errors, **more)
            return begin

        return keep


class Peer:
    """struck_ns: time at which the misbehaviour first affected a frame, the drive or a reading; None before."""

    def __init__(self, clock: SimClock, servo: SimulatedServo | None = None) -> None:
        self.clock = clock
        self._servo = servo
        self.random = Random(0)
        self.struck_ns: int | None = None
        self.way_mm = 0.0  # travel of the axis up to then
        self.on_strike: Callable[[], None] = lambda: None

    @property
    def servo(self) -> SimulatedServo:
        assert self._servo is not None
        return self._servo

    def arm(self, at_ns: int, begin: Callable[[Any], None], seed: int) -> None:
        """Begin to misbehave at this time, ns."""
        self.random = Random(seed)
        when_due(self.clock, at_ns, lambda: begin(self))

    def strike(self) -> None:
        """Record that the misbehaviour has an effect now."""
        if self.struck_ns is None:
            self.struck_ns = self.clock.now_ns()
            self.on_strike()

    def instead(self, order: str, act: Callable[..., None]) -> None:
        """Replace the servo's reaction to this order from now on."""

        def struck(*arguments: Any) -> None:
            self.strike()
            act(*arguments)

        setattr(self.servo, order, struck)


def when_due(clock: SimClock, at_ns: int, act: Callable[[], None]) -> None:
    """Call this once, when simulated time has reached at_ns."""
    done: list[int] = []

    def look(now_ns: int, _dt_s: float) -> None:
        if not done and now_ns >= at_ns:
            done.append(now_ns)
            act()

    clock.attach(look, bearable=lambda now_ns: 60_000_000_000 if done else max(1, at_ns - now_ns))
