"""Stopping a CANopen axis: what leaves first, by which way, and that no error is raised beside a moving axis."""

from __future__ import annotations

import itertools
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial

import can
import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.canopen.sdo import SdoClient
from drivers.canopen.stream import CyclicStream
from drivers.cia402 import objects
from drivers.cia402.modes import Mode
from drivers.cia402.motion_parts import MoveOrder
from drivers.cia402.power import PowerTimes
from drivers.clock import WallClock
from drivers.drive import DriveState
from drivers.errors import (
    BridgeError,
    FollowingErrorError,
    HeldUnderPowerError,
    LinkLostError,
    MotionTimeoutError,
    NoAnswerError,
    ProtocolError,
    StateError,
)
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from drivers.shutdown import HALT_TAKEN_S, LOOK_S, share_time
from drivers.standstill import STILL_MM_S, STILL_S, Standstill
from drivers.undo import undo_all
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from sim_backends.bare_shaft import SMALL_SERVO
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind

NODE = 5
LIMITS = DriveLimits(-300.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
K = CanFaultKind
STOP_RPDO, STREAM_RPDO, SYNC, SDO = "305#0200", "205#0200", "080#", "605#2B40600002000000"
FIXED_RPDO_2 = (0x1401, 2)
SDO_DEAD = K.SDO_REQUEST_LOST
FAULT_AT_S = 1.0


class Rig:
    """One drive, everything that goes over its wire with its time, and what its servo does."""

    def __init__(self, *faults: CanFault, settings: CanOpenSettings | None = None, **bench: object) -> None:
        servo = replace(SMALL_SERVO, coast_rev_s2=300.0)  # a spring brake closes when the power goes
        self.bench = CanBench((NODE,), faults={NODE: faults}, servo_parameters=servo, **bench)  # type: ignore[arg-type]
        self.clock, self.servo = self.bench.clock, self.bench.servo
        self.frames: list[tuple[int, str]] = []
        self.bench.wire.add_node().on_frame = lambda cob_id, data, now_ns: self.frames.append(
            (now_ns, f"{cob_id:03X}#{data.hex().upper()}")
        )
        self.link = CanLink(self.bench.port(), self.clock)
        scaling = AxisScaling(100_000, 10.0)
        self.drive = CanOpenDrive("X", scaling, LIMITS, self.clock, link=self.link, node_id=NODE, settings=settings)

    def moving(self, velocity_mm_s: float = 200.0) -> CanOpenDrive:
        """Enabled and in the middle of a long move; at `FAULT_AT_S` of the clock where faults are to begin."""
        self.drive.open()
        self.drive.enable()
        self.clock.sleep_until_ns(round((FAULT_AT_S - 0.4) * 1e9))
        self.drive.start_move(280.0, velocity_mm_s)
        self.clock.sleep_until_ns(round(FAULT_AT_S * 1e9) + 1_000_000)
        assert self.servo.velocity_actual_counts_s > 0
        return self.drive

    def sent_since(self, since_ns: int) -> list[str]:
        """The master's frames of this moment, requests that ask for nothing but a look left out."""
        return [
            text for time_ns, text in self.frames if time_ns == since_ns and text[:3] in ("305", "205", "080", "605")
        ]

    @property
    def place_mm(self) -> float:
        return self.servo.motor_rev * 10.0

    def assert_without_power_at_rest(self) -> None:
        assert not self.servo.powered
        assert self.servo.velocity_actual_counts_s == 0


MakeRig = Callable[..., Rig]
BRAKING_MM = 200.0**2 / (2 * 2000.0)


@pytest.fixture
def make() -> Iterator[MakeRig]:
    with ExitStack() as stack:

        def build(*faults: CanFault, **how: object) -> Rig:
            rig = Rig(*faults, **how)  # type: ignore[arg-type]
            stack.callback(rig.link.close)
            return rig

        yield build


# -- a wire that is read with errors ---------------------------------------------------------------------------------------
def undecodable() -> Exception:
    """As python-can's slcan raises it for a byte above 127."""
    error = can.CanOperationError("Could not read from serial device")
    error.__cause__ = UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte")
    return error


def damaging(rig: Rig, errors: Iterator[Exception]) -> None:
    """The next frames are damaged, each by one of these errors."""
    plain = rig.link.bus.recv

    def recv(timeout: float | None = None) -> can.Message | None:
        message = plain(timeout)
        if message is not None and (error := next(errors, None)) is not None:
            raise error
        return message

    rig.link.bus.recv = recv  # type: ignore[method-assign]


@pytest.mark.parametrize("error", [ValueError("non-hexadecimal"), IndexError("out of range"), undecodable()])
def test_a_damaged_frame_costs_a_request_that_is_repeated_and_never_the_move(make: MakeRig, error: Exception) -> None:
    rig = make()
    drive = rig.moving()
    damaging(rig, errors := iter([error]))
    arrived = False
    while not arrived:
        rig.clock.sleep_s(0.01)
        arrived = drive.sample().target_reached
    assert next(errors, None) is None
    assert rig.place_mm == pytest.approx(280.0, abs=5e-4)
    drive.close()


@pytest.mark.parametrize("error", [ValueError("non-hexadecimal"), undecodable(), can.CanOperationError("removed")])
def test_where_reading_fails_for_good_the_axis_is_stopped_and_disabled_by_what_can_be_sent(
    make: MakeRig, error: Exception
) -> None:
    """The quick stop has its ramp before the power goes, as where a drive does not answer."""
    rig = make()
    drive = rig.moving()

    def recv(timeout: float | None = None) -> can.Message | None:
        raise error

    rig.link.bus.recv = recv  # type: ignore[method-assign]
    with pytest.raises(LinkLostError, match=r"is gone: \d+ reads in a row failed"):
        drive.sample()
    with suppress(BridgeError):
        drive.disable()
    rig.clock.sleep_s(0.05)
    rig.assert_without_power_at_rest()
    sent = [(time_ns, text) for time_ns, text in rig.frames if time_ns >= FAULT_AT_S * 1e9 and text[:3] == "305"]
    assert sent[0][1] == STOP_RPDO
    off_ns = next(time_ns for time_ns, text in sent if text == "305#0000")
    assert off_ns - sent[0][0] >= 0.1e9  # 200 mm/s by 2000 mm/s²


# -- what leaves, and when ------------------------------------------------------------------------------------------------


def _move(drive: CanOpenDrive) -> None:
    drive.start_move(280.0, 200.0)


def _home(drive: CanOpenDrive) -> None:
    drive.settings = CanOpenSettings(homing=HomingSettings(method=18, speed_switch_mm_s=100.0))
    drive.start_homing()


def _halt(drive: CanOpenDrive) -> None:
    _move(drive)
    drive.motion.halt()


@pytest.mark.parametrize("order", [_move, _home, _halt, lambda drive: None], ids=["move", "home", "halt", "hold"])
@pytest.mark.parametrize(
    ("fixed", "frames"),
    [((), [STOP_RPDO, SDO]), ((FIXED_RPDO_2,), [STREAM_RPDO, SYNC, SDO])],
    ids=["event-rpdo", "synchronous-rpdo"],
)
def test_the_stop_leaves_at_once_by_every_way_the_fastest_first(
    make: MakeRig, order: Callable[[CanOpenDrive], None], fixed: tuple[tuple[int, int], ...], frames: list[str]
) -> None:
    rig = make(refused=fixed, parameters={(0x1401, 2): 1} if fixed else {})
    rig.drive.open()
    rig.drive.enable()
    order(rig.drive)
    rig.clock.sleep_s(0.3)
    asked_ns, place_mm = rig.clock.now_ns(), rig.place_mm
    rig.drive.send_stop()
    assert rig.clock.now_ns() == asked_ns
    sent = [text[:8] if text.startswith("205#") else text for text in rig.sent_since(asked_ns)]
    assert sent == frames
    rig.clock.sleep_s(0.5)
    assert rig.servo.velocity_actual_counts_s == 0
    assert rig.bench.slave.profile.state in (DriveState.QUICK_STOP, DriveState.SWITCH_ON_DISABLED)
    assert rig.place_mm - place_mm <= BRAKING_MM + 1.0


@pytest.mark.parametrize("way", [SDO_DEAD, K.RPDO_LOST, K.TPDO_LOST])
def test_one_way_is_enough_for_the_stop_and_for_its_confirmation(make: MakeRig, way: CanFaultKind) -> None:
    rig = make(CanFault(way, at_s=FAULT_AT_S))
    drive = rig.moving()
    place_mm = rig.place_mm
    drive.quick_stop()
    rig.clock.sleep_s(0.5)
    assert rig.servo.velocity_actual_counts_s == 0
    assert rig.place_mm - place_mm <= BRAKING_MM + 1.0


def test_a_stop_that_nobody_confirms_is_an_error_and_was_sent(make: MakeRig) -> None:
    rig = make(CanFault(SDO_DEAD, at_s=FAULT_AT_S), CanFault(K.TPDO_LOST, at_s=FAULT_AT_S))
    drive = rig.moving()
    asked_ns, place_mm = rig.clock.now_ns(), rig.place_mm
    with pytest.raises(NoAnswerError):
        drive.quick_stop()
    assert rig.clock.now_ns() - asked_ns < 2e9
    assert rig.servo.velocity_actual_counts_s == 0
    assert rig.place_mm - place_mm <= BRAKING_MM + 1.0


def test_a_drive_that_does_not_listen_is_named(make: MakeRig) -> None:
    rig = make(CanFault(K.LOCAL_CONTROL, at_s=FAULT_AT_S))
    with pytest.raises(MotionTimeoutError, match=r"quick stop was sent, but it stays enabled .*remote bit 9 is 0"):
        rig.moving().quick_stop()


@pytest.mark.parametrize(
    ("lacking", "fixed", "expected"),
    [((), (), 255), ((), (FIXED_RPDO_2,), None), ((0x1401, 0x1601), (), None)],
    ids=["as-built", "type-fixed", "no-rpdo-2"],
)
def test_a_drive_without_an_event_driven_rpdo_is_noted(
    make: MakeRig, lacking: tuple[int, ...], fixed: tuple[tuple[int, int], ...], expected: int | None
) -> None:
    rig = make(lacking=lacking, refused=fixed, parameters={(0x1401, 2): 1})
    with rig.drive as drive:
        stop = drive.connection.stop_rpdo
        assert (stop.kind if stop else None) == expected
        assert any("takes no event-driven RPDO 2" in note for note in drive.notes) is (expected is None)
        drive.enable()
        drive.start_move(10.0, 50.0)


def test_the_makers_event_type_is_taken_where_the_profiles_is_refused(make: MakeRig) -> None:
    rig = make()

    rig.bench.slave.dictionary.set_number(0x1401, 2, 1)
    item = rig.bench.slave.dictionary.items[0x1401, 2]
    rig.bench.slave.dictionary.items[0x1401, 2] = replace(item, high=254)
    with rig.drive as drive:
        assert drive.connection.stop_rpdo is not None
        assert drive.connection.stop_rpdo.kind == 254
        drive.enable()
        drive.send_stop()
        assert rig.bench.slave.profile.state is not DriveState.ENABLED


def test_a_stop_never_raises(make: MakeRig) -> None:
    rig = make()
    rig.drive.send_stop()  # not open
    drive = rig.moving()
    rig.link.bus.shutdown()
    drive.send_stop()
    with pytest.raises(LinkLostError):
        drive.quick_stop()


def test_a_stop_from_another_thread_does_not_wait_for_one_that_receives() -> None:
    """On a bus where nobody answers, one thread waits for an SDO answer; another one sends the stop meanwhile."""
    channel = uuid.uuid4().hex
    with (
        CanLink.open(WallClock(), interface="virtual", channel=channel) as link,
        can.Bus(interface="virtual", channel=channel) as peer,
    ):
        client = SdoClient(link, NODE, "drive X", timeout_s=20.0)
        ended: list[BaseException] = []

        def ask() -> None:
            try:
                client.read(objects.STATUSWORD)
            except BridgeError as error:
                ended.append(error)

        asking = threading.Thread(target=ask)
        asking.start()
        assert peer.recv(10.0) is not None  # the request: the other thread waits for its answer now, holding the link
        client.send_at_once(objects.CONTROLWORD, 0x0002)
        frames = [peer.recv(10.0), peer.recv(10.0)]
        asking.join(10.0)
        assert [bytes(frame.data).hex() for frame in frames if frame] == ["8041600000000008", "2b40600002000000"]
        assert not asking.is_alive()
        assert [type(error) for error in ended] == [StateError]


@pytest.mark.parametrize("reading", [True, False])
def test_a_stop_in_the_middle_of_a_long_transfer(make: MakeRig, reading: bool) -> None:
    """The server drops what it was sending or receiving, the stop is taken, and the channel works afterwards."""
    rig = make()
    drive = rig.moving()
    segments: list[int] = []

    def at_the_second_segment(_time_ns: int, cob_id: int, data: bytes) -> None:
        if cob_id == 0x585 and data[0] >> 5 in (0, 1):
            segments.append(1)
            if len(segments) == 2:
                drive.send_stop()

    rig.link.watch(at_the_second_segment)
    transfer = (
        partial(drive.sdo.read_bytes, 0x1008, 0) if reading else partial(drive.sdo.write_bytes, 0x1010, 1, bytes(70))
    )
    with pytest.raises(StateError, match="broken off by a stop"):
        transfer()
    rig.link.unwatch(at_the_second_segment)
    assert drive.sdo.read(objects.STATUSWORD) & 0x6F != 0x27
    assert drive.sdo.read_bytes(0x1008, 0) == b"Simulated feed axis servo drive"


@pytest.mark.parametrize("option", [2, 6])
def test_no_order_enables_the_axis_after_a_stop(make: MakeRig, option: int) -> None:
    """In quick stop active "enable operation" is what lets a drive go on (transition 16), and every order contains it."""
    rig = make(parameters={(0x605A, 0): option})
    drive = rig.moving()
    drive.send_stop()
    for order in (drive.motion.halt, lambda: drive.motion.move(MoveOrder(0, 100_000, 1_000_000))):
        with pytest.raises(StateError, match="was told to stop: enable it before the next command"):
            order()
    rig.clock.sleep_s(0.5)
    place_mm = rig.place_mm
    assert rig.bench.slave.profile.state is not DriveState.ENABLED
    rig.clock.sleep_s(0.2)
    assert rig.place_mm == place_mm
    drive.enable()
    drive.start_move(place_mm + 1.0, 50.0)


# -- streams --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fixed", [(), (FIXED_RPDO_2,)], ids=["event-rpdo", "synchronous-rpdo"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_stop_in_the_middle_of_a_cycle_is_not_undone_by_the_set_point_that_waits_for_sync(
    make: MakeRig, fixed: tuple[tuple[int, int], ...], share: float
) -> None:
    """605Ah = 6: the drive holds after its quick stop, and a set-point with "enable operation" would let it go on."""
    rig = make(refused=fixed, parameters={(0x605A, 0): 6})
    drive = rig.drive
    drive.open()
    drive.enable()
    period_s, at_ns, states = 0.01, [0], []
    words: list[int] = []  # that the drive takes once the stop was sent
    rig.bench.slave.dictionary.on_write(0x6040, 0, lambda word: words.append(word) if states else None)

    def press(now_ns: int, _dt_s: float) -> None:
        if at_ns[0] and now_ns >= at_ns[0]:
            at_ns[0] = 0
            states.append(now_ns)
            drive.send_stop()

    def run() -> None:
        with CyclicStream([drive], SetPointSettings(period_s)) as stream:
            for cycle in range(60):
                if cycle == 40:
                    at_ns[0] = rig.clock.now_ns() + round(share * period_s * 1e9) + 1
                    rig.clock.attach(press, bearable=lambda now_ns: max(1, at_ns[0] - now_ns) if at_ns[0] else 1 << 60)
                stream.cycle([0.5 * cycle])

    with pytest.raises(StateError, match="was told to stop while streaming"):
        run()
    assert states
    assert rig.bench.slave.profile.state is DriveState.QUICK_STOP
    rig.clock.sleep_s(0.5)
    assert rig.bench.slave.profile.state is DriveState.QUICK_STOP
    assert set(words) == {0x0002}
    assert rig.servo.velocity_actual_counts_s == 0
    assert rig.place_mm < 0.5 * 41 + 1.0
    stopped = [time_ns for time_ns, text in rig.frames if text in (STOP_RPDO, SDO) and time_ns >= states[0]]
    assert stopped[0] - states[0] <= 1_000_000


@pytest.mark.parametrize("fixed", [(), (FIXED_RPDO_2,)], ids=["event-rpdo", "synchronous-rpdo"])
def test_a_set_point_that_leaves_after_the_stop_does_not_undo_it(
    make: MakeRig, fixed: tuple[tuple[int, int], ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread sends the stop between the check of this cycle and its set-point."""
    rig = make(refused=fixed, parameters={(0x605A, 0): 6})
    drive = rig.drive
    drive.open()
    drive.enable()
    words: list[int] = []

    def run() -> None:
        with CyclicStream([drive], SetPointSettings(0.01)) as stream:
            for cycle in range(20):
                stream.cycle([0.5 * cycle])
            (axis,) = stream._axes
            plan = axis.plan

            def late(position_load_mm: float) -> None:
                plan(position_load_mm)
                drive.send_stop()
                rig.bench.slave.dictionary.on_write(0x6040, 0, words.append)

            monkeypatch.setattr(axis, "plan", late)
            stream.cycle([10.0])

    with pytest.raises(StateError, match="was told to stop while streaming"):
        run()
    rig.clock.sleep_s(0.1)
    assert set(words) == {0x0002}
    assert rig.bench.slave.profile.state is DriveState.QUICK_STOP


def test_an_axis_that_something_else_disables_in_a_stream_stays_disabled(make: MakeRig) -> None:
    """A panel or a second master writes "shutdown": no set-point may switch on again what somebody has switched off."""
    rig = make()
    drive = rig.drive
    drive.open()
    drive.enable()
    states: list[DriveState] = []

    def run() -> None:
        with CyclicStream([drive], SetPointSettings(0.01)) as stream:
            for cycle in range(60):
                if cycle == 40:
                    rig.bench.slave.dictionary.write(0x6040, 0, b"\x06\x00")
                    rig.clock.attach(lambda _now_ns, _dt_s: states.append(rig.bench.slave.profile.state))
                stream.cycle([0.5 * cycle])

    with pytest.raises(StateError, match="left operation enabled while streaming"):
        run()
    assert states
    assert DriveState.ENABLED not in states


STILL_LOOKS = round(STILL_S / LOOK_S)


# -- standstill -------------------------------------------------------------------------------------------------------------


def _looks(positions: Callable[[int], int], velocity: Callable[[int], int | None]) -> int | None:
    """The number of the look that says "stands", at 10 000 counts/mm and `LOOK_S` apart; None of a hundred."""
    standstill = Standstill(1e-4)
    for look in range(100):
        counts_per_s = velocity(look)
        velocity_mm_s = None if counts_per_s is None else 1e-4 * counts_per_s
        if standstill.look(round(look * LOOK_S * 1e9), 1e-4 * positions(look), velocity_mm_s):
            return look
    return None


@pytest.mark.parametrize(
    ("positions", "velocity", "expected"),
    [
        (lambda n: 0, lambda n: 0, 2),  # a velocity of 0, and positions that agree for 20 ms
        (lambda n: 0, lambda n: None, STILL_LOOKS),  # no 606Ch
        (lambda n: n % 2, lambda n: 90_000, STILL_LOOKS),  # 606Ch in other units: positions
        (lambda n: 90 * (n % 2), lambda n: 4_000, STILL_LOOKS),  # hunts by 9 µm, 606Ch is low
        (lambda n: 1000 * n, lambda n: 0, None),  # 606Ch is stuck
        (lambda n: 1000 * n, lambda n: 3, None),  # 606Ch in other units contradicts the positions
        (lambda n: 1000 * n, lambda n: None, None),
        (lambda n: 10 * n, lambda n: None, None),  # creeps with 0.1 mm/s
        (lambda n: 1000 * min(n, 30), lambda n: None, 30 + STILL_LOOKS),
    ],
)
def test_standstill(
    positions: Callable[[int], int], velocity: Callable[[int], int | None], expected: int | None
) -> None:
    assert _looks(positions, velocity) == expected


# -- disabling ----------------------------------------------------------------------------------------------------------------


def test_disabling_ends_a_homing_in_the_time_that_braking_needs(make: MakeRig) -> None:
    rig = make(settings=CanOpenSettings(homing=HomingSettings(method=2, speed_switch_mm_s=50.0, speed_zero_mm_s=1.0)))
    drive = rig.drive
    drive.open()
    drive.enable()
    drive.start_homing()
    rig.clock.sleep_s(0.5)
    asked_ns = rig.clock.now_ns()
    speeds: list[int] = []
    rig.bench.slave.dictionary.on_write(0x6040, 0, lambda word: speeds.append(rig.servo.velocity_actual_counts_s))
    drive.disable()
    assert rig.clock.now_ns() - asked_ns < 0.5e9
    assert not rig.servo.powered
    assert speeds[0] == 500_000
    powering_down = speeds[2:]  # the first two are the halt, by RPDO and by SDO
    assert powering_down
    assert max(powering_down) <= STILL_MM_S * 10_000  # at rest, as far as 606Ch can tell
    assert drive.sample().homed is False


def test_an_axis_that_never_shows_its_arrival_is_disabled_by_its_positions(make: MakeRig) -> None:
    rig = make(CanFault(K.NEVER_ARRIVES))
    drive = rig.moving()
    asked_ns = rig.clock.now_ns()
    drive.disable()
    assert rig.clock.now_ns() - asked_ns < 1e9
    rig.assert_without_power_at_rest()


def test_an_axis_that_goes_on_after_a_halt_is_quick_stopped_when_its_ramp_should_be_over(make: MakeRig) -> None:
    rig = make()
    drive = rig.moving(20.0)
    rig.servo.halt = lambda *_: None  # type: ignore[method-assign]
    asked_ns = rig.clock.now_ns()
    drive.disable()
    limits = drive.limits
    allowed_s = HALT_TAKEN_S + 3.0 * limits.max_velocity_mm_s / limits.max_acceleration_mm_s2
    assert allowed_s < (rig.clock.now_ns() - asked_ns) * 1e-9 < allowed_s + 0.5
    rig.assert_without_power_at_rest()


RESTLESS = CanOpenSettings(power=PowerTimes(stop_s=0.5))


def restless(rig: Rig) -> Rig:
    """From now on the drive shows an axis that is never at rest."""
    dictionary, places = rig.bench.slave.dictionary, itertools.cycle((0, 2000))
    dictionary.on_read(0x606C, 0, lambda: 777)
    dictionary.on_read(0x6064, 0, lambda: rig.servo.position_actual_counts + next(places))
    return rig


@pytest.mark.parametrize("option", [2, 6])
def test_an_axis_that_is_not_seen_at_rest_is_quick_stopped_and_disabled_all_the_same(
    make: MakeRig, option: int
) -> None:
    rig = restless(make(settings=RESTLESS, parameters={(0x605A, 0): option}))
    drive = rig.moving()
    if option == 2:  # the drive disables itself after its quick stop: that counts
        drive.disable()
    else:
        with pytest.raises(MotionTimeoutError, match="quick-stopped and disabled nevertheless"):
            drive.disable()
    assert SDO in [text for _, text in rig.frames]
    rig.assert_without_power_at_rest()


@pytest.mark.parametrize(("option", "state"), [(2, DriveState.ENABLED), (6, DriveState.QUICK_STOP)])
def test_an_axis_that_falls_is_held_instead(make: MakeRig, option: int, state: DriveState) -> None:
    """By the quick stop where the drive holds after it, else by the halt: a quick stop would end without power."""
    rig = restless(make(settings=RESTLESS, parameters={(0x605A, 0): option}))
    rig.drive.falls_without_power = True
    drive = rig.moving()
    assert any("switches its power off" in note for note in drive.notes) is (option == 2)
    with pytest.raises(HeldUnderPowerError, match="drive X was stopped but not seen at rest"):
        drive.disable()
    assert rig.servo.powered
    assert rig.bench.slave.profile.state is state
    assert rig.servo.velocity_actual_counts_s == 0
    with pytest.raises(HeldUnderPowerError):
        drive.close()
    assert rig.servo.powered


def test_an_axis_that_falls_is_disabled_once_it_was_seen_at_rest(make: MakeRig) -> None:
    rig = make()
    rig.drive.falls_without_power = True
    rig.moving().disable()
    rig.assert_without_power_at_rest()


# -- orders that are not confirmed ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "order", "error"),
    [
        (K.SETPOINT_NOT_TAKEN, lambda drive: drive.start_move(-100.0, 100.0), ProtocolError),
        (K.ACKNOWLEDGE_STUCK, lambda drive: drive.start_move(-100.0, 100.0), ProtocolError),
        (K.MODE_STUCK, lambda drive: drive.set_mode(Mode.CYCLIC_POSITION), ProtocolError),
        (K.MODE_STUCK, lambda drive: drive.start_homing(), ProtocolError),
        (K.SDO_WRITE_ABORTED, lambda drive: drive.start_move(-100.0, 100.0), BridgeError),
        (SDO_DEAD, lambda drive: drive.start_move(-100.0, 100.0), NoAnswerError),
        (K.SDO_LOST, lambda drive: drive.start_move(-100.0, 100.0), NoAnswerError),
    ],
)
def test_an_order_that_is_not_confirmed_leaves_no_moving_axis(
    make: MakeRig, fault: CanFaultKind, order: Callable[[CanOpenDrive], None], error: type[BridgeError]
) -> None:
    size = 0x08000022 if fault is K.SDO_WRITE_ABORTED else 0.0
    rig = make(CanFault(fault, at_s=FAULT_AT_S, size=size))
    drive = rig.moving(100.0)
    with pytest.raises(error):
        order(drive)
    rig.assert_without_power_at_rest()


HALT = "605#2B4060000F010000"


@pytest.mark.parametrize(("falls", "first"), [(False, STOP_RPDO), (True, HALT)])
def test_an_axis_whose_order_is_not_confirmed_is_quick_stopped_before_anything_else(
    make: MakeRig, falls: bool, first: str
) -> None:
    """But for one that gravity can move and whose quick stop (605Ah is 2) ends without power."""
    rig = make(CanFault(K.ACKNOWLEDGE_STUCK, at_s=FAULT_AT_S))
    drive = rig.moving(100.0)
    drive.falls_without_power = falls
    with pytest.raises(ProtocolError, match="acknowledge"):
        drive.start_move(-100.0, 100.0)
    assert next(text for _, text in rig.frames if text in (STOP_RPDO, HALT)) == first
    rig.assert_without_power_at_rest()


def test_an_axis_that_moves_elsewhere_while_it_takes_a_set_point_is_stopped_at_once(make: MakeRig) -> None:
    """As another master moves it: 1 mm, and what it brakes from there, instead of the 100 mm of the time for the acknowledge."""
    rig = make(CanFault(K.SETPOINT_NOT_TAKEN, at_s=FAULT_AT_S))
    drive = rig.drive
    drive.open()
    drive.enable()
    rig.clock.sleep_until_ns(round(FAULT_AT_S * 1e9))
    here_mm = rig.place_mm
    rig.servo.move_absolute(-1_000_000, 2_000_000, 20_000_000)
    with pytest.raises(FollowingErrorError, match="was given the target 500000 and moves elsewhere"):
        drive.start_move(50.0, 100.0)
    assert abs(rig.place_mm - here_mm) < 5.0
    rig.assert_without_power_at_rest()


def test_an_interrupt_in_the_middle_of_an_order_sends_a_stop(make: MakeRig) -> None:
    rig = make()
    drive = rig.moving(100.0)

    def interrupt(word: int) -> None:
        if word & 0x10:
            raise KeyboardInterrupt

    rig.bench.slave.dictionary.on_write(0x6040, 0, interrupt)
    with pytest.raises(KeyboardInterrupt):
        drive.start_move(-100.0, 100.0)
    assert rig.bench.slave.profile.state is DriveState.QUICK_STOP


def test_an_enabling_that_is_given_up_does_not_come_true_later(make: MakeRig) -> None:
    """A brake that opens after the time-out must not complete it."""
    rig = make(settings=CanOpenSettings(power=PowerTimes(enable_s=0.5)))
    rig.bench.slave.profile.brake_delay_ns = 800_000_000
    rig.drive.open()
    with pytest.raises(MotionTimeoutError, match="brake"):
        rig.drive.enable()
    rig.clock.sleep_s(1.0)
    assert rig.bench.slave.profile.state is not DriveState.ENABLED
    assert not rig.servo.powered


# -- closing --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("faults", "put_back"),
    [
        ((K.HEARTBEAT_STOPS,), True),
        ((K.HEARTBEAT_STOPS, K.TPDO_LOST), True),
        ((K.HEARTBEAT_STOPS, K.RPDO_LOST), True),
        ((K.HEARTBEAT_STOPS, SDO_DEAD), False),
        ((K.HEARTBEAT_STOPS, SDO_DEAD, K.TPDO_LOST), False),
        ((SDO_DEAD,), False),
        ((K.NMT_PRE_OPERATIONAL,), True),  # what CiA-301 has a node do that misses a heartbeat itself
        ((K.NEVER_ARRIVES,), True),
    ],
    ids=lambda value: "+".join(kind.name.lower() for kind in value) if isinstance(value, tuple) else None,
)
@pytest.mark.parametrize("option", [2, 6])
@pytest.mark.parametrize("fixed", [(), (FIXED_RPDO_2,)], ids=["event-rpdo", "synchronous-rpdo"])
def test_a_drive_that_can_still_be_reached_is_stopped_and_disabled_on_the_way_out(
    make: MakeRig, faults: tuple[CanFaultKind, ...], put_back: bool, fixed: tuple[tuple[int, int], ...], option: int
) -> None:
    rig = make(
        *(CanFault(kind, at_s=FAULT_AT_S) for kind in faults),
        settings=CanOpenSettings(guard_s=5.0),
        refused=fixed,
        parameters={(0x605A, 0): option},
    )
    watched = (0x1800, 1), (0x1A00, 0), (0x1017, 0), (0x1016, 1), (0x6007, 0), (0x6060, 0), (0x6081, 0), (0x1600, 0)
    before = [rig.bench.slave.dictionary.number(*key) for key in watched]
    drive = rig.moving(50.0)
    rig.clock.sleep_s(0.6)  # the heartbeat's grace is over
    place_mm = rig.place_mm
    drive.close()
    rig.assert_without_power_at_rest()
    assert rig.place_mm - place_mm < 50.0 * 0.2
    assert ([rig.bench.slave.dictionary.number(*key) for key in watched] == before) is put_back


def test_a_guard_is_left_in_the_drive_of_an_axis_that_may_still_move(make: MakeRig) -> None:
    """Nothing stops the axis: the drive does not listen. It must still watch us, as it stops once our heartbeat ends."""
    rig = make(CanFault(K.LOCAL_CONTROL, at_s=FAULT_AT_S), settings=CanOpenSettings(guard_s=0.2))
    drive = rig.moving(50.0)
    with pytest.raises(BridgeError):
        drive.close()
    assert rig.bench.slave.dictionary.number(0x1016, 1) == 127 << 16 | 200


# -- the whole way out: how long it takes ---------------------------------------------------------------------------------------

WATCHED = (0x1800, 1), (0x1A00, 0), (0x1017, 0), (0x1016, 1), (0x6007, 0), (0x6060, 0), (0x6081, 0), (0x1600, 0)
WAY_OUT_S, AT_LEAST_S = 6.0, 1.1
LOOKS_S = 1.5
"""Braking, and the SYNCs of each step that are not answered, s."""


def _leave(*drives: CanOpenDrive) -> BridgeError:
    """What a program does after an error: stop all axes, once more where it was not confirmed, disable and close each."""
    error = BridgeError("the measurement failed")
    share_time(drives)
    for _ in range(2):
        for drive in drives:
            drive.send_stop()
        undo_all([("", drive.quick_stop) for drive in drives], during=error)
    undo_all([("", drive.disable) for drive in drives], during=error)
    undo_all([("", drive.close) for drive in drives], during=error)
    return error


@pytest.mark.parametrize(
    "faults",
    [
        (CanFault(SDO_DEAD, at_s=FAULT_AT_S),),
        (CanFault(K.SDO_LOST, at_s=FAULT_AT_S),),
        (CanFault(K.SDO_LATE, at_s=FAULT_AT_S, size=2.0),),
        (CanFault(K.SDO_WRONG_INDEX, at_s=FAULT_AT_S),),
        (CanFault(K.SDO_GARBAGE, at_s=FAULT_AT_S),),
        (CanFault(SDO_DEAD, at_s=FAULT_AT_S), CanFault(K.TPDO_LOST, at_s=FAULT_AT_S)),
        (CanFault(K.NODE_DEAD, at_s=FAULT_AT_S),),
        (CanFault(K.NMT_STOPPED, at_s=FAULT_AT_S),),
        (CanFault(K.LOCAL_CONTROL, at_s=FAULT_AT_S),),
        (CanFault(K.STATUS_IMPOSSIBLE, at_s=FAULT_AT_S),),
        (CanFault(K.TPDO_LOST, at_s=FAULT_AT_S),),
    ],
    ids=lambda faults: "+".join(fault.kind.name.lower() for fault in faults),
)
def test_the_whole_way_out_is_bounded_whatever_is_dead(make: MakeRig, faults: tuple[CanFault, ...]) -> None:
    rig = make(*faults, settings=CanOpenSettings(guard_s=0.5))
    drive = rig.moving(50.0)
    began_ns = rig.clock.now_ns()
    _leave(drive)
    assert rig.clock.now_ns() - began_ns <= (WAY_OUT_S + LOOKS_S) * 1e9
    told = [text for time_ns, text in rig.frames if time_ns == began_ns]
    assert told[0] == STOP_RPDO
    if all(fault.kind not in (K.LOCAL_CONTROL, K.NODE_DEAD) for fault in faults):
        rig.clock.sleep_s(1.0)  # NMT stopped: no frame but our heartbeat, which ends, reaches the drive
        assert rig.servo.velocity_actual_counts_s == 0


def test_a_drive_that_stays_enabled_is_waited_for_once(make: MakeRig) -> None:
    rig = make(CanFault(K.LOCAL_CONTROL, at_s=FAULT_AT_S))
    drive = rig.moving(50.0)
    rig.clock.sleep_s(6.0)  # the move is over
    with pytest.raises(MotionTimeoutError, match="stays enabled"):
        drive.quick_stop()
    began_ns = rig.clock.now_ns()
    for _ in range(3):
        with pytest.raises(MotionTimeoutError, match=r"not disabled within"):
            drive.disable()
    assert rig.clock.now_ns() - began_ns <= (WAY_OUT_S + LOOKS_S) * 1e9


class Pair:
    """Two drives on one wire, both moving, both cut off at `FAULT_AT_S`."""

    def __init__(self, *faults: CanFault) -> None:
        nodes = (NODE, NODE + 1)
        self.bench = CanBench(nodes, faults=dict.fromkeys(nodes, faults))
        self.clock = self.bench.clock
        self.link = CanLink(self.bench.port(), self.clock)
        self.drives = [
            CanOpenDrive(name, AxisScaling(100_000, 10.0), LIMITS, self.clock, link=self.link, node_id=node)
            for name, node in zip("XY", nodes, strict=True)
        ]
        for drive in self.drives:
            drive.open()
            drive.enable()


@pytest.mark.parametrize("kind", [SDO_DEAD, K.NODE_DEAD])
def test_the_ways_out_of_two_axes_do_not_add_up(kind: CanFaultKind) -> None:
    pair = Pair(CanFault(kind, at_s=FAULT_AT_S))
    with pair.link:
        for drive in pair.drives:
            drive.start_move(280.0, 50.0)
        pair.clock.sleep_until_ns(round(FAULT_AT_S * 1e9) + 1_000_000)
        began_ns = pair.clock.now_ns()
        _leave(*pair.drives)
        assert pair.clock.now_ns() - began_ns <= (WAY_OUT_S + AT_LEAST_S + 2 * LOOKS_S) * 1e9


@pytest.mark.parametrize("kind", [SDO_DEAD, K.NODE_DEAD])
def test_the_ways_out_of_two_axes_that_were_not_stopped_do_not_add_up(kind: CanFaultKind) -> None:
    """Found dead while they are disabled at the end of a good run."""
    pair = Pair(CanFault(kind, at_s=FAULT_AT_S))
    with pair.link:
        pair.clock.sleep_until_ns(round(FAULT_AT_S * 1e9) + 1_000_000)
        began_ns = pair.clock.now_ns()
        supervisor = Supervisor([WatchedAxis(drive) for drive in pair.drives])
        with suppress(BridgeError):
            supervisor.leave(None)
        for drive in pair.drives:
            with suppress(BridgeError):
                drive.close()
        assert pair.clock.now_ns() - began_ns <= (WAY_OUT_S + AT_LEAST_S + LOOKS_S) * 1e9


@pytest.mark.parametrize("kind", [SDO_DEAD, K.NODE_DEAD])
def test_leaving_a_stream_of_two_axes_that_are_dead_is_part_of_the_way_out(kind: CanFaultKind) -> None:
    pair = Pair(CanFault(kind, at_s=FAULT_AT_S))
    with pair.link:
        try:
            with CyclicStream(pair.drives, SetPointSettings(0.01)) as stream:
                while pair.clock.now_ns() < (FAULT_AT_S + 0.1) * 1e9:
                    stream.cycle([0.0, 0.0])
                raise BridgeError("the measurement failed")
        except BridgeError:
            _leave(*pair.drives)
        assert pair.clock.now_ns() <= (FAULT_AT_S + 0.1 + WAY_OUT_S + AT_LEAST_S + 2 * LOOKS_S) * 1e9


def test_a_slow_drive_does_not_leave_its_neighbour_waiting_for_sync_at_the_end_of_a_stream() -> None:
    """Both watch for SYNC, which ends with the stream; an SDO answer takes 40 ms, ten periods."""
    pair = Pair(CanFault(K.SDO_LATE, at_s=FAULT_AT_S, size=0.04))
    with pair.link:
        with CyclicStream(pair.drives, SetPointSettings(0.004)) as stream:
            while pair.clock.now_ns() < (FAULT_AT_S + 0.1) * 1e9:
                stream.cycle([0.0, 0.0])
        pair.clock.sleep_s(0.5)
        assert [drive.sample().state for drive in pair.drives] == [DriveState.ENABLED] * 2
        for drive in pair.drives:
            drive.disable()
            drive.close()


@pytest.mark.parametrize(
    "fault",
    [
        CanFault(K.SDO_LATE, at_s=FAULT_AT_S, size=0.3),  # slow, and nothing is left out
        CanFault(K.SDO_LOST, at_s=FAULT_AT_S, count=1),
        CanFault(K.SDO_LOST, at_s=FAULT_AT_S, duration_s=2.0),
    ],
    ids=["slow", "one answer lost", "silent for 2 s"],
)
def test_a_drive_that_answers_is_put_back_wholly(make: MakeRig, fault: CanFault) -> None:
    rig = make(fault)
    before = [rig.bench.slave.dictionary.number(*key) for key in WATCHED]
    drive = rig.moving(50.0)
    began_ns = rig.clock.now_ns()
    drive.quick_stop()
    drive.disable()
    drive.close()
    rig.assert_without_power_at_rest()
    assert [rig.bench.slave.dictionary.number(*key) for key in WATCHED] == before
    if not fault.count and not fault.duration_s:
        assert rig.clock.now_ns() - began_ns > WAY_OUT_S * 1e9


def test_a_drive_that_answers_again_is_waited_for_again(make: MakeRig) -> None:
    """Long after a way out that failed: the answers are back, it is asked for something, and closing puts everything back."""
    rig = make(CanFault(SDO_DEAD, at_s=FAULT_AT_S, duration_s=20.0))
    before = [rig.bench.slave.dictionary.number(*key) for key in WATCHED]
    drive = rig.moving(50.0)
    error = BridgeError("the measurement failed")
    undo_all([("", drive.quick_stop), ("", drive.disable)], during=error)
    with pytest.raises(NoAnswerError, match="was not answered in time"):
        drive.sdo.read(objects.STATUSWORD)  # no way out: it is asked, and waited for
    while drive.way_out.left_s() > 0:
        drive.disable()
    assert rig.clock.now_ns() < (FAULT_AT_S + 10.0) * 1e9
    with drive.way_out.step(last=True), pytest.raises(NoAnswerError, match="was not tried"):
        drive.sdo.read(objects.STATUSWORD)
    rig.clock.sleep_s(20.0)
    drive.sdo.read(objects.STATUSWORD)
    drive.close()
    rig.assert_without_power_at_rest()
    assert [rig.bench.slave.dictionary.number(*key) for key in WATCHED] == before
