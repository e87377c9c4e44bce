"""The ground the CANopen tests stand on: frames, SDO and the kernel's periodic SYNC really cross SocketCAN."""

from collections.abc import Callable, Iterator
from pathlib import Path

import can
import canopen
import pytest
from can.interfaces.socketcan import CyclicSendTask
from support.candump import candump

pytestmark = pytest.mark.vcan

SYNC = 0x080


@pytest.fixture
def bus() -> Iterator[Callable[[str], can.BusABC]]:
    """bus(interface): one more socket on that interface, closed at the end."""
    opened: list[can.BusABC] = []

    def open_bus(interface: str) -> can.BusABC:
        opened.append(can.Bus(interface="socketcan", channel=interface))
        return opened[-1]

    yield open_bus
    for each in opened:
        each.shutdown()


@pytest.mark.parametrize(
    "message",
    [
        can.Message(
            arbitration_id=0x000, data=b"\x01\x05", is_extended_id=False
        ),  # CiA 301 7.3.2.2.1: NMT start node 5
        can.Message(arbitration_id=0x7FF, data=bytes(range(8)), is_extended_id=False),
        can.Message(arbitration_id=0x1FFFFFFF, data=b"", is_extended_id=True),
        can.Message(arbitration_id=0x605, is_remote_frame=True, dlc=8, is_extended_id=False),
    ],
    ids=["nmt", "full", "extended", "remote"],
)
def test_a_frame_arrives_as_it_was_sent_and_only_on_its_bus(
    bus: Callable[[str], can.BusABC], message: can.Message
) -> None:
    sender, receiver, elsewhere = bus("vcan0"), bus("vcan0"), bus("vcan1")
    sender.send(message)
    received = receiver.recv(5.0)
    assert received is not None
    assert received.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert elsewhere.recv(0.05) is None


def test_candump_sees_what_is_sent(bus: Callable[[str], can.BusABC], tmp_path: Path) -> None:
    sender = bus("vcan0")
    with candump("vcan0", tmp_path) as seen:
        sender.send(can.Message(arbitration_id=0x605, data=bytes.fromhex("4041600000000000"), is_extended_id=False))
        assert seen() == ["605#4041600000000000"]


def test_the_kernel_sends_sync_by_itself(bus: Callable[[str], can.BusABC]) -> None:
    period_s, wanted = 0.02, 25
    master, slave = bus("vcan0"), bus("vcan0")
    task = master.send_periodic(can.Message(arbitration_id=SYNC, is_extended_id=False), period_s)
    assert isinstance(task, CyclicSendTask), "the broadcast manager of the kernel, not a thread of Python"
    frames = [slave.recv(5.0) for _ in range(wanted)]
    task.stop()

    stamps = []
    for frame in frames:
        assert frame is not None
        assert (frame.arbitration_id, bytes(frame.data), frame.is_extended_id) == (SYNC, b"", False)
        stamps.append(frame.timestamp)
    mean_s = (stamps[-1] - stamps[0]) / (wanted - 1)
    assert 0.9 * period_s < mean_s < 10 * period_s  # a guest may be slow, but must not be fast
    while slave.recv(0.0) is not None:  # sent before stop()
        pass
    assert slave.recv(period_s * 10) is None, "it goes on after stop()"


def test_sdo_crosses_two_networks() -> None:
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
    entry = canopen.objectdictionary.ODVariable("Target position", 0x607A)
    entry.data_type = canopen.objectdictionary.INTEGER32
    entry.access_type = "rw"
    dictionary.add_object(entry)
    master, slave = canopen.Network(), canopen.Network()
    try:
        for network in (master, slave):
            network.connect(interface="socketcan", channel="vcan0")
        slave.create_node(5, dictionary)
        remote = master.add_node(5, dictionary)
        remote.sdo.RESPONSE_TIMEOUT = 5.0
        remote.sdo[0x607A].raw = -123456
        assert remote.sdo[0x607A].raw == -123456
    finally:
        master.disconnect()
        slave.disconnect()
