"""Options of `hil scan`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_json_option

EXAMPLE = """\
example:
  hil scan --channel can0                            every CANopen node: identity, state
  hil scan --channel can0 --listen 2                 send nothing, list the nodes heard: for a bus that has another master
  hil scan --interface slcan --channel /dev/ttyACM0
  hil scan --tcp 192.168.0.20                        Modbus units 1 to 16
  hil scan --serial "/dev/ttyUSB0?parity=N" --baud 9600 --units 1-31,100 --map vendor_style

Nothing is written to any device. Exit status 1: no device was found.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil scan`."""
    parser = subparsers.add_parser(
        "scan",
        description="List the CANopen nodes of a CAN bus, or the units of a Modbus line, with their identity and state.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--channel", help="CAN channel, such as can0 or a serial adapter's device")
    where.add_argument("--tcp", metavar="HOST[:PORT]", help="Modbus TCP server (port 502 unless given)")
    where.add_argument("--serial", metavar="DEVICE", help="Modbus RTU line")
    can = parser.add_argument_group("CANopen")
    can.add_argument("--interface", default="socketcan", help="interface of python-can (default socketcan)")
    can.add_argument("--bitrate", type=int, help="bit/s, for interfaces that set it")
    can.add_argument("--nodes", metavar="IDS", default="1-127", help="which to ask (default 1-127)")
    can.add_argument("--listen", metavar="S", type=float, help="send nothing, listen for S seconds")
    line = parser.add_argument_group("Modbus")
    line.add_argument("--units", metavar="IDS", default="1-16", help="which to ask (default 1-16)")
    line.add_argument("--baud", type=int, default=19_200, help="of a serial line (default 19200)")
    line.add_argument("--map", metavar="MAP", help="register map, shipped or a file: read each drive's state too")
    parser.add_argument("--timeout", metavar="S", type=float, help="for one answer (default 0.1 on CAN, 0.2 on Modbus)")
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.scan"))
