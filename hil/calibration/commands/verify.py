"""`hil verify`: measure with the correction in force, at targets other than those it was computed from."""

from __future__ import annotations

import argparse
from typing import Any

from drivers.errors import InputError
from drivers.files import replace_file
from hil.app.jobs.figures import error_figures
from hil.app.terminal.axis_options import (
    add_axis_arguments,
    add_password_options,
    add_zero_options,
    load_stored,
    open_store,
    print_plan,
    seed,
    tell_zero,
)
from hil.app.terminal.measuring_options import (
    add_limit_option,
    add_recording_options,
    limited,
    machine_of,
    recording_name,
)
from hil.app.terminal.output import print_facts, write_json
from hil.app.terminal.progress import terminal_progress
from hil.app.terminal.records_input import add_effects_option, read_effects
from hil.app.terminal.summary import print_accuracy, print_stages
from hil.axis.axis_file import accuracy_of, load_axis, uncertainty_of
from hil.calibration.job import band_sentence, run_verification, verification_plan
from hil.calibration.straightness import straightness_in
from hil.figures.commands.iso230 import print_figures
from hil.figures.iso230 import iso230
from hil.figures.uncertainty import budget_um

EXAMPLE = """\
example:
  hil verify X.toml
  hil verify X.toml --report verified.html --seed 3
  hil verify X.toml --record machine.csv          drive and instrument, recorded together
  hil verify X.toml --replay machine.csv          the same again from the recording: nothing is connected

  hil verify X.toml --limit 8                     A against 8 µm, in place of the axis file's accuracy_limit_um

The verdict: the accuracy A of ISO 230-2 at these targets with its uncertainty U (k = 2) against the limit, by ISO 14253-1.
The bench (backend "bench") starts anew with each command: cold, and with its own parameters.
Exit status 1: A fails the limit or is undecided; or sections lie outside the band of the axis file, and are named.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `hil verify`."""
    parser = subparsers.add_parser(
        "verify",
        description="Prove a calibration: measure with the stored correction in force, at targets between its own.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--seed", type=seed, default=1, help="chooses the other targets (default 1)")
    parser.add_argument("--resume", action="store_true", help="continue an interrupted verification")
    add_limit_option(parser)
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_zero_options(parser)
    add_recording_options(parser)
    add_password_options(parser, key=False)
    add_effects_option(parser)
    parser.set_defaults(run=run, resumes="verify")


def run(args: argparse.Namespace) -> int:
    """Returns 0: verified; 1: not proven to be within the limit, or sections outside the band. Raises what connecting and
    measuring raise."""
    axis = limited(load_axis(args.axis), args.limit)
    if args.dry_run:
        print_plan(axis, verification_plan(axis, args.seed))
        if axis.straightness is not None:
            at = f"{axis.straightness.axis_file.name} at {axis.straightness.at_mm:g} mm"
            print(f"would enable and move the axis of {at} too, where what is stored corrects straightness by it")
        return 0
    compensation = load_stored(open_store(args, axis, writing=False), read_effects(args.effects))
    with machine_of(args, axis, moves_axis=compensation.moves_axis) as machine, terminal_progress() as listener:
        tell_zero(args, machine)
        how = {"seed": args.seed, "resume": args.resume, "recording": recording_name(args)}
        result = run_verification(machine, compensation, listener, **how)
    figures = error_figures(result.records)
    found = accuracy_of(axis, result.records, corrected=True)
    print_accuracy(found)
    if axis.correction.band is not None:
        print(f"  {band_sentence(axis.correction.band, result)}")
    more: dict[str, Any] = {}
    try:
        iso = iso230(result.records)
        known = dict(budget_um(uncertainty_of(axis), iso, result.records))
        print_figures(iso, known)
        more = {"figures_um": iso.figures(), "uncertainty_um": known or None}
    except InputError as error:  # an axis of two sections has one target between them
        print(f"no figures of ISO 230-2: {error.what}")
    print_stages({"verified, other targets": figures})
    straight = straightness_in(axis, result.records)
    if straight is not None:
        print_facts({"straightness": str(straight)})
    for section in result.outside:
        print(f"outside the band: {section}")
    for place in result.not_judged:
        print(f"not judged: {place}")
    if args.report:
        from hil.calibration.report import verification_report  # noqa: PLC0415  (plots are slow to import)

        replace_file(args.report, verification_report(axis, compensation.tables, result).encode())
    if args.json:
        outside = [vars(section) for section in result.outside]
        if axis.correction.band is not None:
            figures["not_judged"] = [vars(place) for place in result.not_judged]
        more |= {} if straight is None else {"straightness": straight.figures()}
        told = {"axis": axis.name, "accuracy": found.as_json(), **figures}
        write_json(args.json, {**told, "good": result.good and found.good, "outside": outside, **more})
    return 0 if result.good and found.good else 1
