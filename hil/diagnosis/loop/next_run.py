"""Making the next measurement of a diagnosis on the machine: the axis's abilities, and a planned run as steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hil.axis.axis_file import MeasurementConfig
from hil.calibration.explore import ExploringRun
from hil.diagnosis.next.planned_run import Means, PlannedPoint
from hil.machine.conditions import SET_UP
from hil.machine.measure import Step
from hil.machine.session import AxisSession


def means_of_measurement(how: MeasurementConfig) -> Means:
    """The measuring abilities given by the targets and times of an axis file; conditions, sensors and persons are added
    by the caller.
    """
    return Means(
        min(how.targets_mm),
        max(how.targets_mm),
        feed_mm_s=how.velocity_mm_s,
        reading_s=how.dwell_s + how.reading_s,
        overrun_mm=how.overrun_mm,
        targets=min(len(how.targets_mm), 21),
    )


def means_of(session: AxisSession) -> Means:
    """The measuring abilities of a session: its targets and times, conditions, and sensors.

    With a person the optics can be set up anew; sensors cannot be added while the axis is connected.
    """
    how, conditions = session.how, session.conditions
    asked = conditions.by_hand
    levels = {name: tuple(float(v) for v in values) for name, values in conditions.levels.items() if name not in SET_UP}
    return replace(
        means_of_measurement(how),
        levels=levels,
        by_itself=frozenset() if asked else frozenset(levels),
        sensors=frozenset(session.known()),
        mountable=SET_UP if asked else frozenset(),
    )


def runs_of(points: Sequence[PlannedPoint]) -> list[ExploringRun]:
    """Planned rows as parts of a campaign: a new part wherever a condition is set, the axis is warmed, or it rests."""
    runs: list[ExploringRun] = []
    steps: list[Step] = []
    first = points[0]
    for point in points:
        step = Step(
            point.run, point.direction, point.target_mm, point.overrun_mm, point.feed_mm_s, dwell_s=point.dwell_s
        )
        if steps and (point.strokes_s or point.rest_s or point.levels != first.levels):
            runs.append(ExploringRun(tuple(steps), first.strokes_s, first.rest_s, first.levels))
            steps, first = [], point
        steps.append(step)
    runs.append(ExploringRun(tuple(steps), first.strokes_s, first.rest_s, first.levels))
    return runs
