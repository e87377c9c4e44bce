"""One verb with one misbehaving peer, judged by the plant's true state: end and its time, positions of the axis, rows kept.

Runs in simulated time. A run in which simulated time does not pass (a loop without a wait) is ended by a real timer, and is a hang.
"""

from __future__ import annotations

import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from hostile.can_kinds import CAN_KINDS
from hostile.instrument_kinds import INSTRUMENT_KINDS, InstrumentPeer
from hostile.modbus_kinds import MODBUS_KINDS, ModbusPeer
from hostile.modbus_kinds import stand_in as behind_proxy
from hostile.peer import Kind, Peer
from hostile.places import TRAVEL_MM, VERBS, WITH_INSTRUMENT, NotGoodError, Place
from hostile.servo_kinds import SERVO_KINDS

import hil.machine.bench_modbus
import hil.probe.wiring
from drivers.clock import Waiting
from drivers.errors import DriveFaultError
from drivers.modbus.wire import PymodbusWire
from hil.desk.stop import StoppedByOperator
from hil.machine.supervisor import Supervisor
from hil.records.journal import RowJournal
from sim_backends.bench import Bench
from sim_backends.probe_bench import ProbeBench

WITHIN_S = 10.0
"""Longest simulated time from the fault to the end, s; from the first stop on for a kind that a verb can work with."""
GIVEN_UP_S = 60.0
"""Simulated time after the fault, or from the begin of a run without a fault, after which a run is a hang, s."""
WORKED_WITH = 4.0
"""The same for a kind that a verb can work with, times as long: it may make every request slower."""
WALL_S = 60.0
"""Real time after which a run in which simulated time does not pass is a hang, s."""
WALLS = 5
"""Number of such times that a run in which it does pass may take."""
HOMING_MM = 5.0
"""Allowed distance below the travel, mm: homing goes to the limit switch, 3 mm outside, and beyond it as it brakes from 50 mm/s
at 1000 mm/s² (1.25 mm) and by the time that a servo needs to notice the switch."""
REACH_MM = 1.0
"""Allowed distance above the travel, mm, which no order reaches: overshoot of a supervised axis
(`hil.machine.motion_checks.OUTSIDE_MM`)."""
COASTING_MM = 0.5
"""Allowed distance beyond the place to which a drive without power coasts, mm: what it moves between two looks of the judge."""
NOTICED_MM = 1.0
"""A fault after which the axis moves no further than this may go unnoticed, mm."""
STILL_MM_S = 0.01
ANSWERED_S = 0.5
"""Simulated time of the axis for its stop, s: waiting for a Modbus reply takes real time and no simulated time."""
COASTED_S = 3.0
"""Time in which a drive that loses its power by itself coasts, s: 100 mm/s at 80 mm/s²."""
GUARDED_S = 4.0
"""Time in which a drive without a connection notices (its guard time is 1 s) and comes to rest, s."""
READ_S = 0.1
"""Duration of a reading (`places.MEASUREMENT`), s."""
ROW_MM = 0.02
"""Largest difference between a row's position and the true one; the machines' own errors are excluded, heat and noise included."""
DATUM_MM = 0.15
"""The same between the frame of all rows and that of the machine: errors of the machine at the reference position."""
NOT_WAITED_S = 0.03
"""Real time of a Modbus request, s, that is no wait: a busy computer's own."""
BENCH_SILENCE_S = 0.3
"""Time-out of the simulated Modbus drive, in real time, s; the bench's own is longer, for busy hosts."""

WIRES: Mapping[str, tuple[Mapping[str, Kind], tuple[str, ...], tuple[str, ...]]] = {
    "canopen": (CAN_KINDS, tuple(VERBS), ("canopen",)),
    "modbus": (MODBUS_KINDS, tuple(VERBS), ("modbus-tcp",)),
    "drive": (SERVO_KINDS, tuple(VERBS), ("canopen", "virtual", "modbus-tcp")),
    "instrument": (INSTRUMENT_KINDS, WITH_INSTRUMENT, ("virtual", "canopen")),
}
"""Kinds, verbs that can meet them, and faces of the drive, which the seeds use in turn."""


@dataclass(frozen=True)
class Case:
    wire: str
    kind: str
    verb: str
    seed: int

    @property
    def face(self) -> str:
        faces = WIRES[self.wire][2]
        return faces[self.seed % len(faces)]

    def __str__(self) -> str:
        return f"{self.wire}: {self.kind} x {self.verb} x {self.seed}"


@dataclass
class Outcome:
    """complaints: deviations, empty for a correct run; ended: name of the error, or the other end."""

    case: Case
    ended: str = ""
    error: str = ""
    seconds: float = 0.0
    complaints: list[str] = field(default_factory=list)


class HangError(BaseException):
    """Raised in a run that does not end."""


class Truth:
    """True motion of the plant of one bench. Attached after everything that moves it."""

    def __init__(self, bench: Bench | ProbeBench) -> None:
        self.bench, self.clock = bench, bench.clock
        self.low_mm = self.high_mm = 0.0
        self.ends: Callable[[], int | None] = lambda: None  # end of simulated time, ns
        self.limits_mm = TRAVEL_MM if isinstance(bench, Bench) else (-2.0, 200.0)
        self._fresh = True
        self.way_mm = 0.0  # travel of all axes
        self._last: list[float] = []
        self._was_powered = False
        # lowest and highest place to which an axis that lost its power in motion may coast
        self._coasts_to_mm = (0.0, 0.0)
        self._lately: deque[tuple[int, float]] = deque()  # of the table, over `READ_S`
        self.clock.attach(self._look, bearable=lambda _now_ns: 60_000_000_000)

    def places(self) -> list[tuple[float, float]]:
        """Position in mm and velocity in mm/s of each axis's shaft, in the frame of the machine."""
        if isinstance(self.bench, Bench):
            servo, lead = self.bench.servo, self.bench.parameters.plant.screw.lead_mm
            return [(servo.motor_rev * lead, servo.velocity_actual_counts_s * lead / servo.parameters.counts_per_rev)]
        scalings = {name: self.bench.axes[name].scaling for name in self.bench.servos}
        return [
            (scaling.load_mm(servo._actual), scaling.load_mm(servo._actual_velocity))
            for (name, scaling), servo in zip(scalings.items(), self.bench.servos.values(), strict=True)
            if name != "spindle"
        ]

    @property
    def powered(self) -> bool:
        servos = [self.bench.servo] if isinstance(self.bench, Bench) else self.bench.servos.values()
        return any(servo.powered for servo in servos)

    def off_mm(self, measured_mm: float) -> float:
        """A row against where the table is, or was when its reading began: what moves the axis after the last reading makes no row
        wrong, and a mean over a motion agrees with neither."""
        assert isinstance(self.bench, Bench)
        stood_mm = self._lately[0][1] if self._lately else self.bench.plant.position_mm
        return min(measured_mm - self.bench.plant.position_mm, measured_mm - stood_mm, key=abs)

    def _let_coast(self) -> None:
        """The power is gone: no command can stop the axis before friction does. An end stop may come first."""
        if not isinstance(self.bench, Bench):
            return
        slowing_mm_s2 = self.bench.servo.parameters.coast_rev_s2 * self.bench.parameters.plant.screw.lead_mm
        for place_mm, velocity_mm_s in self.places():
            rest_mm = place_mm + velocity_mm_s * abs(velocity_mm_s) / (2.0 * slowing_mm_s2)
            low_mm, high_mm = self._coasts_to_mm
            self._coasts_to_mm = min(low_mm, rest_mm - COASTING_MM), max(high_mm, rest_mm + COASTING_MM)

    def outside_mm(self, low_mm: float, high_mm: float, *, coasted: bool) -> float:
        """Distance that the axis was beyond two places, mm, 0 within. coasted: as far as it coasted without power does not count."""
        if coasted:
            low_mm, high_mm = min(low_mm, self._coasts_to_mm[0]), max(high_mm, self._coasts_to_mm[1])
        return max(low_mm - self.low_mm, self.high_mm - high_mm, 0.0)

    def speed_mm_s(self) -> float:
        return max(abs(velocity) for _, velocity in self.places())

    def _look(self, now_ns: int, _dt_s: float) -> None:
        places = [place for place, _ in self.places()]
        if isinstance(self.bench, Bench):
            self._lately.append((now_ns, self.bench.plant.position_mm))
            while len(self._lately) > 1 and now_ns - self._lately[1][0] >= READ_S * 1e9:
                self._lately.popleft()
        self.way_mm += sum(abs(now - before) for now, before in zip(places, self._last or places, strict=True))
        self._last = places
        if self._fresh:
            self.low_mm, self.high_mm, self._fresh = min(places), max(places), False
        self.low_mm, self.high_mm = min(self.low_mm, *places), max(self.high_mm, *places)
        if self._was_powered and not self.powered:
            self._let_coast()
        self._was_powered = self.powered
        end_ns = self.ends()
        if end_ns is not None and now_ns > end_ns:
            raise HangError(f"simulated time is at {now_ns * 1e-9:.1f} s")


class Rows:
    """Every row that a journal stores and does not withdraw, with the true position of the table."""

    def __init__(self) -> None:
        self.off_mm: list[float] = []
        self.truth: Truth | None = None

    def catch(self) -> Any:
        append, withdraw, rows = RowJournal.append, RowJournal.withdraw, self

        def appended(journal: RowJournal, row: Mapping[str, float]) -> None:
            append(journal, row)
            if rows.truth is not None and isinstance(rows.truth.bench, Bench) and "measured_mm" in row:
                rows.off_mm.append(rows.truth.off_mm(row["measured_mm"]))

        def withdrawn(journal: RowJournal, count: int, why: str) -> None:
            withdraw(journal, count, why)
            del rows.off_mm[max(0, len(rows.off_mm) - count) :]

        return patch.multiple(RowJournal, append=appended, withdraw=withdrawn)

    def complaints(self) -> Iterator[str]:
        if not self.off_mm:
            return
        spread = max(self.off_mm) - min(self.off_mm)
        if spread > ROW_MM:
            yield f"rows wrong by {1e3 * spread:.1f} µm against each other"
        if max(map(abs, self.off_mm)) > DATUM_MM:
            yield f"rows in another frame, {max(self.off_mm, key=abs):.3f} mm off"


class Press(Waiting):
    """The operator's stop, pressed once at a simulated time."""

    def __init__(self, at_ns: int) -> None:
        self._at_ns: int | None = at_ns

    def over(self) -> None:
        """Ignore everything after the end of the run."""
        self._at_ns = None

    def real(self, duration_s: float) -> None:
        time.sleep(duration_s)

    def simulated(self, now_ns: int) -> None:
        if self._at_ns is not None and now_ns >= self._at_ns:
            self._at_ns = None
            raise StoppedByOperator("stopped by the operator")


@contextmanager
def through_a_proxy(armed: Callable[[Peer], None], truths: Sequence[Truth]) -> Iterator[None]:
    """Put the proxy before the Modbus drive. The real time that a request waits passes for the machine too, as where nothing is
    simulated."""

    def passing(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            began_s = time.monotonic()
            try:
                return method(*arguments, **named)
            finally:
                waited_s = time.monotonic() - began_s
                if waited_s > NOT_WAITED_S and truths:
                    truths[0].clock.sleep_s(waited_s)

        return call

    names = ("connect", "exchange", "discard")
    with ExitStack() as stack:
        stack.enter_context(
            patch.multiple(PymodbusWire, **{name: passing(getattr(PymodbusWire, name)) for name in names})
        )
        for module in (hil.machine.bench_modbus, hil.probe.wiring):
            stack.enter_context(patch.object(module, "BENCH_TIMEOUT_S", BENCH_SILENCE_S))
            stack.enter_context(patch.object(module, "tcp_server", behind_proxy(armed)))
        yield


def noted(stops_ns: list[int], truths: Sequence[Truth]) -> Any:
    """Note the time of each stop after an error: a kind that a verb can work with may be worked with for long before it."""
    stop_for = Supervisor.stop_for

    def stopping(supervisor: Supervisor, error: BaseException) -> None:
        stops_ns.append(truths[0].clock.now_ns())
        stop_for(supervisor, error)

    return patch.object(Supervisor, "stop_for", stopping)


@contextmanager
def ended_after(wall_s: float, passed: Callable[[], int] = lambda: 0) -> Iterator[None]:
    """A real timer that raises HangError repeatedly, as one may be suppressed."""

    seen = [passed()]

    def ring(_number: int, _frame: object) -> None:
        if len(seen) < WALLS and passed() > seen[-1]:  # simulated time passes, slowly: a bus that answers after 50 ms
            seen.append(passed())
            signal.setitimer(signal.ITIMER_REAL, wall_s, 1.0)
            return
        raise HangError(f"no end within {wall_s:g} s of real time")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, wall_s, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@cache
def undisturbed_s(face: str, verb: str) -> float:
    """Simulated duration of a verb without a fault, s."""
    truths: list[Truth] = []
    with TemporaryDirectory() as directory:
        place = Place(Path(directory), face, on_bench=lambda bench: truths.append(Truth(bench)))
        with place.wired():
            VERBS[verb](place)
    return truths[0].clock.now_ns() * 1e-9


def moment_s(case: Case) -> float:
    """Time of the fault, s; seeds are spread over the verb's duration."""
    duration_s = undisturbed_s(case.face, case.verb)  # here, before any row is watched
    if WIRES[case.wire][0][case.kind].at_start:
        return 0.001
    random = Random(str(case))
    return duration_s * (case.seed % 10 + random.random()) / 10.0


def run(case: Case) -> Outcome:
    """One case; never raises."""
    kind = WIRES[case.wire][0][case.kind]
    at_ns = round(moment_s(case) * 1e9)
    truths: list[Truth] = []
    peers: list[Peer] = []
    rows = Rows()

    def armed(peer: Peer) -> None:
        if not peers:
            peers.append(peer)
            peer.on_strike = lambda: setattr(peer, "way_mm", truths[0].way_mm)
            peer.arm(at_ns, kind.begin, case.seed)

    def on_bench(bench: Any) -> None:
        truths.append(Truth(bench))
        if len(truths) > 1:
            return
        rows.truth = truths[0]
        truths[0].ends = lambda: _given_up_ns(case, truths, peers)
        if case.wire == "instrument":
            armed(InstrumentPeer(bench))
        elif case.wire == "drive":
            armed(Peer(bench.clock, bench.servo if isinstance(bench, Bench) else bench.servos["x"]))

    waiting = None if kind.stop_after_s is None else Press(at_ns + round(1e9 * kind.stop_after_s))
    with TemporaryDirectory() as directory, ExitStack() as stack:
        place = Place(Path(directory), case.face, waiting, on_bench=on_bench)
        place.on_can = armed if case.wire == "canopen" else None
        stack.enter_context(place.wired())
        stack.enter_context(rows.catch())
        if case.wire == "modbus":
            stack.enter_context(through_a_proxy(armed, truths))
        stops_ns: list[int] = []
        stack.enter_context(noted(stops_ns, truths))
        error = None
        try:
            with ended_after(WALL_S, lambda: truths[0].clock.now_ns() if truths else 0):
                VERBS[case.verb](place)
        except BaseException as raised:  # noqa: BLE001 - it is the result to judge
            error = raised
        if waiting is not None:
            waiting.over()
        peer = next((peer for peer in peers if peer.struck_ns is not None), None)
        ended = Outcome(case, "unmet" if peer is None else "got over" if error is None else type(error).__name__)
        ended.error = "" if error is None else " ".join(str(error).split())[:300]
        for truth in truths:
            truth.ends = lambda: None
        if not truths:
            ended.complaints.append(f"nothing was connected: {error!r}")
            return ended
        if peer is not None and peer.struck_ns is not None:
            since_ns = max([peer.struck_ns, *stops_ns[: kind.passes]])
            ended.seconds = (truths[0].clock.now_ns() - since_ns) * 1e-9
        ended.complaints += _how_it_ended(kind, error, truths, peer, ended)
        ended.complaints += _what_the_plant_shows(kind, truths, peer, ended)
        ended.complaints += rows.complaints()
    return ended


def _given_up_ns(case: Case, truths: list[Truth], peers: list[Peer]) -> int:
    struck_ns = next((peer.struck_ns for peer in peers if peer.struck_ns is not None), None)
    if struck_ns is not None:
        passes = WIRES[case.wire][0][case.kind].passes
        return struck_ns + round(1e9 * (GIVEN_UP_S * (WORKED_WITH if passes else 1.0) + WITHIN_S))
    return round(1e9 * (2.0 * undisturbed_s(case.face, case.verb) + GIVEN_UP_S))


def _causes(error: BaseException) -> Iterator[BaseException]:
    """An error, and each of those that are reported together in it."""
    yield error
    for one in getattr(error, "errors", ()):
        yield from _causes(one)


def _how_it_ended(
    kind: Kind, error: BaseException | None, truths: list[Truth], peer: Peer | None, ended: Outcome
) -> Iterator[str]:
    if isinstance(error, HangError):
        yield f"hangs: {error}"
        return
    if peer is None or peer.struck_ns is None:
        if error is not None and not isinstance(error, StoppedByOperator):
            yield f"fails before the fault: {error!r}"
        return
    if error is None and not kind.passes and truths[0].way_mm - peer.way_mm > NOTICED_MM:
        yield "ends as if nothing had been"
    if error is not None and not any(isinstance(one, (*kind.errors, NotGoodError)) for one in _causes(error)):
        yield f"ends by {type(error).__name__}: {ended.error}"
    if error is not None and ended.seconds > WITHIN_S + (kind.stop_after_s or 0.0):
        yield f"ends {ended.seconds:.1f} s after the fault"


def _what_the_plant_shows(kind: Kind, truths: list[Truth], peer: Peer | None, ended: Outcome) -> Iterator[str]:
    clock, met = truths[0].clock, peer is not None
    if isinstance(peer, ModbusPeer):
        clock.sleep_s(ANSWERED_S)
    if kind.unreachable and met:
        clock.sleep_s(GUARDED_S)
    # a drive in its fault reaction brakes by itself: nobody brings it to rest any sooner
    coasts = kind.coasts or ended.ended == DriveFaultError.__name__
    if coasts and met and not any(truth.powered for truth in truths):
        clock.sleep_s(COASTED_S)
    for truth in truths:
        if (speed := truth.speed_mm_s()) > STILL_MM_S:
            yield f"the axis still moves, at {speed:.2f} mm/s, {'under' if truth.powered else 'without'} power"
    before = [truth.places() for truth in truths]
    clock.sleep_s(5.0)
    for truth, was in zip(truths, before, strict=True):
        moved = max(abs(now[0] - then[0]) for now, then in zip(truth.places(), was, strict=True))
        if moved > STILL_MM_S:
            yield f"the axis moves by {moved:.3f} mm after the end"
        if truth.powered:
            ended.ended += ", held"
        low_mm, high_mm = truth.limits_mm
        low_mm, high_mm = low_mm - HOMING_MM - kind.disobeys_mm, high_mm + REACH_MM + kind.disobeys_mm
        if (beyond_mm := truth.outside_mm(low_mm, high_mm, coasted=kind.coasts)) > 0.0:
            yield f"{beyond_mm:.2f} mm further outside than allowed"


def cases(seeds: int = 10, wires: Sequence[str] | None = None) -> list[Case]:
    """All cases."""
    return [
        Case(wire, kind, verb, seed)
        for wire in (wires or WIRES)
        for kind in WIRES[wire][0]
        for verb in WIRES[wire][1]
        for seed in range(seeds)
    ]


def sample(verbs_each: int, among: Sequence[str]) -> list[Case]:
    """Every kind with so many of these verbs, which the kinds use in turn, as they do the seeds."""
    found = []
    for wire, (kinds, met_by, _) in WIRES.items():
        verbs = [verb for verb in among if verb in met_by]
        for number, kind in enumerate(kinds):
            for turn in range(verbs_each):
                verb = verbs[(number + turn * (len(verbs) // verbs_each)) % len(verbs)]
                found.append(Case(wire, kind, verb, (7 * number + 3 * turn) % 10))
    return found
