"""Motion of a measuring campaign as a workshop runs it: a list of moves, most of which end in a captured row.

Every plan is for one axis, mm from its zero. A move that captures "on the fly" goes on in the same direction
afterwards; the plan contains that motion as the next move. Moves without a capture (overruns, exercise between runs)
are part of the plan: reversals and heat need them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

REST, FLY, UNSEEN = "rest", "fly", ""
BACK_OFF_MM = 6.0
"""Distance of the short moves that approach a target from a chosen side."""


@dataclass(frozen=True)
class Axis:
    """One feed axis: travel from 0, pitch of its screw, feeds it is run at (mm/s), overrun beyond the outer targets."""

    travel_mm: float
    screw_pitch_mm: float
    feeds_mm_s: tuple[float, ...]
    overrun_mm: float
    acceleration_mm_s2: float


@dataclass(frozen=True)
class Setting:
    """What is set during a part of a campaign: load on the table and places of two other axes."""

    load_kg: float
    y_mm: float
    z_mm: float


@dataclass(frozen=True)
class Move:
    """One move: end, feed, what is captured there, dwell before the capture, pause after it."""

    to_mm: float
    feed_mm_s: float
    capture: str
    run: int
    setting: Setting
    dwell_s: float = 1.0
    pause_s: float = 0.0


@dataclass(frozen=True)
class Variation:
    """What a campaign varies: with one load, one feed or one cross position some causes cannot show."""

    loads: bool
    cross: bool
    slow: bool  # dwell and pauses are long: the campaign takes hours


def draw_axis(rng: Generator) -> Axis:
    """An axis of a small or a large machine."""
    return Axis(
        travel_mm=float(rng.choice([250.0, 400.0, 600.0, 1000.0, 1600.0])),
        screw_pitch_mm=float(rng.choice([5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0])),
        feeds_mm_s=tuple(
            sorted(rng.choice([10.0, 25.0, 40.0, 75.0, 110.0, 160.0, 220.0], size=4, replace=False).tolist())
        ),
        overrun_mm=float(rng.uniform(1.0, 12.0)),
        acceleration_mm_s2=float(rng.uniform(300.0, 3000.0)),
    )


def targets(rng: Generator, axis: Axis, count: int) -> list[float]:
    """Targets spread over the travel with a random offset each, as ISO 230-2 asks for."""
    first, last = 0.03 * axis.travel_mm, 0.97 * axis.travel_mm
    spacing = (last - first) / (count - 1)
    places = first + spacing * (np.arange(count) + rng.uniform(-0.35, 0.35, count))
    return [round(float(place), 4) for place in np.clip(places, 0.01 * axis.travel_mm, 0.99 * axis.travel_mm)]


class _Plan:
    """Collects moves; settings change between runs or between pairs of runs."""

    def __init__(self, rng: Generator, axis: Axis, variation: Variation) -> None:
        self.rng, self.axis, self.variation = rng, axis, variation
        self.moves: list[Move] = []
        self.run = 0
        self.setting = Setting(
            float(rng.choice([0.0, 50.0])), float(rng.uniform(-100, 100)), float(rng.uniform(0, 200))
        )
        self.loads = sorted(float(load) for load in rng.choice(np.arange(0.0, 501.0, 25.0), size=4, replace=False))

    def new_run(self, keep: bool = False) -> None:
        self.run += 1
        rng = self.rng
        if not keep:
            load, y, z = self.setting.load_kg, self.setting.y_mm, self.setting.z_mm
            if self.variation.loads:
                load = float(rng.choice(self.loads))
            if self.variation.cross:
                y, z = float(np.round(rng.uniform(-250, 250), 2)), float(np.round(rng.uniform(0, 400), 2))
            self.setting = Setting(load, y, z)
        pause = float(rng.uniform(60, 600)) if self.variation.slow else float(rng.uniform(5, 60))
        if self.moves:
            self.moves[-1] = replace(self.moves[-1], pause_s=pause)

    def exercise(self, strokes: int) -> None:
        feed = self.axis.feeds_mm_s[-1]
        for _ in range(strokes):
            self.go(0.99 * self.axis.travel_mm, feed)
            self.go(0.01 * self.axis.travel_mm, feed)

    def go(self, to_mm: float, feed: float, capture: str = UNSEEN) -> None:
        dwell = float(self.rng.uniform(1.0, 4.0)) * (2.0 if self.variation.slow else 1.0)
        self.moves.append(
            Move(round(to_mm, 5), feed, capture, self.run, self.setting, dwell if capture == REST else 0.0)
        )

    def cross_again(self) -> None:
        """Other axes move between two rows."""
        if self.variation.cross:
            y, z = float(np.round(self.rng.uniform(-250, 250), 2)), float(np.round(self.rng.uniform(0, 400), 2))
            self.setting = Setting(self.setting.load_kg, y, z)

    def up_and_down(self, places: Sequence[float], feed: float, capture: str = REST) -> None:
        self.go(max(min(places) - self.axis.overrun_mm, -self.axis.overrun_mm), feed)
        for place in places:
            self.go(place, feed, capture)
        self.go(max(places) + self.axis.overrun_mm, feed)
        for place in reversed(places):
            self.go(place, feed, capture)
        self.go(min(places) - self.axis.overrun_mm, feed)

    def pairs(self, pairs: int, count: int) -> None:
        """ISO 230-2 runs, two at a time with the same targets and conditions."""
        same = targets(self.rng, self.axis, count) if self.rng.random() < 0.5 else None
        for _ in range(pairs):
            places = same or targets(self.rng, self.axis, count)
            self.new_run()
            self.up_and_down(places, self.axis.feeds_mm_s[1])
            self.new_run(keep=True)
            self.up_and_down(places, self.axis.feeds_mm_s[1])

    def random_order(self, runs: int, count: int, rows: int, moving: float) -> None:
        """Targets in random order; some rows on the fly, some captured again after a short move back."""
        for _ in range(runs):
            self.new_run()
            places = targets(self.rng, self.axis, count)
            here = -1
            for _ in range(rows):
                if self.rng.random() < 0.3:
                    self.cross_again()
                if here >= 0 and self.rng.random() < 0.22:
                    side = 1.0 if self.moves[-1].to_mm > self.moves[-2].to_mm else -1.0
                    side = side if self.rng.random() < 0.5 else -side
                else:
                    here, side = int((here + 1 + self.rng.integers(count - 1)) % count), 0.0
                feed = float(self.rng.choice(self.axis.feeds_mm_s))
                if side and abs(self.moves[-1].to_mm - places[here]) < BACK_OFF_MM:
                    self.go(places[here] - side * BACK_OFF_MM, feed)
                fly = self.rng.random() < moving
                self.go(places[here], feed, FLY if fly else REST)
                if fly:
                    ahead = 1.0 if self.moves[-1].to_mm >= self.moves[-2].to_mm else -1.0
                    self.go(places[here] + ahead * float(self.rng.uniform(4.0, 10.0)), feed)

    def stairs(self, runs: int, count: int, rows: int) -> None:
        """Up and down in steps, with turning points anywhere, and pilgrim's steps: two forward, one back."""
        for _ in range(runs):
            self.new_run()
            places = targets(self.rng, self.axis, count)
            feed = float(self.rng.choice(self.axis.feeds_mm_s[:3]))
            index, ahead, made = 0, 1, 0
            pilgrim = self.rng.random() < 0.4
            self.go(-self.axis.overrun_mm, feed)
            while made < rows:
                turn = int(self.rng.integers(index + 2, count + 2)) if ahead > 0 else int(self.rng.integers(-1, index))
                while index != min(max(turn, 0), count - 1) and made < rows:
                    self.go(places[index], feed, REST)
                    made += 1
                    if pilgrim and self.rng.random() < 0.3 and 0 < index < count - 1:
                        back = places[index] - ahead * float(self.rng.uniform(0.3, 3.0)) * BACK_OFF_MM
                        self.go(back, feed, REST)
                        self.go(places[index], feed, REST)
                        made += 2
                    index += ahead
                beyond = 1.0 if ahead > 0 else -1.0
                self.go(places[index] + beyond * self.axis.overrun_mm, feed)
                ahead = -ahead

    def passes(self, passes: int, count: int) -> None:
        """Whole strokes with rows on the fly, at several feeds."""
        for _ in range(passes):
            self.new_run()
            places = targets(self.rng, self.axis, count)
            self.up_and_down(places, float(self.rng.choice(self.axis.feeds_mm_s)), FLY)


def _iso_pairs(plan: _Plan) -> None:
    plan.pairs(int(plan.rng.integers(3, 6)), int(plan.rng.integers(15, 22)))


def _warm_up(plan: _Plan) -> None:
    places = targets(plan.rng, plan.axis, int(plan.rng.integers(13, 20)))
    for _ in range(int(plan.rng.integers(8, 12))):
        plan.new_run(keep=not plan.variation.loads and not plan.variation.cross)
        plan.exercise(int(plan.rng.integers(2, 8)))
        plan.up_and_down(places, plan.axis.feeds_mm_s[-1])


def _random_moves(plan: _Plan) -> None:
    plan.random_order(
        int(plan.rng.integers(5, 8)), 24, int(plan.rng.integers(45, 65)), float(plan.rng.uniform(0.2, 0.5))
    )


def _mixed(plan: _Plan) -> None:
    plan.pairs(2, int(plan.rng.integers(15, 21)))
    plan.random_order(
        int(plan.rng.integers(3, 5)), 24, int(plan.rng.integers(45, 65)), float(plan.rng.uniform(0.2, 0.5))
    )


def _stairs(plan: _Plan) -> None:
    plan.stairs(int(plan.rng.integers(5, 8)), int(plan.rng.integers(16, 24)), int(plan.rng.integers(45, 60)))


def _feeds(plan: _Plan) -> None:
    plan.pairs(1, int(plan.rng.integers(15, 21)))
    plan.passes(int(plan.rng.integers(6, 9)), int(plan.rng.integers(16, 22)))


KINDS: dict[str, Callable[[_Plan], None]] = {
    "iso_pairs": _iso_pairs,
    "warm_up": _warm_up,
    "random_moves": _random_moves,
    "mixed": _mixed,
    "stairs": _stairs,
    "feeds": _feeds,
}


def plan(rng: Generator, axis: Axis, kind: str, variation: Variation) -> list[Move]:
    """The moves of one campaign of a kind named in `KINDS`. Raises KeyError for another."""
    made = _Plan(rng, axis, variation)
    made.go(-axis.overrun_mm, axis.feeds_mm_s[0])
    KINDS[kind](made)
    return made.moves
