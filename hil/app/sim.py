"""`hil sim`: a simulated machine, or a part of it, as a process on a real interface (CAN, Modbus, pty)."""

from __future__ import annotations

import argparse
import json
import re
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

from drivers.clock import WallClock
from drivers.errors import InputError
from drivers.files import replace_file
from hil.axis.axis_file import load_drive_axis
from hil.machine.likeness import read_likeness
from hil.machine.simulated_file import axis_text, instrument_text
from sim_backends.bench import Bench, BenchParameters, known_bench
from sim_backends.canopen_strict import StrictSlave
from sim_backends.drive_profiles import load_profile
from sim_backends.fault_text import Faults, parse_faults
from sim_backends.faults import CanFaultKind, WireFaultKind
from sim_backends.gauge import GaugeParameters
from sim_backends.likeness import alike
from sim_backends.machine import CanDrive, modbus_face, modbus_server, open_bus
from sim_backends.maker_file import read_maker_file
from sim_backends.own_table import known_table
from sim_backends.reach import check_can, parse_tcp
from sim_backends.serve import Pace, Shuttle, run_in_real_time


# -- the machine -------------------------------------------------------------------------------------------------------
def _parameters(args: argparse.Namespace, faults: Faults) -> BenchParameters:
    if not 1.0 <= args.rate <= 2000.0:
        raise InputError(f"--rate is {args.rate:g}, expected 1 to 2000 readings per second")
    if args.seed is not None and args.seed < 0:
        raise InputError(f"--seed is {args.seed}, expected a whole number >= 0")
    if args.seed is not None and args.like is not None:
        raise InputError(
            "--seed is which machine of --machine, expected none beside --like, whose machine was measured"
        )
    parameters = known_bench(args.machine, args.seed or 0) if args.like is None else alike(read_likeness(args.like))
    laser = replace(parameters.laser, rate_hz=args.rate)
    gauge = None if args.kind == "umd" else GaugeParameters(args.kind, rate_hz=args.rate)
    homing_method = getattr(args, "homing", parameters.homing_method)  # of a drive on a wire only
    return replace(
        parameters,
        laser=laser,
        gauge=gauge,
        laser_faults=faults.laser,
        servo_faults=faults.servo,
        homing_method=homing_method,
    )


def _effects(texts: Sequence[str]) -> list[tuple[str, float]]:
    effects = []
    for text in texts:
        name, equals, size = text.partition("=")
        try:
            effects.append((name, float(size)))
        except ValueError as error:
            raise InputError(f"effect {text!r}, expected ID=UM such as thermal_expansion=12") from error
        if not equals:
            raise InputError(f"effect {text!r}, expected ID=UM such as thermal_expansion=12")
    return effects


@contextmanager
def _machine(args: argparse.Namespace, faults: Faults, *, laser: bool) -> Iterator[Bench]:
    """The bench of the command line; laser: with its instrument on a pty."""
    effects = _effects(args.effect)
    with Bench(_parameters(args, faults), wait_for_arrival=False) as bench:
        for name, size_um in effects:
            bench.switch_on(name, size_um)
        if not laser:
            bench.close_instrument()
        yield bench


def run_drive(args: argparse.Namespace) -> int:
    _check_axis_file(args)
    if not 1 <= args.node <= 127:
        raise InputError(f"--node is {args.node}, expected 1 to 127")
    check_can(args.interface, args.channel, allow_outside=args.allow_outside)
    faults = parse_faults(args.fault, wire=CanFaultKind)
    with ExitStack() as stack:
        bench = stack.enter_context(_machine(args, faults, laser=args.laser))
        bus = open_bus(args.interface, args.channel, args.bitrate)
        stack.callback(bus.shutdown)
        wall = WallClock()
        pace = Pace(bench.clock, wall)
        table = known_table(args.table, bench.parameters.scaling.counts_per_load_mm / 1000.0)
        maker = None if args.eds is None else read_maker_file(Path(args.eds))
        profile = None if args.profile is None else load_profile(args.profile)
        if profile is not None and args.table:
            raise InputError("--table: a documented drive has no correction table here")
        drive = CanDrive(bench, pace, bus, args.node, faults=faults.can, table=table, maker=maker, profile=profile)
        place: dict[str, Any] = {"backend": "canopen", "interface": args.interface, "channel": args.channel}
        if args.interface == "slcan-pty":
            place |= {"interface": "slcan", "channel": bus.channel_info}
        place["node_id"] = args.node
        if args.table:
            place["correction_table"] = args.table
        if profile is not None:
            homing = profile.axis_file.homing
            place |= {**profile.axis_file.drive, **({"homing": homing} if homing else {})}
        counts_per_rev = None
        if isinstance(drive.slave, StrictSlave):
            counts_per_rev = round(1 / drive.slave.units[0].position_rev)
            print(f"units of this drive: {drive.slave.units[0]}", file=sys.stderr)
        _run(args, bench, place, pace, drive.serve, counts_per_rev=counts_per_rev)
    return 0


def run_modbus(args: argparse.Namespace) -> int:
    _check_axis_file(args)
    if not 0 <= args.unit <= 255:
        raise InputError(f"--unit is {args.unit}, expected 0 to 255")
    tcp = None if args.pty else parse_tcp(args.tcp, allow_outside=args.allow_outside)
    faults = parse_faults(args.fault, wire=WireFaultKind)
    with _machine(args, faults, laser=args.laser) as bench:
        faces = {args.unit: modbus_face(bench, args.shape)}
        with modbus_server(bench, WallClock(), faces, tcp=tcp, faults=faults.modbus) as (pace, address):
            register_map = "vendor_style" if args.shape == "vendor" else "cia402_over_modbus"
            url = address if tcp else f"{address}?parity=N"
            place = {"backend": "modbus", "register_map": register_map, "url": url, "unit": args.unit}
            _run(args, bench, place, pace, None)
    return 0


def run_laser(args: argparse.Namespace) -> int:
    faults = parse_faults(args.fault)
    with _machine(args, faults, laser=True) as bench:
        if not args.still:
            bench.clock.attach(Shuttle(bench.servo).advance)
        _run(args, bench, None, Pace(bench.clock, WallClock()), None)
    return 0


# -- running -----------------------------------------------------------------------------------------------------------
def _run(
    args: argparse.Namespace,
    bench: Bench,
    drive: dict[str, Any] | None,
    pace: Pace,
    serve: Callable[[float], None] | None,
    *,
    counts_per_rev: int | None = None,
) -> None:
    """Print the interfaces as JSON, run until a signal or the time limit, print the final state of the axis as JSON."""
    with _until_signal() as keep_running:
        laser = {"kind": args.kind, "port": bench.laser_path} if bench.has_instrument else None
        if args.like is not None and drive is not None:
            drive = {**drive, "like": str(args.like.resolve())}
        if getattr(args, "axis_file", None):
            instrument = instrument_text(args.kind, bench.laser_path)
            name = _axis_name(args)  # its campaigns have a folder of their own
            text = axis_text(bench.parameters, drive or {}, instrument, counts_per_rev, name)
            replace_file(args.axis_file, text.encode())
            campaigns = load_drive_axis(args.axis_file).store.directory
            if campaigns.exists():
                print(
                    f"hil: {campaigns} has measurements of another machine of this name; give each its own folder",
                    file=sys.stderr,
                )
        machine: dict[str, Any] = {"kind": args.machine, "seed": args.seed or 0}
        if args.like is not None:
            effects = dict(read_likeness(args.like).effects)
            machine = {"kind": "likeness", "like": str(args.like), "effects": effects}
            print(
                f"hil: a likeness of the axis in {args.like} to rehearse on; it proves nothing of that axis",
                file=sys.stderr,
            )
        machine["length_mm"] = bench.parameters.plant.length_mm
        print(json.dumps({"machine": machine, "drive": drive, "laser": laser}), flush=True)
        end = None if args.seconds is None else pace.wall.deadline(args.seconds)
        run_in_real_time(
            pace, keep_running=lambda: keep_running() and not (end is not None and end.expired), idle=serve
        )
    servo = bench.servo
    left = {
        "powered": servo.powered,
        "moving": servo.velocity_actual_counts_s != 0,
        "fault_code": servo.fault_code,
        "position_mm": bench.plant.position_mm,
    }
    print(json.dumps({"left": left}), flush=True)


def _axis_name(args: argparse.Namespace) -> str:
    """The name of the file or of the likeness's axis, as a name of at most 64 characters."""
    likeness = None if args.like is None else args.like.resolve().name.removesuffix("-campaign")
    name = re.sub(r"\A[.-]|[^A-Za-z0-9_.-]", "_", likeness or Path(args.axis_file).stem)[:59]
    return name if likeness is None else f"{name}-like"


@contextmanager
def _until_signal() -> Iterator[Callable[[], bool]]:
    """A function that is true until SIGINT or SIGTERM, which set it false instead of raising."""
    received: list[int] = []

    def end(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: not received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _check_axis_file(args: argparse.Namespace) -> None:
    if args.axis_file is None:
        return
    if not args.laser:
        raise InputError("--axis-file needs --laser: an axis file names an instrument")
    if Path(args.axis_file).exists():
        raise InputError("exists already, and might be a real machine's; expected a new file", path=args.axis_file)
