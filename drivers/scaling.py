"""AxisScaling: conversion between motor counts and millimetres at the load. No other module converts them.

Frames: *motor counts* are the position units the drive speaks on its wire (6064h, 607Ah); *load mm* is the nominal position of
the table, without any correction, in the axis's own direction.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Annotated

from drivers.errors import InputError, LimitError
from drivers.toml_types import Limits, Positive, Ratio, Sign

LARGEST_POSITION = 2**31 - 1
"""Positions are 32 bits with a sign."""


def beyond_reach(first_mm: float, last_mm: float) -> str:
    """That a position lies beyond those that a drive holds, mm, and what to change."""
    return (
        f"the drive holds positions from {first_mm:.6g} to {last_mm:.6g} mm; set coarser position units in the drive (608Fh, 6091h,"
        " electronic gear) and the same in [scaling], or lay travel and zero within"
    )


@dataclass(frozen=True)
class AxisScaling:
    """Motor counts <-> load mm.

    encoder_counts_per_motor_rev: counts (608Fh:1 / 608Fh:2)
    motor_revs_per_shaft_rev: gear ratio (6091h:1 / 6091h:2)
    feed_mm_per_shaft_rev: mm of table travel per revolution of the driving shaft, the screw's lead (6092h:1 / 6092h:2)
    direction: +1 or -1, the sign of load motion for rising counts
    """

    encoder_counts_per_motor_rev: Annotated[int, Limits(ge=1, le=2**40, description="a whole number > 0")]
    feed_mm_per_shaft_rev: Positive
    motor_revs_per_shaft_rev: Ratio = Fraction(1)
    direction: Sign = 1

    def __post_init__(self) -> None:
        if self.encoder_counts_per_motor_rev <= 0:
            raise InputError(f"encoder_counts_per_motor_rev is {self.encoder_counts_per_motor_rev}, expected > 0")
        if not self.feed_mm_per_shaft_rev > 0:
            raise InputError(f"feed_mm_per_shaft_rev is {self.feed_mm_per_shaft_rev}, expected > 0")
        if self.motor_revs_per_shaft_rev <= 0:
            raise InputError(f"motor_revs_per_shaft_rev is {self.motor_revs_per_shaft_rev}, expected > 0")
        if self.direction not in (1, -1):
            raise InputError(f"direction is {self.direction}, expected 1 or -1")

    @cached_property
    def counts_per_load_mm(self) -> float:
        """Counts per mm of load travel, always positive."""
        counts = self.encoder_counts_per_motor_rev * self.motor_revs_per_shaft_rev
        return float(counts) / self.feed_mm_per_shaft_rev

    @property
    def resolution_load_mm(self) -> float:
        """Load travel of one count in mm."""
        return 1.0 / self.counts_per_load_mm

    def motor_counts(self, position_load_mm: float) -> int:
        """Load mm -> motor counts, to the nearest count."""
        return round(self.direction * position_load_mm * self.counts_per_load_mm)

    def load_mm(self, position_motor_counts: float) -> float:
        """Motor counts -> load mm."""
        return self.direction * position_motor_counts / self.counts_per_load_mm

    def unheld(self, position_load_mm: float) -> str:
        """Why a drive that holds positions in 32 bits with a sign cannot hold this one (mm), and what to change; "" where it can."""
        counts = self.motor_counts(position_load_mm)
        if -LARGEST_POSITION <= counts <= LARGEST_POSITION:
            return ""
        last_mm = LARGEST_POSITION / self.counts_per_load_mm
        return f"is {position_load_mm:g} mm, {counts} counts: {beyond_reach(-last_mm, last_mm)}"

    def motor_counts_per_s(self, speed_mm_s: float) -> int:
        """An unsigned speed (or acceleration) in mm/s (mm/s²) -> counts/s (counts/s²), at least 1."""
        return max(1, round(abs(speed_mm_s) * self.counts_per_load_mm))


ROUNDED_UP = 1.02
"""Largest ratio by which a velocity may be rounded up to whole units of the drive; above it the next lower one is taken."""
_UNIT = re.compile(r"(?:(\d+(?:\.\d+)?|\d+/\d+) +)?(\w+)((?:/\w+)*)")
_TIMES_S = {"s": (1, Fraction(1)), "s2": (2, Fraction(1)), "s3": (3, Fraction(1))} | {
    "ms": (1, Fraction(1, 1000)),
    "ms2": (2, Fraction(1, 1000)),
    "min": (1, Fraction(60)),
    "h": (1, Fraction(3600)),
}
"""Divisors of a unit of motion: (power of time, that time in s)."""
_KINDS = {1: "velocity", 2: "acceleration", 3: "jerk"}


@dataclass(frozen=True)
class MotionUnit:
    """One unit of velocity, acceleration or jerk on a drive's wire.

    counts: position counts per s, s² or s³ in one unit. text: as an axis file names it. source: what says so.
    """

    counts: Fraction
    text: str
    source: str


def motion_unit(text: str, scaling: AxisScaling, times: int, source: str = "the axis file") -> MotionUnit:
    """The unit that a text names. times: 1 for a velocity, 2 for an acceleration, 3 for a jerk.

    [factor] base/time, such as "rpm", "0.1 rpm", "counts/s", "1/65536 counts/ms", "mm/s", "rev/s2", "rpm/s". Bases: counts (of
    position on the wire), rev (of the motor), deg, rad, m, mm, um. Raises InputError for another text.
    """
    match = _UNIT.fullmatch(text.strip())
    if match is None:
        raise _unknown(text, times)
    factor, base, rest = match[1], match[2], [part for part in match[3].split("/") if part]
    if base == "rpm":
        base, rest = "rev", ["min", *rest]
    counts_per_rev = Fraction(scaling.encoder_counts_per_motor_rev)
    per_mm = Fraction(scaling.counts_per_load_mm)
    bases = {
        "counts": Fraction(1),
        "rev": counts_per_rev,
        "deg": counts_per_rev / 360,
        "rad": counts_per_rev / Fraction(math.tau),
        "m": per_mm * 1000,
        "mm": per_mm,
        "um": per_mm / 1000,
    }
    if base not in bases or any(part not in _TIMES_S for part in rest):
        raise _unknown(text, times)
    if sum(_TIMES_S[part][0] for part in rest) != times:
        raise _unknown(text, times)
    counts = bases[base] * Fraction(factor or 1)
    if not counts:
        raise _unknown(text, times)
    for part in rest:
        power, unit_s = _TIMES_S[part]
        counts /= unit_s**power
    return MotionUnit(counts, text.strip(), source)


def _unknown(text: str, times: int) -> InputError:
    examples = {1: "rpm, 0.1 rpm, counts/s, rev/s or mm/s", 2: "rpm/s, counts/s2, rev/s2 or mm/s2", 3: "counts/s3"}
    return InputError(f"{_KINDS[times]}_unit {text!r}, expected such as {examples[times]}")


@dataclass(frozen=True)
class MotionScaling:
    """mm/s and mm/s² at the load <-> the drive's own units of velocity and acceleration. The only place that converts them.

    ambiguous: why these units must not be used for motion, "" where they may.
    """

    scaling: AxisScaling
    velocity: MotionUnit
    acceleration: MotionUnit
    ambiguous: str = ""

    @classmethod
    def in_counts(cls, scaling: AxisScaling) -> MotionScaling:
        """Position counts per s and s²: the units of a drive that has no others."""
        source = "the standard: position units per s, as the drive states no unit"
        return cls(
            scaling, motion_unit("counts/s", scaling, 1, source), motion_unit("counts/s2", scaling, 2, source), ""
        )

    def velocity_units(self, speed_mm_s: float) -> int:
        """An unsigned speed in mm/s -> whole units, at least 1. Raises LimitError for a speed far below one unit."""
        exact = abs(speed_mm_s) * self.scaling.counts_per_load_mm / float(self.velocity.counts)
        units = round(exact)
        if self.velocity.counts <= 1:
            return max(1, units)
        if units > ROUNDED_UP * exact:
            units = math.floor(exact)
        if units < 1:
            raise LimitError(
                f"velocity {speed_mm_s:g} mm/s is below one unit of the drive's velocity,"
                f" {self.mm_s(1):.4g} mm/s ({self.velocity.text})"
            )
        return units

    def representable_mm_s(self, speed_mm_s: float) -> float:
        """The speed in whole units that an order for `speed_mm_s` leads to, mm/s; one unit for a speed below it."""
        return self.mm_s(self.velocity_units(max(speed_mm_s, self.mm_s(1))))

    def acceleration_units(self, acceleration_mm_s2: float) -> int:
        """An unsigned acceleration in mm/s² -> whole units, at least 1."""
        exact = abs(acceleration_mm_s2) * self.scaling.counts_per_load_mm / float(self.acceleration.counts)
        return max(1, round(exact))

    def mm_s(self, velocity_units: float) -> float:
        """Units -> an unsigned or signed speed in mm/s along the motor's own direction."""
        return velocity_units * float(self.velocity.counts) / self.scaling.counts_per_load_mm

    def load_mm_s(self, velocity_units: float) -> float:
        """Signed units -> mm/s at the load, in the axis's own direction."""
        return self.scaling.direction * self.mm_s(velocity_units)

    def mm_s2(self, acceleration_units: float) -> float:
        """Units -> mm/s²."""
        return acceleration_units * float(self.acceleration.counts) / self.scaling.counts_per_load_mm


@dataclass(frozen=True)
class ReportedScaling:
    """The units that a drive reports of itself, exact fractions; None where it has no object for it.

    position_units_per_shaft_rev: position units per revolution of the driving shaft, where the drive states them apart from the
    encoder
    """

    encoder_counts_per_motor_rev: Fraction | None = None
    motor_revs_per_shaft_rev: Fraction | None = None
    feed_mm_per_shaft_rev: Fraction | None = None
    position_units_per_shaft_rev: Fraction | None = None

    @property
    def counts_per_shaft_rev(self) -> Fraction | None:
        """Position units per revolution of the driving shaft."""
        if self.position_units_per_shaft_rev is not None:
            return self.position_units_per_shaft_rev
        counts, gear = self.encoder_counts_per_motor_rev, self.motor_revs_per_shaft_rev
        return None if counts is None or gear is None else counts * gear

    @property
    def counts_per_load_mm(self) -> Fraction | None:
        """Position units per mm of load travel."""
        counts, feed = self.counts_per_shaft_rev, self.feed_mm_per_shaft_rev
        return None if counts is None or feed is None else counts / feed
