"""The question of a plan, before its job moves or writes."""

from __future__ import annotations

import math
from pathlib import Path

from hil.desk.plan import Plan
from hil.ui.screen.texts import Texts

S_PER_MIN = 60.0
AS_BEGUN = ("rows", "signs")
"""What a campaign that is gone on with writes as it was begun: it is not asked again."""


def plan_question(plan: Plan, t: Texts) -> list[str]:
    """A plan as lines of text; of a campaign that is gone on with, what is left of it."""
    lines = []
    if plan.measured:
        minutes = math.ceil(plan.seconds_left / S_PER_MIN)
        lines.append(t("plan.goes_on", measured=plan.measured, count=plan.positions, left=plan.left, minutes=minutes))
    if plan.moves:
        lines.append(t("plan.enables_homes" if plan.homes else "plan.enables", axis=plan.axis))
    if plan.new_zero:
        lines.append(t("plan.new_zero"))
    if plan.instrument_zeroed:
        lines.append(t("plan.instrument_zeroed"))
    if plan.datum_mm is not None and not plan.measured:
        lines.append(t("plan.datum", position=t.number(plan.datum_mm)))
    for move in plan.moves:
        sign = move.how == "drives"
        ends = {"low": t.number(move.low_mm, sign=sign), "high": t.number(move.high_mm, sign=sign)}
        what = t(f"plan.move.{move.what.split()[0]}", way=t.said(move.what.partition(" ")[2]))
        lines.append(t(f"plan.{move.how}", what=what, speed=t.number(move.velocity_mm_s, 1), **ends))
    if plan.overtravel_mm is not None:
        lines.append(t("plan.contacts", count=plan.positions, overtravel=t.number(plan.overtravel_mm, 1)))
    elif plan.positions and not plan.measured:
        lines.append(t("plan.captures", count=plan.positions, seconds=t.number(plan.at_rest_s, 1)))
    writes = [write for write in plan.writes if not (plan.measured and write.what in AS_BEGUN)]
    return lines + [t(f"plan.write.{write.what}", place=_short_name(write.place)) for write in writes]


def _short_name(place: str) -> str:
    """A place as a person names it: of a path its last part."""
    return Path(place).name if Path(place).is_absolute() else place
