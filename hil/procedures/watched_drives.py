"""Several drives of one machine, worked together and watched without a gap.

Entering opens them all; leaving stops them after an error and puts each back as it was found: disabled unless it was enabled.
What else has to be looked at while one of them moves is the business of whoever derives from this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from types import TracebackType
from typing import Self

from drivers.clock import NS_PER_S, Clock
from drivers.drive import DriveSample, DriveState, ServoDrive
from drivers.errors import (
    DriveFaultError,
    FollowingErrorError,
    LimitError,
    LinkLostError,
    LocalError,
    MotionTimeoutError,
    StateError,
)
from hil.procedures.way_out import completed

POLL_S = 0.005
STALE_S = 0.5

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION)

Look = Callable[[DriveSample], None]
"""What else is looked at with every sample of the axis that moves; raises to stop the machine."""


class WatchedDrives:
    """drives: by what the machine calls its axes."""

    def __init__(self, drives: Mapping[str, ServoDrive]) -> None:
        self.drives = dict(drives)
        self._was_enabled: dict[str, bool] = {}
        self._stopped_for: BaseException | None = None

    @property
    def clock(self) -> Clock:
        return next(iter(self.drives.values())).clock

    # -- coming and going --------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        with ExitStack() as opened:
            for name, drive in self.drives.items():
                drive.open()
                opened.callback(drive.close)
                self._was_enabled[name] = drive.sample().state is DriveState.ENABLED
            self.check()
            opened.pop_all()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with ExitStack() as stack:  # each of these is done whatever becomes of the others
            for name, drive in self.drives.items():
                stack.callback(drive.close)
                if not self._was_enabled[name]:
                    stack.callback(completed, drive.disable, raising=exc_type is None)
            stack.callback(self.put_back, raising=exc_type is None)
            if exc_type is not None:
                stack.callback(self.stop)
            self._stopped_for = None

    def check(self) -> None:
        """Called once everything is open and nothing has been enabled; raises for what the machine cannot do."""

    def put_back(self, *, raising: bool) -> None:
        """Called on leaving, before drives are disabled."""

    def stop(self) -> None:
        """Quick stop of every drive that can be reached."""
        with ExitStack() as stack:  # each of them whatever becomes of the others
            for drive in reversed(self.drives.values()):
                stack.callback(completed, drive.quick_stop)

    @contextmanager
    def stopping_on_error(self) -> Iterator[None]:
        """Whatever goes wrong inside, an interrupt from the keyboard too, stops the machine before anyone hears of it."""
        try:
            yield
        except BaseException as error:
            if error is not self._stopped_for:
                self._stopped_for = error
                self.stop()
            raise

    # -- looking -----------------------------------------------------------------------------------------------------
    def enable(self) -> None:
        """Power on, where it is not."""
        for drive in self.drives.values():
            if drive.sample().state is not DriveState.ENABLED:
                drive.enable()

    def place(self, name: str) -> float:
        """Where an axis is, in the unit of its axis file."""
        return self.drives[name].sample().position_load_mm

    def watch(
        self, name: str, done: Callable[[DriveSample], bool], timeout_s: float, what: str, look: Look
    ) -> DriveSample:
        """Watch an axis until it is done. MotionTimeoutError, with the machine stopped, when it is not in time."""
        drive, deadline = self.drives[name], self.clock.deadline(timeout_s)
        with self.stopping_on_error():
            while True:
                sample = drive.sample()
                age_s = sample.age_ns(self.clock.now_ns()) / NS_PER_S
                if age_s > STALE_S:
                    raise LinkLostError(f"drive {drive.name}: no sample for {age_s:.2f} s")
                if sample.state in _FAULTS:
                    code = "" if sample.fault_code is None else f", error code {sample.fault_code:04X}h"
                    raise DriveFaultError(
                        f"drive {drive.name} went into a fault during {what}{code}", sample.fault_code
                    )
                if sample.state is not DriveState.ENABLED:
                    raise StateError(f"drive {drive.name}: {what} ended by itself, it is {sample.state.value}")
                drive.looked_at(sample)
                look(sample)
                if done(sample):
                    return sample
                if deadline.expired:
                    raise MotionTimeoutError(f"drive {drive.name}: {what} not over within {timeout_s:.1f} s")
                self.clock.sleep_s(POLL_S)

    # -- moving ------------------------------------------------------------------------------------------------------
    def start(self, order: Callable[[], None]) -> None:
        """Start a motion; after any error but a refusal it may be under way, and is stopped."""
        try:
            order()
        except (LimitError, LocalError):
            raise  # refused: nothing moved
        except BaseException as error:
            self._stopped_for = error
            self.stop()
            raise

    def longest_s(self, name: str, target: float, speed: float) -> float:
        """How long a move from here may take at most."""
        drive = self.drives[name]
        way = abs(target - drive.sample().position_load_mm)
        return 5.0 + 3.0 * (way / speed + speed / drive.limits.max_acceleration_mm_s2)

    def go(self, name: str, target: float, speed: float, look: Look, *, within: float) -> None:
        """Move an axis and see it arrive; within: what it may be off when it says that it is there."""
        drive = self.drives[name]
        what = f"the move of {drive.name} to {target:.4f}"
        longest_s = self.longest_s(name, target, speed)
        self.start(lambda: drive.start_move(target, speed))
        sample = self.watch(name, lambda sample: sample.target_reached, longest_s, what, look)
        if abs(sample.position_load_mm - target) > within:
            with self.stopping_on_error():
                raise FollowingErrorError(f"drive says {what} is over, but it is at {sample.position_load_mm:.4f}")
