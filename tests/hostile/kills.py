"""A verb interrupted at one moment (killed, Ctrl-C, supply of machine and host lost) and resumed on the same machine.

The simulated machine continues between the two processes: bench, clock, drive and wire are the same. A kill leaves the files as they
were on disk at its moment, sometimes with an incomplete last line, and no further frame leaves the master: the drive has only its
guard time. Judged by the plant: no motion outside the limits, every row of both processes in one frame.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from hostile.can_peer import HostileBus
from hostile.judge import DATUM_MM, HOMING_MM, REACH_MM, ROW_MM, WALL_S, HangError, Rows, Truth, ended_after
from hostile.peer import when_due
from hostile.places import TRAVEL_MM, VERBS, Place

import hil.machine.bench_canopen
import hil.machine.bench_wiring
from drivers.errors import BridgeError
from sim_backends.bench import Bench, BenchParameters
from sim_backends.clock import SimClock

KILL, CTRL_C, POWER = "kill", "Ctrl-C", "power loss"
WAYS = (KILL, CTRL_C, POWER)
BROKEN_OFF = ("calibrate", "verify", "lost-motion", "close-loop")
HOMING = {
    "37": "method = 37\nhome_position_mm = 0.0",
    "1": "method = 1\nhome_position_mm = 0.0",
    "17": "method = 17\nhome_position_mm = -5.0",
    "none": "",
}
"""[drive.homing] by which a homed axis counts from the machine's own zero: the limit switch is at -5 mm, an index pulse at 0.
37 takes the present position, which is 0 in the first process; "none" relies on the drive's counter."""
KEEPS_ZERO = ("1", "17")
"""Methods that find the same zero from any position: with them a resume has to succeed."""
REST_S = 6.0
"""Time for the drive to notice the lost master, and to come to rest, s."""


class KilledError(BaseException):
    """The process was killed. Raised at that moment; code that runs after it changes no file."""


@dataclass(frozen=True)
class Break:
    verb: str
    method: str
    way: str
    share: float
    seed: int

    def __str__(self) -> str:
        return f"{self.verb}, homing {self.method}, {self.way} at {self.share:.4f} ({self.seed})"


@dataclass
class Broken:
    """complaints: empty for a correct run. ended: end of the second process."""

    case: Break
    ended: str = ""
    complaints: list[str] = field(default_factory=list)


class Machine:
    """The parts that continue between two processes."""

    def __init__(self) -> None:
        self.bench: Bench | None = None
        self.bus: HostileBus | None = None
        self.truth: Truth | None = None
        self.on_first: Callable[[Bench], None] = lambda _bench: None
        self._slaves: dict[int, Any] = {}

    def make_bench(self, parameters: BenchParameters, clock: SimClock | None = None) -> Any:
        if self.bench is None:
            self.bench = Bench(parameters, clock=clock)
            self.truth = Truth(self.bench)
            self.on_first(self.bench)
        return _Kept(self.bench)

    @contextmanager
    def drives(self, clock: SimClock, _channel: str) -> Iterator[Machine]:
        if self.bus is None:
            self.bus = HostileBus(clock, None)
        yield self

    def add(self, servo: Any, node_id: int = 1, **settings: Any) -> Any:
        if node_id not in self._slaves:
            assert self.bus is not None
            self._slaves[node_id] = self.bus.add(servo, node_id, **settings)
        return self._slaves[node_id]

    def master(self) -> Any:
        assert self.bus is not None
        return self.bus.master()

    def lose_master(self, clock: SimClock) -> None:
        """No further frame leaves the process."""
        if self.bus is not None:
            for port in self.bus.ports:
                port.schedule_bus_off(clock.now_ns() * 1e-9, 1e9)

    def lose_power(self, bench: Bench) -> None:
        for slave in self._slaves.values():
            slave.lose_power(bench.clock.now_ns())

    def power_back(self, bench: Bench) -> None:
        """The drive's counter starts at 0 at the present position; the laser has its own supply, and has counted on."""
        servo = bench.servo
        servo._frame, servo.homed = servo._actual, False
        for slave in self._slaves.values():
            slave.boot(bench.clock.now_ns())

    @contextmanager
    def wired(self) -> Iterator[None]:
        with (
            patch.object(hil.machine.bench_wiring, "Bench", self.make_bench),
            patch.object(hil.machine.bench_canopen, "drives_in_turn", self.drives),
        ):
            yield


class _Kept:
    """A bench that remains when its context is left."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def __enter__(self) -> Bench:
        return self._bench

    def __exit__(self, *_exc: object) -> None:
        """The machine does not end with the process."""


def _place(directory: Path, case: Break, *, resume: bool) -> Place:
    homing = HOMING[case.method]
    place = Place(directory, "canopen", resume=resume)
    place.homing = f"\n[drive.homing]\n{homing}\n" if homing else ""
    place.home, place.corrected = bool(homing), False  # tables are bound to a zero, which not every method finds
    return place


def _start_counts(case: Break) -> float:
    """First position of the axis, counts: its zero for methods that take the present position as zero."""
    return 1e5 * Random(case.seed).uniform(0.0, 100.0) if case.method in KEEPS_ZERO else 0.0


@cache
def whole_s(verb: str, method: str) -> float:
    """Simulated duration of a verb that is not interrupted, s."""
    machine = Machine()
    with TemporaryDirectory() as directory, machine.wired():
        VERBS[verb](_place(Path(directory), Break(verb, method, KILL, 1.0, 0), resume=False))
    assert machine.bench is not None
    return machine.bench.clock.now_ns() * 1e-9


def run(case: Break) -> Broken:
    """Both processes; never raises."""
    random = Random(str(case))
    at_ns = max(1, round(case.share * whole_s(case.verb, case.method) * 1e9))
    machine, rows, found = Machine(), Rows(), Broken(case)
    over: list[bool] = []
    with TemporaryDirectory() as folder, ExitStack() as stack:
        directory, kept = Path(folder) / "axis", Path(folder) / "as it was"

        def breaks(bench: Bench) -> None:
            if over:  # the first process ended before that moment
                return
            if case.way == CTRL_C:
                raise KeyboardInterrupt
            _snapshot(directory, kept, random)
            machine.lose_master(bench.clock)
            if case.way == POWER:
                machine.lose_power(bench)
            raise KilledError

        def begin(bench: Bench) -> None:
            rows.truth = machine.truth
            servo = bench.servo
            servo._actual = servo._demand = servo._target = _start_counts(case)
            when_due(bench.clock, at_ns, lambda: breaks(bench))

        machine.on_first = begin
        stack.enter_context(machine.wired())
        stack.enter_context(rows.catch())
        _live(lambda: VERBS[case.verb](_place(directory, case, resume=False)))
        over.append(True)
        bench, truth = machine.bench, machine.truth
        assert bench is not None
        assert truth is not None
        if kept.exists():
            shutil.rmtree(directory)
            kept.rename(directory)
        bench.clock.sleep_s(REST_S)
        if truth.powered and truth.speed_mm_s() > 0.0:
            found.complaints.append(f"still moving {REST_S:g} s after it was broken off")
        if case.way == POWER:
            machine.power_back(bench)
        before = len(rows.off_mm)
        error = _live(lambda: VERBS[case.verb](_place(directory, case, resume=True)))
        found.ended = "done" if error is None else type(error).__name__
        found.complaints += _judged(case, error, truth, rows, before)
    return found


def _live(life: Callable[[], None]) -> BaseException | None:
    try:
        with ended_after(WALL_S):
            life()
    except BaseException as error:  # noqa: BLE001 - it is the result to judge
        return error
    return None


def _snapshot(directory: Path, kept: Path, random: Random) -> None:
    """The files as a kill leaves them; sometimes with the row being written incomplete."""
    shutil.copytree(directory, kept)
    growing = sorted(kept.glob("*-campaign/*/*.csv"), key=lambda path: path.stat().st_mtime_ns)
    if growing and random.random() < 0.3:
        with growing[-1].open("ab") as file:
            file.write(b"1.0,1.0,20.0,2"[: random.randrange(1, 14)])


def _judged(case: Break, error: BaseException | None, truth: Truth, rows: Rows, before: int) -> Iterator[str]:
    if isinstance(error, HangError):
        yield f"hangs: {error}"
    elif error is not None and not isinstance(error, BridgeError):
        yield f"ends by {type(error).__name__}: {error}"
    elif error is not None and case.method in KEEPS_ZERO:
        yield f"does not go on: {' '.join(str(error).split())[:200]}"
    low_mm, high_mm = TRAVEL_MM[0] - HOMING_MM, TRAVEL_MM[1] + REACH_MM
    if (beyond_mm := truth.outside_mm(low_mm, high_mm, coasted=case.way == POWER)) > 0.0:
        yield f"{beyond_mm:.2f} mm further outside than allowed"
    if not rows.off_mm:
        return
    spread_mm = max(rows.off_mm) - min(rows.off_mm)
    shifted = (
        before > 0 or case.method in KEEPS_ZERO
    )  # without an earlier row, a zero of the second process is as good as one of the first
    if spread_mm > ROW_MM or (shifted and max(map(abs, rows.off_mm)) > DATUM_MM):
        yield f"rows in another frame: {spread_mm:.4f} mm apart, {len(rows.off_mm) - before} of them after the break"


def breaks(moments: int, verbs: tuple[str, ...] = BROKEN_OFF, methods: tuple[str, ...] = tuple(HOMING)) -> list[Break]:
    """So many random moments of each verb with each method; the kinds of interruption take turns."""
    random = Random(f"{moments}")
    return [
        Break(verb, method, WAYS[(turn + number) % len(WAYS)], random.random(), number)
        for turn, (verb, method) in enumerate(product(verbs, methods))
        for number in range(moments)
    ]
