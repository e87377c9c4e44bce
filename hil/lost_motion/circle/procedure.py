"""The circle test: two axes stream one circle together, both instruments measure, and the bumps after the quadrants are
evaluated.

1. Both axes ready, each with its own datum, each supervised while the other moves.
2. To the start from the side opposite to the initial direction, so that both are wound up.
3. The circle, every set-point of both with the correction in force.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from drivers.drive import Capability
from drivers.errors import InputError, LimitError
from drivers.instrument import Reading
from drivers.set_points import SetPointSettings
from hil.correction.compensation import Compensation
from hil.lost_motion.circle.figures import Circle, Trace, trace_of
from hil.machine.cross_axis import check_across
from hil.machine.events import Event, Listener, silent
from hil.machine.sample_times import SampleDating, sample_dating
from hil.machine.session import AxisSession
from hil.records.rows import Floats

RUN_IN_MM = 5.0
"""Length of the run-in before the start: more than the axes need to wind up."""
APPROACH_MM_S = 10.0
_REPORT_EVERY_S = 1.0


@dataclass(frozen=True)
class CircleRun:
    """One driven circle. time_s and position_mm: of the first axis's samples, (n,) and (n, 2); missed: set-points that
    came too late.
    """

    trace: Trace
    time_s: Floats
    position_mm: Floats
    missed: int


def check_axes(axes: Sequence[AxisSession], circle: Circle, period_s: float) -> None:
    """Checks drives and path before any motion. Raises CapabilityError, LimitError, or InputError for a period that is
    too long.
    """
    for axis, centre_mm in zip(axes, circle.centre_mm, strict=True):
        axis.drive.require(Capability.PROFILE_POSITION, Capability.STREAMING)
        reach_mm = circle.radius_mm + RUN_IN_MM
        for place in (centre_mm - reach_mm, centre_mm + reach_mm):
            try:
                axis.drive.limits.check_target(place)
            except LimitError as error:
                raise LimitError(
                    f"the circle of {circle.radius_mm:g} mm around {centre_mm:g} mm, with its run-in: {error}"
                ) from error
        axis.drive.limits.check_velocity(max(circle.feed_mm_s, APPROACH_MM_S))
    if not 0.0 < period_s <= 0.1 * circle.radius_mm / circle.feed_mm_s:
        raise InputError(
            f"a period of {1e3 * period_s:g} ms, expected more than 0 and at most a tenth of radius over feed"
        )


def prepare(axes: Sequence[AxisSession], compensations: Sequence[Compensation | None] = (None, None)) -> None:
    """Waits for both instruments before either axis is enabled; then homes each in turn and takes its datum.

    compensations: to be put into force. Raises ZeroError as `AxisSession.prepare`.
    """
    for axis in axes:
        axis.await_instrument()
    _join(axes)
    for axis, compensation in zip(axes, compensations, strict=True):
        axis.prepare(compensation=compensation)


def _join(axes: Sequence[AxisSession]) -> None:
    """The set-points of each axis carry what the straightness of the others adds to it (`_across_um`)."""
    names = frozenset(axis.drive.name for axis in axes)
    for axis in axes:
        axis.beside_in_stream = names - {axis.drive.name}


def drive_circle(
    axes: Sequence[AxisSession],
    circle: Circle,
    compensations: Sequence[Compensation | None],
    *,
    latency_s: Sequence[float] = (0.0, 0.0),
    stage: str = "circle",
    period_s: float = 0.004,
    listener: Listener = silent,
) -> CircleRun:
    """One circle with these corrections in force, on prepared sessions; afterwards none is in force, also after an
    error.

    latency_s: of each axis's instrument (`hil.figures.latency`). A common latency rotates the measured circle about its
    centre; a difference between them shows as an ellipse, its half-axes apart by feed × difference.
    Raises CapabilityError, LimitError before any motion, and whatever stops an axis: all stop together.
    """
    check_axes(axes, circle, period_s)
    _join(axes)
    try:
        for axis, compensation in zip(axes, compensations, strict=True):
            axis.compensation = compensation
        for axis, compensation in zip(axes, compensations, strict=True):
            for other in axes:
                if compensation is not None and compensation.moves_axis == other.drive.name != axis.drive.name:
                    check_across(compensation.tables, other.command_state.bound)
        _to_the_start(axes, circle)
        dates = [sample_dating(axis, latency) for axis, latency in zip(axes, latency_s, strict=True)]
        return _stream(axes, dates, circle, stage=stage, period_s=period_s, listener=listener)
    finally:
        for axis in axes:
            axis.compensation = None
            axis.beside_in_stream = frozenset()


def _across_um(
    axes: Sequence[AxisSession], targets_mm: Sequence[float], directions: Sequence[int] = (0, 0)
) -> list[float]:
    """What the straightness of the other axes, at their own targets, adds to each axis, µm. directions: as of `across_um`."""
    return [
        sum(
            other.across_um(at_mm, axis.drive.name, came)
            for other, at_mm, came in zip(axes, targets_mm, directions, strict=True)
            if other is not axis
        )
        for axis in axes
    ]


def _to_the_start(axes: Sequence[AxisSession], circle: Circle) -> None:
    starts = circle.at(0.0)
    for axis, start_mm, direction, across_um in zip(
        axes, starts, circle.starting(), _across_um(axes, starts, circle.starting()), strict=True
    ):
        axis.approach(start_mm - direction * RUN_IN_MM)
        axis.move_to(start_mm, APPROACH_MM_S, across_um=across_um)
        axis.watch(axis.how.dwell_s)


def _stream(
    axes: Sequence[AxisSession],
    clocks: Sequence[SampleDating],
    circle: Circle,
    *,
    stage: str,
    period_s: float,
    listener: Listener,
) -> CircleRun:
    samples: list[list[tuple[int, Reading]]] = [[] for _ in axes]
    for times in clocks:
        times.find_arrival()
    seconds = round(circle.duration_s)
    every = max(1, round(_REPORT_EVERY_S / period_s))
    points = [axis.set_points() for axis in axes]
    first, others = axes[0], [axis.drive for axis in axes[1:]]
    with ExitStack() as stack:
        stack.enter_context(first.supervisor.stopping_on_error())
        found = [stack.enter_context(axis.axis.following()) for axis in axes]
        stream = stack.enter_context(first.drive.stream(SetPointSettings(period_s), others))
        for index, (targets, feed) in enumerate(circle.path(period_s)):
            commands = [
                axis.set_point(own, target, feed, across_um=across_um)
                for axis, own, target, across_um in zip(axes, points, targets, _across_um(axes, targets), strict=True)
            ]
            stream.cycle(commands)
            for axis, own, rows, tell, seen in zip(axes, points, samples, found, stream.found, strict=True):
                own.issued()
                axis.command_state.found_at(seen[1])
                tell(*seen, feed)
                rows.extend(axis.readings())
            if index % every == 0:
                listener(Event(stage, done=min(seconds, round(index * period_s)), total=seconds))
        missed = stream.missed_cycles
    listener(Event(stage, done=seconds, total=seconds))
    first.watch(first.how.dwell_s)
    for times in clocks:
        times.find_arrival()
    when, where = zip(*(_dated(*each) for each in zip(axes, clocks, samples, strict=True)), strict=True)
    both = (when[0] >= when[1][0]) & (when[0] <= when[1][-1])
    position = np.column_stack([where[0][both], np.interp(when[0][both], when[1], where[1])])
    trace = trace_of(position[:, 0], position[:, 1], circle)
    return CircleRun(trace, (when[0][both] - when[0][both][0]) / 1e9, position, missed)


def _dated(axis: AxisSession, times: SampleDating, samples: list[tuple[int, Reading]]) -> tuple[Floats, Floats]:
    """Times, ns, and positions, mm, of the samples of one axis."""
    when = np.array([times.taken_ns(number, reading) for number, reading in samples], dtype=np.float64)
    return when, np.array([axis.load_position_mm(reading) for _, reading in samples])
