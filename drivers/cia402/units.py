"""Position units that a CiA-402 drive reports (608Fh, 6091h, 6092h and 60A8h), with every possible interpretation.

These values are a claim; whether the axis moves by them, only an instrument shows.

By the standard the position on the wire (6064h) is internal increments · feed / (encoder resolution · gear ratio), in the unit that
60A8h names, and the feed (6092h) is in the same unit (IEC 61800-7-201, factor group): position units per revolution of the
driving shaft. Where 60A8h names a length, that is the screw's lead too, and there is one interpretation. Where it names increments, or
is missing, drives differ: some follow the standard; others show the encoder's increments and keep the lead in the feed, in the unit
that their manufacturer chose. Micrometres are assumed then, the usual choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial

from drivers.cia402 import objects
from drivers.cia402.objects import Entry
from drivers.cia402.wire import ObjectAccess
from drivers.scaling import AxisScaling, MotionScaling, MotionUnit, ReportedScaling, motion_unit

METRE = 0x01  # the unit in bits 16 to 23 of 60A8h (CiA-303-2); bits 24 to 31 are its power of ten
MM_PER_M = 1000
UM_PER_MM = 1000


def read_units(access: ObjectAccess) -> ReportedScaling:
    """Read the objects. Raises NoAnswerError, ProtocolError; an object that is missing or zero becomes None."""
    read = partial(access.read_if_shown, absent=None)
    encoder = _ratio(read, objects.ENCODER_INCREMENTS, objects.ENCODER_REVOLUTIONS)
    if encoder == 1:  # as delivered, never set
        encoder = None
    gear = _ratio(read, objects.GEAR_MOTOR_REVOLUTIONS, objects.GEAR_SHAFT_REVOLUTIONS)
    feed = _ratio(read, objects.FEED, objects.FEED_SHAFT_REVOLUTIONS)
    si_unit = read(objects.SI_UNIT_POSITION)
    turn = None if not si_unit else _units_per_turn(si_unit)
    if turn is not None:
        return ReportedScaling(encoder, gear, None, turn)
    if feed is None:
        return ReportedScaling(encoder, gear)
    if si_unit is None:
        return ReportedScaling(encoder, gear, feed / UM_PER_MM)
    metre = _power_of_metre(si_unit)
    return ReportedScaling(encoder, gear, None if metre is None else feed * metre * MM_PER_M, feed)


def _units_per_turn(si_unit: int) -> Fraction | None:
    """Position units per revolution of the shaft, where 60A8h names turns or degrees of it; None where it names another unit."""
    per_turn = {0xB4: Fraction(1), 0x41: Fraction(360)}.get(si_unit >> 16 & 0xFF)
    prefix = si_unit >> 24 & 0xFF
    return None if per_turn is None else per_turn / Fraction(10) ** (prefix - 0x100 if prefix & 0x80 else prefix)


def _power_of_metre(si_unit: int) -> Fraction | None:
    """The position unit in metres, None for one that is no length (increments, degrees …)."""
    if si_unit >> 16 & 0xFF != METRE:
        return None
    prefix = si_unit >> 24 & 0xFF
    return Fraction(10) ** (prefix - 0x100 if prefix & 0x80 else prefix)


def _ratio(read: Callable[[Entry], int | None], above: Entry, below: Entry) -> Fraction | None:
    numerator, denominator = read(above), read(below)
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


# -- velocity and acceleration -------------------------------------------------------------------------------------------
_SI_BASES = {0xB4: "rev", 0xB5: "counts", 0x41: "deg", 0x10: "rad", METRE: "m", 0xC0: "rpm"}
"""Numerators of 60A9h and 60AAh (CiA 303-2, bits 16 to 23); C0h is maxon's turns per minute in 60AAh (EPOS4 manual)."""
_SI_TIMES = {0x03: ("s",), 0x47: ("min",), 0x48: ("h",), 0x57: ("s", "s")}
"""Denominators: bits 8 to 15, and 0 to 7 of a second one."""
_DIMENSIONS = {
    objects.VELOCITY_DIMENSION: {0xA3: "rev/s", 0xA4: "rpm", 0xAD: "counts/s"},
    objects.ACCELERATION_DIMENSION: {0xA3: "rev/s2", 0xA4: "rpm/s", 0xAE: "counts/s2"},
}
"""Dimension indices 608Ch and 608Eh of DSP 402 version 2; the notation index is a power of ten."""

FAULHABER, MAXON, NANOTEC, ORIENTAL, TRINAMIC, TECHNOSOFT = 0x147, 0xFB, 0x26C, 0x2BE, 0x286, 0x1A3
_BY_MANUAL = {
    MAXON: ("maxon", "rpm", "rpm/s"),
    FAULHABER: ("Faulhaber", "rpm", "rev/s2"),
    NANOTEC: ("Nanotec", "rpm", "rpm/s"),
    ORIENTAL: ("Oriental Motor", "rpm", "rpm/s"),
}
"""Vendor (1018h:1) -> name, velocity and acceleration by the maker's manuals, where no object states them."""
_BY_MODEL = {
    TRINAMIC: "Trinamic's modules take turns per minute (rpm) or steps per second (counts/s), by model",
    TECHNOSOFT: "Technosoft's drives take 1/65536 counts/ms, or what their factors make of it",
}
"""Vendors whose drives differ, or whose objects do not tell it: the axis file has to."""
_STATE_IT = 'state velocity_unit in [drive], such as velocity_unit = "rpm"'
_CONTRADICT = Fraction(1, 1000)


MOTION_OBJECTS = (
    objects.SI_UNIT_VELOCITY,
    objects.SI_UNIT_ACCELERATION,
    objects.VELOCITY_NOTATION,
    objects.VELOCITY_DIMENSION,
    objects.ACCELERATION_NOTATION,
    objects.ACCELERATION_DIMENSION,
    *objects.VELOCITY_FACTOR,
    *objects.VELOCITY_FACTOR_NEW,
    *objects.ACCELERATION_FACTOR,
    objects.VELOCITY_ENCODER_INCREMENTS,
    objects.VELOCITY_ENCODER_REVOLUTIONS,
    objects.ENCODER_INCREMENTS,
    objects.ENCODER_REVOLUTIONS,
)
"""Objects that `motion_units` may read."""


def motion_units(
    read: Callable[[Entry], int | None],
    scaling: AxisScaling,
    *,
    velocity: str | None = None,
    acceleration: str | None = None,
    vendor: int = 0,
) -> MotionScaling:
    """The units of velocity and acceleration: stated by the axis file (velocity, acceleration), by the drive's objects, by its maker's
    manual (vendor, 1018h:1), or the standard's position units per second. read(): a value, None for an object that the drive does not
    show.

    Raises InputError for a text that is no unit, and as `read`. What contradicts itself is `ambiguous`.
    """
    usual = MotionScaling.in_counts(scaling)
    stated, doubt = _by_objects(read, scaling, 1)
    by_file = None if velocity is None else motion_unit(velocity, scaling, 1)
    ambiguous = doubt if by_file is None else ""
    if by_file is not None and stated is not None and not _same(by_file, stated):
        ambiguous = f"the axis file says {by_file.text}, {stated.source} says {stated.text}"
    chosen = by_file or stated
    maker = _BY_MANUAL.get(vendor)
    if chosen is None and maker is not None:
        chosen = motion_unit(maker[1], scaling, 1, f"{maker[0]}'s manual, as no object states it")
    if chosen is None and vendor in _BY_MODEL and not ambiguous:
        ambiguous = f"{_BY_MODEL[vendor]}, and no object of the drive states it"
    if ambiguous:
        ambiguous = f"its unit of velocity is not known: {ambiguous}; {_STATE_IT}"
    speed = chosen or usual.velocity
    ramp = None if acceleration is None else motion_unit(acceleration, scaling, 2)
    if ramp is None:
        ramp, doubt = _by_objects(read, scaling, 2)
        if ramp is None and doubt and not ambiguous:
            ambiguous = f"its unit of acceleration is not known: {doubt}; state acceleration_unit in [drive]"
    if ramp is None and maker is not None and (chosen is None or chosen.text == maker[1] or stated is not None):
        ramp = motion_unit(maker[2], scaling, 2, f"{maker[0]}'s manual, as no object states it")
    if ramp is None and chosen is not None:
        time = "2" if speed.text.endswith("/ms") else "/s"
        ramp = motion_unit(f"{speed.text}{time}", scaling, 2, "the unit of velocity, as no object states it")
    return MotionScaling(scaling, speed, ramp or usual.acceleration, ambiguous)


def _same(one: MotionUnit, other: MotionUnit) -> bool:
    return abs(one.counts - other.counts) <= _CONTRADICT * abs(other.counts)


def _by_objects(read: Callable[[Entry], int | None], scaling: AxisScaling, times: int) -> tuple[MotionUnit | None, str]:
    """The unit that the drive's objects state, None where they state none; and why it cannot be known, "" where it can."""
    si = objects.SI_UNIT_VELOCITY if times == 1 else objects.SI_UNIT_ACCELERATION
    code = read(si)
    found: list[MotionUnit] = []
    if code:
        text = si_text(code, times)
        if text is None:
            return None, f"{si.index:04X}h is {code:08X}h, which is no unit that is known here"
        found.append(motion_unit(text, scaling, times, f"{si.index:04X}h"))
    notation, dimension = (
        (objects.VELOCITY_NOTATION, objects.VELOCITY_DIMENSION)
        if times == 1
        else (objects.ACCELERATION_NOTATION, objects.ACCELERATION_DIMENSION)
    )
    index = read(dimension)
    if index:
        named = _DIMENSIONS[dimension].get(index)
        if named is None:
            return None, f"{dimension.index:04X}h is {index:02X}h, which is no dimension that is known here"
        factor = Fraction(10) ** (read(notation) or 0)
        text = named if factor == 1 else f"{factor} {named}"
        found.append(motion_unit(text, scaling, times, f"{notation.index:04X}h and {dimension.index:04X}h"))
    factors: Sequence[Sequence[Entry]] = (
        (objects.VELOCITY_FACTOR, objects.VELOCITY_FACTOR_NEW) if times == 1 else (objects.ACCELERATION_FACTOR,)
    )
    for above, below in factors:
        ratio = _ratio(read, above, below)
        if ratio is not None and ratio != 1:
            text = f"{ratio} counts/s{'' if times == 1 else '2'}"
            found.append(motion_unit(text, scaling, times, f"{above.index:04X}h"))
    if times == 1 and not found:
        speed, place = (
            _ratio(read, objects.VELOCITY_ENCODER_INCREMENTS, objects.VELOCITY_ENCODER_REVOLUTIONS),
            _ratio(read, objects.ENCODER_INCREMENTS, objects.ENCODER_REVOLUTIONS),
        )
        if speed and place and speed > 1 and speed != place:
            return None, f"6090h has {speed} increments per revolution, 608Fh {place}"
    for other in found[1:]:
        if not _same(found[0], other):
            return None, f"{found[0].source} says {found[0].text}, {other.source} says {other.text}"
    return (found[0] if found else None), ""


def si_text(code: int, times: int) -> str | None:
    """The unit that 60A9h (times 1) or 60AAh (2) names, as `motion_unit` reads it; None for one that is not known here."""
    exponent = code >> 24 & 0xFF
    base = _SI_BASES.get(code >> 16 & 0xFF)
    divisors: list[str] = []
    for byte in (code >> 8 & 0xFF, code & 0xFF):
        if byte and byte not in _SI_TIMES:
            return None
        divisors += _SI_TIMES.get(byte, ())
    if base is None or len(divisors) + (base == "rpm") != times:
        return None
    factor = Fraction(10) ** (exponent - 0x100 if exponent & 0x80 else exponent)
    text = "/".join((base, *divisors))
    return text if factor == 1 else f"{factor} {text}"
