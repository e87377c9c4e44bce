"""`hil run`: a user's own procedure."""

from __future__ import annotations

import argparse
import os

from drivers.errors import InputError
from hil.axis.axis_file import load_axis
from hil.script.open_axis import open_axis
from hil.script.procedure import Procedure, values_of
from hil.script.procedure_file import made_from
from hil.script.procedure_job import procedure_plan
from hil.ui.terminal.axis_options import print_plan
from hil.ui.terminal.options import READING
from hil.ui.terminal.output import finish, from_here, print_facts
from hil.ui.terminal.passwords import password
from hil.ui.terminal.progress import terminal_progress


def run(args: argparse.Namespace) -> int:
    """Returns 0. Raises InputError for a wrong file, and what the procedure and the axis raise."""
    if args.procedure_class is None:
        raise InputError("expected a file that ends in .py", path=args.procedure)
    procedure, axis = made_from(args.procedure_class, args), load_axis(args.axis)
    if args.dry_run:
        print_facts(_parameters(procedure))
        print_plan(axis, procedure_plan(procedure, axis))
        return 0
    usual = axis.store.password_file
    reading = (
        password(args.password_file, READING, "reading password", os.environ, usual=usual) if args.corrected else None
    )
    with terminal_progress() as listener, open_axis(args.axis, password=reading, on_event=listener) as opened:
        result = opened.run(
            procedure,
            corrected=args.corrected,
            resume=args.resume,
            new_zero=args.new_zero,
            instrument_zeroed=args.instrument_zeroed,
        )
    print(result.sentence)
    print_facts({"rows": from_here(result.path)})
    return finish(args, result)


def _parameters(procedure: Procedure) -> dict[str, str]:
    """The procedure and its parameters, name -> text."""
    given = {name: str(value).strip("[]") for name, value in values_of(procedure).items()}
    return {"procedure": type(procedure).__name__, **given}
