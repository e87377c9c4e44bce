"""The simulated wire: arbitration, exact times, periodic frames, and time that runs only while somebody waits."""

from __future__ import annotations

from itertools import pairwise

import can
import pytest
from support.can_bus_model import frame_bits
from support.can_wire import SimWire, WirePort

from sim_backends.clock import SimClock


def _message(cob_id: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=cob_id, data=data, is_extended_id=False)


@pytest.fixture
def wire() -> SimWire:
    return SimWire(SimClock(), 1_000_000)


def _received(port: WirePort, timeout_s: float = 1.0) -> list[tuple[int, int]]:
    """(identifier, ns) of everything that comes."""
    found = []
    while (message := port.recv(timeout_s)) is not None:
        found.append((message.arbitration_id, round(message.timestamp * 1e9)))
    return found


def test_a_frame_takes_its_bits(wire: SimWire) -> None:
    a, b = wire.port(), wire.port()
    a.send(_message(0x605, bytes(8)))
    assert _received(b) == [(0x605, 1000 * frame_bits(0x605, bytes(8)))]
    assert wire.busy_ns == 1000 * frame_bits(0x605, bytes(8))
    a.shutdown()
    b.shutdown()


def test_the_lowest_identifier_wins_and_the_others_wait(wire: SimWire) -> None:
    a, b, c = wire.port(), wire.port(), wire.port()
    a.send(_message(0x700))  # the bus is free: it goes out at once
    a.send(_message(0x605))
    b.send(_message(0x185))
    c.send(_message(0x080))
    order = _received(wire.port(), 0.0) or [identifier for identifier, _ in _received(a)]
    assert order == [0x080, 0x185]
    assert [identifier for identifier, _ in _received(b)] == [0x700, 0x080, 0x605]
    for port in (a, b, c):
        port.shutdown()


def test_frames_follow_each_other_without_a_gap(wire: SimWire) -> None:
    a, b = wire.port(), wire.port()
    for number in range(5):
        a.send(_message(0x100 + number, bytes((number,))))
    times = [time_ns for _, time_ns in _received(b)]
    lengths = [1000 * frame_bits(0x100 + number, bytes((number,))) for number in range(5)]
    assert times == [sum(lengths[: number + 1]) for number in range(5)]
    a.shutdown()
    b.shutdown()


def test_equal_frames_at_the_same_time_are_one(wire: SimWire) -> None:
    a, b, c, listener = (wire.port() for _ in range(4))
    c.send(_message(0x001))
    for port in (a, b):
        port.send(_message(0x7E4, b"\x4f"))
    assert [identifier for identifier, _ in _received(listener)] == [0x001, 0x7E4]
    for port in (a, b, c, listener):
        port.shutdown()


def test_waiting_costs_simulated_time_only(wire: SimWire) -> None:
    port = wire.port()
    assert port.recv(60.0) is None
    assert wire.clock.now_ns() == 60 * 10**9
    assert port.recv(0.0) is None
    assert wire.clock.now_ns() == 60 * 10**9
    port.shutdown()


def test_without_a_bit_rate_nothing_takes_time() -> None:
    wire = SimWire(SimClock())
    a, b = wire.port(), wire.port()
    for number in range(100):
        a.send(_message(number))
    assert len(_received(b, 0.0)) == 100
    assert wire.clock.now_ns() == 0
    a.shutdown()
    b.shutdown()


def test_periodic_frames_keep_their_period(wire: SimWire) -> None:
    a, b = wire.port(), wire.port()
    task = a.send_periodic(_message(0x080), 0.001)
    times = []
    for _ in range(5):
        message = b.recv(1.0)
        assert message is not None
        times.append(round(message.timestamp * 1e9))
    assert [later - earlier for earlier, later in pairwise(times)] == [1_000_000] * 4
    task.stop()
    b.recv(0.0)
    assert b.recv(0.01) is None
    a.shutdown()
    b.shutdown()


def test_bus_off_raises_and_ends(wire: SimWire) -> None:
    a, b = wire.port(), wire.port()
    a.schedule_bus_off(0.1, 0.2)
    a.send(_message(0x100))
    wire.clock.sleep_s(0.15)
    with pytest.raises(can.CanOperationError, match="bus-off"):
        a.send(_message(0x101))
    b.send(_message(0x102))
    wire.clock.sleep_s(0.2)
    assert a.recv(0.0) is None
    a.send(_message(0x103))
    assert [identifier for identifier, _ in _received(b)] == [0x100, 0x103]
    a.shutdown()
    b.shutdown()


def test_a_closed_port_says_so(wire: SimWire) -> None:
    port = wire.port()
    port.shutdown()
    with pytest.raises(can.CanOperationError, match="closed"):
        port.send(_message(1))
    with pytest.raises(can.CanOperationError, match="closed"):
        port.recv(0.0)


def test_the_load_is_the_share_of_busy_time(wire: SimWire) -> None:
    a, b = wire.port(), wire.port()
    a.send_periodic(_message(0x185, bytes(8)), 0.001)
    wire.clock.sleep_s(1.0)
    assert wire.load(0, 0) == pytest.approx(frame_bits(0x185, bytes(8)) / 1000, rel=0.01)
    a.shutdown()
    b.shutdown()


def test_a_wait_below_the_clocks_resolution_ends(wire: SimWire) -> None:
    """A caller waits for the rest of a time-out until none is left: were it to cost nothing, it would wait for ever."""
    port = wire.port()
    before_ns = wire.clock.now_ns()
    assert port.recv(1e-18) is None
    assert wire.clock.now_ns() == before_ns + 1
    assert port.recv(0.0) is None
    assert wire.clock.now_ns() == before_ns + 1


def test_a_closed_port_is_no_longer_on_the_wire(wire: SimWire) -> None:
    """A program that connects again and again leaves nothing behind that would go on to collect frames."""
    stays, goes = wire.port(), wire.port()
    goes.shutdown()
    goes.shutdown()
    wire.add_node().send(0x123, b"\x01")
    assert stays.recv(1.0) is not None
    assert not goes._received
