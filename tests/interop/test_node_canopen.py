"""Both of our CANopen roles against a stack that nobody here wrote (npm's `canopen`), over real SocketCAN, in real time.

What they say to each other is compared with byte vectors where can-utils' candump saw it.
"""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.candump import Seen, candump
from support.node_peer import NodePeer, PeerError
from support.served_drive import served

from drivers.canopen.bus import CanLink
from drivers.canopen.node import NmtCommand, NmtState, NodeMonitor
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.pdo_setup import PdoSetup, read_image
from drivers.canopen.sdo import SdoClient
from drivers.canopen.whole_pdo import wanted_image
from drivers.cia402.objects import DataType, Entry
from drivers.clock import WallClock
from drivers.drive import DriveState
from drivers.errors import AbortError, LinkLostError
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.servo import SimulatedServo

pytestmark = [pytest.mark.vcan, pytest.mark.outside]

BUS = "vcan0"
DRIVE, PEER = 5, 0x20
LONG = pytest.mark.parametrize(
    ("length", "block"),
    [
        *(pytest.param(length, False, id=f"{length}-in-segments") for length in (5, 7, 8, 14, 250)),
        *(pytest.param(length, True, id=f"{length}-in-blocks") for length in (5, 7, 8, 889, 890, 2000)),
    ],
)
Until = Callable[[Callable[[], bool], str], None]


@pytest.fixture(scope="module")
def peer_process() -> Iterator[NodePeer]:
    prepare = Path(__file__).parent / "node_canopen" / "prepare.py"
    answer = subprocess.run([sys.executable, prepare], capture_output=True, text=True, check=False, timeout=400)
    if answer.returncode:
        pytest.skip(answer.stderr.strip())
    with NodePeer(Path(answer.stdout.strip()), BUS) as peer:
        yield peer


@pytest.fixture
def peer(peer_process: NodePeer) -> Iterator[NodePeer]:
    peer_process.events.clear()
    yield peer_process
    peer_process.ask("stop")


@pytest.fixture
def seen(tmp_path: Path) -> Iterator[Seen]:
    with candump(BUS, tmp_path) as seen:
        yield seen


def pattern(length: int) -> bytes:
    return bytes(number * 7 + 3 & 0xFF for number in range(length))


# -- their master, our slave -------------------------------------------------------------------------------------------


@pytest.fixture
def slave() -> Iterator[CanOpenSlave]:
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    with served(servo, WallClock(), interface="socketcan", channel=BUS, node_id=DRIVE) as slave:
        yield slave


def test_they_read_and_write(peer: NodePeer, slave: CanOpenSlave, seen: Seen) -> None:
    peer.ask("start", node=PEER, servers=[DRIVE])
    assert peer.upload(DRIVE, 0x1000) == (0x20192).to_bytes(4, "little")
    peer.download(DRIVE, 0x2210, 1, (4321).to_bytes(4, "little"))
    assert slave.dictionary.number(0x2210, 1) == 4321
    assert peer.upload(DRIVE, 0x1008) == b"Simulated feed axis servo drive"

    # CiA 301, 7.2.4.3: initiate upload, expedited; initiate download, expedited; initiate upload, with size
    wanted = [
        "605#4000100000000000",
        "585#4300100092010200",
        "605#23102201E1100000",
        "585#6010220100000000",
        "605#4008100000000000",
        "585#410810001F000000",
    ]
    assert seen()[: len(wanted)] == wanted


@pytest.mark.parametrize(
    ("index", "data", "code"),
    [
        (0x5000, b"\1", 0x06020000),  # no such object
        (0x1000, b"\1\0\0\0", 0x06010002),  # read only
        (0x605A, b"\x09\0", 0x06090031),  # quick stop option code: value too high
    ],
)
def test_they_are_told_what_is_wrong(peer: NodePeer, slave: CanOpenSlave, index: int, data: bytes, code: int) -> None:
    del slave
    peer.ask("start", node=PEER, servers=[DRIVE])
    with pytest.raises(PeerError) as refused:
        peer.download(DRIVE, index, 0, data)
    assert refused.value.code == code


@LONG
def test_they_transfer_long_objects(peer: NodePeer, slave: CanOpenSlave, length: int, block: bool) -> None:
    peer.ask("start", node=PEER, servers=[DRIVE])
    peer.download(DRIVE, 0x2100, 0, pattern(length), block=block)
    assert slave.dictionary.raw((0x2100, 0)) == pattern(length)
    assert peer.upload(DRIVE, 0x2100, block=block) == pattern(length)


def test_they_map_a_pdo_and_get_it_with_their_sync(peer: NodePeer, slave: CanOpenSlave) -> None:
    peer.ask(
        "start",
        node=PEER,
        servers=[DRIVE],
        objects=[{"index": 0x2000, "type": "UNSIGNED16"}, {"index": 0x2001, "type": "INTEGER32"}],
        rpdos=[{"cobId": 0x185, "transmissionType": 255, "objects": [0x2000, 0x2001]}],
    )
    for index, subindex, size, value in (
        (0x1800, 1, 4, 0xC0000185),  # CiA 301, 7.5.2.36: not valid, clear, map, set, valid
        (0x1A00, 0, 1, 0),
        (0x1A00, 1, 4, 0x60410010),
        (0x1A00, 2, 4, 0x60640020),
        (0x1A00, 0, 1, 2),
        (0x1800, 2, 1, 1),
        (0x1800, 1, 4, 0x40000185),
    ):
        peer.download(DRIVE, index, subindex, value.to_bytes(size, "little"))
    slave.servo.power_on()
    peer.ask("nmt", command="startNode")  # itself
    peer.ask("nmt", command="startNode", node=DRIVE)
    peer.ask("sync")
    event = peer.wait_event(lambda event: event["event"] == "pdo")
    assert event["cobId"] == 0x185
    assert event["values"][0] == slave.profile.statusword()
    assert abs(event["values"][1]) <= 1


def test_they_drive_it_by_rpdo_through_the_states_and_by_sdo_to_a_place(
    peer: NodePeer, slave: CanOpenSlave, until: Until
) -> None:
    peer.ask(
        "start",
        node=PEER,
        servers=[DRIVE],
        objects=[{"index": 0x2000, "type": "UNSIGNED16"}],
        tpdos=[{"cobId": 0x205, "transmissionType": 255, "objects": [0x2000]}],
    )
    assert slave.dictionary.number(0x1600, 1) == 0x60400010  # by default RPDO 1 begins with the controlword
    peer.download(DRIVE, 0x1400, 1, (0x80000205).to_bytes(4, "little"))
    peer.download(DRIVE, 0x1600, 0, b"\0")
    peer.download(DRIVE, 0x1600, 0, b"\1")
    peer.download(DRIVE, 0x1400, 1, (0x205).to_bytes(4, "little"))
    peer.download(DRIVE, 0x6060, 0, b"\1")
    peer.ask("nmt", command="startNode", node=DRIVE)
    peer.ask("nmt", command="startNode")  # itself

    def command(word: int) -> None:
        peer.ask("set", index=0x2000, value=word)
        peer.ask("write", cobId=0x205)

    for word, state in ((6, DriveState.READY), (7, DriveState.SWITCHED_ON), (15, DriveState.ENABLED)):
        command(word)
        until(lambda state=state: slave.profile.state is state, state.value)  # type: ignore[misc]

    peer.download(DRIVE, 0x6081, 0, (200_000).to_bytes(4, "little"))
    peer.download(DRIVE, 0x6083, 0, (2_000_000).to_bytes(4, "little"))
    peer.download(DRIVE, 0x6084, 0, (2_000_000).to_bytes(4, "little"))
    peer.download(DRIVE, 0x607A, 0, (50_000).to_bytes(4, "little"))
    command(0x1F)

    def arrived() -> bool:
        word = int.from_bytes(peer.upload(DRIVE, 0x6041), "little")
        place = int.from_bytes(peer.upload(DRIVE, 0x6064), "little", signed=True)
        return bool(word & 0x0400) and abs(place - 50_000) <= 20

    until(arrived, "their move has ended")


def test_they_hear_heartbeat_and_emergency(peer: NodePeer, slave: CanOpenSlave, seen: Seen) -> None:
    peer.ask("start", node=PEER, servers=[DRIVE], heartbeats=[{"node": DRIVE, "ms": 1000}], emergencies=[0x80 + DRIVE])
    peer.download(DRIVE, 0x1017, 0, (100).to_bytes(2, "little"))
    peer.wait_event(lambda event: event == {"event": "heartbeat", "node": DRIVE, "state": 0x7F})
    peer.ask("nmt", command="startNode", node=DRIVE)
    peer.wait_event(lambda event: event == {"event": "heartbeat", "node": DRIVE, "state": 0x05})
    slave.servo.raise_fault(0x3210)
    event = peer.wait_event(lambda event: event["event"] == "emergency")
    assert event["cobId"] == 0x80 + DRIVE
    assert (event["code"], event["register"]) == (0x3210, 0x05)  # generic and voltage
    peer.download(DRIVE, 0x1017, 0, (0).to_bytes(2, "little"))
    peer.wait_event(lambda event: event == {"event": "heartbeat lost", "node": DRIVE})
    assert {"000#0105", "705#7F", "705#05", "085#1032050000000000"} <= set(seen())


def test_it_misses_their_heartbeat(peer: NodePeer, slave: CanOpenSlave, until: Until) -> None:
    peer.ask("start", node=PEER, servers=[DRIVE], producerMs=100)
    peer.download(DRIVE, 0x1016, 1, (PEER << 16 | 1000).to_bytes(4, "little"))
    with CanLink.open(WallClock(), interface="socketcan", channel=BUS) as link:
        monitor = NodeMonitor(link, DRIVE, "ours")
        beats = NodeMonitor(link, PEER, "theirs")
        assert link.wait(lambda: beats.heartbeats >= 3, 20.0)
        peer.ask("stop")
        assert link.wait(lambda: monitor.last_error_code() == 0x8130, 20.0)
    assert slave.dictionary.number(0x1003, 1) & 0xFFFF == 0x8130


# -- our master, their slave -------------------------------------------------------------------------------------------


@pytest.fixture
def link() -> Iterator[CanLink]:
    with CanLink.open(WallClock(), interface="socketcan", channel=BUS) as link:
        yield link


@pytest.fixture
def sdo(link: CanLink) -> SdoClient:
    return SdoClient(link, DRIVE, "theirs", timeout_s=10.0)  # a guest is slow


THEIR_OBJECTS = [
    {"index": 0x2000, "type": "UNSIGNED16", "value": 0x0237},
    {"index": 0x2001, "type": "INTEGER32", "value": -123456},
    {"index": 0x2002, "type": "VISIBLE_STRING", "value": "a drive of somebody else"},
    {"index": 0x2003, "type": "UNSIGNED32", "value": 7, "access": "ro"},
    {"index": 0x2100, "type": "DOMAIN", "value": "00"},
]


def test_we_read_and_write(peer: NodePeer, sdo: SdoClient) -> None:
    peer.ask("start", node=DRIVE, serveTo=[PEER], objects=THEIR_OBJECTS)
    number = Entry(0x2001, 0, DataType.I32, "number")
    assert sdo.read(Entry(0x2000, 0, DataType.U16, "word")) == 0x0237
    assert sdo.read(number) == -123456
    sdo.write(number, 99)
    assert peer.ask("get", index=0x2001)["data"] == "63000000"
    assert sdo.read_bytes(0x2002, 0) == b"a drive of somebody else"
    with pytest.raises(AbortError) as refused:
        sdo.write(Entry(0x2003, 0, DataType.U32, "read only"), 1)
    assert refused.value.code == 0x06010002
    with pytest.raises(AbortError) as refused:
        sdo.read_bytes(0x5000, 0)
    assert refused.value.code == 0x06020000
    assert sdo.counters.timeouts == 0


@LONG
def test_we_transfer_long_objects(peer: NodePeer, sdo: SdoClient, length: int, block: bool) -> None:
    peer.ask("start", node=DRIVE, serveTo=[PEER], objects=THEIR_OBJECTS)
    sdo.write_bytes(0x2100, 0, pattern(length), block=block)
    assert bytes.fromhex(peer.ask("get", index=0x2100)["data"]) == pattern(length)
    assert sdo.read_bytes(0x2100, 0, block=block) == pattern(length)


STATUS = Entry(0x2000, 0, DataType.U16, "their status")
PLACE = Entry(0x2001, 0, DataType.I32, "their place")


def test_we_configure_a_pdo_of_theirs(peer: NodePeer, sdo: SdoClient) -> None:
    peer.ask(
        "start",
        node=DRIVE,
        serveTo=[PEER],
        objects=THEIR_OBJECTS,
        tpdos=[{"cobId": 0x185, "transmissionType": 255, "objects": [0x2001, 0x2000]}],
    )
    spec = PdoSpec(1, True, 0x185, SYNC_EVERY, (STATUS, PLACE))
    PdoSetup(sdo, sdo.node_id, (spec,)).apply(refuse=False)
    assert read_image(sdo, spec.pdo).holds(wanted_image(spec))


def test_we_get_their_pdo_with_our_sync_and_they_get_ours(peer: NodePeer, link: CanLink) -> None:
    peer.ask(
        "start",
        node=DRIVE,
        objects=[*THEIR_OBJECTS, {"index": 0x2010, "type": "UNSIGNED16"}, {"index": 0x2011, "type": "INTEGER32"}],
        tpdos=[{"cobId": 0x185, "transmissionType": 1, "objects": [0x2000, 0x2001]}],
        rpdos=[{"cobId": 0x205, "transmissionType": 255, "objects": [0x2010, 0x2011]}],
    )
    monitor = NodeMonitor(link, DRIVE, "theirs")
    spec = PdoSpec(1, True, 0x185, SYNC_EVERY, (STATUS, PLACE))
    received: list[tuple[int, ...]] = []
    link.subscribe(spec.cob_id, lambda _time_ns, data: received.append(spec.codec.unpack(data)))
    monitor.command(NmtCommand.START)
    peer.wait_event(lambda event: event == {"event": "state", "state": NmtState.OPERATIONAL})
    link.send(0x080, b"")
    assert link.wait(lambda: bool(received), 20.0)
    assert received == [(0x0237, -123456)]

    link.send(0x205, struct.pack("<Hi", 0x001F, -70_000))
    event = peer.wait_event(lambda event: event["event"] == "pdo")
    assert event == {"event": "pdo", "cobId": 0x205, "values": [0x001F, -70_000]}


def test_we_hear_their_heartbeat_and_emergency_and_miss_them(peer: NodePeer, link: CanLink) -> None:
    with ExitStack() as stack:
        monitor = NodeMonitor(link, DRIVE, "theirs")
        stack.callback(monitor.close)
        peer.ask("start", node=DRIVE, producerMs=50, emergencyId=0x80 + DRIVE, objects=THEIR_OBJECTS)
        monitor.expect_heartbeat(20.0)
        assert link.wait(lambda: monitor.state is NmtState.PRE_OPERATIONAL, 20.0)
        monitor.command(NmtCommand.START)
        assert link.wait(lambda: monitor.state is NmtState.OPERATIONAL, 20.0)
        monitor.check()

        peer.ask("emergency", code=0x8611, info="0102030405")
        assert link.wait(lambda: len(monitor.log) == 1, 20.0)
        assert monitor.log[-1].code == 0x8611
        assert monitor.log[-1].extra == bytes((1, 2, 3, 4, 5))
        assert str(monitor.log[-1]).startswith("following error (8611h)")

        monitor.expect_heartbeat(0.5)
        peer.ask("stop")
        link.wait(lambda: False, 1.5)
        with pytest.raises(LinkLostError, match="no heartbeat of node 5"):
            monitor.check()
