"""One simulated servo behind every face of a drive: the rigs of the contract suite.

A backend is a function that builds a `Rig` around the same simulated servo. A new wire is added to BACKENDS and nowhere else.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

import pytest
from support.can_bench import attach_to_wire
from support.can_wire import SimWire
from support.served_drive import served

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.drive import ServoDrive
from drivers.limits import DriveLimits
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.scaling import AxisScaling
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import rtu_slave, tcp_server
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.probe_latch import ProbeLatch
from sim_backends.servo import ServoParameters, SimulatedServo
from sim_backends.virtual_drive import VirtualDrive, VirtualDriveSettings

LIMITS = DriveLimits(-3.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
COUNTS_PER_REV = 100_000


@dataclass
class Rig:
    drive: ServoDrive
    servo: SimulatedServo
    clock: SimClock
    probe: ProbeLatch | None = None  # the drive's probe inputs, where it has some

    def run(self, seconds: float) -> None:
        self.clock.sleep_s(seconds)


Backend = Callable[[AxisScaling], AbstractContextManager[Rig]]


def _machine(scaling: AxisScaling) -> tuple[SimClock, SimulatedServo]:
    clock = SimClock()
    counts_per_mm = scaling.direction * scaling.counts_per_load_mm
    ends = sorted(place * counts_per_mm for place in (-5.0, 310.0))
    servo = SimulatedServo(
        BareShaft(),
        ServoParameters(
            counts_per_rev=COUNTS_PER_REV,
            negative_limit_counts=ends[0],
            positive_limit_counts=ends[1],
            negative_stop_counts=ends[0] - 1000,
            positive_stop_counts=ends[1] + 1000,
        ),
    )
    clock.attach(servo.advance, bearable=servo.bearable)
    return clock, servo


@contextmanager
def in_process(scaling: AxisScaling) -> Iterator[Rig]:
    clock, servo = _machine(scaling)
    settings = VirtualDriveSettings(homing_method=37, home_position_mm=0.0)
    drive = VirtualDrive(servo, scaling, LIMITS, clock, settings=settings)
    yield Rig(drive, servo, clock, drive.probe)


def _canopen(scaling: AxisScaling, clock: SimClock, link: CanLink) -> CanOpenDrive:
    homing = HomingSettings(method=37, home_position_mm=0.0)
    patient = CanOpenSettings(homing=homing, sdo_timeout_s=5.0, sample_timeout_s=5.0)  # the guest's host may be busy
    return CanOpenDrive("X", scaling, LIMITS, clock, link=link, node_id=5, settings=patient)


def _on_wire(bitrate: int | None) -> Backend:
    @contextmanager
    def rig(scaling: AxisScaling) -> Iterator[Rig]:
        clock, servo = _machine(scaling)
        wire = SimWire(clock, bitrate)
        slave = attach_to_wire(wire, servo, node_id=5)
        with CanLink(wire.port(), clock) as link:
            yield Rig(_canopen(scaling, clock, link), servo, clock, slave.profile.probe)

    return rig


def _on_interface(interface: str, channel: Callable[[], str]) -> Backend:
    @contextmanager
    def rig(scaling: AxisScaling) -> Iterator[Rig]:
        clock, servo = _machine(scaling)
        name = channel()
        with (
            served(servo, clock, interface=interface, channel=name, node_id=5) as slave,
            CanLink.open(clock, interface=interface, channel=name) as link,
        ):
            yield Rig(_canopen(scaling, clock, link), servo, clock, slave.profile.probe)

    return rig


def _modbus_face(map_name: str, servo: SimulatedServo) -> VendorRegisters | Cia402Registers:
    if map_name == "vendor_style":
        return VendorRegisters(servo, counts_per_rev=COUNTS_PER_REV, settings={"origin_method": 35})
    return Cia402Registers(servo, parameters={(0x6098, 0): 37, (0x6085, 0): 20_000_000})


def _modbus_endpoint(place: str | int) -> Endpoint:
    if isinstance(place, str):
        return RtuEndpoint(place, baud=115_200, parity="N")
    return TcpEndpoint("127.0.0.1", place)


def _modbus(map_name: str, *, serial: bool) -> Backend:
    @contextmanager
    def rig(scaling: AxisScaling) -> Iterator[Rig]:
        clock, servo = _machine(scaling)
        face = _modbus_face(map_name, servo)
        probe = face.profile.probe if isinstance(face, Cia402Registers) else None
        with rtu_slave({7: face}, clock) if serial else tcp_server({7: face}, clock) as (_, place):
            drive = ModbusDrive(
                "X",
                scaling,
                LIMITS,
                clock,
                link=ModbusLink(_modbus_endpoint(place), clock),
                unit=7,
                drive_map=load_drive_map(map_name),
            )
            yield Rig(drive, servo, clock, probe)

    return rig


BACKENDS: dict[str, Backend] = {
    "in process": in_process,
    "canopen, simulated wire": _on_wire(None),
    "canopen, simulated wire at 1 Mbit/s": _on_wire(1_000_000),
    "canopen, python-can virtual bus": _on_interface("virtual", lambda: uuid.uuid4().hex),
    "canopen, socketcan": _on_interface("socketcan", lambda: "vcan0"),
    "modbus tcp, cia402 map": _modbus("cia402_over_modbus", serial=False),
    "modbus rtu, cia402 map": _modbus("cia402_over_modbus", serial=True),
    "modbus tcp, vendor map": _modbus("vendor_style", serial=False),
}
MARKS = {
    "canopen, socketcan": pytest.mark.vcan,  # run in the guest where this kernel has no SocketCAN
    "modbus rtu, cia402 map": pytest.mark.outside,  # pseudo-terminals
}


def home(rig: Rig) -> None:
    rig.drive.start_homing()
    rig.drive.wait_for(lambda sample: sample.homed is True, 30.0, "homed")


def arrive(rig: Rig, timeout_s: float = 30.0) -> float:
    return rig.drive.wait_for(lambda sample: sample.target_reached, timeout_s, "arrived").position_load_mm
