"""One slow drive of a download holds up no other, on one bus or on several, and what ends one line ends all of them in order."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.paper_drive import task_on
from support.parameter_rigs import ParameterRig, maker_eds, maker_keys, maker_set, shows_late

from drivers.canopen.eds import EdsFile, load_eds
from drivers.canopen.known_objects import address_of
from drivers.canopen.raw_parameters import START_S
from drivers.clock import Clock, WallClock
from drivers.errors import NoAnswerError
from drivers.modbus.wear import WearLedger
from drivers.raw_parameters import Pause, RawParameters, Steps
from hil.parameters.download import download
from hil.parameters.report import Ending
from hil.parameters.tasks import run_together
from hil.parameters.transaction import Target
from sim_backends.canopen_faults import CanFault
from sim_backends.clock import SimClock
from sim_backends.faults import CanFaultKind

COUNT = 12
KEYS = maker_keys(COUNT)
NEW = maker_set(COUNT)
NODES = (5, 6, 7, 8)
SLOW = 6
SLOW_S = 5.0
TURNAROUND_S = 0.01  # of every drive, so that all of them are at work for as long as one waits
K = CanFaultKind
Make = Callable[..., ParameterRig]
Times = dict[str, float]
"""When each drive was done, s from the beginning."""


@pytest.fixture(scope="module")
def parsed(tmp_path_factory: pytest.TempPathFactory) -> EdsFile:
    return load_eds(maker_eds(tmp_path_factory.mktemp("eds"), COUNT), 5)


@pytest.fixture
def make(parsed: EdsFile, tmp_path: Path) -> Iterator[Make]:
    rigs: list[ParameterRig] = []

    def build(**options: object) -> ParameterRig:
        folder = tmp_path / str(len(rigs))
        rigs.append(ParameterRig(Path(parsed.path), folder, **{"nodes": NODES, "file": parsed, **options}))  # type: ignore[arg-type]
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.stack.close()


def finished(rig: ParameterRig, steps: Callable[[RawParameters], Steps[None]]) -> Times:
    clock, start_ns = rig.bench.clock, rig.bench.clock.now_ns()
    times: Times = {}

    def timed(drive: RawParameters) -> Steps[None]:
        yield from steps(drive)
        times[drive.name] = (clock.now_ns() - start_ns) * 1e-9

    errors = run_together(rig.drives, lambda drive: drive, timed)
    assert errors == [None] * len(rig.drives)
    return times


def goals() -> dict[str, bytes]:
    sizes = [4, 2, 1, 4, 2, 1]
    return {
        address_of(key): int(entry.raw).to_bytes(sizes[number % 6], "little")  # type: ignore[arg-type]
        for number, (key, entry) in enumerate(zip(KEYS, NEW.entries, strict=True))
    }


def proves(drive: RawParameters) -> Steps[None]:
    present = yield from drive.show(list(goals()))
    yield from task_on(drive, 2 * SLOW_S).bring(goals(), present, starts=drive.restarts)


def settles(drive: RawParameters) -> Steps[None]:
    yield from task_on(drive, 0.1).settle_at(goals(), retry_within_s=4 * SLOW_S)


@pytest.mark.parametrize("steps", [proves, settles])
def test_a_drive_that_shows_its_values_late_holds_up_no_other(
    make: Make, steps: Callable[[RawParameters], Steps[None]]
) -> None:
    alone = finished(make(nodes=[node for node in NODES if node != SLOW]), steps)
    rig = make()
    shows_late(rig, KEYS, SLOW, SLOW_S)
    together = finished(rig, steps)
    assert together.pop(f"X{SLOW}") > SLOW_S
    assert together.keys() == alone.keys()
    for name, took_s in together.items():  # the slow one's frames take their share of the bus
        assert took_s <= 4 / 3 * alone[name] + 0.001
    assert all(rig.values(KEYS, node) == [entry.raw for entry in NEW.entries] for node in range(len(NODES)))


@pytest.mark.parametrize(
    "faults",
    [
        [CanFault(K.SDO_LATE, size=0.04)],  # the time-out is 0.05 s
        [CanFault(K.SDO_LOST, skip=20 + 7 * number, count=1) for number in range(10)],
        [CanFault(K.SDO_LATE, size=0.2, skip=20 + 5 * number, count=1) for number in range(8)],
    ],
    ids=["every answer late", "answers lost", "answers behind the time-out"],
)
def test_a_drive_that_answers_late_or_not_holds_up_no_other_in_any_stage(make: Make, faults: list[CanFault]) -> None:
    def times(rig: ParameterRig) -> tuple[dict[str, float], set[Ending]]:
        clock = rig.bench.clock
        first: dict[str, int] = {}
        last: dict[tuple[str, str], int] = {}

        def progress(stage: str, drive: str, done: int, total: int) -> None:
            first.setdefault(stage, clock.now_ns())
            if done == total:
                last.setdefault((stage, drive), clock.now_ns())

        targets = [Target(drive, NEW, journal) for drive, journal in zip(rig.drives, rig.journals, strict=True)]
        reports = download(targets, progress=progress)
        spans = {
            drive: sum(1e-9 * (time_ns - first[stage]) for (stage, name), time_ns in last.items() if name == drive)
            for drive in (drive.name for drive in rig.drives)
        }
        return spans, {report.ending for report in reports}

    alone, endings = times(make(nodes=[node for node in NODES if node != SLOW], turnaround_s=TURNAROUND_S))
    assert endings == {Ending.WRITTEN}
    rig = make(faults=faults, only=SLOW, turnaround_s=TURNAROUND_S)
    together, endings = times(rig)
    assert endings == {Ending.WRITTEN}
    slow_s = together.pop(f"X{SLOW}")
    assert slow_s > 1.5 * max(alone.values())
    for name, took_s in together.items():
        assert took_s <= alone[name] + 0.02


def test_a_drive_whose_boot_up_does_not_come_holds_up_no_other(make: Make) -> None:
    rig = make(faults=[CanFault(K.NODE_DEAD)], only=SLOW)
    clock, start_ns = rig.bench.clock, rig.bench.clock.now_ns()
    times: Times = {}

    def restarts_or_reads(drive: RawParameters) -> Steps[None]:
        if drive.name == f"X{SLOW}":
            yield from drive.restart()
        yield from drive.show(list(goals()))
        times[drive.name] = (clock.now_ns() - start_ns) * 1e-9

    errors = run_together(rig.drives, lambda drive: drive, restarts_or_reads)
    assert [type(error) for error in errors] == [type(None), NoAnswerError, type(None), type(None)]
    assert (clock.now_ns() - start_ns) * 1e-9 == pytest.approx(START_S, abs=0.01)
    assert max(times.values()) < 0.1


# -- drives on different lines ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("steps", [proves, settles])
def test_a_slow_drive_holds_up_no_drive_of_another_bus(
    make: Make, steps: Callable[[RawParameters], Steps[None]]
) -> None:
    """One simulated time for three buses: what the fast ones take is what each takes alone."""

    def times() -> list[float]:
        clock = SimClock()
        rigs = [make(clock=clock, nodes=(5,)) for _ in range(3)]
        shows_late(rigs[0], KEYS, 5, SLOW_S)
        start_ns = clock.now_ns()
        took_s = [0.0] * len(rigs)

        def timed(rig: ParameterRig) -> Steps[None]:
            yield from steps(rig.drives[0])
            took_s[rigs.index(rig)] = (clock.now_ns() - start_ns) * 1e-9

        assert run_together(rigs, lambda rig: rig.drives[0], timed) == [None] * 3
        assert all(rig.values(KEYS) == [entry.raw for entry in NEW.entries] for rig in rigs)
        return took_s

    alone = make(nodes=(5,))
    start_ns = alone.bench.clock.now_ns()
    assert run_together(alone.drives, lambda drive: drive, steps) == [None]
    alone_s = (alone.bench.clock.now_ns() - start_ns) * 1e-9
    slow_s, *others_s = times()
    assert slow_s > SLOW_S
    assert others_s == pytest.approx([alone_s] * 2, abs=1e-6)
    assert times() == [slow_s, *others_s], "threads or not, a run is repeatable"


def test_a_whole_download_over_two_buses(make: Make) -> None:
    """Each drive's own time is what its report says, and each journal comes to its end."""
    clock = SimClock()
    slow = make(clock=clock, nodes=(5,), faults=[CanFault(CanFaultKind.SDO_LATE, size=0.04)])
    fast = make(clock=clock, nodes=(5,))
    told: list[tuple[str, str]] = []
    targets = [Target(rig.drives[0], NEW, rig.journals[0]) for rig in (slow, fast)]
    reports = download(targets, progress=lambda stage, drive, *_: told.append((stage, drive)))
    assert [report.ending for report in reports] == [Ending.WRITTEN] * 2
    assert all(rig.journals[0].unfinished() is None for rig in (slow, fast))
    last = reports[0].seconds, reports[1].seconds
    assert last[0] > 1.0
    looked_s = 0.04 * (COUNT + 4)  # nothing is written before all have been looked at
    assert last[1] < last[0] - looked_s / 2


class _Line:
    """Work on a wall clock that nothing but pauses and threads is needed for."""

    def run(self, jobs: list[Steps[None]]) -> list[None]:
        for job in jobs:
            for pause in job:
                assert isinstance(pause, Pause)
                deadline = WallClock().deadline(pause.duration_s)
                while not (deadline.expired or pause.done()):
                    WallClock().sleep_s(0.001)
        return [None for _ in jobs]


class _Drive:
    def __init__(self) -> None:
        self.line = _Line()
        self.clock: Clock = WallClock()


def test_lines_on_the_wall_clock_wait_for_each_other_not_in_turn() -> None:
    """Each of these ends only once the others have begun."""
    barrier = threading.Barrier(3, timeout=10.0)

    def meets(_drive: object) -> Steps[None]:
        barrier.wait()
        yield Pause(0.0)

    assert run_together([_Drive(), _Drive(), _Drive()], lambda drive: drive, meets) == [None] * 3  # type: ignore[arg-type,return-value]


def test_two_ledgers_of_one_file_count_each_others_writes(tmp_path: Path) -> None:
    path = tmp_path / "eeprom-writes.json"
    ledgers = {name: WearLedger(path) for name in ("X", "Z")}

    def charges(name: str) -> None:
        for _ in range(50):
            ledgers[name].charge(name, "gain", 1000)

    threads = [threading.Thread(target=charges, args=(name,)) for name in ledgers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert json.loads(path.read_text()) == {"X/gain": 50, "Z/gain": 50}
