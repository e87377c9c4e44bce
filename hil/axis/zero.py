"""What keeps the zero of the axis that a file describes."""

from __future__ import annotations

from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.records.zero import ZeroKeeper


def zero_keeper(axis: DriveAxis) -> ZeroKeeper:
    """Of the axis's zero, as its file says."""
    if not isinstance(axis, AxisConfig):
        return ZeroKeeper(axis.zero_path, axis.name, axis.path, absolute_encoder=axis.absolute_encoder)
    return ZeroKeeper(
        axis.zero_path,
        axis.name,
        axis.path,
        within_um=axis.measurement.reference_within_um,
        absolute_encoder=axis.absolute_encoder,
        instrument=axis.instrument.kind,
    )
