"""Faults of a simulated machine while a test runs."""

from __future__ import annotations

from collections.abc import Callable

from hil.script.open_axis import OpenAxis
from hil.testing.drive import SimulatedDrive, add_to_bench
from sim_backends.fault_text import parse_faults


def fault_of(machine: OpenAxis | SimulatedDrive) -> Callable[[str], None]:
    """The fixture `fault` of a machine."""
    if isinstance(machine, SimulatedDrive):
        return machine.fault
    return lambda text: add_to_bench(machine.bench, parse_faults([text]))
