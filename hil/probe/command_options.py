"""Options of `hil probe`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from hil.probe import MODES
from hil.ui.terminal.options import KEY, READING, Later, Subparsers, add_json_option, positive, verb_parser, whole_type

_COUNT = whole_type(1, sys.maxsize, "a whole number > 0")

EXAMPLE = """\
example:
  hil probe measure mill.toml --dry-run              what would move, and how far
  hil probe measure mill.toml --report probe.html    M90: run-out and tip radius, put into force if it closes
  hil probe measure mill.toml --mode step            by pulses, where the drive latches no positions
  hil probe measure mill.toml --every 30             again every 30 minutes, until interrupted
  hil probe correct mill.toml --code M91             move X by the run-out in force (M92: Y, M93: both)
  hil probe centre mill.toml                         touch a bore on both sides in X and Y, go to its centre
  hil probe face mill.toml --spindle 30              where a face is; also: boss, reference, angle
  hil probe codes mill.toml                          do so when the control asks for it by its M codes

Where [machine] names no z axis, Z is the operator's: jog the probe to the height of block, bore or face first.
hil/examples/probe_machine.toml shows a machine file.
Exit status 1: the measurement was refused, as the contacts do not close, do not repeat, or give another radius; nothing was stored.
"""


CODES = "M91: correct X, M92: Y, M93: both, unless [codes] of the machine file says otherwise"


OTHERS = (
    ("face", "where a single face is"),
    ("angle", "the angle of a face"),
    ("boss", "middle and widths of a boss"),
    ("reference", "a reference position, where two faces meet"),
)


def add_parser(subparsers: Subparsers) -> None:
    """Adds `hil probe` with its jobs."""
    parser = verb_parser(
        subparsers,
        "probe",
        "Measure the run-out of a touch probe on a reference block, and correct measurements by it.",
        EXAMPLE,
    )
    jobs = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    measure = _add_job(
        jobs,
        "measure",
        "M90: run-out and tip radius, from contacts at 0, 90, 180 and 270°",
        Later("hil.probe.command", "run_measure"),
    )
    measure.add_argument("--every", metavar="MINUTES", type=positive, help="again at this interval, until interrupted")
    measure.add_argument("--times", metavar="N", type=_COUNT, help="with --every: number of measurements")
    measure.add_argument("--report", metavar="FILE.html", help="also write a report")
    correct_ = _add_job(
        jobs,
        "correct",
        "M91, M92, M93: drive the axes by the run-out in force",
        Later("hil.probe.command", "run_correct"),
    )
    correct_.add_argument("--code", metavar="M91|M92|M93", required=True, help=CODES)
    centre = _add_job(
        jobs,
        "centre",
        "find a bore's centre, corrected by the run-out in force, and go there",
        Later("hil.probe.command", "run_centre"),
    )
    centre.add_argument("--code", metavar="M91|M92|M93", help=f"{CODES} (default: both)")
    centre.add_argument("--report", metavar="FILE.html", help="also write a report")
    others = [
        _add_job(
            jobs, name, f"measure {what}, corrected by the run-out in force", Later("hil.probe.command", "run_other")
        )
        for name, what in OTHERS
    ]
    for (name, _), other in zip(OTHERS, others, strict=True):
        other.set_defaults(feature=name)
        other.add_argument(
            "--spindle", metavar="DEGREES", type=float, help="turn the spindle there before (default: as it is)"
        )
    codes = _add_job(
        jobs,
        "codes",
        "wait for a control's M codes, do what they ask for, answer with MFIN",
        Later("hil.probe.command", "run_codes"),
    )
    codes.add_argument(
        "--times", metavar="N", type=_COUNT, help="number of codes to handle (default: until interrupted)"
    )
    codes.add_argument("--wait", metavar="SECONDS", type=positive, help="longest wait for a code (default: no limit)")
    for touching in (measure, centre, codes, *others):
        touching.add_argument(
            "--mode", choices=MODES, help="contacts by latch or by steps (default: the machine file's)"
        )


def _add_job(
    jobs: argparse._SubParsersAction[argparse.ArgumentParser], name: str, what: str, run: Callable[..., int]
) -> argparse.ArgumentParser:
    parser = jobs.add_parser(
        name, help=what, description=what, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("machine", metavar="MACHINE.toml", help="the machine file")
    parser.add_argument("--dry-run", action="store_true", help="say what would be moved and written, and do nothing")
    parser.add_argument(
        "--password-file",
        metavar="F",
        help=f"of a sealed store: file with the reading password (else ${READING}, else asked)",
    )
    parser.add_argument(
        "--key-password-file",
        metavar="F",
        help=f"of a sealed store: file with the builder key's password (else ${KEY}, else asked)",
    )
    add_json_option(parser)
    parser.set_defaults(run=run)
    return parser
