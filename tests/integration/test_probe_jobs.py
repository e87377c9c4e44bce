"""The probe's jobs at the operator's desk, on the bench in simulated time: measured, refused, stopped, locked, corrected, centred."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from support import probe_files

import hil.probe.job
from hil.axis.axis_file import load_drive_axis
from hil.correction.sealed import Cost, WrongPasswordError, new_key, save_private_key, save_public_key
from hil.desk.axis_thread import AxisThread
from hil.desk.control import NotInControlError
from hil.desk.desk import Desk
from hil.desk.job import Job
from hil.desk.progress import JobLog, Phase, Progress
from hil.desk.roles import LockedError
from hil.probe import job as probe
from hil.probe.machine_file import ProbeMachineConfig, load_probe_machine
from hil.probe.page_data import (
    ProbeRecord,
    contacts,
    last_at,
    lent,
    open_store_at,
    probe_record,
    result_at,
    store_at,
)
from hil.probe.procedure import BoreCentre, Correction, FeatureMeasurement
from hil.probe.runout import CorrectionCode
from hil.probe.store import RunOutStore
from hil.records.files import held
from hil.ui.screen.texts import Texts
from sim_backends.plant.touch_probe import Bore, Boss
from sim_backends.probe_bench import ProbeBench

Until = Callable[[Callable[[], bool], str], None]
TOUCH_MM_S = 20.0
QUICK = f"touch_mm_s = {TOUCH_MM_S}\nposition_mm_s = 50.0"
SEED = "[bench]\nseed = 4\n"
BOSS = "\n[boss]\nx_mm = 80.0\ny_mm = 80.0\nclear_mm = 9.0\nsearch_mm = 1.0\n"


@dataclass
class Seen:
    """The simulated machines of the jobs, the last one last; look: is attached to the clock of each"""

    benches: list[ProbeBench] = field(default_factory=list)
    look: Callable[[ProbeBench, int], None] | None = None


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> Seen:
    behind, make = Seen(), hil.probe.job.probe_bench

    def making(*given: Any, **more: Any) -> ProbeBench:
        bench = make(*given, **more)
        behind.benches.append(bench)
        look = behind.look
        if look is not None:
            bench.clock.attach(lambda now_ns, _dt_s: look(bench, now_ns), bearable=lambda _now_ns: 1_000_000)
        return bench

    monkeypatch.setattr(hil.probe.job, "probe_bench", making)
    return behind


@dataclass
class AtWork:
    """Desks of some of the machine's axes, all of them controlled; jobs are run from the first."""

    config: ProbeMachineConfig
    desks: list[Desk]
    tokens: dict[Desk, str]
    until: Until

    @property
    def desk(self) -> Desk:
        return self.desks[0]

    def record(self) -> ProbeRecord:
        return probe_record(self.config, store_at(self.config, self.desk))

    def start(self, job: Job) -> None:
        others = lent(self.config, self.desks, self.desk)
        self.desk.run(self.tokens[self.desk], job, {desk: self.tokens[desk] for desk in others})

    def run(self, job: Job) -> Progress:
        """To its end, and until each desk has its axis again."""
        self.start(job)
        self.until(lambda: not self.now().running, "the job is over")
        self.until(lambda: all(desk.live.connected for desk in self.desks), "each has its axis")
        return self.now()

    def now(self) -> Progress:
        job = last_at(self.desks)
        assert job is not None
        return job

    def m90(self, mode: str = "latch") -> Job:
        store = store_at(self.config, self.desk)
        assert store is not None
        return probe.measuring_job(self.config, store, mode)


@contextmanager
def at_work(tmp_path: Path, until: Until, axes: str = "X", **more: Any) -> Iterator[AtWork]:
    given = {"start_mm": 102.6, "search_mm": 1.0, "probe": QUICK, "block": "turns = 1", "more": SEED, **more}
    config = load_probe_machine(probe_files.lay_out(tmp_path, **given))
    numbers = itertools.count(1)
    desks = [Desk(load_drive_axis(tmp_path / f"{name}.toml"), pace=0.0, numbers=numbers) for name in axes]
    try:
        for desk in desks:
            desk.__enter__()
        until(lambda: all(desk.live.connected for desk in desks), "connected")
        yield AtWork(config, desks, {desk: desk.control.take("test") for desk in desks}, until)
    finally:
        for desk in desks:
            desk.close()


# -- stop ------------------------------------------------------------------------------------------------------------------
@dataclass
class _Stopped:
    clicked_ns: int = 0
    held_ns: int = 0
    demand_counts: int = 0
    shown_mm: float = 0.0
    place_mm: float = 0.0


@pytest.mark.parametrize(
    ("mode", "clicked_at", "drive"),
    [
        ("latch", "X", probe_files.VIRTUAL),
        ("step", "Y", probe_files.VIRTUAL),
        pytest.param("latch", "X", probe_files.CANOPEN, marks=pytest.mark.outside),
    ],
)
def test_holds_within_50_ms_of_a_stop_while_feeding_towards_the_block(  # noqa: PLR0917
    tmp_path: Path, until: Until, seen: Seen, mode: str, clicked_at: str, drive: str
) -> None:
    """Clicked at 20 mm/s, for which the ramp of the axis file (1000 mm/s²) needs 20 ms, or after 100 pulses, at the desk that lends Y.

    Nothing is touched, nothing stays enabled.
    """
    with at_work(tmp_path, until, "XY", drive=drive, start_mm=101.0, search_mm=3.0) as at:
        stopped = _Stopped()

        def look(bench: ProbeBench, now_ns: int) -> None:
            servo = bench.servos["x"]
            speed_mm_s = servo.velocity_actual_counts_s / bench.axes["x"].scaling.counts_per_load_mm
            feeds = speed_mm_s > 0.99 * TOUCH_MM_S if mode == "latch" else speed_mm_s > 0.0 and bench.place("x") > 101.1
            if not stopped.clicked_ns and feeds:
                stopped.clicked_ns = now_ns
                stopped.place_mm, stopped.shown_mm = bench.place("x"), at.desk.live.position_load_mm or 0.0
                next(desk for desk in at.desks if desk.name == clicked_at).stop()
            elif stopped.clicked_ns and servo.position_demand_counts == stopped.demand_counts and speed_mm_s < 2.0:
                stopped.held_ns = stopped.held_ns or now_ns
            stopped.demand_counts = servo.position_demand_counts

        seen.look = look
        assert at.run(at.m90(mode)).phase is Phase.STOPPED
        assert 0 < stopped.held_ns - stopped.clicked_ns <= 50_000_000
        assert stopped.shown_mm == pytest.approx(stopped.place_mm, abs=0.5)  # looked at while it was fed
        (bench,) = seen.benches
        assert 101.1 < bench.place("x") < 102.9  # under way, and short of the face
        assert bench.probe.touches == 0
        assert not any(servo.powered for servo in bench.servos.values())
        assert at.record() == ProbeRecord(None, None, [])


# -- what is measured ------------------------------------------------------------------------------------------------------
def test_measured_corrected_and_centred(tmp_path: Path, until: Until, seen: Seen) -> None:
    """From the page of X, which the machine has, while Y's desk lends its axis; against what the simulated machine holds."""
    with at_work(tmp_path, until, "XY", block="turns = 2", more=SEED + BOSS) as at:
        y = at.desks[1]
        assert lent(at.config, at.desks, at.desk) == [y]
        assert at.run(at.m90()).phase is Phase.DONE
        assert y.job() is None  # lent, not run
        measured = result_at(at.desks, probe.MEASURE, probe.MeasuredRunOut)
        assert measured is not None
        assert measured.refusal is None
        found, stylus = measured.measurement.run_out, seen.benches[-1].probe.parameters.stylus
        assert (found.x_mm, found.y_mm) == pytest.approx(stylus.offset_mm, abs=1e-3)
        assert found.tip_radius_mm == pytest.approx(stylus.radius_mm, abs=1e-3)
        came = contacts(at.config, last_at(at.desks, [probe.MEASURE]))
        assert [(one.turn, one.angle_deg) for one in came] == [(t, a) for t in (1, 2) for a in (0, 90, 180, 270)]
        assert [one.pulses for one in came] == pytest.approx([1000 * one.feed_mm for one in came])
        assert [one.feed_mm for one in came[:4]] == pytest.approx(list(vars(measured.measurement.turns[0]).values()))
        record = at.record()
        assert record.in_force == found
        assert [one.verdict for one in record.history] == ["stored"]

        store = store_at(at.config, at.desk)
        assert store is not None
        ended = at.run(probe.correction_job(at.config, store, found, CorrectionCode.M91))
        assert ended.error == ""
        assert result_at(at.desks, probe.CORRECT, Correction).driven_mm == pytest.approx((found.x_mm, 0.0))  # type: ignore[union-attr]
        assert 1000 * (seen.benches[-1].place("x") - 50.0) == pytest.approx(1000 * found.x_mm, abs=0.1)

        assert at.run(probe.centring_job(at.config, store, found, CorrectionCode.M93, "latch")).phase is Phase.DONE
        (bore,) = (one for one in seen.benches[-1].probe.parameters.solids if isinstance(one, Bore))
        centred = result_at(at.desks, probe.CENTRE, BoreCentre)
        assert centred is not None
        assert centred.centring.centre_mm == pytest.approx(bore.point_mm[:2], abs=1e-3)
        assert (seen.benches[-1].place("x"), seen.benches[-1].place("y")) == pytest.approx(bore.point_mm[:2], abs=1e-3)

        assert at.run(probe.feature_job(at.config, store, found, "boss", "latch")).phase is Phase.DONE
        (boss,) = (one for one in seen.benches[-1].probe.parameters.solids if isinstance(one, Boss))
        other = result_at(at.desks, probe.OTHER, FeatureMeasurement)
        assert other is not None
        assert (other.corrected["x_mm"], other.corrected["y_mm"]) == pytest.approx(boss.point_mm[:2], abs=1e-3)


def test_a_job_that_is_over_has_given_its_axes_back(
    tmp_path: Path, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the next one, started at once, would ask for an axis that the last one is about to take back."""
    seen_at_the_end: list[tuple[bool, list[bool]]] = []
    taken_back: list[str] = []
    end, take_back = JobLog.end, AxisThread.take_back

    def ending(log: JobLog, *given: Any, **more: Any) -> None:
        seen_at_the_end.append((taken_back == ["Y"], [desk.live.connected for desk in at.desks]))
        end(log, *given, **more)

    def taking_back(thread: AxisThread) -> None:
        taken_back.append(thread.axis.name)
        take_back(thread)

    with at_work(tmp_path, until, "XY") as at:
        monkeypatch.setattr(JobLog, "end", ending)
        monkeypatch.setattr(AxisThread, "take_back", taking_back)
        assert at.run(at.m90()).phase is Phase.DONE
    assert seen_at_the_end == [(True, [False, False])]


def test_a_chip_on_the_block_is_refused_and_said_in_german(tmp_path: Path, until: Until) -> None:
    with at_work(tmp_path, until, "Y", more=f"{SEED}chip_um = 30.0") as at:
        assert at.run(at.m90()).phase is Phase.WITHOUT_RESULT
        measured = result_at(at.desks, probe.MEASURE, probe.MeasuredRunOut)
        assert measured is not None
        assert measured.refusal is not None
        assert "the contacts do not close" in measured.refusal
        assert Texts("de").said(measured.refusal).startswith("Die Antastungen schließen nicht: N0 + N180 = ")
        record = at.record()
        assert record.in_force is None
        assert [(one.verdict, one.why) for one in record.history] == [("refused", measured.refusal)]


def test_axes_to_be_lent_are_told_by_their_files_and_their_names(tmp_path: Path) -> None:
    """Not the page's own, and none that only looks alike."""
    config = load_probe_machine(probe_files.lay_out(tmp_path))
    probe_files.lay_out(tmp_path / "other")
    strange = tmp_path / "other/Z.toml"
    strange.write_text((tmp_path / "other/X.toml").read_text().replace('name = "X"', 'name = "Z"'))
    paths = (tmp_path / "X.toml", tmp_path / "other/../S.toml", tmp_path / "other/Y.toml", strange)
    desks = [Desk(load_drive_axis(path)) for path in paths]
    assert [desk.name for desk in lent(config, desks, desks[0])] == ["S", "Y"]
    assert [desk.name for desk in lent(config, desks, desks[3])] == ["X", "S", "Y"]


# -- who may -----------------------------------------------------------------------------------------------------------------
def test_an_axis_that_is_not_ours_to_lend_is_refused(tmp_path: Path, until: Until) -> None:
    """By whoever controls its desk, and by another process that has its file."""
    with at_work(tmp_path, until, "XY") as at:
        x, y = at.desks
        with pytest.raises(NotInControlError):
            x.run(at.tokens[x], at.m90(), {y: None})
    with at_work(tmp_path, until, "X") as at, held(tmp_path / "S.toml"):
        ended = at.run(at.m90())
        assert ended.phase is Phase.FAILED
        assert ended.error.endswith("S.toml: is in use already, expected one process at a time")


SEALED = f"{SEED}[store]\nsealed = true"


def opened(at: AtWork) -> RunOutStore:
    store = store_at(at.config, at.desk)
    assert store is not None
    return store


def lay_out_keys(tmp_path: Path) -> None:
    key = new_key()
    save_private_key(tmp_path / "builder.key", key, "builder of the probe", cost=Cost(n=1 << 10, r=8, p=1))
    save_public_key(tmp_path / "builder.pub", key.public_key())


def test_a_sealed_run_out_is_measured_by_its_builder_only(tmp_path: Path, until: Until) -> None:
    """Who is not, moves nothing; and what was opened ends with the role, and with control."""
    lay_out_keys(tmp_path)
    with at_work(tmp_path, until, more=SEALED) as at:
        token = at.tokens[at.desk]
        assert store_at(at.config, at.desk) is None
        with pytest.raises(WrongPasswordError):
            open_store_at(at.desk, token, at.config, "reading of the probe", "wrong")
        with pytest.raises(NotInControlError):
            open_store_at(at.desk, None, at.config, "reading of the probe", "builder of the probe")
        open_store_at(at.desk, token, at.config, "reading of the probe")
        assert not opened(at).writable
        with pytest.raises(LockedError):
            at.start(at.m90())
        for give_up in (lambda: at.desk.become_operator(token), lambda: at.desk.control.release(token)):
            open_store_at(at.desk, token, at.config, "reading of the probe", "builder of the probe")
            assert opened(at).writable
            give_up()
            assert store_at(at.config, at.desk) is None
        assert last_at(at.desks) is None
        assert not at.config.store.directory.exists()


@pytest.mark.outside
def test_a_sealed_run_out_is_put_into_force_and_read(tmp_path: Path, until: Until) -> None:
    lay_out_keys(tmp_path)
    with at_work(tmp_path, until, more=SEALED) as at:
        token = at.tokens[at.desk]
        open_store_at(at.desk, token, at.config, "reading of the probe", "builder of the probe")
        job = at.m90()
        assert at.run(job).phase is Phase.DONE
        assert at.record().in_force is not None
        assert at.config.store.directory.joinpath("runout.sealed").exists()

        at.desk.become_operator(token)
        with pytest.raises(LockedError, match="it needs the builder"):
            at.start(job)
        record = at.record()
        assert (record.in_force, len(record.history)) == (None, 1)
        with pytest.raises(WrongPasswordError):
            open_store_at(at.desk, token, at.config, "not it")
        assert store_at(at.config, at.desk) is None
        open_store_at(at.desk, token, at.config, "reading of the probe")
        assert at.record().in_force is not None
