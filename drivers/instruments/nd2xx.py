"""Decoder for HEIDENHAIN ND 2xx displays (length gauges, encoders): bytes in, typed events out, and the requests. No I/O.

RS-232-C, 7 data bits, even parity, 2 stop bits. A display sends nothing unrequested. Two requests give the position (user's manual,
"Data interface"):

    Ctrl-B          -> what is displayed, 15 characters and CR LF: sign, 10 for the number with its decimal point (leading zeros
                       are blanks), blank, unit (blank mm, " inch, ? fault), sorting status, kind of a measurement series
    ESC A0200 CR    -> the count: STX, sign, 9 digits without a decimal point, CR LF

A pulse on the display's external input (EXT) stores a value within a microsecond and sends the displayed value unrequested.
An ESC command that is not understood is answered by NAK. `Nd2xxDecoder.feed` raises nothing, whatever arrives.
"""

from __future__ import annotations

import re

from drivers.errors import InputError
from drivers.instruments.lines import LineSplitter
from drivers.instruments.values import BadLine, Fault, Value, ValueEvent

STX, ACK, NAK, ESC = b"\x02", b"\x06", b"\x15", b"\x1b"
ASK_DISPLAYED = STX
ASK_COUNT = ESC + b"A0200\r"
MM_PER_INCH = 25.4
LONGEST_BYTES = 40

_DISPLAYED = re.compile(rb"(?P<sign>[+-])(?P<number>[ 0-9.]{10}) (?P<unit>[ \"?])[ <>=?][ SAGD]")
_NUMBER = re.compile(rb" *(\d+\.?\d*|\.\d+)")
_COUNT = re.compile(rb"\x02(?P<count>[+-]\d{9})")
_TEXT = re.compile(rb"\x02(?=.*[A-Za-z])(?P<text>[ -~]{1,20})")


class Nd2xxDecoder:
    """Replies of either kind. count_mm: one step of the count, mm; None where only the displayed value is requested.

    pulsed: no requests; its external input triggers the values. Raises InputError for a count_mm outside 0…1.
    """

    def __init__(self, count_mm: float | None = None, *, pulsed: bool = False) -> None:
        if count_mm is not None and not 0.0 < count_mm <= 1.0:
            raise InputError(f"ND 2xx count_mm is {count_mm:g}, expected more than 0 and at most 1")
        self._count_mm = count_mm
        self._pulsed = pulsed
        self._lines = LineSplitter(LONGEST_BYTES, from_line_start=True)

    @property
    def request(self) -> bytes:
        """The bytes that ask for one value."""
        if self._pulsed:
            return b""
        return ASK_DISPLAYED if self._count_mm is None else ASK_COUNT

    def restart(self) -> None:
        """Discard an unfinished reply."""
        self._lines = LineSplitter(LONGEST_BYTES, from_line_start=True)

    def feed(self, data: bytes) -> list[ValueEvent]:
        """Events completed by these bytes, in order; ACK carries no position and is left out. Raises nothing."""
        before, whole, after = self._lines.feed(data.replace(ACK, b"\n").replace(NAK, b"\n" + NAK + b"\n"))
        return [*before, *(self._event(line) for line in whole if line), *after]

    def _event(self, line: bytes) -> ValueEvent:
        if match := _DISPLAYED.fullmatch(line):
            return _displayed(line, match)
        if match := _COUNT.fullmatch(line):
            if self._count_mm is None:
                return BadLine(line, "is a count, expected the value displayed")
            return Value(int(match["count"]) * self._count_mm)
        if line == NAK:
            return Fault("the display does not understand the request (NAK)")
        if match := _TEXT.fullmatch(line):
            return Fault(f"the display says {match['text'].decode('ascii').strip()!r}")
        return BadLine(line[:LONGEST_BYTES], "is no reply of an ND 2xx")


def _displayed(line: bytes, match: re.Match[bytes]) -> ValueEvent:
    if match["unit"] == b"?":
        return Fault("the display shows a fault of its encoder")
    number = _NUMBER.fullmatch(match["number"])
    if number is None:
        return BadLine(line, "holds no number where the value stands")
    value = float(match["sign"] + number[1])
    return Value(value * MM_PER_INCH if match["unit"] == b'"' else value)
