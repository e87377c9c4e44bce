"""Resuming after a lost signal: the axis stands until the signal is back, the datum is taken anew, and the point is measured again.

The datum is taken anew because the instrument loses its zero with the signal. The axis then moves without an operator's command, and a
hand may be in the beam: this is done only where the axis file allows it ([instrument] resume_within_s).
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
"""Time for which the signal must be good without a break before it is used, s."""
MOST_LOSSES = 3
"""Losses at one point after which it is not tried again. A hand in the beam explains one or two; a third loss at the same point is
likely caused by the machine (a cover, a cable, the pitch of the table), and each further try would move the axis without an
operator."""

T = TypeVar("T")


def retry_after_signal_loss(session: AxisSession, measure: Callable[[], T], tell: Callable[[str], None]) -> T:
    """Returns what `measure` returns. After a lost signal that comes back in time, `measure` is called again, from a new datum.

    measure: measures one point; tell: called with a message at each loss and resume. Raises MeasurementLostError in a session without
    `resume_within_s`, when the signal does not come back within that, at the loss number `MOST_LOSSES`, and at once where the readings
    disagree with the motor. Errors of the drive are raised at once.
    """
    for times in count(1):
        try:
            return measure()
        except MeasurementLostError as lost:
            if session.resume_within_s is None or lost.followed_ns is not None:
                raise  # readings that disagree with the motor do not come back, and rows before may be wrong
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
    """Wait until the signal was good for `STEADY_S`, then take the datum. A signal that is lost again meanwhile is waited for too."""
    deadline = session.clock.deadline(within_s)
    while True:
        try:
            session.acknowledge_loss()
            session.watch(STEADY_S)
            if session.drive.sample().state is not DriveState.ENABLED:
                session.drive.disable()  # a quick stop holds the drive until it is disabled
                session.drive.enable()
            refuse_while_drive_corrects(session.drive)
            session.take_datum(signal_was_lost=True)
        except MeasurementLostError:
            if deadline.expired:
                raise lost from None
        else:
            return
