"""ModbusDrive on a line in this process: what it spares a drive, what it refuses, and how it behaves in trouble."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import pytest
from support.modbus_in_turn import in_turn

from drivers.drive import Capability, DriveState
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    DriveFaultError,
    HeldUnderPowerError,
    InputError,
    LinkLostError,
    MotionTimeoutError,
    NoAnswerError,
    ProtocolError,
    StateError,
    UndoError,
)
from drivers.limits import DriveLimits
from drivers.modbus.codec import Layout, Order, RegisterType
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import RtuEndpoint, TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_map import find_map
from drivers.modbus.wear import WearLedger
from drivers.modbus.wire import PymodbusWire
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.faults import CanFaultKind, WireFaultKind
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import ModbusServer
from sim_backends.modbus_faults import WireFault
from sim_backends.modbus_registers import Bank, Space, Value
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo

COUNTS = 100_000
LIMITS = DriveLimits(-3.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
SCALING = AxisScaling(COUNTS, 10.0)
CIA402, VENDOR = "cia402_over_modbus", "vendor_style"
UNIT = 3


@dataclass
class Rig:
    drive: ModbusDrive
    face: Cia402Registers | VendorRegisters
    servo: SimulatedServo
    server: ModbusServer
    clock: SimClock
    link: ModbusLink


def make_face(name: str, servo: SimulatedServo) -> Cia402Registers | VendorRegisters:
    if name == VENDOR:
        return VendorRegisters(servo, counts_per_rev=COUNTS, settings={"origin_method": 35})
    return Cia402Registers(servo, parameters={(0x6098, 0): 37, (0x6085, 0): 20_000_000, (0x608F, 1): COUNTS})


@contextmanager
def rig(
    name: str,
    *,
    serial: bool = False,
    wear: WearLedger | None = None,
    map_path: Path | None = None,
    make: Callable[[SimulatedServo], Cia402Registers | VendorRegisters] | None = None,
) -> Iterator[Rig]:
    """A drive, not yet open, on a wire of its own."""
    clock = SimClock()
    servo = SimulatedServo(
        BareShaft(),
        ServoParameters(
            counts_per_rev=COUNTS,
            negative_limit_counts=-50_000,
            positive_limit_counts=3_100_000,
            negative_stop_counts=-51_000,
            positive_stop_counts=3_101_000,
        ),
    )
    clock.attach(servo.advance, bearable=servo.bearable)
    face = make_face(name, servo) if make is None else make(servo)
    with in_turn({UNIT: face}, clock) as (server, make_wire):
        endpoint = RtuEndpoint("in turn", 115_200, "N") if serial else TcpEndpoint("in turn", 0)
        link = ModbusLink(endpoint, clock, make_wire=make_wire)
        drive_map = load_drive_map(map_path or name)
        drive = ModbusDrive("X", SCALING, LIMITS, clock, link=link, unit=UNIT, drive_map=drive_map, wear=wear)
        yield Rig(drive, face, servo, server, clock, link)


def writes_to(server: ModbusServer, address: int, functions: tuple[int, ...] = (5, 6, 15, 16)) -> list[bytes]:
    """PDUs of all requests so far that write from this address on."""
    head = address.to_bytes(2, "big")
    return [pdu for _, pdu in server.seen if pdu[0] in functions and pdu[1:3] == head]


@pytest.fixture(params=[CIA402, VENDOR])
def each(request: pytest.FixtureRequest) -> Iterator[Rig]:
    with rig(request.param) as r:
        yield r


# -- what it spares a drive --------------------------------------------------------------------------------------------
def test_opening_writes_nothing(each: Rig) -> None:
    with each.drive:
        assert all(pdu[0] in (1, 2, 3, 4) for _, pdu in each.server.seen)


def test_the_target_is_the_actual_position_before_power_comes_on() -> None:
    with rig(VENDOR) as r, r.drive as drive:
        drive.enable()
        drive.start_move(20.0, 100.0)
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        drive.disable()
        r.servo._actual += 777.0  # somebody turned the screw by hand
        r.servo._demand += 777.0
        drive.enable()
        assert drive.parameters.read("target") == r.servo.position_actual_counts
        r.clock.sleep_s(0.3)
        assert drive.sample().position_load_mm == pytest.approx(20.0777, abs=1e-3)


def test_a_target_that_cannot_be_set_keeps_power_off() -> None:
    with rig(CIA402) as r, r.drive as drive:
        r.server.faults.add(WireFault(WireFaultKind.EXCEPTION, function=16, count=100, code=4))
        with pytest.raises(AbortError):
            drive.enable()
        assert not r.servo.powered


def test_a_sample_is_one_request_per_table(each: Rig) -> None:
    with each.drive as drive:
        before = each.server.requests
        drive.sample()
        assert each.server.requests - before == (1 if isinstance(each.face, Cia402Registers) else 2)


def test_a_move_writes_its_values_in_one_request(each: Rig) -> None:
    with each.drive as drive:
        drive.enable()
        each.server.seen.clear()
        drive.start_move(5.0, 10.0)
        assert sum(pdu[0] == 16 for _, pdu in each.server.seen) == 1


# -- hand-shakes -------------------------------------------------------------------------------------------------------


def test_a_set_point_bit_left_standing_is_cleared_first() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        for target in (4.0, 9.0):
            drive.start_move(target, 50.0)
            r.link.write(UNIT, drive.registers["controlword"].table, 0x2100, (0x003F,))  # as a script that crashed
            drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        assert drive.sample().position_load_mm == pytest.approx(9.0, abs=1e-3)


def test_a_trigger_is_sent_once_and_waited_for() -> None:
    with rig(VENDOR) as r, r.drive as drive:
        drive.enable()
        r.server.seen.clear()
        drive.start_move(5.0, 10.0)
        assert len(writes_to(r.server, 6)) == 1
        assert drive.sample().target_reached is False


@pytest.mark.parametrize("kind", [WireFaultKind.NO_REPLY, WireFaultKind.DROP, WireFaultKind.WRONG_ECHO])
def test_a_trigger_whose_reply_is_lost_is_not_repeated_as_the_axis_itself_is_the_evidence(kind: WireFaultKind) -> None:
    with rig(VENDOR) as r, r.drive as drive:
        drive.enable()
        r.server.seen.clear()
        r.server.faults.add(WireFault(kind, function=6))
        drive.start_move(50.0, 10.0)
        assert len(writes_to(r.server, 6)) == 1
        drive.wait_for(lambda sample: sample.target_reached, 20.0, "arrived")
        assert drive.sample().position_load_mm == pytest.approx(50.0, abs=1e-3)


def test_a_trigger_that_was_lost_is_reported_as_in_doubt_and_nothing_moves() -> None:
    with rig(VENDOR) as r, r.drive as drive:
        drive.enable()
        r.server.faults.add(WireFault(WireFaultKind.LOST_REQUEST, function=6))
        with pytest.raises(NoAnswerError, match="start of move is in doubt"):
            drive.start_move(50.0, 10.0)
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED  # nobody watches a move that start_move denied
        r.clock.sleep_s(1.0)
        assert drive.sample().position_load_mm == 0.0


def test_a_move_that_began_but_was_not_confirmed_is_stopped() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        drive.start_move(1.0, 10.0)
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        r.server.faults.add(WireFault(WireFaultKind.EXCEPTION, nth=2, function=6, code=4))  # taking the start bit back
        with pytest.raises(AbortError):
            drive.start_move(250.0, 50.0)
        r.clock.sleep_s(1.0)
        assert drive.sample().velocity_mm_s == 0.0
        assert drive.sample().position_load_mm < 2.0


@pytest.mark.parametrize(
    ("name", "counts_per_rev", "travel_max_mm", "last_mm"),
    [
        (CIA402, 2**23, 3000.0, 2560.0),
        (VENDOR, 2**23, 3000.0, 2560.0),
        ("mitsubishi_mr_je_c", 2**26, 400.0, 320.0),
        ("kollmorgen_akd2g", 2**26, 60_000.0, 59652.3),  # in revolutions: 2^31 steps of 0.001 degrees
        ("kollmorgen_akd2g", 2**26, 50_000.0, None),
        (CIA402, 2**23, 2500.0, None),
    ],
)
def test_a_travel_that_the_registers_do_not_hold_is_refused_before_a_request(
    name: str, counts_per_rev: int, travel_max_mm: float, last_mm: float | None
) -> None:
    clock = SimClock()
    drive = ModbusDrive(
        "X",
        AxisScaling(counts_per_rev, 10.0),
        replace(LIMITS, travel_max_mm=travel_max_mm),
        clock,
        link=ModbusLink(TcpEndpoint("127.0.0.1", 1, 0.25), clock),
        unit=UNIT,
        drive_map=load_drive_map(name),
    )
    said = "Modbus" if last_mm is None else rf"the drive holds positions from -{last_mm:g} to {last_mm:g} mm"
    with pytest.raises(LinkLostError if last_mm is None else InputError, match=said):
        drive.open()


@pytest.mark.parametrize("name", [CIA402, VENDOR])
@pytest.mark.parametrize(("home_mm", "sign"), [(-5.0, 1), (120.0, 1), (120.0, -1), (0.9, -1), (0.9, 0)])
def test_the_place_after_a_homing_is_the_one_that_the_drive_announced(name: str, home_mm: float, sign: int) -> None:
    with rig(name) as r, r.drive as drive:
        homing = drive.map.homing
        assert homing is not None
        assert homing.home_position is not None
        drive.parameters.write(homing.home_position, 10_000 * home_mm)
        assert drive.zero().home_position_mm == pytest.approx(home_mm)
        plain = r.servo.start_homing
        r.servo.start_homing = lambda how, fast, slow, offset: plain(how, fast, slow, sign * offset)  # type: ignore[method-assign]
        drive.enable()

        def home() -> None:
            drive.start_homing()
            drive.wait_for(lambda sample: sample.homed is True, 5.0, "homed")

        if sign == 1:
            home()
            assert drive.sample().position_load_mm == pytest.approx(home_mm, abs=0.01)
            return
        with pytest.raises(ProtocolError, match=rf"was to show {home_mm:g} mm and shows"):
            home()
        assert drive.sample().homed is False


def test_a_drive_that_says_it_is_there_and_does_not_move_is_found_out() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        r.servo.move_absolute = lambda *_: None  # type: ignore[method-assign]
        with pytest.raises(MotionTimeoutError, match="says it is in position, and does not move"):
            drive.start_move(50.0, 10.0)


@pytest.mark.parametrize("window", [10, 0xFFFF_FFFF])
@pytest.mark.parametrize("distance_mm", [100.0, 3.0])
def test_in_position_all_the_time_is_no_arrival(window: int, distance_mm: float) -> None:
    """As Leadshine's 2CS3E shows bit 10, and any drive whose window (6067h) is wider than the move."""
    with rig(CIA402) as r, r.drive as drive:
        assert isinstance(r.face, Cia402Registers)
        r.face.dictionary.set_number(0x6067, 0, window)
        profile = r.face.profile
        r.face.dictionary.on_read(0x6041, 0, lambda: profile.statusword() | 0x0400)
        drive.enable()
        drive.start_move(distance_mm, 20.0)
        drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrived")
        assert r.servo.position_actual_counts / 10_000 == pytest.approx(distance_mm, abs=0.006)
        drive.start_homing()
        drive.wait_for(lambda sample: sample.homed is True and sample.target_reached, 5.0, "homed")


def test_a_mode_that_does_not_change_after_a_homing_ends_without_power() -> None:
    with rig(CIA402) as r, r.drive as drive:
        assert isinstance(r.face, Cia402Registers)
        drive.enable()
        drive.start_homing()
        drive.wait_for(lambda sample: sample.homed is True, 5.0, "homed")
        r.face.profile.defects.add(CanFaultKind.MODE_STUCK)
        with pytest.raises(MotionTimeoutError, match="change of mode not within"):
            drive.start_move(50.0, 10.0)
        assert (r.servo.powered, r.servo.velocity_actual_counts_s) == (False, 0)


def test_small_steps_are_quick_even_inside_the_drives_window(each: Rig) -> None:
    """The torque method steps by a micrometre: a drive whose in-position never leaves must not cost its time-out each time."""
    with each.drive as drive:
        drive.enable()
        start_ns = each.clock.now_ns()
        for step in range(20):
            drive.start_move(0.001 * (step + 1), 1.0)
            drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        assert drive.sample().position_load_mm == pytest.approx(0.020, abs=2e-4)
        assert each.clock.now_ns() - start_ns < 20 * 200_000_000


class StartsOnItsTarget(VendorRegisters):
    """The vendor's drive in the mode in which writing the target, even the one it is at, starts a move at once."""

    def __init__(self, servo: SimulatedServo) -> None:
        super().__init__(servo, counts_per_rev=COUNTS)
        self.targets = 0
        (cell,) = (cell for cell in self._holding_cells() if cell.address == 0)
        others = [cell for cell in self._holding_cells() if cell.address != 0]
        self.banks = {
            **self.banks,
            Space.HOLDING_REGISTERS: Bank([replace(cell, write=self._start), *others], gaps_readable=False),
        }

    def _start(self, value: Value) -> None:
        self._motion["target"] = int(value)
        self._motion["trigger"] = 1
        self._take_order()
        self.targets += 1


def test_a_drive_that_starts_on_its_target_gets_it_last(tmp_path: Path) -> None:
    source = load_drive_map(VENDOR).registers.path.read_text(encoding="utf-8")
    start, end = source.index("[drive.move]"), source.index("[drive.homing]")
    move = (
        '[drive.move]\nhandshake = "on write"\ntarget = "target"\nvelocity = "target_speed"\n'
        'acceleration = "ramp"\nreached = [{ register = "in_position", value = 1 }]\nwindow = 20\n\n'
    )
    path = tmp_path / "on_write.toml"
    path.write_text(source[:start] + move + source[end:], encoding="utf-8")
    with rig(VENDOR, map_path=path, make=StartsOnItsTarget) as r, r.drive as drive:
        assert isinstance(r.face, StartsOnItsTarget)
        drive.enable()
        r.clock.sleep_s(0.2)
        assert r.servo.position_actual_counts == 0
        drive.start_move(20.0, 10.0)
        assert r.face.targets == 2  # one to stay at power-on, one for the move
        assert drive.sample().target_reached is False
        r.clock.sleep_s(1.0)
        assert drive.sample().velocity_mm_s == pytest.approx(10.0, rel=0.01)  # the speed was there before the target
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        assert drive.sample().position_load_mm == pytest.approx(20.0, abs=0.002)


# -- homing ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("period_s", "serial", "who"),
    [(0.009, False, "its register map requires 10 ms"), (0.011, True, "set-points and answers take 1")],
)
def test_a_period_that_cannot_be_kept_is_refused_before_anything_is_written(
    period_s: float, serial: bool, who: str
) -> None:
    with rig(CIA402, serial=serial) as r, r.drive as drive:
        drive.enable()
        r.server.seen.clear()
        with pytest.raises(InputError, match=who), drive.stream(SetPointSettings(period_s)):
            pytest.fail("entered")
        assert not any(pdu[0] in (5, 6, 15, 16) for _, pdu in r.server.seen)


def test_a_period_is_held_against_the_time_that_the_drive_takes_to_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cycle is two exchanges: one that writes and one that reads."""
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        exchange = PymodbusWire.exchange

        def late(*request: object) -> tuple[int, ...]:
            r.clock.sleep_s(0.02)
            return exchange(*request)  # type: ignore[arg-type]

        monkeypatch.setattr(PymodbusWire, "exchange", late)
        with (
            pytest.raises(InputError, match="set-points and answers take 40 ms"),
            drive.stream(SetPointSettings(0.039)),
        ):
            pytest.fail("entered")
        with drive.stream(SetPointSettings(0.041)) as stream:
            for step in range(20):
                stream.cycle([0.1 * step])
            assert stream.missed_cycles == 0


def test_homing_attained_means_something_in_homing_mode_only() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        assert drive.sample().homed is None
        drive.start_homing()
        drive.wait_for(lambda sample: sample.homed is True, 5.0, "homed")
        drive.start_move(3.0, 10.0)  # bit 12 is now the set-point acknowledge
        assert drive.sample().homed is True
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        drive.start_homing()
        drive.wait_for(lambda sample: sample.homed is True, 5.0, "homed again")
        assert drive.sample().position_load_mm == pytest.approx(0.0, abs=1e-3)


def show_attained_for(r: Rig, duration_s: float) -> None:
    """The drive shows "attained" of the last homing for so long after now."""
    assert isinstance(r.face, Cia402Registers)
    profile, until_ns = r.face.profile, r.clock.now_ns() + round(duration_s * 1e9)

    def statusword() -> int:
        old = 0x1400 if profile._mode == 6 and r.clock.now_ns() < until_ns else 0
        return profile.statusword() | old

    r.face.dictionary.on_read(0x6041, 0, statusword)


def test_the_attained_of_the_last_homing_is_not_believed_while_the_axis_moves() -> None:
    with rig(CIA402) as r, r.drive as drive:
        assert isinstance(r.face, Cia402Registers)
        drive.enable()
        drive.start_homing()
        drive.wait_for(lambda sample: sample.homed is True, 5.0, "homed")
        drive.start_move(10.0, 200.0)
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        r.face.dictionary.set_number(0x6098, 0, 17)
        r.face.dictionary.set_number(0x6099, 1, 50_000)
        show_attained_for(r, 2.0)
        drive.start_homing()
        for _ in range(130):
            assert drive.sample().homed is False
            r.clock.sleep_s(0.01)
        assert r.servo.velocity_actual_counts_s < 0
        drive.wait_for(lambda sample: sample.homed is True, 30.0, "homed")
        assert r.servo.velocity_actual_counts_s == 0
        assert r.servo.homed


def test_a_homing_without_motion_counts_once_attained_and_the_axis_have_stayed() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        show_attained_for(r, 1e6)
        start_ns = r.clock.now_ns()
        drive.start_homing()
        drive.wait_for(lambda sample: sample.homed is True, 5.0, "homed")
        assert 500_000_000 <= r.clock.now_ns() - start_ns < 700_000_000


# -- stopping ----------------------------------------------------------------------------------------------------------
def test_quick_stop_is_sent_to_a_unit_in_backoff_too(each: Rig) -> None:
    with each.drive as drive:
        drive.enable()
        drive.start_move(200.0, 50.0)
        each.clock.sleep_s(0.5)
        each.server.faults.add(WireFault(WireFaultKind.LOST_REQUEST, count=4))
        with pytest.raises(NoAnswerError):
            drive.sample()
        with pytest.raises(NoAnswerError, match="not tried again"):
            drive.sample()
        drive.quick_stop()  # the first attempt is lost as well
        each.clock.sleep_s(1.0)
        assert drive.sample().velocity_mm_s == 0.0
        assert each.servo.position_actual_counts < 100_0000


QUICK_STOP = (b"\x06\x21\x00\x00\x02", b"\x05\x00\x01\xff\x00")  # controlword, emergency stop


def stops(r: Rig) -> int:
    return sum(pdu in QUICK_STOP for _, pdu in r.server.seen)


def test_a_quick_stop_is_over_when_it_is_seen_to_be_obeyed(each: Rig) -> None:
    with each.drive as drive:
        drive.enable()
        drive.start_move(200.0, 50.0)
        each.clock.sleep_s(0.5)
        drive.quick_stop()
        assert drive.sample().state is DriveState.QUICK_STOP
        assert stops(each) == 1


def test_a_quick_stop_to_a_unit_that_is_dead_says_so_and_was_sent() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        r.server.faults.add(WireFault(WireFaultKind.LOST_REQUEST, count=10**6))
        with pytest.raises(NoAnswerError):
            drive.quick_stop()
        assert stops(r) == 4  # at once, and three times until it would be acknowledged


def test_a_quick_stop_that_is_not_obeyed_is_told() -> None:
    with rig(CIA402) as r, r.drive as drive:
        assert isinstance(r.face, Cia402Registers)
        drive.enable()
        drive.start_move(200.0, 50.0)
        r.clock.sleep_s(0.5)
        r.face.profile.defects.add(CanFaultKind.LOCAL_CONTROL)
        with pytest.raises(MotionTimeoutError, match="the quick stop was sent, but it stays enabled"):
            drive.quick_stop()
        r.face.profile.defects.clear()


def test_a_stop_leaves_the_other_bits_of_its_register_alone(tmp_path: Path) -> None:
    source = load_drive_map(CIA402).registers.path.read_text(encoding="utf-8")
    whole = 'write = [{ register = "controlword", value = 0x0002 }]'
    assert source.count(whole) == 1
    path = tmp_path / "masked.toml"
    masked = 'write = [{ register = "controlword", mask = 0x0004, value = 0 }]'
    path.write_text(source.replace(whole, masked), encoding="utf-8")
    with rig(CIA402, map_path=path) as r, r.drive as drive:
        drive.enable()
        before = r.server.requests
        drive.send_stop()
        drive.sample()
        assert r.server.seen[before][1] == bytes.fromhex("06 21 00 00 0B")  # 000Fh without bit 2
        assert drive.sample().state is DriveState.QUICK_STOP


# -- coming to rest ------------------------------------------------------------------------------------------------------
def unsteady(r: Rig, counts: int) -> None:
    """A drive whose velocity is never 0, and whose position jumps by so many counts."""
    assert isinstance(r.face, Cia402Registers)
    sign = itertools.cycle((0, 1))
    r.face.dictionary.set_number(0x605A, 0, 6)  # it stays in "quick stop active"
    r.face.dictionary.on_read(0x606C, 0, lambda: 777)
    r.face.dictionary.on_read(0x6064, 0, lambda: r.servo.position_actual_counts + counts * next(sign))


def off_at(r: Rig) -> list[int]:
    """Speeds at which power went, counts/s."""
    speeds: list[int] = []
    power_off = r.servo.power_off

    def off() -> None:
        if r.servo.powered:
            speeds.append(r.servo.velocity_actual_counts_s)
        power_off()

    r.servo.power_off = off  # type: ignore[method-assign]
    return speeds


def test_an_axis_not_seen_at_rest_is_quick_stopped_and_disabled_all_the_same() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        unsteady(r, 2000)
        with pytest.raises(MotionTimeoutError, match="quick-stopped and disabled nevertheless"):
            drive.disable()
        assert not r.servo.powered
        assert stops(r) >= 1


def test_an_axis_not_seen_at_rest_that_would_fall_is_held() -> None:
    with rig(CIA402) as r:
        drive = r.drive
        drive.falls_without_power = True
        drive.open()
        drive.enable()
        drive.start_move(1.0, 10.0)
        unsteady(r, 2000)
        with pytest.raises(HeldUnderPowerError, match="gravity can move its axis: it is left under power"):
            drive.disable()
        with pytest.raises(HeldUnderPowerError):
            drive.close()
        assert r.servo.powered
        assert r.face.profile.state is DriveState.QUICK_STOP  # type: ignore[union-attr]
        assert r.face.dictionary.number(0x6060) == 1  # type: ignore[union-attr]


def set_off(drive: ModbusDrive, how: str) -> None:
    if how == "homing":
        drive.start_homing()
    else:
        drive.start_move(200.0, 100.0)


@pytest.mark.parametrize("how", ["homing", "move"])
def test_disabling_brings_the_axis_to_rest_in_the_time_that_braking_needs(how: str) -> None:
    with rig(CIA402) as r, r.drive as drive:
        assert isinstance(r.face, Cia402Registers)
        drive.enable()
        drive.start_move(100.0, 200.0)
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        for index, value in ((0x6098, 1), (0x609A, 20_000_000)):
            r.face.dictionary.set_number(index, 0, value)
        r.face.dictionary.set_number(0x6099, 1, 500_000)
        set_off(drive, how)
        r.clock.sleep_s(0.4)
        assert abs(r.servo.velocity_actual_counts_s) > 100_000
        speeds, start_ns = off_at(r), r.clock.now_ns()
        drive.disable()
        assert r.clock.now_ns() - start_ns < 2_000_000_000
        assert speeds == [0]
        assert drive.sample().homed is not True


def test_disabling_in_a_stream_brings_the_axis_to_rest_first() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.enable()
        settings = SetPointSettings(0.02, following_error_mm=5.0)
        with drive.stream(settings) as stream:
            for step in range(30):
                stream.cycle([0.5 * step])
            speeds, start_ns = off_at(r), r.clock.now_ns()
            drive.disable()
            assert r.clock.now_ns() - start_ns < 2_000_000_000
            assert speeds == [0]
        assert not r.servo.powered


def test_a_stream_that_cannot_be_entered_or_left_leaves_the_axis_without_power() -> None:
    for nth, what in ((1, "entered"), (2, "left")):
        with rig(CIA402) as r, r.drive as drive:
            assert isinstance(r.face, Cia402Registers)
            drive.enable()
            r.face.profile.defects |= {CanFaultKind.MODE_STUCK} if nth == 1 else set()
            with pytest.raises(MotionTimeoutError, match="change of mode"), drive.stream(SetPointSettings(0.02)):  # noqa: PT012
                assert what == "left"
                r.face.profile.defects.add(CanFaultKind.MODE_STUCK)
            assert not r.servo.powered


# -- leaving -------------------------------------------------------------------------------------------------------------
def test_a_drive_that_falls_silent_for_a_while_is_disabled_and_put_back_by_closing(each: Rig) -> None:
    names = ("profile_velocity",) if isinstance(each.face, Cia402Registers) else ("target_speed",)
    with each.drive as drive:
        before = drive.access.read(names)
    drive.open()
    drive.enable()
    drive.start_move(200.0, 10.0)
    each.server.faults.add(WireFault(WireFaultKind.LOST_REQUEST, count=3))  # one request and its repeats
    drive.close()
    assert not each.servo.powered
    with each.drive as drive:
        assert drive.access.read(names) == before


def test_a_drive_that_cannot_be_disabled_is_stopped_keeps_its_mode_and_is_told_by_closing() -> None:
    with rig(CIA402) as r:
        drive = r.drive
        drive.open()
        drive.enable()
        drive.start_move(200.0, 10.0)
        r.clock.sleep_s(0.2)
        assert isinstance(r.face, Cia402Registers)
        r.face.dictionary.set_number(0x605A, 0, 6)  # it does not take power off by itself

        def refused(_state: DriveState) -> None:
            raise AbortError("device failure", 4)

        drive.power.disable = refused  # type: ignore[method-assign, assignment]
        drive.power.post_off = lambda _state: None  # type: ignore[method-assign, assignment]
        with pytest.raises(AbortError, match="device failure"):
            drive.close()
        assert r.servo.velocity_actual_counts_s == 0
        assert stops(r) >= 1
        assert r.face.dictionary.number(0x6081) == 100_000  # as it may be under power


def test_all_that_fails_when_closing_is_told_together() -> None:
    with rig(CIA402) as r:
        drive = r.drive
        drive.open()
        drive.enable()
        drive.start_move(20.0, 10.0)
        assert isinstance(r.face, Cia402Registers)
        r.face.dictionary.set_number(0x605A, 0, 6)

        def refused(_state: DriveState) -> None:
            raise AbortError("device failure", 4)

        drive.power.disable = refused  # type: ignore[method-assign, assignment]
        r.server.faults.add(WireFault(WireFaultKind.EXCEPTION, function=16, count=100, code=4))
        with pytest.raises(
            UndoError, match=r"^profile_velocity not put back: .*device failure.*; profile_acceleration not put back: "
        ) as caught:
            drive.close()
        assert isinstance(caught.value.errors[0], AbortError)


def test_closing_on_a_dead_wire_does_not_raise(each: Rig) -> None:
    drive = each.drive
    drive.open()
    drive.enable()
    each.server.faults.add(WireFault(WireFaultKind.LOST_REQUEST, count=10**6))
    drive.close()
    with pytest.raises(StateError, match="is not open"):
        drive.sample()


def test_a_fault_is_reset_although_a_stop_was_sent_in_it(each: Rig) -> None:
    with each.drive as drive:
        drive.enable()
        each.servo.raise_fault(0x5112)
        each.clock.sleep_s(0.1)
        drive.quick_stop()
        drive.reset_fault()
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
        drive.enable()
        assert each.servo.powered


def test_a_fault_that_stays_is_named_and_not_reset_into_an_enable(each: Rig) -> None:
    with each.drive as drive:
        drive.enable()
        each.servo.raise_fault(0x5112)
        each.servo.reset_fault = lambda: None  # type: ignore[method-assign]
        each.clock.sleep_s(0.1)
        with pytest.raises(DriveFaultError, match="the fault stays") as caught:
            drive.reset_fault()
        assert caught.value.code == 0x5112
        assert not each.servo.powered


@pytest.mark.parametrize(
    ("defect", "what"),
    [
        (CanFaultKind.SAFE_TORQUE_OFF, r"ready to switch on \(mains, STO .*it is switch on disabled"),
        (CanFaultKind.LOCAL_CONTROL, r"ready to switch on \(mains, STO .*it is switch on disabled"),
        (CanFaultKind.BRAKE_STUCK, r"operation enabled \(mains, STO .*it is switched on"),
    ],
)
def test_a_drive_that_does_not_come_up_says_where_it_is_stuck(defect: CanFaultKind, what: str) -> None:
    with rig(CIA402) as r, r.drive as drive:
        assert isinstance(r.face, Cia402Registers)
        r.face.profile.defects.add(defect)
        with pytest.raises(MotionTimeoutError, match=what):
            drive.enable()
        r.face.profile.defects.clear()  # and the brake opens at last
        r.clock.sleep_s(5.0)
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED


def test_a_fault_on_the_way_up_ends_enabling(each: Rig) -> None:
    with each.drive as drive:
        each.servo.power_on = lambda: each.servo.raise_fault(0x3220)  # type: ignore[method-assign]
        with pytest.raises(DriveFaultError, match="fault while trying to enable") as caught:
            drive.enable()
        assert caught.value.code == 0x3220


def test_a_state_the_map_does_not_know_is_a_protocol_error() -> None:
    with rig(CIA402) as r, r.drive as drive:
        assert isinstance(r.face, Cia402Registers)
        r.face.profile.defects.add(CanFaultKind.STATUS_IMPOSSIBLE)
        with pytest.raises(ProtocolError, match=r"statusword 0x[0-9a-f]+ is no state that its register map knows"):
            drive.sample()
        r.face.profile.defects.clear()


def store(drive: ModbusDrive) -> None:
    (result,) = drive.raw.line.run([drive.raw.store()])
    if isinstance(result, BridgeError):
        raise result


# -- parameters --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "what"), [("controlword", "is a command, a target"), ("target_position", "is a command, a target")]
)
def test_what_moves_the_axis_is_no_parameter(name: str, what: str) -> None:
    with rig(CIA402) as r, r.drive as drive:
        with pytest.raises(CapabilityError, match=what):
            drive.parameters.write(name, 1)
        assert not drive.parameters.describe(name).writable
        with pytest.raises(CapabilityError, match="statusword is read only"):
            drive.parameters.write("statusword", 1)


def test_eeprom_is_spared_and_the_count_outlives_the_process(tmp_path: Path) -> None:
    ledger = tmp_path / "wear.json"
    with rig(VENDOR, wear=WearLedger(ledger)) as r, r.drive as drive:
        for value in range(1, 21):
            assert drive.parameters.write("origin_offset", value)
            assert not drive.parameters.write("origin_offset", value)
        with pytest.raises(
            StateError, match="origin_offset is kept in EEPROM and was written 20 times, its budget is 20"
        ):
            drive.parameters.write("origin_offset", 99)
        assert isinstance(r.face, VendorRegisters)
        assert r.face.eeprom_writes == {"origin_offset": 20}
    with rig(VENDOR, wear=WearLedger(ledger)) as r, r.drive as drive:
        assert drive.raw.wear.writes("X", "origin_offset") == 20
        with pytest.raises(StateError):
            drive.parameters.write("origin_offset", 99)
        assert drive.parameters.write("origin_creep", 5.0)


@pytest.mark.parametrize("name", ["max_torque", "position_gain", "following_error_window"])
def test_a_parameter_beyond_its_maps_limits_is_put_back_as_found(name: str, tmp_path: Path) -> None:
    path, table = tmp_path / "map.toml", f"[registers.{name}]\n"
    text = re.sub(r"(?m)^limits = .*\n", "", find_map(CIA402).read_text(encoding="utf-8"))
    path.write_text(text.replace(table, f"{table}limits = [1, 50]\n"), encoding="utf-8")
    with rig(CIA402, map_path=path) as r, r.drive as drive:
        before = drive.parameters.read(name)
        assert isinstance(before, int | float)
        assert before > 50
        assert drive.parameters.write(name, before) is False
        assert drive.parameters.write(name, 2) is True
        assert drive.parameters.write(name, before) is True
        assert drive.parameters.read(name) == before
        with pytest.raises(InputError, match=f"{name}: .* is above its limit 50"):
            drive.parameters.write(name, before - 1)


@pytest.mark.parametrize(
    ("value", "why"), [(300.04, "300.04 is above its limit 300"), (-0.04, "-0.04 is below its limit 0")]
)
def test_a_value_outside_the_limits_is_not_rounded_into_them(value: float, why: str) -> None:
    with rig(VENDOR) as r, r.drive as drive:
        for held in (300.0, 0.0, 123.4):
            drive.parameters.write("torque_limit", held)
            with pytest.raises(InputError, match=rf"torque_limit: {why}, allowed is 0 to 300 percent"):
                drive.parameters.write("torque_limit", value)
            assert drive.parameters.read("torque_limit") == pytest.approx(held)


def test_only_what_the_drive_holds_for_a_limit_may_lie_beyond_it(tmp_path: Path) -> None:
    """A number of four bytes holds 0.1 as 0.100000001, a whole number of steps of 0.1 holds 0.3 as 0.30000000000000004."""
    path, text = tmp_path / "map.toml", re.sub(r"(?m)^limits = .*\n", "", find_map(CIA402).read_text(encoding="utf-8"))
    for name, more in (
        ("following_error_window", "limits = [0.001, 2000000.0]\nscale = 0.001\n"),
        ("position_gain", "limits = [0.01, 0.1]\n"),
        ("max_torque", "limits = [0, 0.3]\n"),
    ):
        text = text.replace(f"[registers.{name}]\n", f"[registers.{name}]\n{more}")
    path.write_text(text, encoding="utf-8")
    with rig(CIA402, map_path=path) as r, r.drive as drive:
        for name, limit, low in (
            ("following_error_window", 2_000_000.0, 0.5),
            ("position_gain", 0.1, 0.05),
            ("max_torque", 0.3, 0.1),
        ):
            drive.parameters.write(name, low)
            assert drive.parameters.write(name, limit)
            held = drive.parameters.read(name)
            assert isinstance(held, float)
            assert held == pytest.approx(limit, rel=1e-7)
            assert drive.parameters.write(name, low)
            assert drive.parameters.write(name, held)
            with pytest.raises(InputError, match=f"{name}: .* is above its limit"):
                drive.parameters.write(name, limit * (1.0 + 5e-8))


def test_a_refused_parameter_names_itself() -> None:
    with rig(CIA402) as r, r.drive as drive:
        r.server.faults.add(WireFault(WireFaultKind.EXCEPTION, writes=True, code=3))
        with pytest.raises(
            AbortError, match=r"drive X refuses following_error_window = 5: .*illegal data value"
        ) as caught:
            drive.parameters.write("following_error_window", 5)
        assert caught.value.code == 3


def test_a_parameter_the_drive_silently_changes_is_found_out() -> None:
    with rig(CIA402) as r, r.drive as drive:
        assert isinstance(r.face, Cia402Registers)
        r.face.dictionary.on_read(0x6067, 0, lambda: 20)
        with pytest.raises(ProtocolError, match="position_window was written 77, it reads back 20"):
            drive.parameters.write("position_window", 77)


def test_storing_waits_until_the_drive_is_done() -> None:
    with rig(CIA402) as r, r.drive as drive:
        drive.require(Capability.STORE)
        assert isinstance(r.face, Cia402Registers)
        start_ns = r.clock.now_ns()
        store(drive)
        assert r.face.stores == 1
        assert r.clock.now_ns() - start_ns >= 200_000_000
        drive.enable()
        with pytest.raises(StateError, match="disable it before storing"):
            store(drive)
    with rig(VENDOR) as r, r.drive as drive, pytest.raises(CapabilityError):
        store(drive)


def test_a_drive_that_is_busy_while_it_stores_has_the_time_that_its_map_gives() -> None:
    """5 s: longer than a busy drive is asked again by a single request."""
    with rig(CIA402) as r, r.drive as drive:
        r.server.faults.add(WireFault(WireFaultKind.EXCEPTION, code=6, nth=2, count=180, function=3))  # at 20 ms: 3.6 s
        store(drive)
        r.server.faults.clear()
        r.server.faults.add(WireFault(WireFaultKind.EXCEPTION, code=6, count=999, function=3))
        with pytest.raises(AbortError, match="asked again for 3 s"):
            store(drive)
        r.server.faults.clear()


def test_the_drive_states_its_own_units() -> None:
    with rig(CIA402) as r, r.drive as drive:
        scaling = drive.raw.reported_scaling()
        assert scaling.encoder_counts_per_motor_rev == COUNTS
        assert scaling.feed_mm_per_shaft_rev == 10
        assert scaling.counts_per_load_mm == Fraction(10_000)
    with rig(VENDOR) as r, r.drive as drive:
        scaling = drive.raw.reported_scaling()
        assert scaling.motor_revs_per_shaft_rev == 1
        assert scaling.counts_per_load_mm is None


def test_the_order_of_a_wide_register_is_found_from_what_the_display_shows(each: Rig) -> None:
    name, order = (
        ("position_actual", Order.BIG) if isinstance(each.face, Cia402Registers) else ("position", Order.LITTLE)
    )
    with each.drive as drive:
        drive.enable()
        drive.start_move(123.4567, 100.0)
        drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrived")
        known = each.servo.position_actual_counts
        matches = drive.raw.probe_order(name, known)
        assert {(match.offset, match.layout) for match in matches} == {
            (0, Layout(kind, order)) for kind in (RegisterType.I32, RegisterType.U32)
        }
        assert drive.raw.probe_order(name, known + 3, tolerance=5.0) == matches


# -- its zero ----------------------------------------------------------------------------------------------------------
def test_what_the_zero_rests_on_is_in_the_map(each: Rig) -> None:
    with each.drive as drive:
        zero = drive.zero()
        cia402 = isinstance(each.face, Cia402Registers)
        assert (zero.method, zero.home_position_mm) == (37 if cia402 else 35, 0.0)
        assert zero.identity["map"] == each.drive.registers.name
        assert ("serial_number" in zero.identity) is cia402


def test_whether_the_drive_has_kept_its_zero(each: Rig) -> None:
    """A flag that is always there is believed at once; one of the homing mode is asked for in it, and forgotten with the mode here."""
    with each.drive as drive:
        assert not drive.says_homed()
        drive.enable()
        drive.start_homing()
        drive.wait_for(lambda sample: sample.homed is True, 5.0, "homed")
        assert drive.says_homed() is True
    with each.drive as drive:
        kept = drive.says_homed()
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
    assert kept is (None if isinstance(each.face, Cia402Registers) else True)
