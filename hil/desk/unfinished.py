"""Interrupted work in the axis's folder: campaigns to resume and settings to restore, also after a restart of the server."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.backlash.job import unrestored
from hil.backlash.settings import NOTE
from hil.calibration.job import CALIBRATE, UNCORRECTED, VERIFY
from hil.diagnosis.loop.jobs.plan import CLOSE_LOOP
from hil.lost_motion.job import CAMPAIGN as LOST_MOTION
from hil.parameters.job import unfinished
from hil.records.journal import Campaign

SETTINGS = "settings"
DOWNLOAD = "download"
_RESUMED = {
    CALIBRATE: "calibrate",
    VERIFY: "calibrate",
    UNCORRECTED: "calibrate",
    LOST_MOTION: "lost_motion",
    CLOSE_LOOP: "diagnosis",
}
"""Kinds of campaigns that can be gone on with, and the page for each."""


@dataclass(frozen=True)
class UnfinishedWork:
    """Interrupted work. kind: of a campaign to resume, or "settings" to restore; page: where that is done; place: name of its
    folder or set; since: when its last file was written; rows: of a campaign, None for anything else, which cannot be discarded."""

    kind: str
    page: str
    place: str
    since: datetime | None = field(default=None, compare=False)
    rows: int | None = field(default=None, compare=False)


def unfinished_work(axis: DriveAxis) -> tuple[UnfinishedWork, ...]:
    """All interrupted work of an axis. Reads its folder."""
    directory = axis.store.directory
    found = []
    for kind, page in _RESUMED.items() if isinstance(axis, AxisConfig) else ():
        campaign = Campaign.unfinished(directory, kind)
        if campaign is not None:
            place = campaign.directory
            found.append(UnfinishedWork(kind, page, place.name, _written(place), campaign.rows))
    if unrestored(axis):
        found.append(UnfinishedWork(SETTINGS, "backlash", directory.name, _written(directory / NOTE)))
    download = unfinished(axis)
    if download is not None:
        found.append(UnfinishedWork(DOWNLOAD, "parameters", download.set_name, _written(download.path)))
    return tuple(found)


def discard(axis: DriveAxis, work: UnfinishedWork) -> None:
    """Give up a campaign: it is not offered again, and its rows stay. Raises InputError for anything else, and when that cannot be
    written."""
    if work.rows is None:
        raise InputError(f"{work.place} cannot be discarded, expected a campaign")
    Campaign.discard(axis.store.directory / work.place)


def _written(path: Path) -> datetime:
    """When a file, or the latest file of a folder, was written."""
    files = [path, *path.glob("*")] if path.is_dir() else [path]
    return datetime.fromtimestamp(max(one.stat().st_mtime for one in files)).astimezone()
