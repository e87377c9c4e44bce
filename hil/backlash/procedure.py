"""Lost motion from the servo's torque, without a position sensor (system B, CN103561904).

1. Note the drive's backlash parameter and its acceleration switch; set both to 0.
2. Each run: to the reference in +, reverse, step by step until the table has broken away, then a few longer moves; or, as
published too, one very slow move; the same from −.
3. Both estimates of every reversal, the mean of both directions (or one alone, `BacklashConfig.reversals`).
4. Restore the parameters, also after any error; write the new amount only on request.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.drive import Capability, DriveSample, ServoDrive
from drivers.errors import CapabilityError, LimitError, ProtocolError
from hil.axis.backlash import SLIDE_MM, SLIDES, BacklashConfig
from hil.backlash.neutral_settings import BacklashSettings, neutral
from hil.backlash.result import NAMES, Reversal, TorqueBacklash
from hil.backlash.settings import NoSetting
from hil.backlash.torque_fit import fit_wind_up
from hil.backlash.trace import ReversalTrace, crept_trace
from hil.desk.job import Tell
from hil.machine.events import Event, Listener, Measured, Point, silent
from hil.machine.one_correction import refuse_while_drive_corrects
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis

READING_S = 0.002
"""Interval between two torque readings at one position, s."""
STEP_SLICE_S = 0.005
"""Polling interval of the drive during a single step, s."""
CREEP_SLICE_S = 0.005
"""Polling interval of the drive while it creeps, s."""
_FIT_EVERY = 8  # steps
_SLIDING_STEPS, _SLIDING_SHARE = 14, 0.25  # how far to continue beyond the break-away

Keep = Callable[[int, ReversalTrace], None]
"""keep(run, trace): receives every reversal, also an interrupted one."""
Remember = Callable[[dict[str, float], float], None]
"""remember(before, amount): receives the parameters before the measurement, and the amount about to be written."""


def check_drive(drive: ServoDrive, how: BacklashConfig) -> None:
    """Checks the drive before anything is written or moved.

    Raises CapabilityError for what it cannot do, LimitError for positions outside the travel, and StateError while the
    drive's own correction table is in force: at a reversal it would turn the motor further than the drive shows.
    """
    refuse_while_drive_corrects(drive, "what its table adds at a reversal would be missing from the lost motion")
    drive.require(Capability.PROFILE_POSITION, Capability.TORQUE_ACTUAL)
    sample = drive.sample()
    if how.home and not sample.homed:
        drive.require(Capability.HOMING)
    if sample.torque_percent is None:
        raise CapabilityError(f"drive {drive.name} does not report its torque, and backlash is measured by torque")
    check_reach(
        drive, *(place(each) for each in how.directions for place in (how.start_mm, how.turning_mm, how.end_mm))
    )


def check_reach(drive: ServoDrive, *positions_load_mm: float) -> None:
    """Raises LimitError for the first position outside the travel, before anything moves."""
    for position in positions_load_mm:
        try:
            drive.limits.check_target(position)
        except LimitError as error:
            raise LimitError(f"nothing was moved: {error}") from error


def measure_backlash(
    drive: ServoDrive,
    how: BacklashConfig,
    settings: BacklashSettings,
    *,
    write: bool = False,
    remember: Remember = lambda _before, _amount: None,
    keep: Keep = lambda _run, _trace: None,
    listener: Listener = silent,
    tell: Tell = lambda _text: None,
) -> TorqueBacklash:
    """Measures on an open drive. tell: receives what could not be restored, while another error is raised.

    The parameters are restored before this returns or raises; with `write` the mean is then written to the parameter
    and read back.
    Raises what `check_drive` raises, NotRestoredError, ProtocolError for another value read back, and what stops an
    axis.
    """
    check_drive(drive, how)
    if write and isinstance(settings.amount, NoSetting):
        settings.amount.write(1.0)  # raises: nothing could hold what would be measured
    reversals: list[Reversal] = []
    with neutral(settings, tell) as found, Supervisor([WatchedAxis(drive)]) as supervisor:
        supervisor.get_ready(home=how.home)
        measurement = _Measurement(supervisor, how, keep, listener)
        for run in range(1, how.runs + 1):
            for direction in how.directions:
                reversals.append(Reversal.of(run, measurement.reversal(run, direction)))
                listener(measurement.result(reversals[-1]))
                if reversals[-1].lost_motion_um(how.method) is None:
                    return TorqueBacklash(tuple(reversals), how.method, how.directions, found)
    result = TorqueBacklash(tuple(reversals), how.method, how.directions, found)
    if not write or result.lost_motion_um is None:
        return result
    amount = settings.amount_of(result.lost_motion_um)
    remember(found.values, amount)
    _write(settings, amount)
    return replace(result, written=amount)


def _write(settings: BacklashSettings, amount: float) -> None:
    settings.amount.write(amount)
    kept = settings.amount.read()
    if abs(kept - amount) > 0.5 * settings.amount.resolution:
        raise ProtocolError(f"{settings.amount.name} was written {amount:g}, it reads back {kept:g}")


@dataclass
class _Recording:
    """The rows of one reversal while it is measured."""

    how: BacklashConfig
    direction: int
    weight_percent: float = 0.0
    position_load_mm: list[float] = field(default_factory=list)
    torque_percent: list[list[float]] = field(default_factory=list)
    slides_percent: list[list[float]] = field(default_factory=list)

    def trace(self) -> ReversalTrace:
        if self.how.feed == "creep":
            places, readings = np.array(self.position_load_mm), np.array([each[0] for each in self.torque_percent])
            step_um, creep_um_s = self.how.step_um, self.how.creep_um_s
            return crept_trace(
                self.direction,
                places,
                readings,
                step_um=step_um,
                creep_um_s=creep_um_s,
                weight_percent=self.weight_percent,
            )
        torques = np.array(self.torque_percent)
        slides = np.array(self.slides_percent).reshape(-1, torques.shape[1])
        return ReversalTrace(self.direction, np.array(self.position_load_mm), torques, slides, self.weight_percent)


@dataclass(frozen=True)
class _Measurement:
    """The measurement of single reversals: supervisor, settings and listeners."""

    supervisor: Supervisor
    how: BacklashConfig
    keep: Keep
    listener: Listener

    def reversal(self, run: int, direction: int) -> ReversalTrace:
        """One reversal: run in, reverse, and step until the table slides or the steps are used up.

        The run-in goes both ways: half the sum of the torques that remain after each is the weight of a vertical axis.
        """
        how, turning, step_mm = self.how, self.how.turning_mm(direction), self.how.step_um / 1000.0
        stage = self._stage(run, direction)
        self.listener(Event(stage, "to the reference", 0, how.steps))
        self.supervisor.move(turning, how.travel_velocity_mm_s)
        left_behind = [self._step(place)[1] for place in (how.start_mm(direction), turning)]
        recording = _Recording(how, direction, float(np.mean(left_behind)))
        try:
            if how.feed == "creep":
                self._creep(recording, run, turning)
                return recording.trace()
            for index in range(how.steps + 1):
                position, torques = self._step(turning + direction * index * step_mm)
                recording.position_load_mm.append(position)
                recording.torque_percent.append(torques)
                travelled_um = abs(position - recording.position_load_mm[0]) * 1000.0
                said = f"{travelled_um:.1f} µm, {torques[0]:+.1f} %"
                point = Point(_series(run, direction), travelled_um, float(np.mean(torques)))
                self.listener(Event(stage, said, index, how.steps, point))
                if index % _FIT_EVERY == 0 and _slides_long_enough(recording.trace(), how.step_um):
                    self._slide(recording)
                    break
        finally:
            if recording.position_load_mm:
                self.keep(run, recording.trace())
        return recording.trace()

    def _creep(self, recording: _Recording, run: int, turning_mm: float) -> None:
        """One very slow move over the way of all steps; position and torque are read as often as the drive shows them."""
        how, direction = self.how, recording.direction
        stage, shown = self._stage(run, direction), -1

        def look(sample: DriveSample) -> None:
            nonlocal shown
            if sample.torque_percent is None:
                raise CapabilityError("the drive no longer reports its torque")
            recording.position_load_mm.append(sample.position_load_mm)
            recording.torque_percent.append([sample.torque_percent])
            travelled_um = abs(sample.position_load_mm - recording.position_load_mm[0]) * 1000.0
            if int(travelled_um / how.step_um) > shown:
                shown = int(travelled_um / how.step_um)
                point = Point(_series(run, direction), travelled_um, sample.torque_percent)
                said = f"{travelled_um:.1f} µm, {sample.torque_percent:+.1f} %"
                self.listener(Event(stage, said, min(shown, how.steps), how.steps, point))

        place_mm, torques = self._step(turning_mm)
        recording.position_load_mm.append(place_mm)
        recording.torque_percent.append([float(np.mean(torques))])
        end_mm = turning_mm + direction * how.steps * how.step_um / 1000.0
        self.supervisor.move(end_mm, how.creep_um_s / 1000.0, slice_s=CREEP_SLICE_S, look=look)

    def _stage(self, run: int, direction: int) -> str:
        return f"run {run} of {self.how.runs}, {NAMES[direction]}"

    def result(self, one: Reversal) -> Event:
        direction = one.trace.direction
        found = Measured(_series(one.run, direction), one.lost_motion_um(self.how.method), "µm")
        return Event(self._stage(one.run, direction), "done", self.how.steps, self.how.steps, found)

    def _slide(self, recording: _Recording) -> None:
        """Longer moves in the new direction, at the measuring speed; the torque at rest after each."""
        broken_away_mm = recording.position_load_mm[-1]
        for index in range(1, SLIDES + 1):
            place = broken_away_mm + recording.direction * index * SLIDE_MM
            recording.slides_percent.append(self._step(place)[1])

    def _step(self, position_load_mm: float) -> tuple[float, list[float]]:
        """Moves to one position and rests; the motor's position and the torque readings."""
        supervisor, axis = self.supervisor, self.supervisor.axes[0]
        supervisor.move(position_load_mm, self.how.velocity_mm_s, slice_s=STEP_SLICE_S)
        supervisor.watch(self.how.settle_s)
        torques: list[float] = []
        while True:
            with supervisor.stopping_on_error():
                sample = axis.look_enabled("reading the torque")
            if sample.torque_percent is None:
                raise CapabilityError(f"drive {axis.drive.name} no longer reports its torque")
            torques.append(sample.torque_percent)
            if len(torques) == self.how.readings:
                return sample.position_load_mm, torques
            supervisor.clock.sleep_s(READING_S)


def _series(run: int, direction: int) -> str:
    """Name of a reversal's points and figures."""
    return f"{run}, {NAMES[direction]}"


def _slides_long_enough(trace: ReversalTrace, step_um: float) -> bool:
    """Whether the table has been sliding long enough to determine its level."""
    fit = fit_wind_up(trace)
    if fit is None:
        return False
    beyond_um = float(trace.travel_um[-1]) - fit.lost_motion_um
    return beyond_um >= max(_SLIDING_STEPS * step_um, _SLIDING_SHARE * fit.lost_motion_um)
