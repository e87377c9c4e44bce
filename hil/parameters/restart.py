"""Restarting drives: the audit of what they have stored, and the return to their factory defaults."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.errors import CapabilityError, NoAnswerError, RemoteError, StateError, TransportError
from drivers.raw_parameters import Pause, RawParameters, Steps
from hil.parameters.preflight import objection_to_state
from hil.parameters.tasks import Progress, no_progress, run_together, serialized, stage
from hil.parameters.transaction import DriveTask, ended_in

Ask = Callable[[str], None]
"""ask(what): asks a person to do something and returns at once; the drive shows when it was done."""

PERSON_S = 300.0
"""Time limit for a person to switch a drive off or on, s."""
START_S = 15.0
"""Time limit for a drive to answer after its start, s."""
_LOOK_S = 0.2
"""Interval between requests meanwhile, s."""


def audit(works: Sequence[DriveTask], ask: Ask, progress: Progress = no_progress) -> None:
    """Restart every drive and compare. Results are in each task's `audited`, `lost` and `error`."""
    ask = serialized(ask)
    for work in works:
        work.audited = False
    stage(works, "restart", lambda _work: 1, lambda work: restart_drive(work.drive, ask), progress)
    stage([work for work in works if not work.error], "audit", lambda work: len(work.new), _compare, progress)


def restart_drive(drive: RawParameters, ask: Ask) -> Steps[None]:
    """Restart a drive by command, or by a person where it cannot; ends when it answers. Raises NoAnswerError when it does not in
    time."""
    try:
        yield from drive.restart()
    except CapabilityError:
        ask(f"drive {drive.name}: switch it off and on again")
        yield from _until(drive, False, PERSON_S)
        yield from _until(drive, True, PERSON_S)
    else:
        yield from _until(drive, True, START_S)


def _until(drive: RawParameters, answers: bool, within_s: float) -> Steps[None]:
    """Wait until a drive answers, or until it does not. Raises NoAnswerError after `within_s`."""
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


def _compare(work: DriveTask) -> Steps[None]:
    shown = yield from work.drive.show(list(work.new), work.done)
    work.lost = [address for address, data in work.new.items() if not work.drive.shows(address, shown[address], data)]
    work.audited = not work.lost


# -- factory defaults --------------------------------------------------------------------------------------------------
def load_defaults(drives: Sequence[RawParameters], ask: Ask) -> list[str]:
    """Load the factory defaults (1011h) and restart the drives; returns the error of each, "" for none. Only a backup can undo it."""
    ask = serialized(ask)
    errors = run_together(drives, lambda drive: drive, lambda drive: _load(drive, ask))
    return ["" if error is None else ended_in(error) for error in errors]


def _load(drive: RawParameters, ask: Ask) -> Steps[None]:
    objection = objection_to_state((yield from drive.state()))
    if objection is not None:
        raise StateError(f"drive {drive.name}: {objection.why}")
    yield from drive.load_defaults()
    yield from restart_drive(drive, ask)
