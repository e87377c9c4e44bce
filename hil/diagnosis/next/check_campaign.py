"""What a measured campaign cannot show: too few repeats, targets in step with a pitch, collinear columns, missing
sensors.

Only the design is used - where, when, with what - never the measured error. Columns are taken beside the declared
table, which is free in both directions, and beside an offset of each run.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hil.diagnosis.campaign import CampaignRows, prepare
from hil.diagnosis.model.diagnosing import BLIND
from hil.diagnosis.model.evidence import Fit, Noise
from hil.diagnosis.model.rows import NO_MEMORY, ROUGH, ModelRows
from hil.diagnosis.next.causes import unseen_causes
from hil.effects import ALL, Effect, Form
from hil.effects.cyclic import COMMON_MM
from hil.records.rows import Floats, Records

LEAST_REPEATS = 8
"""Degrees of freedom of the noise floor below which it is uncertain by more than a quarter."""
NEAR_MM = 0.02
"""Targets closer than this are one target repeated."""
ALIKE = 0.95
"""Canonical correlation above which two effects cannot be separated."""
IN_STEP = 0.9
"""Length of the mean phase vector of the targets above which they are all at one phase of a pitch."""
MOST_POINTS = 7
"""Points of a form's grid that are evaluated."""
MOST_ROWS = 2000
MOTION = "velocity_mm_s"
FREE, OFFSET = 1e6, 0.8
"""Variance of a free table, and standard deviation of an offset of a run, over the white noise."""


@dataclass(frozen=True)
class Gap:
    """An effect or figure that the campaign cannot show. kind: repeats | pitch | blind | alike | missing | order."""

    kind: str
    effects: tuple[str, ...]
    what: str
    figure: float


@dataclass(frozen=True)
class CampaignCheck:
    """rows, runs; repeats: degrees of freedom of the noise floor; gaps: what cannot be shown; visible: effects that
    can.
    """

    rows: int
    runs: int
    repeats: int
    gaps: tuple[Gap, ...]
    visible: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        gaps = [{"kind": g.kind, "effects": list(g.effects), "what": g.what, "figure": g.figure} for g in self.gaps]
        return {
            "rows": self.rows,
            "runs": self.runs,
            "repeats": self.repeats,
            "can_show": list(self.visible),
            "gaps": gaps,
        }


def check_campaign(
    records: Records, pitches_mm: tuple[float, ...] = (), effects: Sequence[Effect] = ALL
) -> CampaignCheck:
    """The gaps of these records. Raises InputError for too few rows."""
    if len(records) > MOST_ROWS:
        records = records.where(np.arange(len(records)) % (-(-len(records) // MOST_ROWS)) == 0)
    with threadpool_limits(1, "blas"):
        campaign = prepare(records, pitches_mm)
        repeats = repeats_of(campaign.x, campaign.d)
        table = _table(campaign)
        parts = {effect.id: _parts(campaign, table, effect) for effect in effects}
        visible = tuple(name for name, part in parts.items() if part is not None and part.share >= BLIND)
        gaps = [
            *_repeat_gap(repeats),
            *_pitch_gaps(campaign, pitches_mm or COMMON_MM, pitches_mm),
            *_order_gap(campaign),
            *_blind_gaps(parts),
            *_missing_gaps(campaign, effects, parts),
            *_alike_gaps({name: parts[name] for name in visible}),
        ]
    return CampaignCheck(len(campaign), campaign.runs, repeats, tuple(gaps), visible)


def repeats_of(target_mm: Floats, direction: Floats) -> int:
    """Degrees of freedom for pure error: rows at a target and direction, (n,) each, that were measured before."""
    keys = np.round(target_mm / NEAR_MM) * direction + 1e-3 * direction
    return len(keys) - len(np.unique(keys))


def _table(campaign: CampaignRows) -> Fit:
    """A table that is free at repeated targets and rough elsewhere, beside an offset of each run."""
    rough = FREE if campaign.repeated else ROUGH
    return Fit(ModelRows(campaign), (), Noise(NO_MEMORY, np.log([rough**0.5, rough**0.5, OFFSET])))


@dataclass(frozen=True)
class _Part:
    """An effect beside the table: the largest remaining share of its norm, and its remaining columns by form."""

    share: float
    forms: tuple[tuple[Form, Floats], ...]


def _parts(campaign: CampaignRows, table: Fit, effect: Effect) -> _Part | None:
    """None where the records allow no form of the effect."""
    best, kept = 0.0, []
    forms = [form for form in effect.forms(campaign.survey) if form.scan]
    for form in forms:
        some = np.linspace(0, len(form.starts) - 1, min(len(form.starts), MOST_POINTS)).astype(int)
        for theta in (form.starts[i] for i in some):
            rest, share = _beside(table, effect.basis(form, theta, campaign.columns))
            best = max(best, share)
            if share >= BLIND and not form.shrunk:
                kept.append((form, rest))
    return _Part(best, tuple(kept)) if forms else None


def _beside(table: Fit, columns: Floats) -> tuple[Floats, float]:
    """Columns (n, k) with the table projected out, orthonormal, and the largest remaining share of a column's norm."""
    rest = table.beside(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    left, sizes, _ = np.linalg.svd(rest, full_matrices=False)
    share = float(np.max(np.linalg.norm(rest, axis=0)))
    return np.asarray(left[:, sizes > max(1e-3 * float(sizes[0]), 1e-12)]), share


def _repeat_gap(repeats: int) -> list[Gap]:
    if repeats >= LEAST_REPEATS:
        return []
    what = f"{repeats} repeated targets give no noise floor; expected at least {LEAST_REPEATS}, some within one run"
    return [Gap("repeats", (), what, float(repeats))]


def _pitch_gaps(campaign: CampaignRows, likely: Sequence[float], given: Sequence[float]) -> list[Gap]:
    """Pitches with which all targets are in step."""
    span = 2 * campaign.survey.half_span_mm
    found = []
    for pitch in sorted({p for base in likely for p in (base, base / 2)} if given else set(likely)):
        if pitch > span / 2:
            continue
        in_step = abs(complex(np.mean(np.exp(2j * np.pi * np.unique(campaign.x) / pitch))))
        if in_step > IN_STEP:
            what = f"all targets are in step with a pitch of {pitch:g} mm: an error with that period is a constant here"
            found.append(Gap("pitch", ("cyclic",), what, in_step))
    return found


def _order_gap(campaign: CampaignRows) -> list[Gap]:
    """Runs that only go one way through the travel confound position with time."""
    worst = 1.0
    for run in range(campaign.runs):
        rows = campaign.run == run
        x = campaign.x[rows]
        if len(x) < 4 or np.ptp(x) == 0.0:
            return []
        worst = min(worst, abs(float(np.corrcoef(np.arange(len(x)), x)[0, 1])))
    if worst <= ALIKE:
        return []
    what = "every run goes through the travel one way only: position stands for time; measure in mixed order, or back again"
    return [Gap("order", ("thermal_drift", "thermal_expansion"), what, worst)]


def _blind_gaps(parts: dict[str, _Part | None]) -> list[Gap]:
    shares = {name: part.share for name, part in parts.items() if part is not None and part.share < BLIND}
    if not shares:
        return []
    most = max(shares.values())
    left = "nothing" if most < 1e-6 else f"at most {100 * most:.1g} %"  # 1e-6: rounding
    what = f"{', '.join(shares)}: at these targets a table holds them; {left} of each would be left beside it"
    return [Gap("blind", tuple(shares), what, max(shares.values()))]


def _missing_gaps(campaign: CampaignRows, effects: Sequence[Effect], parts: dict[str, _Part | None]) -> list[Gap]:
    """Effects for which a column is missing, or never changed."""
    wanted: dict[str, dict[str, None]] = {}
    for unseen in unseen_causes(campaign, effects):
        part = parts[unseen.effect.id]
        if part is None or part.share < BLIND:
            wanted.setdefault(unseen.effect.id, {})[unseen.column] = None
    moving = replace(
        campaign.survey, varying=campaign.survey.varying | {MOTION}, mean={**campaign.survey.mean, MOTION: 1.0}
    )
    for effect in effects:
        if parts[effect.id] is None:
            inputs = {name for form in effect.forms(moving) for name in form.inputs}
            wanted.setdefault(effect.id, {MOTION: None} if MOTION in inputs else {})
    gaps = []
    for name, columns in wanted.items():
        what = (
            " or ".join(_why(campaign, column) for column in columns) or "a column it reads is missing or never changed"
        )
        gaps.append(Gap("missing", (name,), f"{name}: {what}", 0.0))
    return gaps


def _why(campaign: CampaignRows, column: str) -> str:
    if column == MOTION and not np.any(np.nan_to_num(campaign.columns.get(MOTION, np.zeros(1)))):
        return "every row was taken at rest"
    return f"{column} never changed" if column in campaign.columns else f"there is no column {column}"


def _alike_gaps(parts: dict[str, _Part | None]) -> list[Gap]:
    """Pairs of effects of which some forms cannot be separated in this design, each with its closest forms."""
    gaps = []
    for (first, a), (second, b) in itertools.combinations(parts.items(), 2):
        if a is None or b is None:
            continue
        closest, names = 0.0, ("", "")
        for (form_a, qa), (form_b, qb) in itertools.product(a.forms, b.forms):
            correlation = float(np.linalg.norm(qa.T @ qb, 2))
            if correlation > closest:
                closest, names = correlation, (form_a.name, form_b.name)
        if closest > ALIKE:
            what = f"{first} ({names[0]}) looks like {second} ({names[1]}) (canonical correlation {closest:.3f})"
            gaps.append(Gap("alike", (first, second), what, min(closest, 1.0)))
    return gaps
