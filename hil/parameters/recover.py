"""Going on from a journal: finish a download that was cut off, or have everything as it was before it.

What may go in: what may still be done to a drive nobody has seen since. It may hold old and new values, or others if it was without
power meanwhile; in the end it holds one side entirely, and has shown it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from drivers.errors import InputError, StateError
from drivers.raw_parameters import RawParameters, Steps
from hil.parameters.download import keep
from hil.parameters.journal import Download, Journal, Phase
from hil.parameters.preflight import objection_to_state, objections_to_identity
from hil.parameters.report import Ending, JobReport
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.transaction import DriveJob
from hil.parameters.works import Progress, Work, reports_of, stage, unseen


@dataclass
class Unfinished:
    """A drive whose journal has a download without an end."""

    drive: RawParameters
    journal: Journal


def recover(targets: Sequence[Unfinished], *, forward: bool, progress: Progress = unseen) -> list[JobReport]:
    """Finish (forward) or undo the unfinished download of each drive. The drive must be the one it was begun with.

    Never raises for what a drive or its wire does; then the job stays unfinished and can be tried again. Raises InputError where a
    journal cannot be read or the drive's file does not know its parameters.
    """
    works = []
    for target in targets:
        noted = target.journal.unfinished()
        if noted is not None:
            works.append(_work(target, noted, forward))
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


def _work(target: Unfinished, noted: Download, forward: bool) -> Work:
    work = Work(target.drive, target.journal, DriveJob(target.drive), noted=noted, meant_back=not forward)
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


def _finish(work: Work, forward: bool) -> Steps[None]:
    noted = work.noted
    if noted is None:
        return
    yield from _check(work, noted)
    goals = work.new if forward else work.old
    if not forward:
        work.note(Phase.GOING_BACK)
    written = yield from work.job.settle_at(goals, work.after)
    if forward:
        work.note(Phase.PROVEN)
    work.starts = work.drive.restarts
    if _stores(noted, forward, bool(written)):
        yield from keep(work, goals)
    ending = Ending.WRITTEN if forward else Ending.PUT_BACK
    work.note(Phase.END, ending=ending.name)
    work.ending = ending


def _check(work: Work, noted: Download) -> Steps[None]:
    identity = yield from work.drive.identify()
    objections = objections_to_identity(noted.identity, identity, same_unit=True)
    objection = objection_to_state((yield from work.drive.state()))
    if objection is not None:
        objections.append(objection)
    if objections:
        work.objections += objections
        raise StateError(f"drive {work.drive.name} is not as the download left it")


def _stores(noted: Download, forward: bool, written: bool) -> bool:
    """Forward: when it was asked for and is not done. Back: when the drive may have kept what is now undone."""
    if not forward:
        return noted.may_have_stored
    return noted.store and (written or Phase.STORED not in noted.phases)


def set_before(noted: Download) -> ParameterSet:
    """What a drive held before a download, as a set."""
    return _side(noted, f"before {noted.set_name}", before=True)


def set_after(noted: Download) -> ParameterSet:
    """What a download wrote."""
    return _side(noted, noted.set_name, before=False)


def _side(noted: Download, name: str, *, before: bool) -> ParameterSet:
    entries = tuple(
        SetEntry(each.address, None, (each.old if before else each.new).hex(), name=each.name, after=each.after)
        for each in noted.parameters
    )
    return ParameterSet(name, noted.identity, entries)
