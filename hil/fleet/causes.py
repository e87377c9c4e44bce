"""The diagnosis of many axes: the newest pass of each, over the executor, each result kept in the index as soon as
it is there."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from drivers.errors import BridgeError, InputError
from drivers.files import read_text, replace_file
from drivers.undo import one_line
from hil.fleet.executor import completed
from hil.records.files import parse_json
from hil.records.rows import read_csv

FOLDER = "diagnoses"
"""Folder of the index with the diagnoses."""
VERSION = 2
"""Of what is kept: another is diagnosed again."""


@dataclass(frozen=True)
class Task:
    """The pass of an axis that is diagnosed. kept: file name of its result, by the campaign's signature and the pass"""

    axis: str
    campaign: str
    name: str
    begun: datetime
    path: Path
    kept: str


@dataclass(frozen=True)
class Cause:
    """One finding of one axis, µm. before_um, after_um: RMS on rows that were not fitted; effect "" where nothing
    was found, or `why` says why not"""

    task: Task
    effect: str
    rms_um: float
    confidence: float
    action: str
    explanation: str
    before_um: float
    after_um: float
    unexplained: bool
    why: str = ""


def newest_passes(
    root: Path, campaigns: Iterable[Mapping[str, Any]], results: Iterable[Mapping[str, Any]]
) -> list[Task]:
    """Of each axis the newest pass that has figures of a positioning test. Both tables as lists of lines."""
    signatures = {one["campaign"]: one["signature"] for one in campaigns}
    newest: dict[str, Mapping[str, Any]] = {}
    for row in results:
        if row["quantity"] == "E_um" and row["campaign"] in signatures:
            known = newest.get(row["axis"])
            if known is None or (row["begun"], row["campaign"]) > (known["begun"], known["campaign"]):
                newest[row["axis"]] = row
    found = []
    for axis, row in sorted(newest.items()):
        campaign, name = row["campaign"], row["source"]
        key = json.dumps([VERSION, signatures[campaign], campaign, name])
        kept = f"{hashlib.sha256(key.encode()).hexdigest()}.json"
        found.append(Task(axis, campaign, name, row["begun"], root / campaign / f"{name}.csv", kept))
    return found


def diagnose_task(task: Task) -> dict[str, Any]:
    """The JSON form of a diagnosis, or {"why": the reason why there is none}."""
    from hil.diagnosis.follow_up import diagnosed  # noqa: PLC0415  (slow to import; only workers need it)

    try:
        return diagnosed(read_csv(task.path), None).to_json()
    except (BridgeError, OSError) as error:
        return {"why": error.what if isinstance(error, InputError) else one_line(error)}
    except Exception as error:  # noqa: BLE001  one axis that was not foreseen must not end the diagnosis of all
        return {"why": f"{type(error).__name__}: {one_line(error)}"}


def diagnose_all(
    index: Path,
    tasks: Sequence[Task],
    *,
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[Cause]:
    """The causes of all axes, the largest first. What was diagnosed before, of the same rows, is taken from the
    index."""
    folder = index / FOLDER
    folder.mkdir(exist_ok=True)
    forms: dict[str, dict[str, Any]] = {}
    for task in tasks:
        form = _kept(folder / task.kept)
        if form is not None:
            forms[task.kept] = form
    todo = [task for task in tasks if task.kept not in forms]
    for done, (task, form) in enumerate(completed(diagnose_task, todo, scheduler=scheduler, processes=processes), 1):
        if "why" not in form:
            replace_file(folder / task.kept, json.dumps(form).encode())
        forms[task.kept] = form
        progress(done, len(todo))
    causes = [cause for task in tasks for cause in _causes(task, forms[task.kept])]
    return sorted(causes, key=lambda one: (-one.rms_um, one.task.axis))


def _kept(path: Path) -> dict[str, Any] | None:
    if not path.exists():
        return None
    try:
        form = parse_json(read_text(path))
    except (InputError, ValueError):
        return None
    return form if isinstance(form, dict) and isinstance(form.get("findings"), list) else None


def _causes(task: Task, form: Mapping[str, Any]) -> list[Cause]:
    if "why" in form:
        return [Cause(task, "", 0.0, 0.0, "", "", 0.0, 0.0, False, str(form["why"]))]
    before, after = float(form["before"]["rms_um"]), float(form["after"]["rms_um"])
    unexplained = bool(form["unexplained"])
    found = [
        Cause(
            task,
            str(one["effect"]),
            float(one["rms_um"]),
            float(one["confidence"]),
            str(one["action"]),
            str(one["explanation"]),
            before,
            after,
            unexplained,
        )
        for one in form["findings"]
    ]
    return found or [Cause(task, "", 0.0, 0.0, "", "", before, after, unexplained)]


def counted(causes: Iterable[Cause]) -> dict[str, int]:
    """On how many axes each effect was found, the most frequent first."""
    pairs = {(one.task.axis, one.effect) for one in causes if one.effect}
    return dict(Counter(effect for _, effect in sorted(pairs)).most_common())
