"""Modbus frames as a server sees them: MBAP headers, RTU frames and their CRC, and where a request ends. Bytes only, no ports.

Written from "Modbus messaging on TCP/IP V1.0b" (3.1.3) and "Modbus over serial line V1.02" (2.5.1, 6.2.2), independent of any
library, since it tests one.
"""

from __future__ import annotations

from dataclasses import dataclass

_MBAP_BYTES = 7
_MAX_PDU = 253


@dataclass(frozen=True)
class Frame:
    """A request or a reply; transaction is 0 on a serial line, which has none."""

    unit: int
    pdu: bytes
    transaction: int = 0

    def with_pdu(self, pdu: bytes) -> Frame:
        """The same frame with another PDU."""
        return Frame(self.unit, pdu, self.transaction)


def crc16(data: bytes) -> int:
    """CRC-16 with the polynomial A001h reflected, start FFFFh; it is sent low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def pack_tcp(frame: Frame) -> bytes:
    """Transaction, protocol 0, length of what follows, unit, PDU."""
    return (
        frame.transaction.to_bytes(2, "big")
        + b"\0\0"
        + (len(frame.pdu) + 1).to_bytes(2, "big")
        + bytes((frame.unit,))
        + frame.pdu
    )


def pack_rtu(frame: Frame) -> bytes:
    """Unit, PDU, CRC."""
    body = bytes((frame.unit,)) + frame.pdu
    return body + crc16(body).to_bytes(2, "little")


class TcpDecoder:
    """Cuts a stream into frames. `broken` after an invalid Modbus header: the connection has then to be closed."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.broken = False

    def feed(self, data: bytes) -> list[Frame]:
        self._buffer += data
        frames: list[Frame] = []
        while len(self._buffer) >= _MBAP_BYTES and not self.broken:
            length = int.from_bytes(self._buffer[4:6], "big")
            if self._buffer[2:4] != b"\0\0" or not 2 <= length <= _MAX_PDU + 1:
                self.broken = True
                break
            if len(self._buffer) < 6 + length:
                break
            frames.append(
                Frame(
                    self._buffer[6],
                    bytes(self._buffer[7 : 6 + length]),
                    int.from_bytes(self._buffer[0:2], "big"),
                )
            )
            del self._buffer[: 6 + length]
        return frames


class RtuDecoder:
    """Cuts a serial line into requests, by the length that the function implies, else by silence."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def waiting(self) -> bool:
        """Whether there are bytes that are no complete frame; call `silence` when no more have come for a while."""
        return bool(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        self._buffer += data
        frames: list[Frame] = []
        while (length := _request_bytes(self._buffer)) is not None and len(self._buffer) >= length:
            frame = _checked(bytes(self._buffer[:length]))
            if frame is None:
                break  # damaged: only silence shows where the next one begins
            frames.append(frame)
            del self._buffer[:length]
        return frames

    def silence(self) -> list[Frame]:
        """To be called when the line has been quiet: the bytes so far were one frame, or none."""
        frame = _checked(bytes(self._buffer))
        self._buffer.clear()
        return [] if frame is None else [frame]


def _request_bytes(buffer: bytearray) -> int | None:
    """Length of the request that starts here, with unit and CRC; None where it cannot be determined (yet)."""
    if len(buffer) < 2:
        return None
    if buffer[1] in (1, 2, 3, 4, 5, 6):
        return 8
    if buffer[1] in (15, 16):
        return None if len(buffer) < 7 else 9 + buffer[6]
    return None


def _checked(data: bytes) -> Frame | None:
    if len(data) < 4 or crc16(data[:-2]) != int.from_bytes(data[-2:], "little"):
        return None
    return Frame(data[0], data[1:-2])
