"""Measuring while the axis moves: passes at several feeds, each set-point of a stream corrected in its cycle.

What only shows in motion (a lag in proportion to velocity) no campaign at rest can see, and no correction at rest can mend. A row is
one sample of the instrument on a stretch of constant velocity: its target is where the path is at that moment.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.drive import Capability
from drivers.errors import InputError
from drivers.instrument import Reading
from drivers.set_points import SetPointSettings, SetPointStream
from hil.journal import Campaign
from hil.procedures.events import Event, Listener, silent
from hil.procedures.measure import BASE_COLUMNS
from hil.procedures.sample_times import SampleTimes
from hil.procedures.session import AxisSession
from hil.records import Floats, Records


@dataclass(frozen=True)
class InMotion:
    """How passes are made.

    feeds_mm_s: at each, up and down in every run; stretch_mm: of constant velocity; rows: kept of each pass, evenly;
    latency_s: of the instrument, see `SampleTimes`; lag_mm: how far the axis may be behind its set-point
    """

    feeds_mm_s: tuple[float, ...]
    runs: int = 4
    rows: int = 10
    stretch_mm: float = 80.0
    acceleration_mm_s2: float = 400.0
    period_s: float = 0.002
    latency_s: float = 0.0
    lag_mm: float = 2.0


@dataclass(frozen=True)
class Pass:
    """One stretch at one feed in one direction. from_mm, to_mm: the path, with its ramps."""

    run: int
    feed_mm_s: float
    from_mm: float
    to_mm: float

    @property
    def direction(self) -> int:
        return 1 if self.to_mm > self.from_mm else -1


def check_passes(session: AxisSession, how: InMotion) -> None:
    """Raises CapabilityError or InputError, before anything moves, for passes that this axis cannot make."""
    session.drive.require(Capability.STREAMING)
    plan_passes(session, how, 0)


def plan_passes(session: AxisSession, how: InMotion, seed: int) -> list[Pass]:
    """Feeds in random order in each run, each up and down over a stretch at a random place of the travel.

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
                Pass(run, float(feed), start, start + length),
                Pass(run, float(feed), start + length, start),
            ]
    return passes


def ramped_path(this: Pass, acceleration_mm_s2: float, period_s: float) -> Floats:
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
    """What a pass leaves behind: the path in time, and the numbered samples."""

    times: SampleTimes
    session: AxisSession
    reached_ns: list[int]
    command_mm: list[float]
    since_reversal_mm: list[float]
    samples: list[tuple[int, Reading]]

    def look(self, stream: SetPointStream) -> None:
        history = self.session.history
        self.reached_ns.append(stream.reached_ns)
        self.command_mm.append(self.session.commanded_mm)
        self.since_reversal_mm.append(math.nan if history is None else history.since_reversal_mm)
        self.samples += self.session.readings()


def measure_in_motion(
    session: AxisSession,
    campaign: Campaign,
    name: str,
    passes: Sequence[Pass],
    *,
    how: InMotion,
    listener: Listener = silent,
) -> Records:
    """Make the passes with the compensation now in force, on a prepared session; every row is on disk before the next pass.

    A campaign that was interrupted makes its passes again: there is no half of a pass. Raises CapabilityError before anything moves
    where the drive takes no set-points in its cycle.
    """
    session.drive.require(Capability.STREAMING)
    columns = (*BASE_COLUMNS, *sorted(column for column in session.known() if column not in BASE_COLUMNS))
    times = SampleTimes(session, how.latency_s)
    with campaign.rows(name, columns) as journal:
        done = _passes_done(journal.records(), passes)
        listener(Event(name, done=done, total=len(passes)))
        for number, this in enumerate(passes[done:], start=done + 1):
            for row in _measure_pass(session, times, this, how):
                journal.append({**dict.fromkeys(columns, math.nan), **row})
            listener(Event(name, f"{this.feed_mm_s:g} mm/s", number, len(passes)))
        records = journal.records()
    if records is None:
        raise InputError("no row came of these passes: the stretch is shorter than the way between two samples")
    return records


def _passes_done(records: Records | None, passes: Sequence[Pass]) -> int:
    """Whole passes that are on disk already: those before the last one of which there are rows."""
    if records is None:
        return 0
    last = (int(records.run[-1]), int(records.direction[-1]), float(records["velocity_mm_s"][-1]))
    keys = [(this.run, this.direction, this.feed_mm_s) for this in passes]
    if last not in keys:
        raise InputError("the passes on disk are not those of this plan; expected the settings it was started with")
    return keys.index(last) + 1


def _measure_pass(session: AxisSession, times: SampleTimes, this: Pass, how: InMotion) -> Iterator[dict[str, float]]:
    session.approach(this.from_mm - this.direction * session.how.overrun_mm)
    session.move_to(this.from_mm)
    session.watch(session.how.dwell_s)
    path = ramped_path(this, how.acceleration_mm_s2, how.period_s)
    trace = _Trace(times, session, [], [], [], [])
    times.find_arrival()
    known = session.known()
    stroke_mm = session.stroke_or_long_mm
    settings = SetPointSettings(how.period_s, following_error_mm=how.lag_mm)
    session.stream_along(((float(x), float(v)) for x, v in path), settings, trace.look)
    session.watch(session.how.dwell_s)
    times.find_arrival()
    for row in _rows(this, path, trace, how.rows):
        yield {**known, **row, "time_s": known["time_s"] + row["time_s"], "stroke_mm": stroke_mm}


def _rows(this: Pass, path: Floats, trace: _Trace, wanted: int) -> Iterator[dict[str, float]]:
    """Samples on the stretch of constant velocity, some evenly spread ones of them."""
    reached = np.array(trace.reached_ns, dtype=np.float64)
    even = np.flatnonzero(path[:, 1] >= this.feed_mm_s * (1 - 1e-9))
    settled = even[len(even) // 4 :]  # the first quarter is left for the servo's lag to build up
    first_ns, last_ns = reached[settled[0]], reached[settled[-1]]
    dated = [(trace.times.taken_ns(index), reading) for index, reading in trace.samples]
    inside = [(time_ns, reading) for time_ns, reading in dated if first_ns <= time_ns <= last_ns]
    for pick in np.unique(np.linspace(0, len(inside) - 1, min(wanted, len(inside))).round().astype(int)):
        time_ns, reading = inside[pick]
        yield {
            "run": float(this.run),
            "direction": float(this.direction),
            "target_mm": float(np.interp(time_ns, reached, path[:, 0])),
            "measured_mm": trace.session.load_position_mm(reading),
            "command_mm": float(np.interp(time_ns, reached, trace.command_mm)),
            "time_s": (time_ns - reached[0]) / 1e9,
            "velocity_mm_s": this.feed_mm_s,
            "since_reversal_mm": float(np.interp(time_ns, reached, trace.since_reversal_mm)),
        }
