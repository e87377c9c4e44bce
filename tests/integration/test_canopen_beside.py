"""The canopen package beside a drive that hil moves, in simulated time, and a user's own network as the bus."""

from __future__ import annotations

import io
import runpy
import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path
from unittest.mock import patch

import can
import canopen
import pytest
from support import their_canopen
from support.can_bench import attach_to_wire
from support.can_wire import SimWire
from support.drive_rigs import LIMITS
from support.served_drive import served

from drivers.canopen.beside import Beside, SharedBus
from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.canopen.eds import load_eds
from drivers.canopen.sdo import SdoClient
from drivers.canopen.stream import CyclicStream
from drivers.clock import WallClock
from drivers.drive import DriveState
from drivers.errors import BridgeError, InputError, NoAnswerError, SafetyError, StateError
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import EDS, CanOpenSlave
from sim_backends.clock import SimClock
from sim_backends.servo import SimulatedServo

NODE = 5
SCRIPT = Path(__file__).parents[2] / "hil" / "examples" / "canopen_network.py"
SCALING = AxisScaling(100_000, 10.0)
SETTINGS = CanOpenSettings(
    homing=HomingSettings(method=37, home_position_mm=0.0), sdo_timeout_s=2.0, sample_timeout_s=2.0
)


@pytest.fixture(autouse=True)
def quiet_library() -> Iterator[None]:
    with their_canopen.quiet():
        yield


@pytest.fixture(params=["with its EDS", "without"])
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[CanOpenDrive, CanOpenSlave, SimulatedServo]]:
    clock = SimClock()
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    clock.attach(servo.advance, bearable=servo.bearable)
    wire = SimWire(clock, 1_000_000)
    slave = attach_to_wire(wire, servo, node_id=NODE)
    eds = load_eds(EDS, NODE) if request.param == "with its EDS" else None
    with CanLink(wire.port(), clock) as link:
        drive = CanOpenDrive("X", SCALING, LIMITS, clock, link=link, node_id=NODE, settings=SETTINGS, eds=eds)
        with drive:
            yield drive, slave, servo


Simulated = tuple[CanOpenDrive, CanOpenSlave, SimulatedServo]


def test_objects_are_read_by_name_and_number_while_the_axis_moves(simulated: Simulated) -> None:
    drive, _, _ = simulated
    with Beside(drive) as beside:
        sdo = beside.node.sdo
        drive.enable()
        drive.start_move(50.0, 100.0)
        seen = []
        while not drive.sample().target_reached:
            seen.append(sdo[0x6064].raw)
            assert sdo[0x6041].bits[2] == 1, "operation enabled (CiA 402, statusword)"
            drive.clock.sleep_s(0.02)
        assert len(seen) > 10
        assert seen == sorted(seen)
        assert (
            sdo.upload(0x607A, 0)
            == sdo[0x607A].raw.to_bytes(4, "little", signed=True)
            == (500_000).to_bytes(4, "little")
        )
        with sdo.open(0x1008, 0, "r") as text:
            assert text.read() == bytes(drive.sdo.read_bytes(0x1008, 0)).decode()
        assert drive.sample().position_load_mm == pytest.approx(50.0, abs=0.01)


def test_names_and_limits_are_those_of_the_makers_file(simulated: Simulated) -> None:
    drive, _, _ = simulated
    with Beside(drive) as beside:
        if drive.node.eds is None:
            assert beside.node.object_dictionary[0x6041].name.lower() == "statusword"
            assert beside.node.object_dictionary[0x1001].name.lower() == "error register"
            return
        theirs = canopen.objectdictionary.eds.import_eds(str(EDS), NODE)
        assert set(theirs) == set(beside.node.object_dictionary)
        assert (
            beside.node.sdo["Statusword"].raw
            == drive.sdo.read_bytes(0x6041, 0)[0] | drive.sdo.read_bytes(0x6041, 0)[1] << 8
        )


@pytest.mark.parametrize(
    ("index", "says"),
    [
        (0x6040, "6040h"),
        (0x607A, "607Ah"),
        (0x60FF, "60FFh"),
        (0x6060, "6060h"),
        (0x1400, "PDO mapping"),
        (0x1A00, "PDO mapping"),
        (0x1005, "set up as a whole"),
        (0x1017, "set up as a whole"),
        (0x1011, "1011h"),
        (0x1200, "1200h"),
    ],
)
def test_what_would_move_the_axis_or_change_its_communication_is_refused(
    simulated: Simulated, index: int, says: str
) -> None:
    drive, _, _ = simulated
    with Beside(drive) as beside:
        before = drive.sdo.counters.transfers
        with pytest.raises(StateError, match=f"drive X is hil's, .*{says}"):
            beside.node.sdo.download(index, 1 if index in (0x1400, 0x1A00, 0x1011, 0x1200) else 0, b"\x00\x00\x00\x00")
        assert drive.sdo.counters.transfers == before, "nothing was sent"


def _frames(network: canopen.Network) -> dict[str, Callable[[], object]]:
    node = network[NODE]
    return {
        "NMT": lambda: setattr(node.nmt, "state", "STOPPED"),
        "NMT ": lambda: network.nmt.send_command(0x82),
        "SYNC": network.sync.transmit,
        "SYNC ": lambda: network.sync.start(0.1),
        "205h": lambda: network.send_message(0x205, bytes(6)),
        "305h": lambda: network.send_periodic(0x305, bytes(6), 0.1),
        "85h": lambda: network.send_message(0x085, bytes(8)),
        "second SDO client": lambda: network.send_message(0x605, bytes(8)),
        "second SDO client ": lambda: canopen.sdo.SdoClient.send_request(node.sdo, bytes(8)),
        "LSS": lambda: network.lss.send_switch_state_global(0),
    }


def test_frames_that_command_the_drive_are_refused_with_a_sentence(simulated: Simulated) -> None:
    drive, _, _ = simulated
    with Beside(drive) as beside:
        for what, send in _frames(beside.network).items():
            with pytest.raises(StateError, match=f"drive X is hil's, .*{what.strip()}"):
                send()
        beside.network.send_message(0x20A, b"\x01")  # another node's
    drive.enable()
    assert drive.sample().state is DriveState.ENABLED


def test_process_data_and_emergencies_come_to_their_callbacks(simulated: Simulated) -> None:
    drive, slave, _ = simulated
    with Beside(drive) as beside:
        heard: list[int] = []
        beside.network.subscribe(0x180 + NODE, lambda _id, data, _at: heard.append(int.from_bytes(data[:2], "little")))
        if drive.node.eds is not None:
            beside.node.tpdo[1].read()
            beside.node.tpdo[1].add_callback(lambda pdo: heard.append(pdo[0].raw))
        drive.sample()
        assert heard
        assert set(heard) == {drive.sdo.read_bytes(0x6041, 0)[0] | drive.sdo.read_bytes(0x6041, 0)[1] << 8}
        drive.enable()
        slave.emergency(0x8611)
        drive.clock.sleep_s(0.05)
        drive.sample()
        assert [entry.code for entry in beside.node.emcy.log] == [entry.code for entry in drive.monitor.log]
        assert beside.node.emcy.log


def test_an_error_of_a_callback_ends_no_move_and_is_told_at_the_next_access(simulated: Simulated) -> None:
    drive, _, _ = simulated

    def fails(*_: object) -> None:
        raise LookupError("of the user")

    with Beside(drive) as beside:
        beside.network.subscribe(0x180 + NODE, fails)
        drive.sample()
        with pytest.raises(LookupError, match="of the user"):
            _ = beside.node.sdo[0x6041].raw


def test_an_object_is_not_read_in_a_callback(simulated: Simulated) -> None:
    drive, _, _ = simulated
    with Beside(drive) as beside:
        beside.network.subscribe(0x180 + NODE, lambda *_: beside.node.sdo.upload(0x6041, 0))
        drive.sample()
        with pytest.raises(StateError, match="in a callback"):
            beside.node.sdo.upload(0x6041, 0)


def test_errors_of_the_drive_are_those_of_the_canopen_package(simulated: Simulated) -> None:
    drive, _, _ = simulated
    with Beside(drive) as beside:
        with pytest.raises(canopen.SdoAbortedError) as refused:
            beside.node.sdo.upload(0x5FFF, 0)
        assert refused.value.code == 0x06020000
        drive.close()
        with pytest.raises(StateError, match="is not open"):
            beside.node.sdo.upload(0x6041, 0)
        drive.open()


# -- a user's own network ------------------------------------------------------------------------------------------------
AXIS = """\
[axis]
name = "X"
travel_min_mm = -3.0
travel_max_mm = 300.0
max_velocity_mm_s = 200.0
max_acceleration_mm_s2 = 2000.0
[scaling]
encoder_counts_per_motor_rev = 100000
feed_mm_per_shaft_rev = 10.0
[drive]
backend = "canopen"
interface = "{interface}"
channel = "{channel}"
node_id = 5
sdo_timeout_s = 2.0
sample_timeout_s = 2.0
"""


def run_script(folder: Path, interface: str, channel: str) -> list[list[int]]:
    """What hil/examples/canopen_network.py prints, on any interface, with the drive served in real time."""
    axis = folder / "X.toml"
    axis.write_text(AXIS.format(interface=interface, channel=channel))
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    printed = io.StringIO()
    with (
        served(servo, WallClock(), interface=interface, channel=channel, node_id=NODE),
        patch.object(sys, "argv", ["", str(axis), str(EDS)]),
        redirect_stdout(printed),
    ):
        runpy.run_path(str(SCRIPT))
    assert servo.motor_rev * 10.0 == pytest.approx(10.0, abs=0.01)
    return [[int(word) for word in line.split()] for line in printed.getvalue().splitlines()]


def check_printed(seen: list[list[int]]) -> None:
    places, enabled = zip(*seen, strict=True)
    assert places[0] < 100_000, "read while it moves, however slow the host is"
    assert list(places) == sorted(places)
    assert places[-1] <= 100_100
    assert set(enabled) == {1}


@pytest.mark.outside
def test_hil_moves_an_axis_on_a_network_whose_user_reads_meanwhile(tmp_path: Path) -> None:
    assert len([line for line in SCRIPT.read_text().splitlines() if line]) <= 16, "15 lines, and what they are"
    check_printed(run_script(tmp_path, "virtual", uuid.uuid4().hex))


@pytest.mark.vcan
def test_the_same_on_socketcan(tmp_path: Path) -> None:
    check_printed(run_script(tmp_path, "socketcan", "vcan0"))


@pytest.mark.outside
def test_a_network_is_its_users_again_when_the_axis_is_left() -> None:
    channel = uuid.uuid4().hex
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    with ExitStack() as stack:
        network = their_canopen.network(stack, channel)
        node = network.add_node(NODE, str(EDS))
        stack.enter_context(served(servo, WallClock(), channel=channel, node_id=NODE))
        with CanLink(SharedBus(network), WallClock()) as link:
            drive = CanOpenDrive("X", SCALING, LIMITS, link.clock, link=link, node_id=NODE, settings=SETTINGS)
            with Beside(drive, network), drive:
                with pytest.raises(StateError, match="drive X is hil's, refused beside it: NMT"):
                    node.nmt.state = "STOPPED"
                theirs = node.sdo["Statusword"].raw
        assert node.sdo["Statusword"].raw == theirs, "by its own client"
        node.nmt.state = "PRE-OPERATIONAL"


@pytest.mark.outside
def test_a_second_thread_reads_while_the_first_one_moves() -> None:
    """One client for the channel: every access of both is answered."""
    channel = uuid.uuid4().hex
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    with ExitStack() as stack:
        network = their_canopen.network(stack, channel)
        stack.enter_context(served(servo, WallClock(), channel=channel, node_id=NODE))
        link = stack.enter_context(CanLink(SharedBus(network), WallClock()))
        drive = CanOpenDrive("X", SCALING, LIMITS, link.clock, link=link, node_id=NODE, settings=SETTINGS)
        beside = stack.enter_context(Beside(drive, network))
        stack.enter_context(drive)
        drive.enable()
        read, ended = [], threading.Event()

        def reading() -> None:
            while not ended.is_set():
                read.append(beside.node.sdo.upload(0x6064, 0))

        thread = threading.Thread(target=reading)
        thread.start()
        try:
            for place_mm in (5.0, 0.0):
                drive.start_move(place_mm, 100.0)
                drive.wait_for(lambda sample: sample.target_reached, 10.0, "the target")
                windows = {drive.parameters.read("following_error_window") for _ in range(50)}
                assert len(windows) == 1
        finally:
            ended.set()
            thread.join()
        assert len(read) > 20
        assert drive.sdo.counters.timeouts == 0


@contextmanager
def streaming_beside(asked_s: float) -> Iterator[tuple[CyclicStream, threading.Thread, list[BaseException], str]]:
    """A stream of 20 ms, a thread that asks an absent node for so long, what it was told, and the channel."""
    channel = uuid.uuid4().hex
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    with ExitStack() as stack:
        stack.enter_context(served(servo, WallClock(), channel=channel, node_id=NODE))
        link = stack.enter_context(CanLink.open(WallClock(), interface="virtual", channel=channel))
        drive = CanOpenDrive("X", SCALING, LIMITS, link.clock, link=link, node_id=NODE, settings=SETTINGS)
        stack.enter_context(drive)
        drive.enable()
        absent, told = SdoClient(link, NODE + 1, "absent", timeout_s=asked_s), list[BaseException]()

        def asking() -> None:
            try:
                absent.read_bytes(0x1000, 0)
            except BridgeError as error:
                told.append(error)

        thread = threading.Thread(target=asking)
        stack.callback(thread.join)
        with CyclicStream([drive], SetPointSettings(0.02, missed_limit=1000)) as stream:
            thread.start()
            yield stream, thread, told, channel


@pytest.mark.outside
def test_a_stream_goes_on_while_a_second_thread_waits_for_an_answer_that_does_not_come() -> None:
    late_ms = []
    with streaming_beside(1.0) as (stream, thread, told, _channel):
        while thread.is_alive():
            stream.cycle([0.0])
            late_ms.append((stream.clock.now_ns() - stream.reached_ns) / 1e6 + 20.0)  # after the SYNC of this cycle
    assert [type(error) for error in told] == [NoAnswerError]
    print(f"longest cycle: {max(late_ms):.1f} ms after its SYNC")
    assert len(late_ms) > 50
    assert max(late_ms) < 200.0


@pytest.mark.outside
def test_a_second_producer_of_sync_ends_the_stream_whichever_thread_hears_it() -> None:
    with streaming_beside(1.0) as (stream, thread, told, channel):
        with can.Bus(interface="virtual", channel=channel) as other:

            def cycles() -> None:
                for _ in range(50):
                    other.send(can.Message(arbitration_id=0x80, is_extended_id=False))
                    stream.cycle([0.0])

            with pytest.raises(SafetyError, match="a second SYNC producer is on the bus"):
                cycles()
        thread.join()
        assert [type(error) for error in told] == [NoAnswerError]


def test_a_network_that_is_not_connected_is_no_bus() -> None:
    with pytest.raises(InputError, match="connect"):
        SharedBus(canopen.Network())
