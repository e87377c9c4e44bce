"""A download of sets to one or several drives, all or nothing over all of them, in stages:

    look      identity, state, snapshot, check of every entry         any objection ends the download before the first write
    write     entries that differ, in order, read back                on any failure every drive is put back
    store     the drives store what they hold                         only on request, after everything was read back
    audit     restart the drives and read everything again            only on request

Drives on different lines, and on one line as far as it allows, are served side by side (`tasks`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from drivers.drive import DriveState
from drivers.errors import AbortError, BridgeError, CapabilityError, InputError, LinkLostError, StateError
from drivers.raw_parameters import Steps
from hil.parameters.journal import DownloadPhase, Noted
from hil.parameters.preflight import (
    Objection,
    left_out,
    match_set,
    notes_of_file,
    notes_of_units,
    objection_to_state,
    objections_to_file,
    objections_to_identity,
    objections_to_reversal,
    unless_held,
)
from hil.parameters.report import Ending, JobReport
from hil.parameters.restart import Ask, audit
from hil.parameters.tasks import Progress, no_progress, reports_of, stage
from hil.parameters.transaction import DriveTask, Target, ended_in


def download(
    targets: Sequence[Target], *, store: bool = False, ask: Ask | None = None, progress: Progress = no_progress
) -> list[JobReport]:
    """Write every target's set, all or nothing over all of them.

    store: the drives store it afterwards; ask: audit what was stored by a restart, asking a person for what a drive cannot do itself.
    Errors of a drive or its wire are in the reports. Raises InputError where an earlier download of a target is not finished, or the
    journal cannot be written before the first write. KeyboardInterrupt is raised after everything was put back.
    """
    works = [DriveTask(each) for each in targets]
    for work in works:
        refuse_unfinished(work)
        work.began_ns = work.drive.clock.now_ns()
    stage(works, "look", lambda work: len(work.target.contents.entries), partial(_look, store=store), progress)
    if any(work.objections or work.error for work in works):
        for work in works:
            work.ending = Ending.REFUSED
        return reports_of(works)
    _begin(works, store)
    changing = [work for work in works if work.noted is not None]
    try:
        stage(changing, "write", lambda work: 2 * len(work.differing()), _write, progress)
    except KeyboardInterrupt:
        stage(changing, "put back", lambda work: len(work.old), put_back, progress)
        raise
    for work in changing:
        if work.drive.restarts != work.starts:
            work.fail(LinkLostError(f"drive {work.drive.name} restarted before all of it was proven"))
    if any(work.error for work in changing):
        stage(changing, "put back", lambda work: len(work.old), put_back, progress)
        for work in works:
            work.ending = work.ending or Ending.UNCHANGED
        return reports_of(works)
    if store:
        stage(changing, "store", lambda _work: 1, _keep, progress)
    for work in works:
        _end(work)
    if ask is not None:
        audit([work for work in works if work.stored], ask, progress)
    return reports_of(works)


def refuse_unfinished(work: DriveTask) -> None:
    """Raises InputError where an interrupted download is not finished."""
    unfinished = work.journal.unfinished()
    if unfinished is not None:
        raise InputError(
            f"drive {work.drive.name}: the download begun {unfinished.began} is not finished, expected `hil params resume`"
            " or `hil params rollback` first",
            path=unfinished.path,
        )


# -- the stages of one drive -------------------------------------------------------------------------------------------
def _look(work: DriveTask, store: bool) -> Steps[None]:
    drive, contents = work.drive, work.target.contents
    wanted, work.objections = match_set(drive, contents)
    for each in wanted:
        work.parameters[each.address] = each.parameter
        work.new[each.address] = each.data
        work.after[each.address] = each.after
    work.identity = yield from drive.identify()
    work.objections += objections_to_identity(contents.identity, work.identity, any_version=work.target.any_version)
    differing = objections_to_file(drive, work.identity)
    if work.target.other_eds:
        work.notes += [each.why for each in differing]
    else:
        work.objections += differing
    omitted = left_out(drive, contents)
    work.notes += [omitted] if omitted else []
    work.notes += notes_of_file(drive)
    objection = objection_to_state((yield from drive.state()))
    if objection is not None:
        work.objections.append(objection)
    if store:
        why = yield from drive.objection_to_store()
        if why is not None:
            work.objections.append(Objection("", "", why))
    yield from snapshot(work)
    work.objections = unless_held(drive, work.objections, wanted, work.old)
    tables = work.target.tables
    if tables is not None:
        work.objections += objections_to_reversal(drive, tables, work.target.backlash, wanted, work.old)
        work.notes += notes_of_units(drive, tables, wanted)


def snapshot(work: DriveTask) -> Steps[None]:
    """Read the present values of the wanted parameters. One that cannot be read becomes an objection.

    Raises LinkLostError when the drive restarts meanwhile.
    """
    work.starts = work.drive.restarts
    accesses = yield from work.drive.read(list(work.new), work.done)
    for access in accesses:
        if access.data is not None:
            work.old[access.address] = access.data
        elif access.error is not None:
            name = work.parameters[access.address].info.name
            work.objections.append(Objection(access.address, name, f"cannot be read: {ended_in(access.error)}"))
    if work.drive.restarts != work.starts:
        raise LinkLostError(f"drive {work.drive.name} restarted while it was read")


def _begin(works: Sequence[DriveTask], store: bool) -> None:
    """Write the journal of every drive before the first write to any."""
    for work in works:
        if work.identity is None or not (work.differing() or store):
            work.ending = Ending.UNCHANGED
            continue
        noted = [
            Noted(address, parameter.info.name, work.old[address], work.new[address], tuple(work.after[address]))
            for address, parameter in work.parameters.items()
        ]
        contents = work.target.contents
        work.noted = work.journal.begin(
            work.drive.name, contents.name, contents.digest(), work.identity, noted, store=store
        )


def _write(work: DriveTask) -> Steps[None]:
    yield from work.bring(work.new, work.old, starts=work.starts)
    work.note(DownloadPhase.PROVEN)


def put_back(work: DriveTask) -> Steps[None]:
    """Write the old values and read them back. Where that fails the download stays unfinished."""
    try:
        work.note(DownloadPhase.GOING_BACK)
    except InputError as error:  # the disk is full: no reason to leave the drive as it is
        work.notes.append(ended_in(error))
    work.ending = Ending.UNFINISHED
    try:
        yield from work.settle_at(work.old)
    except BridgeError as error:
        work.notes.append(f"it could not be put back: {ended_in(error)}")
        return
    work.note(DownloadPhase.END, ending=Ending.PUT_BACK.name)
    work.ending = Ending.PUT_BACK


def _keep(work: DriveTask) -> Steps[None]:
    try:
        yield from keep(work, work.new)
    except (AbortError, CapabilityError, StateError) as error:  # the drive refused, so its state is known
        work.not_kept = ended_in(error)


def keep(work: DriveTask, goals: Mapping[str, bytes]) -> Steps[None]:
    """Have a disabled drive store the goals, which it holds. Raises StateError for an enabled drive, and what storing raises.

    A drive that restarted since the goals were read back may have stored something else: then they are read again, and ProtocolError
    is raised where it no longer holds them.
    """
    drive = work.drive
    state: DriveState = yield from drive.state()
    objection = objection_to_state(state)
    if objection is not None:
        raise StateError(f"drive {drive.name}: {objection.why}; it was not stored")
    work.note(DownloadPhase.STORING)
    refusal: BridgeError | None = None
    try:
        yield from drive.store()
    except (AbortError, CapabilityError) as error:
        refusal = error
    if drive.restarts != work.starts or not drive.hears_restarts:
        yield from drive.prove(goals, work.done, work.settle_s)
    if refusal is not None:
        raise refusal
    work.stored = True
    work.note(DownloadPhase.STORED)


def _end(work: DriveTask) -> None:
    """Set the ending after everything was read back. A store without an answer leaves the download unfinished; it can be resumed."""
    if work.error:
        work.ending = Ending.UNFINISHED
        work.notes.append("everything is written and was read back; whether the drive keeps it is not known")
        return
    work.ending = Ending.WRITTEN if work.differing() else Ending.UNCHANGED
    work.note(DownloadPhase.END, ending=work.ending.name)
    if work.not_kept:
        work.fail(StateError(f"it was not stored: {work.not_kept}"))
