"""What a report says of the set-up."""

from __future__ import annotations

from hil.axis import DriveAxis


def drive_in_words(axis: DriveAxis) -> str:
    """The drive as a report names it."""
    if axis.drive.backend == "bench":
        return f"bench, {axis.drive.machine} machine, as {axis.drive.face}"
    return axis.drive.backend
