"""A table of 8 kB as one domain: how fast it goes by block transfer, and what a CANopen stack that nobody here wrote makes of it."""

from __future__ import annotations

import random
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import canopen
import pytest
from support import their_canopen
from support.can_bench import CanBench
from support.served_drive import served

from drivers.canopen.bus import CanLink
from drivers.canopen.correction_table import CanOpenCorrectionTable
from drivers.canopen.node import Node
from drivers.canopen.table_map import load_table_map
from drivers.canopen.wire_time import table_s
from drivers.cia402.objects import DataType, Entry
from drivers.clock import WallClock
from drivers.correction_table import RawTable
from drivers.errors import ProtocolError
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import EDS
from sim_backends.own_table import ARRAY, error_domain
from sim_backends.servo import SimulatedServo

NODE, DOMAIN = 7, 0x2321
POINTS = 1000  # of eight bytes
LIMIT_KB_S = 51.0
"""What block transfer can do at 1 Mbit/s with the worst stuffing (seven bytes in 135 bits, and the acknowledgements)."""


def table(points: int = POINTS) -> RawTable:
    """Positions with noise-like values: about as many stuff bits as a real table has."""
    generator = random.Random(8)
    plus, minus = (tuple(generator.randint(-3000, 3000) for _ in range(points)) for _ in range(2))
    return RawTable(plus, minus, tuple(generator.randint(0, 400) + 500 * place for place in range(points)))


def test_a_table_of_8_kb_by_block_transfer_at_1_mbit_s(record_property: pytest.RecordProperty) -> None:
    bench = CanBench(node_ids=(NODE,), bitrate=1_000_000, table=error_domain(10.0))
    with CanLink(bench.port(), bench.clock) as link:
        node = Node("X", link, NODE)
        node.open()
        held = CanOpenCorrectionTable(node, load_table_map("simulated_domain"))
        wanted = table()
        start_ns = bench.clock.now_ns()
        held.write(wanted)
        written_ns = bench.clock.now_ns()
        assert held.read() == wanted
        read_ns = bench.clock.now_ns()
    kb_s = {
        "written": 8e9 / (written_ns - start_ns),
        "read back": 8e9 / (read_ns - written_ns),
    }
    for what, rate in kb_s.items():
        record_property(what, f"{rate:.1f} kB/s, {rate / LIMIT_KB_S:.2f} of the limit")
        assert 0.85 * LIMIT_KB_S <= rate <= 7e3 / 111, what  # never faster than frames without a stuff bit
    assert held.pack(wanted) == bench.slave.dictionary.raw((DOMAIN, 0))
    predicted_ns = 1e9 * table_s(held.map, wanted, 1_000_000)
    assert 0.8 * predicted_ns < read_ns - start_ns <= predicted_ns


def test_what_an_array_takes_is_predicted_to_the_frame() -> None:
    bench = CanBench(node_ids=(NODE,), bitrate=1_000_000, table=ARRAY)
    with CanLink(bench.port(), bench.clock) as link:
        node = Node("X", link, NODE)
        node.open()
        held = CanOpenCorrectionTable(node, load_table_map("simulated_array"))
        wanted = RawTable(tuple(range(30)), tuple(range(0, -30, -1)), (), -500, 1000)
        bench.clock.sleep_s(0.001)  # the boot-up message is through
        start_ns, frames = bench.clock.now_ns(), bench.wire.frames
        held.write(wanted)
        assert held.read() == wanted
    predicted_s = table_s(held.map, wanted, 1_000_000)
    assert predicted_s == pytest.approx((bench.wire.frames - frames) * 135e-6)
    assert (bench.clock.now_ns() - start_ns) * 1e-9 <= predicted_s


@pytest.mark.parametrize("name", ["simulated_array", "simulated_domain"])
def test_a_switch_that_is_neither_on_nor_off_is_said(name: str) -> None:
    bench = CanBench(node_ids=(NODE,), table=ARRAY if name == "simulated_array" else error_domain(10.0))
    with CanLink(bench.port(), bench.clock) as link:
        node = Node("X", link, NODE)
        node.open()
        held = CanOpenCorrectionTable(node, load_table_map(name))
        bench.slave.dictionary.on_read(held.map.enable.index, held.map.enable.subindex, lambda: 7)
        with pytest.raises(ProtocolError, match=r"is 7, expected 1 \(on\) or 0 \(off\)"):
            held.switch(False)


@pytest.fixture
def quiet_library() -> Iterator[None]:
    with their_canopen.quiet():
        yield


@contextmanager
def their_turn(channel: str) -> Iterator[canopen.RemoteNode]:
    """Their master, on the bus while it is asked only: it takes answers to another master's requests for its own."""
    with ExitStack() as stack:
        yield their_canopen.network(stack, channel).add_node(NODE, str(EDS))


@pytest.mark.usefixtures("quiet_library")
def test_their_master_reads_by_block_what_ours_wrote_and_ours_what_theirs_wrote() -> None:
    channel = uuid.uuid4().hex
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    with ExitStack() as stack:
        form = error_domain(10.0)
        slave = stack.enter_context(served(servo, WallClock(), channel=channel, node_id=NODE, table=form))
        link = stack.enter_context(CanLink.open(WallClock(), interface="virtual", channel=channel))
        node = Node("X", link, NODE)
        node.open(5.0)
        held = CanOpenCorrectionTable(node, load_table_map("simulated_domain"))
        first, second = table(), table(300)
        data = held.pack(second)
        held.write(first)
        with their_turn(channel) as theirs:
            with theirs.sdo.open(DOMAIN, 0, "rb", block_transfer=True) as stream:
                assert stream.read() == held.pack(first)
            with theirs.sdo.open(DOMAIN, 0, "wb", size=len(data), block_transfer=True) as stream:
                stream.write(data)
        assert held.read() == second
        held.switch(True)
        with their_turn(channel) as theirs:
            assert theirs.sdo.upload(0x2320, 0) == b"\x01"
            with pytest.raises(canopen.SdoAbortedError, match="0x08000022"):  # while it corrects by it
                theirs.sdo.download(DOMAIN, 0, bytes(16))
        assert slave.table is not None
        assert slave.table.table.enabled


@pytest.mark.usefixtures("quiet_library")
def test_a_drive_of_theirs_without_block_transfer_gets_it_in_segments() -> None:
    """The trace buffer of the EDS stands in for the table: their drive knows no other domain, and no block transfer."""
    channel = uuid.uuid4().hex
    with ExitStack() as stack:
        node = their_canopen.network(stack, channel).create_node(NODE, str(EDS))
        link = stack.enter_context(CanLink.open(WallClock(), interface="virtual", channel=channel))
        ours = Node("theirs", link, NODE)
        ours.open(5.0)
        buffer = Entry(0x2100, 0, DataType.DOMAIN, "trace buffer")
        table_map = replace(load_table_map("simulated_domain"), domain=buffer, scalars={})
        held = CanOpenCorrectionTable(ours, table_map)
        wanted = table(60)
        held.write(wanted)
        assert node.sdo.upload(0x2100, 0) == held.pack(wanted)
        assert held.read() == wanted
