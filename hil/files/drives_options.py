"""Options of `hil drives`."""

from __future__ import annotations

import argparse
from typing import Any

from hil.files.first_axis_file import CANOPEN, QUESTIONS
from hil.ui.terminal.options import Later

EXAMPLE = """\
example:
  hil drives list                                     every ready drive file
  hil drives show leadshine_el7                       what it says, and where each fact comes from
  hil drives new X.toml --drive leadshine_el7 --serial /dev/ttyUSB1
                                                      asks for what only you know, reads the rest from the drive
  hil drives new X.toml --drive kollmorgen_akd2g --tcp 192.168.0.20 --travel 0,500 --max-velocity 100 --max-acceleration 500 \\
      --counts-per-rev 360000 --feed 10 --instrument-port /dev/ttyUSB0 --known position=120345 --tolerance 50
  hil drives new X.toml --drive canopen --channel can0 --node 3
  hil drives new X.toml --drive trinamic_tmcm --channel can0 --node 3 --velocity-unit rpm --eds TMCM-1270.eds

Then: hil doctor X.toml. "new" writes nothing to the drive, except with --set-up what the drive file needs and the user agrees to.
Exit status 1: the drive does not answer as its file says; the axis file is not written.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    text = "Ready drive files: list them, show what each fact rests on, make a first axis file."
    how: dict[str, Any] = {"epilog": EXAMPLE, "formatter_class": argparse.RawDescriptionHelpFormatter}
    parser = subparsers.add_parser("drives", description=text, **how)
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    job = jobs.add_parser("list", help="every ready drive file", description="List the ready drive files.", **how)
    job.add_argument("--json", metavar="FILE", help="also write the result as JSON to FILE")
    job.set_defaults(run=Later("hil.files.drives_shown", "list_drives"))
    job = jobs.add_parser("show", help="one drive file", description="Show a drive file and its sources.", **how)
    job.add_argument(
        "name", metavar="NAME", help="a name of the list, of a drive file or of notes, or a register map of your own"
    )
    job.add_argument("--json", metavar="FILE", help="also write the result as JSON to FILE")
    job.set_defaults(run=Later("hil.files.drives_shown", "show_drive"))
    job = jobs.add_parser("new", help="a first axis file", description="Make a first axis file for a drive.", **how)
    job.add_argument("file", metavar="AXIS.toml", help="the file to write; one that exists is refused")
    job.add_argument("--drive", metavar="NAME", required=True, help=f"a name of the list, a register map, or {CANOPEN}")
    where = job.add_mutually_exclusive_group()
    where.add_argument("--tcp", metavar="HOST[:PORT]", help="Modbus TCP")
    where.add_argument("--serial", metavar="DEVICE", help="Modbus RTU line, e.g. /dev/ttyUSB1")
    where.add_argument("--channel", help="CAN channel")
    job.add_argument("--interface", default="socketcan", help="interface of python-can (default socketcan)")
    job.add_argument("--bitrate", type=int, default=1_000_000, help="of the CAN bus (default 1000000)")
    job.add_argument("--node", type=int, metavar="ID", help="CANopen node id")
    job.add_argument("--axis", metavar="N", help="of a CANopen node with several axes (default 1)")
    job.add_argument("--eds", metavar="FILE", help="the maker's EDS or DCF file of a CANopen drive")
    job.add_argument("--velocity-unit", metavar="UNIT", help="of a CANopen drive that does not state it, such as rpm")
    job.add_argument(
        "--acceleration-unit", metavar="UNIT", help="of a CANopen drive that does not state it, such as rpm/s"
    )
    job.add_argument("--unit", type=int, metavar="ID", help="Modbus unit (default: the drive's from the factory)")
    job.add_argument("--baud", type=int, help="of the serial line (default: the drive's from the factory)")
    job.add_argument("--timeout", type=float, default=1.0, metavar="S", help="for one answer (default 1)")
    for question in QUESTIONS:
        job.add_argument(question.option, metavar=question.metavar, help=question.asks)
    job.add_argument(
        "--direction", type=int, choices=(1, -1), default=1, help="-1: the table's position falls when counts rise"
    )
    job.add_argument(
        "--known", metavar="REG=VALUE", help="what the drive's display shows of a register: finds the word order"
    )
    job.add_argument(
        "--tolerance", type=float, default=0.0, metavar="V", help="how far the value of --known may be off"
    )
    job.add_argument(
        "--set-up", action="store_true", help="write what the drive file needs and says that it may be written"
    )
    job.add_argument("--json", metavar="FILE", help="also write the result as JSON to FILE")
    job.set_defaults(run=Later("hil.files.drives"))
