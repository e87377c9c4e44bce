"""The list of measurements that an axis could make next: rows, order, preparation, and minutes of a person. Nothing is
weighed here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.next.planned_run import Means, PlannedPoint, PlannedRun, motion_columns
from hil.records.rows import Floats

THERMOMETER = "temp_screw_c"
AIR = ("air_temp_c", "air_pressure_hpa", "air_humidity_percent")
MOUNT_MIN, CHANGE_MIN, REALIGN_MIN, CROSS_MIN = 15.0, 5.0, 20.0, 2.0
"""Waiting times for a person, min: to mount sensors, change a load, move or realign the optics, move another axis."""
START_MIN = 4.0
"""Minutes before a run: homing, datum, preparation."""
ABBE_STEP_MM = 150.0
WARM_S = REST_S = 300.0
LONGEST_PITCH_MM = 20.0
STEPS_PER_PERIOD = 11.3
USUAL_SPAN_MM, DIGITS = 10.0, 3
"""Targets are whole µm on a travel of at least that many mm, and finer in proportion on a shorter one."""


def feasible_runs(means: Means, *, first_run: int = 1, seed: int = 0) -> tuple[PlannedRun, ...]:
    """Every measurement that this axis could make next, its runs numbered from `first_run`; none where it stands at one place."""
    if means.span_mm <= 0.0:
        return ()
    maker = _Maker(means, np.random.default_rng([seed, 17]), first_run)
    runs = [maker.repeat(), maker.shifted(), maker.fine(), maker.dense(), maker.reversals(), maker.returns()]
    runs.append(maker.warm_and_cool())
    if means.feeds_mm_s:
        runs.append(maker.feeds())
    runs += [maker.levels(column, values) for column, values in means.levels.items() if len(values) > 1]
    runs += maker.logged()
    runs += maker.other_optics()
    return tuple(runs)


class _Maker:
    """Builds the runs of one list."""

    def __init__(self, means: Means, rng: np.random.Generator, first_run: int) -> None:
        self.means, self.rng, self.first_run = means, rng, first_run
        self.digits = DIGITS + max(0, math.ceil(math.log10(USUAL_SPAN_MM / means.span_mm)))

    # -- parts of runs -----------------------------------------------------------------------------------------------------
    def scattered(self, count: int) -> Floats:
        """One random target in each of `count` equal parts of the travel, rounded, ascending."""
        edges = np.linspace(self.means.low_mm, self.means.high_mm, count + 1)
        return np.asarray(np.round(self.rng.uniform(edges[:-1], edges[1:]), self.digits))

    def point(
        self, index: int, direction: int, target_mm: float, overrun_mm: float | None = None, *levels: tuple[str, float]
    ) -> PlannedPoint:
        """A row of run `index` of this measurement; its reversal no farther out than the usual overrun."""
        means = self.means
        wanted = means.overrun_mm if overrun_mm is None else overrun_mm
        room = (target_mm - means.low_mm if direction > 0 else means.high_mm - target_mm) + means.overrun_mm
        return PlannedPoint(
            self.first_run + index, direction, target_mm, round(min(wanted, room), self.digits), levels=levels
        )

    def there_and_back(
        self, targets: Floats, passes: int, *levels: tuple[str, float], first: int = 0
    ) -> list[PlannedPoint]:
        """Up through the targets and down again, `passes` times, a run each."""
        points = []
        for index in range(first, first + passes):
            for direction, way in ((1, targets), (-1, targets[::-1])):
                points += [self.point(index, direction, float(target), None, *levels) for target in way]
        return points

    def heated(self, passes: int) -> list[PlannedPoint]:
        """Cold, warm and cooled: passes over a few targets, with strokes and rests before them."""
        targets = self.scattered(max(self.means.targets // 2, 5))
        points = self.there_and_back(targets, passes)
        for index, (strokes_s, rest_s) in enumerate(((WARM_S, 0.0), (WARM_S, 0.0), (0.0, REST_S), (0.0, REST_S))):
            part = self.there_and_back(targets, 1, first=passes + index)
            points += [replace(part[0], strokes_s=strokes_s, rest_s=rest_s), *part[1:]]
        return points

    def planned(
        self,
        name: str,
        words: str,
        points: Sequence[PlannedPoint],
        *,
        person: str = "",
        wait_min: float = 0.0,
        adds: tuple[str, ...] = (),
    ) -> PlannedRun:
        minutes = float(motion_columns(points, self.means)["time_s"][-1]) / 60.0 + START_MIN + wait_min
        return PlannedRun(name, words, tuple(points), minutes, person, adds)

    # -- runs that the axis makes alone ------------------------------------------------------------------------------------
    def repeat(self) -> PlannedRun:
        grid = np.round(np.linspace(self.means.low_mm, self.means.high_mm, self.means.targets), self.digits)
        return self.planned("repeat", "measure the same once more, there and back twice", self.there_and_back(grid, 2))

    def shifted(self) -> PlannedRun:
        count = self.means.targets
        words = f"measure at {count} other targets, off the spacing of the first ones, there and back twice"
        return self.planned("shifted", words, self.there_and_back(self.scattered(count), 2))

    def fine(self) -> PlannedRun:
        count = 3 * self.means.targets
        words = f"measure at {count} other targets all over the travel, there and back"
        return self.planned("fine", words, self.there_and_back(self.scattered(count), 1))

    def dense(self) -> PlannedRun:
        """Fine steps that no usual pitch divides, over two of the longest periods, at three positions."""
        low, high = self.means.low_mm, self.means.high_mm
        longest = max((*self.means.pitches_mm, min(LONGEST_PITCH_MM, self.means.span_mm / 8)))
        window, step = min(2 * longest, self.means.span_mm), round(longest / STEPS_PER_PERIOD, self.digits)
        places = [float(np.clip(place - window / 2, low, high - window)) for place in self.scattered(3)]
        points: list[PlannedPoint] = []
        for index, start in enumerate(places):
            fine = np.round(start + step * np.arange(int(window / step + 1e-9) + 1), self.digits)
            points += self.there_and_back(fine, 1, first=index)
        where = ", ".join(f"{place:.{self.digits - DIGITS}f}" for place in places)
        words = f"sweep {window:.3g} mm in steps of {step:.3g} mm both ways, from {where} mm on"
        return self.planned("dense", words, points)

    def reversals(self) -> PlannedRun:
        """The same targets after travels of very different length since the reversal."""
        travels = np.geomspace(min(self.means.overrun_mm, 0.5), 0.45 * self.means.span_mm, 4)
        targets = self.scattered(6)
        rows = [self.point(0, d, float(x), float(s)) for x in targets for d in (1, -1) for s in travels]
        words = (
            f"turn in mid-travel and come back to {len(targets)} targets from both sides after"
            f" {travels[0]:.2g} to {travels[-1]:.3g} mm of travel since the turn"
        )
        return self.planned("reversals", words, [rows[i] for i in self.rng.permutation(len(rows))])

    def returns(self) -> PlannedRun:
        """One reference point repeatedly between two ends."""
        low, high = self.means.low_mm, self.means.high_mm
        middle = round((low + high) / 2, self.digits)
        once = [(1, middle), (1, high), (-1, middle), (-1, low)]
        words = f"return to {middle:g} mm twenty times, by turns from either end of the travel"
        return self.planned("returns", words, [self.point(0, d, x) for _ in range(10) for d, x in once])

    def warm_and_cool(self) -> PlannedRun:
        words = f"measure cold, after {WARM_S / 60:.0f} and {2 * WARM_S / 60:.0f} min of fast strokes, and twice while it cools"
        return self.planned("warm and cool", words, self.heated(2))

    def feeds(self) -> PlannedRun:
        feeds, stretch = self.means.feeds_mm_s, self.means.span_mm / 10
        rows = [
            self.point(0, d, float(x), stretch, ("velocity_mm_s", feed))
            for x in self.scattered(6)
            for d in (1, -1)
            for feed in feeds
        ]
        words = f"capture 6 targets in motion at {', '.join(f'{f:g}' for f in feeds)} mm/s, both ways, in mixed order"
        mixed = [rows[i] for i in self.rng.permutation(len(rows))]
        return self.planned("feeds", words, mixed, adds=("velocity_mm_s",))

    # -- runs that need a person, or may ------------------------------------------------------------------------------------
    def levels(self, column: str, values: tuple[float, ...]) -> PlannedRun:
        """Alternately at the usual level and at the one farthest from it, so that level and time are not confounded."""
        usual = values[0]
        other = max(values, key=lambda value: abs(value - usual))
        targets = self.scattered(max(self.means.targets // 2, 5))
        points: list[PlannedPoint] = []
        for index, level in enumerate((usual, other, usual, other)):
            points += self.there_and_back(targets, 1, (column, level), first=index)
        load = column == "load_kg"
        what, unit = ("load", "kg") if load else (f"axis {column.removeprefix('pos_').removesuffix('_mm')}", "mm")
        as_it_was = f"as it was (write {usual:g} {unit} where it is not known)" if column in self.means.assumed else ""
        words = f"measure by turns with {what} {as_it_was or f'at {usual:g} {unit}'} and at {other:g} {unit}"
        person, wait_min = "", 0.0
        if column not in self.means.by_itself:
            person = f"somebody has to bring {what} to {other:g} {unit}, back to {usual:g} {unit}, and there again"
            wait_min = 3 * (CHANGE_MIN if load else CROSS_MIN)
        return self.planned(f"levels of {column}", words, points, person=person, wait_min=wait_min, adds=(column,))

    def logged(self) -> list[PlannedRun]:
        """Warming and cooling with sensors to be added."""
        sensors, mountable = self.means.sensors, self.means.mountable
        wanted: list[tuple[str, tuple[str, ...], str]] = []
        if "thermometers" in mountable and not any(name.startswith("temp_") for name in sensors):
            wanted.append(("thermometers", (THERMOMETER,), "a thermometer at the screw"))
        if "air" in mountable and not sensors & set(AIR):
            wanted.append(("air", AIR, "air temperature, pressure and humidity"))
        if len(wanted) == 2:
            wanted.append(
                ("thermometers and air", (THERMOMETER, *AIR), "a thermometer at the screw and the air sensors")
            )
        plain = self.warm_and_cool().words
        return [
            self.planned(
                name,
                f"{plain}, with {what} logged",
                self.heated(2),
                person=f"somebody has to have {what} read along with every row",
                wait_min=MOUNT_MIN,
                adds=columns,
            )
            for name, columns, what in wanted
        ]

    def other_optics(self) -> list[PlannedRun]:
        """Another set-up of the measuring line: an error that changes with it is not the axis's."""
        passes = "measure there and back twice"
        wanted = (
            (
                "second offset",
                ("abbe_offset_mm", ABBE_STEP_MM),
                f"{passes} with the measuring line moved sideways or up by {ABBE_STEP_MM:g} mm",
                "somebody has to move the beam and write its distance from before into abbe_offset_mm",
            ),
            (
                "realigned",
                ("setup", 2.0),
                f"realign the beam parallel to the travel and {passes}",
                "somebody has to realign it and write 2 into the column setup, where it was 1 before",
            ),
        )
        targets = self.scattered(self.means.targets)
        return [
            self.planned(
                name,
                words,
                self.there_and_back(targets, 2, level),
                person=person,
                wait_min=REALIGN_MIN,
                adds=(level[0],),
            )
            for name, level, words, person in wanted
            if level[0] in self.means.mountable
        ]
