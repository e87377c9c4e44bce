"""Correction: tables, the engine that applies them, the bound, the sealed store, and controllers' files."""

TABLES = ("pitch", "backlash", "specified", "straightness")
"""The tables that may have a password of their own."""
CONTROLLER_FORMATS = ("linuxcnc", "sinumerik", "fanuc", "twincat", "grblhal", "fluidnc", "mach3", "mach4")
MEASUREMENT_FORMATS = ("keysight", "renishaw", "lines", "csv", "iso-wide")
"""Names of the formats of `hil.correction.formats`, for options, whose help loads nothing that computes."""
WIDE_ISO_CELLS = {"deviation_um": 1e-3, "deviation_mm": 1.0, "position_mm": 1.0}
"""Contents of the cells of the format iso-wide -> mm per unit of a cell."""
RISE_SHAPES = ("two tanh", "tanh", "exponential", "dead zone", "straight pieces")
"""Names of the shapes of `hil.correction.rise`."""

MAX_CORRECTION_UM = 500.0
"""Default of `max_correction_um`. A cheap rolled screw of class C10 (JIS B 1192) may deviate by 210 µm within any 300 mm: makers state
C7 and C10 by that figure alone, 0.05 and 0.21 mm (ABBA, ball screw catalogue, 6.1.1 "Lead / travel accuracy" and table 6.1.1.3). The
class has no figure for 500 mm; the same deviation all along gives 210·500/300 = 350 µm. A worn nut and gear lose some 100 µm at a
reversal. A longer axis of that class has to state more."""
MAX_SLOPE_UM_PER_MM = 10.0
"""Default of `max_slope_um_per_mm`. The same screw's lead error is 0.7 µm/mm, thermal expansion by 40 K 0.5 µm/mm; an error of 5 µm
amplitude that repeats with a lead of 5 mm changes by 2π·5/5 = 6.3 µm/mm. A feed constant that is 1 % wrong makes 10 µm/mm."""
