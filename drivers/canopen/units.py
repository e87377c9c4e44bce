"""Position units that a CiA-402 drive reports (608Fh, 6091h, 6092h and 60A8h), with every possible interpretation.

These values are a claim; whether the axis moves by them, only an instrument shows.

By the standard the position on the wire (6064h) is internal increments · feed / (encoder resolution · gear ratio), in the unit that
60A8h names, and the feed (6092h) is in the same unit (IEC 61800-7-201, factor group): position units per revolution of the
driving shaft. Where 60A8h names a length, that is the screw's lead too, and there is one interpretation. Where it names increments, or
is missing, drives differ: some follow the standard; others show the encoder's increments and keep the lead in the feed, in the unit
that their manufacturer chose. Micrometres are assumed then, the usual choice.
"""

from __future__ import annotations

from fractions import Fraction

from drivers.canopen import objects
from drivers.canopen.objects import Entry
from drivers.canopen.pdo import OBJECT_MISSING
from drivers.canopen.sdo import SdoClient
from drivers.errors import AbortError
from drivers.scaling import ReportedScaling

METRE = 0x01  # the unit in bits 16 to 23 of 60A8h (CiA-303-2); bits 24 to 31 are its power of ten
MM_PER_M = 1000
UM_PER_MM = 1000


def read_units(sdo: SdoClient) -> ReportedScaling:
    """Read the objects. Raises NoAnswerError, ProtocolError; an object that is missing or zero becomes None."""
    encoder = _ratio(sdo, objects.ENCODER_INCREMENTS, objects.ENCODER_REVOLUTIONS)
    gear = _ratio(sdo, objects.GEAR_MOTOR_REVOLUTIONS, objects.GEAR_SHAFT_REVOLUTIONS)
    feed = _ratio(sdo, objects.FEED, objects.FEED_SHAFT_REVOLUTIONS)
    si_unit = _read(sdo, objects.SI_UNIT_POSITION)
    if feed is None:
        return ReportedScaling(encoder, gear)
    if si_unit is None:
        return ReportedScaling(encoder, gear, feed / UM_PER_MM)
    metre = _power_of_metre(si_unit)
    return ReportedScaling(encoder, gear, None if metre is None else feed * metre * MM_PER_M, feed)


def _power_of_metre(si_unit: int) -> Fraction | None:
    """The position unit in metres, None for one that is no length (increments, degrees …)."""
    if si_unit >> 16 & 0xFF != METRE:
        return None
    prefix = si_unit >> 24 & 0xFF
    return Fraction(10) ** (prefix - 0x100 if prefix & 0x80 else prefix)


def _read(sdo: SdoClient, entry: Entry) -> int | None:
    try:
        return sdo.read(entry)
    except AbortError as error:
        if error.code in OBJECT_MISSING:
            return None
        raise


def _ratio(sdo: SdoClient, above: Entry, below: Entry) -> Fraction | None:
    numerator, denominator = _read(sdo, above), _read(sdo, below)
    if not numerator or denominator == 0:
        return None
    return Fraction(numerator, 1 if denominator is None else denominator)


def readings(reported: ReportedScaling) -> tuple[ReportedScaling, ...]:
    """The values of `read_units`, and their other possible interpretations, the likeliest first.

    A feed of 1 per revolution is a factory default and not used as a feed.
    """
    encoder, gear = reported.encoder_counts_per_motor_rev, reported.motor_revs_per_shaft_rev
    units, feed_mm = reported.position_units_per_shaft_rev, reported.feed_mm_per_shaft_rev
    if units is not None and feed_mm is not None:
        return (reported,)
    feed = units if units is not None else None if feed_mm is None else feed_mm * UM_PER_MM
    if feed is None or feed == 1:
        return (ReportedScaling(encoder, gear),)
    wire = ReportedScaling(encoder, gear, None, feed)
    lead = ReportedScaling(encoder, gear or Fraction(1), feed / UM_PER_MM)
    if encoder is None or encoder * (gear or 1) == feed:
        return (wire,)
    return (wire, lead) if units is not None else (lead, wire)
