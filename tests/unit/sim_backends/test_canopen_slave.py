"""The simulated drive by itself, fed with frames: what the network side does without a master of ours."""

from __future__ import annotations

import pytest

from drivers.drive import DriveState
from drivers.errors import InputError
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_dictionary import Dictionary, RefusedError, load_items
from sim_backends.canopen_drive import EDS, CanOpenSlave, NmtState
from sim_backends.servo import SimulatedServo

NODE = 5
MS = 1_000_000


class Bench:
    """A drive, its servo, and what it sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, bytes]] = []
        self.servo = SimulatedServo(BareShaft(), SMALL_SERVO)
        self.slave = CanOpenSlave(self.servo, NODE, lambda cob_id, data: self.sent.append((cob_id, data)))
        self.now_ns = 0
        self.slave.boot(0)

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now_ns += MS
            self.servo.advance(self.now_ns, 0.001)
            self.slave.tick(self.now_ns)

    def frame(self, cob_id: int, data: str = "") -> list[tuple[int, bytes]]:
        """Feed a frame; what was sent since the last look."""
        self.sent.clear()
        self.slave.on_frame(cob_id, bytes.fromhex(data), self.now_ns)
        return list(self.sent)

    def write(self, index: int, subindex: int, value: int, size: int) -> bytes:
        command = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
        payload = bytes((command,)) + index.to_bytes(2, "little") + bytes((subindex,)) + value.to_bytes(4, "little")
        (answer,) = [data for cob_id, data in self.frame(0x600 + NODE, payload.hex()) if cob_id == 0x580 + NODE]
        return answer

    def control(self, word: int) -> None:
        assert self.write(0x6040, 0, word, 2)[0] == 0x60


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_stopped_node_answers_no_sdo_and_sends_no_pdo(bench: Bench) -> None:
    bench.frame(0x000, "0205")
    assert bench.slave.nmt_state is NmtState.STOPPED
    assert bench.frame(0x605, "4000100000000000") == []
    assert bench.frame(0x080) == []
    bench.frame(0x000, "0100")  # to all nodes
    assert bench.slave.nmt_state is NmtState.OPERATIONAL


def test_commands_to_others_are_not_ours(bench: Bench) -> None:
    bench.frame(0x000, "0106")
    assert bench.slave.nmt_state is NmtState.PRE_OPERATIONAL
    bench.frame(0x000, "01")
    assert bench.slave.nmt_state is NmtState.PRE_OPERATIONAL


def _map_status(bench: Bench, kind: int, *, inhibit: int = 0, timer: int = 0) -> None:
    bench.write(0x1800, 1, 0xC0000185, 4)
    bench.write(0x1801, 1, 0xC0000285, 4)
    bench.write(0x1A00, 0, 0, 1)
    bench.write(0x1A00, 1, 0x60410010, 4)
    bench.write(0x1A00, 0, 1, 1)
    bench.write(0x1800, 2, kind, 1)
    bench.write(0x1800, 3, inhibit, 2)
    bench.write(0x1800, 5, timer, 2)
    bench.write(0x1800, 1, 0x40000185, 4)
    bench.frame(0x000, "0105")


def _count(bench: Bench, cob_id: int) -> int:
    return sum(found == cob_id for found, _ in bench.sent)


@pytest.mark.parametrize(("kind", "sent"), [(1, 12), (3, 4), (5, 2)])
def test_every_nth_sync(bench: Bench, kind: int, sent: int) -> None:
    _map_status(bench, kind)
    total = sum(len(bench.frame(0x080)) for _ in range(12))
    assert total == sent


def test_acyclic_synchronous_sends_on_change_at_sync(bench: Bench) -> None:
    _map_status(bench, 0)
    assert len(bench.frame(0x080)) == 1
    assert bench.frame(0x080) == []
    bench.control(0x06)
    assert bench.frame(0x080) == [(0x185, b"\x31\x06")]


def test_event_driven_with_inhibit_time(bench: Bench) -> None:
    _map_status(bench, 255, inhibit=500)  # 50 ms
    bench.sent.clear()
    bench.run(60)
    for word in (0x06, 0x00) * 20:  # a change every millisecond
        bench.slave.dictionary.write(0x6040, 0, word.to_bytes(2, "little"))
        bench.run(1)
    assert _count(bench, 0x185) == 2


def test_the_event_timer_sends_without_a_change(bench: Bench) -> None:
    _map_status(bench, 255, timer=10)
    bench.sent.clear()
    bench.run(100)
    assert 9 <= _count(bench, 0x185) <= 11


def test_a_synchronous_rpdo_waits_for_sync(bench: Bench) -> None:
    bench.write(0x1400, 2, 1, 1)
    bench.frame(0x000, "0105")
    bench.frame(0x205, "0600")
    assert bench.slave.profile.state is DriveState.SWITCH_ON_DISABLED
    bench.frame(0x080)
    assert bench.slave.profile.state is DriveState.READY


def test_a_short_rpdo_is_reported_and_not_taken(bench: Bench) -> None:
    bench.frame(0x000, "0105")
    sent = bench.frame(0x205, "06")
    assert sent == [(0x085, bytes.fromhex("1082110000000000"))]
    assert bench.slave.profile.state is DriveState.SWITCH_ON_DISABLED


def test_a_fault_while_moving_passes_through_its_reaction(bench: Bench) -> None:
    bench.write(0x6060, 0, 3, 1)
    for word in (0x06, 0x07, 0x0F):
        bench.control(word)
    bench.write(0x60FF, 0, 500_000, 4)
    bench.run(200)
    bench.servo.raise_fault(0x3210)
    bench.slave.tick(bench.now_ns)
    assert bench.slave.profile.state is DriveState.FAULT_REACTION
    bench.run(500)
    assert bench.slave.profile.state is DriveState.FAULT


def test_the_error_history_keeps_eight(bench: Bench) -> None:
    for code in range(0x1000, 0x100A):
        bench.slave.emergency(code)
    od = bench.slave.dictionary
    assert od.number(0x1003, 0) == 8
    assert [od.number(0x1003, number) for number in (1, 8)] == [0x1009, 0x1002]
    assert bench.write(0x1003, 0, 1, 1)[0] == 0x80  # only 0 may be written, to clear it
    assert bench.write(0x1003, 0, 0, 1)[0] == 0x60
    assert od.number(0x1003, 1) == 0


def test_an_emergency_channel_that_is_off_is_silent(bench: Bench) -> None:
    bench.write(0x1014, 0, 0x80000085, 4)
    bench.sent.clear()
    bench.servo.raise_fault(0x3210)
    bench.run(1)
    assert bench.sent == []


def test_a_node_id_out_of_range_is_refused() -> None:
    with pytest.raises(InputError, match="node id is 128"):
        CanOpenSlave(SimulatedServo(BareShaft(), SMALL_SERVO), 128, lambda _cob_id, _data: None)


def test_a_refused_write_changes_nothing() -> None:
    dictionary = Dictionary(load_items(EDS, NODE))

    def refuse(_value: int) -> None:
        raise RefusedError(0x08000022)

    dictionary.on_write(0x605A, 0, refuse)
    with pytest.raises(RefusedError):
        dictionary.write(0x605A, 0, b"\x06\x00")
    assert dictionary.number(0x605A) == 2
