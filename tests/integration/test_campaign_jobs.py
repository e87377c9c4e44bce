"""Calibration, loop, diagnosis and reports as an axis's desk runs them, on the bench and without a browser."""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from support.bench_axis import PASSWORDS, lay_out

from hil.axis.axis_file import AxisConfig, load_axis
from hil.calibration import job as calibrate
from hil.calibration.explore import Exploration
from hil.calibration.job import CALIBRATE
from hil.calibration.page_data import calibration_screen
from hil.desk.desk import Desk
from hil.desk.job import Job, Workplace
from hil.desk.plan import Move
from hil.desk.progress import Phase, Progress
from hil.desk.roles import LockedError
from hil.desk.worker_process import Passes
from hil.diagnosis.loop.job import loop_job
from hil.diagnosis.loop.jobs.plan import Looped, passes_at
from hil.diagnosis.loop.jobs.stored import STAGES, StoredLoop, stored_loop
from hil.diagnosis.loop.procedure import Turning
from hil.diagnosis.page import DIAGNOSE
from hil.diagnosis.page_data import diagnosis_screen
from hil.machine.events import Event, Point
from hil.machine.in_motion_settings import feeds_of
from hil.records.rows import read_csv
from hil.report.job import HISTORY
from hil.report.page_data import reports
from hil.ui.screen.campaigns import measurements

pytestmark = pytest.mark.outside
Until = Callable[[Callable[[], bool], str], None]
READING, KEY = PASSWORDS["HIL_PASSWORD"], PASSWORDS["HIL_KEY_PASSWORD"]


@pytest.fixture
def axis(tmp_path: Path) -> AxisConfig:
    return load_axis(lay_out(tmp_path, machine="typical", sections=5))


@pytest.fixture
def desk(axis: AxisConfig, until: Until) -> Iterator[Desk]:
    with Desk(axis, pace=0.0) as one:
        until(lambda: one.live.connected, "the axis is connected")
        yield one


def waits(condition: Callable[[], bool], what: str, within_s: float = 300.0) -> None:
    """For whole jobs, in real time."""
    deadline = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"not within {within_s:g} s: {what}")
        time.sleep(0.02)


def now(desk: Desk, kind: str) -> Progress:
    progress = desk.last(kind)
    assert progress is not None
    return progress


def run(desk: Desk, token: str, job: Job) -> Progress:
    desk.run(token, job)
    waits(lambda: not now(desk, job.kind).running, f"{job.kind} is over")
    return now(desk, job.kind)


def stopped_after(points: int, job: Job, desk: Desk) -> Job:
    """The same job; the stop is pressed in the axis's own thread, when this many points are measured."""

    def work(place: Workplace) -> object:
        numbers = itertools.count(1)

        def listen(event: Event) -> None:
            place.listener(event)
            if isinstance(event.found, Point) and next(numbers) == points:
                desk.stop()

        return job.work(replace(place, listener=listen))

    return replace(job, work=work)


def test_calibrated_stopped_resumed_verified_with_and_without(axis: AxisConfig, desk: Desk) -> None:
    token = desk.control.take("test")
    with pytest.raises(LockedError):
        desk.run(token, calibrate.calibration_job(axis))
    assert not list(axis.store.directory.glob("*"))
    refused = run(desk, token, calibrate.verification_job(axis))
    assert refused.phase is Phase.FAILED
    assert "reading password" in refused.error

    desk.become_builder(token, KEY, READING)
    stopped = run(desk, token, stopped_after(5, calibrate.calibration_job(axis), desk))
    assert stopped.phase is Phase.STOPPED
    assert calibration_screen(axis).unfinished == {CALIBRATE: ("calibrate-001", 1, (), None)}
    begun = read_csv(axis.store.directory / "calibrate-001" / "measure.csv")
    assert len(begun) == 5

    resumed = run(desk, token, calibrate.calibration_job(axis, resume=True))
    assert resumed.phase is Phase.DONE, resumed.error
    measured = read_csv(axis.store.directory / "calibrate-001" / "measure.csv")
    assert len(measured) == 20
    assert measured.measured_mm[: len(begun)].tolist() == begun.measured_mm.tolist()
    assert axis.tables_path.exists()
    screen = calibration_screen(axis)
    assert screen.unfinished == {}
    assert screen.tables
    assert screen.stages["after"].figures_um["A"] < 0.2 * screen.stages["before"].figures_um["A"]

    verified = run(desk, token, calibrate.verification_job(axis))
    plain = run(desk, token, calibrate.verification_job(axis, corrected=False))
    assert (verified.phase, plain.phase) == (Phase.DONE, Phase.DONE)
    stages = calibration_screen(axis).stages
    assert stages["verified"].figures_um["A"] < 0.5 * stages["uncorrected"].figures_um["A"]
    assert {point for point, _ in stages["verified"].means_um[1]} == {
        point for point, _ in stages["uncorrected"].means_um[1]
    }
    assert desk.live.in_force == ""  # of the session: nothing stays in force after a job


def test_loop_diagnosis_and_history(axis: AxisConfig, desk: Desk) -> None:
    token = desk.control.take("test")
    desk.become_builder(token, KEY, READING)
    passes = replace(passes_at(axis, feeds_of("30, 110")), runs=1, rows=6, latency_s=0.0, period_s=0.008)
    turning = Turning(Exploration(runs=2, rows=12, warm_up_s=30.0), most_further=0, in_motion=passes)
    job = loop_job(axis, turning)
    targets = axis.measurement.targets_mm
    assert job.plan.moves[-1] == Move("feeds 30, 110", min(targets), max(targets), 110.0)
    looped = run(desk, token, job)
    assert looped.phase is Phase.DONE, looped.error
    assert isinstance(looped.result, Looped)
    assert list(looped.result.stages) == list(STAGES)
    stored = stored_loop(axis.store.directory)  # as a desk finds it that was not there
    assert stored == StoredLoop("close-loop-001", looped.result.stages, looped.result.good)
    assert looped.result.stages["uncorrected"]["rms_um"] > 3.0 * looped.result.stages["extended, explored"]["rms_um"]
    latest = diagnosis_screen(axis).chosen
    assert latest is not None
    assert latest.key == "close-loop-001/motion-before"
    kept = diagnosis_screen(axis, "close-loop-001/before")
    assert kept.shown is not None
    assert kept.shown.rms_um["before"] > 0.0

    again = next(one for one in measurements(axis.store.directory) if one.key == "close-loop-001/after")
    desk.compute(token, DIAGNOSE, [Passes(again.key, again.paths)])
    number = desk.trace()[-1].number
    waits(lambda: not desk.computed.running, "the diagnosis is made")
    assert desk.computed.error == ""
    assert desk.trace()[-1].number > number  # the axis was looked at meanwhile
    assert diagnosis_screen(axis, again.key).shown is not None

    desk.compute(token, HISTORY)
    waits(lambda: not desk.computed.running, "the history is made")
    assert desk.computed.made == ("history-001.html",), desk.computed.error
    assert [one.kind for one in reports(axis.store.directory)] == ["history"]
