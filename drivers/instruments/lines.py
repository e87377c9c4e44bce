"""Splits a stream of bytes into lines, without I/O: in pieces, with any line end, joined in the middle, or never ending.

Used by every instrument that talks in lines, before a character is interpreted. Memory is bounded by the longest line allowed.
"""

from __future__ import annotations

from typing import NamedTuple


class BadLine(NamedTuple):
    """Bytes that are no reading: `raw` without the line end, cut to the longest line; `reason` as text."""

    raw: bytes
    reason: str


class Lines(NamedTuple):
    """The result of one piece: `whole` lines without their ends, and what was refused before and after them."""

    before: list[BadLine]
    whole: list[bytes]
    after: list[BadLine]


class LineSplitter:
    """Lines may arrive in pieces and end in CR, LF or both; both together count as one end, so an empty line is ignored.

    A running stream is usually joined in mid-line, where a cut first number would look like a small one: the bytes before
    the first line end are refused unless `from_line_start`.
    """

    def __init__(self, longest_bytes: int, *, from_line_start: bool) -> None:
        self._longest = longest_bytes
        self._rest = b""
        self._overlong = False  # dropping bytes until the next line end
        self._aligned = from_line_start

    def feed(self, data: bytes) -> Lines:
        """Lines that are complete with these bytes, in order."""
        data = self._rest + data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        whole = data.split(b"\n")
        self._rest = whole.pop()
        before = self._refuse_first(whole) if whole and (self._overlong or not self._aligned) else []
        after: list[BadLine] = []
        if len(self._rest) > self._longest:
            if not self._overlong:
                after.append(BadLine(self._rest[: self._longest], f"line longer than {self._longest} bytes"))
            self._overlong = True
            self._rest = b""
        return Lines(before, whole, after)

    def _refuse_first(self, whole: list[bytes]) -> list[BadLine]:
        """Refuse the end of a line whose beginning was not received, or was reported as overlong."""
        first = whole.pop(0)
        refused = [BadLine(first[: self._longest], "joined in mid-line")] if first and not self._overlong else []
        self._aligned = True
        self._overlong = False
        return refused
