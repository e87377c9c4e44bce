"""Rows drawn from a large campaign: even over runs and rows, without a step that could meet a period."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import AllRows, kept_rows


@given(st.integers(1, 300), st.integers(1, 60), st.integers(0, 9), st.integers(200, 900))
@settings(max_examples=15)
def test_rows_are_few_ascending_and_spread_over_each_run_kept(runs: int, rows: int, seed: int, most: int) -> None:
    run = np.repeat(np.arange(float(runs)), rows)
    kept = kept_rows(run, seed, most)
    assert len(kept) <= max(most, 1)
    assert np.all(np.diff(kept) > 0)
    if len(run) <= most:
        np.testing.assert_array_equal(kept, np.arange(len(run)))
        return
    counts = np.unique(run[kept], return_counts=True)[1]
    assert np.min(counts) >= 0.6 * np.max(counts)
    for number in np.unique(run[kept])[:3]:
        inside = np.sort(kept[run[kept] == number]) - number * rows
        assert np.max(np.diff(np.concatenate([[-1], inside, [rows]]))) <= 2 * rows / len(inside) + 1


def test_no_even_step_through_the_rows() -> None:
    steps = np.diff(kept_rows(np.zeros(40_000), 0, 2000))
    assert np.std(steps) > 0.3 * np.mean(steps)


def test_the_past_of_a_row_is_that_of_all_rows_and_a_run_shares_its_fold() -> None:
    records = campaign(wavy, runs=30, targets=50)
    rows = AllRows.of(records, 0)
    assert len(rows.kept) < len(rows) == 3000
    whole = rows.columns["since_reversal_mm"]
    np.testing.assert_array_equal(rows.searched.columns["since_reversal_mm"], whole[rows.kept])
    run = rows.columns["run"]
    fold = (run[rows.kept] % 3).astype(np.int64)
    spread = rows.folds(fold)
    np.testing.assert_array_equal(spread[rows.kept], fold)
    assert all(len(set(spread[run == number])) == 1 for number in np.unique(run))
