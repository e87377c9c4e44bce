"""PacedStream: a stream of set-points that the host paces by its clock, for wires without a SYNC.

Holds the supervision that such a wire needs: missed cycles, steps that are too long, state, following error. A backend
implements how a set-point reaches the drive.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
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
from drivers.set_points import SetPointGroup, SetPointSettings, SetPointStream
from drivers.shutdown import stop_together
from drivers.undo import undo_all


class PacedStream(SetPointStream):
    """A stream paced by the host's clock; a backend implements `_begin`, `_send` and `_end`."""

    def __init__(self, drive: ServoDrive, settings: SetPointSettings) -> None:
        self.drive = drive
        self.settings = settings
        self._missed = 0
        self._missed_in_a_row = 0
        self._period_ns = round(settings.period_s * NS_PER_S)
        self._due_ns = 0  # time of the next set-point
        self._found = 0, math.nan
        self._begun = False
        self._last_mm = self._before_mm = 0.0
        self.running = False
        """Entered, and neither left nor stopped."""

    @property
    def reached_ns(self) -> int:
        return self._due_ns

    @property
    def found(self) -> tuple[int, float]:
        return self._found

    @property
    def missed_cycles(self) -> int:
        return self._missed

    def __enter__(self) -> Self:
        self._last_mm = self._begin().position_load_mm
        self._begun, self.running = False, True
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if exc is not None:
            stop_all([self], exc)
        else:
            self.end()

    def end(self) -> None:
        """Leave without an error. A stopped axis stays stopped; one that cannot be put back is stopped."""
        running, self.running = self.running, False
        if not running:
            return
        try:
            self._end()
        except BaseException as error:
            self.running = True
            stop_all([self], error)
            raise

    def cycle(self, position_load_mm: float) -> float:
        try:
            self.check(position_load_mm)
            self.give(position_load_mm)
            return self.settle()
        except BaseException as error:
            stop_all([self], error)
            raise

    def give(self, position_load_mm: float) -> None:
        """First half of a cycle: send a set-point (load mm) that `check` has accepted. Raises as `SetPointStream.cycle`."""
        self._account_for_lateness()
        self._send(position_load_mm)
        self._before_mm, self._last_mm = self._last_mm, position_load_mm

    def settle(self) -> float:
        """Second half of a cycle: check the following error, wait until the set-point's time; the axis's position, load mm."""
        sample = self.drive.sample()
        self._found = sample.time_ns, sample.position_load_mm
        self._judge(sample, self._before_mm, self._last_mm)
        self.drive.clock.sleep_until_ns(self._due_ns)
        return sample.position_load_mm

    def check(self, position_load_mm: float) -> None:
        """Raise StateError unless the stream runs, LimitError for a position outside the travel (mm) or a step that is too long."""
        if not self.running:
            raise StateError("the stream is not running")
        limits, period_s = self.drive.limits, self.settings.period_s
        limits.check_target(position_load_mm)
        step_mm = abs(position_load_mm - self._last_mm)
        if step_mm > limits.max_velocity_mm_s * period_s + self.drive.scaling.resolution_load_mm:
            raise LimitError(
                f"drive {self.drive.name}: step of {step_mm:.6f} mm in one cycle is {step_mm / period_s:g} mm/s,"
                f" allowed are {limits.max_velocity_mm_s:g} mm/s"
            )

    def _account_for_lateness(self) -> None:
        """Advance the time of the next set-point; whole periods that lie behind count as missed cycles."""
        now_ns = self.drive.clock.now_ns()
        if not self._begun:
            self._begun, self._due_ns = True, now_ns  # the first set-point is the zero of time
        missed = max(0, now_ns - self._due_ns) // self._period_ns
        self._due_ns += (missed + 1) * self._period_ns
        self._missed += missed
        self._missed_in_a_row = self._missed_in_a_row + missed if missed else 0
        if self._missed_in_a_row > self.settings.missed_limit:
            raise SafetyError(
                f"stream: {self._missed_in_a_row} cycles of {1e3 * self.settings.period_s:g} ms missed in a row, the host is late"
            )

    def _judge(self, sample: DriveSample, before_mm: float, now_mm: float) -> None:
        state, name = sample.state, self.drive.name
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

    @abstractmethod
    def _begin(self) -> DriveSample:
        """Bring the enabled drive into its streaming mode without moving it; its sample. Raises StateError unless enabled."""

    @abstractmethod
    def _send(self, position_load_mm: float) -> None: ...

    @abstractmethod
    def _end(self) -> None:
        """Hold the axis where it is, and return to the mode for profile moves."""


def stop_all(streams: Sequence[PacedStream], error: BaseException) -> None:
    """Stop the axes whose streams run, see `stop_together`."""
    running = [stream for stream in streams if stream.running]
    for stream in running:
        stream.running = False
    stop_together([stream.drive for stream in running], error)


class PacedGroup(SetPointGroup):
    """Several axes paced by the host's clock: all set-points of a cycle are checked before the first is sent."""

    def __init__(self, drives: Sequence[ServoDrive], settings: SetPointSettings) -> None:
        """Raises CapabilityError for a drive that is not paced by the host's clock."""
        self._streams: list[PacedStream] = []
        for drive in drives:
            stream = drive.stream(settings)
            if not isinstance(stream, PacedStream):
                raise CapabilityError(f"drive {drive.name} cannot stream together with {drives[0].name}")
            self._streams.append(stream)

    @property
    def missed_cycles(self) -> int:
        return max(stream.missed_cycles for stream in self._streams)

    @property
    def reached_ns(self) -> int:
        return self._streams[0].reached_ns

    @property
    def found(self) -> list[tuple[int, float]]:
        return [stream.found for stream in self._streams]

    def __enter__(self) -> Self:
        try:
            for stream in self._streams:
                stream.__enter__()
        except BaseException as error:
            stop_all(self._streams, error)
            raise
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if exc is not None:
            stop_all(self._streams, exc)
        else:
            undo_all([("", stream.end) for stream in self._streams])

    def cycle(self, positions_load_mm: Sequence[float]) -> list[float]:
        """As `SetPointGroup.cycle`, load mm; raises InputError for another number of set-points."""
        if len(positions_load_mm) != len(self._streams):
            raise InputError(f"{len(positions_load_mm)} set-points for {len(self._streams)} axes")
        pairs = list(zip(self._streams, positions_load_mm, strict=True))
        try:
            for stream, position in pairs:
                stream.check(position)
            for stream, position in pairs:
                stream.give(position)
            return [stream.settle() for stream in self._streams]
        except BaseException as error:
            stop_all(self._streams, error)
            raise
