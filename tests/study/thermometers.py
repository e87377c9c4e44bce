"""How well temperatures are known from noisy thermometers: `python tests/study/thermometers.py [--machines N] [--other]`.

Machines of the grammar (tuning seeds) know the true temperature of each place. Printed by kind of campaign: RMS error of the readings
and of `hil.effects.thermometers.without_noise`; with --other also of scipy's smoothing spline (generalised cross-validation), and the
time of both.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.interpolate import make_smoothing_spline

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from study.grammar.machine import draw

from hil.effects.thermometers import without_noise

TUNING_SEED = 103_000
"""No figure of the study that is reported comes from this seed on."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=60)
    parser.add_argument("--other", action="store_true")
    how = parser.parse_args()
    off: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    took_s = np.zeros(2)
    for seed in range(TUNING_SEED, TUNING_SEED + how.machines):
        drawn = draw("strong", seed)
        rows = drawn.fit.records
        for place, true_c in drawn.fit.state.temperature_c.items():
            name = f"temp_{place}_c"
            if name not in rows or "time_s" not in rows:
                continue
            began_s = time.perf_counter()
            found = [rows[name], without_noise(rows["time_s"], rows[name])]
            took_s[0] += time.perf_counter() - began_s
            if how.other:
                began_s = time.perf_counter()
                moments, first = np.unique(rows["time_s"], return_index=True)
                found.append(make_smoothing_spline(moments, rows[name][first])(rows["time_s"]))
                took_s[1] += time.perf_counter() - began_s
            off[drawn.truth()["campaign"]].append(tuple(float(np.std(one - true_c)) for one in found))
    print("campaign         records   error in mK, median (90 %): reading, without noise" + ", scipy" * how.other)
    every = [one for some in off.values() for one in some]
    for name, some in [*sorted(off.items()), ("all", every)]:
        middle, high = (1e3 * np.quantile(np.array(some), q, axis=0) for q in (0.5, 0.9))
        print(
            f"{name:16} {len(some):7}   " + "   ".join(f"{a:5.1f} ({b:.1f})" for a, b in zip(middle, high, strict=True))
        )
    print("ms per record: " + ", ".join(f"{1e3 * one / len(every):.0f}" for one in took_s[: 1 + how.other]))


if __name__ == "__main__":
    main()
