"""Waves whose period changes along a column, which no block of the remainder holds: they are left all the same, with columns and size.

Of the one of another axis alone an effect first undid a part, and 1.9 µm were said of 0.6: what is left is sized again without it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis import diagnose

pytestmark = pytest.mark.outside

Array = np.ndarray
NOISE_UM = 0.3


def sensors(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    rows = len(c["run"])
    return {
        "load_kg": rng.choice([0.0, 200.0, 400.0], rows),
        "pos_y_mm": rng.uniform(0.0, 300.0, rows),
        "temp_screw_c": 20.0 + 3.0 * (1.0 - np.exp(-c["time_s"] / 400.0)),
    }


def chirp(u: Array, first: float, last: float) -> Array:
    """From `first` cycles per unit of u, which goes from 0 to 1, to `last`."""
    return np.asarray(np.sin(2.0 * np.pi * (first * u + 0.5 * (last - first) * u**2)))


CHIRPS: dict[str, tuple[Callable[[dict[str, Array]], Array], set[str]]] = {
    "of another axis": (lambda c: chirp(c["pos_y_mm"] / 300.0, 1.0, 6.0), {"pos_y_mm"}),
    "of another axis, with the direction": (
        lambda c: chirp(c["pos_y_mm"] / 300.0, 1.0, 6.0) * c["direction"],
        {"pos_y_mm", "direction"},
    ),
    "along the travel, with the load": (
        lambda c: chirp(c["target_mm"] / 300.0, 2.0, 9.0) * (c["load_kg"] - 200.0) / 160.0,
        {"target_mm", "load_kg"},
    ),
}


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", CHIRPS)
def test_a_chirp_of_twice_the_noise_is_left_with_its_columns_and_size(name: str, seed: int) -> None:
    course, columns = CHIRPS[name]
    records = campaign(
        lambda c: wavy(c) + 0.85 * course(c), sensors=sensors, runs=7, targets=18, seed=seed, noise_um=NOISE_UM
    )
    found = diagnose(records)
    assert found.unexplained
    acts = {"load_deflection"} if "load_kg" in columns else set()
    assert {one.effect for one in found.findings if one.confidence > 0.5} <= acts
    sizes = [one.rms.value for one in found.carriers if set(one.columns) == columns]
    assert sizes
    assert sizes[0] == pytest.approx(float(np.std(0.85 * course(records.columns))), rel=0.25)
