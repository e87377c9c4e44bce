"""The guarded SDO client against the simulated drive, in simulated time: late, lost, foreign and refused answers."""

import sys
import threading
from collections.abc import Callable, Iterator
from typing import Self

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.can_bench import CanBench

from drivers.canopen import cia301
from drivers.canopen.bus import CanLink
from drivers.canopen.sdo import Running, SdoClient
from drivers.canopen.sdo_transfer import Conversation, upload
from drivers.canopen.side_by_side import CanLine
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.clock import WallClock
from drivers.errors import AbortError, InputError, NoAnswerError, ProtocolError, StateError
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind

NODE = 5
BUFFER = 0x2100
GAIN = Entry(0x2210, 1, DataType.U32, "proportional gain")


class Desk:
    """A bench with one client."""

    def __init__(self, *faults: CanFault, bitrate: int | None = None) -> None:
        self.bench = CanBench((NODE,), bitrate, {NODE: faults})
        self.link = CanLink(self.bench.port(), self.bench.clock)
        self.sdo = SdoClient(self.link, NODE, "drive X")

    def stored(self, entry: Entry) -> int:
        return self.bench.slave.dictionary.number(entry.index, entry.subindex)

    def close(self) -> None:
        self.sdo.close()
        self.link.close()


@pytest.fixture
def desk() -> Iterator[Desk]:
    desk = Desk()
    yield desk
    desk.close()


def _desk(*faults: CanFault) -> Desk:
    return Desk(*faults)


def test_numbers_and_texts(desk: Desk) -> None:
    assert desk.sdo.read(cia301.DEVICE_TYPE) == 0x20192
    assert desk.sdo.read_bytes(0x1008, 0) == b"Simulated feed axis servo drive"
    desk.sdo.write(objects.HOME_OFFSET, -123_456)
    assert desk.sdo.read(objects.HOME_OFFSET) == -123_456


def test_a_value_that_does_not_fit_is_refused_before_it_is_sent(desk: Desk) -> None:
    with pytest.raises(InputError, match="605Ah:00 quick stop option code: 40000 does not fit I16"):
        desk.sdo.write(objects.QUICK_STOP_OPTION, 40_000)
    assert desk.sdo.counters.transfers == 0


def test_a_refusal_names_drive_object_and_reason(desk: Desk) -> None:
    with pytest.raises(AbortError, match=r"drive X: 605Ah:00 refused: value too high \(0x06090031\)"):
        desk.sdo.write(objects.QUICK_STOP_OPTION, 9)
    assert desk.stored(objects.QUICK_STOP_OPTION) == 2


@settings(max_examples=40)
@given(data=st.binary(max_size=1200), block=st.booleans(), bitrate=st.sampled_from([None, 1_000_000]))
def test_any_length_comes_back_as_it_was_written(data: bytes, block: bool, bitrate: int | None) -> None:
    desk = Desk(bitrate=bitrate)
    desk.sdo.write_bytes(BUFFER, 0, data, block=block)
    assert desk.bench.slave.dictionary.raw((BUFFER, 0)) == data
    assert desk.sdo.read_bytes(BUFFER, 0, block=block) == data
    assert desk.sdo.read_bytes(BUFFER, 0, block=not block) == data
    desk.close()


# -- time-outs -----------------------------------------------------------------------------------------------------------


def test_a_node_that_is_not_there_costs_the_time_out_and_no_more() -> None:
    desk = _desk(CanFault(CanFaultKind.NODE_DEAD))
    with pytest.raises(NoAnswerError, match="drive X: SDO 1000h:00 was not answered in time"):
        desk.sdo.read(cia301.DEVICE_TYPE)
    assert desk.bench.clock.now_ns() == pytest.approx(1.2e9, abs=1e6)  # two time-outs and the quiet time between
    desk.close()


def test_a_lost_answer_to_a_read_is_asked_again() -> None:
    desk = _desk(CanFault(CanFaultKind.SDO_LOST, count=1))
    assert desk.sdo.read(cia301.DEVICE_TYPE) == 0x20192
    assert desk.sdo.counters.timeouts == 1
    desk.close()


def test_a_write_whose_answer_was_lost_is_resolved_by_reading_back() -> None:
    desk = _desk(CanFault(CanFaultKind.SDO_LOST, count=1))
    desk.sdo.write(GAIN, 777)
    assert desk.stored(GAIN) == 777
    assert desk.sdo.counters.writes_read_back == 1
    desk.close()


def test_the_reading_back_of_a_lost_write_is_asked_again() -> None:
    desk = _desk(CanFault(CanFaultKind.SDO_LOST, count=2))
    desk.sdo.write(GAIN, 777)
    assert desk.stored(GAIN) == 777
    assert (desk.sdo.counters.timeouts, desk.sdo.counters.writes_read_back) == (2, 1)
    desk.close()


def test_a_write_whose_request_was_lost_is_reported_not_repeated() -> None:
    desk = _desk(CanFault(CanFaultKind.SDO_REQUEST_LOST, count=1))
    with pytest.raises(NoAnswerError, match="it reads back e8030000, not 09030000: not written"):
        desk.sdo.write(GAIN, 777)
    assert desk.stored(GAIN) == 1000
    desk.close()


def test_a_late_confirmation_counts_for_its_own_write() -> None:
    desk = _desk(CanFault(CanFaultKind.SDO_LATE, size=0.6, count=1))
    desk.sdo.write(GAIN, 777)
    assert desk.stored(GAIN) == 777
    assert desk.sdo.counters.writes_confirmed_late == 1
    desk.close()


def test_a_late_refusal_counts_for_its_own_write() -> None:
    desk = _desk(CanFault(CanFaultKind.SDO_LATE, size=0.6, count=1))
    with pytest.raises(AbortError, match="value too high"):
        desk.sdo.write(objects.QUICK_STOP_OPTION, 9)
    desk.close()


@pytest.mark.parametrize("late_s", [0.55, 0.8, 1.1, 1.6])
def test_a_late_answer_never_confirms_the_next_write(late_s: float) -> None:
    """However late the first answer comes, the refused second write is reported as refused."""
    desk = _desk(CanFault(CanFaultKind.SDO_LATE, size=late_s, count=1))
    desk.sdo.write(objects.HOME_OFFSET, 1)  # late, found out by itself or by reading back
    with pytest.raises(AbortError, match="605Ah"):
        desk.sdo.write(objects.QUICK_STOP_OPTION, 9)
    assert desk.stored(objects.QUICK_STOP_OPTION) == 2
    desk.close()


def test_an_answer_with_a_foreign_index_is_ignored() -> None:
    desk = _desk(CanFault(CanFaultKind.SDO_WRONG_INDEX, count=1))
    answered: list[bytes] = []
    desk.link.watch(lambda _time_ns, _cob_id, data: answered.append(data[1:3]))
    assert desk.sdo.read(cia301.DEVICE_TYPE) == 0x20192
    assert len(set(answered)) == 2
    desk.close()


def test_every_answer_twice_does_no_harm() -> None:
    desk = _desk(CanFault(CanFaultKind.DUPLICATES))
    for value in range(20):
        desk.sdo.write(GAIN, value)
        assert desk.sdo.read(GAIN) == value
    desk.close()


@pytest.mark.parametrize("block", [False, True])
def test_a_doubled_segment_is_not_taken_for_two(block: bool) -> None:
    desk = _desk(CanFault(CanFaultKind.DUPLICATES))
    data = bytes(range(250)) * 8
    desk.sdo.write_bytes(BUFFER, 0, data)
    assert desk.sdo.read_bytes(BUFFER, 0, block=block) == data
    desk.close()


def test_doubled_block_acknowledgements_never_leave_wrong_data() -> None:
    """They cannot be told from the next ones: the transfer fails, and the drive keeps what it had."""
    desk = _desk(CanFault(CanFaultKind.DUPLICATES))
    with pytest.raises(ProtocolError):
        desk.sdo.write_bytes(BUFFER, 0, bytes(range(250)) * 8, block=True)
    assert desk.bench.slave.dictionary.raw((BUFFER, 0)) == b""
    desk.close()


# -- servers that answer otherwise ----------------------------------------------------------------------------------------
Change = Callable[[bytes], bytes]


def answering(change: Change, *faults: CanFault) -> Desk:
    """Every answer of the drive is changed by this."""
    desk = Desk(*faults)
    plain = desk.bench.slave.sdo.handle
    desk.bench.slave.sdo.handle = lambda data: [change(bytes(answer)) for answer in plain(data)]  # type: ignore[method-assign]
    return desk


def nameless(answer: bytes) -> bytes:
    return b"\x80\0\0\0" + answer[4:] if answer[0] == 0x80 else answer


@pytest.mark.parametrize(
    ("refused", "code"),
    [
        (lambda sdo: sdo.read(Entry(0x60A9, 0, DataType.U32, "velocity unit")), 0x06020000),
        (lambda sdo: sdo.read_bytes(0x60A9, 0, block=True), 0x06020000),
        (lambda sdo: sdo.write(objects.QUICK_STOP_OPTION, 9), 0x06090031),
        (lambda sdo: sdo.write_bytes(0x1008, 0, b"another name"), 0x06010002),
    ],
    ids=["read", "block", "expedited", "segmented"],
)
def test_an_abort_that_names_no_object_ends_the_only_transfer(
    refused: Callable[[SdoClient], object], code: int
) -> None:
    desk = answering(nameless)
    with pytest.raises(AbortError) as error:
        refused(desk.sdo)
    assert (error.value.code, desk.sdo.counters.timeouts) == (code, 0)
    assert desk.sdo.read(cia301.DEVICE_TYPE) == 0x20192
    desk.close()


def test_a_late_abort_that_names_no_object_is_that_of_the_write_before() -> None:
    desk = answering(nameless, CanFault(CanFaultKind.SDO_LATE, size=0.6, count=1))
    with pytest.raises(AbortError, match="value too high"):
        desk.sdo.write(objects.QUICK_STOP_OPTION, 9)
    assert desk.sdo.counters.timeouts == 1
    desk.close()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda answer: answer[:5], "was answered with a frame of 5 bytes, expected 8"),
        (lambda answer: answer[:4], "was answered with a frame of 4 bytes, expected 8"),
        (lambda answer: answer[:1] + b"\x10\x60\x02" + answer[4:], "was answered for 6010h:02: another master"),
        (lambda answer: b"\x80\x10\x60\x02" + answer[4:], "was answered for 6010h:02: another master"),
    ],
    ids=["cut", "without a value", "another object", "abort of another object"],
)
def test_what_came_instead_of_an_answer_is_said_and_never_that_none_came(change: Change, said: str) -> None:
    desk = answering(change)
    for tried in (
        lambda: desk.sdo.read(objects.STATUSWORD),
        lambda: desk.sdo.write(objects.HOME_OFFSET, 1),
        lambda: desk.sdo.write(objects.QUICK_STOP_OPTION, 2),
    ):
        with pytest.raises(NoAnswerError) as error:
            tried()  # type: ignore[no-untyped-call]
        assert said in str(error.value)
        assert "not answered in time" not in str(error.value)
    desk.close()


def test_an_impossible_answer_is_an_error() -> None:
    desk = _desk(CanFault(CanFaultKind.SDO_GARBAGE, count=1))
    with pytest.raises(ProtocolError, match="drive X: SDO 1000h:00: answered with command E0h"):
        desk.sdo.read(cia301.DEVICE_TYPE)
    assert desk.sdo.read(cia301.DEVICE_TYPE) == 0x20192
    desk.close()


# -- several nodes -------------------------------------------------------------------------------------------------------


def test_many_nodes_are_read_in_the_time_of_few() -> None:
    node_ids = tuple(range(1, 21))
    bench = CanBench(node_ids, 1_000_000)
    for node_id, slave in bench.slaves.items():
        slave.dictionary.set_number(0x1018, 4, 1000 + node_id)
    with CanLink(bench.port(), bench.clock) as link:
        clients = [SdoClient(link, node_id, f"node {node_id}") for node_id in node_ids]
        start_ns = bench.clock.now_ns()
        values = CanLine(link).run([client.getting(cia301.SERIAL_NUMBER) for client in clients])
        together_ns = bench.clock.now_ns() - start_ns
        assert values == [1000 + node_id for node_id in node_ids]
    wire_ns = bench.wire.busy_ns
    assert together_ns <= wire_ns  # the bus is never idle between them


def test_one_dead_node_does_not_stall_the_others() -> None:
    bench = CanBench((1, 2, 3), faults={2: [CanFault(CanFaultKind.NODE_DEAD)]})
    with CanLink(bench.port(), bench.clock) as link:
        clients = [SdoClient(link, node_id, f"node {node_id}") for node_id in (1, 2, 3)]
        values = CanLine(link).run([client.getting(cia301.DEVICE_TYPE) for client in clients])
        assert values[0] == values[2] == 0x20192
        assert isinstance(values[1], NoAnswerError)
        assert "node 2" in str(values[1])


def test_one_channel_carries_one_transfer() -> None:
    bench = CanBench((1,))
    with CanLink(bench.port(), bench.clock) as link:
        client = SdoClient(link, 1, "node 1")
        first, second = CanLine(link).run([client.getting(cia301.DEVICE_TYPE), client.getting(objects.STATUSWORD)])
        assert first == 0x20192
        assert isinstance(second, StateError)
        assert "already in use" in str(second)
        assert client.read(cia301.DEVICE_TYPE) == 0x20192


class OtherThread:
    """A link whose frames another thread dispatches: those of an answer, endlessly."""

    def __init__(self) -> None:
        self.clock = WallClock()
        self._handler: Callable[[int, bytes], None] = lambda _time_ns, _data: None
        self._ended = threading.Event()
        self.errors: list[BaseException] = []
        self._thread = threading.Thread(target=self._dispatch)

    def subscribe(self, _cob_id: int, handler: Callable[[int, bytes], None]) -> None:
        self._handler = handler

    def send(self, _cob_id: int, _data: bytes) -> None:
        """Nobody hears it."""

    def poll(self) -> None:
        """Nothing while another thread dispatches."""

    def _dispatch(self) -> None:
        while not self._ended.is_set() and not self.errors:
            try:
                self._handler(self.clock.now_ns(), bytes([0x43, 0, 0x10, 0, 1, 0, 0, 0]))
            except Exception as error:  # noqa: BLE001 - whatever it is, the thread that dispatches would end by it
                self.errors.append(error)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._ended.set()
        self._thread.join()


def test_answers_that_another_thread_dispatches_meet_no_transfer_half_begun_or_half_ended() -> None:
    usual_s = sys.getswitchinterval()
    link = OtherThread()
    client = SdoClient(link, NODE, "drive X")  # type: ignore[arg-type]
    sys.setswitchinterval(1e-6)
    try:
        with link:
            for _ in range(5000):
                talk = Conversation(0x1000, 0)
                client.begin(Running(client, talk, upload(talk, 4)))
                client.end()
    finally:
        sys.setswitchinterval(usual_s)
    assert link.errors == []
