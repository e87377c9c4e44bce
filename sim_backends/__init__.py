"""The simulated side: a machine with its drives and instruments, shown through the protocols of real ones.

Contains truth physics (`plant`, numbers only), the drive firmware around it (`servo`), one module per face that shows it
(in-process, CANopen, Modbus, laser), the simulated clock, and faults as data. It may use the drivers' abstractions and no-I/O
tables; it never imports `hil`, so that its results are independent of the code under test.
"""

from importlib import resources
from pathlib import Path

MODBUS_SHAPES = ("cia402", "vendor")
"""Register sets of the simulated Modbus drive."""


def profile_paths() -> dict[str, Path]:
    """The profiles that come with the package, by name."""
    folder = resources.files("sim_backends") / "profiles"
    found = sorted(str(item) for item in folder.iterdir() if item.name.endswith(".toml"))
    return {Path(item).stem: Path(item) for item in found}
