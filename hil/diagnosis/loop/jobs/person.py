"""Somebody at the machine, whom a job asks through the desk: for a run that needs a person, and to bring a condition about."""

from __future__ import annotations

from drivers.errors import StateError
from hil.app.jobs.job import Question, Workplace
from hil.app.report.views import label_of
from hil.axis.axis_file import AxisConfig
from hil.diagnosis.next.planned_run import PlannedRun
from hil.machine.conditions import AskedConditions, Conditions

CONSENT_S, BRING_S = 600.0, 3600.0
"""How long an answer is waited for: whether a run shall be made, and until a load, an optic … is as it was asked for."""
RUN, CONDITION = "run", "condition"
"""Kinds of question."""


class Person:
    """Who is at the machine of one job. After a question about a run that nobody answered nobody is asked for another."""

    def __init__(self, place: Workplace) -> None:
        self._place = place
        self._gone = False

    def consents(self, run: PlannedRun) -> bool:
        """Whether a run that needs a person is to be made; no answer in time is a no, and is told."""
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
        """Returns once the condition is as asked for. Raises StateError where it is not, or nobody answers in time."""
        unit = label_of(name).partition(", ")[2]
        figures = {"condition": name, "value": f"{value:g} {unit}".rstrip()}
        answer = self._place.ask(Question(CONDITION, figures, BRING_S))
        if not answer:
            why = "somebody answered that it cannot be" if answer is False else f"no answer within {BRING_S / 60:g} min"
            raise StateError(f"{name} was not brought to {value:g}: {why}; what was measured is kept")

    def conditions(self, axis: AxisConfig, there: Conditions) -> Conditions:
        """Who brings about loads and the like: the bench does so itself, on a machine this person does."""
        if axis.drive.backend == "bench":
            return there
        return AskedConditions(axis.conditions.levels, self.brings)
