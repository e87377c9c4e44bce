"""The [lost_motion] section of an axis file: where and how reversals are measured by the axis's instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.drive import DriveLimits
from hil.axis import reader
from hil.axis.reader import Table


@dataclass(frozen=True)
class LostMotionConfig:
    """How reversals are measured.

    at_mm: middle of the strokes; stroke_mm: their length; places: at each end, at which the axis rests after turning there; finest_um:
    travel to the first of them; runs: how often there and back; proof_moves: of any length, before and after; shortest_rise_um: no
    correction rises faster, as the drive has to follow it; how much of a rise over less is lost motion of the load, it does not see
    """

    at_mm: float
    stroke_mm: float
    places: int
    finest_um: float
    runs: int
    proof_moves: int
    shortest_rise_um: float

    @property
    def low_mm(self) -> float:
        """Where the strokes turn below."""
        return round(self.at_mm - self.stroke_mm / 2.0, 6)

    @property
    def high_mm(self) -> float:
        """Where they turn above."""
        return round(self.at_mm + self.stroke_mm / 2.0, 6)

    @property
    def travels_mm(self) -> tuple[float, ...]:
        """From a turning point to each of its places, ascending, up to the middle of the stroke; whole nm."""
        travels = np.geomspace(self.finest_um / 1000.0, 0.49 * self.stroke_mm, self.places)
        return tuple(round(float(travel), 6) for travel in travels)


def read_lost_motion(table: Table, limits: DriveLimits, targets_mm: Sequence[float]) -> LostMotionConfig:
    """[lost_motion]; every key has a default, so that an axis file without it can be measured too."""
    middle = round(0.5 * (min(targets_mm) + max(targets_mm)), 3)
    config = LostMotionConfig(
        at_mm=table.take("at_mm", reader.finite, "a position in mm", middle),
        stroke_mm=table.take("stroke_mm", reader.between(0.1, 200.0), "mm, 0.1 to 200", 6.0),
        places=table.take("places", reader.whole(10, 200), "a whole number, 10 to 200", 20),
        finest_um=table.take("finest_um", reader.between(0.05, 1000.0), "µm, 0.05 to 1000", 2.0),
        runs=table.take("runs", reader.whole(2, 100), "a whole number, 2 to 100", 3),
        proof_moves=table.take("proof_moves", reader.whole(4, 1000), "a whole number, 4 to 1000", 40),
        shortest_rise_um=table.take("shortest_rise_um", reader.between(0.01, 1000.0), "µm, 0.01 to 1000", 0.25),
    )
    table.finish()
    if not limits.travel_min_mm < config.low_mm < config.high_mm < limits.travel_max_mm:
        raise table.fail(
            "at_mm",
            f"is {config.at_mm:g}: strokes of {config.stroke_mm:g} mm around it leave the travel"
            f" {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm",
        )
    steps = np.diff(config.travels_mm)
    if config.finest_um / 1000.0 >= 0.1 * config.stroke_mm or float(steps.min()) < 1e-5:
        raise table.fail(
            "finest_um",
            f"is {config.finest_um:g} with {config.places} places: expected less than a tenth of stroke_mm,"
            f" {config.stroke_mm:g}, and places apart by more than 0.01 µm",
        )
    return config


def default_lost_motion(path: Path, limits: DriveLimits, targets_mm: Sequence[float]) -> LostMotionConfig:
    """What holds for an axis file that says nothing of it. Raises InputError where the travel is too short for that."""
    return read_lost_motion(Table(path, "", "lost_motion", {}), limits, targets_mm)
