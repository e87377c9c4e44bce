"""Comparison of the drive's reported units with the axis file, with the likely mistake behind a difference.

Pure. The wire counts so much per revolution of the driving shaft, and a revolution moves the table so far: two figures, each of which
the drive may know or not. Neither of the two witnesses is the truth; that is the small move of `hil.doctor.procedure`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from drivers.scaling import AxisScaling, ReportedScaling

SAME = Fraction(1, 1_000_000)
"""Relative tolerance, for rounding."""


@dataclass(frozen=True)
class UnitsVerdict:
    """Result of the comparison. agrees: no reported unit contradicts the axis file (also where none is reported)."""

    agrees: bool
    detail: str


def compare_units(readings: Sequence[ReportedScaling], scaling: AxisScaling) -> UnitsVerdict:
    """Compare, and name what is wrong where something is.

    readings: the ways to understand what the drive says; it agrees when any of them does, else the one with the fewest mistakes is
    told.
    """
    told = [reported for reported in readings if _said(reported)]
    if not told:
        return UnitsVerdict(True, "the drive says nothing of its units: only a move proves them")
    verdicts = [([*_counts(reported, scaling), *_feed(reported, scaling)], reported) for reported in told]
    wrong, reported = min(verdicts, key=lambda verdict: len(verdict[0]))
    by_drive = reported.counts_per_load_mm
    per_mm = "" if by_drive is None else f", {float(by_drive):g} counts/mm"
    text = f"the drive says {', '.join(_said(reported))}{per_mm}"
    if wrong:
        return UnitsVerdict(False, f"{text}; but {'; and '.join(wrong)}")
    return UnitsVerdict(True, f"{text}: as the axis file{', as far as it goes' if by_drive is None else ''}")


def _said(reported: ReportedScaling) -> list[str]:
    parts = (
        (reported.encoder_counts_per_motor_rev, "encoder counts per motor revolution"),
        (reported.motor_revs_per_shaft_rev, "motor revolutions per shaft revolution"),
        (reported.position_units_per_shaft_rev, "position units per shaft revolution"),
        (reported.feed_mm_per_shaft_rev, "mm per shaft revolution"),
    )
    return [f"{_figure(value)} {what}" for value, what in parts if value is not None]


def _counts(reported: ReportedScaling, scaling: AxisScaling) -> list[str]:
    """Mistakes in the counts per shaft revolution: encoder, gear, or unit of position."""
    encoder, gear, wire = (
        reported.encoder_counts_per_motor_rev,
        reported.motor_revs_per_shaft_rev,
        reported.counts_per_shaft_rev,
    )
    file_encoder, file_gear = Fraction(scaling.encoder_counts_per_motor_rev), scaling.motor_revs_per_shaft_rev
    file = file_encoder * file_gear
    parts = [*_encoder(file_encoder, encoder), *_gear(file_gear, gear)]
    if wire is None:
        return parts
    if _same(file, wire):
        return []
    own = None if encoder is None or gear is None else encoder * gear
    if own is not None and _same(file, own):
        return [
            f"the axis file counts the encoder's increments where this drive speaks position units:"
            f" encoder_counts_per_motor_rev is {_figure(file_encoder)}, expected {_figure(wire / file_gear)}"
        ]
    if parts and own is not None and _same(own, wire):
        return parts
    return [f"the axis file counts {_figure(file)} per shaft revolution ({_factor(file / wire)})"]


def _encoder(file: Fraction, drive: Fraction | None) -> list[str]:
    if drive is None or _same(file, drive):
        return []
    return [f"encoder_counts_per_motor_rev is {_figure(file)} ({_factor(file / drive)})"]


def _gear(file: Fraction, drive: Fraction | None) -> list[str]:
    if drive is None or _same(file, drive):
        return []
    what = f"motor_revs_per_shaft_rev is {_figure(file)}"
    if _same(file * drive, Fraction(1)):
        return [f"{what}: the gear is the wrong way round"]
    if file == 1:
        return [f"{what}: the gear is left out"]
    return [f"{what} ({_factor(file / drive)})"]


def _feed(reported: ReportedScaling, scaling: AxisScaling) -> list[str]:
    drive = reported.feed_mm_per_shaft_rev
    file = Fraction(str(scaling.feed_mm_per_shaft_rev))
    if drive is None or _same(file, drive):
        return []
    return [f"feed_mm_per_shaft_rev is {_figure(file)} ({_factor(file / drive)})"]


def _factor(ratio: Fraction) -> str:
    """A ratio of axis file to drive, with its usual cause."""
    text = f"{_figure(ratio)} of the drive's" if ratio < 1 else f"{_figure(ratio)} times the drive's"
    for factor, cause in (
        (Fraction(4), "quadrature counted twice"),
        (Fraction(1, 4), "lines instead of counts: quadrature left out"),
        (Fraction(2), "a double-start screw, or edges counted twice"),
        (Fraction(1, 2), "a double-start screw, or edges left out"),
        (Fraction(254, 10), "inches taken for mm"),
        (Fraction(10, 254), "mm taken for inches"),
    ):
        if _same(ratio, factor):
            return f"{text}: {cause}"
    for power in (1, 2, 3, 6):
        if _same(ratio, Fraction(10**power)) or _same(ratio, Fraction(1, 10**power)):
            return f"{text}: a wrong power of ten"
    return text


def _same(one: Fraction, other: Fraction) -> bool:
    return abs(one - other) <= SAME * abs(other)


def _figure(value: Fraction) -> str:
    """A fraction as text: whole, a short decimal, else with its denominator."""
    if value.denominator == 1:
        return str(value.numerator)
    short = f"{float(value):.6g}"
    return short if Fraction(short) == value else f"{value.numerator}/{value.denominator}"
