"""`hil fit` and `hil apply`: the baseline model of an axis from records, and its correction of others."""

from __future__ import annotations

import argparse

import numpy as np

from drivers.errors import InputError
from drivers.files import replace_file
from hil.diagnosis.fitting import fit_model
from hil.effects.non_parametric import without_cause
from hil.effects.user_effects import attributing_errors, catalogue_with, check_on
from hil.effects.warming import goes_beyond_what_was_seen, is_bounded
from hil.figures.error_figures import rms
from hil.records.rows import to_csv
from hil.ui.terminal.output import print_facts, write_json
from hil.ui.terminal.records_input import read_model, read_records


def run_fit(args: argparse.Namespace) -> int:
    """Fits and writes the model, prints the residual. Returns 0. Raises InputError for records that cannot be fitted."""
    known = {effect.id: effect for effect in catalogue_with(args.effects)}
    for name in args.wanted:
        if name not in known:
            raise InputError(f"--with {name}: there is no such effect; there are {', '.join(known)}")
    wanted = [known[name] for name in dict.fromkeys(args.wanted)]
    records = read_records(args.records, args.runs)
    with attributing_errors(wanted):
        try:
            check_on(wanted, records.columns)
            model = fit_model(records, wanted)
        except InputError as error:
            raise error if error.path is not None else InputError(error.what, path=args.records[0]) from error
    replace_file(args.out, model.to_json().encode("utf-8"))
    uncorrected = records.uncorrected_error_um
    left = uncorrected - model.error_um(records.columns)
    figures = {
        "rows": len(records),
        "runs": len(records.runs),
        "error_rms_um": rms(uncorrected),
        "residual_rms_um": rms(left),
    }
    print_facts(
        {
            "records": f"{figures['rows']} rows, {figures['runs']} runs",
            "error RMS": f"{figures['error_rms_um']:.3f} µm",
            "left by the model": f"{figures['residual_rms_um']:.3f} µm RMS on the rows it was fitted to",
            "model": f"{args.out}: {', '.join(model.declared)}",
        }
    )
    for term in model.terms:
        print(term.effect.explain(term))
    if args.json:
        write_json(args.json, {"declared": model.declared, "model": str(args.out), **figures})
    return 0


def run_apply(args: argparse.Namespace) -> int:
    """Applies the model and writes the records. Returns 0. Raises InputError where they lack a column that the model needs."""
    effects = catalogue_with(args.effects)
    with attributing_errors(effects):
        model = read_model(args.model, effects)
        records = read_records(args.records, args.runs)
        try:
            correction = model.correction_um(records.columns)
        except InputError as error:
            raise error if error.path is not None else InputError(error.what, path=args.records[0]) from error
    before = records.uncorrected_error_um
    after = before + correction
    out = records.with_column("correction_um", correction).with_column("residual_um", after)
    replace_file(args.out, to_csv(out).encode("utf-8"))
    figures = {
        "rows": len(records),
        "before_rms_um": rms(before),
        "after_rms_um": rms(after),
        "after_peak_um": float(np.max(np.abs(after))),
    }
    print_facts(
        {
            "rows": str(len(records)),
            "uncorrected": f"{figures['before_rms_um']:.3f} µm RMS",
            "with the model": f"{figures['after_rms_um']:.3f} µm RMS, {figures['after_peak_um']:.3f} µm at most",
            "written": str(args.out),
        }
    )
    for term in filter(is_bounded, model.terms):
        if beyond := int(np.sum(goes_beyond_what_was_seen(term, records.columns))):
            print(
                f"{term.effect.id}: on {beyond} of {len(records)} rows {term.form.inputs[0]} is beyond the range that the model was"
                " fitted to; its correction goes no further than it was seen to go"
            )
    for term in without_cause(model.terms):
        print(f"{term.effect.id}: {term.effect.explain(term)}")
    if args.json:
        write_json(args.json, figures)
    return 0
