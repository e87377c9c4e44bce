"""Our master against a slave, and our slave against a master, that nobody here wrote: the `canopen` package's own.

In this process, on python-can's virtual bus, in real time. Other stacks on SocketCAN are met in the guest.
"""

import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import canopen
import pytest
from support import their_canopen
from support.parameter_faults import KilledError
from support.served_drive import served

from drivers.canopen import cia301
from drivers.canopen.bus import CanLink
from drivers.canopen.eds import load_eds
from drivers.canopen.node import NmtCommand, NmtState, Node, NodeMonitor
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.pdo_setup import PdoSetup, read_image
from drivers.canopen.raw_parameters import CanOpenRawParameters
from drivers.canopen.sdo import SdoClient
from drivers.canopen.side_by_side import CanLine
from drivers.canopen.whole_pdo import wanted_image
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.clock import WallClock
from drivers.drive import DriveState
from drivers.errors import AbortError
from hil.parameters.compare import compare
from hil.parameters.download import download
from hil.parameters.formats import read_any, write_any
from hil.parameters.journal import Journal
from hil.parameters.recover import recover
from hil.parameters.report import Ending
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.snapshot import back_up
from hil.parameters.transaction import Target
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import EDS, CanOpenSlave
from sim_backends.servo import SimulatedServo

NODE = 7
GAIN = Entry(0x2210, 1, DataType.U32, "proportional gain")


@pytest.fixture(autouse=True)
def quiet_library() -> Iterator[None]:
    with their_canopen.quiet():
        yield


# -- their master, our slave -------------------------------------------------------------------------------------------


@pytest.fixture
def theirs() -> Iterator[tuple[canopen.RemoteNode, CanOpenSlave, SimulatedServo]]:
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    channel = uuid.uuid4().hex
    with ExitStack() as stack:
        network = their_canopen.network(stack, channel)
        node = network.add_node(NODE, str(EDS))
        slave = stack.enter_context(served(servo, WallClock(), channel=channel, node_id=NODE))
        yield node, slave, servo


Theirs = tuple[canopen.RemoteNode, CanOpenSlave, SimulatedServo]


def test_boot_up_reaches_them(theirs: Theirs, until: Callable[..., None]) -> None:
    node, _, _ = theirs
    node.network.nmt.send_command(0x81)
    until(lambda: node.nmt.state == "PRE-OPERATIONAL", "their master has heard the boot-up")


def test_they_read_and_write(theirs: Theirs) -> None:
    node, slave, _ = theirs
    assert node.sdo["Device type"].raw == 0x20192
    assert node.sdo["Manufacturer device name"].raw == "Simulated feed axis servo drive"
    node.sdo["Position controller"]["Proportional gain"].raw = 4321
    assert slave.dictionary.number(0x2210, 1) == 4321
    with pytest.raises(canopen.SdoAbortedError, match="0x06090031"):
        node.sdo["Quick stop option code"].raw = 9
    with pytest.raises(canopen.SdoAbortedError, match="0x06020000"):
        node.sdo.upload(0x5000, 0)


@pytest.mark.parametrize("length", [0, 1, 4, 5, 7, 8, 14, 700, 889, 890, 5000])
def test_they_transfer_blocks(theirs: Theirs, length: int) -> None:
    node, slave, _ = theirs
    data = bytes(number * 7 & 0xFF for number in range(length))
    if length:
        with node.sdo.open(0x2100, 0, "wb", size=length, block_transfer=True) as stream:
            stream.write(data)
        assert slave.dictionary.raw((0x2100, 0)) == data
        with node.sdo.open(0x2100, 0, "rb", block_transfer=True) as stream:
            assert stream.read() == data
    node.sdo.download(0x2100, 0, data, force_segment=True)
    assert node.sdo.upload(0x2100, 0) == data


def test_they_configure_pdos_and_get_them_on_sync(theirs: Theirs) -> None:
    node, slave, _ = theirs
    node.nmt.state = "PRE-OPERATIONAL"
    node.tpdo.read()
    tpdo = node.tpdo[1]
    tpdo.clear()
    tpdo.add_variable("Statusword")
    tpdo.add_variable("Position actual value")
    tpdo.add_variable("Torque actual value")
    tpdo.trans_type = 1
    tpdo.enabled = True
    tpdo.save()
    node.nmt.state = "OPERATIONAL"
    slave.servo.power_on()
    received = []
    tpdo.add_callback(lambda mapped: received.append([variable.raw for variable in mapped]))
    node.network.sync.transmit()
    tpdo.wait_for_reception(1.0)
    assert received
    assert received[-1][0] == slave.profile.statusword()
    assert received[-1][1] == 0


def test_they_drive_it_through_the_states_by_rpdo(theirs: Theirs, until: Callable[..., None]) -> None:
    node, slave, _ = theirs
    node.nmt.state = "PRE-OPERATIONAL"
    node.rpdo.read()
    node.nmt.state = "OPERATIONAL"
    for word, state in ((6, DriveState.READY), (7, DriveState.SWITCHED_ON), (15, DriveState.ENABLED)):
        node.rpdo[1]["Controlword"].raw = word
        node.rpdo[1].transmit()
        until(lambda state=state: slave.profile.state is state, state.value)


def test_heartbeat_and_emergency_reach_them(theirs: Theirs) -> None:
    node, _, servo = theirs
    node.sdo["Producer heartbeat time"].raw = 20
    node.nmt.state = "OPERATIONAL"
    node.nmt.wait_for_heartbeat(1.0)
    assert node.nmt.state == "OPERATIONAL"
    servo.raise_fault(0x3210)
    emergency = node.emcy.wait(0x3210, 1.0)
    assert emergency.code == 0x3210
    assert emergency.register == 0x05  # generic and voltage
    assert node.sdo["Pre-defined error field"][1].raw & 0xFFFF == 0x3210


# -- our master, their slave ------------------------------------------------------------------------------------------


@pytest.fixture
def ours() -> Iterator[tuple[CanLink, canopen.LocalNode]]:
    channel = uuid.uuid4().hex
    with ExitStack() as stack:
        network = their_canopen.network(stack, channel)
        node = network.create_node(NODE, str(EDS))
        link = stack.enter_context(CanLink.open(WallClock(), interface="virtual", channel=channel))
        yield link, node


Ours = tuple[CanLink, canopen.LocalNode]


def test_we_read_and_write(ours: Ours) -> None:
    link, node = ours
    sdo = SdoClient(link, NODE, "theirs")
    assert sdo.read(cia301.DEVICE_TYPE) == 0x20192
    assert sdo.read_bytes(0x1008, 0) == b"Simulated feed axis servo drive"
    sdo.write(GAIN, 99)
    assert node.sdo[0x2210][1].raw == 99
    with pytest.raises(AbortError, match="object does not exist"):
        sdo.read_bytes(0x5000, 0)


@pytest.mark.parametrize("length", [1, 4, 5, 7, 8, 14, 1000])
def test_we_transfer_segments_and_follow_their_fall_back_from_block(ours: Ours, length: int) -> None:
    link, _ = ours
    sdo = SdoClient(link, NODE, "theirs")
    data = bytes(number * 5 & 0xFF for number in range(length))
    sdo.write_bytes(0x2100, 0, data)
    assert sdo.read_bytes(0x2100, 0) == data
    assert sdo.read_bytes(0x2100, 0, block=True) == data


def test_we_write_a_pdo_configuration_that_they_understand(ours: Ours) -> None:
    link, node = ours
    sdo = SdoClient(link, NODE, "theirs")
    spec = PdoSpec(1, True, 0x180 + NODE, SYNC_EVERY, (objects.STATUSWORD, objects.POSITION_ACTUAL))
    PdoSetup(sdo, sdo.node_id, (spec,)).apply(refuse=False)
    assert read_image(sdo, spec.pdo).holds(wanted_image(spec))
    assert node.sdo[0x1A00][1].raw == 0x60410010
    assert node.sdo[0x1A00][2].raw == 0x60640020
    assert node.sdo[0x1800][2].raw == 1


def test_we_hear_their_heartbeat_boot_up_and_emergency(ours: Ours) -> None:
    link, node = ours
    monitor = NodeMonitor(link, NODE, "theirs")
    node.nmt.state = "INITIALISING"
    node.nmt.state = "PRE-OPERATIONAL"
    assert link.wait(lambda: monitor.boot_ups == 1, 1.0)
    node.sdo[0x1017].raw = 20
    node.nmt.start_heartbeat(20)
    assert link.wait(lambda: monitor.state is NmtState.PRE_OPERATIONAL, 1.0)
    monitor.command(NmtCommand.START)
    assert link.wait(lambda: monitor.state is NmtState.OPERATIONAL, 1.0)
    node.emcy.send(0x8611, 0x20, b"\x01\x02\x03\x04\x05")
    assert link.wait(lambda: len(monitor.log) == 1, 1.0)
    assert str(monitor.log[0]) == "following error (8611h), register 20h, extra 0102030405"
    node.nmt.stop_heartbeat()


def test_a_parameter_set_goes_into_their_node_and_out_again(ours: Ours, tmp_path: Path) -> None:
    """Written and read back; cut off in the middle and finished both ways; put back when they refuse one entry; as DCF."""
    link, node = ours
    node.sdo[0x6041].raw = 0x0250  # switch on disabled
    node.sdo[0x2101].raw = "as found"  # theirs has no value where its EDS has no default, and says so when it is read
    opened = Node("theirs", link, NODE, load_eds(EDS, NODE))
    opened.open()
    drive = CanOpenRawParameters(opened, CanLine(link))
    journal = Journal(tmp_path)
    backup = back_up([drive])[0].contents
    assert backup is not None
    assert len(backup.entries) > 30
    keys = {
        "2210h:01": 4321,
        "605Ah:00": 6,
        "6065h:00": 12_345,
        "2101h:00": "spare drive",
        "607Ch:00": -77,
        "6067h:00": 5,
    }
    new = ParameterSet("new", None, tuple(SetEntry(address, value) for address, value in keys.items()))
    before = replace(backup, entries=tuple(entry for entry in backup.entries if entry.address in keys), hash=None)
    assert download([Target(drive, new, journal)])[0].ending is Ending.WRITTEN
    assert (node.sdo[0x2210][1].raw, node.sdo[0x607C].raw, node.sdo[0x2101].raw) == (4321, -77, "spare drive")

    def cut_off(stage: str, _drive: str, done: int, _total: int) -> None:
        if stage == "write" and done >= 3:
            raise KilledError

    for forward, held in ((False, new), (True, before)):
        with pytest.raises(KilledError):
            download([Target(drive, before, journal)], progress=cut_off)
        drive.clock.sleep_s(0.01)
        assert recover([(drive, journal)], forward=forward)[0].good
        assert compare([(drive, held)])[0].same

    def refuse(index: int, subindex: int, od: object, data: bytes) -> None:
        if (index, subindex) == (0x607C, 0) and data == (-77).to_bytes(4, "little", signed=True):
            raise canopen.SdoAbortedError(0x06090030)

    node.add_write_callback(lambda index, subindex, od, data: refuse(index, subindex, od, bytes(data)))
    assert download([Target(drive, new, journal)])[0].ending is Ending.PUT_BACK
    assert compare([(drive, before)])[0].same
    path = tmp_path / "theirs.dcf"
    write_any(path, before, drive, None, EDS)
    assert {(entry.address, entry.value) for entry in read_any(path).entries} == {
        (entry.address, entry.value) for entry in before.entries
    }
    opened.close()
