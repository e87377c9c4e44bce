"""The touch-probe unit of the simulated drive: positions latched on the edges of two inputs (CiA-402, 60B8h to 60BDh).

What may go in: arming, latching, edge counters and time stamps. What closes a contact is the machine's business: it is attached as a
function of the motor's position, so that the switching point is found between two steps of time as exactly as counts allow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sim_backends.canopen_dictionary import INVALID_VALUE, Dictionary, RefusedError
from sim_backends.servo import Servo

Contact = Callable[[int], bool]
"""contact(position_counts): whether the input is active when the motor is there."""

ENABLE, CONTINUOUS, SOURCE, POSITIVE, NEGATIVE = 0x01, 0x02, 0x0C, 0x10, 0x20
STATUS_ENABLED, STATUS_POSITIVE, STATUS_NEGATIVE = 0x01, 0x02, 0x04
VALUE, STAMP, COUNTER = 0x60BA, 0x60D1, 0x60D5


@dataclass
class _Channel:
    number: int  # 0 or 1
    function: int = 0
    status: int = 0
    contact: Contact | None = None
    level: bool = False
    at_counts: int = 0


class TouchProbeUnit:
    """Both channels of one drive."""

    def __init__(self, dictionary: Dictionary, servo: Servo) -> None:
        self._od = dictionary
        self._servo = servo
        self._now_ns = 0
        self._channels = (_Channel(0), _Channel(1))
        dictionary.on_write(0x60B8, 0, self._write_function)
        dictionary.on_read(0x60B9, 0, lambda: self._channels[0].status | self._channels[1].status << 8)

    @property
    def inputs(self) -> int:
        """The levels as bits 0 and 1."""
        return sum(channel.level << channel.number for channel in self._channels)

    def attach(self, number: int, contact: Contact) -> None:
        """Let input 1 or 2 follow a contact that depends on where the motor is."""
        channel = self._channels[number - 1]
        channel.contact = contact
        channel.at_counts = self._servo.position_actual_counts
        channel.level = contact(channel.at_counts)

    def set_input(self, number: int, level: bool, position_counts: int | None = None) -> None:
        """Switch input 1 or 2 now, at the present position or at one that is known better."""
        channel = self._channels[number - 1]
        position = self._servo.position_actual_counts if position_counts is None else position_counts
        if level != channel.level:
            channel.level = level
            self._edge(channel, level, position)

    def reset(self) -> None:
        """The electronics start anew."""
        for channel in self._channels:
            channel.function = channel.status = 0

    def tick(self, now_ns: int) -> None:
        """The motor has moved on: look at the contacts."""
        self._now_ns = now_ns
        for channel in self._channels:
            contact = channel.contact
            if contact is None:
                continue
            position = self._servo.position_actual_counts
            if position == channel.at_counts:
                continue
            level = contact(position)
            if level != channel.level:
                self._edge(channel, level, _switching_point(contact, channel.at_counts, position))
                channel.level = level
            channel.at_counts = position

    def _edge(self, channel: _Channel, rising: bool, position: int) -> None:
        place = 2 * channel.number + (0 if rising else 1)
        counter = COUNTER + place
        self._od.set_number(counter, 0, self._od.number(counter) + 1 & 0xFFFF)
        stored = STATUS_POSITIVE if rising else STATUS_NEGATIVE
        wanted = channel.function & (POSITIVE if rising else NEGATIVE)
        if not channel.function & ENABLE or not wanted:
            return
        if channel.status & stored and not channel.function & CONTINUOUS:
            return
        channel.status |= stored
        self._od.set_number(VALUE + place, 0, position)
        self._od.set_number(STAMP + place, 0, self._now_ns // 1000 & 0xFFFFFFFF)

    def _write_function(self, word: int) -> None:
        if (word | word >> 8) & SOURCE:
            raise RefusedError(INVALID_VALUE)  # zero pulse and other sources are not built in
        for channel in self._channels:
            before, channel.function = channel.function, word >> 8 * channel.number & 0x3F
            if not channel.function & ENABLE:
                channel.status = 0
            elif not before & ENABLE:
                channel.status = STATUS_ENABLED
            for edge, stored in ((POSITIVE, STATUS_POSITIVE), (NEGATIVE, STATUS_NEGATIVE)):
                if not channel.function & edge:
                    channel.status &= ~stored


def _switching_point(contact: Contact, before: int, after: int) -> int:
    """The first count on the way from `before` to `after` at which the contact is as it is at `after`."""
    final = contact(after)
    low, high = before, after
    while abs(high - low) > 1:
        middle = (low + high) // 2
        if contact(middle) == final:
            high = middle
        else:
            low = middle
    return high
