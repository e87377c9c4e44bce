"""Each fault of the CAN libraries that the field notes name: shown to be there, and shown not to reach us.

If one of the first halves fails after an update of a library, its fault has gone and the wrapper may be reconsidered.
Runs on python-can's in-process bus, in real time.
"""

import logging
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.node import NmtCommand, NodeMonitor
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.pdo_setup import configure
from drivers.canopen.sdo import SdoClient
from drivers.cia402 import objects
from drivers.cia402.modes import Mode
from drivers.clock import WallClock
from drivers.drive import DriveLimits, DriveState
from drivers.errors import AbortError, DriveFaultError, NoAnswerError, ProtocolError
from drivers.scaling import AxisScaling
from sim_backends.canopen_bench import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import EDS, CanOpenSlave, served
from sim_backends.canopen_faults import CanFault, CanFaultKind
from sim_backends.servo import SimulatedServo

NODE = 5
LIMITS = DriveLimits(-300.0, 300.0, 200.0, 2000.0)
ENABLED = DriveState.ENABLED


@dataclass
class Rig:
    slave: CanOpenSlave
    servo: SimulatedServo
    channel: str
    stack: ExitStack

    def foreign(self) -> BaseNode402:
        """The library's own CiA-402 node, set up as its documentation says."""
        network = canopen.Network()
        network.NOTIFIER_CYCLE = 0.02  # how long its receiver takes to end
        network.connect(interface="virtual", channel=self.channel)
        self.stack.callback(network.disconnect)
        node = BaseNode402(NODE, str(EDS))
        network.add_node(node)
        node.nmt.state = "PRE-OPERATIONAL"
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        return node

    def link(self) -> CanLink:
        return self.stack.enter_context(CanLink.open(WallClock(), interface="virtual", channel=self.channel))

    def ours(self, mode_timeout_s: float = 1.0) -> CanOpenDrive:
        settings = CanOpenSettings(heartbeat_s=None, mode_timeout_s=mode_timeout_s)
        link = self.link()
        drive = CanOpenDrive(
            "X", AxisScaling(100_000, 10.0), LIMITS, link.clock, link=link, node_id=NODE, settings=settings
        )
        self.stack.enter_context(drive)
        return drive


@contextmanager
def _rig(*faults: CanFault) -> Iterator[Rig]:
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    channel = uuid.uuid4().hex
    with ExitStack() as stack:
        slave = stack.enter_context(served(servo, WallClock(), channel=channel, node_id=NODE, faults=faults))
        yield Rig(slave, servo, channel, stack)


@pytest.fixture
def rig() -> Iterator[Rig]:
    with _rig() as rig:
        yield rig


@pytest.fixture(autouse=True)
def quiet_library() -> Iterator[None]:
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    yield
    logging.getLogger("canopen").setLevel(logging.NOTSET)


# -- SDO download: the reply's index is not checked -----------------------------------------------------------------------

LATE_TWICE = CanFault(CanFaultKind.SDO_LATE, size=0.45, count=2)


def test_the_library_takes_a_late_reply_for_that_of_the_next_write() -> None:
    with _rig(LATE_TWICE) as rig:
        network = canopen.Network()
        network.connect(interface="virtual", channel=rig.channel)
        rig.stack.callback(network.disconnect)
        node = network.add_node(NODE, str(EDS))
        with pytest.raises(canopen.SdoCommunicationError):
            node.sdo.download(0x607C, 0, (1).to_bytes(4, "little"))
        node.sdo.download(0x605A, 0, (9).to_bytes(2, "little"))  # returns as if it had been taken
        assert rig.slave.dictionary.number(0x605A) == 2


def test_ours_reports_the_rejected_write() -> None:
    with _rig(LATE_TWICE) as rig:
        sdo = SdoClient(rig.link(), NODE, "drive X", timeout_s=0.3)
        sdo.write(objects.HOME_OFFSET, 1)
        with pytest.raises(AbortError, match="605Ah"):
            sdo.write(objects.QUICK_STOP_OPTION, 9)


# -- p402: setting the mode drops the axis ---------------------------------------------------------------------------------


def test_the_library_drops_the_axis_when_the_mode_is_set(rig: Rig, until: Callable[..., None]) -> None:
    node = rig.foreign()
    node.state = "OPERATION ENABLED"
    assert rig.slave.profile.state is ENABLED
    node.op_mode = "PROFILED VELOCITY"
    until(lambda: rig.slave.profile.state is not ENABLED, "the axis drops out of operation enabled")
    assert not rig.servo.powered


def test_ours_keeps_the_axis_when_the_mode_is_set(rig: Rig) -> None:
    drive = rig.ours()
    drive.enable()
    for mode in (Mode.PROFILE_VELOCITY, Mode.CYCLIC_POSITION, Mode.PROFILE_POSITION, Mode.HOMING, Mode.CYCLIC_VELOCITY):
        drive.set_mode(mode)
        assert drive.sample().state is ENABLED
        assert rig.servo.powered


# -- p402: setters log and return, the check of the NMT state checks nothing ----------------------------------------------


DEAF_TO_MODES = CanFault(CanFaultKind.MODE_STUCK)


def test_the_librarys_setter_logs_a_mode_that_does_not_come_and_returns(caplog: pytest.LogCaptureFixture) -> None:
    with _rig(DEAF_TO_MODES) as rig:
        node = rig.foreign()
        logging.getLogger("canopen").setLevel(logging.WARNING)
        node.op_mode = "PROFILED VELOCITY"
        assert "Timeout setting node 5's new mode" in caplog.text
        assert rig.slave.dictionary.number(0x6061) == 0


def test_ours_raises_for_a_mode_that_does_not_come() -> None:
    with _rig(DEAF_TO_MODES) as rig, pytest.raises(ProtocolError, match="mode 3 was written, 6061h"):
        rig.ours(mode_timeout_s=0.1).set_mode(Mode.PROFILE_VELOCITY)


def test_the_library_believes_the_state_it_has_commanded_itself() -> None:
    """Nobody is on the bus, and its check for a state in which SDO works is passed all the same."""
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.02
    network.connect(interface="virtual", channel=uuid.uuid4().hex)
    try:
        node = BaseNode402(NODE, str(EDS))
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 0.02
        node.nmt.state = "PRE-OPERATIONAL"
        assert node.nmt.state == "PRE-OPERATIONAL"
        with pytest.raises(canopen.SdoCommunicationError):
            node.setup_402_state_machine()
    finally:
        network.disconnect()


def test_ours_knows_no_state_that_it_has_not_heard() -> None:
    clock = WallClock()
    with CanLink.open(clock, interface="virtual", channel=uuid.uuid4().hex) as link:
        monitor = NodeMonitor(link, NODE, "drive X")
        monitor.command(NmtCommand.PRE_OPERATIONAL)
        assert monitor.state is None
        settings = CanOpenSettings(sdo_timeout_s=0.02)
        scaling = AxisScaling(100_000, 10.0)
        drive = CanOpenDrive("X", scaling, LIMITS, clock, link=link, node_id=NODE, settings=settings)
        with pytest.raises(NoAnswerError, match="drive X"):
            drive.open()


# -- p402: a fault reset times out, and then enables -----------------------------------------------------------------------


def test_the_library_enables_after_a_fault_reset(rig: Rig, until: Callable[..., None]) -> None:
    node = rig.foreign()
    rig.servo.raise_fault(0x3210)
    until(lambda: node.state == "FAULT", "the fault is seen")
    node.reset_from_fault()
    assert rig.slave.profile.state is ENABLED  # nobody asked for that


def test_ours_leaves_the_axis_disabled_after_a_fault_reset(rig: Rig) -> None:
    drive = rig.ours()
    rig.servo.raise_fault(0x3210)
    drive.wait_for(lambda sample: sample.state is DriveState.FAULT, 1.0, "fault")
    drive.reset_fault()
    assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
    assert not rig.servo.powered


# -- p402: homing() turns a fault into False --------------------------------------------------------------------------------


def test_the_library_calls_a_fault_during_homing_false(rig: Rig) -> None:
    node = rig.foreign()
    node.sdo[0x6098].raw = 17  # to the limit switch, which is far away
    node.sdo[0x6099][1].raw = 1000
    trip = threading.Timer(0.3, rig.servo.raise_fault, [0x3210])
    trip.start()
    assert node.homing(timeout=10) is False  # no word of the fault
    trip.join()
    assert rig.servo.fault_code == 0x3210


def test_ours_shows_a_fault_during_homing(rig: Rig) -> None:
    drive = rig.ours()
    drive.enable()
    drive.sdo.write(objects.HOMING_METHOD, 17)
    drive.start_homing()
    rig.servo.raise_fault(0x3210)
    sample = drive.wait_for(lambda sample: sample.state is DriveState.FAULT, 2.0, "fault")
    assert sample.fault_code == 0x3210
    assert sample.homed is False


def test_ours_raises_when_homing_fails(rig: Rig) -> None:
    drive = rig.ours()
    drive.enable()
    drive.sdo.write(objects.HOMING_METHOD, -4)  # allowed by the dictionary, not supported by the motor
    drive.start_homing()
    with pytest.raises(DriveFaultError, match="homing failed"):
        drive.wait_for(lambda sample: bool(sample.homed), 2.0, "homed")


# -- p402: no set-point handshake --------------------------------------------------------------------------------------------


def test_the_library_has_no_setpoint_handshake_and_no_touch_probe() -> None:
    names = " ".join(name.lower() for name in dir(BaseNode402))
    assert "setpoint" not in names
    assert "set_point" not in names
    assert "probe" not in names


def test_ours_moves_only_what_was_acknowledged(rig: Rig) -> None:
    drive = rig.ours()
    drive.enable()
    drive.start_move(1.0, 50.0)
    arrived = drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
    assert arrived.position_load_mm == pytest.approx(1.0, abs=1e-3)


# -- LocalNode: no SYNC-triggered TPDO, no block transfer --------------------------------------------------------------------


@contextmanager
def _local_node(stack: ExitStack) -> Iterator[str]:
    channel = uuid.uuid4().hex
    network = canopen.Network()
    network.connect(interface="virtual", channel=channel)
    stack.callback(network.disconnect)
    node = network.create_node(NODE, str(EDS))
    for index, value in ((0x6041, 0x0250), (0x6064, 1234)):
        node.sdo[index].raw = value
    node.nmt.state = "PRE-OPERATIONAL"
    yield channel


def test_the_library_slave_does_not_answer_sync_and_ours_does(rig: Rig) -> None:
    spec = PdoSpec(1, True, 0x180 + NODE, SYNC_EVERY, (objects.STATUSWORD, objects.POSITION_ACTUAL))
    with ExitStack() as stack, _local_node(stack) as channel:
        link = stack.enter_context(CanLink.open(WallClock(), interface="virtual", channel=channel))
        heard: list[bytes] = []
        link.subscribe(spec.cob_id, lambda _time_ns, data: heard.append(data))
        link.send(0x000, b"\x01\x05")
        configure(SdoClient(link, NODE, "local node"), spec)
        link.send(0x080, b"")
        assert not link.wait(lambda: bool(heard), 0.3)
    drive = rig.ours()
    assert drive.sample().position_load_mm == 0.0


def test_the_library_server_knows_no_block_download_and_ours_does(rig: Rig) -> None:
    data = bytes(range(256)) * 4
    with ExitStack() as stack, _local_node(stack) as channel:
        link = stack.enter_context(CanLink.open(WallClock(), interface="virtual", channel=channel))
        with pytest.raises(AbortError):
            SdoClient(link, NODE, "local node").write_bytes(0x2100, 0, data, block=True)
    sdo = SdoClient(rig.link(), NODE, "drive X")
    sdo.write_bytes(0x2100, 0, data, block=True)
    assert sdo.read_bytes(0x2100, 0, block=True) == data


# -- python-can: the Notifier's thread dies in silence ------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_the_notifier_loses_its_thread_and_the_sender_never_learns(until: Callable[..., None]) -> None:
    channel = uuid.uuid4().hex
    seen: list[int] = []

    def listener(message: can.Message) -> None:
        seen.append(message.arbitration_id)
        raise RuntimeError("a handler's mistake")

    with can.Bus(interface="virtual", channel=channel) as bus, can.Bus(interface="virtual", channel=channel) as other:
        notifier = can.Notifier(bus, [listener], timeout=0.05)
        other.send(can.Message(arbitration_id=0x181, is_extended_id=False))
        until(lambda: notifier.exception is not None, "the thread has died")
        for _ in range(10):  # nothing here raises
            other.send(can.Message(arbitration_id=0x182, is_extended_id=False))
            bus.send(can.Message(arbitration_id=0x201, is_extended_id=False))
        notifier.stop()
    assert seen == [0x181]


def test_ours_raises_in_the_call_that_was_waiting() -> None:
    channel = uuid.uuid4().hex
    with (
        CanLink.open(WallClock(), interface="virtual", channel=channel) as link,
        can.Bus(interface="virtual", channel=channel) as other,
    ):

        def handler(_time_ns: int, _data: bytes) -> None:
            raise RuntimeError("a handler's mistake")

        link.subscribe(0x181, handler)
        other.send(can.Message(arbitration_id=0x181, is_extended_id=False))
        with pytest.raises(RuntimeError, match="a handler's mistake"):
            link.wait(lambda: False, 1.0)
        heard: list[bytes] = []
        link.subscribe(0x182, lambda _time_ns, data: heard.append(data))
        other.send(can.Message(arbitration_id=0x182, data=b"\x01", is_extended_id=False))
        assert link.wait(lambda: bool(heard), 1.0)  # and goes on working
