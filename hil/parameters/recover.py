"""Recovery of an interrupted download from its journal: finish it (resume), or restore the old values (rollback).

The drive may hold old and new values, or others if it was without power meanwhile. Afterwards it holds one side entirely, read back.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from drivers.errors import InputError, StateError
from drivers.raw_parameters import RawParameters, Steps
from hil.parameters.download import keep
from hil.parameters.journal import Download, DownloadPhase, Journal
from hil.parameters.preflight import objection_to_state, objections_to_identity
from hil.parameters.report import Ending, JobReport
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.tasks import Progress, no_progress, reports_of, stage
from hil.parameters.transaction import DriveTask, Target


def recover(
    drives: Sequence[tuple[RawParameters, Journal]], *, forward: bool, progress: Progress = no_progress
) -> list[JobReport]:
    """Finish (forward) or undo the unfinished download of each drive, which must be the same unit.

    After an error of a drive or its wire the download stays unfinished and can be recovered again; the report names the error. Raises
    InputError where a journal cannot be read, or the drive's file lacks one of its parameters.
    """
    works = []
    for drive, journal in drives:
        noted = journal.unfinished()
        if noted is not None:
            works.append(_work(Target(drive, set_after(noted), journal), noted, forward))
    stage(
        works,
        "resume" if forward else "put back",
        lambda work: len(work.new),
        partial(_finish, forward=forward),
        progress,
    )
    for work in works:
        if work.error:
            work.ending = Ending.UNFINISHED
    return reports_of(works)


def _work(target: Target, noted: Download, forward: bool) -> DriveTask:
    work = DriveTask(target, noted=noted, meant_back=not forward)
    work.began_ns = target.drive.clock.now_ns()
    for each in noted.parameters:
        parameter = target.drive.find(each.address)
        if parameter is None:
            raise InputError(
                f"was begun with {each.address} {each.name}, which the drive's file has no longer", path=noted.path
            )
        work.parameters[each.address] = parameter
        work.old[each.address], work.new[each.address] = each.old, each.new
        work.after[each.address] = each.after
    return work


def _finish(work: DriveTask, forward: bool) -> Steps[None]:
    noted = work.noted
    if noted is None:
        return
    yield from _check(work, noted)
    goals = work.new if forward else work.old
    if not forward:
        work.note(DownloadPhase.GOING_BACK)
    written = yield from work.settle_at(goals)
    if forward:
        work.note(DownloadPhase.PROVEN)
    work.starts = work.drive.restarts
    if _stores(noted, forward, bool(written)):
        yield from keep(work, goals)
    ending = Ending.WRITTEN if forward else Ending.PUT_BACK
    work.note(DownloadPhase.END, ending=ending.name)
    work.ending = ending


def _check(work: DriveTask, noted: Download) -> Steps[None]:
    identity = yield from work.drive.identify()
    objections = objections_to_identity(noted.identity, identity, same_unit=True)
    objection = objection_to_state((yield from work.drive.state()))
    if objection is not None:
        objections.append(objection)
    if objections:
        work.objections += objections
        raise StateError(f"drive {work.drive.name} is not as the download left it")


def _stores(noted: Download, forward: bool, written: bool) -> bool:
    """Whether to store. Forward: when it was requested and is not done. Back: when the drive may have stored the new values."""
    if not forward:
        return noted.may_have_stored
    return noted.store and (written or DownloadPhase.STORED not in noted.phases)


def set_before(noted: Download) -> ParameterSet:
    return _side(noted, f"before {noted.set_name}", before=True)


def set_after(noted: Download) -> ParameterSet:
    return _side(noted, noted.set_name, before=False)


def _side(noted: Download, name: str, *, before: bool) -> ParameterSet:
    entries = tuple(
        SetEntry(each.address, None, (each.old if before else each.new).hex(), name=each.name, after=each.after)
        for each in noted.parameters
    )
    return ParameterSet(name, noted.identity, entries)
