"""The simulated side: a machine with its drives and instruments, shown through the protocols of real ones.

Contains truth physics (`plant`, numbers only), the drive firmware around it (`servo`), one module per face that shows it
(in-process, CANopen, Modbus, laser), the simulated clock, and faults as data. It may use the drivers' abstractions and no-I/O
tables; it never imports `hil`, so that its results are independent of the code under test.
"""

from pathlib import Path

MODBUS_SHAPES = ("cia402", "vendor")
"""Register sets of the simulated Modbus drive."""
GAUGE_KINDS = ("nd2xx", "mitutoyo", "ascii")
"""Simulated instruments beside the laser."""


def profile_paths() -> dict[str, Path]:
    """The profiles that come with the package, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "profiles").glob("*.toml"))}
