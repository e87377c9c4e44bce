"""AxisScaling: conversion between motor counts and millimetres at the load. No other module converts them.

Frames: *motor counts* are the position units the drive speaks on its wire (6064h, 607Ah); *load mm* is the nominal position of
the table, without any correction, in the axis's own direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Annotated

from drivers.errors import InputError
from drivers.toml_types import Limits, Positive, Ratio, Sign


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

    def motor_counts_per_s(self, speed_mm_s: float) -> int:
        """An unsigned speed (or acceleration) in mm/s (mm/s²) -> counts/s (counts/s²), at least 1."""
        return max(1, round(abs(speed_mm_s) * self.counts_per_load_mm))


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
