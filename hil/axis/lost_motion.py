"""The [lost_motion] section of an axis file: where and how reversals are measured by the axis's instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from drivers.limits import DriveLimits
from drivers.toml_schema import Document
from drivers.toml_types import Limits, Number, one_of

TRAVEL_BY = ("command", "estimate")
"""The set-points, or as published the body's actual position, estimated from the drive's encoder less the correction in force."""


@dataclass(frozen=True)
class LostMotionConfig:
    """How reversals are measured.

    at_mm: middle of the strokes; stroke_mm: their length; places: at each end, at which the axis rests after turning there; finest_um:
    travel to the first of them; runs: how often there and back; proof_moves: of any length, before and after; shortest_rise_um: no
    correction rises faster, as the drive has to follow it; how much of a rise over less is lost motion of the load, it does not see
    travel_by: what the travel since a reversal is counted by in streams, see `TRAVEL_BY`
    """

    at_mm: Number
    stroke_mm: Annotated[float, Limits(ge=0.1, le=200.0)] = 6.0
    places: Annotated[int, Limits(ge=10, le=200)] = 20
    finest_um: Annotated[float, Limits(ge=0.05, le=1000.0)] = 2.0
    runs: Annotated[int, Limits(ge=2, le=100)] = 3
    proof_moves: Annotated[int, Limits(ge=4, le=1000)] = 40
    shortest_rise_um: Annotated[float, Limits(ge=0.01, le=1000.0)] = 0.25
    travel_by: Annotated[str, one_of(*TRAVEL_BY)] = TRAVEL_BY[0]

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


def read_lost_motion(document: Document, limits: DriveLimits, targets_mm: Sequence[float]) -> LostMotionConfig:
    """[lost_motion]; every key has a default, so that an axis file without it can be measured too."""
    middle = round(0.5 * (min(targets_mm) + max(targets_mm)), 3)
    config = document.load(LostMotionConfig, "lost_motion", usual={"at_mm": middle}, required=False)
    if not limits.travel_min_mm < config.low_mm < config.high_mm < limits.travel_max_mm:
        raise document.fail(
            "lost_motion.at_mm",
            f"is {config.at_mm:g}: strokes of {config.stroke_mm:g} mm around it leave the travel"
            f" {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm",
        )
    steps = np.diff(config.travels_mm)
    if config.finest_um / 1000.0 >= 0.1 * config.stroke_mm or float(steps.min()) < 1e-5:
        raise document.fail(
            "lost_motion.finest_um",
            f"is {config.finest_um:g} with {config.places} places: expected less than a tenth of stroke_mm,"
            f" {config.stroke_mm:g}, and places apart by more than 0.01 µm",
        )
    return config


def default_lost_motion(path: Path, limits: DriveLimits, targets_mm: Sequence[float]) -> LostMotionConfig:
    """What holds for an axis file that says nothing of it. Raises InputError where the travel is too short for that."""
    return read_lost_motion(Document(path, ""), limits, targets_mm)
