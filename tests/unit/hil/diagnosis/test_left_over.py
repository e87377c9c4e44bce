"""What is kept of what a model leaves: rows that can be drawn, columns that are there and vary."""

from __future__ import annotations

import numpy as np
import pytest
from support.campaigns import campaign

from hil.diagnosis.campaign import columns_of
from hil.diagnosis.pictures import MOST_ROWS, left_over
from hil.diagnosis.result import Carrier, Diagnosis, NoiseParts
from hil.effects import Estimate
from hil.effects.model import Model, PitchTable
from hil.records.rows import Records


def a_diagnosis(rows: int, *carriers: tuple[str, ...]) -> Diagnosis:
    model = Model(PitchTable.of([0.0, 1.0], [0.0, 0.0], [0.0, 0.0]))
    left = np.arange(rows) / 7.0
    carried = tuple(Carrier(names, Estimate(1.0, 0.1), 0.001) for names in carriers)
    return Diagnosis(
        None, NoiseParts(0.1, 0.0, 0.0, 0.0), model, model, (), True, carried, (), left, left, left, left, "so", True
    )


def records(runs: int) -> Records:
    made = campaign(runs=runs, targets=10)
    still, empty = np.full(len(made), 3.0), np.where(np.arange(len(made)) % 2 == 0, 1.0, np.nan)
    for name, values in (("load_kg", still), ("temp_bed_c", empty), ("pos_y_mm", np.arange(len(made)) % 5.0)):
        made = made.with_column(name, values)
    return made


def test_columns_that_are_there_and_vary_are_kept_the_carriers_among_them() -> None:
    made = records(3)
    form = left_over(a_diagnosis(len(made), ("pos_y_mm", "load_kg"), ("temp_bed_c",)), columns_of(made))
    assert form["every"] == 1
    assert form["left_um"] == pytest.approx(np.arange(len(made)) / 7.0, abs=1e-4)
    expected = ["run", "target_mm", "direction", "time_s", "since_reversal_mm", "pos_y_mm"]
    assert list(form["columns"]) == expected
    assert form["columns"]["target_mm"] == pytest.approx(made.target_mm.tolist(), abs=1e-4)


def test_of_many_rows_every_so_manieth_is_kept() -> None:
    made = records(250)
    form = left_over(a_diagnosis(len(made)), columns_of(made))
    assert form["every"] == 3
    assert len(form["left_um"]) == len(made) // 3 + 1 <= MOST_ROWS
    assert {len(values) for values in form["columns"].values()} == {len(form["left_um"])}
    assert form["left_um"][1] == pytest.approx(3 / 7.0, abs=1e-4)
