"""Interrupted work in the axis's folder: campaigns to resume and settings to restore, also after a restart of the server."""

from __future__ import annotations

from dataclasses import dataclass

from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.backlash.job import unrestored
from hil.calibration.job import CALIBRATE, VERIFY
from hil.records.journal import Campaign

SETTINGS = "settings"
_RESUMED = {CALIBRATE: "calibrate", VERIFY: "calibrate"}


@dataclass(frozen=True)
class UnfinishedWork:
    """Interrupted work. kind: of a campaign to resume, or "settings" to restore; page: where that is done; place: name of its
    folder."""

    kind: str
    page: str
    place: str


def unfinished_work(axis: DriveAxis) -> tuple[UnfinishedWork, ...]:
    """All interrupted work of an axis. Reads its folder."""
    directory = axis.store.directory
    found = []
    for kind, page in _RESUMED.items() if isinstance(axis, AxisConfig) else ():
        campaign = Campaign.unfinished(directory, kind)
        if campaign is not None:
            found.append(UnfinishedWork(kind, page, campaign.directory.name))
    if unrestored(axis):
        found.append(UnfinishedWork(SETTINGS, "backlash", directory.name))
    return tuple(found)
