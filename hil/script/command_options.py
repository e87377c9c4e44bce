"""Options of `hil run`: its own, and one for each parameter of the procedure that the command line names."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from drivers.errors import InputError
from hil.ui.terminal.options import READING, Later, Subparsers, add_axis_arguments, add_zero_options, verb_parser

EXAMPLE = """\
example:
  hil run creep.py --help                           the parameters of the procedure, with their usual values
  hil run creep.py X.toml --dry-run                 what would move, between which positions
  hil run creep.py X.toml --watch-s 60 --report creep.html
  hil run creep.py X.toml --watch-s 60 --resume     after an interruption, from the run that was broken off
  hil diagnose X-campaign/run-creep-001/creep.csv   what the rows show

creep.py holds a class of hil.Procedure; `hil help scripts` shows one. Its code is yours: it is run as any program of yours.
The axis is homed, the procedure moves it within its own plan alone, and each row is on disk before the next is measured.
Exit status 2: the file, a parameter or a row is wrong, and the axis was stopped and left as it was found; 1: the machine did not let
it finish.
"""


def add_parser(subparsers: Subparsers) -> None:
    """Adds `hil run`."""
    parser = verb_parser(
        subparsers,
        "run",
        "Carry out a measuring procedure of yours: with dry run, journal, stop and resume as the other verbs.",
        EXAMPLE,
    )
    parser.add_argument("procedure", metavar="PROCEDURE.py", help="Python code with a class of hil.Procedure")
    add_axis_arguments(parser)
    parser.add_argument(
        "--resume", action="store_true", help="go on with what was interrupted, with the same parameters"
    )
    parser.add_argument("--corrected", action="store_true", help="with the stored correction in force")
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser, anew=True)
    parser.add_argument(
        "--password-file",
        metavar="F",
        help=f"with --corrected: file with the tables' reading password (else ${READING}, else asked)",
    )
    parser.set_defaults(run=Later("hil.script.command"), procedure_class=None)


def add_options_of(argv: Sequence[str], parser: argparse.ArgumentParser) -> None:
    """Adds the parameters of the procedure, if the words name a file of one. Raises as `load_procedure`."""
    path = next((word for word in argv if word.endswith(".py") and not word.startswith("-")), None)
    if path is None:
        return
    from hil.script.procedure_file import class_line, load_procedure, parameters_of  # noqa: PLC0415  (loads the user's code)

    procedure = load_procedure(path)
    group = parser.add_argument_group(f"parameters of {procedure.__name__}")
    for one in parameters_of(procedure):
        try:
            one.add_to(group)
        except argparse.ArgumentError as error:
            what = f"declares {one.name}, and hil run has an option of this name"
            raise InputError(what, path=path, line=class_line(procedure, one.name)) from error
    parser.set_defaults(procedure_class=procedure, resumes=procedure.kind)
