"""Backup: the parameters of drives, read into sets. It leaves out the parameters that a download would refuse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from drivers.errors import BridgeError, TransportError
from drivers.parameters import ParameterKind
from drivers.raw_parameters import RawParameter, RawParameters, Steps
from hil.parameters.preflight import notes_of_file, objections_to_file
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.tasks import Progress, counted, no_progress, run_together, serialized
from hil.parameters.transaction import ended_in


@dataclass
class Backup:
    """Backup of one drive. contents: None on failure, then `error` says why; unreadable: address -> the drive's refusal."""

    drive: RawParameters
    contents: ParameterSet | None = None
    unreadable: dict[str, str] | None = None
    error: str = ""
    notes: tuple[str, ...] = ()


def back_up(
    drives: Sequence[RawParameters], *, everything: bool = False, progress: Progress = no_progress
) -> list[Backup]:
    """Read every writable parameter of each drive, side by side. everything: also read-only ones.

    Errors of a drive or its wire become `Backup.error`.
    """
    backups, progress = [Backup(drive) for drive in drives], serialized(progress)
    errors = run_together(backups, lambda backup: backup.drive, lambda backup: _read(backup, everything, progress))
    for backup, error in zip(backups, errors, strict=True):
        if error is not None:
            backup.error = ended_in(error)
    return backups


def _read(backup: Backup, everything: bool, progress: Progress) -> Steps[None]:
    drive = backup.drive
    wanted = [entry for entry in drive.entries.values() if everything or entry.refusal is None]
    identity = yield from drive.identify()
    backup.notes = (*(each.why for each in objections_to_file(drive, identity)), *notes_of_file(drive))
    starts = drive.restarts
    accesses = yield from drive.read([entry.address for entry in wanted], counted(progress, "read", drive, len(wanted)))
    errors = [access.error for access in accesses]
    _refuse_silence(errors)
    if drive.restarts != starts:
        backup.error = f"drive {drive.name} restarted while it was read"
        return
    shown = {access.address: access.data for access in accesses if access.data is not None}
    backup.unreadable = {access.address: ended_in(access.error) for access in accesses if access.error is not None}
    title = f"{drive.name}, {datetime.now(UTC).isoformat(timespec='seconds')}"
    entries = [entry_of(drive, entry, shown[entry.address]) for entry in wanted if entry.address in shown]
    contents = ParameterSet(title, identity, tuple(entries))
    backup.contents = replace(contents, hash=contents.digest())


def _refuse_silence(errors: Sequence[BridgeError | None]) -> None:
    """Raises the error of a drive that stopped answering: the rest was not read. Refused objects do not prevent a backup."""
    for error in errors:
        if isinstance(error, TransportError):
            raise error


def entry_of(drive: RawParameters, parameter: RawParameter, data: bytes) -> SetEntry:
    """The entry of one parameter. data: as the drive's bytes."""
    info = parameter.info
    value = None if info.kind is ParameterKind.BYTES else drive.decode(parameter, data)
    name = "" if info.name == parameter.address else info.name
    return SetEntry(
        parameter.address, value, drive.to_raw(parameter, data), parameter.type, drive.unit_of(parameter), name
    )
