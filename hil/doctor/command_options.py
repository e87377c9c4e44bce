"""Options of `hil doctor`."""

from __future__ import annotations

from hil.ui.terminal.options import Later, Subparsers, add_axis_arguments, add_in_motion_options, feeds, verb_parser

EXAMPLE = """\
example:
  hil doctor X.toml
  hil doctor X.toml --no-move                look only, move nothing
  hil doctor X.toml --home                   and home it: proves what its register map says of homing
  hil doctor X.toml --latency 20,110         passes up and down at these feeds: how late the instrument's readings are
  hil doctor X.toml --probe-order position=120345 --tolerance 50
                                             which type, word and byte order show what the drive's own display shows (Modbus)

What the drive says of its units (608Fh, 6091h, 6092h, 60A8h, or by its register map) is compared with the axis file before anything
moves; small moves prove them, way against the instrument, speed against the clock, very slow ones first. Passes in motion cannot tell
a late reading from a table that trails its motor by a time; an edge that drive and instrument share ([instrument] trigger_input) can.
Exit status 1: a check failed.
"""


def add_parser(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "doctor",
        "Is everything there, and are the units what the axis file says? Asked of the drive, proven by small moves.",
        EXAMPLE,
    )
    add_axis_arguments(parser)
    parser.add_argument("--no-move", action="store_true", help="leave out the proof of the units, which moves the axis")
    parser.add_argument(
        "--trust-file",
        action="store_true",
        help="tell what the drive says of its units, but hold the axis file for right",
    )
    parser.add_argument(
        "--home",
        action="store_true",
        help="when all is good, also home the axis: proves what its register map says of homing",
    )
    parser.add_argument(
        "--latency",
        metavar="MM_S",
        type=feeds,
        help="when all is good, also measure the instrument's latency, e.g. 20,110 (mm/s)",
    )
    add_in_motion_options(parser)
    parser.add_argument(
        "--probe-order",
        metavar="REG=VALUE",
        help="look for a known value in and around a register; nothing else is done",
    )
    parser.add_argument(
        "--tolerance", metavar="V", type=float, default=0.0, help="how far the known value may be off (default 0)"
    )
    parser.set_defaults(run=Later("hil.doctor.command"))
