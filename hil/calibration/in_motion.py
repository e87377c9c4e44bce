"""Measuring while the axis moves: passes at several feeds, each set-point of a stream corrected in its cycle.

An effect of motion (a lag proportional to velocity) cannot be measured or corrected at rest. A row is one sample of the
instrument on a stretch of constant velocity: its target is the position of the path at the time of the sample. That
time is its arrival less the instrument's latency (on the fly), or that of an edge which drive and instrument share
(triggered).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field

import numpy as np

from drivers.clock import NS_PER_S
from drivers.drive import Capability
from drivers.errors import InputError
from drivers.instrument import Reading
from drivers.set_points import SetPointSettings, SetPointStream
from drivers.touch_probe import Edge, TouchProbe
from hil.figures.latency import DELAY, check_feeds
from hil.machine.events import Event, Listener, silent
from hil.machine.in_motion_settings import InMotion
from hil.machine.measure import BASE_COLUMNS
from hil.machine.sample_times import SampleDating, sample_dating
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import Floats, Records


@dataclass(frozen=True)
class FeedPass:
    """One stretch at one feed in one direction. from_mm, to_mm: the path, with its ramps."""

    run: int
    feed_mm_s: float
    from_mm: float
    to_mm: float

    @property
    def direction(self) -> int:
        """+1 or -1."""
        return 1 if self.to_mm > self.from_mm else -1


def check_passes(session: AxisSession, how: InMotion) -> None:
    """Raises CapabilityError or InputError, before any motion, for passes that this axis cannot make."""
    session.drive.require(Capability.STREAMING, *([] if how.trigger_input is None else [Capability.TOUCH_PROBE]))
    if how.latency_s is None:
        check_feeds(how.feeds_mm_s * how.runs)
    plan_passes(session, how, 0)


def plan_passes(session: AxisSession, how: InMotion, seed: int) -> list[FeedPass]:
    """Feeds in random order in each run, each up and down over a stretch at a random position of the travel.

    Raises InputError for a feed beyond the limits, or whose ramps leave no room for the stretch.
    """
    rng = np.random.default_rng([session.how.seed, seed])
    low, high = min(session.how.targets_mm), max(session.how.targets_mm)
    passes = []
    for run in range(1, how.runs + 1):
        for feed in rng.permutation(how.feeds_mm_s):
            session.drive.limits.check_velocity(float(feed))
            length = how.stretch_mm + float(feed) ** 2 / how.acceleration_mm_s2
            if length > high - low:
                raise InputError(
                    f"a pass at {feed:g} mm/s needs {length:.0f} mm with its ramps, the targets span {high - low:.0f} mm"
                )
            start = round(float(rng.uniform(low, high - length)), 3)
            passes += [
                FeedPass(run, float(feed), start, start + length),
                FeedPass(run, float(feed), start + length, start),
            ]
    return passes


def ramped_path(this: FeedPass, acceleration_mm_s2: float, period_s: float) -> Floats:
    """Targets (mm) and velocities (mm/s) of every period, shape (n, 2): ramp up, constant velocity, ramp down."""
    length, feed = abs(this.to_mm - this.from_mm), this.feed_mm_s
    ramp_s = feed / acceleration_mm_s2
    even_s = length / feed - ramp_s
    times = np.arange(1, math.ceil((2 * ramp_s + even_s) / period_s) + 1) * period_s
    velocity = np.clip(np.minimum(times, 2 * ramp_s + even_s - times) * acceleration_mm_s2, 0.0, feed)
    up = np.minimum(times, ramp_s)
    down = np.clip(times - ramp_s - even_s, 0.0, ramp_s)
    middle = np.clip(times - ramp_s, 0.0, even_s)
    travel = acceleration_mm_s2 * up**2 / 2 + feed * middle + feed * down - acceleration_mm_s2 * down**2 / 2
    return np.column_stack([this.from_mm + this.direction * np.minimum(travel, length), velocity])


@dataclass
class _Trace:
    """The data of one pass: the path in time, the drive's positions, the numbered samples, and latches."""

    times: SampleDating
    session: AxisSession
    edges: LatchReader | None
    reached_ns: list[int] = field(default_factory=list)
    command_mm: list[float] = field(default_factory=list)
    since_reversal_mm: list[float] = field(default_factory=list)
    found: list[tuple[int, float]] = field(default_factory=list)
    samples: list[tuple[int, Reading]] = field(default_factory=list)

    def look(self, stream: SetPointStream) -> None:
        history = self.session.history
        self.reached_ns.append(stream.reached_ns)
        self.command_mm.append(self.session.commanded_mm)
        self.since_reversal_mm.append(math.nan if history is None else history.since_reversal_mm)
        found = stream.found[0]
        if not self.found or found[0] > self.found[-1][0]:  # a late position is reported once
            self.found.append(found)
        self.samples += self.session.readings()
        if self.edges is not None:
            self.edges.look()


def measure_in_motion(
    session: AxisSession,
    campaign: Campaign,
    name: str,
    passes: Sequence[FeedPass],
    *,
    how: InMotion,
    listener: Listener = silent,
) -> Records:
    """Makes the passes with the compensation now in force, on a prepared session; every row is on disk before the next
    pass.

    An interrupted campaign repeats the pass that was incomplete. Raises CapabilityError before any motion where the
    drive takes no set-points in its cycle, InputError for rows of another plan or passes without a row, and what stops
    the axis.
    """
    session.drive.require(Capability.STREAMING)
    edges = None if how.trigger_input is None else LatchReader(session, how.trigger_input)
    beside = sorted(column for column in session.known() if column not in BASE_COLUMNS)
    columns = (*BASE_COLUMNS, *beside, *([] if edges is None else [DELAY]))
    latency_s = how.latency_s or 0.0
    times = sample_dating(session, latency_s)
    with campaign.rows(name, columns) as journal:
        done = _passes_done(journal.records(), passes)
        if not done and (how.dated_by or latency_s):
            journal.note(f"dated by {how.dated_by or f'a latency of {1e3 * latency_s:g} ms'}")
        listener(Event(name, done=done, total=len(passes)))
        for number, this in enumerate(passes[done:], start=done + 1):
            for row in _measure_pass(session, _Trace(times, session, edges), this, how):
                journal.append({**dict.fromkeys(columns, math.nan), **row})
            listener(Event(name, f"{this.feed_mm_s:g} mm/s", number, len(passes)))
        records = journal.records()
    if records is None:
        raise InputError("no row came of these passes: the stretch is shorter than the way between two samples")
    return records


def _passes_done(records: Records | None, passes: Sequence[FeedPass]) -> int:
    """Number of complete passes on disk: those up to the last one with rows."""
    if records is None:
        return 0
    last = (int(records.run[-1]), int(records.direction[-1]), float(records["velocity_mm_s"][-1]))
    keys = [(this.run, this.direction, this.feed_mm_s) for this in passes]
    if last not in keys:
        raise InputError("the passes on disk are not those of this plan; expected the settings it was started with")
    return keys.index(last) + 1


_DatedSample = tuple[float, tuple[int, Reading], dict[str, float]]
"""Time in ns, the sample, and further columns of its row."""


def _measure_pass(session: AxisSession, trace: _Trace, this: FeedPass, how: InMotion) -> Iterator[dict[str, float]]:
    session.approach(this.from_mm - this.direction * session.how.overrun_mm)
    session.move_to(this.from_mm)
    session.watch(session.how.dwell_s)
    path = ramped_path(this, how.acceleration_mm_s2, how.period_s)
    trace.times.find_arrival()
    known = session.known()
    stroke_mm = session.stroke_or_long_mm
    settings = SetPointSettings(how.period_s, following_error_mm=how.lag_mm)
    with nullcontext() if trace.edges is None else trace.edges.armed():
        session.stream_along(((float(x), float(v)) for x, v in path), settings, trace.look)
    session.watch(session.how.dwell_s)
    trace.times.find_arrival()
    for row in _rows(this, path, trace, how):
        yield {**known, **row, "time_s": known["time_s"] + row["time_s"], "stroke_mm": stroke_mm}


def _rows(this: FeedPass, path: Floats, trace: _Trace, how: InMotion) -> Iterator[dict[str, float]]:
    """Samples on the stretch of constant velocity, evenly thinned to `how.rows`."""
    reached = np.array(trace.reached_ns, dtype=np.float64)
    found_ns, found_mm = np.array(trace.found, dtype=np.float64).T
    even = np.flatnonzero(path[:, 1] >= this.feed_mm_s * (1 - 1e-9))
    settled = even[len(even) // 4 :]  # the servo's lag builds up in the first quarter
    first_ns, last_ns = reached[settled[0]], reached[settled[-1]]
    moments: list[_DatedSample]
    if trace.edges is None:
        moments = [(float(trace.times.taken_ns(*sample)), sample, {}) for sample in trace.samples]
    else:
        moments = _at_edges(trace, found_ns, found_mm, (found_ns >= first_ns) & (found_ns <= last_ns))
    inside = [moment for moment in moments if first_ns <= moment[0] <= last_ns]
    for pick in np.unique(np.linspace(0, len(inside) - 1, min(how.rows, len(inside))).round().astype(int)):
        time_ns, (_, reading), more = inside[pick]
        yield {
            "run": float(this.run),
            "direction": float(this.direction),
            "target_mm": float(np.interp(time_ns, reached, path[:, 0])),
            "measured_mm": trace.session.load_position_mm(reading),
            "command_mm": float(np.interp(time_ns, reached, trace.command_mm)),
            "time_s": (time_ns - reached[0]) / 1e9,
            "velocity_mm_s": this.feed_mm_s,
            "since_reversal_mm": float(np.interp(time_ns, reached, trace.since_reversal_mm)),
            "motor_mm": float(np.interp(time_ns, found_ns, found_mm)),
            **more,
        }


def _at_edges(
    trace: _Trace, found_ns: Floats, found_mm: Floats, settled: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> list[_DatedSample]:
    """Time of each edge, the sample that belongs to it, and the delay of its arrival."""
    if trace.edges is None or not trace.samples or not settled.any():
        return []
    measured = np.array([trace.session.load_position_mm(reading) for _, reading in trace.samples])
    edges = pair_triggers(trace.edges.latched_mm, found_ns[settled], found_mm[settled], trace.samples, measured)
    late = [(trace.times.arrived_ns(edge.index, edge.reading) - edge.time_ns) / 1e9 for edge in edges]
    return [(edge.time_ns, (edge.index, edge.reading), {DELAY: s}) for edge, s in zip(edges, late, strict=True)]


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
