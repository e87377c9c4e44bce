"""A diagnosis with all its rivals, those that the records show and those hidden in them, and the measurement that
separates each.

`diagnosed` is the only way from records to a verdict: command, screen, loop, demo and fleet call it with all columns
of the rows.
`hil.diagnosis.next.causes` weighs the causes, `hil.diagnosis.next.next_measurement` the runs.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.diagnosis.campaign import columns_of
from hil.diagnosis.model.diagnosing import diagnose
from hil.diagnosis.model.rivals import catalogue_says, to_show
from hil.diagnosis.next.causes import LEAST, weigh
from hil.diagnosis.next.next_measurement import Outlook, Prospect, outlook
from hil.diagnosis.next.planned_run import Means, PlannedRun
from hil.diagnosis.result import Diagnosis, Finding, RivalFound
from hil.effects import ALL, Effect
from hil.effects.model import Model
from hil.effects.user_effects import check_on
from hil.records.rows import UM_PER_MM, Records

MOST_ROWS = 3000
"""Rows beyond which runs are left out of the weighing: rivals differ in form, which more rows do not change."""
MOST_FINDINGS = 3
"""Findings whose rivals are weighed."""
USUAL_LOAD_KG, USUAL_STEP_MM = 50.0, 100.0
NONE_SHOWN = 0.005
"""Confidence below which two digits show none: no rival."""
ALONE_MIN = "no measurement that this axis can make tells the two apart"


@dataclass(frozen=True)
class FollowUp:
    """diagnosis: with all rivals and what separates them; finding, prospect: the next measurement and the finding it is
    for, None for none

    undecided: effects of the findings that still have rivals
    """

    diagnosis: Diagnosis
    finding: Finding | None
    prospect: Prospect | None
    undecided: tuple[str, ...]

    @property
    def run(self) -> PlannedRun | None:
        """The next measurement, if any."""
        return None if self.prospect is None else self.prospect.run

    def to_json(self) -> dict[str, Any]:
        """The JSON object of a diagnosis, with the next measurement under `next_measurement` (null for none)."""
        return {**self.diagnosis.to_json(), "next_measurement": self._asked()}

    def _asked(self) -> dict[str, Any] | None:
        if self.prospect is None or self.finding is None:
            return None
        run = self.prospect.run
        return {
            "name": run.name,
            "what": run.describe(),
            "for": self.finding.effect,
            "rows": len(run.points),
            "minutes": round(run.minutes, 1),
            "person": run.person or None,
            "adds": list(run.adds),
            "tells_apart": [
                {"effects": list(pair), "discrimination": round(value, 1)}
                for pair, value in self.prospect.pairs.items()
            ],
        }


def diagnosed(
    records: Records,
    declared: Model | None,
    effects: Sequence[Effect] = ALL,
    *,
    means: Means | None = None,
    pitches_mm: tuple[float, ...] = (),
    non_parametric: bool = False,
    made: Sequence[str] = (),
    seed: int = 0,
) -> FollowUp:
    """Diagnoses records, weighs the rivals of what is found, and finds the next measurement.

    declared: the model in force, None: a table fitted from the records; means: of the axis, None: as far as the records show them,
    with periods of its mechanics in pitches_mm; non_parametric: also correct the unexplained part; made, seed: as in `follow_up`
    Raises InputError for records that cannot be diagnosed, and where a correction without a cause is refused.
    """
    check_on(effects, records.columns)
    diagnosis = diagnose(records, declared, effects=effects)
    if non_parametric:
        if isinstance(diagnosis.non_parametric, str):
            raise InputError(f"--non-parametric is refused: {diagnosis.non_parametric}")
        diagnosis = diagnosis.non_parametric
    known = means_of_records(records, pitches_mm) if means is None else means
    return follow_up(diagnosis, records, declared, known, effects=effects, made=made, seed=seed)


def follow_up(
    diagnosis: Diagnosis,
    records: Records,
    declared: Model | None,
    means: Means,
    *,
    effects: Sequence[Effect] = ALL,
    persons: bool = True,
    made: Sequence[str] = (),
    seed: int = 0,
) -> FollowUp:
    """Weighs the rivals of each finding, and chooses the next measurement for the first finding that has rivals.

    declared, effects: as in the diagnosis; persons: a person can be asked to help; made: names of runs made already
    """
    if not diagnosis.findings:
        return FollowUp(diagnosis, None, None, ())
    sample = thinned(records)
    findings: list[Finding] = []
    asked: tuple[Finding, Prospect] | None = None
    undecided: list[str] = []
    for index, finding in enumerate(diagnosis.findings):
        if index >= MOST_FINDINGS:
            findings.append(finding)
            continue
        beside = [term for other in diagnosis.findings if other is not finding for term in other.terms]
        try:
            rows, base = _against(finding, sample, declared)
            look = outlook(rows, base, means, effects=effects, beside=beside, persons=persons, made=made, seed=seed)
        except InputError:  # too few rows to weigh anything
            findings.append(finding)
            continue
        if not any(cause.id == finding.effect and cause.gain > 0.0 for cause in look.causes):
            findings.append(finding)  # these rows show nothing of it, as of a cycle that a table of their own holds
            continue
        findings.append(_with_rivals(finding, look, rows.columns))
        if findings[-1].rivals and not look.decided:
            undecided.append(finding.effect)
        if asked is None and look.best is not None:
            asked = findings[-1], look.best
    told = replace(diagnosis, findings=tuple(map(as_shares, findings)))
    if asked is None:
        return FollowUp(told, None, None, tuple(undecided))
    return FollowUp(told, asked[0], asked[1], tuple(undecided))


def ruled_out(asked: FollowUp, records: Records, *, effects: Sequence[Effect]) -> set[str]:
    """The causes of the finding that a run was made for which all rows together now reject.

    asked: the follow-up that led to the run; records: all rows, with those of the run. Nothing is ruled out where no
    cause remains: they were then the wrong ones to compare, and the search decides.
    """
    if asked.finding is None:
        return set()
    finding = asked.finding
    beside = [term for other in asked.diagnosis.findings if other is not finding for term in other.terms]
    weight = {cause.id: cause.weight for cause in weigh(thinned(records), None, effects, beside)}
    suspects = {finding.effect, *(rival.effect for rival in finding.rivals if rival.effect in weight)}
    left = {name for name in suspects if weight.get(name, 0.0) >= LEAST}
    return suspects - left if left else set()


def _against(finding: Finding, records: Records, declared: Model | None) -> tuple[Records, Model | None]:
    """Rows and model against which the rivals of a finding are weighed: as it was found.

    What varies beside any table is weighed beside a table fitted from the rows, without the declared terms. Raises InputError where a
    declared term lacks a column.
    """
    if declared is None or not finding.beside_any_table:
        return records, declared
    known_um = sum((term.error_um(columns_of(records)) for term in declared.terms), np.zeros(len(records)))
    return records.with_column("measured_mm", records["measured_mm"] - known_um / UM_PER_MM), None


def _with_rivals(finding: Finding, look: Outlook, recorded: Collection[str]) -> Finding:
    """The finding with the weight of its effect and of every other remaining cause, and the measurement that would separate them. What
    that leaves of 1 is of the rivals known before that weigh less now: the weighing does not see why they were.
    """
    weights = {cause.id: cause.weight for cause in look.rivals}
    unseen = {cause.id: to_show(cause.unseen.column, recorded) for cause in look.rivals if cause.unseen is not None}
    if finding.effect not in weights:
        return finding
    known = {rival.effect: rival for rival in finding.rivals}
    rivals = []
    for name, weight in weights.items():
        if name == finding.effect:
            continue
        best = look.best_for(finding.effect, name)
        said = (
            known[name].separate_by
            if name in known
            else catalogue_says(finding.term.effect, name) or unseen.get(name, "")
        )
        rivals.append(RivalFound(name, weight, best.run.describe() if best is not None else said or ALONE_MIN))
    rivals += [rival for name, rival in known.items() if name not in weights]
    confidence = min(finding.confidence, weights[finding.effect])
    lost = {
        one.effect: max(known[one.effect].confidence - one.confidence, 0.0) for one in rivals if one.effect in known
    }
    rest = max(1.0 - confidence - sum(one.confidence for one in rivals), 0.0)
    share = min(rest / whole, 1.0) if (whole := sum(lost.values())) > 0.0 else 0.0
    rivals = [replace(one, confidence=one.confidence + share * lost.get(one.effect, 0.0)) for one in rivals]
    return replace(finding, confidence=confidence, rivals=tuple(sorted(rivals, key=lambda one: -one.confidence)))


def as_shares(finding: Finding) -> Finding:
    """The finding with rivals that share what its confidence leaves of 1: some weights are of the search, others of the weighing."""
    said = sum(rival.confidence for rival in finding.rivals)
    share = min(1.0, (1.0 - finding.confidence) / said) if said > 0.0 else 1.0
    rivals = (replace(rival, confidence=share * rival.confidence) for rival in finding.rivals)
    return replace(finding, rivals=tuple(rival for rival in rivals if rival.confidence >= NONE_SHOWN))


def thinned(records: Records) -> Records:
    """Whole runs, evenly over the campaign, up to about `MOST_ROWS` rows."""
    if len(records) <= MOST_ROWS or len(records.runs) < 2:
        return records if len(records) <= MOST_ROWS else records.where(np.arange(len(records)) < MOST_ROWS)
    runs = records.runs
    wanted = max(2, MOST_ROWS * len(runs) // len(records))
    return records.of_runs({runs[int(i)] for i in np.linspace(0, len(runs) - 1, wanted)})


def means_of_records(records: Records, pitches_mm: tuple[float, ...] = ()) -> Means:
    """The measuring abilities of an axis as far as its records show them: travel, time per row, sensors, and set
    columns.
    """
    low, high = float(np.min(records.target_mm)), float(np.max(records.target_mm))
    seconds = np.diff(records["time_s"]) if "time_s" in records else np.zeros(0)
    seconds = seconds[np.isfinite(seconds) & (seconds > 0)]
    per_row = float(np.median(seconds)) if len(seconds) else 6.0
    feed = 50.0
    way = float(np.median(np.abs(np.diff(records.target_mm))) if len(records) > 1 else 0.0)
    levels: dict[str, tuple[float, ...]] = {}
    assumed: set[str] = set()
    others = [name for name in records.columns if name.startswith("pos_") and name.endswith("_mm")] or ["pos_y_mm"]
    for name in ("load_kg", *others):
        values = records[name][np.isfinite(records[name])] if name in records else np.zeros(0)
        step = USUAL_LOAD_KG if name == "load_kg" else USUAL_STEP_MM
        usual = float(values[0]) if len(values) else step
        if not len(values):
            assumed.add(name)
        levels[name] = (usual, usual + step)
    speeds = np.abs(records["velocity_mm_s"]) if "velocity_mm_s" in records else np.zeros(1)
    fast = float(np.nanmax(speeds)) if np.any(np.isfinite(speeds)) else 0.0
    return Means(
        low,
        high,
        feed_mm_s=feed,
        reading_s=max(per_row - way / feed, 1.0),
        targets=int(min(len(np.unique(np.round(records.target_mm, 2))), 21)),
        levels=levels,
        assumed=frozenset(assumed),
        sensors=frozenset(name for name, values in records.columns.items() if np.all(np.isfinite(values))),
        feeds_mm_s=(fast, fast / 4, fast / 16) if fast > 0 else (),
        pitches_mm=pitches_mm,
    )
