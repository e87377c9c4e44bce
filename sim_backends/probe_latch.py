"""Position latches of a simulated drive: two probe inputs, the armed edges, and the latched positions. No protocol.

The machine's contact is attached as a function of the motor's position, so that the switching point is
found between two steps of time to one count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from sim_backends.servo import SimulatedServo

Contact = Callable[[int], bool]
"""contact(position_counts): whether the input is active at this motor position."""


@dataclass
class EdgeLatch:
    """Last latch of one edge of one input. stamp_us: of the drive's clock; count: of all edges, armed or not."""

    armed: bool = False
    stored: bool = False
    position_counts: int = 0
    stamp_us: int = 0
    count: int = 0


@dataclass
class ProbeInput:
    """One input: `rising` and `falling` are the latches of its edges."""

    enabled: bool = False
    continuous: bool = False
    rising: EdgeLatch = field(default_factory=EdgeLatch)
    falling: EdgeLatch = field(default_factory=EdgeLatch)
    contact: Contact | None = None
    level: bool = False
    at_counts: int = 0

    def arm(self, *, enabled: bool, continuous: bool, rising: bool, falling: bool) -> None:
        """Arm the input; an edge that is no longer armed, or armed again, loses its latch."""
        anew = enabled and not self.enabled
        self.enabled, self.continuous = enabled, continuous
        for edge, armed in ((self.rising, rising), (self.falling, falling)):
            edge.armed = armed
            if anew or not enabled or not armed:
                edge.stored = False


class ProbeLatch:
    """Both inputs of one drive."""

    def __init__(self, servo: SimulatedServo) -> None:
        self._servo = servo
        self._now_ns = 0
        self.channels = (ProbeInput(), ProbeInput())
        servo.fast_inputs.append(self.pulse)

    @property
    def inputs(self) -> int:
        """The levels as bits 0 and 1."""
        return sum(probe.level << place for place, probe in enumerate(self.channels))

    def attach(self, number: int, contact: Contact) -> None:
        """Connect input 1 or 2 to a contact that depends on the motor's position."""
        probe = self.channels[number - 1]
        probe.contact = contact
        probe.at_counts = self._servo.position_actual_counts
        probe.level = contact(probe.at_counts)

    def set_input(self, number: int, level: bool) -> None:
        """Switch input 1 or 2 now."""
        probe = self.channels[number - 1]
        if level != probe.level:
            self._edge(probe, level, self._servo.position_actual_counts)

    def pulse(self, number: int) -> None:
        """A short pulse on input 1 or 2, now: both its edges."""
        self.set_input(number, True)
        self.set_input(number, False)

    def reset(self) -> None:
        """Restart of the electronics."""
        for probe in self.channels:
            probe.arm(enabled=False, continuous=False, rising=False, falling=False)

    def tick(self, now_ns: int) -> None:
        """Evaluate the contacts after a motion of the motor."""
        self._now_ns = now_ns
        for probe in self.channels:
            contact = probe.contact
            if contact is None:
                continue
            position = self._servo.position_actual_counts
            if position == probe.at_counts:
                continue
            level = contact(position)
            if level != probe.level:
                self._edge(probe, level, _switching_point(contact, probe.at_counts, position))
            probe.at_counts = position

    def _edge(self, probe: ProbeInput, level: bool, position: int) -> None:
        probe.level = level
        edge = probe.rising if level else probe.falling
        edge.count = edge.count + 1 & 0xFFFF
        if probe.enabled and edge.armed and (probe.continuous or not edge.stored):
            edge.stored = True
            edge.position_counts = position
            edge.stamp_us = self._now_ns // 1000 & 0xFFFFFFFF


def _switching_point(contact: Contact, before: int, after: int) -> int:
    """The first count on the way from `before` to `after` at which the contact has the state that it has at `after`."""
    final = contact(after)
    low, high = before, after
    while abs(high - low) > 1:
        middle = (low + high) // 2
        if contact(middle) == final:
            high = middle
        else:
            low = middle
    return high
