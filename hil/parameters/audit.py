"""Does a drive still hold what it was told to keep, once it has been without power?

What may go in: starting drives anew, by themselves or by a person's hand, and reading everything again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.errors import CapabilityError, NoAnswerError, RemoteError, TransportError
from drivers.raw_parameters import Pause, RawParameters, Steps
from hil.parameters.works import Progress, Work, one_at_a_time, stage, unseen

Ask = Callable[[str], None]
"""ask(what): tell a person what to do; it returns at once, the drive shows when it was done."""

PERSON_S = 300.0  # a person may take so long to walk to the switch
START_S = 15.0  # until a drive answers again after its start
_LOOK_S = 0.2


def audit(works: Sequence[Work], ask: Ask, progress: Progress = unseen) -> None:
    """Start every drive anew and compare; the works' `audited` and `lost` say what was found, `error` what went wrong."""
    ask = one_at_a_time(ask)
    for work in works:
        work.audited = False
    stage(works, "restart", lambda _work: 1, lambda work: restart_drive(work.drive, ask), progress)
    stage([work for work in works if not work.error], "audit", lambda work: len(work.new), _compare, progress)


def restart_drive(drive: RawParameters, ask: Ask) -> Steps[None]:
    """Start a drive anew, by itself or by a person's hand; returns when it answers again. Raises NoAnswerError."""
    try:
        yield from drive.restart()
    except CapabilityError:
        ask(f"drive {drive.name}: switch it off and on again")
        yield from _until(drive, False, PERSON_S)
        yield from _until(drive, True, PERSON_S)
    else:
        yield from _until(drive, True, START_S)


def _until(drive: RawParameters, answers: bool, within_s: float) -> Steps[None]:
    """Wait until a drive answers, or until it does not. Raises NoAnswerError when that does not come."""
    deadline = drive.clock.deadline(within_s)
    while True:
        try:
            yield from drive.state()
            found = True
        except TransportError:
            found = False
        except RemoteError:
            found = True
        if found is answers:
            return
        if deadline.expired:
            what = "does not answer after its restart" if answers else "was not switched off"
            raise NoAnswerError(f"drive {drive.name} {what} within {within_s:g} s")
        yield Pause(_LOOK_S)


def _compare(work: Work) -> Steps[None]:
    shown = yield from work.job.show(list(work.new))
    work.lost = [address for address, data in work.new.items() if not work.same(address, shown[address], data)]
    work.audited = not work.lost
