"""Trigger pairing: at a common edge the drive latches its position and the instrument takes a sample.

The transmission times of the two values do not matter. The source of the edge may be an instrument that shows its samples on an
output, or a generator, a cam or an output of the drive at a display's external input.
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
"""Interval between two requests for a latch, s. Each takes a few answers of the drive, so it is not made in each cycle."""
NEAR = 0.25
"""Share of the distance between two samples within which a sample belongs to a latch: below 0.5, so that no other can."""


@dataclass(frozen=True)
class TriggerPair:
    """A latch and its sample. time_ns: when the drive was at `motor_mm`; index, reading: the sample taken there."""

    time_ns: float
    motor_mm: float
    index: int
    reading: Reading


class LatchReader:
    """Reads the drive's latches during a stream. number: of the touch probe. Raises CapabilityError for a drive without one."""

    def __init__(self, session: AxisSession, number: int) -> None:
        session.drive.require(Capability.TOUCH_PROBE)
        self._session = session
        self._number = number
        self._probe: TouchProbe | None = None  # made once the drive is open, and kept: it holds which latches were read
        self._due_ns = 0
        self.latched_mm: list[float] = []

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Arm the touch probe inside the block."""
        self.latched_mm.clear()
        self._probe = probe = self._probe or self._session.drive.touch_probe()
        probe.arm(self._number, {Edge.POSITIVE}, continuous=True)
        try:
            yield
        finally:
            probe.disarm(self._number)

    def look(self) -> None:
        """Call after each set-point: every `FETCHED_EVERY_S` it reads the last latch into `latched_mm`."""
        now_ns = self._session.clock.now_ns()
        if self._probe is not None and now_ns >= self._due_ns:
            self._due_ns = now_ns + round(FETCHED_EVERY_S * NS_PER_S)
            self.latched_mm += [latch.position_load_mm for latch in self._probe.poll()]


def pair_triggers(
    latched_mm: Sequence[float],
    found_ns: Floats,
    found_mm: Floats,
    samples: Sequence[tuple[int, Reading]],
    measured_mm: Floats,
) -> list[TriggerPair]:
    """The sample of each latch during a motion at constant velocity.

    latched_mm: positions latched by the drive, mm; found_ns, found_mm: times and motor positions of that motion, shapes (n,)
    samples, measured_mm: samples of the whole pass and the load positions by them, mm, shapes (m,)
    A latch outside the motion, or without a sample near enough (`NEAR`), is left out.
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
            edges.append(TriggerPair(time_ns, motor_mm, *samples[nearest]))
    return edges
