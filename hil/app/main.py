"""The command line `hil`: runs one verb, prints errors and sets the exit status.

Exit status: 0 done; 1 the job ran and its verdict is "not good", or the machine did not let it finish; 2 bad input or usage;
130 interrupted. An error is one line on stderr that states what, where, and what was expected; for a program error it names the file
with the traceback. After an interruption that can be resumed, one more line states the command for it.
"""

from __future__ import annotations

import argparse
import difflib
import io
import os
import re
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from drivers.errors import BridgeError, InputError, LocalError
from drivers.undo import one_line
from hil.desk.error_log import ERRORS, ErrorLog, thread_errors_caught
from hil.machine.interrupts import INTERRUPTED, ending_by_signals
from hil.ui.terminal.options import Later

if TYPE_CHECKING:
    from hil.files.resume_hints import Unfinished

VERBS = {
    "help": ("app.help:add_parser", "the pages of the documentation: hil help TOPIC"),
    "demo": ("app.command_options:add_demo", "the whole loop on the built-in bench"),
    "scan": ("files.command_options:add_scan", "who is on the bus"),
    "drives": ("files.drives_options:add_parser", "ready drive files and their sources; a first axis file"),
    "doctor": ("doctor.command_options:add_parser", "preflight: drive, limits, instrument, units, speed"),
    "calibrate": (
        "calibration.command_options:add_calibrate",
        "measure, compute tables, store them sealed, prove them",
    ),
    "verify": ("calibration.command_options:add_verify", "measure with the correction in force at other targets"),
    "backlash": (
        "backlash.command_options:add_parser",
        "lost motion from the servo's torque, without a position sensor",
    ),
    "lost-motion": (
        "lost_motion.command_options:add_lost_motion",
        "lost motion after a reversal: measure, fit, store, prove",
    ),
    "circle": (
        "lost_motion.command_options:add_circle",
        "two axes drive a circle: what lost motion does at the quadrants",
    ),
    "run": (
        "script.command_options:add_parser",
        "a procedure of yours in one Python file: plan, rows as they come, resume",
    ),
    "probe": ("probe.command_options:add_parser", "a touch probe's run-out: measure, correct, centre a bore"),
    "params": (
        "parameters.command_options:add_parser",
        "drive parameters: back up, compare, download all or nothing, prove, keep",
    ),
    "straightness": (
        "calibration.command_options:add_straightness",
        "straightness by the instrument, and the other axis moved against it",
    ),
    "close-loop": (
        "diagnosis.command_options:add_close_loop",
        "calibrate, verify warm, diagnose, extend, measure again",
    ),
    "campaign": ("diagnosis.command_options:add_campaign", "design a measuring campaign, or check what one can show"),
    "diagnose": ("diagnosis.command_options:add_diagnose", "trace what is left to an effect"),
    "fit": ("diagnosis.command_options:add_fit", "a baseline model from records"),
    "apply": ("diagnosis.command_options:add_apply", "the correction of a model for each row of records"),
    "iso230": ("files.command_options:add_iso230", "the figures of ISO 230-2"),
    "iso230-4": (
        "files.command_options:add_iso230_4",
        "the figures of ISO 230-4 of circular tests, driven here or imported",
    ),
    "records": ("files.command_options:add_records", "campaigns on disk: list, inspect, merge, export, history"),
    "fleet": ("fleet.command_options:add_parser", "many axes over years: index, what ages, comparison, causes"),
    "report": ("report.command_options:add_parser", "one HTML file from records: plots, ISO 230-2 figures, data"),
    "export": ("files.controller_options:add_export", "the tables as a controller's file"),
    "import": ("files.controller_options:add_import", "a controller's table, or measurements of another program"),
    "seal": ("files.command_options:add_seal", "lock files: encrypted, signed by the builder"),
    "open": ("files.command_options:add_open", "read a sealed file"),
    "sign": ("files.command_options:add_sign", "sign a file with the builder's key, or make the key"),
    "check": ("files.command_options:add_check", "check the builder's signature"),
    "panel": ("app.command_options:add_panel", "the operator's screen in a browser on loopback"),
    "sim": ("app.sim_options:add_parser", "simulated drive and laser as processes on a real interface"),
}
"""Verb -> the module in `hil` and the function that add its options, and its line in the help, in the order of the help. The module is
imported when its verb is called, and what the verb runs after its options are read."""

DONE, NOT_GOOD, BAD_INPUT = 0, 1, 2


class _OneLineParser(argparse.ArgumentParser):
    """A parser that reports an error as one line."""

    def _get_option_tuples(self, option_string: str) -> list[Any]:
        """What an abbreviation may mean: an option with two spellings, `--a-mm` and `--a_mm`, once."""
        return list({id(found[0]): found for found in super()._get_option_tuples(option_string)}.values())

    def error(self, message: str) -> NoReturn:
        """Print the message, with the nearest choice in place of a list of them, and exit with status 2."""
        if wrong := _WRONG_CHOICE.search(message):
            near = difflib.get_close_matches(wrong[1].lower(), re.findall(r"[\w.-]+", wrong[2]), 1)
            message = message[: wrong.start()] + f"'{wrong[1]}', the nearest is {near[0]}" if near else message
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


class _Version(argparse.Action):
    """Prints the installed version; it is looked up only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        print(f"hil {import_module('importlib.metadata').version('hil')}")
        parser.exit(DONE)


_WRONG_CHOICE = re.compile(r"'([^']*)' \(choose from (.*)\)")


def build_parser(argv: Sequence[str] = ()) -> argparse.ArgumentParser:
    """The parser: the named verb with its options, or every verb with its line in the help."""
    parser = _OneLineParser(
        prog="hil",
        description="Measure a feed axis, correct it through its servo drive, prove it, and trace what is left.",
        epilog="hil VERB --help shows an example of each.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    subparsers = parser.add_subparsers(title="verbs", metavar="VERB", required=True, parser_class=_OneLineParser)
    if argv and argv[0] in VERBS:
        module, function = VERBS[argv[0]][0].split(":")
        options = import_module(f"hil.{module}")
        getattr(options, function)(subparsers)
        if hasattr(options, "add_options_of"):  # of a file that the command line names
            options.add_options_of(argv[1:], subparsers.choices[argv[0]])
    else:
        for name, (_, text) in VERBS.items():
            subparsers.add_parser(name, help=text)
    return parser


def main(argv: Sequence[str] | None = None, loaded: Callable[[], None] = lambda: None) -> int:
    """Run one verb; returns the process's exit status. argv: without the program's name, None for the process's own; loaded: called
    when what the verb runs is imported.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal without µ shows "?"
        sys.stdout.reconfigure(errors="replace")
    argv = sys.argv[1:] if argv is None else argv
    args, before, status, begun_s = argparse.Namespace(), None, None, time.time()
    try:
        args = build_parser(argv).parse_args(argv)
        if isinstance(args.run, Later):
            args.run.load()
        loaded()
        before = _unfinished(args)
        with (
            _output_of(args),
            _plan_of(args),
            ending_by_signals(),
            thread_errors_caught(lambda error: _say(_errors_of(args).line_of(error))),
        ):
            status = int(args.run(args))
        if sys.stdout is not None:  # None: the process was started with it closed
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if status is None:
            _say(_cut_off(args, begun_s))
            status = NOT_GOOD
    except (KeyboardInterrupt, Exception) as error:  # noqa: BLE001  a program error is one line too
        said, status = _end(error, args)
        _say(said)
        for sentence in _resume_hints(args, argv, before, error):
            _say(sentence)
    return status


def _cut_off(args: argparse.Namespace, begun_s: float) -> str:
    """What is said where the reader of the output (head, a pager that was left) closes it while a verb runs; begun_s: of the epoch."""
    asked = (Path(value) for name in _WRITTEN if (value := getattr(args, name, None)) not in (None, "-"))
    lost = [str(path) for path in asked if not path.exists() or path.stat().st_mtime < begun_s]
    ended = "the output was closed by its reader, as head does, and the verb ended there"
    missing = f": {' and '.join(lost)} was not written" if lost else ""
    return f"{ended}{missing}; let the output run to its end"


_WRITTEN = ("out", "report", "json", "certificate")
"""Options that name a file a verb writes."""


def _output_of(args: argparse.Namespace) -> AbstractContextManager[None]:
    """Standard output for the JSON alone with `--json -`."""
    if getattr(args, "json", None) != "-":
        return nullcontext()
    from hil.ui.terminal.output import json_alone_on_output  # noqa: PLC0415  (rich is slow to import)

    return json_alone_on_output()


def _plan_of(args: argparse.Namespace) -> AbstractContextManager[None]:
    """The plan of a dry run with `--json` as JSON, unless the verb makes one of its own."""
    if not getattr(args, "dry_run", False) or not args.json or getattr(args, "own_plan", False):
        return nullcontext()
    from hil.ui.terminal.output import plan_as_json  # noqa: PLC0415  (as above)

    return plan_as_json(args.json)


def _end(error: BaseException, args: argparse.Namespace) -> tuple[str, int]:
    """Message and exit status for the error that ended a verb."""
    if isinstance(error, KeyboardInterrupt):
        left = one_line(error) if getattr(error, "__notes__", ()) else ""
        done = "what was measured is kept" + (f", but: {left}" if left else "")
        return f"interrupted; {done}" if left else f"interrupted; the axis was stopped, {done}", INTERRUPTED
    if isinstance(error, EOFError):
        return "the input ended at a question (Ctrl-D): it was not answered, and the job ended there", BAD_INPUT
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror or error}", NOT_GOOD
    said = _errors_of(args).line_of(error)
    if isinstance(error, InputError):
        from hil.ui.terminal.passwords import password_source  # noqa: PLC0415  (cryptography is slow to import)

        said += password_source(error, args, os.environ)
    return said, BAD_INPUT if isinstance(error, LocalError) else NOT_GOOD


def _say(text: str) -> None:
    print(f"hil: {text}", file=sys.stderr)


def _errors_of(args: argparse.Namespace) -> ErrorLog:
    """The error log beside the campaigns of the verb's axis, else in the user's state directory (XDG_STATE_HOME)."""
    from hil.axis.axis_file import load_drive_axis  # noqa: PLC0415  (numpy is slow to import)

    for name in ("axis", "x", "source", "axes", "machine"):
        value = getattr(args, name, "")
        path = str(value[0] if isinstance(value, list) and value else value)
        if path.endswith(".toml"):
            with suppress(BridgeError, OSError):
                return ErrorLog(load_drive_axis(path).store.directory / ERRORS)
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return ErrorLog(Path(state) / "hil" / ERRORS)


def _unfinished(args: argparse.Namespace) -> Unfinished | None:
    if not hasattr(args, "resumes"):
        return None
    from hil.files.resume_hints import find_unfinished  # noqa: PLC0415  (numpy is slow to import, and few verbs resume)

    return find_unfinished(args)


def _resume_hints(
    args: argparse.Namespace, argv: Sequence[str], before: Unfinished | None, error: BaseException
) -> list[str]:
    if not hasattr(args, "resumes"):
        return []
    from hil.files.resume_hints import resume_hints  # noqa: PLC0415  (as above)

    return resume_hints(args, argv, before, error)


if __name__ == "__main__":
    sys.exit(main())
