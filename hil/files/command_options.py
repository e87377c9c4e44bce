"""Options of the verbs on sealed files, buses, figures and campaigns."""

from __future__ import annotations

import argparse
from typing import Any

from hil.correction import WIDE_ISO_CELLS
from hil.figures import FIGURES
from hil.ui.terminal.options import (
    Later,
    Subparsers,
    add_json_option,
    add_key_options,
    add_reading_options,
    verb_parser,
)

# -- hil scan ----------------------------------------------------------------------------------------------------------
SCAN_EXAMPLE = """\
example:
  hil scan --channel can0                            every CANopen node: identity, state
  hil scan --channel can0 --listen 2                 send nothing, list the nodes heard: for a bus that has another master
  hil scan --interface slcan --channel /dev/ttyACM0
  hil scan --tcp 192.168.0.20                        Modbus units 1 to 16
  hil scan --serial "/dev/ttyUSB0?parity=N" --baud 9600 --units 1-31,100 --map vendor_style

Nothing is written to any device. Exit status 1: no device was found.
"""


def add_scan(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "scan",
        "List the CANopen nodes of a CAN bus, or the units of a Modbus line, with their identity and state.",
        SCAN_EXAMPLE,
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


# -- hil iso230 --------------------------------------------------------------------------------------------------------
ISO230_EXAMPLE = """\
example:
  hil iso230 records.csv
  hil iso230 records.csv --json figures.json

The deviation of a row is measured - target: with a correction in force, the figures are those of the corrected axis.
"""


def add_iso230(subparsers: Subparsers) -> None:
    """Adds `hil iso230`."""
    parser = verb_parser(
        subparsers,
        "iso230",
        "Accuracy and repeatability of positioning of a linear axis by ISO 230-2:2014.",
        ISO230_EXAMPLE,
    )
    parser.add_argument(
        "records", metavar="RECORDS.csv", help="measurement records: run, direction, target_mm, measured_mm"
    )
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.iso230"))


# -- hil iso230-4 ------------------------------------------------------------------------------------------------------
ISO230_4_EXAMPLE = """\
example:
  hil iso230-4 ccw.json cw.json                     two results of `hil circle --json`, the second with --clockwise
  hil iso230-4 path.csv --radius 100                one path: no bi-directional figures
  hil iso230-4 ccw.csv cw.csv --radius 150 --json figures.json

A CSV file has a header and the points of one turn in the order of time: x_mm,y_mm, or angle_deg,deviation_um of a telescoping bar (the
angle from the first axis, the deviation from the nominal radius). Lines that begin with # are left out. Other columns are ignored.
"""


def add_iso230_4(subparsers: Subparsers) -> None:
    """Adds `hil iso230-4`."""
    parser = verb_parser(
        subparsers,
        "iso230-4",
        "Circular deviation G, radial deviation F and, of both senses, G(b) and D by ISO 230-4:2005.",
        ISO230_4_EXAMPLE,
    )
    parser.add_argument("paths", metavar="PATH", nargs="+", help="one or two files: .json of `hil circle`, or .csv")
    parser.add_argument("--radius", metavar="MM", type=float, help="nominal radius of paths in CSV files")
    parser.add_argument(
        "--circle", metavar="NAME", help="which circle of a .json: uncorrected, tables, corrected (default: the last)"
    )
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.iso230", "run_circle"))


# -- hil records -------------------------------------------------------------------------------------------------------
RECORDS_EXAMPLE = """\
example:
  hil records list .                                    every campaign below this directory, by date
  hil records inspect X-campaign/calibrate-003          its purpose, its passes, whether they are unchanged
  hil records merge jan.csv feb.csv --out both.csv      runs numbered on, times by the dates of the passes
  hil records export X-campaign/verify-001/verify.csv --format iso-wide --out table.csv
  hil records history X-campaign --figure A --figure R --out history.html

Exit status 1: inspect found a pass that was changed, torn, or cannot be read.
"""


def add_records(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "records",
        "List, inspect, merge and export measurement records. No existing file is changed.",
        RECORDS_EXAMPLE,
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    one = _job(jobs, "list", "every campaign below some directories, by date", Later("hil.files.records", "run_list"))
    one.add_argument("places", metavar="DIRECTORY", nargs="+")
    one = _job(
        jobs,
        "inspect",
        "one campaign: purpose, passes, whether they are unchanged",
        Later("hil.files.records", "run_inspect"),
    )
    one.add_argument("campaign", metavar="CAMPAIGN", help="its directory")
    one = _job(jobs, "merge", "record files as one, in the order of time", Later("hil.files.records", "run_merge"))
    one.add_argument("records", metavar="RECORDS.csv", nargs="+")
    one.add_argument("--out", metavar="OUT.csv", required=True)
    one = _job(jobs, "export", "records for other programs", Later("hil.files.records", "run_export"))
    one.add_argument("records", metavar="RECORDS.csv")
    one.add_argument("--format", choices=("csv", "iso-wide", "json"), required=True)
    one.add_argument(
        "--cells", choices=tuple(WIDE_ISO_CELLS), default="deviation_um", help="iso-wide (default deviation_um)"
    )
    one.add_argument("--decimal", choices=(".", ","), default=".", help="iso-wide: decimal mark (default .)")
    one.add_argument("--out", metavar="FILE", required=True)
    one = _job(
        jobs, "history", "ISO 230-2 figures over months, with a trend", Later("hil.files.records", "run_history")
    )
    one.add_argument("places", metavar="DIRECTORY", nargs="+")
    one.add_argument("--figure", action="append", choices=tuple(FIGURES), help="may be repeated (default A, R and B)")
    one.add_argument("--axis", metavar="NAME", help="only this axis")
    one.add_argument(
        "--pass", dest="passes", metavar="NAME", action="append", help="passes of this name (default: the most usual)"
    )
    one.add_argument("--out", metavar="HISTORY.html", help="also write an HTML page with the plot")
    one.add_argument("--png", metavar="FILE", help="also write the plot")


def _job(jobs: Any, name: str, what: str, run: Any) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = jobs.add_parser(
        name, help=what, description=what, epilog=RECORDS_EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_json_option(parser)
    parser.set_defaults(run=run)
    return parser


# -- hil seal ----------------------------------------------------------------------------------------------------------
SEAL_EXAMPLE = """\
example:
  hil sign --new-key builder                                        # once: builder.key (keep it), builder.pub (goes with the machine)
  hil seal pitch.json backlash.json --out axis.sealed --key builder.key
  hil seal backlash.json --out axis.sealed --key builder.key --update --entry-password backlash.json=pw.txt

Each file becomes an entry of its own name, encrypted with its password; the builder's key signs the whole.
"""


def add_seal(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "seal",
        "Lock files into one sealed file that machines can run with and only the builder can change.",
        SEAL_EXAMPLE,
    )
    parser.add_argument("files", metavar="FILE", nargs="+", help="files to seal, one entry each")
    parser.add_argument(
        "--out", metavar="SEALED", required=True, help="the sealed file; an older one is replaced in one step"
    )
    parser.add_argument(
        "--update",
        action="store_true",
        help="keep the other entries of SEALED as they are (their passwords are not needed)",
    )
    add_key_options(parser, required=True)
    add_reading_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.sealing", "run_seal"))


# -- hil open ----------------------------------------------------------------------------------------------------------
OPEN_EXAMPLE = """\
example:
  hil open axis.sealed --builder builder.pub --entry pitch.json
  hil open axis.sealed --builder builder.pub --out unlocked/

The builder's signature is checked first; nothing is decrypted from a file that is not as the builder signed it.
"""


def add_open(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "open",
        "Check a sealed file and decrypt its entries, to standard output (one entry) or into a directory.",
        OPEN_EXAMPLE,
    )
    parser.add_argument("sealed", metavar="SEALED", help="the sealed file")
    parser.add_argument("--builder", metavar="BUILDER.pub", required=True, help="the builder's public key")
    parser.add_argument("--entry", metavar="NAME", action="append", help="only this entry; may be repeated")
    parser.add_argument("--out", metavar="DIR", help="write the entries as files into DIR (made if need be)")
    parser.add_argument("--force", action="store_true", help="replace files that are already in DIR")
    add_reading_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.sealing", "run_open"))


# -- hil sign ----------------------------------------------------------------------------------------------------------
SIGN_EXAMPLE = """\
example:
  hil sign --new-key builder                              # makes builder.key (password-protected) and builder.pub
  hil sign report.html --key builder.key                  # writes report.html.sig
  hil sign --accept X.toml                                # the sealed file beside this axis is the one to use
  hil sign axis.sealed --key new.key --builder old.pub    # hands a sealed file on to another key

A sealed file is signed anew only if its present signature is good, so that a file that was changed meanwhile is not signed.
"""


def add_sign(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "sign",
        "Sign a record, a report or a sealed file with the builder's key; or make a key pair.",
        SIGN_EXAMPLE,
    )
    parser.add_argument(
        "file", metavar="FILE", nargs="?", help="a sealed file (signed anew) or any other (gets a FILE.sig)"
    )
    parser.add_argument("--new-key", metavar="NAME", help="make the key pair NAME.key and NAME.pub")
    parser.add_argument(
        "--accept",
        metavar="AXIS.toml",
        help="with the builder's key of the axis file: take its sealed file, though another or a later one was used before",
    )
    parser.add_argument(
        "--builder", metavar="OLD.pub", help="whose signature a sealed file carries now (default: the key's own)"
    )
    add_key_options(parser, required=False)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.sealing", "run_sign"))


# -- hil check ---------------------------------------------------------------------------------------------------------
CHECK_EXAMPLE = """\
example:
  hil check axis.sealed --builder builder.pub
  hil check report.html --builder builder.pub      # with report.html.sig beside it

exit code: 0 as the builder signed it, 1 not, 2 cannot be checked.
"""


def add_check(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "check",
        "Check a sealed file, or a file with a detached signature, against the builder's public key.",
        CHECK_EXAMPLE,
    )
    parser.add_argument("file", metavar="FILE", help="a sealed file, or any file with a FILE.sig")
    parser.add_argument("--builder", metavar="BUILDER.pub", required=True, help="the builder's public key")
    parser.add_argument("--signature", metavar="SIG", help="the detached signature (default: FILE.sig)")
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.sealing", "run_check"))
