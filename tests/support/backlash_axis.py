"""Axis files for measuring backlash by torque on the bench, for every face of its drive, and the bench behind them."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.bench_axis import AXIS

import hil.machine.bench_wiring
from sim_backends.bench import Bench, BenchParameters
from sim_backends.clock import SimClock

PARAMETERS = {
    "virtual": "",
    "canopen": 'parameter = "2201h"\nacceleration = "2202h"\nparameter_um = 0.01\n',
    "modbus-rtu": "",
    "modbus-tcp": 'parameter = "backlash"\nacceleration = "backlash_quick"\nparameter_um = 0.01\n',
}
"""The drive's parameters as the axis file names them; a count of the bench is 10 nm."""
FACES = {
    "virtual": 'face = "virtual"\n',
    "canopen": 'face = "canopen"\n',
    "modbus-rtu": 'face = "modbus-rtu"\nregister_map = "cia402_over_modbus"\n',
    "modbus-tcp": 'face = "modbus-tcp"\nregister_map = "vendor_style"\n',
}

TEXT = (
    AXIS
    + """
[drive]
backend = "bench"
machine = "worn"
{face}
[backlash]
reference_plus_mm = 5.0
reference_minus_mm = 5.0
travel_velocity_mm_s = 100.0
{backlash}
"""
)

QUICK = "step_um = 2.0\nsettle_s = 0.03\nreadings = 2\nvelocity_mm_s = 2.0\nrun_in_mm = 0.2\n"
"""For tests of anything but the accuracy."""


def lay_out(directory: Path, face: str = "virtual", backlash: str = QUICK) -> Path:
    """Write axis.toml into a directory; its path."""
    path = directory / "axis.toml"
    path.write_text(TEXT.format(face=FACES[face], backlash=PARAMETERS[face] + backlash), encoding="utf-8")
    return path


class BenchBehind:
    """The bench that a verb or `connected_drive` built last."""

    bench: Bench


def look_behind(monkeypatch: pytest.MonkeyPatch) -> BenchBehind:
    """Record the benches that are built from now on."""
    seen = BenchBehind()

    class SeenBench(Bench):
        def __init__(
            self,
            parameters: BenchParameters | None = None,
            *,
            wait_for_arrival: bool = True,
            clock: SimClock | None = None,
        ) -> None:
            super().__init__(parameters, wait_for_arrival=wait_for_arrival, clock=clock)
            seen.bench = self

    monkeypatch.setattr(hil.machine.bench_wiring, "Bench", SeenBench)
    return seen
