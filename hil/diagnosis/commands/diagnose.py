"""`hil diagnose`: trace the residual of a correction to the effect that the model lacks."""

from __future__ import annotations

import argparse

from drivers.errors import InputError
from drivers.files import replace_file
from hil.axis.axis_file import load_axis
from hil.diagnosis import Diagnosis
from hil.diagnosis.follow_up import diagnosed
from hil.diagnosis.job import read_passes
from hil.diagnosis.pictures import with_plots
from hil.effects.user_effects import attributing_errors, catalogue_with
from hil.ui.terminal.output import print_facts, print_table, write_json
from hil.ui.terminal.records_input import read_model


def run(args: argparse.Namespace) -> int:
    """Diagnoses, prints, writes. Returns 1 when structure remains unexplained. Raises InputError for bad records or
    model.
    """
    if args.non_parametric and not args.out:
        raise InputError("--non-parametric is about the extended model, expected --out EXTENDED with it")
    effects = catalogue_with(args.effects)
    with attributing_errors(effects):
        declared = read_model(args.model, effects) if args.model else None
        records = read_passes(args.records, args.runs)
        try:
            follow = diagnosed(
                records, declared, effects, pitches_mm=_pitches(args.axis), non_parametric=args.non_parametric
            )
        except InputError as error:
            raise error if error.path is not None else InputError(error.what, path=args.records[0]) from error
    diagnosis = follow.diagnosis
    if args.out:
        replace_file(args.out, diagnosis.extended.to_json().encode("utf-8"))
    if args.json:
        write_json(args.json, with_plots(follow.to_json(), diagnosis, records))
    print_diagnosis(diagnosis)
    if follow.run is not None:
        print(f"next measurement: {follow.run.describe()}; then diagnose both files together")
    return 1 if diagnosis.unexplained else 0


def _pitches(axis: str | None) -> tuple[float, ...]:
    """Periods of an axis's mechanics, mm."""
    return () if axis is None else (load_axis(axis).scaling.feed_mm_per_shaft_rev,)


def _size(error_um: float) -> str:
    return f"{error_um:.3f} µm" if error_um >= 1e-2 or not error_um else f"{error_um:.3g} µm"


def floor_text(diagnosis: Diagnosis) -> str:
    """The pure error with its degrees of freedom, beside the noise as the model has it."""
    parts, floor = diagnosis.noise, diagnosis.pure_error
    known = (
        "no true repeats" if floor is None else f"{floor.std_um} µm from {floor.how}, {floor.dof} degrees of freedom"
    )
    return (
        f"{known}; in the model {parts.white_um:.3g} µm from row to row, {parts.memory_um:.3g} µm with memory,"
        f" {parts.run_offset_um:.3g} µm from run to run"
    )


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """Prints the result on standard output."""
    before, after = diagnosis.before, diagnosis.after
    print_facts(
        {
            "noise floor": floor_text(diagnosis),
            "declared": ", ".join(diagnosis.declared.declared),
            "before": f"{_size(before.rms_um)} RMS, {_size(before.peak_um)} at most (held out, {diagnosis.held_out})",
            "after": f"{_size(after.rms_um)} RMS, {_size(after.peak_um)} at most",
        }
    )
    if not diagnosis.findings:
        print("nothing in the catalogue is missing from the model")
        if diagnosis.blind:
            unseen = ", ".join(one.effect for one in diagnosis.blind)
            print(f"these rows cannot show: {unseen} (why: hil campaign check)")
    else:
        print_table(
            ["effect", "confidence", ("action", "left"), ("what it does on these rows", "left")],
            [
                [
                    f.effect,
                    f"{f.confidence:.3f}",
                    f.action.value,
                    f.explanation if f.summed or f.is_unstated else f"{f.rms} µm RMS. {f.explanation}",
                ]
                for f in diagnosis.findings
            ],
        )
    for finding in diagnosis.findings:
        by_advice: dict[str, list[str]] = {}
        for rival in finding.rivals:
            by_advice.setdefault(rival.separate_by, []).append(f"{rival.effect} ({rival.confidence:.2f})")
        for advice, names in by_advice.items():
            print(f"{finding.effect} or {', '.join(names)}? {advice}")
    if diagnosis.unexplained:
        print(f"unexplained: {diagnosis.unexplained_sentence}")
    for note in diagnosis.notes:
        print(f"note: {note}")
