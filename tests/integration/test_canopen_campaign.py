"""The fault campaign on CAN: every kind of fault, at seeded moments of a whole commissioning job, on a bus with real frame lengths.

Each run must end, within bounded simulated time, in a safe state (power off or axis at rest, never outside its travel) and with an
error that names what happened - or without one, where the fault is of the kind that is lived with. Truth is read from the servo,
never from the driver. One of each kind runs by default, more with `--seeds`; `-s` prints the table of results.
"""

from __future__ import annotations

import random
import re
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import pytest
from support.can_bench import CanBench
from support.can_wire import WirePort

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.canopen.stream import CyclicStream
from drivers.cia402 import objects
from drivers.cia402.power import PowerTimes
from drivers.drive import DriveSample, DriveState
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    DriveFaultError,
    FollowingErrorError,
    LinkLostError,
    MotionTimeoutError,
    NoAnswerError,
    ProtocolError,
    StateError,
    UndoError,
)
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from sim_backends.bare_shaft import SMALL_SERVO
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind, Fault, FaultKind

K = CanFaultKind
NODE = 5
TRAVEL_MM = (-5.0, 120.0)
LIMITS = DriveLimits(*TRAVEL_MM, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
SETTINGS = CanOpenSettings(
    sdo_timeout_s=0.1,
    heartbeat_s=0.05,
    guard_s=0.2,
    power=PowerTimes(enable_s=1.0, disable_s=1.0, stop_s=2.0, fault_reset_s=0.5),
    homing=HomingSettings(method=37, home_position_mm=0.0),
)
GAIN = objects.Entry(0x2210, 1, objects.DataType.U32, "proportional gain")
LONGEST_S = 60.0  # of simulated time, for a whole run with whatever went wrong


BusOff = tuple[float, float]  # from, for how long, s
Draw = Callable[[random.Random], CanFault | Fault | BusOff]


@dataclass(frozen=True)
class Kind:
    """One row of the campaign: how a fault is drawn, which errors are right, and whether getting through is."""

    name: str
    draw: Draw
    errors: tuple[type[BridgeError], ...]
    text: str = ""
    survivable: bool = False


WHOLE_JOB = (0.0, 4.0)


def _can(
    kind: CanFaultKind,
    low: float = 0.0,
    high: float = 0.0,
    *,
    at: tuple[float, float] = WHOLE_JOB,
    duration: tuple[float, float] = (0.0, 0.0),
    count: int = 0,
) -> Draw:
    def draw(rng: random.Random) -> CanFault:
        size = rng.uniform(low, high) if high > low else low
        return CanFault(kind, rng.uniform(*at), rng.uniform(*duration), size, count, rng.randrange(3))

    return draw


def _servo(kind: FaultKind, duration: tuple[float, float], size: float = 0.0) -> Draw:
    def draw(rng: random.Random) -> Fault:
        return Fault(kind, rng.uniform(0.1, 4.0), rng.uniform(*duration), size)

    return draw


def _bus_off(duration: tuple[float, float]) -> Draw:
    def draw(rng: random.Random) -> BusOff:
        return rng.uniform(0.0, 4.0), rng.uniform(*duration)

    return draw


WIRE = (NoAnswerError, LinkLostError)
KINDS = (
    Kind("SDO answer late, once", _can(K.SDO_LATE, 0.11, 0.4, count=1), WIRE, survivable=True),
    # of a write of a PDO: the late answer of the one before it makes it look as if reads alone were answered, a refusal
    Kind("SDO answers late for good", _can(K.SDO_LATE, 0.12, 0.5), (*WIRE, AbortError), "SDO", survivable=True),
    Kind("SDO answer lost, once", _can(K.SDO_LOST, count=1), WIRE, survivable=True),
    Kind("SDO answers lost for good", _can(K.SDO_LOST), WIRE, "SDO"),
    Kind("SDO request lost, once", _can(K.SDO_REQUEST_LOST, count=1), WIRE, survivable=True),
    Kind("SDO refused, once", _can(K.SDO_ABORTED, 0x08000022, count=1), (AbortError,), "present device state", True),
    Kind("SDO writes refused", _can(K.SDO_WRITE_ABORTED, 0x08000022), (AbortError,), "present device state"),
    Kind("SDO answers name another index", _can(K.SDO_WRONG_INDEX), WIRE, "SDO"),
    Kind("SDO answers impossible", _can(K.SDO_GARBAGE), (ProtocolError, NoAnswerError), "SDO"),
    Kind("SDO answers cut short", _can(K.SDO_SHORT), WIRE, "SDO"),
    Kind("TPDO lost, once", _can(K.TPDO_LOST, count=1), WIRE, survivable=True),
    Kind("TPDOs lost for good", _can(K.TPDO_LOST), WIRE, "SYNC|feedback"),
    Kind("TPDOs late", _can(K.TPDO_LATE, 0.11, 0.3), (*WIRE, FollowingErrorError), survivable=True),
    # cut short from the first one on they prove that the mapping was not taken, and no stream is begun
    Kind(
        "TPDOs cut short",
        _can(K.TPDO_SHORT),
        (ProtocolError, NoAnswerError, CapabilityError),
        "bytes|feedback|SYNC|not those",
    ),
    Kind("RPDOs lost", _can(K.RPDO_LOST), (FollowingErrorError,), "set-point", survivable=True),
    Kind("SYNC not received, once", _can(K.SYNC_LOST, count=1), WIRE, survivable=True),
    Kind("SYNC not received", _can(K.SYNC_LOST), (*WIRE, DriveFaultError), "SYNC|feedback|fault"),
    Kind("heartbeat stops", _can(K.HEARTBEAT_STOPS), (LinkLostError,), "heartbeat"),
    # emergencies go before PDOs: a long burst keeps a stream's feedback off the bus
    Kind("EMCY burst", _can(K.EMCY_BURST, 20, 200), (NoAnswerError,), "feedback", survivable=True),
    Kind("every frame twice", _can(K.DUPLICATES), (), survivable=True),
    Kind("node cut off for good", _can(K.NODE_DEAD), WIRE),
    Kind(
        "node cut off for a moment",
        _can(K.NODE_DEAD, duration=(0.01, 0.5)),
        (*WIRE, StateError, DriveFaultError),
        "",
        True,
    ),
    Kind("node restarts", _can(K.REBOOT), (*WIRE, StateError, AbortError, MotionTimeoutError)),
    Kind("power cut", _can(K.POWER_CUT, duration=(0.3, 1.0)), (*WIRE, StateError)),
    Kind("another master stops the node", _can(K.NMT_STOPPED), (*WIRE, StateError)),
    Kind(
        "another master takes it out of operation",
        _can(K.NMT_PRE_OPERATIONAL),
        (*WIRE, DriveFaultError),
        survivable=True,
    ),
    Kind(
        "another master writes the controlword",
        _can(K.FOREIGN_CONTROLWORD, 0x0000),
        (StateError, MotionTimeoutError),
        "",
        True,
    ),
    Kind(
        "safe torque off",
        _can(K.SAFE_TORQUE_OFF),
        (StateError, MotionTimeoutError),
        "safe torque off|switch on disabled|unk",
    ),
    Kind("brake does not open", _can(K.BRAKE_STUCK, at=(0.0, 0.05)), (MotionTimeoutError,), "brake", survivable=True),
    Kind("set-point never acknowledged", _can(K.SETPOINT_NOT_TAKEN), (ProtocolError,), "acknowledged", survivable=True),
    Kind("acknowledge bit stuck", _can(K.ACKNOWLEDGE_STUCK), (ProtocolError,), "bit 12", survivable=True),
    Kind("target reached never shown", _can(K.NEVER_ARRIVES), (MotionTimeoutError,), "not within"),
    Kind("mode does not change", _can(K.MODE_STUCK), (ProtocolError,), "6061h", survivable=True),
    Kind(
        "local control",
        _can(K.LOCAL_CONTROL),
        (MotionTimeoutError, ProtocolError, DriveFaultError, StateError),
        "",
        True,
    ),
    Kind("statusword impossible", _can(K.STATUS_IMPOSSIBLE), (StateError, MotionTimeoutError), "unknown"),
    Kind("drive fault", _can(K.DRIVE_FAULT, 0x3210), (DriveFaultError,), "fault"),
    Kind(
        "shaft jammed",
        _servo(FaultKind.JAM, (5.0, 6.0)),
        (DriveFaultError, FollowingErrorError, MotionTimeoutError),
        "",
        True,
    ),
    Kind("torque noise", _servo(FaultKind.TORQUE_NOISE, (1.0, 2.0), 100.0), (), survivable=True),
    Kind("our controller bus-off for good", _bus_off((1e6, 1e6)), (LinkLostError,), "bus-off"),
    Kind("our controller bus-off for a moment", _bus_off((0.05, 0.3)), (LinkLostError, StateError), "", True),
)


@dataclass
class Outcome:
    error: BridgeError | None
    closing_error: BridgeError | None
    simulated_s: float
    lowest_mm: float
    highest_mm: float
    powered: bool
    at_rest: bool


class Watched:
    """The job's own watching: what a session does at every look."""

    def __init__(self, drive: CanOpenDrive) -> None:
        self._drive = drive

    def until(self, condition: Callable[[DriveSample], bool], timeout_s: float, what: str) -> None:
        def look(sample: DriveSample) -> bool:
            if sample.state in (DriveState.FAULT, DriveState.FAULT_REACTION):
                raise DriveFaultError(f"drive {self._drive.name} went into {sample.state.value}", sample.fault_code)
            if sample.state is not DriveState.ENABLED:
                raise StateError(f"drive {self._drive.name} is {sample.state.value} while it should {what}")
            return condition(sample)

        self._drive.wait_for(look, timeout_s, what)


def _job(drive: CanOpenDrive) -> None:
    """About four seconds of a commissioning: enable, home, move, set a parameter, stream."""
    watched = Watched(drive)
    drive.enable()
    drive.start_homing()
    watched.until(lambda sample: sample.homed is True, 2.0, "home")
    for target_mm in (60.0, 5.0, 90.0, 0.0):
        drive.start_move(target_mm, 150.0)
        watched.until(lambda sample: sample.target_reached, 3.0, "arrive")
        before = drive.sdo.read(GAIN)
        drive.sdo.write(GAIN, before + 1)
        if drive.sdo.read(GAIN) != before + 1:
            raise ProtocolError("gain does not read back")
    with CyclicStream([drive], SetPointSettings(0.002, following_error_mm=2.0)) as stream:
        for cycle in range(400):
            stream.cycle([min(cycle, 300) * 0.2])
    for target_mm in (30.0, 0.0):
        drive.start_move(target_mm, 150.0)
        watched.until(lambda sample: sample.target_reached, 3.0, "arrive")
    drive.disable()


def _run(kind: Kind, seed: int) -> Outcome:
    rng = random.Random(f"{kind.name} {seed}")
    fault = kind.draw(rng)
    bench = CanBench(
        (NODE,),
        1_000_000,
        {NODE: [fault]} if isinstance(fault, CanFault) else {},
        servo_faults=[fault] if isinstance(fault, Fault) else [],
        servo_parameters=replace(SMALL_SERVO, coast_rev_s2=300.0),  # a spring brake closes when the power goes
    )
    port: WirePort = bench.port()
    if isinstance(fault, tuple):
        port.schedule_bus_off(*fault)
    scaling = AxisScaling(100_000, 10.0)
    extremes = [0.0, 0.0]

    def observe(_now_ns: int, _dt_s: float) -> None:
        place_mm = bench.servo.motor_rev * 10.0
        extremes[0], extremes[1] = min(extremes[0], place_mm), max(extremes[1], place_mm)

    bench.clock.attach(observe)
    error: BridgeError | None = None
    closing: BridgeError | None = None
    with CanLink(port, bench.clock) as link:
        drive = CanOpenDrive("X", scaling, LIMITS, bench.clock, link=link, node_id=NODE, settings=SETTINGS)
        try:
            drive.open()
            _job(drive)
        except BridgeError as caught:
            error = caught
            with suppress(BridgeError):
                drive.quick_stop()
        try:
            drive.close()
        except BridgeError as caught:
            closing = caught
        ended_s = bench.clock.now_ns() / 1e9
    bench.clock.sleep_s(3.0)
    servo = bench.servo
    return Outcome(
        error, closing, ended_s, *extremes, powered=servo.powered, at_rest=servo.velocity_actual_counts_s == 0
    )


def _judge(kind: Kind, outcome: Outcome) -> str:
    """The name of the result; fails the test when it is not one of the right ones."""
    where = f"{kind.name}: {outcome}"
    assert outcome.at_rest, where
    assert TRAVEL_MM[0] - 0.01 <= outcome.lowest_mm, where
    assert outcome.highest_mm <= TRAVEL_MM[1] + 0.01, where
    assert outcome.simulated_s < LONGEST_S, where
    if outcome.error is None:
        assert kind.survivable, where
        assert not outcome.powered, where
        return "got through"
    errors = outcome.error.errors if isinstance(outcome.error, UndoError) else (outcome.error,)
    assert all(isinstance(error, kind.errors) for error in errors), where
    assert re.search(kind.text, str(outcome.error)), where
    return type(outcome.error).__name__


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name.replace(" ", "-"))
def test_each_kind_at_moments_of_a_job(kind: Kind, pytestconfig: pytest.Config) -> None:
    seeds = pytestconfig.getoption("--seeds")
    results: Counter[str] = Counter()
    off = 0
    longest_s = 0.0
    for seed in range(seeds):
        outcome = _run(kind, seed)
        results[_judge(kind, outcome)] += 1
        off += not outcome.powered
        longest_s = max(longest_s, outcome.simulated_s)
    told = ", ".join(f"{name} {count}" for name, count in results.most_common())
    print(f"| {kind.name} | {seeds} | {told} | {off} | {longest_s:.1f} |")


def test_without_a_fault_the_job_gets_through() -> None:
    harmless = Kind("none", lambda _rng: CanFault(K.NODE_DEAD, at_s=1e9), (), survivable=True)
    outcome = _run(harmless, 0)
    assert outcome.error is None
    assert outcome.closing_error is None
    assert not outcome.powered
    assert 85.0 < outcome.highest_mm < 91.0
    assert outcome.simulated_s > 4.0
