"""Interrupted work that each room knows of in the axis's folder: campaigns to resume and settings to restore."""

from __future__ import annotations

from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.backlash.job import unrestored
from hil.backlash.settings import NOTE
from hil.calibration.job import CALIBRATE, UNCORRECTED, VERIFY
from hil.desk.unfinished import UnfinishedWork, written
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


def unfinished_work(axis: DriveAxis) -> tuple[UnfinishedWork, ...]:
    """All interrupted work of an axis. Reads its folder."""
    directory = axis.store.directory
    found = []
    for kind, page in _RESUMED.items() if isinstance(axis, AxisConfig) else ():
        campaign = Campaign.unfinished(directory, kind)
        if campaign is not None:
            place = campaign.directory
            found.append(UnfinishedWork(kind, page, place.name, written(place), campaign.rows))
    if unrestored(axis):
        found.append(UnfinishedWork(SETTINGS, "backlash", directory.name, written(directory / NOTE)))
    download = unfinished(axis)
    if download is not None:
        found.append(UnfinishedWork(DOWNLOAD, "parameters", download.set_name, written(download.path)))
    return tuple(found)
