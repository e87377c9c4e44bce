"""Interrupted work in an axis's folder that the pages go on with: campaigns to resume, settings to restore, a download."""

from __future__ import annotations

from collections.abc import Sequence

from hil.app.panel.bar import Page
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.backlash.job import unrestored
from hil.backlash.settings import NOTE
from hil.desk.unfinished import UnfinishedWork, written
from hil.parameters.job import unfinished
from hil.records.journal import Campaign

SETTINGS = "settings"
DOWNLOAD = "download"


def unfinished_work(axis: DriveAxis, pages: Sequence[Page]) -> tuple[UnfinishedWork, ...]:
    """All interrupted work of an axis that one of the pages goes on with. Reads its folder."""
    directory = axis.store.directory
    found = []
    resumed = {kind: page.name for page in pages for kind in page.resumes}
    for kind, page in resumed.items() if isinstance(axis, AxisConfig) else ():
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
