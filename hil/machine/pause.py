"""A lost signal in the middle of a measurement: the axis stands, someone clears the beam, and the point is measured again.

What was lost with the signal is the instrument's zero, so the datum is taken anew before anything is measured. The axis moves again by
itself: that is done only where the axis file allows it ([instrument] resume_within_s), for there may be a hand in the beam.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import TypeVar

from drivers.drive import DriveState
from drivers.errors import MeasurementLostError
from hil.machine.one_correction import refuse_while_drive_corrects
from hil.machine.session import AxisSession

STEADY_S = 1.0
"""How long the signal has to be good without a break before it is believed."""
MOST_LOSSES = 3
"""So often the signal may be lost on the way to one point and at it. The first loss may be anybody's hand, the second the hand that
was not quite away; a beam that is lost a third time is cut off there by the machine itself (a cover, a cable, the pitch of the table),
and each further try would move the axis by itself for nothing."""

T = TypeVar("T")


def resuming(session: AxisSession, measure: Callable[[], T], tell: Callable[[str], None]) -> T:
    """What `measure` returns; after a lost signal it is called again, from a new datum, if that comes back in time.

    measure: of one point. tell: hears what was lost and when it went on. Raises the MeasurementLostError for a session without
    `resume_within_s`, when the signal does not come back within that, or when it is lost for the time `MOST_LOSSES`; whatever the
    drive raises meanwhile, at once.
    """
    for times in count(1):
        try:
            return measure()
        except MeasurementLostError as lost:
            if session.resume_within_s is None:
                raise
            if times == MOST_LOSSES:
                raise MeasurementLostError(
                    f"{lost}; it was lost {times} times on the way to the same point, which is not tried again: see what cuts the"
                    " beam off there"
                ) from lost
            tell(f"{lost}; waiting up to {session.resume_within_s:g} s for it")
            _await_signal(session, session.resume_within_s, lost)
            tell("signal back; datum taken anew")
    raise AssertionError("count does not end")


def _await_signal(session: AxisSession, within_s: float, lost: MeasurementLostError) -> None:
    """Until the signal was good for STEADY_S and the datum was taken; one that is lost again meanwhile is waited for as well."""
    deadline = session.clock.deadline(within_s)
    while True:
        try:
            session.acknowledge_loss()
            session.watch(STEADY_S)
            if session.drive.sample().state is not DriveState.ENABLED:
                session.drive.disable()  # out of the quick stop, which holds it
                session.drive.enable()
            refuse_while_drive_corrects(session.drive)
            session.take_datum(signal_was_lost=True)
        except MeasurementLostError:
            if deadline.expired:
                raise lost from None
        else:
            return
