"""The node scan: who is there, who only makes itself heard, and that nothing but reads is ever sent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.node import NmtState
from drivers.canopen.scan import FoundNode, listen, scan
from drivers.clock import NS_PER_S
from drivers.drive import DriveState
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind

SDO_REQUESTS = range(0x601, 0x680)
READS = (0x40, 0x60, 0x70, 0x80)  # initiate upload, segments of it, and the master's abort


@dataclass
class Spied:
    """A bench, a link to it, and every frame that went over the wire from that link."""

    bench: CanBench
    link: CanLink
    sent: list[tuple[int, bytes]] = field(default_factory=list)

    def only_read(self) -> bool:
        return all(cob_id in SDO_REQUESTS and data[0] in READS for cob_id, data in self.sent)


def spied(bench: CanBench) -> Spied:
    link = CanLink(bench.port(), bench.clock)
    spy = Spied(bench, link)
    send = link.send

    def sending(cob_id: int, data: bytes) -> None:
        spy.sent.append((cob_id, data))
        send(cob_id, data)

    link.send = sending  # type: ignore[method-assign]
    return spy


@pytest.fixture
def three() -> Iterator[Spied]:
    spy = spied(CanBench(node_ids=(2, 5, 127), bitrate=1_000_000))
    yield spy
    spy.link.close()


def test_every_node_is_found_with_its_identity_and_state(three: Spied) -> None:
    bench = three.bench
    bench.servos[5].power_on()
    bench.servos[127].raise_fault(0x3210)
    bench.clock.sleep_s(0.1)
    found = scan(three.link)
    assert [node.node_id for node in found] == [2, 5, 127]
    for node in found:
        assert node.answers_sdo
        assert node.profile == 402
        dictionary = bench.slaves[node.node_id].dictionary
        assert node.vendor_id == dictionary.number(0x1018, 1)
        assert node.product_code == dictionary.number(0x1018, 2)
        assert node.serial == dictionary.number(0x1018, 4)
        assert node.device_name == dictionary.raw((0x1008, 0)).decode()
        assert node.position_counts == 0
    assert found[0].state is DriveState.SWITCH_ON_DISABLED
    assert found[0].fault_code is None
    assert found[2].state is DriveState.FAULT
    assert found[2].fault_code == 0x3210
    assert three.only_read()


def test_a_whole_scan_of_a_bus_takes_seconds_at_most_and_leaves_the_bus_half_idle(three: Spied) -> None:
    before_ns = three.bench.clock.now_ns()
    busy_ns = three.bench.wire.busy_ns
    scan(three.link)
    took_ns = three.bench.clock.now_ns() - before_ns
    assert took_ns < 2 * NS_PER_S
    assert three.bench.wire.busy_ns - busy_ns < 0.1 * took_ns


def test_only_the_nodes_asked_for_are_asked(three: Spied) -> None:
    assert [node.node_id for node in scan(three.link, (3, 5))] == [5]
    assert {cob_id - 0x600 for cob_id, _ in three.sent} == {3, 5}


def test_a_stopped_node_speaks_no_sdo_but_is_heard() -> None:
    spy = spied(CanBench(node_ids=(4, 9), parameters={(0x1017, 0): 100}))
    spy.link.send(0x000, b"\x02\x09")  # NMT: stop node 9
    found = scan(spy.link)
    assert [(node.node_id, node.answers_sdo, node.nmt_state) for node in found] == [
        (4, True, NmtState.PRE_OPERATIONAL),
        (9, False, NmtState.STOPPED),
    ]
    assert found[1] == FoundNode(9, heard=("heartbeat",), nmt_state=NmtState.STOPPED)
    spy.link.close()


def test_a_node_that_refuses_everything_is_there_all_the_same() -> None:
    spy = spied(CanBench(faults={5: [CanFault(CanFaultKind.SDO_ABORTED, size=0x08000022)]}))
    (node,) = scan(spy.link, range(1, 10))
    assert node == FoundNode(5, answers_sdo=True)
    spy.link.close()


def test_a_node_that_answers_with_short_frames_is_there_and_told() -> None:
    spy = spied(CanBench(node_ids=(2, 5)))
    plain = spy.bench.slaves[5].sdo.handle
    spy.bench.slaves[5].sdo.handle = lambda data: [answer[:6] for answer in plain(data)]  # type: ignore[method-assign]
    first, second = scan(spy.link)
    assert (first.answers_sdo, first.problem) == (True, "")
    assert (second.node_id, second.answers_sdo) == (5, False)
    assert "was answered with a frame of 6 bytes, expected 8" in second.problem
    spy.link.close()


def test_a_node_that_answers_late_is_not_taken_for_its_neighbour() -> None:
    late = CanFault(CanFaultKind.SDO_LATE, size=0.15, count=1)
    spy = spied(CanBench(node_ids=(5, 20), faults={5: [late]}))
    assert [node.node_id for node in scan(spy.link, timeout_s=0.1)] == [20]
    assert [node.node_id for node in scan(spy.link, timeout_s=0.1)] == [5, 20]
    spy.link.close()


def test_listening_sends_nothing() -> None:
    spy = spied(CanBench(node_ids=(4, 9), parameters={(0x1017, 0): 200}))
    spy.bench.slaves[9].emergency(0xFF01)
    found = listen(spy.link, 1.0)
    assert found == [
        FoundNode(4, heard=("heartbeat",), nmt_state=NmtState.PRE_OPERATIONAL),
        FoundNode(9, heard=("EMCY", "heartbeat"), nmt_state=NmtState.PRE_OPERATIONAL),
    ]
    assert spy.sent == []
    spy.link.close()


def test_an_empty_bus_has_nobody() -> None:
    spy = spied(CanBench(node_ids=(5,), faults={5: [CanFault(CanFaultKind.NODE_DEAD)]}))
    assert scan(spy.link) == []
    assert listen(spy.link, 0.5) == []
    spy.link.close()
