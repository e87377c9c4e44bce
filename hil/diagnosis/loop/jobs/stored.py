"""The stored results of an axis's last loop: the figures of its measured stages, and the verdict."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from hil.diagnosis.loop.jobs.plan import CLOSE_LOOP
from hil.diagnosis.loop.procedure import measured_no_worse
from hil.diagnosis.stored import STORED, read_stored
from hil.figures.error_figures import error_figures
from hil.figures.history import Pass, read_campaign
from hil.records.journal import FINISHED, measurement_of
from hil.records.rows import Records, concatenate
from hil.ui.report.views import object_of, value_of

STAGES = {
    "uncorrected": "measure",
    "table": "round",
    "table, explored": "before",
    "extended, explored": "after",
    "in motion": "motion-before",
    "in motion, extended": "motion-after",
}
"""Stage -> the measurement that it is of, in the order of time."""
STAGE_LABELS = {
    "uncorrected": "uncorrected",
    "table": "tables at the calibrated targets",
    "table, explored": "table, at other targets",
    "extended, explored": "extended, at other targets",
    "in motion": "in motion",
    "in motion, extended": "in motion, extended",
}
"""Stage -> its name in terminal, report and picture."""
LABELS_EXPLAINED = (
    "table: the tables alone; extended: with what was found; other targets: anywhere, warmed up and rested by turns"
)
TURNS = {"before": ("table, explored", "extended, explored"), "motion-before": ("in motion", "in motion, extended")}
"""Diagnosed measurement -> the stages before and after the correction that followed from it."""


@dataclass(frozen=True)
class StoredLoop:
    """place: its folder; stages: the figures of each, as `error_figures`; good: nothing remains to be done, None before
    its end
    """

    place: str
    stages: Mapping[str, Mapping[str, Any]]
    good: bool | None


def stored_loop(directory: Path) -> StoredLoop | None:
    """The last loop with rows in an axis's folder; None without one."""
    begun = [path for path in directory.glob(f"{CLOSE_LOOP}-[0-9]*") if path.name.rpartition("-")[2].isdecimal()]
    for place in sorted(begun, key=lambda path: int(path.name.rpartition("-")[2]), reverse=True):
        try:
            measured = _measured(read_campaign(place).passes)
        except InputError:
            continue
        stages = {stage: error_figures(measured[name]) for stage, name in STAGES.items() if name in measured}
        if stages:
            ended = (place / FINISHED).exists()
            return StoredLoop(place.name, stages, _is_good(place, stages) if ended else None)
    return None


def turn_is_good(before_um: float, after_um: float, noise_um: float, *, unexplained: bool) -> bool:
    """Everything is explained, and the axis measured no worse than before; RMS each, µm."""
    return not unexplained and measured_no_worse(before_um, after_um, noise_um)


def _measured(passes: tuple[Pass, ...]) -> dict[str, Records]:
    """Rows by measurement; of the rounds of a calibration only the last."""
    parts: dict[str, list[Pass]] = {}
    for one in sorted((one for one in passes if one.records is not None), key=_number):
        name = measurement_of(one.name)
        parts.setdefault("round" if name.startswith("round-") else name, []).append(one)
    rows = {name: [one.records for one in group if one.records is not None] for name, group in parts.items()}
    return {name: group[-1] if name == "round" else concatenate(group) for name, group in rows.items()}


def _number(one: Pass) -> int:
    match = re.search(r"-(\d+)$", one.name)
    return 0 if match is None else int(match[1])


def _is_good(place: Path, stages: Mapping[str, Mapping[str, Any]]) -> bool | None:
    """By the stored diagnoses; None without them."""
    turns = []
    for name, (before, after) in TURNS.items():
        if after not in stages or before not in stages:
            continue
        try:
            form = read_stored(place / f"{name}{STORED}")
        except InputError:
            return None
        waits = bool(object_of(form.get("next_measurement")).get("person"))
        noise_um, unexplained = value_of(form.get("noise"), "within_run_um") or 0.0, form.get("unexplained") is True
        rms_um = (stages[before]["rms_um"], stages[after]["rms_um"])
        turns.append(not waits and turn_is_good(*rms_um, noise_um, unexplained=unexplained))
    return all(turns) if turns else None
