"""Lines that echo, garble, repeat or replay: nothing that was not said just now, by whom it was asked of, is believed."""

from __future__ import annotations

import random

import pytest
from fuzz.targets import _Port

from drivers.errors import BridgeError, NoAnswerError, ProtocolError
from drivers.instrument import ReadingStatus
from drivers.instruments.umd_laser import UmdLaser, UmdSettings
from drivers.modbus.endpoint import parse_endpoint
from drivers.modbus.wire import Function, PymodbusWire, Request
from sim_backends.clock import SimClock
from sim_backends.modbus_framing import Frame, pack_rtu

READS = (
    Request(Function.READ_HOLDING, 0, 2),
    Request(Function.READ_COILS, 0, 9),
    Request(Function.READ_INPUT, 0x0300, 1),
)
WRITES = (Request(Function.WRITE_REGISTER, 1, 1, (5,)), Request(Function.WRITE_REGISTERS, 1, 2, (5, 6)))
REPLIES = {3: b"\3\4\0\1\0\2", 1: b"\1\2\1\0", 4: b"\4\2\0\7", 6: b"\6\0\1\0\5", 16: b"\x10\0\1\0\2"}


def exchanged(request: Request, data: bytes) -> tuple[int, ...]:
    wire = PymodbusWire(parse_endpoint("/dev/null"))
    wire._port = _Port(data)  # type: ignore[assignment]
    return wire.exchange(1, request)


def frame_of(request: Request) -> bytes:
    return PymodbusWire(parse_endpoint("/dev/null"))._frame(1, request, 0)


def reply_to(request: Request) -> bytes:
    return pack_rtu(Frame(1, REPLIES[int(request.function)]))


@pytest.mark.parametrize("request_", READS, ids=str)
@pytest.mark.parametrize("dead", [False, True])
def test_a_line_that_echoes_is_refused_at_the_first_reading(request_: Request, dead: bool) -> None:
    """Every drive is read before anything is written to it. A single write's echo is byte for byte its reply."""
    assert reply_to(WRITES[0]) == frame_of(WRITES[0])
    data = frame_of(request_) + (b"" if dead else reply_to(request_))
    with pytest.raises(ProtocolError, match="the line echoes what is sent"):
        exchanged(request_, data)
    assert exchanged(request_, reply_to(request_)) is not None


@pytest.mark.parametrize("request_", [*READS, *WRITES], ids=str)
def test_noise_on_the_line_is_no_answer_and_no_other_value(request_: Request) -> None:
    good, chance = reply_to(request_), random.Random(int(request_.function))
    honest = exchanged(request_, good)
    for _ in range(2000):
        data = bytearray(good)
        for _ in range(chance.randint(1, 3)):
            what = chance.random()
            at = chance.randrange(len(data) + 1)
            if what < 0.4:
                data[at:at] = chance.randbytes(chance.randint(1, 3))
            elif at < len(data):
                if what < 0.8:
                    data[at] ^= 1 << chance.randrange(8)
                else:
                    del data[at]
        try:
            values = exchanged(request_, bytes(data))
        except (NoAnswerError, ProtocolError):
            continue
        except BridgeError as error:  # an exception reply that noise made would need its CRC
            raise AssertionError(data.hex()) from error
        assert values == honest, data.hex()


class Wire:
    """A serial line on which the test says what has arrived."""

    def __init__(self) -> None:
        self.waiting = b""

    def open(self) -> None: ...
    def close(self) -> None: ...
    def read_waiting(self) -> bytes:
        data, self.waiting = self.waiting, b""
        return data


def line(sequence: int, displacement: int) -> bytes:
    return f"1000 1000 {displacement} 0 0 {sequence} 0 0\r\n".encode()


@pytest.mark.parametrize(
    "again",
    [
        pytest.param([5], id="the last line twice"),
        pytest.param([3, 4, 5], id="three lines replayed"),
        pytest.param([0, 1, 2, 3, 4, 5], id="the whole stream replayed"),
        pytest.param([3], id="one line replayed"),
    ],
)
@pytest.mark.parametrize("latch", [True, False])
def test_replayed_and_duplicated_laser_lines_give_no_position(again: list[int], latch: bool) -> None:
    wire, clock = Wire(), SimClock()
    laser = UmdLaser(wire, clock, UmdSettings(compensate_air=False, latch_loss=latch))
    laser.open()
    wire.waiting = b"\r\n" + b"".join(line(number, 10 * number) for number in range(6))
    assert [reading.status for reading in laser.poll()] == [ReadingStatus.GOOD] * 6
    wire.waiting = b"".join(line(number, 10 * number) for number in again)
    replayed = laser.poll()
    assert replayed[0].status is ReadingStatus.HEAD_ERROR
    assert [reading.position_mm for reading in replayed if latch] == [None] * (len(again) if latch else 0)
    wire.waiting = line(6, 60)
    (after,) = laser.poll()
    assert (after.position_mm is None) is latch, "withheld until a person acknowledges the loss"
    laser.acknowledge_loss()
    wire.waiting = line(7, 70)
    assert laser.poll()[0].status is ReadingStatus.GOOD
