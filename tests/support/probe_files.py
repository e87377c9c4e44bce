"""A machine file with its axis files for the bench, with a short travel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.session import ProbeSession
from hil.probe.wiring import probe_drives, probe_session
from sim_backends.probe_bench import ProbeBench

AXIS = """
[axis]
name = "{name}"
travel_min_mm = {low}
travel_max_mm = {high}
max_velocity_mm_s = {velocity}
max_acceleration_mm_s2 = {acceleration}

[scaling]
encoder_counts_per_motor_rev = 1_000_000
feed_mm_per_shaft_rev = {feed}

[drive]
backend = "bench"
{drive}
"""

MACHINE = """
[machine]
name = "mill"
x = "X.toml"
y = "Y.toml"
spindle = "S.toml"

[spindle]
velocity_deg_s = 180.0
{spindle}

[probe]
tip_radius_mm = 2.0
{probe}

[block]
face_mm = 105.0
start_mm = {start_mm}
y_mm = 40.0
search_mm = {search_mm}
{block}

[bore]
x_mm = 50.0
y_mm = 60.0
reach_mm = 8.0
{bore}

{more}
"""

VIRTUAL = 'face = "virtual"'
CANOPEN = 'face = "canopen"'
MODBUS = 'face = "modbus-tcp"'
VENDOR = 'face = "modbus-rtu"\nregister_map = "vendor_style"'


def lay_out(
    directory: Path,
    *,
    drive: str = VIRTUAL,
    spindle_drive: str | None = None,
    start_mm: float = 101.0,
    search_mm: float = 3.0,
    spindle: str = "",
    probe: str = "",
    block: str = "",
    more: str = "",
    z: bool = False,
    bore: str = "",
) -> Path:
    """Write mill.toml and its axis files into a directory; the machine file's path. z: with a Z axis, bore and block 10 mm below
    its safe height.
    """
    directory.mkdir(parents=True, exist_ok=True)
    linear = {"low": -2.0, "high": 200.0, "velocity": 100.0, "acceleration": 1000.0, "feed": 10.0, "drive": drive}
    turning = {"low": -360.0, "high": 720.0, "velocity": 360.0, "acceleration": 3600.0, "feed": 360.0}
    for name in ("X", "Y"):
        (directory / f"{name}.toml").write_text(AXIS.format(name=name, **linear))
    (directory / "S.toml").write_text(AXIS.format(name="S", **turning, drive=spindle_drive or drive))
    path = directory / "mill.toml"
    if z:
        (directory / "Z.toml").write_text(AXIS.format(name="Z", **{**linear, "low": -50.0, "high": 100.0}))
        block, bore, more = f"z_mm = 30.0\n{block}", f"z_mm = 30.0\n{bore}", f"[approach]\nsafe_mm = 40.0\n{more}"
    text = MACHINE.format(
        start_mm=start_mm, search_mm=search_mm, spindle=spindle, probe=probe, block=block, bore=bore, more=more
    )
    path.write_text(text.replace('y = "Y.toml"', 'y = "Y.toml"\nz = "Z.toml"') if z else text)
    return path


@contextmanager
def connected_probe(
    config: ProbeMachineConfig,
    *,
    touching: Sequence[str] = ("x",),
    mode: str | None = None,
    bench: ProbeBench | None = None,
) -> Iterator[ProbeSession]:
    """A session on the machine of a machine file, or on a bench. Raises as `probe_drives`; arguments as of
    `ProbeSession`.
    """
    with (
        probe_drives(config, bench) as drives,
        probe_session(config, drives, touching=touching, mode=mode) as session,
    ):
        yield session
