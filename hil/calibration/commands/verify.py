"""`hil verify`: measure with the correction in force, at targets other than those it was computed from."""

from __future__ import annotations

import argparse
from typing import Any

from drivers.errors import InputError
from drivers.files import replace_file
from hil.axis.axis_file import accuracy_of, load_axis, uncertainty_of
from hil.calibration.job import band_sentence, run_verification, verification_plan
from hil.calibration.straightness import straightness_in
from hil.effects.user_effects import catalogue_with
from hil.figures.error_figures import error_figures
from hil.figures.iso230 import iso230
from hil.figures.uncertainty import budget_um
from hil.ui.terminal.axis_options import load_stored, open_store, print_plan, tell_zero
from hil.ui.terminal.measuring_options import limited, machine_of, recording_name
from hil.ui.terminal.output import print_facts, write_json
from hil.ui.terminal.progress import terminal_progress
from hil.ui.terminal.summary import print_accuracy, print_figures, print_stages


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
    compensation = load_stored(open_store(args, axis, writing=False), catalogue_with(args.effects))
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
