"""A job that asks somebody at the machine, in simulated time: answers, silence, a stop meanwhile, and who may answer."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest
from support.bench_axis import lay_out

from drivers.drive import DriveState
from drivers.errors import StateError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.correction.store import SealedStore
from hil.desk.control import NotInControlError
from hil.desk.desk import Desk
from hil.desk.job import Job, Question, Workplace
from hil.desk.plan import Plan
from hil.desk.progress import Phase, Progress
from hil.desk.stop import Pacing, Stop
from hil.diagnosis.loop import job as close_loop
from hil.diagnosis.loop import job as loop_job
from hil.diagnosis.loop.job import Person
from hil.diagnosis.loop.procedure import Loop, Turning
from hil.diagnosis.next.planned_run import PlannedPoint, PlannedRun
from hil.machine.conditions import AskedConditions, NoConditions
from hil.machine.events import silent
from hil.machine.machine import Machine
from hil.machine.session import AxisSession

Until = Callable[[Callable[[], bool], str], None]
RUN = PlannedRun(
    "levels", "measure by turns", (PlannedPoint(1, 1, 0.0, 1.0),), 3.0, "somebody has to bring load to 60 kg"
)
SAID = "measure by turns (1 rows, about 3 min; somebody has to bring load to 60 kg)"


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> AxisConfig:
    return load_axis(lay_out(tmp_path_factory.mktemp("axis")))


@pytest.fixture(scope="module")
def desk(axis: AxisConfig) -> Iterator[Desk]:
    with Desk(axis, pace=0.0) as one:
        yield one


class Asked:
    """A job that asks, at a desk."""

    def __init__(self, desk: Desk, until: Until, work: Callable[[Workplace], object]) -> None:
        until(lambda: desk.live.connected, "the axis is connected")
        self.desk, self.until, self.token = desk, until, desk.control.take("test")
        desk.run(self.token, Job("asks", Plan(desk.name, "bench"), work))

    def question(self) -> int:
        """The number of the question that is asked."""
        self.until(lambda: self.desk.question is not None, "something is asked")
        pending = self.desk.question
        assert pending is not None
        return pending.number

    def ended(self) -> Progress:
        def now() -> Progress:
            job = self.desk.last("asks")
            assert job is not None
            return job

        self.until(lambda: not now().running, "the job is over")
        self.desk.control.release(self.token)
        assert self.desk.question is None
        return now()


def consents(place: Workplace) -> bool:
    return Person(place).consents(RUN)


@pytest.mark.parametrize(("yes", "told"), [(True, ()), (False, (f"not made, as was answered: {SAID}",))])
def test_the_answer_of_whoever_holds_control(yes: bool, told: tuple[str, ...], desk: Desk, until: Until) -> None:
    asked = Asked(desk, until, consents)
    number = asked.question()
    pending = desk.question
    assert pending is not None
    assert pending.question == Question("run", {"run": SAID}, loop_job.CONSENT_S)
    with pytest.raises(NotInControlError):
        desk.answer("somebody else's token", number, yes=not yes)
    desk.answer(asked.token, number - 1, yes=not yes)  # of a question that is over
    desk.answer(asked.token, number, yes=yes)
    desk.answer(asked.token, number, yes=not yes)  # too late
    job = asked.ended()
    assert (job.phase, job.result, job.messages) == (Phase.DONE, yes, told)


def test_without_an_answer_in_time_it_is_not_made_and_nobody_is_asked_again(
    desk: Desk, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop_job, "CONSENT_S", 0.3)
    passed_s = []

    def work(place: Workplace) -> list[bool]:
        begun_ns = place.drive.clock.now_ns()
        there = Person(place)
        answers = [there.consents(RUN)]
        passed_s.append((place.drive.clock.now_ns() - begun_ns) / 1e9)
        return [*answers, there.consents(RUN)]

    job = Asked(desk, until, work).ended()
    assert job.result == [False, False]
    assert job.messages == (f"not made, nobody answered within 0.005 min: {SAID}",) * 2
    assert passed_s == [pytest.approx(0.3, abs=0.06)]  # of the axis's time, and of the first question alone


def test_a_stop_ends_the_question(desk: Desk, until: Until) -> None:
    asked = Asked(desk, until, consents)
    asked.question()
    desk.stop()
    assert asked.ended().phase is Phase.STOPPED
    until(lambda: desk.live.state is not DriveState.ENABLED, "the axis is as it was found")


def test_a_condition_is_brought_about_or_the_job_fails(
    desk: Desk, axis: AxisConfig, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop_job, "BRING_S", 0.1)
    asked = Asked(desk, until, lambda place: Person(place).brings("load_kg", 60.0))
    job = asked.ended()
    assert (job.phase, "load_kg was not brought to 60: no answer within" in job.error) == (Phase.FAILED, True)

    monkeypatch.undo()
    asked = Asked(desk, until, lambda place: Person(place).brings("load_kg", 60.0))
    number = asked.question()
    assert desk.question is not None
    assert desk.question.question.figures == {"condition": "load_kg", "value": "60 kg"}
    desk.answer(asked.token, number, yes=True)
    assert asked.ended().phase is Phase.DONE


def test_the_bench_brings_its_conditions_about_itself_and_a_person_those_of_a_machine(axis: AxisConfig) -> None:
    answers = iter([True, False])
    waiting = Pacing(Stop())
    place = Workplace(axis, None, None, silent, print, None, waiting, lambda *_: None, lambda _question: next(answers))
    there, somebody = NoConditions(), Person(place)
    assert somebody.conditions(axis, there) is there
    asked = somebody.conditions(replace(axis, drive=replace(axis.drive, backend="canopen")), there)
    assert isinstance(asked, AskedConditions)
    asked.set("setup", 2.0)
    assert asked.read() == {"setup": 2.0}
    with pytest.raises(StateError, match="setup was not brought to 3: somebody answered"):
        asked.set("setup", 3.0)


def test_the_loop_asks_for_its_runs_and_for_its_conditions(axis: AxisConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever is at a machine is asked in place of nobody, and for the time of the loop alone."""
    asked: list[Question] = []
    there = NoConditions()
    session = SimpleNamespace(conditions=there, zero=None)

    def turned(machine: Machine, _store: object, turning: Turning, *_: object, **__: object) -> Loop:
        assert turning.consent is not None
        assert turning.consent(RUN)
        machine.session.conditions.set("setup", 2.0)
        raise StateError("far enough")

    def answers(question: Question) -> bool:
        asked.append(question)
        return True

    monkeypatch.setattr(close_loop, "run_loop", turned)
    on_machine = replace(axis, drive=replace(axis.drive, backend="canopen"))
    place = Workplace(
        *(on_machine, None, cast(AxisSession, session), silent, print, cast(SealedStore, object()), Pacing(Stop())),
        lambda *_: None,
        answers,
    )
    with pytest.raises(StateError, match="far enough"):
        close_loop.loop_job(on_machine, Turning()).work(place)
    assert [one.kind for one in asked] == ["run", "condition"]
    assert session.conditions is there
