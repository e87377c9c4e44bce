"""Jobs on parameter sets: list, backup, compare, download, store, restore, resume and rollback.

Functions of several axes are for the command line; the jobs are for the screen and one axis; `set_files` and `keep_set` are the files
that the screen offers. No drive is opened for motion, so each function connects by itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from datetime import datetime
from functools import partial
from pathlib import Path

from drivers.errors import InputError, StateError
from drivers.files import encoding_of, read_bytes, replace_file
from drivers.raw_parameters import RawParameters
from hil.axis.axis_file import DriveAxis
from hil.axis.backlash import object_key
from hil.correction.sealed import check_detached, load_public_key
from hil.correction.store import bound_tables
from hil.desk.job import Job, Workplace
from hil.desk.plan import Plan, PlannedWrite
from hil.machine.events import Event
from hil.parameters import FORMATS
from hil.parameters.compare import Comparison, compare
from hil.parameters.download import download
from hil.parameters.formats import read_any, write_any
from hil.parameters.journal import Download, Journal
from hil.parameters.listing import Listing, listing_of
from hil.parameters.outcome import BackedUp, keep_outcome
from hil.parameters.recover import recover, set_after, set_before
from hil.parameters.report import Ending, JobReport
from hil.parameters.restart import Ask
from hil.parameters.set_file import FORMAT, ParameterSet, object_address
from hil.parameters.snapshot import Backup, back_up
from hil.parameters.tasks import Progress, no_progress
from hil.parameters.transaction import Target
from hil.parameters.wiring import connected_parameters, journal_of
from hil.records.files import naming

READ = "parameters read"
BACKUP, COMPARE, VERIFY = "parameters backup", "parameters compare", "parameters verify"
DOWNLOAD, STORE, RESTORE = "parameters download", "parameters store", "parameters restore"
RESUME, ROLLBACK = "parameters resume", "parameters rollback"

Connect = Callable[[Sequence[DriveAxis]], AbstractContextManager[list[RawParameters]]]
"""Connects the parameters of each axis's drive."""


# -- sets ----------------------------------------------------------------------------------------------------------------
def load_set(path: str | Path, axis: DriveAxis, *, signed: bool = False, pdos: bool = True) -> ParameterSet:
    """Read a set; a signature beside it is checked. signed: there must be one; pdos: as for `read_any`.

    Raises InputError for a wrong file or a missing signature, SealedError for a wrong signature.
    """
    check_signature(Path(path), axis, demanded=signed)
    return read_any(path, axis.drive.node_id if axis.drive.backend != "modbus" else None, pdos=pdos)


def check_signature(path: Path, axis: DriveAxis, *, demanded: bool) -> None:
    """Check the signature beside a file. Raises SealedError unless it is the builder's, InputError where it is demanded and
    missing."""
    beside = path.with_name(f"{path.name}.sig")
    if not beside.exists():
        if demanded:
            raise InputError(f"has no signature beside it, expected {beside.name} (`hil sign`)", path=path)
        return
    public = load_public_key(axis.store.builder_public)
    with naming(beside):
        check_detached(read_bytes(path), read_bytes(beside), public)


def set_before_last(axis: DriveAxis) -> ParameterSet:
    """The values before the last download that changed something. Raises InputError where there is none, or it was put back."""
    journal = journal_of(axis)
    return set_before(_ended_well(axis, journal, journal.last_change()))


def set_of_last(axis: DriveAxis) -> ParameterSet:
    """The set of the last download. Raises InputError where there is none, or it was put back."""
    journal = journal_of(axis)
    return set_after(_ended_well(axis, journal, journal.last()))


_ANOTHER = "expected a set: --set FILE, in a script download(FILE)"


def _ended_well(axis: DriveAxis, journal: Journal, last: Download | None) -> Download:
    if last is None:
        raise InputError(f"has no download of {axis.name} in its journal, {_ANOTHER}", path=journal.folder)
    if last.finished and last.ending not in (Ending.WRITTEN.name, Ending.UNCHANGED.name):
        raise InputError(f"ended with everything put back, {_ANOTHER}", path=last.path)
    return last


# -- several axes --------------------------------------------------------------------------------------------------------
def back_up_axes(
    axes: Sequence[DriveAxis],
    paths: Sequence[Path],
    form: str | None = None,
    *,
    everything: bool = False,
    progress: Progress = no_progress,
    connect: Connect = connected_parameters,
) -> list[Backup]:
    """Read every writable parameter of each drive into a file each. A drive that could not be read has no file.

    form: None, by each file's suffix; everything: also read-only parameters. Raises what connecting raises, and as `write_any`.
    """
    with connect(axes) as drives:
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
    progress: Progress = no_progress,
    connect: Connect = connected_parameters,
) -> list[Comparison]:
    """Compare each drive with its set; nothing is written. Raises what connecting raises."""
    with connect(axes) as drives:
        return compare(list(zip(drives, sets, strict=True)), any_version=any_version, progress=progress)


def write_axes(
    axes: Sequence[DriveAxis],
    sets: Sequence[ParameterSet],
    *,
    store: bool = False,
    ask: Ask | None = None,
    any_version: bool = False,
    other_eds: bool = False,
    progress: Progress = no_progress,
    connect: Connect = connected_parameters,
) -> list[JobReport]:
    """Write each drive's set, all or nothing over all of them. store, ask: as for `download`; any_version, other_eds: as for `Target`.
    Raises as `download`, and connecting."""
    with connect(axes) as drives:
        targets = [
            Target(
                drive, contents, journal_of(axis), any_version, other_eds, bound_tables(axis), backlash_addresses(axis)
            )
            for drive, contents, axis in zip(drives, sets, axes, strict=True)
        ]
        return download(targets, store=store, ask=ask, progress=progress)


def backlash_addresses(axis: DriveAxis) -> tuple[str, ...]:
    """Addresses of the drive's own backlash compensation, as the axis file names it."""
    named = () if axis.backlash is None else (axis.backlash.parameter, axis.backlash.acceleration)
    keys = {name: object_key(name) for name in named if name is not None}
    return tuple(name if key is None else object_address(*key) for name, key in keys.items())


def recover_axes(
    axes: Sequence[DriveAxis],
    *,
    forward: bool,
    progress: Progress = no_progress,
    connect: Connect = connected_parameters,
) -> list[JobReport]:
    """Finish (forward) or undo interrupted downloads; empty where there is none. Raises as `recover`, and what connecting raises."""
    cut_off = [axis for axis in axes if unfinished(axis) is not None]
    if not cut_off:
        return []
    with connect(cut_off) as drives:
        each = [(drive, journal_of(axis)) for drive, axis in zip(drives, cut_off, strict=True)]
        return recover(each, forward=forward, progress=progress)


def unfinished(axis: DriveAxis) -> Download | None:
    """The interrupted download of an axis, None for none. Raises InputError for a damaged journal."""
    return journal_of(axis).unfinished()


_STAMP, _BACKUP = "%Y%m%d-%H%M%S", ".params.toml"


# -- for the desk: one axis ----------------------------------------------------------------------------------------------
def backup_job(axis: DriveAxis, path: Path | None = None) -> Job:
    """Job that returns a BackedUp. path: None, a new file in the axis's folder, named by the time. Its work raises StateError on
    failure."""
    path = path or new_backup_path(axis)

    def work(place: Workplace) -> BackedUp:
        (backup,) = back_up_axes([axis], [path], progress=_progress_events(place), connect=_connect(place))
        if backup.contents is None:
            raise StateError(backup.error)
        return BackedUp(path, len(backup.contents.entries), len(backup.unreadable or {}))

    return _job(axis, BACKUP, [PlannedWrite("file", str(path))], work, locked=False)


def new_backup_path(axis: DriveAxis) -> Path:
    """A file in the axis's folder that is named by the time."""
    return axis.path.resolve().parent / f"{axis.name}-{datetime.now().astimezone().strftime(_STAMP)}{_BACKUP}"


def backed_up_at(axis: DriveAxis, path: Path) -> datetime | None:
    """When a file was written by `backup_job`, by its name; None for any other file."""
    start = f"{axis.name}-"
    if not (path.name.startswith(start) and path.name.endswith(_BACKUP)):
        return None
    try:
        return datetime.strptime(path.name.removeprefix(start).removesuffix(_BACKUP), _STAMP).astimezone()
    except ValueError:
        return None


def read_job(axis: DriveAxis) -> Job:
    """Job that returns the Listing of everything that the drive shows; it writes nothing. Its work raises StateError on failure."""

    def work(place: Workplace) -> Listing:
        with _connect(place)([axis]) as drives:
            (backup,) = back_up(drives, everything=True, progress=_progress_events(place))
        if backup.contents is None:
            raise StateError(backup.error)
        for note in backup.notes:
            place.tell(note)
        return listing_of(backup)

    return Job(READ, Plan(axis.name, axis.drive.backend), work, connects=True)


def compare_job(axis: DriveAxis, contents: ParameterSet, kind: str = COMPARE) -> Job:
    """Job that returns a Comparison of the drive with a set; it writes nothing. kind: COMPARE or VERIFY."""

    def work(place: Workplace) -> Comparison:
        return _compared(axis, contents, place)

    return _job(axis, kind, [], work, locked=False)


def _compared(axis: DriveAxis, contents: ParameterSet, place: Workplace) -> Comparison:
    (found,) = compare_axes([axis], [contents], progress=_progress_events(place), connect=_connect(place))
    if found.error:
        raise StateError(found.error)
    return found


def download_job(axis: DriveAxis, contents: ParameterSet) -> Job:
    """Job that downloads a set and returns a JobReport."""
    return _writing(axis, DOWNLOAD, contents, [PlannedWrite("parameters", contents.name)])


def store_job(axis: DriveAxis, contents: ParameterSet, *, audit: bool = False) -> Job:
    """Job that has the drive store the set that it holds, and returns a JobReport. audit: a restart shows whether it kept all of it.
    Its work raises StateError where it holds another."""

    def work(place: Workplace) -> JobReport:
        if not _compared(axis, contents, place).same:
            raise StateError("the drive does not hold this set, so it was not told to store it")
        ask = place.tell if audit else None
        (report,) = write_axes(
            [axis], [contents], store=True, ask=ask, progress=_progress_events(place), connect=_connect(place)
        )
        return report

    return _job(axis, STORE, [PlannedWrite("kept", contents.name)], work)


def restore_job(axis: DriveAxis) -> Job:
    """Job that restores the values before the last download, and returns a JobReport. Raises InputError where there is none."""
    contents = set_before_last(axis)
    return _writing(axis, RESTORE, contents, [PlannedWrite("parameters_back", contents.name)])


def _writing(axis: DriveAxis, kind: str, contents: ParameterSet, writes: Sequence[PlannedWrite]) -> Job:
    def work(place: Workplace) -> JobReport:
        (report,) = write_axes([axis], [contents], progress=_progress_events(place), connect=_connect(place))
        return report

    return _job(axis, kind, writes, work)


def recover_job(axis: DriveAxis, *, forward: bool) -> Job:
    """Job that finishes (forward) or undoes an interrupted download, and returns a JobReport. Raises StateError where there is
    none."""
    cut_off = unfinished(axis)
    if cut_off is None:
        raise StateError("nothing to do: no download was cut off")

    def work(place: Workplace) -> JobReport:
        (report,) = recover_axes([axis], forward=forward, progress=_progress_events(place), connect=_connect(place))
        return report

    write = PlannedWrite("parameters" if forward else "parameters_back", cut_off.set_name)
    return _job(axis, RESUME if forward else ROLLBACK, [write], work)


def _job(
    axis: DriveAxis,
    kind: str,
    writes: Sequence[PlannedWrite],
    work: Callable[[Workplace], object],
    *,
    locked: bool = True,
) -> Job:
    plan = Plan(axis.name, axis.drive.backend, writes=tuple(writes), locked=locked)

    def work_and_keep(place: Workplace) -> object:
        result = work(place)
        with suppress(OSError):  # the job is done all the same
            keep_outcome(axis, result)
        return result

    held = lambda result: not isinstance(result, JobReport) or result.good  # noqa: E731
    return Job(kind, plan, work_and_keep, connects=True, reached=held)


def _connect(place: Workplace) -> Connect:
    return partial(connected_parameters, waiting=place.waiting, bench=place.bench)


def _progress_events(place: Workplace) -> Progress:
    """Progress as events. Between two accesses a stop is possible, also where no answer is waited for."""

    def report(stage: str, drive: str, done: int, total: int) -> None:
        place.listener(Event(stage, drive, done, total))
        place.waiting.real(0.0)

    return report


# -- files with sets ---------------------------------------------------------------------------------------------------
LARGEST_BYTES = 2_000_000
_HEAD_BYTES = 4096
_NAME = re.compile(r"[\w][\w .+-]{0,99}")


def set_files(axis: DriveAxis) -> tuple[Path, ...]:
    """Files with sets in the axis file's folder and among the uploaded ones, sorted by name. Their contents are not checked."""
    found = [path for folder in (_folder(axis), _brought(axis)) if folder.is_dir() for path in folder.iterdir()]
    return tuple(sorted((path for path in found if _is_set(path)), key=lambda path: path.name))


def keep_set(axis: DriveAxis, name: str, data: bytes) -> Path:
    """Keep an uploaded set. Raises InputError for a file that is no set or too large, or that differs from the one of that name."""
    name = Path(name).name
    if not _NAME.fullmatch(name) or Path(name).suffix.lower().removeprefix(".") not in FORMATS:
        raise InputError(f"{name!r}: expected the name of a set, ending in {', '.join(f'.{one}' for one in FORMATS)}")
    require_size(name, len(data))
    path, new = _brought(axis) / name, _brought(axis) / f".new-{name}"
    if path.exists():
        if read_bytes(path) != data:
            raise InputError("is there already and holds something else: expected another name", path=path)
        return path
    new.parent.mkdir(parents=True, exist_ok=True)
    replace_file(new, data)
    try:
        read_any(new)
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)
    return path


def require_size(name: str, size_bytes: int) -> None:
    """Raises InputError for a file larger than `LARGEST_BYTES`; for use before it is read."""
    if size_bytes > LARGEST_BYTES:
        raise InputError(f"{Path(name).name} has {size_bytes} bytes, expected at most {LARGEST_BYTES}")


def _folder(axis: DriveAxis) -> Path:
    return axis.path.resolve().parent


def _brought(axis: DriveAxis) -> Path:
    return axis.store.directory / "parameters" / "sets"


def _is_set(path: Path) -> bool:
    """By the file's suffix; for TOML by its first `_HEAD_BYTES` too, as axis files are TOML."""
    if path.name.startswith(".") or not path.is_file():
        return False
    suffix = path.suffix.lower()
    if suffix != ".toml":
        return suffix.removeprefix(".") in FORMATS
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return FORMAT in head.decode(encoding_of(head), "replace")
