"""PacedStream: a stream of set-points that the host paces by its clock, for wires without a SYNC.

Holds the supervision that such a wire needs: missed cycles, steps that are too long, state, following error. A drive that it may be
used with says how a set-point reaches it (`HostPacedDrive`).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from functools import partial
from types import TracebackType
from typing import Self

from drivers.clock import NS_PER_S
from drivers.drive import FAULTS, DriveSample, DriveState, ServoDrive
from drivers.errors import (
    CapabilityError,
    DriveFaultError,
    FollowingErrorError,
    InputError,
    LimitError,
    SafetyError,
    StateError,
)
from drivers.set_points import SetPointSettings, SetPointStream
from drivers.shutdown import stop_together
from drivers.undo import undo_all


class HostPacedDrive(ServoDrive):
    """A drive that follows set-points as they come."""

    def cycle_s(self) -> float:
        """Shortest time of a set-point and a sample, s; writes nothing. Raises CapabilityError, and as `sample`."""
        return 0.0

    @property
    def least_period_s(self) -> float:
        """The shortest period that the drive itself takes, s."""
        return 0.0

    @abstractmethod
    def begin_stream(self) -> DriveSample:
        """Bring the enabled drive into its streaming mode without moving it; its sample. Raises StateError unless enabled."""

    @abstractmethod
    def send_set_point(self, position_load_mm: float) -> None: ...

    @abstractmethod
    def end_stream(self) -> None:
        """Hold the axis where it is, and return to the mode for profile moves."""

    def _stream(self, settings: SetPointSettings, others: Sequence[ServoDrive]) -> PacedStream:
        paced = [drive for drive in others if isinstance(drive, HostPacedDrive)]
        for drive in others:
            if drive not in paced:
                raise CapabilityError(f"drive {drive.name} cannot stream together with {self.name}")
        return PacedStream([self, *paced], settings)


class PacedStream(SetPointStream):
    """All set-points of a cycle are checked before the first is sent."""

    def __init__(self, drives: Sequence[HostPacedDrive], settings: SetPointSettings) -> None:
        self.settings = settings
        self.missed_cycles = 0
        self.reached_ns = 0  # time of the next set-points too
        self.found = [(0, math.nan)] * len(drives)
        self._drives = tuple(drives)
        self._period_ns = round(settings.period_s * NS_PER_S)
        self._missed_in_a_row = 0
        self._begun = False
        self._running = False  # entered, and neither left nor stopped
        self._last_mm: list[float] = []

    # -- entering and leaving --------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        self._check_period()
        begun: list[HostPacedDrive] = []
        self._last_mm = []
        try:
            for drive in self._drives:
                self._last_mm.append(drive.begin_stream().position_load_mm)
                begun.append(drive)
        except BaseException as error:
            stop_together(begun, error)
            raise
        self._begun, self._running = False, True
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if exc is not None:
            self._stop(exc)
        elif self._running:
            self._running = False
            undo_all([("", partial(_leave, drive)) for drive in self._drives])

    def _stop(self, error: BaseException) -> None:
        running, self._running = self._running, False
        if running:
            stop_together(self._drives, error)

    def _check_period(self) -> None:
        """Raise InputError for one that is too short for a drive, or for all of them one after the other."""
        period_s, names = self.settings.period_s, ", ".join(drive.name for drive in self._drives)
        needs = [(f"drive {drive.name}", drive.least_period_s, "its register map requires") for drive in self._drives]
        cycle_s = sum(drive.cycle_s() for drive in self._drives)
        needs.append((f"stream of {names}", cycle_s, "set-points and answers take"))
        for who, least_s, what in needs:
            if period_s < least_s:
                raise InputError(f"{who}: stream period is {1e3 * period_s:g} ms, {what} {1e3 * least_s:.3g} ms")

    # -- the cycle -------------------------------------------------------------------------------------------------------
    def cycle(self, positions_load_mm: Sequence[float]) -> None:
        if len(positions_load_mm) != len(self._drives):
            raise InputError(f"{len(positions_load_mm)} set-points for {len(self._drives)} axes")
        try:
            if not self._running:
                raise StateError("the stream is not running")
            for drive, place_mm, last_mm in zip(self._drives, positions_load_mm, self._last_mm, strict=True):
                self._check(drive, place_mm, last_mm)
            self._account_for_lateness()
            for drive, place_mm in zip(self._drives, positions_load_mm, strict=True):
                drive.send_set_point(place_mm)
            before_mm, self._last_mm = self._last_mm, list(positions_load_mm)
            for index, drive in enumerate(self._drives):
                sample = drive.sample()
                self.found[index] = sample.time_ns, sample.position_load_mm
                self._judge(drive, sample, before_mm[index], positions_load_mm[index])
            self._drives[0].clock.sleep_until_ns(self.reached_ns)
        except BaseException as error:
            self._stop(error)
            raise

    def _check(self, drive: ServoDrive, position_load_mm: float, last_mm: float) -> None:
        """Raise LimitError for a position outside the travel (mm), or a step that is too long."""
        limits, period_s = drive.limits, self.settings.period_s
        limits.check_target(position_load_mm)
        step_mm = abs(position_load_mm - last_mm)
        if step_mm > limits.max_velocity_mm_s * period_s + drive.scaling.resolution_load_mm:
            raise LimitError(
                f"drive {drive.name}: step of {step_mm:.6f} mm in one cycle is {step_mm / period_s:g} mm/s,"
                f" allowed are {limits.max_velocity_mm_s:g} mm/s"
            )

    def _account_for_lateness(self) -> None:
        """Advance the time of the next set-points; whole periods that lie behind count as missed cycles."""
        now_ns = self._drives[0].clock.now_ns()
        if not self._begun:
            self._begun, self.reached_ns = True, now_ns  # the first set-points are the zero of time
        missed = max(0, now_ns - self.reached_ns) // self._period_ns
        self.reached_ns += (missed + 1) * self._period_ns
        self.missed_cycles += missed
        self._missed_in_a_row = self._missed_in_a_row + missed if missed else 0
        if self._missed_in_a_row > self.settings.missed_limit:
            raise SafetyError(
                f"stream: {self._missed_in_a_row} cycles of {1e3 * self.settings.period_s:g} ms missed in a row, the host is late"
            )

    def _judge(self, drive: ServoDrive, sample: DriveSample, before_mm: float, now_mm: float) -> None:
        state, name = sample.state, drive.name
        if state in FAULTS:
            raise DriveFaultError(f"drive {name} went into {state.value} while streaming", sample.fault_code)
        if state is not DriveState.ENABLED:
            raise StateError(f"drive {name} left operation enabled while streaming: {state.value}")
        low, high = sorted((before_mm, now_mm))
        off_mm = max(low - sample.position_load_mm, sample.position_load_mm - high)
        if off_mm > self.settings.following_error_mm:
            raise FollowingErrorError(
                f"drive {name}: {off_mm:.3f} mm from its set-point, allowed are {self.settings.following_error_mm:g} mm"
            )


def _leave(drive: HostPacedDrive) -> None:
    """A drive that cannot be put back is stopped."""
    try:
        drive.end_stream()
    except BaseException as error:
        stop_together([drive], error)
        raise
