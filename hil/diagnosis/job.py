"""Diagnosis of stored records, with all its plots as plain values, stored beside the rows as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.files import replace_file
from hil.axis.axis_file import AxisConfig
from hil.desk.worker_process import Passes
from hil.diagnosis import Diagnosis
from hil.diagnosis.follow_up import FollowUp, diagnosed
from hil.diagnosis.joining import joined
from hil.diagnosis.pictures import with_plots
from hil.diagnosis.stored import sources, stored_beside
from hil.effects.user_effects import attributing_errors, catalogue_with
from hil.records.rows import Floats, Records
from hil.ui.report.data import NamedCampaign
from hil.ui.report.views import ResidualView, finding_view, position_view
from hil.ui.terminal.records_input import read_parts

MOST_POINTS = 1200
"""Most points of one plotted curve."""
MOST_TURNS = 6.0
"""Largest total variation of a curve along x, in units of its range, at which it is drawn as a line."""
SIGNS = {1: "+", -1: "−"}


def diagnose_campaign(axis: AxisConfig, campaigns: Sequence[Passes]) -> list[str]:
    """Diagnose all passes of the first of these campaigns together, as `hil diagnose` does, and store the result beside them; returns
    its file. Raises InputError."""
    paths = campaigns[0].paths
    effects = catalogue_with()
    with attributing_errors(effects):
        records = read_passes(paths)
        follow = diagnosed(records, None, effects, pitches_mm=(axis.scaling.feed_mm_per_shaft_rev,))
    form = {**shown_diagnosis(follow, records), "sources": sources(paths)}
    out = stored_beside(paths)
    replace_file(out, (json.dumps(form) + "\n").encode())
    return [str(out)]


def read_passes(paths: Sequence[str | Path], runs: tuple[int, ...] | None = None) -> Records:
    """The rows of all files for a diagnosis: a column that a person sets and a file lacks had its first known level there.

    Raises InputError as `read_parts`.
    """
    parts = read_parts(paths, runs)
    return parts[0] if len(parts) == 1 else joined(parts)


def shown_diagnosis(follow: FollowUp, records: Records) -> dict[str, Any]:
    """The JSON object of the diagnosis, each finding with its plot, and `drawn`: the curves of a screen.

    records: those that were diagnosed. `drawn` is {"position": curves, "findings": [curves or None, one for each
    finding], "forms": [form and inputs of each finding's effect]}.
    """
    diagnosis = follow.diagnosis
    form = with_plots(follow.to_json(), diagnosis, records)
    explained_um = diagnosis.before_um - diagnosis.after_um
    columns = records.with_column("residual_um", diagnosis.before_um).with_column("explained_um", explained_um)
    whole = NamedCampaign("diagnosed", columns)
    findings = form["findings"]
    alone = len(findings) == 1
    views = [finding_view(one, whole, alone=alone) for one in findings]
    drawn = {
        "position": _curves(position_view(whole.records, findings)) | _along_position(diagnosis, records),
        "findings": [None if view is None else _curves(view) for view in views],
        "forms": [{"name": one.term.form.name, "inputs": list(one.term.needs)} for one in diagnosis.findings],
    }
    return {**form, "drawn": drawn}


def _along_position(diagnosis: Diagnosis, records: Records) -> dict[str, Any]:
    """Curves of the effects over position, evaluated between the rows too; {} where an effect reads more than position
    and direction.
    """
    terms = [term for finding in diagnosis.findings for term in finding.terms]
    if not terms or any(set(term.needs) - {"target_mm", "direction"} for term in terms):
        return {}
    x = np.linspace(np.min(records.target_mm), np.max(records.target_mm), MOST_POINTS)
    laid_over = {}
    for sign, name in SIGNS.items():
        if np.any(records.direction == sign):
            at = {"target_mm": x, "direction": np.full(len(x), float(sign))}
            laid_over[name] = _points(
                x,
                sum((term.error_um(at) - np.mean(term.error_um(records.columns)) for term in terms), np.zeros(len(x))),
            )
    return {"laid_over": laid_over, "smooth": True}


def _curves(view: ResidualView) -> dict[str, Any]:
    """label, over: names of the x axis and of the effect; residual, laid_over: by direction, points (x, µm) along x

    smooth: the effect is a curve along x; else it depends on more than x, and its points are not to be joined
    """
    residual, laid_over, smooth = {}, {}, True
    for sign, name in SIGNS.items():
        here = view.direction == sign
        if np.any(here):
            order = np.argsort(view.x[here], kind="stable")
            residual[name] = _points(view.x[here][order], view.residual_um[here][order])
            over_um = view.over_um[here][order]
            laid_over[name] = _points(view.x[here][order], over_um)
            smooth = smooth and bool(np.sum(np.abs(np.diff(over_um))) <= MOST_TURNS * np.ptp(over_um))
    return {"label": view.label, "over": view.over, "residual": residual, "laid_over": laid_over, "smooth": smooth}


def _points(x: Floats, y_um: Floats) -> list[list[float]]:
    """Evenly thinned."""
    step = -(-len(x) // MOST_POINTS)
    return [[float(f"{a:.7g}"), float(f"{b:.5g}")] for a, b in zip(x[::step], y_um[::step], strict=True)]
