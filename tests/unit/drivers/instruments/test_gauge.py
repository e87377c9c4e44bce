"""A gauge between its line and the session: what is asked and when, how old a reading can be, what a fault takes with it."""

import pytest

from drivers.errors import InputError, LinkLostError
from drivers.instrument import ReadingStatus
from drivers.instruments.ascii_values import AsciiDecoder, AsciiSettings
from drivers.instruments.gauge import ANSWER_S, Gauge
from drivers.instruments.link import RETRY_S, PatientLink
from drivers.instruments.nd2xx import Nd2xxDecoder
from sim_backends.clock import SimClock

MS = 1_000_000


class Wire:
    """A line that says what it is told to, remembers what it heard, and can be pulled out."""

    def __init__(self) -> None:
        self.waiting = b""
        self.heard: list[bytes] = []
        self.plugged = True
        self.opened = 0

    def open(self) -> None:
        if not self.plugged:
            raise LinkLostError("port test cannot be opened")
        self.opened += 1

    def close(self) -> None:
        """Nothing is held."""

    def read_waiting(self) -> bytes:
        if not self.plugged:
            raise LinkLostError("port test is gone")
        data, self.waiting = self.waiting, b""
        return data

    def write(self, data: bytes) -> None:
        if not self.plugged:
            raise LinkLostError("port test is gone")
        self.heard.append(data)


@pytest.fixture
def clock() -> SimClock:
    return SimClock()


@pytest.fixture
def wire() -> Wire:
    return Wire()


def display(wire: Wire, clock: SimClock, direction: int = 1) -> Gauge:
    gauge = Gauge(wire, clock, Nd2xxDecoder(), direction=direction)
    gauge.open()
    return gauge


def shown(value: str) -> bytes:
    return f"{value[0]}{value[1:]:>10}    \r\n".encode()


def test_one_request_at_a_time_and_a_reading_is_no_older_than_its_request(wire: Wire, clock: SimClock) -> None:
    gauge = display(wire, clock, direction=-1)
    assert gauge.answers_when_asked
    assert gauge.poll() == []
    assert wire.heard == [b"\x02"]
    clock.sleep_s(0.05)
    assert gauge.poll() == []
    assert len(wire.heard) == 1, "not asked again while the answer is due"
    wire.waiting = shown("+12.3456")
    clock.sleep_s(0.05)
    (reading,) = gauge.poll()
    assert (reading.status, reading.position_mm) == (ReadingStatus.GOOD, -12.3456)
    assert (reading.since_ns, reading.time_ns) == (0, 100 * MS)
    assert reading.age_ns(clock.now_ns()) == 100 * MS
    assert len(wire.heard) == 2
    assert [gauge.sample_rate_hz, gauge.environment().air_temp_c] == [None, None]


def test_what_was_on_the_line_before_is_no_answer(wire: Wire, clock: SimClock) -> None:
    wire.waiting = shown("+99.0000")
    gauge = display(wire, clock)
    assert gauge.poll() == []
    assert wire.heard == [], "the line has to be quiet first"
    assert gauge.poll() == []
    assert wire.heard == [b"\x02"]


def test_an_answer_that_never_comes_is_asked_for_again_and_a_late_half_of_it_is_not_believed(
    wire: Wire, clock: SimClock
) -> None:
    gauge = display(wire, clock)
    gauge.poll()
    wire.waiting = b"+    12."
    clock.sleep_s(0.1)
    assert gauge.poll() == []
    clock.sleep_s(ANSWER_S)
    gauge.poll()
    wire.waiting = b"3456    \r\n"
    assert gauge.poll() == []
    gauge.poll()
    assert wire.heard == [b"\x02"] * 2
    wire.waiting = shown("+12.3456")
    assert [reading.position_mm for reading in gauge.poll()] == [12.3456]


def test_a_line_of_its_own_accord_is_no_older_than_the_look_before(wire: Wire, clock: SimClock) -> None:
    gauge = Gauge(wire, clock, AsciiDecoder(AsciiSettings()))
    gauge.open()
    wire.waiting = b"3.4\r\n"
    clock.sleep_s(0.1)
    assert gauge.poll() == [], "joined in mid-line"
    clock.sleep_s(120.0)
    wire.waiting = b"13.4\r\nwhat?\r\n13.5\r\n"
    readings = gauge.poll()
    assert [(reading.position_mm, reading.sequence) for reading in readings] == [(13.4, 1), (13.5, 2)]
    assert {reading.since_ns for reading in readings} == {100 * MS}
    assert (gauge.bad_lines, wire.heard) == (2, [])


def test_a_fault_takes_the_zero_with_it_until_someone_says_so(wire: Wire, clock: SimClock) -> None:
    gauge = Gauge(wire, clock, AsciiDecoder(AsciiSettings(fault="ERROR")))
    gauge.open()
    wire.waiting = b"\n1.0\nERROR\n1.0\n"
    assert [reading.status.name for reading in gauge.poll()] == ["GOOD", "HEAD_ERROR", "LOST_BEFORE"]
    assert gauge.acknowledge_loss()
    assert not gauge.acknowledge_loss()
    wire.waiting = b"1.0\n"
    assert gauge.poll()[0].status is ReadingStatus.GOOD


def test_a_port_that_comes_back_is_found_and_its_zero_is_not_believed(wire: Wire, clock: SimClock) -> None:
    link = PatientLink(wire, clock)
    gauge = Gauge(link, clock, AsciiDecoder(AsciiSettings()))
    gauge.open()
    wire.waiting = b"\n1.0\n2."
    assert len(gauge.poll()) == 1
    wire.plugged = False
    for _ in range(3):
        with pytest.raises(LinkLostError, match="is gone"):
            gauge.poll()
        clock.sleep_s(RETRY_S)
    wire.plugged, wire.waiting = True, b"5\n3.0\n"
    assert [reading.status for reading in gauge.poll()] == [ReadingStatus.LOST_BEFORE]
    assert wire.opened == 2
    gauge.acknowledge_loss()
    wire.waiting = b"3.0\n"
    assert gauge.poll()[0].position_mm == 3.0


def test_a_lost_port_is_not_looked_for_at_every_look(wire: Wire, clock: SimClock) -> None:
    link = PatientLink(wire, clock)
    link.open()
    wire.plugged = False
    with pytest.raises(LinkLostError):
        link.write(b"?")
    wire.plugged = True
    with pytest.raises(LinkLostError):
        link.read_waiting()
    with pytest.raises(LinkLostError):
        link.write(b"?")
    clock.sleep_s(RETRY_S)
    assert link.read_waiting() == b""
    link.write(b"?")
    assert (wire.opened, wire.heard) == (2, [b"?"])


def test_a_direction_that_is_none_is_refused(wire: Wire, clock: SimClock) -> None:
    with pytest.raises(InputError, match="direction is 0"):
        display(wire, clock, direction=0)
