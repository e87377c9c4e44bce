"""Interrupted work in the axis's folder, also after a restart of the server."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from drivers.errors import InputError
from hil.axis.axis_file import DriveAxis
from hil.records.journal import Campaign


@dataclass(frozen=True)
class UnfinishedWork:
    """Interrupted work. kind: of a campaign to resume, or "settings" to restore; page: where that is done; place: name of its
    folder or set; since: when its last file was written; rows: of a campaign, None for anything else, which cannot be discarded."""

    kind: str
    page: str
    place: str
    since: datetime | None = field(default=None, compare=False)
    rows: int | None = field(default=None, compare=False)


def discard(axis: DriveAxis, work: UnfinishedWork) -> None:
    """Give up a campaign: it is not offered again, and its rows stay. Raises InputError for anything else, and when that cannot be
    written."""
    if work.rows is None:
        raise InputError(f"{work.place} cannot be discarded, expected a campaign")
    Campaign.discard(axis.store.directory / work.place)


def written(path: Path) -> datetime:
    """When a file, or the latest file of a folder, was written."""
    files = [path, *path.glob("*")] if path.is_dir() else [path]
    return datetime.fromtimestamp(max(one.stat().st_mtime for one in files)).astimezone()
