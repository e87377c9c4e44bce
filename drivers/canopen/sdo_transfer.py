"""SDO transfers of CiA-301 as generators: bytes out, bytes in, no I/O and no clock.

Expedited, segmented and block transfer, client side (CiA-301, 7.2.4). A transfer yields the frames to send next and is resumed with
the next frame of the server; it returns the object's bytes (upload) or None (download). A frame that answers another index
is no answer: it is skipped, and the transfer waits on.
Every transfer ends after a number of the server's frames that its size bounds; frames without data are bounded by time, which
the caller keeps (`longest_s`).
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Generator
from typing import NoReturn, TypeVar

from drivers.canopen.abort_codes import (
    ABORT_COMMAND,
    ABORT_CRC,
    ABORT_LENGTH,
    ABORT_MEMORY,
    ABORT_SEQUENCE,
    ABORT_TOGGLE,
    abort_text,
)
from drivers.errors import AbortError, ProtocolError

T = TypeVar("T")
Frames = tuple[bytes, ...]
Transfer = Generator[Frames, bytes, T]

SEGMENT = 7
MAX_BLOCK = 127
LARGEST_ANNOUNCED = 1 << 20
"""Largest size that an upload may announce, bytes: an EDS kept in the device (1021h) has about 100 kB; firmware is not read."""
LARGEST_UNANNOUNCED = 1 << 14
"""Largest upload without an announced size, bytes: four times a correction table of 1000 points of four bytes."""
MORE_BLOCKS = 3
"""Largest number of successive repeats of a block of which no segment arrived: CAN itself repeats a frame that was disturbed."""
SEGMENT_S = 0.05
"""Mean time allowed for each seven bytes, s. A request and an answer of 135 bits with the worst stuffing at 10 kbit/s, the
slowest bit rate of CiA-301, last 27 ms; a serial adapter keeps an answer for up to 16 ms; the rest is the server's."""

ABORT = 0x80
NO_OBJECT = b"\0\0\0"
"""Index and sub-index of an abort that names no object, as some servers send it: of the transfer in progress, as there is one only."""
UPLOAD, DOWNLOAD, BLOCK_DOWNLOAD, BLOCK_UPLOAD = 0x40, 0x60, 0xA0, 0xC0  # answers to initiate requests
SERVER_SPECIFIERS = (0x00, 0x20, UPLOAD, DOWNLOAD, ABORT, BLOCK_DOWNLOAD, BLOCK_UPLOAD)


def multiplexer(index: int, subindex: int) -> bytes:
    """Index and subindex as they stand in bytes 1 to 3 of a frame."""
    return struct.pack("<HB", index, subindex)


def abort_frame(index: int, subindex: int, code: int) -> bytes:
    """The frame by which either side ends a transfer."""
    return struct.pack("<BHBI", ABORT, index, subindex, code)


def longest_s(timeout_s: float, data_bytes: int) -> float:
    """Longest duration of a transfer that has carried `data_bytes`, s; with all of its bytes, of the whole transfer.

    The first answer (the server looks for the object) and the last (it keeps the value) may take `timeout_s` each, every segment
    `SEGMENT_S` on average.
    """
    return 2 * timeout_s + SEGMENT_S * (1 + segments_of(data_bytes))


def segments_of(data_bytes: int) -> int:
    """Number of segments for so many bytes, at least one."""
    return max(1, -(-data_bytes // SEGMENT))


def crc16(data: bytes) -> int:
    """CRC of block transfers: x^16 + x^12 + x^5 + 1, start value 0 (CiA-301, 7.2.4.3.16)."""
    return binascii.crc_hqx(data, 0)


class Conversation:
    """State shared by the steps of one transfer: its object, its progress, and the number of frames that did not belong to it.

    steps: answers so far that continued it; carried: bytes of the object that they brought or confirmed.
    """

    def __init__(self, index: int, subindex: int) -> None:
        self.index = index
        self.subindex = subindex
        self.mux = multiplexer(index, subindex)
        self.steps = 0
        self.carried = 0
        self.instead = ""  # what came last instead of an answer, and the remedy
        self._awaited: tuple[int, ...] = ()
        self._by_blocks = False
        self.closing_frames: Frames = ()  # sent when the generator has ended; not answered

    def place(self) -> str:
        return f"{self.index:04X}h:{self.subindex:02X}"

    def is_abort(self, frame: bytes) -> bool:
        """Whether a whole frame is an abort of this transfer."""
        return len(frame) == 8 and frame[0] == ABORT and frame[1:4] in (self.mux, NO_OBJECT)

    def raise_abort(self, frame: bytes) -> None:
        """Raise AbortError when the frame is an abort of this transfer."""
        if self.is_abort(frame):
            code = struct.unpack_from("<I", frame, 4)[0]
            raise AbortError(f"{self.place()} refused: {abort_text(code)}", code)

    def skip(self, frame: bytes) -> None:
        """Keep what a frame that is no answer was: where none comes, that is the error."""
        if len(frame) != 8:
            self.instead = (
                f"was answered with a frame of {len(frame)} bytes, expected 8 (CiA 301): it takes another firmware, or a gateway"
                " that does not shorten frames"
            )
        elif frame[0] & 0xE0 in (ABORT, *self._awaited) and frame[1:4] != self.mux:
            index, subindex = struct.unpack_from("<HB", frame, 1)
            self.instead = (
                f"was answered for {index:04X}h:{subindex:02X}: another master on its SDO channel, or answers later than the"
                " time-out?"
            )

    def moved(self, data_bytes: int) -> None:
        """Account for an answer that continued the transfer by so many bytes of the object."""
        self.steps += 1
        self.carried += data_bytes

    def may_answer(self, frame: bytes) -> bool:
        """Whether a frame received after the transfer was abandoned can be a late answer to it.

        Segments name no object: after the first answer every frame of their command can be one, of a block every frame.
        """
        if len(frame) != 8:
            return False
        if self.steps and (self._by_blocks or frame[0] & 0xE0 in (0x00, 0x20)):
            return True
        return self.is_abort(frame) or (frame[1:4] == self.mux and frame[0] & 0xE0 in self._awaited)

    def initiate(self, *frames: bytes, answers: tuple[int, ...]) -> Transfer[bytes]:
        """Send, and return the first answer that names this index and subindex. Raises AbortError, ProtocolError.

        answers: the server's command specifiers (upper three bits) that can answer. Another specifier of the protocol answers
        another request for the same object, late or doubled, and is skipped; an unknown one ends the transfer.
        """
        self._awaited = answers
        self._by_blocks = BLOCK_UPLOAD in answers or BLOCK_DOWNLOAD in answers
        answer = yield frames
        while True:
            self.raise_abort(answer)
            if len(answer) == 8 and answer[1:4] == self.mux:
                specifier = answer[0] & 0xE0
                if specifier in answers:
                    self.moved(0)
                    return answer
                if specifier not in SERVER_SPECIFIERS:
                    self.fail(f"answered with command {answer[0]:02X}h", ABORT_COMMAND)
            self.skip(answer)
            answer = yield ()

    def segment(self, *frames: bytes, after: bytes = b"") -> Transfer[bytes]:
        """Send, and return the next answer; one of another transfer is skipped. Raises AbortError.

        after: the answer before this one. Where two in a row can never be equal (because of the toggle bit) an equal one is a
        frame that CAN delivered twice (ISO 11898-1 allows it after an error in the last bit), and is skipped.
        """
        answer = yield frames
        while len(answer) != 8 or answer == after or (answer[0] == ABORT and not self.is_abort(answer)):
            self.skip(answer)
            answer = yield ()
        self.raise_abort(answer)
        return answer

    def most_to_come(self, answer: bytes, sized: int, most: int) -> tuple[int | None, int]:
        """(announced size or None, bytes that may come) of an upload by its first answer; `sized`: the bit that announces a size."""
        if not answer[0] & sized:
            return None, min(most, LARGEST_UNANNOUNCED)
        size: int = struct.unpack_from("<I", answer, 4)[0]
        if size > most:
            self.fail(f"{size} bytes are announced, {most} are read at most", ABORT_MEMORY)
        return size, size

    def too_many(self, size: int | None, most: int) -> NoReturn:
        """End the transfer: more than `most` bytes have come. Raises ProtocolError."""
        what = f"{size} were announced" if size is not None else f"no size was announced and {most} are read at most"
        self.fail(f"more than {most} bytes came, {what}", ABORT_LENGTH)

    def fail(self, what: str, code: int) -> NoReturn:
        """Set an abort for the server and raise ProtocolError."""
        self.closing_frames = (abort_frame(self.index, self.subindex, code),)
        raise ProtocolError(f"SDO {self.place()}: {what}")


def _expedited_data(answer: bytes) -> bytes:
    if answer[0] & 0x01:
        return answer[4 : 8 - (answer[0] >> 2 & 0x03)]
    return answer[4:8]  # no size indicated: all four bytes, the reader's type cuts them


def upload(talk: Conversation, most: int = LARGEST_ANNOUNCED) -> Transfer[bytes]:
    """Read an object of at most `most` bytes, expedited or segmented as the server chooses. Raises AbortError, ProtocolError."""
    answer = yield from talk.initiate(bytes((0x40,)) + talk.mux + bytes(4), answers=(UPLOAD,))
    return (yield from _rest_of_upload(talk, answer, most))


def _rest_of_upload(talk: Conversation, answer: bytes, most: int) -> Transfer[bytes]:
    """An upload from the server's first answer on."""
    if answer[0] & 0x02:
        return _expedited_data(answer)
    size, most = talk.most_to_come(answer, 0x01, most)
    data = bytearray()
    toggle = 0
    while True:
        answer = yield from talk.segment(bytes((0x60 | toggle, 0, 0, 0, 0, 0, 0, 0)), after=answer)
        if answer[0] & 0xE0:
            talk.fail(f"segment answered with command {answer[0]:02X}h", ABORT_COMMAND)
        if answer[0] & 0x10 != toggle:
            talk.fail("toggle bit not alternated", ABORT_TOGGLE)
        part = answer[1 : 8 - (answer[0] >> 1 & 0x07)]
        data += part
        toggle ^= 0x10
        if len(data) > most:
            talk.too_many(size, most)
        if answer[0] & 0x01:
            break
        if not part:
            talk.fail("a segment without data that is not the last", ABORT_LENGTH)
        talk.moved(len(part))
    if size is not None and size != len(data):
        talk.fail(f"{len(data)} bytes came, {size} were announced", ABORT_LENGTH)
    return bytes(data)


def download(talk: Conversation, data: bytes) -> Transfer[None]:
    """Write an object, expedited up to four bytes, segmented above. Raises AbortError, ProtocolError."""
    if 0 < len(data) <= 4:
        command = 0x23 | (4 - len(data)) << 2
        yield from talk.initiate(bytes((command,)) + talk.mux + data.ljust(4, b"\0"), answers=(DOWNLOAD,))
        return
    answer = yield from talk.initiate(bytes((0x21,)) + talk.mux + struct.pack("<I", len(data)), answers=(DOWNLOAD,))
    toggle = 0
    for start in range(0, max(len(data), 1), SEGMENT):
        part = data[start : start + SEGMENT]
        last = start + SEGMENT >= len(data)
        command = toggle | (SEGMENT - len(part)) << 1 | last
        answer = yield from talk.segment(bytes((command,)) + part.ljust(SEGMENT, b"\0"), after=answer)
        if answer[0] & 0xEF != 0x20:
            talk.fail(f"segment answered with command {answer[0]:02X}h", ABORT_COMMAND)
        if answer[0] & 0x10 != toggle:
            talk.fail("toggle bit not alternated", ABORT_TOGGLE)
        toggle ^= 0x10
        talk.moved(len(part))


def block_upload(talk: Conversation, most: int = LARGEST_ANNOUNCED) -> Transfer[bytes]:
    """Read an object of at most `most` bytes by blocks of up to `MAX_BLOCK` segments of seven bytes, with CRC where the server has
    it.

    Segments lost within a block are requested again by acknowledging the last one in sequence. Raises AbortError,
    ProtocolError.
    """
    threshold = 0  # no change to segmented transfer is offered; a server that changes nevertheless is followed
    request = bytes((0xA4,)) + talk.mux + bytes((MAX_BLOCK, threshold, 0, 0))
    answer = yield from talk.initiate(request, answers=(BLOCK_UPLOAD, UPLOAD))
    if answer[0] & 0xE0 == UPLOAD:
        return (yield from _rest_of_upload(talk, answer, most))
    with_crc = bool(answer[0] & 0x04)
    size, most = talk.most_to_come(answer, 0x02, most)
    data = bytearray()
    frames: Frames = (bytes((0xA3, 0, 0, 0, 0, 0, 0, 0)),)
    finished = False
    in_vain = 0
    while not finished:
        room = SEGMENT * segments_of(most) - len(data)
        came, answer, finished = yield from _block(talk, frames, answer, room)
        data += came
        if len(came) > room:
            talk.too_many(size, most)
        in_vain = 0 if came else in_vain + 1
        if in_vain > MORE_BLOCKS:
            talk.fail(f"no segment in its place in {in_vain} blocks", ABORT_SEQUENCE)
        frames = (bytes((0xA2, len(came) // SEGMENT, MAX_BLOCK, 0, 0, 0, 0, 0)),)
    answer = yield from talk.segment(*frames, after=answer)
    if answer[0] & 0xE3 != 0xC1:
        talk.fail(f"end of block upload is command {answer[0]:02X}h", ABORT_COMMAND)
    unused = answer[0] >> 2 & 0x07
    if unused:
        del data[-unused:]
    if len(data) > most:
        talk.too_many(size, most)
    if with_crc and struct.unpack_from("<H", answer, 1)[0] != crc16(bytes(data)):
        talk.fail("CRC of the block does not match", ABORT_CRC)
    if size is not None and size != len(data):
        talk.fail(f"{len(data)} bytes came, {size} were announced", ABORT_LENGTH)
    talk.closing_frames = (bytes((0xA1, 0, 0, 0, 0, 0, 0, 0)),)
    return bytes(data)


def _block(talk: Conversation, ask: Frames, before: bytes, room: int) -> Transfer[tuple[bytes, bytes, bool]]:
    """Request a block: (its segments up to the first that is missing, the frame that ended it, whether the object's last is there).

    before: the server's frame before. It comes first where it was delivered twice, and would look like a block that lost all others.
    room: largest number of bytes of the block.
    """
    data = bytearray()
    expected, finished = 1, False
    while True:
        answer = yield ask
        ask = ()
        sequence = answer[0] & 0x7F if len(answer) == 8 else 0
        talk.raise_abort(answer)
        if sequence == 0 or (answer == before and expected == 1):  # sequence numbers begin at 1
            talk.skip(answer)
            continue
        before = answer
        if sequence == expected:
            data += answer[1:]
            expected += 1
            finished = bool(answer[0] & 0x80)
            talk.moved(SEGMENT)
        if finished or sequence >= MAX_BLOCK or answer[0] & 0x80 or len(data) > room:
            return bytes(data), answer, finished


def block_download(talk: Conversation, data: bytes) -> Transfer[None]:
    """Write an object by block transfer, with CRC when the server supports it. Raises AbortError, ProtocolError."""
    request = bytes((0xC6,)) + talk.mux + struct.pack("<I", len(data))
    answer = yield from talk.initiate(request, answers=(BLOCK_DOWNLOAD,))
    with_crc = bool(answer[0] & 0x04)
    block_size = answer[4]
    segments = [data[start : start + SEGMENT] for start in range(0, len(data), SEGMENT)] or [b""]
    done = in_vain = 0
    while done < len(segments):
        if not 1 <= block_size <= MAX_BLOCK:
            talk.fail(f"block size {block_size}", 0x05040002)
        block = segments[done : done + block_size]
        frames = []
        for number, part in enumerate(block, start=1):
            last = done + number == len(segments)
            frames.append(bytes((number | (0x80 if last else 0),)) + part.ljust(SEGMENT, b"\0"))
        answer = yield from talk.segment(*frames)
        if answer[0] & 0xE3 != 0xA2:
            talk.fail(f"block answered with command {answer[0]:02X}h", ABORT_COMMAND)
        if answer[1] > len(block):
            talk.fail(f"{answer[1]} segments acknowledged of {len(block)}", ABORT_SEQUENCE)
        in_vain = 0 if answer[1] else in_vain + 1
        if in_vain > MORE_BLOCKS:
            talk.fail(f"no segment of {in_vain} blocks was acknowledged", ABORT_SEQUENCE)
        if answer[1]:
            talk.moved(SEGMENT * answer[1])
        done += answer[1]
        block_size = answer[2]
    unused = SEGMENT - len(segments[-1])
    crc = crc16(data) if with_crc else 0
    answer = yield from talk.segment(struct.pack("<BH5x", 0xC1 | unused << 2, crc))
    if answer[0] & 0xE3 != 0xA1:
        talk.fail(f"end of block download answered with command {answer[0]:02X}h", ABORT_COMMAND)
