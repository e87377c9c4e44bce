"""A Modbus wire without a line: requests are handled as PDUs by the registers of a simulated drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.errors import AbortError
from drivers.modbus.wire import Request
from sim_backends.modbus_registers import Face, answer


class DirectWire:
    """Requests as PDUs to the face, packed and unpacked here by separate code."""

    def __init__(self, face: Face) -> None:
        self.face, self.connected = face, True

    def connect(self, within_s: float = math.inf) -> None: ...
    def disconnect(self) -> None: ...
    def discard(self, silence_s: float) -> None: ...
    def post(self, unit: int, requests: Sequence[Request]) -> None: ...

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        pdu = bytes((request.function,)) + request.address.to_bytes(2, "big")
        if request.function == 5:
            pdu += b"\xff\0" if request.values[0] else b"\0\0"
        elif request.function == 6:
            pdu += request.values[0].to_bytes(2, "big")
        elif request.function == 15:
            bits = sum(value << place for place, value in enumerate(request.values))
            size = (request.count + 7) // 8
            pdu += request.count.to_bytes(2, "big") + bytes((size,)) + bits.to_bytes(size, "little")
        elif request.function == 16:
            pdu += request.count.to_bytes(2, "big") + bytes((2 * request.count,))
            pdu += b"".join(value.to_bytes(2, "big") for value in request.values)
        else:
            assert request.function in (1, 2, 3, 4)
            pdu += request.count.to_bytes(2, "big")
        reply = answer(self.face, pdu)
        if reply[0] & 0x80:
            raise AbortError("refused", reply[1])
        if request.function in (1, 2):
            return tuple(reply[2 + place // 8] >> place % 8 & 1 for place in range(request.count))
        if request.function in (3, 4):
            return tuple(int.from_bytes(reply[2 + 2 * n : 4 + 2 * n], "big") for n in range(request.count))
        return ()
