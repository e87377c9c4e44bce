"""A week of what an axis tells its screen, compressed: states 20 times a second, events, alarms and restarts.

    python tests/study/panel_week.py                    7 days, about 5 minutes
    python tests/study/panel_week.py --days 0.5

States go through the board (`hil.desk.live`), whose clock is a simulated one, and a reader that looks twice a second
takes the new points of the plots, as a page does. Events go through the log on disk (`hil.desk.event_log`), some
7,000 a day, which is replaced by a new file several times; once a day it is opened anew, as after a restart. Accounted
for: every point is read once and in order, events are numbered without a gap, alarms that nobody acknowledged stand,
memory and files stay bounded.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sin
from pathlib import Path

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from study.endurance import resident_mb

from drivers.drive import DriveState
from hil.desk.event_log import EVENTS, MOST_BYTES, EventLog, LogKind
from hil.desk.live import RATE_HZ, Board, Live

DAY_S = 86_400.0
LOOK_EVERY = 10
"""States between two looks of the reader."""
EVENT_EVERY = 240
"""States between two events: one in 12 s."""
JOBS = ("calibrate", "verify", "backlash", "lost motion")


@dataclass
class Week:
    """What happened. lost: points that no look gave; alarms_lost: alarms that stood before a restart and not after it"""

    points: int = 0
    read: int = 0
    out_of_order: int = 0
    events: int = 0
    gaps: int = 0
    alarms_lost: int = 0
    largest_bytes: int = 0
    largest_standing: int = 0
    memory_mb: list[float] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Whether everything is accounted for; memory is judged apart."""
        bounded = self.largest_bytes <= MOST_BYTES
        return self.points == self.read and not (self.out_of_order or self.gaps or self.alarms_lost) and bounded


def run(days: float, seed: int, folder: Path, *, restart_every_s: float = DAY_S) -> Week:
    """A week, or another number of days, with the log below `folder`. Prints a line at each restart."""
    rng, found = random.Random(seed), Week()
    now_s = [0.0]
    board = Board(monotonic_s=lambda: now_s[0])
    path = folder / EVENTS
    log = EventLog(path, "X")
    read_to = 0
    between = round(restart_every_s * RATE_HZ)
    for state in range(1, round(days * DAY_S * RATE_HZ) + 1):
        now_s[0] = state / RATE_HZ
        place_mm = 250.0 + 240.0 * sin(now_s[0] / 30.0)
        moving = state % 200 < 150
        board.publish(Live(True, "", now_s[0], DriveState.ENABLED, None, True, moving, place_mm, 1.5, 40.0, 12.0))
        if state % LOOK_EVERY == 0:
            points = board.trace(read_to)
            found.read += len(points)
            found.out_of_order += [one.number for one in points] != list(range(read_to + 1, read_to + len(points) + 1))
            read_to = points[-1].number if points else read_to
        if state % EVENT_EVERY == 0:
            _event(rng, log, found)
            found.largest_bytes = max(found.largest_bytes, path.stat().st_size)
        if state % between == 0:
            log = _restarted(log, path, found)
            found.memory_mb.append(resident_mb())
            print(
                f"day {now_s[0] / DAY_S:.2f}: {read_to:,} points, {found.events:,} events, {len(log.alarms())} alarms stand,"
                f" {found.memory_mb[-1]:.1f} MB",
                flush=True,
            )
    found.read += len(board.trace(read_to))
    found.points = board.trace()[-1].number
    return found


def _event(rng: random.Random, log: EventLog, found: Week) -> None:
    before = log.number
    drawn = rng.random()
    if drawn < 0.05:
        log.add(LogKind.ALARM, "job.failed", cause="the drive went into a fault", remedy="fault", job=rng.choice(JOBS))
    elif drawn < 0.10 and log.alarms():
        log.acknowledge(rng.choice(log.alarms()).number, "browser 1")
    else:
        log.add(LogKind.JOB, rng.choice(("job.started", "job.done")), who="browser 1", job=rng.choice(JOBS))
    found.events += 1
    found.gaps += log.number != before + 1
    found.largest_standing = max(found.largest_standing, len(log.alarms()))


def _restarted(log: EventLog, path: Path, found: Week) -> EventLog:
    """The log opened anew from its files."""
    standing, number = {one.number for one in log.alarms()}, log.number
    again = EventLog(path, "X")
    found.gaps += again.number != number
    found.alarms_lost += len(standing - {one.number for one in again.alarms()})
    return again


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--days", type=float, default=7.0)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="hil-week-") as place:
        found = run(args.days, args.seed, Path(place))
    print(found)
    print("everything is accounted for" if found.good else "NOT EVERYTHING IS ACCOUNTED FOR")
    return 0 if found.good else 1


if __name__ == "__main__":
    raise SystemExit(main())
