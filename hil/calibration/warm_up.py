"""Warming an axis up by moving it, as production would, and letting it rest: what a cold calibration has not seen."""

from __future__ import annotations

from hil.machine.events import Event, Listener, silent
from hil.machine.session import AxisSession


def warm_up(
    session: AxisSession,
    duration_s: float,
    velocity_mm_s: float | None = None,
    listener: Listener = silent,
    *,
    stage: str = "warm-up",
) -> None:
    """Run full strokes between the outermost targets for a duration, watched like any other motion.

    velocity_mm_s: default half the axis's limit
    """
    velocity = session.drive.limits.max_velocity_mm_s / 2 if velocity_mm_s is None else velocity_mm_s
    low, high = min(session.how.targets_mm), max(session.how.targets_mm)
    start_ns = session.clock.now_ns()
    total = max(1, round(duration_s))
    listener(Event(stage, f"strokes {low:g} to {high:g} mm at {velocity:g} mm/s", 0, total))
    while (elapsed_s := (session.clock.now_ns() - start_ns) / 1e9) < duration_s:
        session.move_to(high, velocity)
        session.move_to(low, velocity)
        listener(Event(stage, done=min(total, round(elapsed_s)), total=total))
    listener(Event(stage, done=total, total=total))


def rest(session: AxisSession, duration_s: float, listener: Listener = silent, *, stage: str = "rest") -> None:
    """Stand still, enabled and watched."""
    total = max(1, round(duration_s))
    listener(Event(stage, done=0, total=total))
    session.watch(duration_s)
    listener(Event(stage, done=total, total=total))
