"""What drives hold, as sets: a backup of everything that can be put back.

What may go in: reading. What a backup leaves out is what a download would refuse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from drivers.errors import BridgeError, TransportError
from drivers.parameters import ParameterKind
from drivers.raw_parameters import DriveIdentity, RawParameter, RawParameters, Steps
from hil.parameters.set_file import ParameterSet, SetEntry
from hil.parameters.transaction import DriveJob, ended_in
from hil.parameters.works import Progress, one_at_a_time, run_together, unseen


@dataclass
class Backup:
    """One drive's. contents None: `error` says why there is none; unreadable: addresses, with what the drive said."""

    drive: RawParameters
    job: DriveJob
    contents: ParameterSet | None = None
    unreadable: dict[str, str] | None = None
    error: str = ""


def back_up(
    drives: Sequence[RawParameters], *, name: str = "", everything: bool = False, progress: Progress = unseen
) -> list[Backup]:
    """Read every parameter that may be written (everything: all that can be read) of each drive, side by side."""
    backups, progress = [Backup(drive, DriveJob(drive)) for drive in drives], one_at_a_time(progress)
    errors = run_together(
        backups, lambda backup: backup.drive, lambda backup: _read(backup, name, everything, progress)
    )
    for backup, error in zip(backups, errors, strict=True):
        if error is not None:
            backup.error = ended_in(error)
    return backups


def _read(backup: Backup, name: str, everything: bool, progress: Progress) -> Steps[None]:
    drive = backup.drive
    wanted = [entry for entry in drive.entries.values() if everything or entry.refusal is None]
    done = 0

    def tell(count: int) -> None:
        nonlocal done
        done += count
        progress("read", drive.name, done, len(wanted))

    identity = yield from drive.identify()
    starts = drive.restarts
    accesses = yield from drive.read([entry.address for entry in wanted], tell)
    backup.job.latencies.note(backup.job.latencies.read_s, accesses)
    errors = [access.error for access in accesses]
    _refuse_silence(errors)
    if drive.restarts != starts:
        backup.error = f"drive {drive.name} started anew while it was read"
        return
    shown = {access.address: access.data for access in accesses if access.data is not None}
    backup.unreadable = {access.address: ended_in(access.error) for access in accesses if access.error is not None}
    title = name or f"{drive.name}, {datetime.now(UTC).isoformat(timespec='seconds')}"
    entries = [entry_of(drive, entry, shown[entry.address]) for entry in wanted if entry.address in shown]
    backup.contents = set_of(title, identity, entries)


def _refuse_silence(errors: Sequence[BridgeError | None]) -> None:
    """A drive that stopped answering has no backup; one that refuses some objects has."""
    last = errors[-1] if errors else None
    if isinstance(last, TransportError):
        raise last


def set_of(name: str, identity: DriveIdentity | None, entries: Sequence[SetEntry]) -> ParameterSet:
    """A set of these, with its hash."""
    contents = ParameterSet(name, identity, tuple(entries))
    return ParameterSet(name, identity, tuple(entries), contents.digest())


def entry_of(drive: RawParameters, parameter: RawParameter, data: bytes) -> SetEntry:
    """One parameter as a set has it."""
    info = parameter.info
    value = None if info.kind is ParameterKind.BYTES else drive.decode(parameter, data)
    name = "" if info.name == parameter.address else info.name
    return SetEntry(parameter.address, value, drive.to_raw(parameter, data), parameter.type, info.unit, name)
