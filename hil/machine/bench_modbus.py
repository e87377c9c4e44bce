"""The bench's servos as units of one Modbus TCP server or RTU line."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack

from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from hil.axis.axis_file import DriveAxis
from hil.machine.links import Links
from hil.machine.modbus_wiring import modbus_drive
from sim_backends.bench import Bench
from sim_backends.clock import SimClock
from sim_backends.machine import modbus_face
from sim_backends.modbus_drive import rtu_slave, tcp_server

BENCH_TIMEOUT_S = 10.0
"""Time-out for an answer of the bench's drive, s of real time: it answers in a thread of its own, which a busy host may delay."""


def modbus_drives(units: Mapping[int, tuple[DriveAxis, Bench]], clock: SimClock, stack: ExitStack) -> list[ModbusDrive]:
    """Drives for simulated servos, each by its unit."""
    endpoint, links = _served(units, clock, stack), Links()
    return [modbus_drive(axis, clock, endpoint, unit, links) for unit, (axis, _) in units.items()]


def _served(units: Mapping[int, tuple[DriveAxis, Bench]], clock: SimClock, stack: ExitStack) -> Endpoint:
    """Serve benches as units of one Modbus TCP server or RTU line, as their axis files name it; returns its endpoint."""
    faces = {
        unit: modbus_face(bench, "vendor" if axis.drive.register_map == "vendor_style" else "cia402")
        for unit, (axis, bench) in units.items()
    }
    if next(iter(units.values()))[0].drive.face == "modbus-tcp":
        _, port = stack.enter_context(tcp_server(faces, clock))
        return TcpEndpoint("127.0.0.1", port, timeout_s=BENCH_TIMEOUT_S)
    _, path = stack.enter_context(rtu_slave(faces, clock))
    return RtuEndpoint(path, baud=115_200, parity="N", timeout_s=BENCH_TIMEOUT_S)
