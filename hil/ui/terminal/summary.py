"""Tables and sentences of figures that several verbs print."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from hil.figures import FIGURES
from hil.figures.iso230 import MEASURED_AT_A_REVERSAL, OTHER_REVERSAL_FIGURES, Iso230, symbol
from hil.figures.iso230_4 import STANDARD, CircularPath
from hil.figures.verdict import Accuracy
from hil.ui.terminal.output import Align, number, print_table


def print_accuracy(found: Accuracy) -> None:
    """Print the verdict on an axis, then what its ± is and by which rule it was judged."""
    print(f"verified: {found}")
    for sentence in found.explained():
        print(f"  {sentence}")


def print_figures(figures: Iso230, expanded_um: Mapping[str, float] = MappingProxyType({})) -> None:
    """Prints the figures of the axis and of each target, µm, on standard output. expanded_um: uncertainty (k = 2) of each, {} for
    none."""
    rows = [
        [symbol(name), number(value), *([number(expanded_um.get(name))] if expanded_um else []), FIGURES[name]]
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


def print_paths(paths: Mapping[str, CircularPath]) -> None:
    rows = [
        [
            name,
            one.name,
            number(one.G_um),
            number(one.F_max_um),
            number(one.F_min_um),
            f"{one.start_deg:.1f}",
            f"{one.end_deg:.1f}",
        ]
        for name, one in paths.items()
    ]
    heads: list[str | tuple[str, Align]] = [
        "path",
        ("sense", "left"),
        "G, µm",
        "Fmax, µm",
        "Fmin, µm",
        "start, °",
        "end, °",
    ]
    print_table(heads, rows, title=f"{STANDARD}, about the least-squares circle")


def print_stages(stages: Mapping[str, Mapping[str, Any]], title: str | None = None) -> None:
    """Print a table with one line per stage of a job. stages: stage -> figures, µm."""
    columns = {"rows": "rows", "rms_um": "RMS", "peak_um": "peak", "mean_um": "mean"}
    columns |= {f"{name}_um": name for name in "ARBM"}
    rows = [
        [name, *(str(figures["rows"]) if key == "rows" else number(figures.get(key)) for key in columns)]
        for name, figures in stages.items()
    ]
    print_table(["error in µm", *columns.values()], rows, title=title)
