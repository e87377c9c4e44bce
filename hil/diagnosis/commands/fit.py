"""`hil fit`: the baseline model of an axis from records."""

from __future__ import annotations

import argparse

import numpy as np

from drivers.errors import InputError
from drivers.files import replace_file
from hil.diagnosis.fitting import fit_model
from hil.effects.user_effects import attributing_errors, check_on
from hil.ui.terminal.output import print_facts, write_json
from hil.ui.terminal.records_input import read_effects, read_records


def run(args: argparse.Namespace) -> int:
    """Fits and writes the model, prints the residual. Returns 0. Raises InputError for records that cannot be
    fitted.
    """
    known = {effect.id: effect for effect in read_effects(args.effects)}
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
        "error_rms_um": float(np.sqrt(np.mean(uncorrected**2))),
        "residual_rms_um": float(np.sqrt(np.mean(left**2))),
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
