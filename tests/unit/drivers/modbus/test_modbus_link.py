"""The link's decisions, on a wire that plays a script: repeats, back-off, silence, late replies, writes in doubt."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import pytest

from drivers.clock import NS_PER_S
from drivers.errors import AbortError, InputError, LinkLostError, NoAnswerError, ProtocolError
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.modbus.link import Doubt, LinkPolicy, ModbusLink
from drivers.modbus.plan import AddressSpace, Span
from drivers.modbus.wire import Request
from sim_backends.clock import SimClock

TCP = TcpEndpoint("nowhere", timeout_s=0.2)
RTU = RtuEndpoint("nowhere", baud=9600)
HOLDING = AddressSpace.HOLDING

Answer = tuple[int, ...] | BaseException | Callable[[Request], "tuple[int, ...]"]


@dataclass
class ScriptedWire:
    """Answers requests from a list, and notes what was asked when. Once the list is used up every read gives zeros."""

    clock: SimClock
    script: list[Answer] = field(default_factory=list)
    asked: list[tuple[int, int, Request]] = field(default_factory=list)  # (time, unit, request)
    connected: bool = False
    connects: int = 0
    refuse_connects: int = 0
    takes_s: float = 0.0
    discards: int = 0
    posted: list[Request] = field(default_factory=list)

    def connect(self, within_s: float = math.inf) -> None:
        if self.refuse_connects:
            self.refuse_connects -= 1
            raise LinkLostError("refused")
        self.connected = True
        self.connects += 1

    def disconnect(self) -> None:
        self.connected = False

    def discard(self, silence_s: float) -> None:
        assert silence_s > 0
        self.discards += 1

    def post(self, unit: int, requests: Sequence[Request]) -> None:
        self.posted += requests

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        assert self.connected
        self.asked.append((self.clock.now_ns(), unit, request))
        self.clock.sleep_s(self.takes_s)
        answer = self.script.pop(0) if self.script else (() if request.function.is_write else (0,) * request.count)
        if isinstance(answer, LinkLostError):
            self.connected = False
        if isinstance(answer, BaseException):
            raise answer
        return answer(request) if callable(answer) else answer

    @property
    def requests(self) -> list[Request]:
        return [request for _, _, request in self.asked]


@dataclass
class Rig:
    wire: ScriptedWire
    link: ModbusLink
    clock: SimClock


def rig(*script: Answer, endpoint: Endpoint = TCP, policy: LinkPolicy | None = None) -> Rig:
    clock = SimClock()
    wire = ScriptedWire(clock, list(script))
    link = ModbusLink(endpoint, clock, policy=policy or LinkPolicy(read_retries=1), make_wire=lambda _endpoint: wire)
    link.open()
    return Rig(wire, link, clock)


def no_answer() -> NoAnswerError:
    return NoAnswerError("no answer")


def read(link: ModbusLink, unit: int = 1, start: int = 10, count: int = 2) -> tuple[int, ...]:
    return link.read(unit, HOLDING, Span(start, count))


# -- reads -------------------------------------------------------------------------------------------------------------
def test_a_read_is_repeated_the_stated_number_of_times() -> None:
    r = rig(no_answer(), (7, 8))
    assert read(r.link) == (7, 8)
    assert len(r.wire.asked) == 2
    r = rig(*[no_answer()] * 3, policy=LinkPolicy(read_retries=2))
    with pytest.raises(NoAnswerError):
        read(r.link)
    assert len(r.wire.asked) == 3


def test_a_refusal_is_no_reason_to_ask_again() -> None:
    r = rig(AbortError("illegal data address", 2))
    with pytest.raises(AbortError) as caught:
        read(r.link)
    assert caught.value.code == 2
    assert len(r.wire.asked) == 1


def test_a_busy_device_is_asked_again_after_a_pause() -> None:
    r = rig(AbortError("busy", 6), AbortError("busy", 6), (1, 2), policy=LinkPolicy(busy_pause_s=0.05))
    assert read(r.link) == (1, 2)
    times = [time for time, _, _ in r.wire.asked]
    assert [later - earlier for earlier, later in itertools.pairwise(times)] == [50_000_000, 50_000_000]
    r = rig(*[AbortError("busy", 6)] * 9, policy=LinkPolicy(busy_s=0.04))
    with pytest.raises(AbortError, match=r"busy, asked again for 0\.04 s"):
        read(r.link)
    assert len(r.wire.asked) == 3


@pytest.mark.parametrize("code", [10, 11])
def test_a_unit_that_a_gateway_does_not_reach_is_asked_again_and_then_counts_as_silent(code: int) -> None:
    r = rig(AbortError("gateway", code), AbortError("gateway", code), (1, 2))
    assert read(r.link) == (1, 2)
    r = rig(*[AbortError("gateway", code)] * 9, policy=LinkPolicy(busy_s=0.04))
    with pytest.raises(NoAnswerError, match=r"gateway, asked again for 0\.04 s"):
        read(r.link)
    assert len(r.wire.asked) == 3


@pytest.mark.parametrize(("code", "writes"), [(10, [True, True]), (11, [True, False])])
def test_a_write_that_a_gateway_passed_on_may_have_been_carried_out(code: int, writes: list[bool]) -> None:
    r = rig(AbortError("gateway", code), (3, 4) if code == 11 else ())
    r.link.write(1, HOLDING, 10, (3, 4))
    assert [request.function.is_write for request in r.wire.requests] == writes


def test_a_lost_connection_is_made_anew_for_a_read() -> None:
    r = rig(LinkLostError("gone"), (5, 6))
    assert read(r.link) == (5, 6)
    assert r.wire.connects == 2


# -- writes ------------------------------------------------------------------------------------------------------------
def test_an_unanswered_write_that_happened_is_not_repeated() -> None:
    r = rig(no_answer(), (3, 4))
    r.link.write(1, HOLDING, 10, (3, 4))
    assert [request.function.is_write for request in r.wire.requests] == [True, False]


@pytest.mark.parametrize("lost", [NoAnswerError("no answer"), LinkLostError("gone"), ProtocolError("echoes 7")])
def test_a_write_that_was_lost_is_told_and_never_sent_again(lost: BaseException) -> None:
    r = rig(lost, no_answer(), (3, 9))  # the read-back is asked again
    with pytest.raises(NoAnswerError, match="not carried out, and not sent again: reads 3, 9, expected 3, 4"):
        r.link.write(1, HOLDING, 10, (3, 4))
    assert [request.function.is_write for request in r.wire.requests] == [True, False, False]
    assert r.wire.requests[-1].count == 2  # the whole value


def test_a_busy_unit_has_refused_a_write_so_it_is_sent_when_it_has_time() -> None:
    r = rig(AbortError("busy", 6), ())
    r.link.write(1, HOLDING, 10, (3, 4))
    assert [request.function.is_write for request in r.wire.requests] == [True, True]


def test_a_write_that_cannot_be_read_back_stays_in_doubt() -> None:
    for second in (no_answer, lambda: AbortError("write only", 2)):
        r = rig(no_answer(), *[second()] * 3)
        with pytest.raises(NoAnswerError, match="in doubt"):
            r.link.write(1, HOLDING, 10, (3, 4))
        assert sum(request.function.is_write for request in r.wire.requests) == 1


def test_a_write_whose_connection_broke_is_read_back_over_a_new_one() -> None:
    r = rig(LinkLostError("gone"), (3, 4))
    r.link.write(1, HOLDING, 10, (3, 4))
    assert r.wire.connects == 2
    assert sum(request.function.is_write for request in r.wire.requests) == 1


def test_a_wrong_echo_puts_a_write_in_doubt_too() -> None:
    r = rig(ProtocolError("echoes 7"), (3, 4))
    r.link.write(1, HOLDING, 10, (3, 4))
    assert [request.function.is_write for request in r.wire.requests] == [True, False]


def test_a_start_bit_is_never_sent_twice() -> None:
    r = rig(no_answer())
    with pytest.raises(NoAnswerError, match="whether it was carried out is unknown"):
        r.link.write(1, HOLDING, 10, (1,), doubt=Doubt.RAISE)
    assert len(r.wire.asked) == 1


def test_a_stop_is_the_one_write_that_is_sent_again_and_ignores_backoff() -> None:
    r = rig(*[no_answer()] * 2, no_answer(), ())
    with pytest.raises(NoAnswerError):
        read(r.link)
    with pytest.raises(NoAnswerError, match="not tried again"):
        read(r.link)
    r.link.write(1, HOLDING, 10, (2,), doubt=Doubt.STOP, urgent=True)
    assert [request.function.is_write for request in r.wire.requests] == [False, False, True, True]


@pytest.mark.parametrize("doubt", [Doubt.READ_BACK, Doubt.RAISE])
def test_a_write_held_back_by_backoff_was_not_sent_and_is_in_no_doubt(doubt: Doubt) -> None:
    r = rig(no_answer(), no_answer())
    with pytest.raises(NoAnswerError):
        read(r.link)
    with pytest.raises(NoAnswerError, match=r"not tried again for another 0.25 s$"):
        r.link.write(1, HOLDING, 10, (2,), doubt=doubt)
    assert len(r.wire.asked) == 2
    r.wire.disconnect()
    r.wire.refuse_connects = 1
    with pytest.raises(LinkLostError):
        r.link.write(2, HOLDING, 10, (2,), doubt=doubt)
    assert len(r.wire.asked) == 2


def test_one_register_goes_with_function_6_or_16() -> None:
    r = rig()
    r.link.write(1, HOLDING, 10, (1,))
    r.link.write(1, HOLDING, 10, (1,), single=False)
    r.link.write(1, HOLDING, 10, (1, 2))
    r.link.write(1, AddressSpace.COIL, 10, (1,))
    r.link.write(1, AddressSpace.COIL, 10, (1, 0))
    assert [int(request.function) for request in r.wire.requests] == [6, 16, 16, 5, 15]


# -- back-off ----------------------------------------------------------------------------------------------------------
def test_a_dead_unit_does_not_stall_the_others() -> None:
    """The dead one costs its time-out once per back-off, and the back-off doubles."""
    policy = LinkPolicy(read_retries=0, backoff_first_s=0.25, backoff_max_s=2.0)
    clock = SimClock()
    wire = ScriptedWire(clock)
    link = ModbusLink(TCP, clock, policy=policy, make_wire=lambda _endpoint: wire)
    link.open()
    tries: list[float] = []
    alive = 0
    for _ in range(1000):
        asked = len(wire.asked)
        wire.script = [no_answer()]
        with pytest.raises(NoAnswerError):
            read(link, unit=1)
        if len(wire.asked) > asked:
            tries.append(clock.now_ns() / NS_PER_S)
        wire.script = []
        read(link, unit=2)
        alive += 1
        clock.sleep_s(0.01)
    assert alive == 1000
    gaps = [later - earlier for earlier, later in itertools.pairwise(tries)]
    assert gaps == pytest.approx([0.25, 0.5, 1.0, 2.0, 2.0, 2.0, 2.0], abs=0.011)


def test_a_unit_that_answers_again_is_forgiven() -> None:
    r = rig(no_answer(), no_answer(), (1, 1))
    with pytest.raises(NoAnswerError):
        read(r.link)
    r.clock.sleep_s(0.3)
    assert read(r.link) == (1, 1)
    assert read(r.link) == (0, 0)


def test_a_refusal_ends_a_backoff_as_well() -> None:
    r = rig(no_answer(), no_answer(), AbortError("no", 2), AbortError("no", 2))
    with pytest.raises(NoAnswerError):
        read(r.link)
    r.clock.sleep_s(0.3)
    for _ in range(2):
        with pytest.raises(AbortError):
            read(r.link)


def test_a_server_that_is_gone_is_dialled_with_backoff() -> None:
    r = rig(LinkLostError("gone"))
    r.wire.refuse_connects = 5
    with pytest.raises(LinkLostError):
        read(r.link)
    with pytest.raises(LinkLostError, match="not tried again"):
        read(r.link)
    assert r.wire.refuse_connects == 4
    r.wire.refuse_connects = 0
    r.clock.sleep_s(1.0)
    assert read(r.link) == (0, 0)


# -- a serial line -----------------------------------------------------------------------------------------------------
def test_frames_are_parted_by_the_silent_interval() -> None:
    r = rig(endpoint=RTU)
    r.wire.takes_s = 0.02
    for unit in (1, 2, 3):
        read(r.link, unit)
    times = [time for time, _, _ in r.wire.asked]
    for earlier, later in itertools.pairwise(times):
        assert later - earlier == round(0.02 * NS_PER_S) + round(38.5 / 9600 * NS_PER_S)


def test_after_a_time_out_the_line_is_left_alone_for_longer() -> None:
    r = rig(no_answer(), policy=LinkPolicy(quiet_s=0.1, read_retries=0), endpoint=RTU)
    with pytest.raises(NoAnswerError):
        read(r.link, 1)
    read(r.link, 2)
    assert r.wire.asked[1][0] - r.wire.asked[0][0] == round(0.1 * NS_PER_S)
    read(r.link, 2)
    assert r.wire.discards == 1


def test_a_repeated_read_is_parted_from_a_late_reply_by_one_of_another_length() -> None:
    r = rig(no_answer(), (9,), (1, 2), endpoint=RTU)
    assert read(r.link) == (1, 2)
    assert [request.count for request in r.wire.requests] == [2, 1, 2]


def test_the_parting_read_is_one_that_was_answered_before_where_there_is_one() -> None:
    """A drive without registers beside the one asked for refuses to read them, and a refusal fits any request."""
    r = rig((5,) * 9, (1, 2), no_answer(), (5,) * 9, (3, 4), endpoint=RTU)
    read(r.link, start=100, count=9)
    read(r.link)
    assert read(r.link) == (3, 4)
    assert [request.count for request in r.wire.requests] == [9, 2, 2, 9, 2]


def test_a_late_reply_that_hits_the_parting_read_is_thrown_away() -> None:
    r = rig(no_answer(), ProtocolError("2 values, expected 1"), (1, 2), endpoint=RTU)
    assert read(r.link) == (1, 2)
    assert [request.count for request in r.wire.requests] == [2, 1, 2]


def test_a_different_request_needs_no_parting() -> None:
    r = rig(no_answer(), policy=LinkPolicy(read_retries=0), endpoint=RTU)
    with pytest.raises(NoAnswerError):
        read(r.link)
    r.link.write(1, HOLDING, 10, (1,), urgent=True)
    read(r.link)
    assert len(r.wire.asked) == 3


def test_tcp_needs_no_parting_as_its_replies_are_numbered() -> None:
    r = rig(no_answer())
    read(r.link)
    assert [request.count for request in r.wire.requests] == [2, 2]


# -- stops and the operator ----------------------------------------------------------------------------------------------
STOP = Request.write(HOLDING, 0, (2,))


@pytest.mark.parametrize(("endpoint", "discards"), [(RTU, 1), (TCP, 0)])
def test_the_answer_to_a_posted_stop_is_taken_off_a_serial_line_before_the_next_request(
    endpoint: Endpoint, discards: int
) -> None:
    r = rig(endpoint=endpoint)
    r.link.post(1, [STOP])
    assert (r.wire.posted, r.wire.asked, r.wire.discards) == ([STOP], [], 0)
    read(r.link)
    assert r.wire.discards == discards


def test_a_stop_passes_by_back_off_and_silence() -> None:
    r = rig(no_answer(), no_answer(), endpoint=RTU)
    with pytest.raises(NoAnswerError):
        read(r.link)
    with pytest.raises(NoAnswerError, match="not tried again"):
        read(r.link)
    before_ns = r.clock.now_ns()
    r.link.post(1, [STOP])
    assert r.wire.posted == [STOP]
    assert r.clock.now_ns() == before_ns
    r.link.close()
    r.link.post(1, [STOP])
    assert r.wire.posted == [STOP]


def test_a_reply_that_the_operator_broke_off_is_still_to_come() -> None:
    r = rig(KeyboardInterrupt(), (9,), (1, 2), endpoint=RTU)
    with pytest.raises(KeyboardInterrupt):
        read(r.link)
    assert read(r.link) == (1, 2)
    assert [request.count for request in r.wire.requests] == [2, 1, 2]
    assert r.wire.discards == 1


def test_the_operator_is_heard_before_each_request_in_simulated_time_too() -> None:
    class Pressed:
        def real(self, duration_s: float) -> None: ...
        def simulated(self, now_ns: int) -> None:
            raise KeyboardInterrupt

    clock = SimClock(waiting=Pressed())
    wire = ScriptedWire(clock)
    link = ModbusLink(TCP, clock, make_wire=lambda _endpoint: wire)
    link.open()
    with pytest.raises(KeyboardInterrupt):
        read(link)
    assert not wire.asked


@pytest.mark.parametrize("code", [5, 6])
def test_a_read_of_a_unit_that_is_busy_for_ever_ends(code: int) -> None:
    r = rig(*[AbortError("busy", code)] * 999)
    with pytest.raises(AbortError):
        read(r.link)
    assert r.clock.now_ns() == pytest.approx(LinkPolicy().busy_s * 1e9, abs=0.03e9)


def test_an_acknowledged_write_is_looked_for_and_never_sent_again() -> None:
    r = rig(AbortError("acknowledge", 5), (0, 0), (3, 4))
    r.link.write(1, HOLDING, 10, (3, 4))
    assert [request.function.is_write for request in r.wire.requests] == [True, False, False]
    r = rig(AbortError("acknowledge", 5), *[(0, 0)] * 100, (3, 4))  # for 2 s, while it is being carried out
    r.link.write(1, HOLDING, 10, (3, 4))
    assert sum(request.function.is_write for request in r.wire.requests) == 1
    r = rig(AbortError("acknowledge", 5), policy=LinkPolicy(busy_s=0.05))
    with pytest.raises(NoAnswerError, match="still reads 0, 0, expected 3, 4"):
        r.link.write(1, HOLDING, 10, (3, 4))
    assert [request.function.is_write for request in r.wire.requests] == [True, False, False, False]
    r = rig(AbortError("acknowledge", 5))
    with pytest.raises(NoAnswerError, match="whether it was carried out is unknown"):
        r.link.write(1, HOLDING, 10, (1,), doubt=Doubt.RAISE)
    assert len(r.wire.asked) == 1


def test_a_line_that_others_keep_is_not_waited_for_without_end() -> None:
    r = rig(policy=LinkPolicy(turn_s=0.05))
    held, over = threading.Event(), threading.Event()

    def hold(request: Request) -> tuple[int, ...]:
        held.set()
        over.wait(10.0)
        return (0,) * request.count

    r.wire.script = [hold]
    holder = threading.Thread(target=read, args=(r.link,))
    holder.start()
    held.wait(10.0)
    with pytest.raises(NoAnswerError, match=r"in use by others for 0.05 s, nothing was sent"):
        read(r.link)
    over.set()
    holder.join()


# -- users and mistakes ------------------------------------------------------------------------------------------------
def test_the_last_user_disconnects() -> None:
    r = rig()
    r.link.open()
    r.link.close()
    assert r.wire.connected
    r.link.close()
    assert not r.wire.connected
    r.link.close()
    with pytest.raises(LinkLostError, match="is not open"):
        read(r.link)
    r.link.open()
    assert read(r.link) == (0, 0)


def test_a_link_that_cannot_be_opened_can_be_tried_again() -> None:
    clock = SimClock()
    wire = ScriptedWire(clock, refuse_connects=1)
    link = ModbusLink(TCP, clock, make_wire=lambda _endpoint: wire)
    with pytest.raises(LinkLostError):
        link.open()
    link.open()
    assert read(link) == (0, 0)


@pytest.mark.parametrize(("endpoint", "unit"), [(RTU, 0), (RTU, 248), (TCP, 256), (TCP, -1)])
def test_unit_ids_that_cannot_be(endpoint: Endpoint, unit: int) -> None:
    with pytest.raises(InputError, match="unit id"):
        read(rig(endpoint=endpoint).link, unit)


def test_requests_that_cannot_be() -> None:
    link = rig().link
    with pytest.raises(InputError, match="at most 125"):
        link.read(1, HOLDING, Span(0, 126))
    with pytest.raises(InputError, match="cannot be written"):
        link.write(1, AddressSpace.INPUT, 0, (1,))
