"""The loop on one axis as a job: calibrate, explore, diagnose, add the missing effect, measure again (system E)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drivers.errors import StateError
from hil.axis.axis_file import AxisConfig
from hil.correction.store import SealedStore
from hil.desk.job import Job, Question, Workplace, tell_unchecked
from hil.desk.plan import going_on
from hil.desk.zero_statement import NO_STATEMENT, ZeroStatement
from hil.diagnosis.job import shown_diagnosis
from hil.diagnosis.loop.jobs.plan import CLOSE_LOOP, Looped, loop_plan
from hil.diagnosis.loop.jobs.stored import turn_is_good
from hil.diagnosis.loop.procedure import Loop, Turn, Turning, close_loop
from hil.diagnosis.next.planned_run import PlannedRun
from hil.diagnosis.stored import STORED
from hil.figures.error_figures import error_figures
from hil.figures.history import purpose_of_replay
from hil.machine.conditions import AskedConditions, Conditions
from hil.machine.events import Listener, silent
from hil.machine.machine import Machine
from hil.records.journal import Campaign
from hil.ui.report.views import label_of

CONSENT_S, BRING_S = 600.0, 3600.0
"""Time limits of answers, s: to whether a run shall be made, and until a condition (load, optics …) is set."""
RUN, CONDITION = "run", "condition"
"""Kinds of question."""


class Person:
    """The person at the machine during one job. After one unanswered question about a run no further one is asked."""

    def __init__(self, place: Workplace) -> None:
        self._place = place
        self._gone = False

    def consents(self, run: PlannedRun) -> bool:
        """Whether to make a run that needs a person; no answer in time counts as no, and is reported."""
        said = run.describe()
        if not self._gone:
            answer = self._place.ask(Question(RUN, {"run": said}, CONSENT_S))
            if answer:
                return True
            if answer is False:
                self._place.tell(f"not made, as was answered: {said}")
                return False
            self._gone = True
        self._place.tell(f"not made, nobody answered within {CONSENT_S / 60:g} min: {said}")
        return False

    def brings(self, name: str, value: float) -> None:
        """Returns once the condition is set. Raises StateError where it is not, or without an answer in time."""
        unit = label_of(name).partition(", ")[2]
        figures = {"condition": name, "value": f"{value:g} {unit}".rstrip()}
        answer = self._place.ask(Question(CONDITION, figures, BRING_S))
        if not answer:
            why = "somebody answered that it cannot be" if answer is False else f"no answer within {BRING_S / 60:g} min"
            raise StateError(f"{name} was not brought to {value:g}: {why}; what was measured is kept")

    def conditions(self, axis: AxisConfig, there: Conditions) -> Conditions:
        """The object that sets loads and the like: the bench's own, or on a machine this person."""
        if axis.drive.backend == "bench":
            return there
        return AskedConditions(axis.conditions.levels, self.brings)


def loop_purpose(axis: AxisConfig, turning: Turning) -> dict[str, Any]:
    """The purpose of a loop's campaign: everything that decides which rows are measured."""
    plan, in_motion = turning.plan, turning.in_motion
    exploration = vars(turning.exploration) if plan is None else {"plan": repr(list(plan))}
    purpose = {**axis.purpose(CLOSE_LOOP), "exploration": exploration}
    if in_motion is not None:
        purpose["in_motion"] = {**vars(in_motion), "feeds_mm_s": list(in_motion.feeds_mm_s)}
    return purpose


def run_loop(
    machine: Machine,
    store: SealedStore | None,
    turning: Turning,
    listener: Listener = silent,
    *,
    resume: bool = False,
    recording: str = "",
    then: Callable[[], None] = lambda: None,
) -> Loop:
    """Prepares and closes the loop; every compensation is sealed before it is used, and the diagnosis stored beside the
    rows.

    recording: file name of a replayed recording, "" for a real machine; store: None for a recording, whose results are
    not stored; then: the rest of the job, called before its campaign counts as finished
    Raises what `close_loop` and `then` raise.
    """
    axis = machine.axis
    purpose = loop_purpose(axis, turning)
    campaign = Campaign.numbered(axis.store.directory, purpose_of_replay(purpose, recording), resume=resume)
    tell_unchecked(campaign, listener)
    machine.session.prepare(campaign.directory)
    save = store.save if store is not None else lambda _compensation: None
    loop = close_loop(machine.session, campaign, axis.correction, save, listener, turning=turning)
    for name, turn in (("before", loop.turn), ("motion-before", loop.in_motion)):
        if turn is not None:
            campaign.write(f"{name}{STORED}", json.dumps(shown_diagnosis(turn.follow, turn.diagnosed)).encode())
    then()
    campaign.finish()
    return loop


def loop_job(axis: AxisConfig, turning: Turning, *, resume: bool = False, zero: ZeroStatement = NO_STATEMENT) -> Job:
    """For the desk: returns a Looped. The axis is watched while the diagnosis is made; a run that needs a person asks for one."""

    def work(place: Workplace) -> Looped:
        machine, person = place.machine(), Person(place)
        how = replace(turning, computing=place.computing, consent=turning.consent or person.consents)
        session = machine.session
        before, session.conditions = session.conditions, person.conditions(axis, session.conditions)
        try:
            with zero.applied(session):
                loop = run_loop(machine, place.opened_store(), how, place.listener, resume=resume)
        finally:
            session.conditions = before
        return Looped(loop_stages(loop), loop_is_good(loop), loop)

    plan = zero.in_plan(loop_plan(axis, turning.exploration, turning.in_motion))
    if resume:
        plan = going_on(plan, axis.store.directory, CLOSE_LOOP)
    return Job(CLOSE_LOOP, plan, work)


def loop_stages(loop: Loop) -> dict[str, dict[str, Any]]:
    """The measured stages of a loop with their figures, µm."""
    stages = {
        "uncorrected": error_figures(loop.calibration.before),
        "table": error_figures(loop.calibration.rounds[-1].records),
        "table, explored": error_figures(loop.turn.before),
        "extended, explored": error_figures(loop.turn.after),
    }
    if loop.in_motion is not None:
        stages["in motion"] = error_figures(loop.in_motion.before)
        stages["in motion, extended"] = error_figures(loop.in_motion.after)
    return stages


def loop_is_good(loop: Loop) -> bool:
    """Everything is explained, no measurement waits for a person, and the axis measured no worse than before."""
    run = loop.turn.follow.run
    waits = run is not None and bool(run.person)
    turns = [loop.turn] if loop.in_motion is None else [loop.turn, loop.in_motion]
    return not waits and all(_turn_is_good(turn) for turn in turns)


def _turn_is_good(turn: Turn) -> bool:
    before, after = error_figures(turn.before)["rms_um"], error_figures(turn.after)["rms_um"]
    found = turn.diagnosis
    return turn_is_good(before, after, found.noise.within_run_um, unexplained=found.unexplained)
