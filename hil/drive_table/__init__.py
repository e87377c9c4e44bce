"""The bridge's correction as a drive's own table: what a drive's table adds at the load, the nearest table a drive can
hold, its proof.
"""

PROVERS = ("instrument", "drive", "nothing")
"""What proves a table: the instrument, the value that the drive says it adds, or nothing."""
TOLERANCE_UM = 1.0
"""Default tolerance of the difference between drive and bridge in the proof, its uncertainty included, µm."""
DEVIATION_UM = 0.5
"""Default largest deviation of a drive's correction from the bridge's, µm."""
