"""Records as the arrays of a diagnosis: runs, and where the table's knots stand."""

from __future__ import annotations

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from drivers.errors import InputError
from hil.diagnosis.campaign import prepare
from hil.records.rows import Records


def test_runs_are_counted_in_the_order_of_their_numbers() -> None:
    prepared = prepare(campaign(runs=3, targets=6))
    np.testing.assert_array_equal(prepared.run, np.repeat([0, 1, 2], 12))


def test_the_error_is_that_of_the_uncorrected_machine() -> None:
    columns = dict(campaign(wavy, noise_um=0.0).columns)
    columns["command_mm"] = columns["target_mm"] - 0.004
    prepared = prepare(Records.of(columns))
    np.testing.assert_allclose(prepared.error_um, wavy(columns) + 4.0, atol=1e-9)


@pytest.mark.parametrize(("scatter", "repeated"), [(0.0, True), (0.5, False)])
def test_knots_are_the_targets_themselves_where_these_repeat(scatter: float, repeated: bool) -> None:
    prepared = prepare(campaign(scatter=scatter, targets=10))
    assert prepared.repeated is repeated
    if repeated:
        np.testing.assert_allclose(prepared.basis.knots_mm, 300.0 / 10 * (np.arange(10) + 0.5))
    assert np.all(np.diff(prepared.basis.knots_mm) > 0)


def test_too_few_rows_are_refused_by_number() -> None:
    columns = {name: values[:3] for name, values in campaign().columns.items()}
    with pytest.raises(InputError, match="3 rows are too few"):
        prepare(Records.of(columns))


def test_what_a_model_said_of_the_rows_is_no_column_of_theirs() -> None:
    columns = dict(campaign().columns)
    rows = len(columns["target_mm"])
    prepared = prepare(Records.of(columns | {"correction_um": np.ones(rows), "residual_um": np.arange(rows) / 1.0}))
    assert not {"correction_um", "residual_um"} & set(prepared.columns)
    assert not {"correction_um", "residual_um"} & set(prepared.survey.varying)
