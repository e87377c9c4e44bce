"""The SDO server of the simulated drive: expedited, segmented and block transfer, one channel (CiA-301, 7.2.4).

Server side of the protocol, frame in, frames out, written apart from the master's client. The dictionary decides which accesses are
allowed.
"""

from __future__ import annotations

from collections.abc import Callable

from sim_backends.canopen_dictionary import Dictionary, RefusedError

TOGGLE = 0x05030000
TIMED_OUT = 0x05040000
UNKNOWN_COMMAND = 0x05040001
BAD_BLOCK_SIZE = 0x05040002
BAD_CRC = 0x05040004
LENGTH = 0x06070010
BLOCK = 127
MAX_DOWNLOAD = 1 << 20


def _crc(data: bytes) -> int:
    """CCITT, bit by bit over a table of sixteen: x^16 + x^12 + x^5 + 1, start 0."""
    value = 0
    for byte in data:
        for nibble in (byte >> 4, byte & 0x0F):
            value = (value << 4 & 0xFFFF) ^ _CRC_NIBBLES[(value >> 12) ^ nibble]
    return value


def _crc_nibble(nibble: int) -> int:
    value = nibble << 12
    for _ in range(4):
        value = (value << 1 ^ 0x1021) if value & 0x8000 else value << 1
    return value & 0xFFFF


_CRC_NIBBLES = tuple(_crc_nibble(nibble) for nibble in range(16))


class SdoServer:
    """`handle(request)` returns the frames that answer it."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        self._mux = bytes(3)
        self._step: Callable[[bytes], list[bytes]] | None = None
        self._buffer = b""
        self._announced: int | None = None
        self._toggle = 0
        self._position = 0
        self._block_size = BLOCK
        self._expected = 1
        self._use_crc = False

    def reset(self) -> None:
        """Discard a transfer that is in progress."""
        self._step = None

    def handle(self, request: bytes) -> list[bytes]:
        """The answer frames to one request; none for a frame of a wrong length or an abort."""
        if len(request) != 8:
            return []
        if self._step is not None and self._step == self._block_download_segment:
            # within a block every frame is a segment; only an abort can be told apart, by its sequence number 0
            if request[0] == 0x80:
                self.reset()
                return []
            return self._block_download_segment(request)
        if request[0] == 0x80:
            self.reset()
            return []
        try:
            return self._dispatch(request)
        except RefusedError as refusal:
            self.reset()
            return [b"\x80" + self._mux + refusal.code.to_bytes(4, "little")]

    def _dispatch(self, request: bytes) -> list[bytes]:
        specifier = request[0] >> 5
        starts = {1: self._start_download, 2: self._start_upload}
        if specifier in starts:
            self._mux = request[1:4]
            self.reset()
            return starts[specifier](request)
        if specifier == 6 and not request[0] & 0x01:
            self._mux = request[1:4]
            self.reset()
            return self._start_block_download(request)
        if specifier == 5 and not request[0] & 0x03:
            self._mux = request[1:4]
            self.reset()
            return self._start_block_upload(request)
        if self._step is None:
            raise RefusedError(UNKNOWN_COMMAND)
        return self._step(request)

    def _target(self) -> tuple[int, int]:
        return int.from_bytes(self._mux[:2], "little"), self._mux[2]

    # -- upload ------------------------------------------------------------------------------------------------------
    def _start_upload(self, _request: bytes) -> list[bytes]:
        data = self._dictionary.read(*self._target())
        if 0 < len(data) <= 4:
            return [bytes((0x43 | (4 - len(data)) << 2,)) + self._mux + data + bytes(4 - len(data))]
        self._buffer, self._position, self._toggle = data, 0, 0
        self._step = self._upload_segment
        return [b"\x41" + self._mux + len(data).to_bytes(4, "little")]

    def _upload_segment(self, request: bytes) -> list[bytes]:
        if request[0] >> 5 != 3:
            raise RefusedError(UNKNOWN_COMMAND)
        if request[0] & 0x10 != self._toggle:
            raise RefusedError(TOGGLE)
        part = self._buffer[self._position : self._position + 7]
        self._position += 7
        last = self._position >= len(self._buffer)
        head = self._toggle | (7 - len(part)) << 1 | int(last)
        self._toggle ^= 0x10
        if last:
            self._step = None
        return [bytes((head,)) + part + bytes(7 - len(part))]

    # -- download ----------------------------------------------------------------------------------------------------
    def _start_download(self, request: bytes) -> list[bytes]:
        self._dictionary.item(*self._target())
        if request[0] & 0x02:
            length = 4 - (request[0] >> 2 & 3) if request[0] & 0x01 else 4
            self._dictionary.write(*self._target(), request[4 : 4 + length])
            return [b"\x60" + self._mux + bytes(4)]
        self._announced = int.from_bytes(request[4:], "little") if request[0] & 0x01 else None
        self._buffer, self._toggle = b"", 0
        self._step = self._download_segment
        return [b"\x60" + self._mux + bytes(4)]

    def _download_segment(self, request: bytes) -> list[bytes]:
        if request[0] >> 5 != 0:
            raise RefusedError(UNKNOWN_COMMAND)
        if request[0] & 0x10 != self._toggle:
            raise RefusedError(TOGGLE)
        self._buffer += request[1 : 8 - (request[0] >> 1 & 7)]
        if len(self._buffer) > MAX_DOWNLOAD:
            raise RefusedError(LENGTH)
        answer = bytes((0x20 | self._toggle,)) + bytes(7)
        self._toggle ^= 0x10
        if request[0] & 0x01:
            self._step = None
            self._store()
        return [answer]

    def _store(self) -> None:
        if self._announced is not None and self._announced != len(self._buffer):
            raise RefusedError(LENGTH)
        self._dictionary.write(*self._target(), self._buffer)

    # -- block upload ------------------------------------------------------------------------------------------------
    def _start_block_upload(self, request: bytes) -> list[bytes]:
        self._buffer = self._dictionary.read(*self._target())
        self._use_crc = bool(request[0] & 0x04)
        self._set_block_size(request[4])
        if request[5] and len(self._buffer) <= request[5]:
            return self._start_upload(request)
        self._position = 0
        self._step = self._block_upload_go
        return [bytes((0xC6,)) + self._mux + len(self._buffer).to_bytes(4, "little")]

    def _set_block_size(self, size: int) -> None:
        if not 1 <= size <= BLOCK:
            raise RefusedError(BAD_BLOCK_SIZE)
        self._block_size = size

    def _block_upload_go(self, request: bytes) -> list[bytes]:
        if request[0] != 0xA3:
            raise RefusedError(UNKNOWN_COMMAND)
        return self._send_block()

    def _send_block(self) -> list[bytes]:
        total = max(1, -(-len(self._buffer) // 7))
        first = self._position // 7
        frames = []
        for number, segment in enumerate(range(first, min(first + self._block_size, total)), start=1):
            part = self._buffer[7 * segment : 7 * segment + 7]
            frames.append(bytes((number | (0x80 if segment == total - 1 else 0),)) + part + bytes(7 - len(part)))
        self._sent = len(frames)
        self._step = self._block_upload_acknowledged
        return frames

    def _block_upload_acknowledged(self, request: bytes) -> list[bytes]:
        if request[0] != 0xA2 or request[1] > self._sent:
            raise RefusedError(UNKNOWN_COMMAND)
        self._position += 7 * request[1]
        self._set_block_size(request[2])
        if self._position < len(self._buffer) or (not self._buffer and request[1] == 0):
            return self._send_block()
        unused = (7 - len(self._buffer) % 7) % 7 if self._buffer else 7
        crc = _crc(self._buffer) if self._use_crc else 0
        self._step = self._block_upload_ended
        return [bytes((0xC1 | unused << 2,)) + crc.to_bytes(2, "little") + bytes(5)]

    def _block_upload_ended(self, request: bytes) -> list[bytes]:
        if request[0] != 0xA1:
            raise RefusedError(UNKNOWN_COMMAND)
        self._step = None
        return []

    # -- block download ----------------------------------------------------------------------------------------------
    def _start_block_download(self, request: bytes) -> list[bytes]:
        item = self._dictionary.item(*self._target())
        if not item.writable:
            raise RefusedError(0x06010002)
        self._announced = int.from_bytes(request[4:], "little") if request[0] & 0x02 else None
        self._use_crc = bool(request[0] & 0x04)
        self._expected, self._block_size = 1, BLOCK
        self._buffer = b""
        self._step = self._block_download_segment
        return [bytes((0xA4,)) + self._mux + bytes((self._block_size, 0, 0, 0))]

    def _block_download_segment(self, request: bytes) -> list[bytes]:
        sequence, last = request[0] & 0x7F, bool(request[0] & 0x80)
        in_order = sequence == self._expected
        if in_order:
            self._buffer += request[1:]
            self._expected += 1
        if not last and sequence < self._block_size:
            return []
        acknowledged = self._expected - 1
        self._expected = 1
        if last and in_order:
            self._step = self._block_download_end
        return [bytes((0xA2, acknowledged, self._block_size, 0, 0, 0, 0, 0))]

    def _block_download_end(self, request: bytes) -> list[bytes]:
        if request[0] & 0xE3 != 0xC1:
            raise RefusedError(UNKNOWN_COMMAND)
        unused = request[0] >> 2 & 7
        self._buffer = self._buffer[: len(self._buffer) - unused]
        if self._use_crc and int.from_bytes(request[1:3], "little") != _crc(self._buffer):
            raise RefusedError(BAD_CRC)
        self._step = None
        self._store()
        return [b"\xa1" + bytes(7)]
