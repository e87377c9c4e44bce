"""Decoder for the µMD interferometer's serial protocol: bytes in, typed events out. No I/O, no clock, no unit but the protocol's.

The firmware (Micro Measurement Display, publicly documented, 115200 baud 8N1) sends one line per sample without being asked: 8
decimal integers, 16 where several axes are fitted, separated by blanks, ended by CR LF:

    REF MEAS disp vel phase seq lsCode lsData [MEAS2 disp2 vel2 phase2 MEAS3 disp3 vel3 phase3]

REF, MEAS: cycles of the reference and of the measuring beam within one sample; disp: displacement in λ/2, λ/4 or λ/8 by the
optics; phase: its fraction in 1/256, of which bit 0x100 is the sign and 0x7E00 are error bits; seq: number of the sample;
lsCode/lsData: one slow value at a time.

`UmdDecoder.feed` raises nothing, whatever arrives: bytes that are no sample become a `BadLine`. Memory is bounded.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum, IntEnum
from typing import NamedTuple

from drivers.instruments.lines import BadLine, LineSplitter

MAX_LINE_BYTES = 400  # 16 numbers of 64 bits with their signs and blanks are 351
_INT64 = 1 << 63
_SEQUENCE_SPAN = 1 << 32
_CLEAN = b"0123456789- "


class SlowCode(IntEnum):
    """lsCode: the meaning of lsData. Scales as the firmware fills them: 0.01 °C, Pa, 0.1 %, 0.01 Hz."""

    NONE = 0
    LASER_POWER = 1
    SIGNAL_STRENGTH = 2
    TEMPERATURE_1 = 3
    TEMPERATURE_2 = 4
    PRESSURE = 5
    HUMIDITY = 6
    SAMPLE_RATE = 8
    FIRMWARE = 10


SLOW_SCALE: dict[int, float] = {
    SlowCode.TEMPERATURE_1: 0.01,  # °C
    SlowCode.TEMPERATURE_2: 0.01,  # °C
    SlowCode.PRESSURE: 0.01,  # hPa
    SlowCode.HUMIDITY: 0.1,  # %
    SlowCode.SAMPLE_RATE: 0.01,  # Hz
}
"""Factor from lsData to the unit named; a negative lsData means that the sensor is not fitted."""


class SampleState(Enum):
    """State of the signal in one sample."""

    GOOD = "good"
    HEAD_ERROR = "no reference signal"
    BEAM_LOST = "no measuring beam"
    OVERSPEED = "faster than the counter follows"


_REFERENCE_BITS = 0x200 | 0x400 | 0x1000 | 0x2000  # no edge of REF found while interpolating
_BEAM_BITS = 0x800 | 0x4000  # no edge of MEAS found
_ERROR_BITS = _REFERENCE_BITS | _BEAM_BITS


class AxisSample(NamedTuple):
    """The values of one axis in a line, in the protocol's integers."""

    ref: int
    meas: int
    displacement: int
    velocity: int
    phase: int

    @property
    def state(self) -> SampleState:
        """State of the reference first: without it the other values mean nothing."""
        phase_error = self.phase & _ERROR_BITS if self.phase >= 0 else 0
        if self.ref == 0 or phase_error & _REFERENCE_BITS:
            return SampleState.HEAD_ERROR
        if self.meas == 0 or phase_error & _BEAM_BITS:
            return SampleState.BEAM_LOST
        if self.meas > 2 * self.ref:
            return SampleState.OVERSPEED
        return SampleState.GOOD

    @property
    def units(self) -> float:
        """Displacement with its fraction, in the optics' unit (λ/2, λ/4 or λ/8)."""
        return self.displacement + phase_fraction(self.phase)


class UmdSample(NamedTuple):
    """One line. `others` holds (MEAS, disp, vel, phase) of axes 2 and 3, flat: 0 or 8 numbers."""

    ref: int
    meas: int
    displacement: int
    velocity: int
    phase: int
    sequence: int
    slow_code: int
    slow_data: int
    others: tuple[int, ...] = ()

    def axis(self, number: int) -> AxisSample | None:
        """Axis 1, 2 or 3; None when the line does not hold it."""
        if number == 1:
            return AxisSample(self.ref, self.meas, self.displacement, self.velocity, self.phase)
        start = 4 * (number - 2)
        values = self.others[start : start + 4]
        return AxisSample(self.ref, *values) if start >= 0 and len(values) == 4 else None


UmdEvent = UmdSample | BadLine


def phase_fraction(phase: int) -> float:
    """Fraction of a unit that a phase value adds: 1/256 each, bit 0x100 negative (two's complement), negative values as they are."""
    if phase > 0 and phase & 0x100:
        phase -= 0x200
    return phase / 256.0


def lost_between(previous: int, sequence: int) -> int | None:
    """Samples missing between two numbers; None when the counter went backwards (the instrument restarted). Wraps at 2³²."""
    step = (sequence - previous) % _SEQUENCE_SPAN
    if step == 0 or step > _SEQUENCE_SPAN // 2:
        return None
    return step - 1


class UmdDecoder:
    """Incremental parser; `LineSplitter` handles lines in pieces, line ends and joining in mid-line."""

    def __init__(self) -> None:
        self._lines = LineSplitter(MAX_LINE_BYTES, from_line_start=False)

    def feed(self, data: bytes) -> list[UmdEvent]:
        """Events completed by these bytes, in order. Raises nothing."""
        before, whole, after = self._lines.feed(data)
        events: list[UmdEvent] = [*before]
        if any(line.translate(None, _CLEAN) or len(line) > MAX_LINE_BYTES for line in whole):
            for line in whole:
                if len(line) > MAX_LINE_BYTES:
                    events.append(BadLine(line[:MAX_LINE_BYTES], f"line longer than {MAX_LINE_BYTES} bytes"))
                elif foreign := line.translate(None, _CLEAN):
                    events.append(BadLine(line[:MAX_LINE_BYTES], f"holds {foreign[:8]!r}, expected decimal integers"))
                else:
                    _parse_lines((line,), events)
        else:
            _parse_lines(whole, events)
        events += after
        return events


def _parse_lines(lines: Iterable[bytes], events: list[UmdEvent]) -> None:
    """Whole lines of nothing but digits, signs and blanks; the fast path."""
    for line in lines:
        try:
            values = tuple(map(int, line.split()))
        except ValueError:
            events.append(BadLine(line[:MAX_LINE_BYTES], "holds something that is no integer"))
            continue
        if len(values) == 8:
            if max(values) < _INT64 and min(values) >= -_INT64 and values[0] >= 0 and values[1] >= 0:
                events.append(UmdSample(*values))
                continue
        elif len(values) == 16:
            if max(values) < _INT64 and min(values) >= -_INT64 and values[0] >= 0 and values[1] >= 0:
                events.append(UmdSample._make((*values[:8], values[8:])))
                continue
        elif not values:
            continue
        else:
            events.append(BadLine(line[:MAX_LINE_BYTES], f"holds {len(values)} numbers, expected 8 or 16"))
            continue
        events.append(BadLine(line[:MAX_LINE_BYTES], "holds a number out of range"))
