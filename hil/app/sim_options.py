"""Options of `hil sim`."""

from __future__ import annotations

import argparse
from pathlib import Path

from hil.axis import BENCH_MACHINES, BENCH_TABLES
from hil.ui.terminal.options import Later, Subparsers, verb_parser
from sim_backends import GAUGE_KINDS, MODBUS_SHAPES, profile_paths
from sim_backends.faults import CanFaultKind, FaultKind, WireFaultKind, fault_names
from sim_backends.homing import HOMING_METHODS, LIMIT_SWITCH_AND_INDEX

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


def add_parser(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers, "sim", "Run a simulated machine, or a part of one, as a process of its own in real time.", EXAMPLE
    )
    parts = parser.add_subparsers(title="parts", metavar="PART", required=True)
    _add_drive(parts)
    _add_modbus(parts)
    _add_laser(parts)


def _part(parts: Subparsers, name: str, words: str, description: str, known: str) -> argparse.ArgumentParser:
    """The parser of a part. words: in the list of parts; known: names that its options take, below the example."""
    layout = argparse.RawDescriptionHelpFormatter
    epilog = f"{EXAMPLE}\n{known}"
    return parts.add_parser(name, help=words, description=description, epilog=epilog, formatter_class=layout)


def _add_drive(parts: Subparsers) -> None:
    drive = _part(
        parts,
        "drive",
        "a CiA-402 drive on a CAN interface",
        "A CiA-402 drive with its axis on a CAN interface, and on request the laser that looks at the axis.",
        f"faults of the bus: {', '.join(fault_names(CanFaultKind))}"
        f"\n\nprofiles, as documented in the sources that each of their files names: {', '.join(profile_paths())}",
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
    drive.set_defaults(run=Later("hil.app.sim", "run_drive"))


def _add_modbus(parts: Subparsers) -> None:
    modbus = _part(
        parts,
        "modbus",
        "a Modbus drive on a TCP port or a pty",
        "A Modbus drive with its axis, and on request the laser that looks at the axis.",
        f"faults of the wire, as KIND#REQUEST[*COUNT][=SECONDS]: {', '.join(fault_names(WireFaultKind))}",
    )
    where = modbus.add_mutually_exclusive_group(required=True)
    where.add_argument("--tcp", metavar="HOST:PORT", help="listen there; port 0 asks for a free one")
    where.add_argument("--pty", action="store_true", help="a serial line (RTU) on a new pty")
    modbus.add_argument("--unit", type=int, default=1, help="unit id (default 1)")
    modbus.add_argument("--shape", choices=MODBUS_SHAPES, default="cia402", help="which register set (default cia402)")
    _add_surroundings(modbus)
    _add_homing(modbus)
    _add_machine(modbus)
    modbus.set_defaults(run=Later("hil.app.sim", "run_modbus"))


def _add_laser(parts: Subparsers) -> None:
    laser = _part(
        parts,
        "laser",
        "a laser interferometer or gauge on a pty, over an axis that shuttles",
        "A µMD laser interferometer, or another instrument, on a pseudo-terminal, looking at an axis that goes to and fro by itself.",
        f"faults of laser and motor: {', '.join(fault_names(FaultKind))}",
    )
    laser.add_argument("--still", action="store_true", help="the axis stands")
    _add_machine(laser)
    laser.set_defaults(run=Later("hil.app.sim", "run_laser"))


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
        default=LIMIT_SWITCH_AND_INDEX,
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
    group.add_argument("--seed", type=int, help="which of the machines of that name (default 0)")
    group.add_argument(
        "--kind", choices=INSTRUMENT_KINDS, default="umd", help="the instrument (default: umd, the µMD laser)"
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
