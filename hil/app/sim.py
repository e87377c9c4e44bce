"""`hil sim`: a simulated machine, or a part of it, as a process on a real interface (CAN, Modbus, pty)."""

from __future__ import annotations

import argparse
import json
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
from hil.axis.connections import BENCH_MACHINES, BENCH_TABLES
from hil.machine.likeness import read_likeness
from hil.machine.simulated_file import axis_text, instrument_text
from sim_backends.bench import Bench, BenchParameters, known_bench
from sim_backends.canopen_faults import CanFaultKind
from sim_backends.canopen_strict import StrictSlave
from sim_backends.drive_profiles import load_profile, profile_paths
from sim_backends.fault_text import Faults, fault_names, parse_faults
from sim_backends.faults import FaultKind
from sim_backends.gauge import GAUGE_KINDS, GaugeParameters
from sim_backends.homing import HOMING_METHODS
from sim_backends.likeness import alike
from sim_backends.machine import MODBUS_SHAPES, CanDrive, modbus_face, modbus_server, open_bus
from sim_backends.maker_file import read_maker_file
from sim_backends.modbus_faults import WireFaultKind
from sim_backends.own_table import known_table
from sim_backends.reach import check_can, parse_tcp
from sim_backends.serve import Pace, Shuttle, run_in_real_time

EXAMPLE = """\
example: a machine in one terminal, its commissioning in another
  sudo ip link add vcan0 type vcan && sudo ip link set vcan0 up
  hil sim drive --channel vcan0 --laser --axis-file X.toml
  hil doctor X.toml

no CAN in the kernel:  hil sim drive --interface slcan-pty --laser --axis-file X.toml
over Modbus:           hil sim modbus --tcp 127.0.0.1:0 --laser --axis-file X.toml
the instrument alone:  hil sim laser, hil sim laser --kind nd2xx

The first line on standard output is JSON and says what is where. Ctrl-C or SIGTERM ends it; the last line says how the axis was left.
"""
INSTRUMENT_KINDS = ("umd", *GAUGE_KINDS)
FAULT_HELP = "what goes wrong, and when: KIND@SECONDS[+SECONDS][=SIZE], for example beam-lost@20+3 (repeatable)"


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil sim`."""
    parser = subparsers.add_parser(
        "sim",
        description="Run a simulated machine, or a part of one, as a process of its own in real time.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parts = parser.add_subparsers(title="parts", metavar="PART", required=True)
    _add_drive(parts)
    _add_modbus(parts)
    _add_laser(parts)


def _add_drive(parts: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    drive = parts.add_parser(
        "drive",
        help="a CiA-402 drive on a CAN interface",
        description="A CiA-402 drive with its axis on a CAN interface, and on request the laser that looks at the axis.",
        epilog=EXAMPLE
        + f"\nfaults of the bus: {', '.join(fault_names(CanFaultKind))}"
        + f"\n\nprofiles, as documented in the sources that each of their files names: {', '.join(profile_paths())}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    drive.add_argument(
        "--interface",
        default="socketcan",
        help="interface of python-can (default socketcan), or slcan-pty: an adapter on a pty",
    )
    drive.add_argument("--channel", default="vcan0", help="default vcan0")
    drive.add_argument("--bitrate", type=int, help="bit/s, for interfaces that set it")
    drive.add_argument("--node", type=int, default=1, help="node id, 1 to 127 (default 1)")
    drive.add_argument(
        "--table", choices=BENCH_TABLES, default="", help="a correction table that the drive holds itself"
    )
    drive.add_argument(
        "--eds",
        metavar="FILE",
        help="a maker's EDS or DCF file: the drive has its objects, rights, limits and units, and nothing else",
    )
    drive.add_argument(
        "--profile",
        metavar="NAME",
        help="a documented drive (list below) or a profile's file: its objects, units, PDO rules and behaviour; with --eds, the"
        " objects of that file",
    )
    _add_surroundings(drive)
    _add_homing(drive)
    _add_machine(drive)
    drive.set_defaults(run=_run_drive)


def _add_modbus(parts: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    modbus = parts.add_parser(
        "modbus",
        help="a Modbus drive on a TCP port or a pty",
        description="A Modbus drive with its axis, and on request the laser that looks at the axis.",
        epilog=EXAMPLE
        + f"\nfaults of the wire, as KIND#REQUEST[*COUNT][=SECONDS]: {', '.join(fault_names(WireFaultKind))}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    where = modbus.add_mutually_exclusive_group(required=True)
    where.add_argument("--tcp", metavar="HOST:PORT", help="listen there; port 0 asks for a free one")
    where.add_argument("--pty", action="store_true", help="a serial line (RTU) on a new pty")
    modbus.add_argument("--unit", type=int, default=1, help="unit id (default 1)")
    modbus.add_argument("--shape", choices=MODBUS_SHAPES, default="cia402", help="which register set (default cia402)")
    _add_surroundings(modbus)
    _add_homing(modbus)
    _add_machine(modbus)
    modbus.set_defaults(run=_run_modbus)


def _add_laser(parts: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    laser = parts.add_parser(
        "laser",
        help="a laser interferometer or gauge on a pty, over an axis that shuttles",
        description="A µMD laser interferometer, or another instrument, on a pseudo-terminal, looking at an axis that goes to and fro"
        " by itself.",
        epilog=EXAMPLE + f"\nfaults of laser and motor: {', '.join(fault_names(FaultKind))}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    laser.add_argument("--still", action="store_true", help="the axis stands")
    _add_machine(laser)
    laser.set_defaults(run=_run_laser)


def _add_surroundings(parser: argparse.ArgumentParser) -> None:
    """Options of a drive on a wire: its laser, an axis file, other hosts."""
    parser.add_argument("--laser", action="store_true", help="the machine's laser too, on a pty")
    parser.add_argument("--axis-file", metavar="FILE", help="write an axis file for this machine (needs --laser)")
    parser.add_argument(
        "--allow-outside",
        action="store_true",
        help="allow an interface or address that others than this machine can reach",
    )


def _add_homing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--homing",
        type=int,
        choices=sorted(HOMING_METHODS),
        default=BenchParameters().homing_method,
        metavar="METHOD",
        help="the drive's homing method, by 6098h (default %(default)s, a limit switch and the index pulse); 37 takes the place where"
        " the axis stands for zero",
    )


def _add_machine(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("the machine")
    which = group.add_mutually_exclusive_group()
    which.add_argument("--machine", choices=BENCH_MACHINES, default="typical", help="default typical")
    which.add_argument(
        "--like",
        metavar="X-campaign",
        type=Path,
        help="in place of --machine, one with the errors that were measured of a real axis: folder of its campaigns; a likeness to"
        " rehearse on, no proof",
    )
    group.add_argument("--seed", type=int, default=0, help="which of those machines (default 0)")
    group.add_argument(
        "--kind",
        choices=INSTRUMENT_KINDS,
        default="umd",
        help="the instrument (default: umd, the µMD laser)",
    )
    group.add_argument(
        "--rate",
        type=float,
        default=50.0,
        help="readings per second of an instrument that sends by itself (default 50)",
    )
    group.add_argument(
        "--effect", action="append", default=[], metavar="ID=UM", help="one more effect of the catalogue (repeatable)"
    )
    group.add_argument("--fault", action="append", default=[], metavar="FAULT", help=FAULT_HELP)
    group.add_argument("--for", dest="seconds", type=float, metavar="S", help="end by itself after so many seconds")


# -- the machine -------------------------------------------------------------------------------------------------------
def _parameters(args: argparse.Namespace, faults: Faults) -> BenchParameters:
    if not 1.0 <= args.rate <= 2000.0:
        raise InputError(f"--rate is {args.rate:g}, expected 1 to 2000 readings per second")
    if args.seed < 0:
        raise InputError(f"--seed is {args.seed}, expected a whole number >= 0")
    parameters = known_bench(args.machine, args.seed) if args.like is None else alike(read_likeness(args.like))
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


def _run_drive(args: argparse.Namespace) -> int:
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


def _run_modbus(args: argparse.Namespace) -> int:
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


def _run_laser(args: argparse.Namespace) -> int:
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
        if getattr(args, "axis_file", None):
            instrument = instrument_text(args.kind, bench.laser_path)
            name = "X" if args.like is None else f"{args.like.resolve().name.removesuffix('-campaign')}-like"
            text = axis_text(bench.parameters, drive or {}, instrument, counts_per_rev, name)
            replace_file(args.axis_file, text.encode())
        machine = {"kind": args.machine, "seed": args.seed, "length_mm": bench.parameters.plant.length_mm}
        if args.like is not None:
            machine = {
                **machine,
                "kind": "likeness",
                "like": str(args.like),
                "effects": dict(read_likeness(args.like).effects),
            }
            print(
                f"hil: a likeness of the axis in {args.like} to rehearse on; it proves nothing of that axis",
                file=sys.stderr,
            )
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
