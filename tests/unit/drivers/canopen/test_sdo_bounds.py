"""SDO against servers that misbehave, each in its own way: every transfer ends within its stated bound, with the right error.

In simulated time. The servers and the other masters are those of `support.sdo_peers`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import cycle, repeat

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.can_bench import CanBench
from support.sdo_peers import Answers, Flood, Peer, bare_bus

from drivers.canopen.bus import CanLink
from drivers.canopen.sdo import QUIET_TIMES, Running, SdoClient
from drivers.canopen.sdo_transfer import (
    LARGEST_ANNOUNCED,
    LARGEST_UNANNOUNCED,
    MORE_BLOCKS,
    SEGMENT_S,
    Conversation,
    Transfer,
    block_download,
    block_upload,
    download,
    longest_s,
    upload,
)
from drivers.canopen.side_by_side import CanLine
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.errors import AbortError, BridgeError, NoAnswerError, OtherAnswerError, ProtocolError

NODE, INDEX = 6, 0x2100
MUX = struct.pack("<HB", INDEX, 0)
TIMEOUT_S, QUIET_S = 0.5, 0.2
FAST_S = 0.0005  # an answer on a quiet line at 1 Mbit/s
NAME = Entry(INDEX, 0, DataType.STRING, "name")
OCTETS = Entry(INDEX, 0, DataType.OCTETS, "bytes")


class Desk:
    """A client and the server that it has to do with."""

    def __init__(self, answer: Callable[[bytes], Answers]) -> None:
        self.bench = bare_bus()
        self.link = CanLink(self.bench.port(), self.bench.clock)
        self.peer = Peer(self.bench.wire, NODE, answer)
        self.sdo = SdoClient(self.link, NODE, "drive X", timeout_s=TIMEOUT_S, quiet_s=QUIET_S)

    def seconds(self, work: Callable[[], object]) -> tuple[float, object]:
        """How long it took, and what came of it: the result or the error."""
        start_ns = self.bench.clock.now_ns()
        try:
            came: object = work()
        except BridgeError as error:
            came = error
        return (self.bench.clock.now_ns() - start_ns) * 1e-9, came

    def close(self) -> None:
        self.sdo.close()
        self.link.close()


# -- what goes wrong -----------------------------------------------------------------------------------------------------
def announced(size: int | None) -> bytes:
    return b"\x40" + MUX + bytes(4) if size is None else b"\x41" + MUX + struct.pack("<I", size)


@dataclass
class Uploads:
    """A server of one object: announces `size`, then its segments carry `carry` bytes each, the last one after `total` bytes.

    delay_s: of each segment. total None: no segment is the last.
    """

    size: int | None
    total: int | None
    carry: int = 7
    delay_s: float = FAST_S
    toggles: bool = True
    sent: int = 0

    def __call__(self, request: bytes) -> Answers:
        if request[0] == 0x40:
            self.sent = 0
            return [(FAST_S, announced(self.size))]
        if request[0] & 0xE0 != 0x60:
            return []
        self.sent += self.carry
        last = self.total is not None and self.sent >= self.total
        carried = self.carry - (self.sent - self.total) if last and self.total is not None else self.carry
        toggle = request[0] & 0x10 if self.toggles else 0
        part = bytes((self.sent + place) % 256 for place in range(carried))
        return [(self.delay_s, bytes((toggle | 7 - carried << 1 | last,)) + part.ljust(7, b"\0"))]


def same_segment_for_ever(request: bytes) -> Answers:
    """The first segment is sent again and again."""
    if request[0] == 0x40:
        return [(FAST_S, announced(100))]
    return zip(repeat(0.1), repeat(b"\x00abcdefg"))


def late_segments_of_a_download(request: bytes) -> Answers:
    """Each is confirmed a little before the time-out."""
    if request[0] == 0x21:
        return [(FAST_S, b"\x60" + MUX + bytes(4))]
    return [] if request[0] == 0x80 else [(0.9 * TIMEOUT_S, bytes((0x20 | request[0] & 0x10,)) + bytes(7))]


def wrongly_toggled_download(request: bytes) -> Answers:
    if request[0] == 0x21:
        return [(FAST_S, b"\x60" + MUX + bytes(4))]
    return [(FAST_S, bytes((0x20 | ~request[0] & 0x10,)) + bytes(7))]


@dataclass
class Blocks:
    """A server of block uploads: announces `size`, then sends sequence numbers in turn, one each `delay_s`, for ever."""

    size: int | None
    numbers: tuple[int, ...]
    delay_s: float = FAST_S

    def __call__(self, request: bytes) -> Answers:
        if request[0] == 0xA4:
            size = self.size
            return [(FAST_S, (b"\xc0" if size is None else b"\xc2") + MUX + struct.pack("<I", size or 0))]
        if request[0] == 0xA3:
            return (
                (self.delay_s, bytes((number,)) + bytes((count % 251,)) * 7)
                for count, number in enumerate(cycle(self.numbers))
            )
        return []


@dataclass
class Acknowledges:
    """A server of block downloads with blocks of ten; of each it acknowledges `taken` segments, `delay_s` behind its last one."""

    taken: int
    delay_s: float = FAST_S
    heard: int = 0

    def __call__(self, request: bytes) -> Answers:
        if request[0] == 0xC6:
            self.heard = 0
            return [(FAST_S, b"\xa4" + MUX + bytes((10, 0, 0, 0)))]
        if request[0] & 0x7F and request[0] != 0x80:
            self.heard += 1
        if request[0] & 0x7F != 10:
            return []
        return [(self.delay_s, bytes((0xA2, self.taken, 10, 0, 0, 0, 0, 0)))]


ALL_IN_PLACE = tuple(range(1, 128))
DATA = bytes(range(250)) * 4  # to write
READ, BLOCK_READ = "read", "block read"
WRITE, BLOCK_WRITE = "write", "block write"


@dataclass(frozen=True)
class Case:
    """One fault. bytes: the size that bounds the transfer's time; frames: requests sent at most, None: not counted."""

    how: str
    server: Callable[[], Callable[[bytes], Answers]]
    error: type[BridgeError]
    words: str
    bytes: int
    within_s: float | None = None


CASES = {
    "each segment just before the time-out": Case(
        READ, lambda: Uploads(700, 700, delay_s=0.9 * TIMEOUT_S), NoAnswerError, "14 bytes in 1.15", 700
    ),
    "one byte a segment, slowly": Case(
        READ, lambda: Uploads(700, 700, carry=1, delay_s=0.04), NoAnswerError, "not answered in time: ", 700
    ),
    "endless segments without a size": Case(
        READ, lambda: Uploads(None, None), ProtocolError, "more than 16384 bytes came, no size", LARGEST_UNANNOUNCED
    ),
    "endless segments behind a size": Case(
        READ, lambda: Uploads(100, None), ProtocolError, "more than 100 bytes came, 100 were", 100, 0.02
    ),
    "more than announced": Case(READ, lambda: Uploads(20, 40), ProtocolError, "more than 20 bytes came", 20, 0.01),
    "less than announced": Case(READ, lambda: Uploads(41, 40), ProtocolError, "40 bytes came, 41 were", 41, 0.01),
    "four gigabytes": Case(
        READ, lambda: Uploads(0xFFFFFFFF, None), ProtocolError, "4294967295 bytes are announced", 0, 0.01
    ),
    "empty segments": Case(
        READ, lambda: Uploads(None, None, carry=0), ProtocolError, "without data that is not the last", 0, 0.01
    ),
    "the toggle bit stays": Case(READ, lambda: Uploads(70, 70, toggles=False), ProtocolError, "toggle", 70, 0.01),
    "one segment again and again": Case(
        READ, lambda: same_segment_for_ever, NoAnswerError, "not answered in time: 7 bytes in 0.", 100, 0.71
    ),
    "silence behind the size": Case(
        READ,
        lambda: lambda request: [(FAST_S, announced(70))] if request[0] == 0x40 else [],
        NoAnswerError,
        ": 0 bytes",
        0,
    ),
    "downloads confirmed just before the time-out": Case(
        WRITE, lambda: late_segments_of_a_download, NoAnswerError, "not answered in time: 14 bytes", len(DATA)
    ),
    "downloads toggled wrongly": Case(
        WRITE, lambda: wrongly_toggled_download, ProtocolError, "toggle", len(DATA), 0.01
    ),
    "no segment of a block acknowledged": Case(
        BLOCK_WRITE, lambda: Acknowledges(0), ProtocolError, "no segment of 4 blocks was acknowledged", len(DATA), 0.01
    ),
    "one segment of each block, slowly": Case(
        BLOCK_WRITE,
        lambda: Acknowledges(1, 0.9 * TIMEOUT_S),
        NoAnswerError,
        "not answered in time: 14 bytes",
        len(DATA),
    ),
    "blocks in wrong order": Case(
        BLOCK_READ, lambda: Blocks(700, (5, 127)), ProtocolError, "no segment in its place in 4 blocks", 700, 0.01
    ),
    "one segment of a block again and again": Case(
        BLOCK_READ, lambda: Blocks(700, (1,), 0.1), NoAnswerError, "not answered in time: 7 bytes", 700, 0.71
    ),
    "blocks longer than announced": Case(
        BLOCK_READ, lambda: Blocks(700, ALL_IN_PLACE), ProtocolError, "more than 700 bytes came", 700
    ),
    "endless blocks": Case(
        BLOCK_READ,
        lambda: Blocks(None, ALL_IN_PLACE),
        ProtocolError,
        "more than 16384 bytes came",
        LARGEST_UNANNOUNCED,
    ),
    "block segments just before the time-out": Case(
        BLOCK_READ,
        lambda: Blocks(700, ALL_IN_PLACE, 0.9 * TIMEOUT_S),
        NoAnswerError,
        "not answered in time: 14 bytes",
        700,
    ),
    "a block of four gigabytes": Case(
        BLOCK_READ, lambda: Blocks(0xFFFFFFFF, ALL_IN_PLACE), ProtocolError, "4294967295 bytes are announced", 0, 0.01
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_each_fault_ends_within_its_bound_with_its_error(name: str) -> None:
    case = CASES[name]
    desk = Desk(case.server())
    talk = Conversation(INDEX, 0)
    transfers: dict[str, Callable[[], Transfer[object]]] = {
        READ: lambda: upload(talk),
        BLOCK_READ: lambda: block_upload(talk),
        WRITE: lambda: download(talk, DATA),
        BLOCK_WRITE: lambda: block_download(talk, DATA),
    }
    running = Running(desk.sdo, talk, transfers[case.how]())

    def alone() -> object:
        CanLine(desk.link).run([iter_of(running)])
        return running.outcome()

    took_s, came = desk.seconds(alone)
    assert isinstance(came, case.error)
    assert case.words in str(came)
    assert took_s <= longest_s(TIMEOUT_S, case.bytes) + 1e-6
    assert took_s <= (case.within_s or took_s)
    assert desk.peer.requests[-1][0] == 0x80  # the server is told
    desk.close()


def iter_of(running: Running[object]) -> Iterator[object]:
    yield running


@pytest.mark.parametrize("name", [name for name in CASES if CASES[name].how in (READ, BLOCK_READ)])
def test_a_read_is_asked_once_more_and_no_further(name: str) -> None:
    case = CASES[name]
    desk = Desk(case.server())
    took_s, came = desk.seconds(lambda: desk.sdo.read_bytes(INDEX, 0, block=case.how == BLOCK_READ))
    assert isinstance(came, (case.error, ProtocolError))
    quiet_s = (QUIET_TIMES + 2) * QUIET_S
    assert took_s <= 2 * longest_s(TIMEOUT_S, case.bytes) + quiet_s
    asked = [request for request in desk.peer.requests if request[0] in (0x40, 0xA4)]
    assert len(asked) <= 2
    desk.close()


@pytest.mark.parametrize("name", [name for name in CASES if CASES[name].how in (WRITE, BLOCK_WRITE)])
def test_a_write_is_never_begun_twice(name: str) -> None:
    case = CASES[name]
    desk = Desk(case.server())
    took_s, came = desk.seconds(lambda: desk.sdo.write_bytes(INDEX, 0, DATA, block=case.how == BLOCK_WRITE))
    assert isinstance(came, case.error)
    assert took_s <= 2 * longest_s(TIMEOUT_S, case.bytes) + (QUIET_TIMES + 2) * QUIET_S
    assert sum(request[0] in (0x21, 0xC6) for request in desk.peer.requests[:1]) == 1
    assert not any(request[:4] in (b"\x21" + MUX, b"\xc6" + MUX) for request in desk.peer.requests[1:])
    desk.close()


def test_a_block_that_arrives_nowhere_is_sent_a_few_times() -> None:
    server = Acknowledges(0)
    desk = Desk(server)
    with pytest.raises(ProtocolError):
        desk.sdo.write_bytes(INDEX, 0, DATA, block=True)
    assert server.heard == 10 * (1 + MORE_BLOCKS)
    desk.close()


def test_short_segments_that_come_fast_are_read() -> None:
    """CiA-301 lets a segment be shorter than seven bytes."""
    desk = Desk(Uploads(20, 20, carry=3))
    assert desk.sdo.read_bytes(INDEX, 0) == bytes(range(3, 23))
    desk.close()


def test_a_number_is_not_read_on_for_ever() -> None:
    desk = Desk(Uploads(None, None))
    took_s, came = desk.seconds(lambda: desk.sdo.read(Entry(INDEX, 0, DataType.U32, "number")))
    assert isinstance(came, ProtocolError)
    assert "more than 8 bytes" in str(came)
    assert took_s < 0.01
    desk.close()


def test_the_largest_object_that_is_announced_takes_a_time_that_is_stated() -> None:
    assert longest_s(TIMEOUT_S, 0) == pytest.approx(2 * TIMEOUT_S + 2 * SEGMENT_S)
    assert longest_s(TIMEOUT_S, 70) == pytest.approx(2 * TIMEOUT_S + 11 * SEGMENT_S)
    assert longest_s(TIMEOUT_S, LARGEST_ANNOUNCED) < 2.1 * 3600


# -- other traffic on the channel ----------------------------------------------------------------------------------------
STATUSWORD_SHOWN = b"\x4b\x41\x60\x00\x37\x02\x00\x00"


@pytest.mark.parametrize("period_s", [0.4, 0.05, 0.001])
def test_another_tools_answers_do_not_extend_a_wait(period_s: float) -> None:
    """One answer is lost while another tool reads the same node: two time-outs and the quiet time, as on a quiet channel."""
    desk = Desk(lambda _request: [])
    Flood(desk.bench.wire, [(0x580 + NODE, STATUSWORD_SHOWN)], period_s)
    took_s, came = desk.seconds(lambda: desk.sdo.read(objects.POSITION_ACTUAL))
    assert isinstance(came, NoAnswerError)
    assert took_s == pytest.approx(2 * TIMEOUT_S + QUIET_S, abs=0.002)
    desk.close()


def test_another_tools_answers_do_not_extend_the_waits_of_nodes_side_by_side() -> None:
    desk = Desk(lambda _request: [])
    others = [SdoClient(desk.link, node, f"node {node}", timeout_s=TIMEOUT_S) for node in (7, 8)]
    frames = [(0x580 + node, STATUSWORD_SHOWN) for node in (NODE, 7, 8)]
    Flood(desk.bench.wire, frames, 0.01)
    entry = objects.POSITION_ACTUAL
    jobs = [client.reading(entry.index, entry.subindex) for client in (desk.sdo, *others)]
    took_s, came = desk.seconds(lambda: CanLine(desk.link).run(jobs))
    assert isinstance(came, list)
    for each in came:
        assert isinstance(each, OtherAnswerError)
        assert "was answered for 6041h:00: another master on its SDO channel" in str(each)
    assert took_s == pytest.approx(2 * TIMEOUT_S + QUIET_S, abs=0.02)
    desk.close()


def test_a_channel_that_never_falls_silent_is_told_in_a_bounded_time() -> None:
    """Another master writes the very object whose write was not answered: its confirmations could be ours, and are not believed."""
    desk = Desk(lambda _request: [])
    Flood(desk.bench.wire, [(0x580 + NODE, b"\x60" + MUX + bytes(4))], 0.03, start_s=TIMEOUT_S + 0.01)
    bound_s = (QUIET_TIMES + 2) * QUIET_S
    took_s, came = desk.seconds(lambda: desk.sdo.write_bytes(INDEX, 0, b"1234"))
    assert isinstance(came, NoAnswerError)
    assert "whether it was written is unknown (drive X: the SDO channel does not fall silent)" in str(came)
    assert took_s <= TIMEOUT_S + bound_s
    took_s, came = desk.seconds(lambda: desk.sdo.write_bytes(INDEX, 0, b"5678"))
    assert isinstance(came, ProtocolError)
    assert took_s <= bound_s
    assert sum(request[0] & 0xE0 == 0x20 for request in desk.peer.requests) == 1
    desk.close()


def test_a_channel_is_quiet_whatever_another_tool_reads_there() -> None:
    """Answers that cannot belong to the lost write, of the same object too, do not keep the channel from being used."""
    desk = Desk(Holds(b"1234"))
    Flood(desk.bench.wire, [(0x580 + NODE, b"\x43" + MUX + b"1234"), (0x580 + NODE, STATUSWORD_SHOWN)], 0.01)
    took_s, came = desk.seconds(lambda: desk.sdo.write_bytes(INDEX, 0, b"1234"))
    assert came is None
    assert took_s == pytest.approx(TIMEOUT_S + QUIET_S, abs=0.02)
    desk.close()


def test_a_bus_full_of_anything_does_not_extend_a_wait() -> None:
    bench = bare_bus(125_000)
    link = CanLink(bench.port(), bench.clock)
    flood = Flood(bench.wire, [(0x080 + NODE, bytes(8)), (0x181, bytes(8)), (0x700 + NODE, b"\x05")], 0.0002)
    start_ns = bench.clock.now_ns()
    with pytest.raises(NoAnswerError):
        SdoClient(link, NODE, "drive X", timeout_s=TIMEOUT_S, quiet_s=QUIET_S).read(objects.POSITION_ACTUAL)
    assert (bench.clock.now_ns() - start_ns) * 1e-9 == pytest.approx(1.2, abs=0.01)
    assert flood.sent > 1000
    link.close()


# -- writes whose answer was lost ----------------------------------------------------------------------------------------
@dataclass
class Holds:
    """A server that loses every write, and shows what it holds."""

    shown: bytes

    def __call__(self, request: bytes) -> Answers:
        if request[0] == 0x40:
            if 0 < len(self.shown) <= 4:
                command = 0x43 | 4 - len(self.shown) << 2
                return [(FAST_S, bytes((command,)) + MUX + self.shown.ljust(4, b"\0"))]
            self._left = self.shown
            return [(FAST_S, announced(len(self.shown)))]
        if request[0] & 0xE0 == 0x60:
            part, self._left = self._left[:7], self._left[7:]
            head = request[0] & 0x10 | 7 - len(part) << 1 | (not self._left)
            return [(FAST_S, bytes((head,)) + part.ljust(7, b"\0"))]
        return []


U16 = Entry(INDEX, 0, DataType.U16, "number")
SHOWN_WRITTEN: list[tuple[Entry, bytes, bytes, bool]] = [
    (NAME, b"AXIS-12 left", b"AXIS-1", False),  # what was there before begins like it
    (NAME, b"AXIS-1", b"AXIS-1", True),
    (NAME, b"AXIS-1\0\0\0\0\0\0", b"AXIS-1", True),  # a text of a fixed length
    (NAME, b"AXIS-1          ", b"AXIS-1", True),
    (NAME, b"AXIS-1\0old rest", b"AXIS-1", False),
    (NAME, b"AXIS-1", b"AXIS-1\0", True),
    (NAME, b"AXIS-", b"AXIS-1", False),
    (NAME, b"AB12", b"AB", False),
    (NAME, b"AB", b"AB", True),
    (OCTETS, b"\1\2\3\4\5\6\0\0", b"\1\2\3\4\5\6", False),
    (OCTETS, b"\1\2\3\4\5\6", b"\1\2\3\4\5\6", True),
    (OCTETS, b"\1\2\0\0", b"\1\2", False),
    (U16, b"\x03\x09", b"\x03\x09", True),
    (U16, b"\x03\x09\0\0", b"\x03\x09", True),  # a device that answers with four bytes for every number
    (U16, b"\x03", b"\x03\x09", False),
]


@pytest.mark.parametrize("side_by_side", [False, True])
@pytest.mark.parametrize(("entry", "shown", "written", "held"), SHOWN_WRITTEN)
def test_a_lost_write_is_done_when_the_whole_value_is_shown(
    entry: Entry, shown: bytes, written: bytes, held: bool, side_by_side: bool
) -> None:
    desk = Desk(Holds(shown))

    def work() -> object:
        if not side_by_side:
            return desk.sdo.write_bytes(INDEX, 0, written, same=entry.same)
        return CanLine(desk.link).run([desk.sdo.writing(INDEX, 0, written, same=entry.same)])[0]

    _, came = desk.seconds(work)
    if held:
        assert came is None
        assert desk.sdo.counters.writes_read_back == 1
    else:
        assert isinstance(came, NoAnswerError)
        assert f"it reads back {shown.hex()}, not {written.hex()}: not written" in str(came)
    assert sum(request[0] & 0xE0 == 0x20 for request in desk.peer.requests) == 1
    desk.close()


def test_bytes_of_no_stated_type_have_to_be_the_same() -> None:
    desk = Desk(Holds(b"AXIS-1\0\0"))
    _, came = desk.seconds(lambda: desk.sdo.write_bytes(INDEX, 0, b"AXIS-1"))
    assert isinstance(came, NoAnswerError)
    desk.close()


def test_an_empty_value_is_not_confirmed_by_the_first_of_its_two_answers() -> None:
    """An empty text goes in segments: the late answer to its announcement says nothing of the write."""

    def late(request: bytes) -> Answers:
        if request[0] == 0x21:
            return [(TIMEOUT_S + 0.1, b"\x60" + MUX + bytes(4))]
        return Holds(b"before")(request) if request[0] == 0x40 else []

    holds = Holds(b"before")
    desk = Desk(lambda request: late(request) if request[0] == 0x21 else holds(request))
    _, came = desk.seconds(lambda: desk.sdo.write_bytes(INDEX, 0, b""))
    assert isinstance(came, NoAnswerError)
    assert desk.sdo.counters.writes_confirmed_late == 0
    desk.close()


@pytest.mark.parametrize("side_by_side", [False, True])
def test_a_lost_write_that_cannot_be_read_back_is_unknown_whatever_comes(side_by_side: bool) -> None:
    desk = Desk(lambda request: [(FAST_S, b"\xe0" + MUX + bytes(4))] if request[0] == 0x40 else [])

    def work() -> object:
        if not side_by_side:
            return desk.sdo.write_bytes(INDEX, 0, b"1234")
        return CanLine(desk.link).run([desk.sdo.writing(INDEX, 0, b"1234")])[0]

    _, came = desk.seconds(work)
    assert isinstance(came, NoAnswerError)
    assert "whether it was written is unknown" in str(came)
    desk.close()


# -- anything at all -----------------------------------------------------------------------------------------------------
COMMANDS = st.sampled_from(bytes.fromhex("00 10 01 11 0E 1E 20 30 41 40 43 42 60 80 A0 A1 A2 A4 C0 C1 C2 C6"))
TAILS = st.one_of(
    st.binary(min_size=7, max_size=7),
    st.builds(
        lambda tail: MUX + tail,
        st.one_of(st.binary(min_size=4, max_size=4), st.sampled_from([bytes(4), b"\x0e\0\0\0"])),
    ),
    st.sampled_from([b"abcdefg", bytes(7), b"\x01\x0a\0\0\0\0\0", b"\0\x0a\0\0\0\0\0"]),
)
FRAMES = st.one_of(
    st.binary(max_size=8),
    st.builds(lambda head, tail: bytes((head,)) + tail, COMMANDS, TAILS),
    st.builds(lambda head, tail: bytes((head,)) + tail, st.integers(1, 255), TAILS),
)
MOST = 60
WRITTEN = b"0123456789abcdefghij"
KINDS: dict[str, Callable[[Conversation], Transfer[object]]] = {
    "upload": lambda talk: upload(talk, MOST),
    "block upload": lambda talk: block_upload(talk, most=MOST),
    "download": lambda talk: download(talk, WRITTEN),
    "expedited download": lambda talk: download(talk, WRITTEN[:4]),
    "block download": lambda talk: block_download(talk, WRITTEN),
}
A_BLOCK = [b"\xc6" + MUX + b"\x0e\0\0\0", b"\x01abcdefg", b"\x82hijklmn", b"\xc1\0\0\0\0\0\0\0"]


def reference_crc(data: bytes) -> int:
    """CCITT by shifting single bits."""
    register = 0
    for byte in data:
        for place in range(7, -1, -1):
            top = register >> 15 & 1
            register = register << 1 & 0xFFFF
            if top ^ (byte >> place & 1):
                register ^= 0x1021
    return register


def check_what_was_read(data: bytes, heard: list[bytes], commands: tuple[int, ...]) -> None:
    """Nothing else is returned than what the server's frames bear out; told from the frames alone, apart from the client's code."""
    starts = [frame for frame in heard if len(frame) == 8 and frame[1:4] == MUX and frame[0] >> 5 in commands]
    start, last = starts[0], heard[-1]
    if start[0] >> 5 == 2 and start[0] & 2:
        assert start[4:].startswith(data)
        assert data
        return
    sized = start[0] & (1 if start[0] >> 5 == 2 else 2)
    assert len(data) <= MOST
    if sized:
        assert len(data) == int.from_bytes(start[4:], "little")
    if start[0] >> 5 == 6:
        assert last[0] & 0xE3 == 0xC1
        if start[0] & 4:
            assert int.from_bytes(last[1:3], "little") == reference_crc(data)
    else:
        assert last[0] & 1


@settings(max_examples=100)
@given(kind=st.sampled_from(sorted(KINDS)), frames=st.lists(FRAMES, max_size=40))
@example(kind="block upload", frames=A_BLOCK)
@example(kind="block upload", frames=[b"\xc2" + MUX + b"\x14\0\0\0", *A_BLOCK[1:]])  # 20 bytes announced, 14 come
@example(
    kind="block upload",
    frames=[*A_BLOCK[:3], b"\xc1" + reference_crc(b"abcdefghijklmn").to_bytes(2, "little") + bytes(5)],
)
@example(kind="upload", frames=[b"\x41" + MUX + b"\x0e\0\0\0", b"\0abcdefg", b"\x11hijklmn"])
def test_no_frames_make_a_transfer_return_what_was_not_announced(kind: str, frames: list[bytes]) -> None:
    talk = Conversation(INDEX, 0)
    transfer = KINDS[kind](talk)
    next(transfer)
    heard: list[bytes] = []
    try:
        for frame in frames:
            heard.append(frame)
            assert len(transfer.send(frame)) <= 127
    except StopIteration as stop:
        if stop.value is not None:
            check_what_was_read(stop.value, heard, (2, 6) if kind == "block upload" else (2,))
    except (AbortError, ProtocolError):
        pass
    assert talk.carried <= MOST + 10  # whole segments, and the one that was too many


@settings(max_examples=60)
@given(
    kind=st.sampled_from(sorted(KINDS)),
    answers=st.lists(st.tuples(st.integers(1, 600), FRAMES), min_size=1, max_size=8),
    for_ever=st.booleans(),
)
def test_whatever_a_server_sends_and_when_a_transfer_ends_within_its_bound(
    kind: str, answers: list[tuple[int, bytes]], for_ever: bool
) -> None:
    """The frames come in turn for ever, or one to each request; in ms."""
    timed = [(1e-3 * ms, frame) for ms, frame in answers]
    in_turn = cycle(timed)
    desk = Desk((lambda _request: cycle(timed)) if for_ever else (lambda _request: [next(in_turn)]))
    talk = Conversation(INDEX, 0)
    running = Running(desk.sdo, talk, KINDS[kind](talk))
    took_s, came = desk.seconds(lambda: CanLine(desk.link).run([iter_of(running)]))
    assert running.finished
    assert came == [None]
    assert took_s <= longest_s(TIMEOUT_S, MOST + 7) + 1e-6
    assert took_s <= longest_s(TIMEOUT_S, talk.carried) + 1e-6
    desk.close()


def test_a_client_of_a_sound_drive_is_not_disturbed_by_any_of_this() -> None:
    """The control: the same client, a sound server, and the traffic of another tool."""
    bench = CanBench((NODE,))
    link = CanLink(bench.port(), bench.clock)
    Flood(bench.wire, [(0x580 + NODE, STATUSWORD_SHOWN), (0x080 + NODE, bytes(8))], 0.0003)
    sdo = SdoClient(link, NODE, "drive X")
    for block in (False, True):
        sdo.write(objects.HOME_OFFSET, 5 + block)
        assert sdo.read(objects.HOME_OFFSET) == 5 + block
    assert sdo.counters.timeouts == 0
    link.close()
