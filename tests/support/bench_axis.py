"""An axis file for the bench, with a short travel and few sections, and the builder's keys beside it."""

from __future__ import annotations

from pathlib import Path

from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key

PASSWORDS = {"HIL_PASSWORD": "tables of the bench", "HIL_KEY_PASSWORD": "builder of the bench"}

AXIS = """
[axis]
name = "X"
travel_min_mm = -2.0
travel_max_mm = 502.0
max_velocity_mm_s = 200.0
max_acceleration_mm_s2 = 1000.0

[scaling]
encoder_counts_per_motor_rev = 1_000_000
feed_mm_per_shaft_rev = 10.0
"""
"""The bench's axis and its scaling, without a drive."""

TEXT = (
    AXIS
    + """
[drive]
backend = "bench"
machine = "{machine}"
seed = 5
{face}
[instrument]
place_temps = {{ screw = 4 }}

[measurement]
first_mm = 20.0
last_mm = 260.0
sections = {sections}
runs = {runs}
velocity_mm_s = 100.0
dwell_s = 0.3
reading_s = 0.3

[correction]
{correction}
"""
)

CERTIFICATE = """
[uncertainty]
device_um = 0.2
device_um_per_m = 1.5
variation_um = 0.4

[certificate]
person = "A. Builder"
machine = { model = "VMC 650", serial = "1234" }
drive = { model = "S-drive 2", serial = "77-01" }
instrument = { model = "uMD2", serial = "0042" }
laboratory = { name = "Example Metrology", city = "Braunschweig", country = "DE" }
customer = { name = "Example Works", city = "Jena", country = "DE" }
"""
"""Sections for an uncertainty and a certificate."""


def lay_out(
    directory: Path,
    *,
    machine: str = "geometric",
    sections: int = 5,
    runs: int = 2,
    correction: str = "",
    on_a_wire: bool = True,
) -> Path:
    """Write axis.toml and the builder's pair into a directory; the axis file's path.

    on_a_wire: the drive is on a CAN bus, which computes as long as the machine itself.
    """
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / "axis.toml"
    face = "" if on_a_wire else 'face = "virtual"\n'
    path.write_text(TEXT.format(machine=machine, sections=sections, runs=runs, correction=correction, face=face))
    write_keys(directory)
    return path


def write_keys(directory: Path) -> None:
    """The builder's pair, where an axis file looks for it."""
    key = new_key()
    save_private_key(directory / "builder.key", key, PASSWORDS["HIL_KEY_PASSWORD"], cost=Cost(n=1 << 10, r=8, p=1))
    save_public_key(directory / "builder.pub", key.public_key())
