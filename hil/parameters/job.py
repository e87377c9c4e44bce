"""Whole sets of drives' parameters: backed up, compared, written all or nothing, kept, and finished or taken back after a cut.

Functions of several axes are what the command line works with; the jobs at the end are for the desk and one axis. No drive is opened
for motion, so each of them connects by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from drivers.clock import Waiting
from drivers.errors import InputError, StateError
from hil.app.jobs.job import Job, Workplace
from hil.app.jobs.plan import Plan, Write
from hil.axis.axis_file import DriveAxis
from hil.correction.sealed import check_detached, load_public_key
from hil.machine.events import Event
from hil.parameters.audit import Ask
from hil.parameters.compare import Comparison, compare
from hil.parameters.download import Target, download
from hil.parameters.formats import read_any, write_any
from hil.parameters.journal import Download, Journal
from hil.parameters.recover import Unfinished, recover, set_after, set_before
from hil.parameters.report import Ending, JobReport
from hil.parameters.set_file import ParameterSet
from hil.parameters.snapshot import Backup, back_up
from hil.parameters.wiring import connected_parameters, journal_of
from hil.parameters.works import Progress, unseen
from hil.records.files import naming, read_bytes

BACKUP, COMPARE, VERIFY = "parameters backup", "parameters compare", "parameters verify"
DOWNLOAD, STORE, RESTORE = "parameters download", "parameters store", "parameters restore"
RESUME, ROLLBACK = "parameters resume", "parameters rollback"


# -- sets ----------------------------------------------------------------------------------------------------------------
def load_set(path: str | Path, axis: DriveAxis, *, signed: bool = False) -> ParameterSet:
    """A set's file, its builder's signature checked where there is one. Raises InputError, and SealedError for a wrong signature."""
    check_signature(Path(path), axis, demanded=signed)
    return read_any(path)


def check_signature(path: Path, axis: DriveAxis, *, demanded: bool) -> None:
    """Raise unless the signature beside a file is the builder's, or there is none and none is demanded."""
    beside = path.with_name(f"{path.name}.sig")
    if not beside.exists():
        if demanded:
            raise InputError(f"has no signature beside it, expected {beside.name} (`hil sign`)", path=path)
        return
    public = load_public_key(axis.store.builder_public)
    with naming(beside):
        check_detached(read_bytes(path), read_bytes(beside), public)


def set_before_last(axis: DriveAxis) -> ParameterSet:
    """What the drive held before the last download that changed something. Raises InputError where there is none, or put back."""
    journal = journal_of(axis)
    return set_before(_ended_well(axis, journal, journal.last_change()))


def set_of_last(axis: DriveAxis) -> ParameterSet:
    """What the last download wrote. Raises InputError where there is none, or it was put back."""
    journal = journal_of(axis)
    return set_after(_ended_well(axis, journal, journal.last()))


def _ended_well(axis: DriveAxis, journal: Journal, last: Download | None) -> Download:
    if last is None:
        raise InputError(f"has no download of {axis.name} in its journal, expected --set FILE", path=journal.folder)
    if last.finished and last.ending not in (Ending.WRITTEN.name, Ending.UNCHANGED.name):
        raise InputError("ended with everything put back, expected --set FILE", path=last.path)
    return last


# -- several axes --------------------------------------------------------------------------------------------------------
def back_up_axes(
    axes: Sequence[DriveAxis],
    paths: Sequence[Path],
    form: str | None = None,
    *,
    everything: bool = False,
    progress: Progress = unseen,
    waiting: Waiting | None = None,
) -> list[Backup]:
    """Read every parameter that can be put back of each drive, into a file each; a drive that could not be read has none."""
    with connected_parameters(axes, waiting) as drives:
        backups = back_up(drives, everything=everything, progress=progress)
    for axis, path, backup in zip(axes, paths, backups, strict=True):
        if backup.contents is not None:
            write_any(path, backup.contents, backup.drive, form, axis.drive.eds)
    return backups


def compare_axes(
    axes: Sequence[DriveAxis],
    sets: Sequence[ParameterSet],
    *,
    any_version: bool = False,
    progress: Progress = unseen,
    waiting: Waiting | None = None,
) -> list[Comparison]:
    """Each drive against its set; nothing is written."""
    with connected_parameters(axes, waiting) as drives:
        return compare(list(zip(drives, sets, strict=True)), any_version=any_version, progress=progress)


def write_axes(
    axes: Sequence[DriveAxis],
    sets: Sequence[ParameterSet],
    *,
    store: bool = False,
    ask: Ask | None = None,
    any_version: bool = False,
    progress: Progress = unseen,
    waiting: Waiting | None = None,
) -> list[JobReport]:
    """Write to each drive its set, all or nothing over all of them; store, ask: as for `download`."""
    with connected_parameters(axes, waiting) as drives:
        targets = [
            Target(drive, contents, journal_of(axis), any_version)
            for drive, contents, axis in zip(drives, sets, axes, strict=True)
        ]
        return download(targets, store=store, ask=ask, progress=progress)


def recover_axes(
    axes: Sequence[DriveAxis], *, forward: bool, progress: Progress = unseen, waiting: Waiting | None = None
) -> list[JobReport]:
    """Finish (forward) or take back the downloads that were cut off; empty where none was."""
    cut_off = [axis for axis in axes if unfinished(axis) is not None]
    if not cut_off:
        return []
    with connected_parameters(cut_off, waiting) as drives:
        targets = [Unfinished(drive, journal_of(axis)) for drive, axis in zip(drives, cut_off, strict=True)]
        return recover(targets, forward=forward, progress=progress)


def unfinished(axis: DriveAxis) -> Download | None:
    """The download that was cut off and has to be finished or taken back first."""
    return journal_of(axis).unfinished()


# -- for the desk: one axis ----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class BackedUp:
    """A backup's file, how many parameters are in it, and how many the drive did not show."""

    path: Path
    parameters: int
    unreadable: int


def backup_job(axis: DriveAxis) -> Job:
    """Returns a BackedUp: a new file in the axis's folder, named by the time."""
    stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    path = axis.path.resolve().parent / f"{axis.name}-{stamp}.params.toml"

    def work(place: Workplace) -> BackedUp:
        (backup,) = back_up_axes([axis], [path], progress=_told(place), waiting=place.waiting)
        if backup.contents is None:
            raise StateError(backup.error)
        return BackedUp(path, len(backup.contents.entries), len(backup.unreadable or {}))

    return _job(axis, BACKUP, [Write("file", str(path))], work, locked=False)


def compare_job(axis: DriveAxis, contents: ParameterSet, kind: str = COMPARE) -> Job:
    """Returns a Comparison of the drive with a set; kind: COMPARE or VERIFY. Writes nothing."""

    def work(place: Workplace) -> Comparison:
        return _compared(axis, contents, place)

    return _job(axis, kind, [], work, locked=False)


def _compared(axis: DriveAxis, contents: ParameterSet, place: Workplace) -> Comparison:
    (found,) = compare_axes([axis], [contents], progress=_told(place), waiting=place.waiting)
    if found.error:
        raise StateError(found.error)
    return found


def download_job(axis: DriveAxis, contents: ParameterSet) -> Job:
    """Returns a JobReport: the set written where it differs and read back, or everything as before."""
    return _writing(axis, DOWNLOAD, contents, [Write("parameters", contents.name)])


def store_job(axis: DriveAxis, contents: ParameterSet) -> Job:
    """Returns a JobReport: the drive keeps what it holds, if that is the set; else it is refused and nothing is done."""

    def work(place: Workplace) -> JobReport:
        if not _compared(axis, contents, place).same:
            raise StateError("the drive does not hold this set: it was not told to keep it")
        (report,) = write_axes([axis], [contents], store=True, progress=_told(place), waiting=place.waiting)
        return report

    return _job(axis, STORE, [Write("kept", contents.name)], work)


def restore_job(axis: DriveAxis) -> Job:
    """Returns a JobReport: as it was before the last download. Raises InputError where there is none."""
    contents = set_before_last(axis)
    return _writing(axis, RESTORE, contents, [Write("parameters_back", contents.name)])


def _writing(axis: DriveAxis, kind: str, contents: ParameterSet, writes: Sequence[Write]) -> Job:
    def work(place: Workplace) -> JobReport:
        (report,) = write_axes([axis], [contents], progress=_told(place), waiting=place.waiting)
        return report

    return _job(axis, kind, writes, work)


def recover_job(axis: DriveAxis, *, forward: bool) -> Job:
    """Returns a JobReport: what was cut off is finished, or taken back. Raises StateError where nothing was."""
    cut_off = unfinished(axis)
    if cut_off is None:
        raise StateError("nothing to do: no download was cut off")

    def work(place: Workplace) -> JobReport:
        (report,) = recover_axes([axis], forward=forward, progress=_told(place), waiting=place.waiting)
        return report

    write = Write("parameters" if forward else "parameters_back", cut_off.set_name)
    return _job(axis, RESUME if forward else ROLLBACK, [write], work)


def _job(
    axis: DriveAxis, kind: str, writes: Sequence[Write], work: Callable[[Workplace], object], *, locked: bool = True
) -> Job:
    plan = Plan(axis.name, axis.drive.backend, writes=tuple(writes), locked=locked)
    return Job(kind, plan, work, connects=True)


def _told(place: Workplace) -> Progress:
    """Progress as events; between two accesses somebody may stop it, also where no answer is waited for."""

    def told(stage: str, drive: str, done: int, total: int) -> None:
        place.listener(Event(stage, drive, done, total))
        place.waiting.real(0.0)

    return told
