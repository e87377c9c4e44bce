"""The touch-probe unit of the simulated drive as objects (CiA-402, 60B8h to 60BDh, stamps 60D1h and counters 60D5h).

Defines the bits of the objects. `probe_latch` decides what is latched, and when.
"""

from __future__ import annotations

from functools import partial

from sim_backends.canopen_dictionary import INVALID_VALUE, Dictionary, RefusedError
from sim_backends.probe_latch import Contact, ProbeLatch
from sim_backends.servo import SimulatedServo

__all__ = ["Contact", "TouchProbeUnit"]

ENABLE, CONTINUOUS, SOURCE, POSITIVE, NEGATIVE = 0x01, 0x02, 0x0C, 0x10, 0x20
STATUS_ENABLED, STATUS_POSITIVE, STATUS_NEGATIVE = 0x01, 0x02, 0x04
VALUE, STAMP, COUNTER = 0x60BA, 0x60D1, 0x60D5


class TouchProbeUnit(ProbeLatch):
    """Both channels of one drive, in its dictionary."""

    def __init__(self, dictionary: Dictionary, servo: SimulatedServo) -> None:
        super().__init__(servo)
        dictionary.on_write(0x60B8, 0, self._write_function)
        dictionary.on_read(0x60B9, 0, self._status)
        caught = [edge for probe in self.channels for edge in (probe.rising, probe.falling)]
        for place, edge in enumerate(caught):
            for first, shown in ((VALUE, "position_counts"), (STAMP, "stamp_us"), (COUNTER, "count")):
                dictionary.on_read(first + place, 0, partial(getattr, edge, shown))

    def _status(self) -> int:
        word = 0
        for place, probe in enumerate(self.channels):
            shown = STATUS_ENABLED if probe.enabled else 0
            shown |= STATUS_POSITIVE if probe.rising.stored else 0
            shown |= STATUS_NEGATIVE if probe.falling.stored else 0
            word |= shown << 8 * place
        return word

    def _write_function(self, word: int) -> None:
        if (word | word >> 8) & SOURCE:
            raise RefusedError(INVALID_VALUE)  # zero pulse and other sources are not implemented
        for place, probe in enumerate(self.channels):
            bits = word >> 8 * place
            probe.arm(
                enabled=bool(bits & ENABLE),
                continuous=bool(bits & CONTINUOUS),
                rising=bool(bits & POSITIVE),
                falling=bool(bits & NEGATIVE),
            )
