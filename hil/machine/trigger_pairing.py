"""Edges that drive and instrument both see: the drive latches its position at each, the instrument takes a sample.

Of a pair of such values it does not matter how long either took to get here. Either end may make the edge: an instrument that shows
its samples on an output, or a generator, a cam or an output of the drive on a display's external input.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from drivers.clock import NS_PER_S
from drivers.drive import Capability
from drivers.instrument import Reading
from drivers.touch_probe import Edge, TouchProbe
from hil.machine.session import AxisSession
from hil.records.rows import Floats

FETCHED_EVERY_S = 0.05
"""A latch is asked for between set-points, which takes a drive on a wire a few answers: not in each cycle."""
NEAR = 0.25
"""Of the way between two samples: so near to the latched position is the one that belongs to it, and no other can be."""


@dataclass(frozen=True)
class SharedEdge:
    """time_ns: when the drive was at `motor_mm`; index, reading: the sample that was taken there."""

    time_ns: float
    motor_mm: float
    index: int
    reading: Reading


class EdgeWatch:
    """What the drive latches during a stream, fetched while it runs. Raises CapabilityError for a drive without a touch probe."""

    def __init__(self, session: AxisSession, number: int) -> None:
        session.drive.require(Capability.TOUCH_PROBE)
        self._session = session
        self._number = number
        self._probe: TouchProbe | None = None  # made on a drive that is open, and kept: it knows what was fetched
        self._due_ns = 0
        self.latched_mm: list[float] = []

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Inside the block edges latch."""
        self.latched_mm.clear()
        self._probe = probe = self._probe or self._session.drive.touch_probe()
        probe.arm(self._number, {Edge.POSITIVE}, continuous=True)
        try:
            yield
        finally:
            probe.disarm(self._number)

    def look(self) -> None:
        """After a set-point: fetch what was latched last, now and then."""
        now_ns = self._session.clock.now_ns()
        if self._probe is not None and now_ns >= self._due_ns:
            self._due_ns = now_ns + round(FETCHED_EVERY_S * NS_PER_S)
            self.latched_mm += [latch.position_load_mm for latch in self._probe.poll()]


def shared_edges(
    latched_mm: Sequence[float],
    found_ns: Floats,
    found_mm: Floats,
    samples: Sequence[tuple[int, Reading]],
    measured_mm: Floats,
) -> list[SharedEdge]:
    """The sample of each latch, on a stretch of even motion where the drive was found at `found_mm` at `found_ns`, shapes (n,).

    samples, measured_mm: what arrived during the whole pass and the load's position by it, shape (m,). A latch from outside the
    stretch, or one without a sample near enough, is left out.
    """
    way = 1.0 if found_mm[-1] > found_mm[0] else -1.0
    step_mm = float(np.max(np.abs(np.diff(measured_mm)))) if len(measured_mm) > 1 else 0.0
    edges = []
    for motor_mm in latched_mm:
        if not min(found_mm[0], found_mm[-1]) <= motor_mm <= max(found_mm[0], found_mm[-1]):
            continue
        nearest = int(np.argmin(np.abs(measured_mm - motor_mm)))
        if abs(measured_mm[nearest] - motor_mm) <= NEAR * step_mm:
            time_ns = float(np.interp(way * motor_mm, way * found_mm, found_ns))
            edges.append(SharedEdge(time_ns, motor_mm, *samples[nearest]))
    return edges
