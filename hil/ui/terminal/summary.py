"""Summaries printed by calibrate, verify, demo and close-loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.figures.verdict import FITTED_PLUS_MINUS, Accuracy
from hil.ui.terminal.output import number, print_table

if TYPE_CHECKING:  # its import takes longer than the start of a calibration
    from hil.diagnosis import Diagnosis


def print_accuracy(found: Accuracy, title: str = "verified") -> None:
    """Print the verdict on an axis, then what its ± is and by which rule it was judged. title: what was measured."""
    print(f"{title}: {found}")
    for sentence in found.explained():
        print(f"  {sentence}")


def print_findings(diagnosis: Diagnosis) -> None:
    """Print the findings of a diagnosis, one line each."""
    for finding in diagnosis.findings:
        verdict = f"confidence {finding.confidence:.2f}, {finding.action.value}"
        print(f"found: {finding.effect} ({verdict}). {finding.explanation}")
    if any("±" in finding.explanation for finding in diagnosis.findings):
        print(f"  {FITTED_PLUS_MINUS}")
    if not diagnosis.findings:
        print("found: nothing that the data support")
    if diagnosis.unexplained:
        print(f"unexplained: {diagnosis.unexplained_sentence}")


def print_stages(stages: Mapping[str, Mapping[str, Any]], title: str | None = None) -> None:
    """Print a table with one line per stage of a job. stages: stage -> figures, µm."""
    columns = {"rows": "rows", "rms_um": "RMS", "peak_um": "peak", "mean_um": "mean"}
    columns |= {f"{name}_um": name for name in "ARBM"}
    rows = [
        [name, *(str(figures["rows"]) if key == "rows" else number(figures.get(key)) for key in columns)]
        for name, figures in stages.items()
    ]
    print_table(["error in µm", *columns.values()], rows, title=title)
