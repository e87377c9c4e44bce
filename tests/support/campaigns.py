"""Small measurement campaigns for the tests of the diagnosis: targets up and down the travel, and errors given row by row."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.records.rows import Records

Array = np.ndarray
Errors = Callable[[dict[str, Array]], Array]

NOTHING: Errors = lambda c: np.zeros(len(c["run"]))  # noqa: E731


def wavy(c: dict[str, Array]) -> Array:
    """A smooth pitch error with a little backlash, µm."""
    return 3.0 * np.sin(c["target_mm"] / 70.0) - 0.8 * c["direction"]


def campaign(
    error_um: Errors = NOTHING,
    *,
    noise_um: float | Array = 0.3,
    runs: int = 6,
    targets: int = 12,
    travel_mm: float = 300.0,
    scatter: float = 0.5,
    seed: int = 1,
    sensors: Callable[[dict[str, Array], np.random.Generator], dict[str, Array]] | None = None,
) -> Records:
    """Records of `runs` runs up and down over `targets` targets, scattered by this share of their spacing about fixed ones.

    error_um: function of the columns made so far (run, direction, target_mm, time_s and the sensors), µm; noise_um: standard
    deviation, or noise of every row
    """
    rng = np.random.default_rng(seed)
    step = travel_mm / targets
    middle = step * (np.arange(targets) + 0.5)
    up = [middle + scatter * step * rng.uniform(-0.5, 0.5, targets) for _ in range(runs)]
    down = [middle + scatter * step * rng.uniform(-0.5, 0.5, targets) for _ in range(runs)]
    c = {
        "run": np.repeat(np.arange(1.0, runs + 1), 2 * targets),
        "direction": np.tile(np.repeat([1.0, -1.0], targets), runs),
        "target_mm": np.concatenate([part for a, b in zip(up, down, strict=True) for part in (a, b[::-1])]),
        "time_s": 5.0 * np.arange(2.0 * targets * runs),
    }
    if sensors is not None:
        c |= sensors(c, rng)
    noise = rng.normal(size=len(c["run"])) * noise_um if np.ndim(noise_um) == 0 else np.asarray(noise_um)
    return Records.of(c | {"measured_mm": c["target_mm"] + (error_um(c) + noise) / 1000.0})
