"""Decoder for instruments that send their value as text, one line each; a pattern describes the line. No I/O.

A pattern is a regular expression over the whole line with a group `value` and, where the line says it, a group `unit` (mm, um, µm,
in, inch, "); capitals and small letters are the same. It should fix the width of the number, or `decimals` be given: otherwise
`+0000.12`, a line that lost its end, would be as valid as `+0000.123`. Shipped: "mitutoyo" (01A+0000.123 CR, 9600 8N1, digital
counters and USB tools) and "number".
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from drivers.errors import InputError
from drivers.instruments.lines import LineSplitter
from drivers.instruments.values import BadLine, Fault, Value, ValueEvent
from drivers.value_pattern import MM, fault_pattern, value_pattern

LONGEST_BYTES = 200

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,2})?")


@dataclass(frozen=True)
class AsciiSettings:
    """pattern: the name of a shipped one, or a regular expression; fault: one for lines that report 'no value', "" for none.

    unit: of the value where the line does not contain it; decimals: digits after the point that a value must have, None for any;
    request: bytes that ask for a value, b"" for an instrument that sends by itself. Raises InputError for what cannot work.
    """

    pattern: str = "number"
    fault: str = ""
    unit: str = "mm"
    decimals: int | None = None
    request: bytes = b""

    def __post_init__(self) -> None:
        if self.unit.casefold() not in MM:
            raise InputError(f"unit is {self.unit!r}, expected one of {', '.join(MM)}")
        value_pattern(self.pattern)
        fault_pattern(self.fault)


class AsciiDecoder:
    """Decodes lines by a pattern. A line that does not match is a BadLine, never a guess."""

    def __init__(self, settings: AsciiSettings) -> None:
        self.settings = settings
        self._pattern = value_pattern(settings.pattern)
        self._fault = fault_pattern(settings.fault)
        self.restart()

    @property
    def request(self) -> bytes:
        """The bytes that ask for one value; empty for an instrument that sends by itself."""
        return self.settings.request

    def restart(self) -> None:
        """Discard an unfinished line; the first line of a stream joined in the middle is refused."""
        self._lines = LineSplitter(LONGEST_BYTES, from_line_start=bool(self.settings.request))

    def feed(self, data: bytes) -> list[ValueEvent]:
        """Events completed by these bytes, in order. Raises nothing."""
        before, whole, after = self._lines.feed(data)
        return [*before, *(self._event(line) for line in whole if line), *after]

    def _event(self, line: bytes) -> ValueEvent:
        raw = line[:LONGEST_BYTES]
        if len(line) > LONGEST_BYTES:
            return BadLine(raw, f"line longer than {LONGEST_BYTES} bytes")
        try:
            text = raw.decode("utf-8")
        except UnicodeDecodeError:  # an 8-bit µ or noise, which no pattern matches
            text = raw.decode("latin-1")
        if self._fault is not None and self._fault.fullmatch(text):
            return Fault(f"the instrument says {text.strip()!r}")
        match = self._pattern.fullmatch(text)
        return BadLine(raw, "does not match the pattern") if match is None else self._value(raw, match)

    def _value(self, raw: bytes, match: re.Match[str]) -> ValueEvent:
        number = re.sub(r"\s", "", match["value"] or "")
        if not number.isascii() or not _NUMBER.fullmatch(number):
            return BadLine(raw, "holds no number where the value stands")
        wanted = self.settings.decimals
        if wanted is not None and len(number.partition(".")[2]) != wanted:
            return BadLine(raw, f"has another number of decimals than {wanted}")
        unit = match.groupdict().get("unit") or self.settings.unit
        if unit.casefold() not in MM:
            return BadLine(
                raw, f"has the unit {unit[:8]!r}, expected one of {', '.join(MM)}; state it (unit), without that group"
            )
        value_mm = float(number) * MM[unit.casefold()]
        return Value(value_mm) if math.isfinite(value_mm) else BadLine(raw, "holds a number out of range")
