"""A simulated machine as a process of its own, in real time: its drive on a real bus or line, its laser on a terminal, one plant.

Shows a running `bench` to other processes; `reach` limits which ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import partial

import can

from drivers.clock import Clock
from drivers.errors import InputError, LinkLostError
from sim_backends import MODBUS_SHAPES
from sim_backends.bench import Bench
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_quirks import ProfiledSlave, machine_objects
from sim_backends.canopen_station import Station
from sim_backends.canopen_strict import StrictSlave
from sim_backends.drive_profiles import DriveProfileFile
from sim_backends.maker_file import MakerFile
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import ModbusServer, rtu_slave, tcp_server
from sim_backends.modbus_faults import WireFault
from sim_backends.modbus_registers import Face
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.own_table import TableForm
from sim_backends.serve import Pace
from sim_backends.slcan import SlcanDevice

_MOST_FRAMES = 64  # handled in a row before anything else runs


def open_bus(interface: str, channel: str, bitrate: int | None) -> can.BusABC:
    """A python-can bus, or, for "slcan-pty", an adapter on a new terminal. Raises LinkLostError."""
    if interface == "slcan-pty":
        return SlcanDevice()
    settings: dict[str, object] = {} if bitrate is None else {"bitrate": bitrate}
    try:
        return can.Bus(channel=channel, interface=interface, **settings)  # type: ignore[arg-type]
    except (can.CanError, OSError, ValueError) as error:
        raise LinkLostError(f"CAN {interface} {channel} cannot be opened: {error}") from error


class CanDrive:
    """The bench's servo as a CANopen node, with the objects of a maker's file (`canopen_strict`), or as a documented drive
    (`canopen_quirks`), where one is given.

    The thread that advances time handles the frames, so nothing is shared. Use `serve` where that thread would sleep. Raises
    LinkLostError when the bus is lost.
    """

    def __init__(
        self,
        bench: Bench,
        pace: Pace,
        bus: can.BusABC,
        node_id: int,
        *,
        faults: tuple[CanFault, ...] = (),
        table: TableForm | None = None,
        maker: MakerFile | None = None,
        profile: DriveProfileFile | None = None,
    ) -> None:
        self._bus = bus
        self._pace = pace
        lead_m = bench.parameters.plant.screw.lead_mm / 1000.0
        make: Callable[..., CanOpenSlave] = CanOpenSlave
        settings = bench.parameters.objects
        if profile is not None:
            make = partial(ProfiledSlave, profile=profile, maker=maker, lead_m=lead_m)
            settings = machine_objects(profile, bench.parameters) if maker is None else {}
        elif maker is not None:
            make, settings = partial(StrictSlave, maker=maker, lead_m=lead_m), {}
        if make is not CanOpenSlave:
            table = None
        self._station = Station(
            bus, bench.clock, bench.servo, node_id, parameters=settings, faults=faults, table=table, make=make
        )
        self.slave = self._station.slave
        layer = self._station.layer
        bench.clock.attach(lambda now_ns, _dt_s: layer.tick(now_ns), bearable=self._station.bearable)

    def add_faults(self, faults: tuple[CanFault, ...]) -> None:
        """Add faults of the bus and of the node, from the thread that serves."""
        self._station.layer.add(faults)

    def serve(self, timeout_s: float) -> None:
        """Wait at most `timeout_s` seconds for a frame; handle it and those that came with it, each at its time.

        Raises LinkLostError."""
        for _ in range(_MOST_FRAMES):
            try:
                message = self._bus.recv(timeout_s)
            except (can.CanError, OSError) as error:
                raise LinkLostError(f"CAN bus {self._bus.channel_info} is gone: {error}") from error
            if message is None:
                return
            self._pace.catch_up()
            self._station.deliver(message)
            timeout_s = 0.0


def modbus_face(bench: Bench, shape: str) -> Face:
    """The bench's servo as registers: "cia402" (objects in blocks of holding registers) or "vendor" (coils and a trigger register).

    Raises InputError for another shape."""
    if shape == "vendor":
        counts, settings = bench.parameters.servo.counts_per_rev, bench.parameters.vendor_settings
        return VendorRegisters(bench.servo, counts_per_rev=counts, settings=settings)
    if shape == "cia402":
        return Cia402Registers(bench.servo, parameters=bench.parameters.micrometre_objects)
    raise InputError(f"Modbus shape {shape!r}, expected one of {', '.join(MODBUS_SHAPES)}")


@contextmanager
def modbus_server(
    bench: Bench,
    wall: Clock,
    faces: Mapping[int, Face],
    *,
    tcp: tuple[str, int] | None,
    faults: tuple[WireFault, ...] = (),
) -> Iterator[tuple[Pace, str]]:
    """Serve units on a TCP address, or on a new terminal when `tcp` is None; yields the pace to keep and the address to connect to.

    A thread of the server answers requests; the pace holds its lock while time advances. Raises InputError, LinkLostError.
    """
    opened: AbstractContextManager[tuple[ModbusServer, str | int]]
    if tcp is None:
        opened = rtu_slave(faces, bench.clock, faults=faults, remember=False)
    else:
        opened = tcp_server(faces, bench.clock, faults=faults, remember=False, host=tcp[0], port=tcp[1])
    with opened as (server, place):
        guarded = server.guard(lambda time_ns, _dt_s: bench.clock.sleep_until_ns(time_ns))
        pace = Pace(bench.clock, wall, sleep=lambda time_ns: guarded(time_ns, 0.0))
        server.catch_up = pace.catch_up
        yield pace, str(place) if tcp is None else f"tcp://{tcp[0]}:{place}"
