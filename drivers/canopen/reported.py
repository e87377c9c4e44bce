"""Every way in which a CiA-402 drive may mean what it says of its units.

Pure. By the standard the position on the wire (6064h) is internal increments · feed / (encoder resolution · gear ratio), in the unit
that 60A8h names, and the feed (6092h) is in the same unit (IEC 61800-7-201, factor group). Where 60A8h names a length, nothing is
left open. Where it names increments, or is missing, drives differ: some keep to that, and the feed is what the wire counts per
revolution of the driving shaft; others show the encoder's increments and keep the screw's lead in the feed, in µm.
"""

from __future__ import annotations

from fractions import Fraction

from drivers.scaling import ReportedScaling

UM_PER_MM = 1000


def readings(reported: ReportedScaling) -> tuple[ReportedScaling, ...]:
    """What `units.read_units` made of a drive's objects, and how else they may be meant, the likeliest first.

    A feed of 1 per revolution is a factory value and no feed.
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
