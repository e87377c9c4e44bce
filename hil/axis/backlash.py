"""The [backlash] section of an axis file: where and how the lost motion is measured by torque, and where its value is kept."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.toml_schema import Document
from drivers.toml_types import Limits, Number, Positive, Text, one_of

METHODS = ("fitted", "four-sample")
"""Which estimate counts: the fitted wind-up curve, or the published rule of four samples. Both are always told."""

FEEDS = ("steps", "creep")
"""How the motor goes on after a reversal, both published: step by step with a rest after each, or very slowly without one."""

REVERSALS = {"both": (-1, 1), "to-minus": (-1,), "to-plus": (1,)}
"""Which reversals are measured, as directions after them, in this order: both, whose mean counts, or one alone (fig. 5)."""

SLIDES, SLIDE_MM = 8, 0.1
"""Ways beyond the break-away, each ended by a reading: they show the torque that sliding leaves behind."""

_OBJECT = re.compile(r"([0-9A-Fa-f]{4})h(?::([0-9A-Fa-f]{2}))?")


@dataclass(frozen=True)
class BacklashConfig:
    """How it is measured, and the drive's parameters.

    reference_plus_mm, reference_minus_mm: where the axis turns back from + to -, and from - to +. parameter, acceleration: an
    object ("2201h", "2201h:01") or a register by name; None: the drive has none, and the amount is entered in the axis's sealed
    tables. parameter_um: what one count of it stands for. reversals: see `REVERSALS`. scale: lost motion by an instrument over
    that by torque, found once on this axis; what is written is the measured amount times it. feed: see `FEEDS`; creep_um_s: the
    speed of the second, whose readings are averaged over each step_um.
    """

    reference_plus_mm: Number
    reference_minus_mm: Number
    travel_velocity_mm_s: Positive
    run_in_mm: Annotated[float, Limits(ge=0.05, le=100.0)] = 0.5
    step_um: Annotated[float, Limits(ge=0.01, le=100.0)] = 1.0
    steps: Annotated[int, Limits(ge=20, le=5000)] = 200
    readings: Annotated[int, Limits(ge=1, le=100)] = 4
    settle_s: Annotated[float, Limits(ge=0.0, le=10.0)] = 0.1
    velocity_mm_s: Positive = 0.5
    feed: Annotated[str, one_of(*FEEDS)] = FEEDS[0]
    creep_um_s: Annotated[float, Limits(ge=1.0, le=1000.0)] = 20.0
    runs: Annotated[int, Limits(ge=1, le=100)] = 1
    method: Annotated[str, one_of(*METHODS)] = METHODS[0]
    reversals: Annotated[str, one_of(*REVERSALS)] = "both"
    scale: Annotated[float, Limits(ge=0.5, le=2.0)] = 1.0
    home: bool = True
    parameter: Text | None = None
    parameter_um: Positive = 1.0
    acceleration: Text | None = None

    @property
    def directions(self) -> tuple[int, ...]:
        """Directions of motion after the reversals that are measured, in their order."""
        return REVERSALS[self.reversals]

    def turning_mm(self, direction: int) -> float:
        """Where a reversal into `direction` takes place."""
        return self.reference_plus_mm if direction < 0 else self.reference_minus_mm

    def start_mm(self, direction: int) -> float:
        """Where the way to that reversal begins, reached from the reversal itself."""
        return self.turning_mm(direction) + direction * self.run_in_mm

    def end_mm(self, direction: int) -> float:
        """The furthest that its steps, and the slides after them, may lead."""
        return self.turning_mm(direction) + direction * (self.steps * self.step_um / 1000.0 + SLIDES * SLIDE_MM)


def object_key(text: str) -> tuple[int, int] | None:
    """(index, subindex) of "2201h" or "2201h:01"; None for what is no object, and so a register's name."""
    match = _OBJECT.fullmatch(text)
    return None if match is None else (int(match[1], 16), int(match[2] or "0", 16))


def read_backlash(document: Document, limits: DriveLimits, scaling: AxisScaling, backend: str) -> BacklashConfig:
    """[backlash]; every key has a default, so that an axis file without it can be measured too."""
    middle = 0.5 * (limits.travel_min_mm + limits.travel_max_mm)
    usual = {
        "reference_plus_mm": middle,
        "reference_minus_mm": middle,
        "travel_velocity_mm_s": limits.max_velocity_mm_s / 5.0,
    }
    config = document.load(BacklashConfig, "backlash", usual=usual, required=False)
    for key in ("parameter", "acceleration"):
        name = getattr(config, key)
        if backend == "canopen" and name is not None and object_key(name) is None:
            raise document.fail(f"backlash.{key}", f'is {name!r}, expected an object such as "2201h" or "2201h:01"')
    resolution_um = 1000.0 * scaling.resolution_load_mm
    if config.step_um < resolution_um:
        raise document.fail(
            "backlash.step_um", f"is {config.step_um:g}, expected at least one count, {resolution_um:g} µm"
        )
    for key in ("velocity_mm_s", "travel_velocity_mm_s"):
        if (speed := getattr(config, key)) > limits.max_velocity_mm_s:
            raise document.fail(f"backlash.{key}", f"is {speed:g}, expected at most {limits.max_velocity_mm_s:g}")
    for key, direction in (("reference_plus_mm", -1), ("reference_minus_mm", 1)):
        reach = (config.turning_mm(direction), config.start_mm(direction), config.end_mm(direction))
        if not limits.travel_min_mm <= min(reach) <= max(reach) <= limits.travel_max_mm:
            raise document.fail(
                f"backlash.{key}",
                f"is {config.turning_mm(direction):g}: its run-in and steps from {min(reach):g} to {max(reach):g} mm leave the"
                f" travel {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm",
            )
    return config


def default_backlash(path: Path, limits: DriveLimits, scaling: AxisScaling, backend: str) -> BacklashConfig:
    """What holds for an axis file that says nothing of it. Raises InputError where the travel is too short for that."""
    return read_backlash(Document(path, ""), limits, scaling, backend)
