"""`hil iso230`: the figures of ISO 230-2 from a record file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from types import MappingProxyType

from hil.figures.iso230 import FIGURES, MEASURED_AT_A_REVERSAL, OTHER_REVERSAL_FIGURES, Iso230, iso230
from hil.figures.verdict import accuracy
from hil.records.files import naming
from hil.records.rows import read_csv
from hil.ui.terminal.output import number, print_table, write_json


def run(args: argparse.Namespace) -> int:
    """Prints the figures and writes them as JSON on request. Returns 0. Raises InputError for records that cannot give
    them.
    """
    with naming(args.records):
        records = read_csv(args.records)
        figures = iso230(records)
    print(accuracy(records, None, None, None))
    print_figures(figures)
    if args.json:
        write_json(args.json, {"records": str(args.records), **figures.as_json()})
    return 0


def print_figures(figures: Iso230, expanded_um: Mapping[str, float] = MappingProxyType({})) -> None:
    """Prints the figures of the axis and of each target, µm, on standard output. expanded_um: uncertainty (k = 2) of each, {} for
    none."""
    rows = [
        [_label(name), number(value), *([number(expanded_um.get(name))] if expanded_um else []), FIGURES[name]]
        for name, value in figures.figures().items()
    ]
    print_table(
        ["figure", "µm", *(["U, k = 2, µm"] if expanded_um else []), ("meaning", "left")],
        rows,
        title=f"ISO 230-2:2014 — {figures.m} targets, {figures.n} runs per direction",
    )
    columns = {
        "x̄↑": figures.mean_up,
        "x̄↓": figures.mean_down,
        "s↑": figures.s_up,
        "s↓": figures.s_down,
        "B": figures.B_i,
        "R↑": figures.R_up_i,
        "R↓": figures.R_down_i,
        "R": figures.R_i,
    }
    given = {name: values for name, values in columns.items() if values is not None}
    print_table(
        [("target mm", "right"), *given],
        (
            [f"{target:.4f}", *(number(float(values[i])) for values in given.values())]
            for i, target in enumerate(figures.target_mm)
        ),
        title="per target, µm",
    )
    if figures.B is not None:
        print(f"{MEASURED_AT_A_REVERSAL['B']} ({OTHER_REVERSAL_FIGURES})")
    for note in figures.notes:
        print(f"note: {note}")


def _label(name: str) -> str:
    if name == "B_mean":
        return "B̄"
    return name.replace("_up", "↑").replace("_down", "↓")
