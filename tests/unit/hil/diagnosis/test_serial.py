"""Noise with memory: ordinary correlation is noise, what switches for some rows at a time is not."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.campaign import prepare
from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import START_ROUGHNESS, Setting
from hil.diagnosis.search.searcher import Memory, Searcher, memory
from hil.records.rows import Records

ROWS = 320


def left_by(extra: np.ndarray) -> Memory | None:
    """What is said of white noise of 1 µm plus `extra`, shape (320,), µm, on 8 runs of 40 rows."""
    rng = np.random.default_rng(17)
    there = np.linspace(10.0, 390.0, 20)
    target = np.tile(np.concatenate([there, there[::-1]]), 8) + rng.uniform(-8.0, 8.0, ROWS)
    records = Records.of(
        {
            "run": np.repeat(np.arange(1.0, 9.0), 40),
            "direction": np.tile(np.repeat([1.0, -1.0], 20), 8),
            "target_mm": target,
            "measured_mm": target + (rng.normal(size=ROWS) + extra) / 1e3,
        }
    )
    campaign = prepare(records)
    searcher = Searcher(Setting.free(campaign), enumerate_candidates(campaign, ()))
    noise = searcher.fit_noise((), Noise(even=START_ROUGHNESS, odd=START_ROUGHNESS))
    return memory(searcher, (), noise)


def test_white_noise_has_no_memory() -> None:
    assert left_by(np.zeros(ROWS)) is None


@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_ordinary_correlated_noise_is_noise(rho: float) -> None:
    rng = np.random.default_rng(5)
    slow = np.zeros(ROWS)
    for i in range(1, ROWS):
        slow[i] = rho * slow[i - 1] + np.sqrt(1 - rho**2) * rng.normal()
    assert left_by(0.8 * slow) is None


def test_what_switches_for_some_rows_at_a_time_is_more_than_noise() -> None:
    rng = np.random.default_rng(6)
    switched = np.where(np.cumsum(rng.random(ROWS) < 0.12) % 2 == 0, 1.0, -1.0)
    found = left_by(3.0 * switched)
    assert found is not None
    assert found.log_odds > 6.0
    assert 2.0 < found.noise.ar < 5.0
