"""Options of `hil params table`."""

from __future__ import annotations

import argparse

from hil.drive_table import DEVIATION_UM, PROVERS, TOLERANCE_UM
from hil.ui.terminal.options import (
    Later,
    Subparsers,
    add_axis_arguments,
    add_password_options,
    positive,
    seed,
    whole_type,
)

EXAMPLE = """\
example:
  hil params table show X.toml                        what the drive holds, and whether it corrects by it
  hil params table download X.toml --dry-run          what would be written, and how near it comes to the stored tables
  hil params table download X.toml                    write, read back, prove on the machine, and switch it on
  hil params table prove X.toml --prove-by drive      the same proof by the value the drive reports, without an instrument
  hil params table remove X.toml                      switch it off and empty it

The drive's table is described in a map: correction_table in [drive] of the axis file (CANopen), [drive.correction_table] of the
register map (Modbus). The drive's correction and the bridge's are never in force together; calibrate, verify and close-loop refuse to
start while the drive's is on. After any error, or Ctrl-C, the drive is restored. Exit status 1: not proven.
"""


def add_table(jobs: Subparsers) -> None:
    """Adds `table` to the jobs of `hil params`."""
    parser = jobs.add_parser(
        "table",
        help="the correction table that the drive holds itself",
        description="Write the stored correction into the drive's own table, prove it there, or take it out.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parts = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    for name, function, text in (
        ("show", "show_table", "what the drive holds"),
        ("download", "download_table", "write the stored tables into the drive, read back, prove, switch on"),
        ("prove", "prove_table", "prove that the drive corrects as the bridge does"),
        ("remove", "remove_table", "switch the drive's correction off and empty its table"),
    ):
        job = parts.add_parser(
            name, help=text, description=text, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        add_axis_arguments(job)
        if name in ("download", "prove"):
            _add_proof_options(job, unproven=name == "download")
        if name == "remove":
            job.add_argument("--keep-contents", action="store_true", help="switch it off only")
        job.set_defaults(run=Later("hil.drive_table.command", function))


def _add_proof_options(job: argparse.ArgumentParser, *, unproven: bool) -> None:
    job.add_argument(
        "--prove-by",
        choices=[one for one in PROVERS if unproven or one != "nothing"],
        default="instrument",
        help="measure it (default), or read the value that the drive adds" + (", or neither" if unproven else ""),
    )
    job.add_argument(
        "--positions",
        type=whole_type(2, 200),
        default=7,
        metavar="N",
        help="number of positions of the proof (default 7)",
    )
    job.add_argument("--runs", type=whole_type(1, 100), default=2, metavar="N", help="of each block (default 2)")
    job.add_argument(
        "--tolerance-um", type=positive, default=TOLERANCE_UM, metavar="UM", help="of the proof (default %(default)s)"
    )
    if unproven:
        job.add_argument(
            "--deviation-um",
            type=positive,
            default=DEVIATION_UM,
            metavar="UM",
            help="largest deviation of the drive's table from the stored ones (default %(default)s)",
        )
    job.add_argument("--seed", type=seed, default=1, help="chooses the positions (default 1)")
    job.add_argument(
        "--tables-only", action="store_true", help="leave fitted effects out, which a drive's table cannot hold"
    )
    add_password_options(job, key=False)
