"""What an interruption left behind, found in the axis's folder: by whoever comes next, after a restart of the server too."""

from __future__ import annotations

from dataclasses import dataclass

from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.backlash.job import unrestored
from hil.calibration.job import CALIBRATE, VERIFY
from hil.records.journal import Campaign

SETTINGS = "settings"
_RESUMED = {CALIBRATE: "calibrate", VERIFY: "calibrate"}


@dataclass(frozen=True)
class LeftOver:
    """kind: of a campaign that can be gone on with, or "settings" to be put back; page: where that is done; place: its folder"""

    kind: str
    page: str
    place: str


def left_over(axis: DriveAxis) -> tuple[LeftOver, ...]:
    """All of it; reads the folder."""
    directory = axis.store.directory
    found = []
    for kind, page in _RESUMED.items() if isinstance(axis, AxisConfig) else ():
        campaign = Campaign.unfinished(directory, kind)
        if campaign is not None:
            found.append(LeftOver(kind, page, campaign.directory.name))
    if unrestored(axis):
        found.append(LeftOver(SETTINGS, "backlash", directory.name))
    return tuple(found)
