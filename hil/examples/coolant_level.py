"""A user's own effect in one file: the bed bends under the coolant in its tank; its level is the column `coolant_level_mm`.

  hil diagnose records.csv --effects coolant_level.py --out model.json
  hil apply --model model.json --effects coolant_level.py other.csv --out corrected.csv

error = coefficient · (level - mean), the same everywhere, or times u, the position from -1 to 1 over the travel.
"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects import Action, Columns, Effect, Estimate, Floats, Form, Rival, Survey, Term

LEVEL = "coolant_level_mm"
COLUMNS = {LEVEL: 120.0}
"""Columns that the record format does not name, each with a usual value; the contract suite makes such records up."""


class CoolantLevel(Effect):
    id: ClassVar[str] = "coolant_level"
    title: ClassVar[str] = "bed bent by the coolant in its tank"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("thermal_drift", "pump the tank empty and full while the temperatures stay"),
        Rival("load_deflection", "pump the tank empty and full under one load"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.has(LEVEL):
            return ()
        constants = {"mean_mm": survey.mean[LEVEL], "centre_mm": survey.centre_mm, "half_span_mm": survey.half_span_mm}
        return (
            Form(self.id, "offset", (LEVEL,), constants),
            Form(self.id, "with position", (LEVEL, "target_mm"), constants),
        )

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        level = columns[LEVEL] - form.constants["mean_mm"]
        if form.name == "offset":
            return level[:, None]
        if form.name == "with position":
            u = (columns["target_mm"] - form.constants["centre_mm"]) / form.constants["half_span_mm"]
            return np.asarray(level * u)[:, None]
        raise KeyError(form.name)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        return {"um_per_mm_of_level": term.coefficient(0)}

    def explain(self, term: Term) -> str:
        where = "everywhere" if term.form.name == "offset" else "at the end of the travel, less towards the middle"
        return f"Each mm of coolant in the tank moves the table by {term.coefficient(0)} µm {where}."


EFFECTS = (CoolantLevel(),)
