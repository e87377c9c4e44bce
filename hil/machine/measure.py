"""Measuring a pass: a list of steps, each approached from its direction. Each row is on disk before the next motion.

An interrupted pass is resumed at its first missing row; its rows must be the first rows of the same plan, in the same order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from typing import TypeVar

import numpy as np

from drivers.drive import DriveSample, ServoDrive
from drivers.errors import InputError, MeasurementLostError, StateError
from drivers.standstill import Standstill
from hil.axis.axis_file import MeasurementConfig
from hil.correction.compensation import CorrectedSetPoint
from hil.figures.reading import RULE
from hil.machine.events import Event, Listener, Point, silent
from hil.machine.one_correction import refuse_while_drive_corrects
from hil.machine.session import AxisSession, PositionReading
from hil.records.journal import Campaign, RowJournal
from hil.records.rows import UM_PER_MM, Records

BASE_COLUMNS = (
    "run",
    "direction",
    "target_mm",
    "measured_mm",
    "command_mm",
    "time_s",
    "velocity_mm_s",
    "since_reversal_mm",
    "stroke_mm",
    "motor_mm",
    "torque_percent",
)

STEADY_S = 1.0
"""Time for which the signal must be good without a break before it is used, s."""
MOST_LOSSES = 3
"""Losses at one point after which it is not tried again. A hand in the beam explains one or two; a third loss at the same point is
likely caused by the machine (a cover, a cable, the pitch of the table), and each further try would move the axis without an
operator."""

T = TypeVar("T")


@dataclass(frozen=True)
class Step:
    """One capture: arrive at a target in a direction, and read.

    run: number of the run, from 1; direction: +1 or -1
    overrun_mm: distance beyond the target at which the axis reverses before it, 0: it moves straight from its present position
    feed_mm_s: velocity of the approach; None for either means the session's value
    dwell_s: standstill before the session's own dwell
    """

    run: int
    direction: int
    target_mm: float
    overrun_mm: float | None = None
    feed_mm_s: float | None = None
    dwell_s: float = 0.0


def bidirectional_steps(targets_mm: Sequence[float], runs: int) -> list[Step]:
    """Steps of the standard test cycle of ISO 230-2: every run goes up through all targets and down again. targets_mm: shape (m,)."""
    up = sorted(targets_mm)
    steps: list[Step] = []
    for run in range(1, runs + 1):
        steps += [Step(run, 1, target) for target in up]
        steps += [Step(run, -1, target) for target in reversed(up)]
    return steps


def steps_for_sections(wanted: Iterable[tuple[float, int]], runs: int) -> list[Step]:
    """Steps for some sections, each in one direction. wanted: (target_mm, direction) pairs, measured `runs` times."""
    pairs = set(wanted)
    up = sorted(target for target, direction in pairs if direction > 0)
    down = sorted((target for target, direction in pairs if direction < 0), reverse=True)
    steps: list[Step] = []
    for run in range(1, runs + 1):
        steps += [Step(run, 1, target) for target in up]
        steps += [Step(run, -1, target) for target in down]
    return steps


def measure(
    session: AxisSession,
    campaign: Campaign,
    name: str,
    steps: Sequence[Step],
    listener: Listener = silent,
    *,
    comment: str = "",
) -> Records:
    """Measure a pass, or the missing rows of it, with the session's present compensation; returns all its rows.

    Where the direction changes, the axis approaches from beyond the target by the overrun, so that each target is reached in its
    direction after at least that travel. Raises InputError where the rows on disk are not of this plan, ValueError for a pass without
    steps, and what moving and reading raise.
    """
    columns = campaign.columns(name)
    if columns is None:
        columns = (*BASE_COLUMNS, *sorted(column for column in session.known() if column not in BASE_COLUMNS))
    session.time_offset_s = max(session.time_offset_s, campaign.last_time_s() - session.elapsed_s())
    with campaign.rows(name, columns, comment) as journal:
        done = _check_plan(journal, steps)
        if 0 < done < len(steps):
            journal.note(f"resumed after {done} rows; homed and datum taken anew")
        readings: list[PositionReading] = []
        read_ns: list[int] = []
        runner = _StepRunner(session, steps)
        listener(Event(name, done=done, total=len(steps)))
        for index, step in enumerate(steps[done:], start=done):

            def tell(what: str, done: int = index) -> None:
                journal.note(what)
                listener(Event(name, what, done, len(steps)))

            try:
                command, reading = retry_after_signal_loss(session, partial(runner.capture, index), tell)
            except MeasurementLostError as lost:
                _withdraw(journal, read_ns, lost)
                raise
            for note in session.untold_notes():
                journal.note(note)
                listener(Event(name, note, index, len(steps), warning=True))
            readings.append(reading)
            read_ns.append(session.clock.now_ns())
            journal.append(_row(step, command, reading, session.known(), columns))
            listener(Event(name, f"{step.target_mm:.3f} mm", index + 1, len(steps), _point(name, step, reading)))
        if readings:
            journal.note(_precision_note(readings))
        records = journal.records()
    if records is None:
        raise ValueError(f"pass {name} has no steps")
    return records


def _withdraw(journal: RowJournal, read_ns: Sequence[int], lost: MeasurementLostError) -> None:
    """Withdraw the rows read since the instrument was last seen to follow the motor. read_ns: times of the latest rows."""
    doubtful = 0 if lost.followed_ns is None else sum(time_ns > lost.followed_ns for time_ns in read_ns)
    if doubtful:
        journal.withdraw(doubtful, f"the instrument was not seen to follow the motor since; {lost}")


def _point(name: str, step: Step, reading: PositionReading) -> Point:
    """The error of one capture at its target, µm over mm; a curve for each direction of a pass."""
    error_um = (reading.position_load_mm - step.target_mm) * UM_PER_MM
    return Point(f"{name}, {'+' if step.direction > 0 else '−'}", step.target_mm, error_um)


@dataclass
class _StepRunner:
    """Moves the axis from step to step. at: index of the step where the axis stands, None when anything else has moved it since."""

    session: AxisSession
    steps: Sequence[Step]
    at: int | None = None

    def capture(self, index: int) -> tuple[CorrectedSetPoint, PositionReading]:
        """Move to the step's target in its direction, and read."""
        step, stands_at, self.at = self.steps[index], self.at, None
        if step.overrun_mm == 0.0 and stands_at != index - 1:
            self._repeat_path_to(index)
        _approach(self.session, step)
        command = self.session.move_to(step.target_mm, step.feed_mm_s)
        if step.dwell_s:
            self.session.watch(step.dwell_s)
        reading, self.at = self.session.read_position(), index
        return command, reading

    def _repeat_path_to(self, index: int) -> None:
        """Repeat the motions before a step that starts from the step before it, without capturing.

        A stop, a homing or a new datum has changed the travel since the last reversal and the strokes before it, on which that row
        depends. The repetition starts at the last step at an end of the pass, approached over the whole length of the pass.
        """
        targets = [step.target_mm for step in self.steps]
        low, high = min(targets), max(targets)
        begin = max((i for i in range(index) if targets[i] in (low, high)), default=0)
        for i, step in enumerate(self.steps[begin:index], start=begin):
            if i == begin:
                at_end = step.target_mm == (high if step.direction > 0 else low)
                _approach(self.session, replace(step, overrun_mm=high - low) if at_end else step, anyhow=True)
            self.session.move_to(step.target_mm, step.feed_mm_s)


def _precision_note(readings: Sequence[PositionReading]) -> str:
    """Precision of the averages of a pass, as a sentence for its file: root mean squares over the points, µm."""
    one, mean = _rms([r.std_um for r in readings]), _rms([r.mean_std_um for r in readings])
    return (
        f"{len(readings)} averages of {min(r.count for r in readings)} or more readings: standard deviation of a reading"
        f" {one:.4f} um, of an average {mean:.4f} um; {sum(r.left_out for r in readings)} left out ({RULE})"
    )


def _rms(values: Sequence[float]) -> float:
    """Root mean square, NaN left out; NaN where all are."""
    return float(np.sqrt(np.nanmean(np.square(values)))) if not np.all(np.isnan(values)) else math.nan


def _check_plan(journal: RowJournal, steps: Sequence[Step]) -> int:
    """Number of rows on disk. Raises InputError unless they are the first rows of this plan."""
    records = journal.records()
    if records is None:
        return 0
    planned = [(step.run, step.direction, step.target_mm) for step in steps[: len(records)]]
    found = list(zip(records.run.tolist(), records.direction.tolist(), records.target_mm.tolist(), strict=True))
    if found != planned:
        row = next(
            (index for index, (is_, was) in enumerate(zip(planned, found, strict=False)) if is_ != was), len(steps)
        )
        raise InputError(
            f"row {row + 1} is not what the plan measures there; expected the axis file it was started with",
            path=journal.path,
        )
    return len(records)


def _approach(session: AxisSession, step: Step, *, anyhow: bool = False) -> None:
    """Move beyond the target by the overrun where the motion to it would not go in the step's direction, or always (`anyhow`)."""
    history = session.history
    if history is None or history.direction == 0:
        session.take_datum()
        history = session.history
    here = math.nan if history is None else history.position_mm
    travel = (step.target_mm - here) * step.direction
    if travel > 0 and step.overrun_mm == 0.0:
        return
    if anyhow or not travel > 0 or (history is not None and history.direction != step.direction):
        overrun_mm = session.how.overrun_mm if step.overrun_mm is None else step.overrun_mm
        session.approach(step.target_mm - step.direction * overrun_mm)


def _row(
    step: Step, command: CorrectedSetPoint, reading: PositionReading, known: Mapping[str, float], columns: Sequence[str]
) -> dict[str, float]:
    """One row. The cell of a sensor without a value is NaN."""
    torque = reading.sample.torque_percent
    row = {
        "run": float(step.run),
        "direction": float(step.direction),
        "target_mm": step.target_mm,
        "measured_mm": round(reading.position_load_mm, 7),
        "command_mm": command.command_mm,
        "time_s": round(known["time_s"], 6),
        "velocity_mm_s": 0.0,
        "since_reversal_mm": command.history.since_reversal_mm,
        "stroke_mm": command.history.stroke_or_long_mm,
        "motor_mm": reading.sample.position_load_mm,
        "torque_percent": math.nan if torque is None else torque,
    }
    return {**{column: known.get(column, math.nan) for column in columns}, **row}


def other_targets(how: MeasurementConfig, seed: int) -> tuple[float, ...]:
    """Verification targets, mm, shape (m - 1,): one at random between each two neighbouring calibration targets."""
    generator = np.random.default_rng([how.seed, seed])
    low, high = np.array(how.targets_mm[:-1]), np.array(how.targets_mm[1:])
    return tuple(round(float(target), 3) for target in low + generator.uniform(0.2, 0.8, len(low)) * (high - low))


# -- a lost signal ---------------------------------------------------------------------------------------------------------
def retry_after_signal_loss(session: AxisSession, point: Callable[[], T], tell: Callable[[str], None]) -> T:
    """Returns what `point` returns. After a lost signal that comes back in time, `point` is called again, from a new datum.

    The instrument loses its zero with the signal. The axis moves without an operator's command then, and a hand may be in the beam:
    only where the axis file allows it ([instrument] resume_within_s).
    point: measures one point; tell: called with a message at each loss and resume. Raises MeasurementLostError in a session without
    `resume_within_s`, when the signal does not come back within that, at the loss number `MOST_LOSSES`, and at once where the readings
    disagree with the motor. Errors of the drive are raised at once.
    """
    for times in count(1):
        try:
            return point()
        except MeasurementLostError as lost:
            if session.resume_within_s is None or lost.followed_ns is not None:
                raise  # readings that disagree with the motor do not come back, and rows before may be wrong
            if times == MOST_LOSSES:
                raise MeasurementLostError(
                    f"{lost}; it was lost {times} times on the way to the same point, which is not tried again: see what cuts the"
                    " beam off there"
                ) from lost
            tell(f"{lost}; waiting up to {session.resume_within_s:g} s for it")
            _await_signal(session, session.resume_within_s, lost)
            tell("signal back; datum taken anew")
    raise AssertionError("count does not end")


def _await_signal(session: AxisSession, within_s: float, lost: MeasurementLostError) -> None:
    """Wait until the signal was good for `STEADY_S`, then take the datum. A signal that is lost again meanwhile is waited for too.
    Raises StateError, before the axis is enabled, as `_StoppedDrive.look`."""
    deadline, stopped = session.clock.deadline(within_s), _StoppedDrive(session.drive)
    while True:
        try:
            session.acknowledge_loss()
            session.supervisor.watch(STEADY_S, stopped.look)
            stopped.require_rest()
            session.supervisor.enable()
            stopped = _StoppedDrive(session.drive)  # for a stop on the way to the datum
            refuse_while_drive_corrects(session.drive)
            session.take_datum(signal_was_lost=True)
        except MeasurementLostError:
            if deadline.expired:
                raise lost from None
            stopped.look(session.drive.sample())
        else:
            return


class _StoppedDrive:
    """A drive that was stopped and is to be enabled again without an operator. Who switches it off meanwhile may be in the machine."""

    def __init__(self, drive: ServoDrive) -> None:
        self._drive, self._standstill = drive, Standstill(drive.scaling.resolution_load_mm)
        self._at_rest: DriveSample | None = None  # the first sample at rest; a drive may power off where its stop ends

    def require_rest(self) -> None:
        """Raises StateError where the axis never was at rest."""
        if self._at_rest is None:
            raise StateError(
                f"drive {self._drive.name} was stopped for a lost signal, and the axis is not at rest; it is not enabled again"
            )

    def look(self, now: DriveSample) -> None:
        """Raises StateError where the state of the drive or its supply has changed since the axis came to rest."""
        stands = self._standstill.look(now.time_ns, now.position_load_mm, now.velocity_mm_s)
        if self._at_rest is None:
            self._at_rest = now if stands else None
        elif (now.state, now.supplied) != (self._at_rest.state, self._at_rest.supplied):
            was, shown = (
                f"{of.state.value}{'' if of.supplied is not False else ' without supply'}"
                for of in (self._at_rest, now)
            )
            raise StateError(
                f"drive {self._drive.name} was stopped for a lost signal, and while it was waited for, the drive went from {was} to"
                f" {shown}: somebody may be in the machine; nothing was enabled. Resume the job"
            )
