"""What a CiA-402 drive says of its own position units: 608Fh, 6091h, 6092h and 60A8h.

What may go in: reading these objects and what follows from them. They are a claim; whether the axis moves by what they say only an
instrument can tell.

Feed constant (6092h) and position unit (60A8h) belong together: the feed is what the wire counts per revolution of the driving shaft,
and where the unit is a length that is the screw's lead too. A drive without 60A8h leaves the unit of its feed to its manufacturer;
micrometres are taken then, the usual choice.
"""

from __future__ import annotations

from fractions import Fraction

from drivers.canopen import objects
from drivers.canopen.objects import Entry
from drivers.canopen.sdo import SdoClient
from drivers.errors import AbortError
from drivers.scaling import ReportedScaling

METRE = 0x01  # the unit in bits 16 to 23 of 60A8h (CiA-303-2); bits 24 to 31 are its power of ten
MM_PER_M = 1000
UM_PER_MM = 1000
OBJECT_MISSING = (0x06020000, 0x06090011)


def read_units(sdo: SdoClient) -> ReportedScaling:
    """Ask the drive. Raises NoAnswerError, ProtocolError; what is missing or zero in the drive becomes None."""
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
