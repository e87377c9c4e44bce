"""Campaigns run as in a workshop, for tests of the diagnosis: ISO runs, then targets in random order, the load set per run and the
speed per row, a sensor with its own noise, noise with memory and an offset per run. Written without the fitted effects.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hil.records.rows import Records

Floats = NDArray[np.float64]
Cause = Callable[[dict[str, Floats]], Floats]
TRAVEL_MM = 400.0
REVERSAL_UM = 7.0
LOADS_KG = (80.0, 0.0, 40.0)


def workshop(
    seed: int,
    cause: Cause | None = None,
    *,
    ratio: float | None = None,
    noise_um: float = 0.5,
    warm_s: float = 1200.0,
    warm_k: float = 4.0,
    iso_runs: int = 4,
    mixed_runs: int = 4,
    tails: str = "normal",
) -> tuple[Records, Floats]:
    """Records, and the true noise of each row in µm, shape (n,).

    cause: error in µm from the true columns (`temp_screw_c` without the sensor's noise), None: a clean machine; ratio: scales it
    to this RMS over the noise's standard deviation, the part that a smooth table holds taken off first
    """
    rng = np.random.default_rng(seed)
    targets = np.linspace(15.0, TRAVEL_MM - 15.0, 21) + rng.uniform(-3.0, 3.0, 21)
    c = _motion(rng, targets, iso_runs, mixed_runs)
    n = len(c["run"])
    c["temp_screw_c"] = 20.0 + warm_k * (1.0 - np.exp(-c["time_s"] / warm_s)) + 0.3 * np.sin(c["time_s"] / 900.0)
    x, d = c["target_mm"] / TRAVEL_MM, c["direction"]
    error = 6.0 * np.sin(2.0 * x + seed) + 3.0 * x**2 + d * REVERSAL_UM / 2
    noise = _noise(rng, c["run"], tails) * noise_um
    if tails == "faster":  # noise that grows with the speed
        noise = noise * (1.0 + c["velocity_mm_s"] / 30.0)
    if cause is not None:
        hidden = cause(c)
        smooth = np.vander(x, 6)
        held = np.hstack([smooth, d[:, None] * smooth])
        dynamic = hidden - held @ np.linalg.lstsq(held, hidden, rcond=None)[0]
        error = error + hidden * (1.0 if ratio is None else ratio * noise_um / float(np.std(dynamic)))
    c["measured_mm"] = c["target_mm"] + (error + noise) / 1e3
    c["temp_screw_c"] = c["temp_screw_c"] + rng.normal(0.0, 0.04, n)
    return Records.of(c), noise


def _motion(rng: np.random.Generator, targets: Floats, iso_runs: int, mixed_runs: int) -> dict[str, Floats]:
    rows: list[tuple[float, ...]] = []
    time_s = 0.0

    def add(run: int, order: Floats, start: float, load: float, speeds: tuple[float, ...], *, again: int = 0) -> None:
        nonlocal time_s
        turned_at, before, way = start, start, 0.0
        for index, place in enumerate(order):
            heading = 1.0 if place > before else -1.0
            if heading != way:
                turned_at, way = before, heading
            velocity = float(rng.choice(speeds))
            time_s += 2.0 + abs(place - before) / 40.0
            rows.append((run, way, place, time_s, velocity, abs(place - turned_at), load))
            before = place
            if again and index % again == 0:  # back by 6 mm and approached once more
                time_s += 2.0
                turned_at = place - way * 6.0
                rows.append((run, way, place, time_s, velocity, 6.0, load))

    for run in range(1, iso_runs + 1):
        add(run, np.concatenate([targets, targets[::-1] - 1e-4]), 0.0, 0.0, (0.0,))
        time_s += 20.0
    for run in range(iso_runs + 1, iso_runs + mixed_runs + 1):
        order = rng.uniform(5.0, TRAVEL_MM - 5.0, 40)
        add(run, order, TRAVEL_MM / 2, LOADS_KG[run % len(LOADS_KG)], (0.0, 20.0, 60.0), again=5)
        time_s += 60.0
    names = ("run", "direction", "target_mm", "time_s", "velocity_mm_s", "since_reversal_mm", "load_kg")
    return dict(zip(names, np.array(rows).T, strict=True))


def _noise(rng: np.random.Generator, run: Floats, tails: str) -> Floats:
    """Unit standard deviation: white, correlated over a few rows, and an offset per run."""
    n = len(run)
    white = rng.standard_t(4, n) / np.sqrt(2.0) if tails == "heavy" else rng.normal(size=n)
    slow = np.zeros(n)
    for i in range(n):
        slow[i] = (0.8 * slow[i - 1] if i and run[i] == run[i - 1] else 0.0) + rng.normal(0.0, 0.6)
    offset = rng.normal(size=int(run.max()) + 1)[run.astype(int)]
    whole = 0.92 * white + 0.3 * slow + 0.25 * offset
    return np.asarray(whole / np.sqrt(0.92**2 + 0.3**2 + 0.25**2))
