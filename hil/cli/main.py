"""`hil`: the command line's entry. Every verb registers itself; this decides how errors look and what the process returns.

Exit status: 0 done; 1 the job ran and its verdict is "not good", or the machine did not let it finish; 2 bad input or usage;
130 interrupted. Errors are one line on stderr that says what, where, and what was expected.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import NoReturn

from drivers.errors import BridgeError, LocalError
from hil.cli.signals import ending_like_ctrl_c

VERBS = (
    "demo",
    "scan",
    "doctor",
    "calibrate",
    "verify",
    "backlash",
    "lost_motion",
    "circle",
    "probe",
    "params",
    "close_loop",
    "campaign",
    "diagnose",
    "fit",
    "apply",
    "iso230",
    "records",
    "report",
    "export",
    "import_",
    "seal",
    "open_",
    "sign",
    "check",
    "panel",
    "sim",
)
"""Modules of `hil.cli`, in the order of the help. Only the one that is asked for is loaded: scipy alone takes longer than a verb."""

DONE, NOT_GOOD, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class _OneLineParser(argparse.ArgumentParser):
    """A parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def verb_name(module: str) -> str:
    """What is typed for a module: `close_loop` is close-loop, `open_` is open."""
    return module.rstrip("_").replace("_", "-")


def load_verbs(argv: Sequence[str]) -> list[ModuleType]:
    """The modules that a command line needs: that of its verb, or all of them where it names none."""
    named = [module for module in VERBS if argv and verb_name(module) == argv[0]]
    return [import_module(f"hil.cli.{module}") for module in named or VERBS]


def build_parser(argv: Sequence[str] = ()) -> argparse.ArgumentParser:
    """The whole command line, or as much of it as `argv` needs."""
    parser = _OneLineParser(
        prog="hil",
        description="Measure a feed axis, correct it through its servo drive, prove it, and trace what is left.",
        epilog="hil VERB --help shows an example of each.",
    )
    subparsers = parser.add_subparsers(title="verbs", metavar="VERB", required=True, parser_class=_OneLineParser)
    for verb in load_verbs(argv):
        verb.add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; the process's exit status."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal without µ shows a ?, and the verb goes on
        sys.stdout.reconfigure(errors="replace")
    try:
        argv = sys.argv[1:] if argv is None else argv
        args = build_parser(argv).parse_args(argv)
        with ending_like_ctrl_c():
            status = int(args.run(args))
        if sys.stdout is not None:  # None: we were started with it closed
            sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return NOT_GOOD
    except KeyboardInterrupt:
        print("hil: interrupted; the axis was stopped, what was measured is kept", file=sys.stderr)
        return INTERRUPTED
    except LocalError as error:
        print(f"hil: {_one_line(error)}", file=sys.stderr)
        return BAD_INPUT
    except BridgeError as error:
        print(f"hil: {_one_line(error)}", file=sys.stderr)
        return NOT_GOOD
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"hil: {place}{error.strerror or error}", file=sys.stderr)
        return NOT_GOOD


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(main())
