"""What keeps the zero of the axis that a file describes, and the drive's parameters that its tables were made with."""

from __future__ import annotations

from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.records.made_with import MadeWithKeeper
from hil.records.zero import ZeroKeeper


def zero_keeper(axis: DriveAxis) -> ZeroKeeper:
    """Of the axis's zero, as its file says."""
    if not isinstance(axis, AxisConfig):
        return ZeroKeeper(axis.zero_path, axis.name, absolute_encoder=axis.absolute_encoder)
    return ZeroKeeper(
        axis.zero_path,
        axis.name,
        within_um=axis.measurement.reference_within_um,
        absolute_encoder=axis.absolute_encoder,
        instrument=axis.instrument.kind,
    )


def made_with_keeper(axis: DriveAxis) -> MadeWithKeeper:
    """Of the drive's units, and of its backlash amount and switch where the axis file names them."""
    how = axis.backlash
    names = () if how is None else tuple(name for name in (how.parameter, how.acceleration) if name is not None)
    return MadeWithKeeper(axis.made_with_path, axis.name, axis.path, names)
