"""What the public verbs say of one machine of the study, beside what was put into it.

`hil fit` makes the table of the fitting rows (or of an older campaign), `hil diagnose` finds what it lacks, `hil
apply` corrects the fresh rows; only their files are read. The cause's true values, a table refitted beside them and a
test that knows form and noise are the reference.
"""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr
from study.grammar.environment import Floats
from study.grammar.equivalence import always_there, not_wrong, right_names, true_parameters
from study.grammar.machine import Campaign, Drawn, draw
from study.grammar.physics import slopes
from study.grammar.reference import Reference, left_beside
from study.grammar.twins import carriers
from support.catalogue import NAMES
from threadpoolctl import threadpool_limits

from hil.app.main import main as hil
from hil.records.rows import Records, read_csv, to_csv

CONFIDENT = 0.9
FALSE_RATE = 0.01
"""False rate over the whole catalogue at which the reference test detects a cause; each name has its share of it."""
EQUIVALENT = 0.95
"""Columns whose ranks are correlated beyond this on the fitting rows cannot be told apart as carriers."""

Outcome = dict[str, Any]


def outcome(lot: str, seed: int) -> Outcome:
    """Everything about one machine that a report needs; `error` where a verb refused."""
    with threadpool_limits(1):
        drawn = draw(lot, seed)
        truth = drawn.truth()
        found: Outcome = {"lot": lot, "seed": seed, "truth": truth}
        with tempfile.TemporaryDirectory() as folder:
            try:
                said = _said(Path(folder), drawn)
            except RuntimeError as error:
                return found | {"error": str(error)}
        reference = Reference(
            drawn.fit.state, drawn.fit.error_um - drawn.fit.caused_um, drawn.noise.covariance(drawn.fit.state)
        )
        free = _free_of_set_up(drawn)
        true_left = drawn.fresh.error_um - drawn.fresh.caused_um - reference.table_um(drawn.fresh.state)
        found["fresh_true_um"] = _rms(true_left, free)
        found["fresh_fitted_um"] = _rms(_fitted_left(drawn, reference), free)
        found["fresh_all_fitted_um"] = _rms(_fitted_left(drawn, reference, every_parameter=True), free)
        for name in ("fresh", "table"):
            found[f"{name}_um"] = _rms(said.pop(name), free)
        found["fresh_noise_um"] = drawn.noise.sd_um(drawn.fresh.state)
        found["reference_p"] = [_reference_p(drawn, reference, index) for index in range(len(drawn.causes))]
        found["said"] = said
        return found | _judged(drawn, truth["causes"], said)


def _free_of_set_up(drawn: Drawn) -> Floats:
    """What a fault of the set-up leaves undetermined for later campaigns, shape (n, m): an offset, beside air over a
    length a lead too.
    """
    columns = []
    if any(cause.of_set_up for cause in drawn.causes):
        columns.append(np.ones(len(drawn.fresh.state)))
    if any(cause.name == "air" for cause in drawn.causes):
        columns.append(drawn.fresh.state.u)
    return np.column_stack(columns) if columns else np.zeros((len(drawn.fresh.state), 0))


def _fitted_left(drawn: Drawn, reference: Reference, *, every_parameter: bool = False) -> Floats:
    """Fresh errors beside the true forms with their amplitudes, or with every parameter that `slopes` finds too, fitted to the same
    rows as the table, µm; the parameters linearised about their true values.
    """
    here, there = [np.zeros((len(drawn.fit.state), 0))], [np.zeros((len(drawn.fresh.state), 0))]
    for cause, held in zip(drawn.causes, drawn.held, strict=True):
        beside = [slope for _, slope in slopes(cause.form)] if every_parameter else []
        for form in [] if held else [cause.form, *beside]:
            course = form(drawn.fit.state)
            if (size := float(np.linalg.norm(course))) > 0.0:
                here.append(course[:, None] / size)
                there.append(form(drawn.fresh.state)[:, None] / size * (0.0 if cause.of_set_up else 1.0))
    left = drawn.fresh.error_um - drawn.fresh.caused_um
    return left - reference.model_um(drawn.fresh.state, np.hstack(here), np.hstack(there))


def _rms(values: Floats, free: Floats) -> float:
    left = left_beside(values, free) if free.shape[1] else values
    return float(np.sqrt(np.mean(left**2)))


def _reference_p(drawn: Drawn, reference: Reference, index: int) -> float:
    """p of the test that knows this cause's form, everything else and the noise."""
    others = drawn.fit.caused_um - drawn.fit.cause_um[index]
    return reference.test(drawn.fit.cause_um[index], drawn.fit.error_um - others, table=drawn.older is None)


def _written(path: Path, campaign: Campaign) -> str:
    path.write_text(to_csv(Records.of(campaign.records)), encoding="utf-8")
    return str(path)


def _run(*words: str) -> int:
    """Exit status of a verb. Raises RuntimeError with its message where it refused its input."""
    err = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        status = hil(list(words))
    if status not in (0, 1):
        raise RuntimeError(f"{words[0]}: {err.getvalue().strip()}")
    return int(status)


def _said(folder: Path, drawn: Drawn) -> dict[str, Any]:
    """The diagnosis in short, what its file holds and leaves of the rows it was fitted to, and what is left of the fresh rows by the
    extended model and by the table alone."""
    fit, fresh = _written(folder / "fit.csv", drawn.fit), _written(folder / "fresh.csv", drawn.fresh)
    table, extended, result = (str(folder / name) for name in ("table.json", "extended.json", "result.json"))
    _run("fit", fit if drawn.older is None else _written(folder / "older.csv", drawn.older), "--out", table)
    words = ["diagnose", fit, "--json", result, "--out", extended]
    began_s = time.perf_counter()
    _run(*words, *(() if drawn.older is None else ("--model", table)))
    took_s = time.perf_counter() - began_s
    told = json.loads(Path(result).read_text(encoding="utf-8"))
    left = {}
    for name, model, rows in (("fresh", extended, fresh), ("table", table, fresh), ("fitted", extended, fit)):
        out = folder / f"{name}_out.csv"
        _run("apply", "--model", model, rows, "--out", str(out))
        left[name] = read_csv(out)["residual_um"]
    in_file = json.loads(Path(extended).read_text(encoding="utf-8"))["terms"]
    findings = [
        {
            "effect": finding["effect"],
            "confidence": finding["confidence"],
            "action": finding["action"],
            "explanation": finding["explanation"],
            "rms_um": finding.get("rms_um"),
            "parameters": {name: [one.get("low"), one.get("high")] for name, one in finding["parameters"].items()},
            "rivals": [[rival["effect"], rival["confidence"], rival["separate_by"]] for rival in finding["rivals"]],
        }
        for finding in told["findings"]
    ]
    return {
        "findings": findings,
        "unexplained": bool(told["unexplained"]),
        "carried_by": told.get("carried_by", []),
        "noise_floor_um": told["noise_floor_um"],
        "notes": told.get("notes", []),
        "seconds": told["seconds"],
        "verb_seconds": took_s,
        "before_um": told["before"]["rms_um"],
        "after_um": told["after"]["rms_um"],
        "recommended": told["recommended"],
        "in_file": [term["effect"] for term in in_file],
        "alone_um": float(np.sqrt(np.mean(drawn.fit.error_um**2))),
        "fitted_um": float(np.sqrt(np.mean(left.pop("fitted") ** 2))),
        **left,
    }


def _judged(drawn: Drawn, causes: Any, said: Mapping[str, Any]) -> Outcome:
    """Verdicts that hold for every lot; `report` chooses which it counts."""
    rights = [
        right_names(cause, drawn.removed, true["course_of_time"])
        for cause, true in zip(drawn.causes, causes, strict=True)
    ]
    tolerated = frozenset().union(
        *rights, *(not_wrong(cause) for cause in drawn.causes), always_there(drawn.older is not None)
    )
    names = [finding["effect"] for finding in said["findings"]]
    sets = [[finding["effect"], *(rival for rival, *_ in finding["rivals"])] for finding in said["findings"]]
    carried = _carriers(drawn, causes, said["carried_by"])
    return {
        "held": any(drawn.held),
        "twin": _not_told_apart(causes),
        "named_first": bool(rights and names[:1] and names[0] in rights[0]),
        "all_named": bool(rights) and all(set(names) & right for right in rights),
        "in_a_set": bool(rights) and any(set(one) & rights[0] for one in sets),
        "silent": not names and not said["unexplained"],
        "confidences": [[f["confidence"], f["effect"] in tolerated] for f in said["findings"]],
        "parameters": _parameters(drawn, said["findings"]),
        "confident_wrong": [
            f["effect"] for f in said["findings"] if f["confidence"] > CONFIDENT and f["effect"] not in tolerated
        ],
        **carried,
    }


def _not_told_apart(causes: Any) -> bool:
    """Whether another cause looks the same as one of these, or a reading that wanders with time holds the other one."""
    wanders = any(cause["name"] == "wander" for cause in causes)
    held_by_it = any(cause["course_of_time"] and cause["name"] != "wander" for cause in causes)
    return any(cause["twin"] for cause in causes) or (wanders and held_by_it)


def _parameters(drawn: Drawn, findings: list[dict[str, Any]]) -> dict[str, bool]:
    """Of each stated parameter that has a true value: whether its interval holds it."""
    found = {}
    for cause in drawn.causes:
        for effect, parameters in true_parameters(cause).items():
            for finding in (one for one in findings if one["effect"] == effect):
                for name, true in parameters.items():
                    low, high = finding["parameters"].get(name, (None, None))
                    if low is not None and high is not None:
                        found[f"{effect} {name}"] = low <= true <= high
    return found


def _carriers(drawn: Drawn, causes: Any, carried_by: list[dict[str, Any]]) -> Outcome:
    """Whether the columns said to carry what is left are those of the outside cause, and how its size compares."""
    outside = [index for index, cause in enumerate(drawn.causes) if cause.name == "outside"]
    if not outside or not carried_by:
        return {"carriers_first": None, "carriers_named": None, "size_ratio": None}
    cause = drawn.causes[outside[0]]
    true = causes[outside[0]]["outside_um"]
    wanted = carriers(cause, drawn.fit.state, drawn.fit.records)
    hits = []
    for entry in carried_by:
        named = set(entry["columns"]) | {name for names in entry.get("or_equivalent", {}).values() for name in names}
        hits.append(all(name in named or _moves_with(drawn.fit.records, name, entry["columns"]) for name in wanted))
    return {
        "carriers": wanted,
        "carriers_first": hits[0],
        "carriers_named": any(hits),
        "size_ratio": carried_by[0]["rms_um"] / true,
    }


def _moves_with(records: Mapping[str, Floats], name: str, columns: list[str]) -> bool:
    """Whether a column's ranks follow those of one of the columns named."""
    others = [column for column in columns if column in records and np.ptp(records[column]) > 0]
    return any(abs(float(spearmanr(records[name], records[other]).statistic)) > EQUIVALENT for other in others)


def detected(one: Outcome, false_rate: float = FALSE_RATE) -> bool:
    """Whether the reference test detects every cause at this false rate over the catalogue."""
    return bool(one["reference_p"]) and max(one["reference_p"]) < false_rate / len(NAMES)
