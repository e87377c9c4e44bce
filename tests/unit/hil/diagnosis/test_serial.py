"""Memory beyond that of noise: a switching error is told from the noise that a quiet machine has."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import prepare
from hil.diagnosis.candidates import enumerate_candidates
from hil.diagnosis.fit import Setting, start_noise
from hil.diagnosis.search import Searcher
from hil.diagnosis.serial import Memory, memory

ROWS = 240


def course(seed: int, rho: float) -> np.ndarray:
    """AR(1) of unit size."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=ROWS)
    out = [steps[0]]
    for step in steps[1:]:
        out.append(rho * out[-1] + math.sqrt(1 - rho**2) * step)
    return np.array(out)


def seen(noise_um: np.ndarray) -> Memory | None:
    prepared = prepare(campaign(wavy, noise_um=noise_um, runs=5, targets=24))
    searcher = Searcher(Setting.free(prepared), enumerate_candidates(prepared, ()))
    return memory(searcher, (), searcher.fit_noise((), start_noise(prepared)))


@pytest.mark.parametrize("seed", [1, 2])
def test_an_error_that_switches_now_and_then_is_beyond_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    switched = np.where(np.cumsum(rng.random(ROWS) < 0.12) % 2 == 0, 1.0, -1.0)
    found = seen(0.3 * rng.normal(size=ROWS) + 0.9 * switched)
    assert found is not None
    assert found.noise.ar > 1.0
    assert found.log_odds > 6.0


@pytest.mark.parametrize(("size", "rho"), [(0.0, 0.0), (0.8, 0.4), (0.8, 0.7), (0.3, 0.95)])
def test_noise_that_hangs_together_a_little_is_noise(size: float, rho: float) -> None:
    rng = np.random.default_rng(5)
    assert seen(0.3 * (rng.normal(size=ROWS) + size * course(6, rho))) is None
