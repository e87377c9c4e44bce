"""An axis without an instrument, moved and watched by its drive alone.

Every wait looks at the drive; whatever goes wrong inside, Ctrl-C too, stops the axis (quick stop) before anyone hears of it. On
leaving, an axis that was found disabled is disabled again.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from drivers.drive import Capability, DriveSample, DriveState, ServoDrive
from drivers.errors import DriveFaultError, FollowingErrorError, LimitError, MotionTimeoutError, StateError
from hil.procedures.way_out import completed

SLICE_S = 0.05
"""How often the drive is looked at on long ways."""
STEP_SLICE_S = 0.005
"""The same in a single step."""

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION)


class BareAxis:
    """Use as a context manager around motion; the drive must be open."""

    def __init__(self, drive: ServoDrive) -> None:
        self.drive = drive
        self._was_enabled = False

    def __enter__(self) -> Self:
        self._was_enabled = self.drive.sample().state is DriveState.ENABLED
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with ExitStack() as stack:
            if not self._was_enabled:
                stack.callback(completed, self.drive.disable, raising=kind is None)
            if kind is not None:
                completed(self.drive.quick_stop)

    # -- motion ------------------------------------------------------------------------------------------------------
    def get_ready(self, *, home: bool) -> None:
        """Enable, and home an axis that does not say that it is homed, if asked to."""
        sample = self.drive.sample()
        if sample.state is not DriveState.ENABLED:
            self.drive.enable()
        if not home or sample.homed:
            return
        self.drive.require(Capability.HOMING)
        self.drive.start_homing()
        limits = self.drive.limits
        slowest = limits.max_velocity_mm_s / 100.0
        timeout_s = 30.0 + (limits.travel_max_mm - limits.travel_min_mm) / slowest
        self.watch_until(lambda seen: bool(seen.homed) and seen.target_reached, timeout_s, "homing")

    def move_to(
        self, position_load_mm: float, velocity_mm_s: float, *, slice_s: float = SLICE_S, window_mm: float = 0.1
    ) -> DriveSample:
        """Go there and arrive; the sample of the arrival. Raises LimitError before any motion, FollowingErrorError for an arrival
        elsewhere."""
        way_mm = abs(position_load_mm - self.drive.sample().position_load_mm)
        expected_s = way_mm / velocity_mm_s + velocity_mm_s / self.drive.limits.max_acceleration_mm_s2
        self.drive.start_move(position_load_mm, velocity_mm_s)
        sample = self.watch_until(lambda seen: seen.target_reached, 5.0 + 3.0 * expected_s, "move", slice_s)
        if abs(sample.position_load_mm - position_load_mm) > window_mm:
            raise FollowingErrorError(
                f"drive {self.drive.name} says it arrived, but is at {sample.position_load_mm:.4f} mm,"
                f" expected {position_load_mm:.4f} mm"
            )
        return sample

    def look(self, what: str) -> DriveSample:
        """One sample of an enabled drive. Raises DriveFaultError and StateError."""
        sample = self.drive.sample()
        self.drive.looked_at(sample)
        if sample.state in _FAULTS:
            code = "" if sample.fault_code is None else f" (error code {sample.fault_code:04X}h)"
            raise DriveFaultError(f"drive {self.drive.name} went into {sample.state.value}{code}", sample.fault_code)
        if sample.state is not DriveState.ENABLED:
            raise StateError(f"drive {self.drive.name}: {what} ended by itself, it is {sample.state.value}")
        return sample

    def watch_until(
        self, condition: Callable[[DriveSample], bool], timeout_s: float, what: str, slice_s: float = SLICE_S
    ) -> DriveSample:
        """Look until the condition holds. Raises MotionTimeoutError when it does not in time, and as `look`."""
        deadline = self.drive.clock.deadline(timeout_s)
        while True:
            sample = self.look(what)
            if condition(sample):
                return sample
            if deadline.expired:
                raise MotionTimeoutError(f"drive {self.drive.name}: {what} not over within {timeout_s:.1f} s")
            self.drive.clock.sleep_s(slice_s)

    def rest(self, seconds: float) -> None:
        """Let time pass at rest."""
        if seconds > 0.0:
            self.drive.clock.sleep_s(seconds)


def check_reach(drive: ServoDrive, *positions_load_mm: float) -> None:
    """Raise LimitError for the first position outside the travel, before anything moves."""
    for position in positions_load_mm:
        try:
            drive.limits.check_target(position)
        except LimitError as error:
            raise LimitError(f"nothing was moved: {error}") from error
