"""Runs left out: nothing of them reaches what predicts them, and they decide what is corrected."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.campaigns import campaign, wavy
from support.workshop import Floats, workshop

from hil.diagnosis import diagnose
from hil.diagnosis.campaign import AllRows, prepare
from hil.diagnosis.model.evidence import Fit, score
from hil.diagnosis.model.force import Folds, Force, improves
from hil.diagnosis.model.rows import ModelRows
from hil.records.rows import Records


def predicted(records: Records, out: Floats) -> Floats:
    """What the table of the other rows says of each row, its noise model as it is."""
    rows = ModelRows(prepare(records))
    noise = score(ModelRows(prepare(campaign(wavy, runs=5))), ())[0].noise
    return Force(Fit(rows, (), noise), {}).without(out).error_um(prepare(records).columns)


@pytest.mark.parametrize("spoilt_um", [1e3, -5.0])
def test_whatever_the_run_left_out_measured_its_prediction_is_the_same(spoilt_um: float) -> None:
    records = campaign(wavy, runs=5)
    out = records.run == 3
    spoilt = records.with_column("measured_mm", records.measured_mm + spoilt_um / 1e3 * out)
    np.testing.assert_allclose(predicted(spoilt, out), predicted(records, out), atol=1e-4 * abs(spoilt_um))


@pytest.mark.parametrize(("runs", "how"), [(1, "quarter"), (4, "leave-one-run-out"), (13, "groups")])
def test_folds_are_whole_runs_or_parts_of_the_only_one(runs: int, how: str) -> None:
    records = campaign(wavy, runs=runs, targets=8)
    rows = AllRows.of(records, 0)
    folds = Folds.of(rows, rows.searched.run)
    assert how in folds.how
    fold = folds.of_all
    np.testing.assert_array_equal(np.unique(fold), np.arange(np.max(fold) + 1))
    if runs > 1:
        assert all(len(set(fold[records.run == number])) == 1 for number in records.runs)
    assert np.all(np.diff(fold) >= 0)


@given(st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=8), st.floats(0.1, 100.0))
@settings(max_examples=50)
def test_a_gain_counts_when_it_is_above_its_standard_error_whatever_the_unit(gain: list[float], unit: float) -> None:
    values, fold = np.array(gain), np.arange(len(gain))
    before, after = np.sqrt(20.0 + values), np.full(len(gain), np.sqrt(20.0))
    clear = np.mean(values) - np.std(values, ddof=1) / np.sqrt(len(values))
    if abs(clear) > 1e-6:
        assert improves(unit * before, unit * after, fold) == (clear > 0)
    assert not improves(after, after, fold)


def behind_the_screw(c: dict[str, Floats]) -> Floats:
    """A drift that follows the screw through a lag of 600 s, from the first row on as warm as the screw then was."""
    out, at = np.empty(len(c["time_s"])), c["temp_screw_c"][0]
    for row, step_s in enumerate(np.diff(c["time_s"], prepend=c["time_s"][0])):
        at += (c["temp_screw_c"][row] - at) * -np.expm1(-step_s / 600.0)
        out[row] = at
    return out


@pytest.mark.outside
def test_a_sensors_lag_does_not_begin_anew_in_the_rows_left_out() -> None:
    records, noise_um = workshop(12, behind_the_screw, ratio=2.0, warm_s=3000.0)
    found = diagnose(records)
    (finding,) = found.findings
    assert finding.effect == "thermal_drift"
    later = records["run"] > records["run"].min()  # nothing but the first run shows where the drift began
    left_um = float(np.sqrt(np.mean(found.after_um[later] ** 2)))
    assert left_um < 1.4 * float(np.std(noise_um)), "begun anew in each run it is 2 to 8 times the noise"


@pytest.mark.parametrize("jump_um", [1.5, 3.0])
def test_the_table_of_a_file_that_corrects_no_cause_is_the_one_beside_it(jump_um: float) -> None:
    """The jump of the instrument is known, so that runs left out know the machine's table better than with the jump in it."""
    found = diagnose(campaign(lambda c: wavy(c) + jump_um * (c["time_s"] > 300.0), runs=4))
    assert found.findings
    assert not found.extended.terms
    assert found.after.rms_um < 1.02 * found.before.rms_um
    assert np.std(found.setup_um) < 0.4 < found.after.rms_um
