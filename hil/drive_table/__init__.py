"""The bridge's correction as a drive's own table: what a drive's table adds at the load, the nearest table a drive can
hold, its proof.
"""

from hil.drive_table.curve import DriveCurve, check_curve, largest_deviation_um
from hil.drive_table.quantise import DEVIATION_UM, DriveTable, drive_table, wanted_of

__all__ = [
    "DEVIATION_UM",
    "DriveCurve",
    "DriveTable",
    "check_curve",
    "drive_table",
    "largest_deviation_um",
    "wanted_of",
]
