"""Two drives on one serial line: they share the link, not each other's fate."""

import time

import pytest

from drivers.drive import DriveLimits, DriveState
from drivers.errors import NoAnswerError
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import parse_endpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.scaling import AxisScaling
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import rtu_slave
from sim_backends.modbus_faults import WireFault, WireFaultKind
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo

pytestmark = pytest.mark.outside

COUNTS = 100_000
LIMITS = DriveLimits(-3.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
SCALING = AxisScaling(COUNTS, 10.0)
TIMEOUT_S = 0.1


class Shaft:
    friction_permille = 10.0

    def step(self, motor_rev: float, dt_s: float) -> None: ...


def test_one_drive_falls_silent_and_the_other_finishes_its_move() -> None:
    clock = SimClock()
    servos = {unit: SimulatedServo(Shaft(), ServoParameters(counts_per_rev=COUNTS)) for unit in (1, 2)}
    for servo in servos.values():
        clock.attach(servo.advance, bearable=servo.bearable)
    faces = {1: Cia402Registers(servos[1]), 2: VendorRegisters(servos[2], counts_per_rev=COUNTS)}
    with rtu_slave(faces, clock) as (server, path):
        link = ModbusLink(parse_endpoint(f"{path}?parity=N&timeout_s={TIMEOUT_S}", baud=115_200), clock)
        maps = {1: "cia402_over_modbus", 2: "vendor_style"}
        mute, other = (
            ModbusDrive(name, SCALING, LIMITS, clock, link=link, unit=unit, drive_map=load_drive_map(maps[unit]))
            for unit, name in ((1, "mute"), (2, "other"))
        )
        with mute, other:
            for drive in (mute, other):
                drive.enable()
                drive.start_move(100.0, 50.0)
            server.faults.add(WireFault(WireFaultKind.LOST_REQUEST, unit=1, count=10**6))
            server.seen.clear()
            started_s, silent_looks = time.monotonic(), 0
            while not other.sample().target_reached:
                with pytest.raises(NoAnswerError):
                    mute.sample()
                silent_looks += 1
                clock.sleep_s(0.02)
            elapsed_s = time.monotonic() - started_s
            assert other.sample().position_load_mm == pytest.approx(100.0, abs=1e-3)
            asked = sum(unit == 1 for unit, _ in server.seen)
            assert silent_looks > 50
            assert asked <= 15  # 3 attempts at a time, after 0, 0.25, 0.75 and 1.75 s of two seconds of motion
            assert elapsed_s < asked * TIMEOUT_S + 10.0  # what the silence costs is its few time-outs
            server.faults.clear()
            clock.sleep_s(8.0)
            assert mute.sample().state is DriveState.ENABLED
            assert mute.sample().position_load_mm == pytest.approx(100.0, abs=1e-3)


def test_the_line_is_let_go_by_the_last_drive() -> None:
    clock = SimClock()
    servo = SimulatedServo(Shaft(), ServoParameters(counts_per_rev=COUNTS))
    clock.attach(servo.advance, bearable=servo.bearable)
    faces = {unit: VendorRegisters(servo, counts_per_rev=COUNTS) for unit in (1, 2)}
    with rtu_slave(faces, clock) as (_, path):
        link = ModbusLink(parse_endpoint(f"{path}?parity=N", baud=115_200), clock)
        first, second = (
            ModbusDrive("X", SCALING, LIMITS, clock, link=link, unit=unit, drive_map=load_drive_map("vendor_style"))
            for unit in (1, 2)
        )
        with first:
            with second:
                second.sample()
            assert first.sample().state is DriveState.SWITCH_ON_DISABLED
        assert link.statistics.connects == 1
        with second:
            second.sample()
        assert link.statistics.connects == 2
