"""The whole way out of a Modbus drive after a fault of its line or of the drive: the stop first, the end within its time.

In simulated time: a request that nobody answers takes its time-out of it, 1 s as on TCP.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from random import Random

import pytest
from support.modbus_direct import DirectWire

from drivers.clock import Clock
from drivers.drive import DriveState
from drivers.errors import AbortError, BridgeError, LinkLostError, NoAnswerError, ProtocolError
from drivers.limits import DriveLimits
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.wire import Request
from drivers.scaling import AxisScaling
from drivers.standstill import FrozenValues
from drivers.way_out import WayOut
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_registers import Face
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo

COUNTS = 100_000
TIMEOUT_S = 1.0  # the bridge's own for Modbus TCP
WITHIN_S = 10.0
LIMITS = DriveLimits(-3.0, 300.0, max_velocity_mm_s=100.0, max_acceleration_mm_s2=100.0)
BRAKING_S = 1.0
SLOW_LIMITS = replace(LIMITS, max_acceleration_mm_s2=25.0)

Answer = Callable[["FaultyWire", Request], tuple[int, ...]]


@dataclass
class FaultyWire(DirectWire):
    """answer(wire, request): what becomes of a request, None while nothing is wrong; posted stops arrive unless `deaf`."""

    face: Face
    clock: SimClock
    answer: Answer | None = None
    deaf: bool = False
    connected: bool = True
    within_s: float = TIMEOUT_S
    order: list[str] = field(default_factory=list)
    seen: list[tuple[int, int]] = field(default_factory=list)
    frozen: dict[tuple[object, ...], tuple[int, ...]] = field(default_factory=dict)

    def connect(self, within_s: float = math.inf) -> None:
        self.clock.sleep_s(min(TIMEOUT_S, within_s))
        raise LinkLostError("cannot be opened: timed out")

    def post(self, unit: int, requests: Sequence[Request]) -> None:
        self.order.append("posted")
        if not self.deaf:
            for request in requests:
                DirectWire.exchange(self, unit, request)

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        self.order.append("asked")
        self.within_s = min(TIMEOUT_S, within_s)
        if self.answer is not None:
            return self.answer(self, request)
        self.clock.sleep_s(0.002)
        return self.honest(request)

    def honest(self, request: Request) -> tuple[int, ...]:
        return DirectWire.exchange(self, 1, request)

    def silence(self) -> NoAnswerError:
        self.clock.sleep_s(self.within_s)
        return NoAnswerError("no answer")


# -- what goes wrong -----------------------------------------------------------------------------------------------------
def silent(wire: FaultyWire, _request: Request) -> tuple[int, ...]:
    raise wire.silence()


def replies_lost(wire: FaultyWire, request: Request) -> tuple[int, ...]:
    wire.honest(request)
    raise wire.silence()


def dead_server(wire: FaultyWire, _request: Request) -> tuple[int, ...]:
    wire.connected = False
    raise LinkLostError("connection lost")


def slow(wire: FaultyWire, request: Request) -> tuple[int, ...]:
    if wire.within_s < 0.9:
        raise wire.silence()
    wire.clock.sleep_s(0.9)
    return wire.honest(request)


def busy(wire: FaultyWire, _request: Request) -> tuple[int, ...]:
    wire.clock.sleep_s(0.002)
    raise AbortError("busy", 6)


def writes_refused(wire: FaultyWire, request: Request) -> tuple[int, ...]:
    wire.clock.sleep_s(0.002)
    if request.function.is_write:
        raise AbortError("refused", 4)
    return wire.honest(request)


def writes_unexecuted(wire: FaultyWire, request: Request) -> tuple[int, ...]:
    wire.clock.sleep_s(0.002)
    return () if request.function.is_write else wire.honest(request)


def frozen(wire: FaultyWire, request: Request) -> tuple[int, ...]:
    wire.clock.sleep_s(0.002)
    values = wire.honest(request)
    return (
        values
        if request.function.is_write
        else wire.frozen.setdefault((request.function, request.address, request.count), values)
    )


def busy_until(rig: Rig, end_s: float, code: int = 6) -> None:
    """Every request is refused as busy until this moment, a posted stop too, as while a drive keeps values in its EEPROM. code: 10 and
    11 are a gateway's, which is overloaded or reaches no drive (Modbus application protocol V1.1b3, section 7)."""

    def answer(wire: FaultyWire, request: Request) -> tuple[int, ...]:
        if rig.clock.now_ns() < end_s * 1e9:
            wire.clock.sleep_s(0.002)
            raise AbortError("busy", code)
        rig.wire.answer, rig.wire.deaf = None, False
        return wire.honest(request)

    rig.wire.answer, rig.wire.deaf = answer, True


DEAF = {silent, dead_server, busy, writes_refused, writes_unexecuted}
"""Where no stop gets to the drive."""
KINDS = [silent, replies_lost, dead_server, slow, busy, writes_refused, writes_unexecuted, frozen]


# -- the drive -------------------------------------------------------------------------------------------------------------
@dataclass
class Rig:
    drive: ModbusDrive
    wire: FaultyWire
    servo: SimulatedServo
    clock: SimClock

    def strike(self, kind: Answer) -> None:
        self.wire.answer, self.wire.deaf = kind, kind in DEAF
        self.wire.order.clear()


def faces(name: str, servo: SimulatedServo) -> Face:
    if name == "vendor_style":
        return VendorRegisters(servo, counts_per_rev=COUNTS, settings={"origin_method": 35})
    return Cia402Registers(servo, parameters={(0x6098, 0): 37, (0x6085, 0): 20_000_000, (0x608F, 1): COUNTS})


@contextmanager
def moving(name: str, limits: DriveLimits = LIMITS, clock: SimClock | None = None) -> Iterator[Rig]:
    """A drive, open, enabled and on its way at full speed."""
    clock = clock or SimClock()
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
    face = faces(name, servo)
    clock.attach(lambda now_ns, _dt_s: face.tick(now_ns), bearable=face.bearable)
    wire = FaultyWire(face, clock)
    link = ModbusLink(TcpEndpoint("127.0.0.1", 502, TIMEOUT_S), clock, make_wire=lambda _endpoint: wire)
    drive = ModbusDrive(
        "X", AxisScaling(COUNTS, 10.0), limits, clock, link=link, unit=1, drive_map=load_drive_map(name)
    )
    drive.open()
    drive.enable()
    drive.start_move(290.0, limits.max_velocity_mm_s)
    clock.sleep_s(1.1)
    yield Rig(drive, wire, servo, clock)


def way_out(rig: Rig) -> list[str]:
    """What a procedure does after an error: stop, stop again on leaving, power off, let go."""
    said = []
    for step in (rig.drive.quick_stop, rig.drive.quick_stop, rig.drive.disable, rig.drive.close):
        try:
            step()
        except BridgeError as error:
            said.append(str(error))
    return said


@pytest.mark.parametrize(
    ("name", "noticed"),
    [("cia402_over_modbus", True), ("vendor_style", False)],
    ids=["stopped after an error", "found out while disabling"],
)
@pytest.mark.parametrize("kind", KINDS, ids=[kind.__name__ for kind in KINDS])
def test_the_way_out_ends_in_time_with_the_stop_first(kind: Answer, noticed: bool, name: str) -> None:
    with moving(name) as r:
        r.strike(kind)
        began_s = 1e-9 * r.clock.now_ns()
        if noticed:
            with suppress(BridgeError):
                r.drive.sample()
            r.wire.order.clear()
            said = way_out(r)
            assert r.wire.order[0] == "posted"
        else:
            said = []
            for step in (r.drive.disable, r.drive.close):
                try:
                    step()
                except BridgeError as error:
                    said.append(str(error))
            assert "posted" in r.wire.order
        assert 1e-9 * r.clock.now_ns() - began_s < WITHIN_S
        assert said or kind is slow, "nobody was told"
        r.clock.sleep_s(3.0)
        if kind not in DEAF:
            assert r.servo.velocity_actual_counts_s == 0.0


@pytest.mark.parametrize("name", ["cia402_over_modbus", "vendor_style"])
@pytest.mark.parametrize(("code", "busy_s"), [(6, 0.3), (6, 2.0), (6, 5.0), (10, 1.5), (11, 0.3), (11, 4.0)])
@pytest.mark.parametrize("stopped", [True, False], ids=["stopped after an error", "disabled at once"])
def test_a_busy_drive_is_stopped_and_disabled_once_it_takes_requests_again(
    stopped: bool, code: int, busy_s: float, name: str
) -> None:
    with moving(name) as r:
        began_s = 1e-9 * r.clock.now_ns()
        busy_until(r, began_s + busy_s, code)
        if stopped:
            assert not way_out(r)
        else:
            r.drive.disable()
            r.drive.close()
        assert 1e-9 * r.clock.now_ns() - began_s < busy_s + 2.0  # and the time of braking
        assert not r.servo.powered
        assert r.servo.velocity_actual_counts_s == 0.0


@pytest.mark.parametrize("name", ["cia402_over_modbus", "vendor_style"])
@pytest.mark.parametrize(
    "order",
    [
        lambda drive: drive.start_move(100.0, 50.0),
        lambda drive: drive.sample(),
        lambda drive: (drive.disable(), drive.enable()),
    ],
    ids=["move", "sample", "enable"],
)
def test_an_order_to_a_busy_drive_is_given_again_for_as_long_as_it_may_take(
    order: Callable[[ModbusDrive], object], name: str
) -> None:
    with moving(name) as r:
        busy_until(r, 1e-9 * r.clock.now_ns() + 2.5)
        order(r.drive)
        assert r.drive.sample().state is DriveState.ENABLED
        busy_until(r, 1e-9 * r.clock.now_ns() + 3.5)
        with pytest.raises(AbortError, match="busy, asked again for 3 s"):
            r.drive.sample()


@pytest.mark.parametrize("name", ["cia402_over_modbus", "vendor_style"])
@pytest.mark.parametrize("kind", [replies_lost, slow, frozen], ids=["replies lost", "slow", "frozen"])
def test_a_drive_that_hears_is_without_power_in_the_end(kind: Answer, name: str) -> None:
    with moving(name) as r:
        r.drive.quick_stop()
        r.strike(kind)
        with suppress(BridgeError):
            r.drive.disable()
        if kind is not replies_lost:  # nothing tells that such an axis has come to rest
            assert not r.servo.powered


def test_an_axis_that_brakes_for_long_has_the_time_for_it() -> None:
    """From 100 mm/s by 25 mm/s²: 4 s, twice."""
    with moving("cia402_over_modbus", SLOW_LIMITS) as r:
        r.clock.sleep_s(2.0)
        began_s = 1e-9 * r.clock.now_ns()
        r.drive.disable()
        assert not r.servo.powered
        assert 1e-9 * r.clock.now_ns() - began_s < r.drive.way_out.budget_s == 11.0
        r.drive.close()


def test_a_drive_that_comes_back_is_waited_for_as_ever() -> None:
    with moving("cia402_over_modbus") as r:
        r.strike(silent)
        for step in (*9 * (r.drive.quick_stop,), r.drive.disable):
            with pytest.raises(NoAnswerError):
                step()
        r.wire.answer, r.wire.deaf = None, False
        r.clock.sleep_s(WITHIN_S)
        r.drive.quick_stop()
        r.drive.disable()
        assert r.drive.sample().state is DriveState.SWITCH_ON_DISABLED
        assert r.drive.way_out.left_s() == r.drive.way_out.budget_s
        r.drive.close()


@pytest.mark.parametrize("name", ["cia402_over_modbus", "vendor_style"])
def test_values_that_are_frozen_in_motion_are_found_out(name: str) -> None:
    with moving(name) as r:
        r.drive.sample()
        r.strike(frozen)
        began_ns = r.clock.now_ns()
        with pytest.raises(ProtocolError, match=r"its values are frozen: it shows 100\.000 mm/s"):
            r.drive.wait_for(lambda _sample: False, 10.0, "nothing")
        assert r.clock.now_ns() - began_ns <= 1.1e9
        assert r.wire.order[-1] == "posted"
        way_out(r)
        assert r.clock.now_ns() - began_ns < WITHIN_S * 1e9


def test_an_axis_that_stands_or_dwells_in_a_motion_shows_no_frozen_values() -> None:
    values = FrozenValues()
    assert not any(values.look(round(each * 1e8), 7.0, 0.0) for each in range(100))
    assert not any(values.look(round(each * 1e8), 7.0, 0.3) for each in range(100))  # noise
    assert not any(values.look(round(each * 1e8), 7.0, None) for each in range(100))
    assert not any(values.look(round(each * 1e8), 7.0 + each, 10.0) for each in range(100))
    assert [values.look(round(each * 1e8), 7.0, 10.0) for each in range(11)] == [*10 * [False], True]


@pytest.mark.parametrize("name", ["cia402_over_modbus", "vendor_style"])
def test_a_line_that_loses_one_reply_in_a_hundred_can_be_worked_with(name: str) -> None:
    """Reads are asked again, writes are read back."""
    random, lost = Random(7), 0

    def lossy(wire: FaultyWire, request: Request) -> tuple[int, ...]:
        nonlocal lost
        wire.clock.sleep_s(0.002)
        values = wire.honest(request)
        if random.random() < 0.01:
            lost += 1
            raise wire.silence()
        return values

    with moving(name) as r:
        r.drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrived")
        r.wire.answer = lossy
        for target_mm in (10.0, 20.0, 15.0, 30.0, 25.0, 60.0):
            r.drive.start_move(target_mm, 50.0)
            sample = r.drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrived")
            assert sample.position_load_mm == pytest.approx(target_mm, abs=0.01)
        r.drive.disable()
        assert not r.servo.powered
        assert lost > 3
        r.drive.close()


# -- several axes that leave together ------------------------------------------------------------------------------------------
@dataclass
class Pair:
    """Two drives, each on a line of its own and both on their way, under one supervisor."""

    rigs: list[Rig]
    supervisor: Supervisor

    @property
    def clock(self) -> SimClock:
        return self.rigs[0].clock

    def leave(self) -> float:
        """After an error, then closing each; how long it took, s."""
        began_ns = self.clock.now_ns()
        error = NoAnswerError("the measurement failed")
        self.supervisor.stop_for(error)
        self.supervisor.leave(error)
        for rig in self.rigs:
            with suppress(BridgeError):
                rig.drive.close()
        return 1e-9 * (self.clock.now_ns() - began_ns)


@pytest.fixture
def pair() -> Iterator[Pair]:
    clock = SimClock()
    with moving("cia402_over_modbus", clock=clock) as first, moving("cia402_over_modbus", clock=clock) as second:
        rigs = [first, second]
        yield Pair(rigs, Supervisor([WatchedAxis(rig.drive) for rig in rigs]))


@pytest.mark.parametrize("kind", [silent, replies_lost, dead_server], ids=lambda kind: kind.__name__)
def test_the_ways_out_of_two_dead_axes_do_not_add_up(pair: Pair, kind: Answer) -> None:
    for rig in pair.rigs:
        rig.strike(kind)
    told_ns: list[int] = []
    for rig in pair.rigs:
        post = rig.wire.post
        rig.wire.post = lambda *args, post=post: (told_ns.append(pair.clock.now_ns()), post(*args))[1]  # type: ignore[method-assign]
    began_ns = pair.clock.now_ns()
    assert pair.leave() < WITHIN_S
    assert told_ns[:2] == [began_ns, began_ns]  # both before either was waited for


def test_an_axis_that_answers_has_its_time_beside_a_dead_one(pair: Pair) -> None:
    dead, alive = pair.rigs
    dead.strike(silent)
    assert pair.leave() < WITHIN_S
    assert not alive.servo.powered
    assert alive.servo.velocity_actual_counts_s == 0.0


def test_axes_that_answer_do_not_take_each_others_time() -> None:
    clock = SimClock()
    with (
        moving("cia402_over_modbus", SLOW_LIMITS, clock) as first,
        moving("cia402_over_modbus", SLOW_LIMITS, clock) as second,
    ):
        supervisor = Supervisor([WatchedAxis(rig.drive) for rig in (first, second)])
        supervisor.leave(None)
        assert [rig.servo.powered for rig in (first, second)] == [False, False]
        assert [rig.wire.order.count("posted") for rig in (first, second)] == [0, 0]  # a halt was enough


@pytest.mark.parametrize("kind", [writes_unexecuted, silent], ids=lambda kind: kind.__name__)
def test_time_that_one_axis_lost_before_both_leave_counts(pair: Pair, kind: Answer) -> None:
    for rig in pair.rigs:
        rig.strike(kind)
    began_ns = pair.clock.now_ns()
    for step in (pair.rigs[0].drive.quick_stop, pair.rigs[0].drive.disable):  # what a refused order does by itself
        with suppress(BridgeError):
            step()
    lost_s = 1e-9 * (pair.clock.now_ns() - began_ns)
    assert lost_s > 2.0
    assert lost_s + pair.leave() < WITHIN_S


# -- the budget -------------------------------------------------------------------------------------------------------------
def failing(way: WayOut, clock: Clock, takes_s: float) -> None:
    with suppress(NoAnswerError), way.step(last=True):
        clock.sleep_s(takes_s)
        raise NoAnswerError("no answer")


def test_steps_that_fail_share_one_budget_and_a_later_way_out_has_its_own() -> None:
    clock = SimClock()
    way = WayOut(clock, BRAKING_S)
    failing(way, clock, 4.0)
    assert way.within_s(3.0) == 3.0  # nothing is limited between the steps
    with way.step(last=True):
        assert way.within_s(3.0) == pytest.approx(2.0)
        assert way.within_s(3.0, leave_s=1.5) == pytest.approx(0.5)
        assert way.repeats(2, silent=False) == 2
        assert way.repeats(2, silent=True) == 0
        clock.sleep_s(2.0)
        assert way.within_s(3.0) == 0.0
        assert way.repeats(2, silent=False) == 0
        assert [way.reply_s(silent=silent) for silent in (False, True)] == [0.5, 0.1]
    clock.sleep_s(4.0)
    with way.step(last=True):
        assert way.within_s(9.0) == 6.0


def test_a_stop_that_succeeds_leaves_the_rest_and_power_off_ends_the_way_out() -> None:
    clock = SimClock()
    way = WayOut(clock, BRAKING_S)
    with way.step(last=False):
        clock.sleep_s(1.0)
    clock.sleep_s(4.0)  # nothing has failed: only the time in the steps counts
    with way.step(last=True):
        assert way.left_s() == 5.0
        clock.sleep_s(4.0)
    with way.step(last=True):
        assert way.left_s() == 6.0


def test_real_time_without_an_answer_counts() -> None:
    way = WayOut(SimClock(), BRAKING_S)
    way.unanswered(2.0)  # in no way out
    with way.step(last=True):
        assert way.left_s() == 6.0
        way.unanswered(2.0)
        assert way.left_s() == 4.0
