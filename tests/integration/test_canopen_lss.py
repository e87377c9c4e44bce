"""Layer setting services: nodes without an id are found by their identity alone, and given one."""

from __future__ import annotations

import logging
import threading
import uuid
from collections.abc import Iterator
from contextlib import suppress

import can
import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.sdo_peers import Flood

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.lss import SLAVE, LssAddress, LssMaster
from drivers.drive import DriveLimits, DriveState
from drivers.errors import InputError, NoAnswerError, ProtocolError
from drivers.scaling import AxisScaling
from sim_backends.canopen_bench import SMALL_SERVO, BareShaft
from sim_backends.canopen_lss import ANSWERS, REQUESTS, Identity, LssSlave, NewDrive
from sim_backends.canopen_wire import SimWire
from sim_backends.clock import SimClock
from sim_backends.servo import SimulatedServo


class Bus:
    """A wire with new drives and a master."""

    def __init__(self, *identities: Identity) -> None:
        self.clock = SimClock()
        servos = [SimulatedServo(BareShaft(), SMALL_SERVO) for _ in identities]
        for servo in servos:
            self.clock.attach(servo.advance, bearable=servo.bearable)
        self.wire = SimWire(self.clock, 1_000_000)
        self.drives = [NewDrive(self.wire, servo, identity) for servo, identity in zip(servos, identities, strict=True)]
        self.link = CanLink(self.wire.port(), self.clock)
        self.lss = LssMaster(self.link, timeout_s=0.005)


def _address(identity: Identity) -> LssAddress:
    return LssAddress(*identity.parts)


@pytest.fixture
def bus() -> Iterator[Bus]:
    bus = Bus(Identity(serial=0xBEEF))
    with bus.link:
        yield bus


@pytest.mark.parametrize(
    "data", [bytes(8), b"\x4f" + bytes(7), b"\x11\x00" + bytes(6)], ids=["others", "found", "taken"]
)
def test_lss_frames_without_end_do_not_extend_a_wait(data: bytes) -> None:
    """An answer that comes without a question ends in a wrong finding at worst, not in a longer wait."""
    bus = Bus()
    Flood(bus.wire, [(SLAVE, data)], 0.0002)
    start_ns = bus.clock.now_ns()
    with suppress(NoAnswerError, ProtocolError):
        bus.lss.find_unconfigured()
    asked = 1 + 4 * 33
    assert bus.clock.now_ns() - start_ns <= 1.01e9 * 0.005 * asked
    start_ns = bus.clock.now_ns()
    with suppress(NoAnswerError, ProtocolError):
        bus.lss.set_node_id(5)
    assert bus.clock.now_ns() - start_ns <= 1.01e9 * 0.005
    bus.link.close()


def test_a_node_without_an_id_speaks_lss_only(bus: Bus) -> None:
    bus.link.send(0x601, bytes.fromhex("4000100000000000"))
    assert not bus.link.wait(lambda: False, 0.01)
    assert bus.link.frames_received == 0
    assert bus.lss.any_unconfigured()


word = st.integers(0, 2**32 - 1)


@settings(max_examples=25, deadline=None)
@given(st.builds(Identity, word, word, word, word))
def test_any_identity_is_found_bit_by_bit(identity: Identity) -> None:
    bus = Bus(identity)
    with bus.link:
        assert bus.lss.find_unconfigured() == _address(identity)
        assert bus.lss.identity() == _address(identity)
        assert bus.lss.node_id() is None


def test_from_the_box_to_enabled(bus: Bus) -> None:
    address = bus.lss.find_unconfigured()
    assert address is not None
    bus.lss.assign(address, 12)
    assert bus.drives[0].lss.stored_node_id == 12
    assert not bus.lss.any_unconfigured()
    limits = DriveLimits(-100.0, 100.0, 100.0, 1000.0)
    with CanOpenDrive("new", AxisScaling(100_000, 10.0), limits, bus.clock, link=bus.link, node_id=12) as drive:
        assert drive.identity is not None
        assert drive.identity.serial == 0xBEEF
        drive.enable()
        assert drive.sample().state is DriveState.ENABLED


def test_several_are_found_one_after_the_other() -> None:
    identities = [Identity(serial=serial) for serial in (7, 9, 0x80000001)]
    bus = Bus(*identities)
    found = []
    with bus.link:
        while (address := bus.lss.find_unconfigured()) is not None:
            found.append(address)
            bus.lss.assign(address, 10 + len(found))
    assert found == [_address(identity) for identity in identities]
    assert [drive.slave.node_id for drive in bus.drives if drive.slave is not None] == [11, 12, 13]


def test_selecting_picks_exactly_one() -> None:
    bus = Bus(Identity(serial=1), Identity(serial=2))
    with bus.link:
        bus.lss.select(_address(Identity(serial=2)))
        assert bus.lss.identity().serial == 2
        with pytest.raises(NoAnswerError, match="000004E1h 00000402h 00010000h 00000003h"):
            bus.lss.select(_address(Identity(serial=3)))
        with pytest.raises(NoAnswerError, match="no node is in configuration state"):
            bus.lss.set_node_id(5)


def test_bit_rates(bus: Bus) -> None:
    bus.lss.select(_address(Identity(serial=0xBEEF)))
    bus.lss.set_bit_rate(500_000)
    with pytest.raises(InputError, match="bit rate is 333000"):
        bus.lss.set_bit_rate(333_000)
    with pytest.raises(InputError, match="node id is 128"):
        bus.lss.set_node_id(128)


def test_a_refusal_is_named() -> None:
    bus = Bus(Identity())
    with bus.link:
        bus.lss.select(_address(Identity()))
        bus.drives[0].lss.handle = lambda _request: bytes.fromhex("1101000000000000")  # type: ignore[method-assign]
        with pytest.raises(ProtocolError, match="node id 9 was refused: out of range"):
            bus.lss.set_node_id(9)


def test_an_empty_bus_has_none() -> None:
    bus = Bus()
    with bus.link:
        assert bus.lss.find_unconfigured() is None
        assert not bus.lss.any_unconfigured()


def test_the_canopen_packages_master_finds_our_slave() -> None:
    """Its fast scan against our slave, over python-can's virtual bus in real time."""
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    identity = Identity(0x11, 0x80000002, 0, 0xFFFFFFFF)
    started: list[int] = []
    slave = LssSlave(identity, None, started.append)
    channel = uuid.uuid4().hex
    done = threading.Event()
    with can.Bus(interface="virtual", channel=channel) as bus:

        def serve() -> None:
            while not done.is_set():
                message = bus.recv(0.02)
                if message is not None and message.arbitration_id == REQUESTS:
                    answer = slave.handle(bytes(message.data))
                    if answer is not None:
                        bus.send(can.Message(arbitration_id=ANSWERS, data=answer, is_extended_id=False))

        thread = threading.Thread(target=serve)
        thread.start()
        network = canopen.Network()
        network.NOTIFIER_CYCLE = 0.05
        network.connect(interface="virtual", channel=channel)
        network.lss.RESPONSE_TIMEOUT = 0.02
        try:
            # it takes an answer that is 20 ms late for none, and a busy host may be: such a scan finds nothing
            found, parts = next(filter(lambda scan: scan[0], (network.lss.fast_scan() for _ in range(10))))
            assert found
            assert tuple(parts) == identity.parts
            network.lss.configure_node_id(0x21)
            network.lss.store_configuration()
            network.lss.send_switch_state_global(network.lss.WAITING_STATE)
        finally:
            done.set()
            thread.join()
            network.disconnect()
    logging.getLogger("canopen").setLevel(logging.NOTSET)
    assert slave.stored_node_id == 0x21
    assert started == [0x21]
