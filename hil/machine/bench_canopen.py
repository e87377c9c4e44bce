"""The bench's servos as CANopen nodes of one bus."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from hil.axis.axis_file import DriveAxis
from hil.machine.canopen_wiring import canopen_drive
from hil.machine.links import Links
from sim_backends.bench import Bench
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.canopen_in_turn import DrivesInTurn, drives_in_turn
from sim_backends.canopen_quirks import ProfiledSlave, machine_objects
from sim_backends.clock import SimClock
from sim_backends.drive_profiles import load_profile
from sim_backends.own_table import TableForm


def canopen_bus(
    nodes: Sequence[tuple[DriveAxis, Bench, TableForm | None]], clock: SimClock, stack: ExitStack
) -> DrivesInTurn:
    """A bus of simulated servos, each the node of its axis file; with the table that it holds."""
    bus = stack.enter_context(drives_in_turn(clock, f"bench-{uuid.uuid4().hex}"))
    for axis, bench, table in nodes:
        parameters, make = bench_node(axis, bench)
        bus.add(bench.servo, axis.drive.node_id, parameters=parameters, table=table, make=make)
    return bus


def canopen_drives(
    axes: Sequence[DriveAxis], bus: DrivesInTurn, clock: SimClock, stack: ExitStack
) -> list[CanOpenDrive]:
    """Drives for the nodes of such a bus."""
    place = ("virtual", "bench")  # of these links alone
    links = Links({place: stack.enter_context(CanLink(bus.master(), clock))})
    return [canopen_drive(axis, clock, place, stack, links=links) for axis in axes]


def bench_node(axis: DriveAxis, bench: Bench) -> tuple[Mapping[tuple[int, int], int], Callable[..., CanOpenSlave]]:
    """Factory settings of the bench's CANopen drive, and what makes it: the documented drive that the axis file names, else the
    standard's."""
    if not axis.drive.profile:
        return bench.parameters.objects, CanOpenSlave
    profile = load_profile(axis.drive.profile)
    lead_m = bench.parameters.plant.screw.lead_mm / 1000.0
    return machine_objects(profile, bench.parameters), partial(ProfiledSlave, profile=profile, lead_m=lead_m)
