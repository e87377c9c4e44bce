"""A Modbus wire without a line: requests are handled as PDUs by the registers of a simulated drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.errors import AbortError
from drivers.modbus.wire import Request
from sim_backends.modbus_registers import Face, answer


def pdu_of(request: Request) -> bytes:
    pdu = bytes((request.function,)) + request.address.to_bytes(2, "big")
    if request.function == 5:
        return pdu + (b"\xff\0" if request.values[0] else b"\0\0")
    if request.function == 6:
        return pdu + request.values[0].to_bytes(2, "big")
    pdu += request.count.to_bytes(2, "big")
    if request.function == 15:
        bits = sum(value << place for place, value in enumerate(request.values))
        size = (request.count + 7) // 8
        return pdu + bytes((size,)) + bits.to_bytes(size, "little")
    if request.function == 16:
        words = b"".join(value.to_bytes(2, "big") for value in request.values)
        return pdu + bytes((len(words),)) + words
    assert request.function in (1, 2, 3, 4)
    return pdu


def values_of(request: Request, reply: bytes) -> tuple[int, ...]:
    """Raises AbortError for a refusal."""
    if reply[0] & 0x80:
        raise AbortError("refused", reply[1])
    if request.function in (1, 2):
        return tuple(reply[2 + place // 8] >> place % 8 & 1 for place in range(request.count))
    if request.function in (3, 4):
        return tuple(int.from_bytes(reply[2 + 2 * n : 4 + 2 * n], "big") for n in range(request.count))
    return ()


class DirectWire:
    """Requests as PDUs to the face, packed and unpacked here by separate code; `seen` has the function and count of each."""

    def __init__(self, face: Face) -> None:
        self.face, self.connected = face, True
        self.seen: list[tuple[int, int]] = []

    def connect(self, within_s: float = math.inf) -> None: ...
    def disconnect(self) -> None: ...
    def discard(self, silence_s: float) -> None: ...
    def post(self, unit: int, requests: Sequence[Request]) -> None: ...

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        self.seen.append((request.function, request.count))
        return values_of(request, answer(self.face, pdu_of(request)))
