"""Ageing in a simulated fleet: false alarms a year, and how long growth takes to be found, against a CUSUM that knows the axis.

    python tests/study/fleet_trend.py                  200 axes, measured weekly
    python tests/study/fleet_trend.py --repetitions 50

One axis's backlash of 10 µm grows by 1 % a week after some weeks of history. The values scatter normally from campaign
to campaign; the level of the noise is varied. The detector is the program's (`hil.fleet.detect`) with the threshold of
the whole fleet. The ideal knows level and noise of the axis beforehand, sees no clipped values, and has the same rate of
false alarms. Only numbers are simulated, no campaigns.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import numpy as np

from hil.fleet.ageing import FALSE_PER_YEAR
from hil.fleet.detect import CLIP, REFERENCE, SURER, cusum, scores, threshold_for, watch

AXES, WEEKS = 200, 52
LEVEL_UM, GROWTH = 10.0, 0.01
LONGEST = 120
"""Weeks of growth that are simulated."""


def first_over(sums: np.ndarray, threshold: float) -> int | None:
    """Index of the first CUSUM that reached the threshold."""
    over = np.flatnonzero(sums >= threshold)
    return int(over[0]) if len(over) else None


def weeks_to_alarm(
    rng: np.random.Generator, share: float, history: int, repetitions: int, reference: float = REFERENCE
) -> tuple[np.ndarray, np.ndarray, int]:
    """Weeks from the beginning of growth until it was found, by the program and by the ideal, and how often it was not found.

    share: noise as a share of the backlash; history: weeks before the growth. Histories with a false alarm are simulated anew.
    """
    run_length = AXES * WEEKS / FALSE_PER_YEAR
    ours_at, ideal_at = threshold_for(run_length, reference, CLIP), threshold_for(run_length, reference, math.inf)
    ours, ideal, missed = [], [], 0
    while len(ours) + missed < repetitions:
        week = np.arange(history + LONGEST)
        truth = LEVEL_UM * (1.0 + GROWTH) ** np.maximum(0, week - history + 1)
        value = truth + rng.normal(0.0, share * LEVEL_UM, len(week))
        found = first_over(cusum(scores(value), reference), ours_at)
        known = first_over(cusum((value - LEVEL_UM) / (share * LEVEL_UM), reference), ideal_at)
        if (found is not None and found < history) or known is None or known < history:
            continue
        if found is None:
            missed += 1
            continue
        ours.append(found - history + 1)
        ideal.append(known - history + 1)
    return np.array(ours), np.array(ideal), missed


def false_alarms(rng: np.random.Generator, years: int, tails: str) -> list[int]:
    """False alarms of the fleet without ageing in each of `years` years, after a year of history.

    tails: "normal", or "heavy" (Student's t of 4 degrees of freedom)
    """
    run_length = AXES * WEEKS / FALSE_PER_YEAR
    threshold, better_at = threshold_for(run_length), threshold_for(SURER * run_length)
    found = []
    for _ in range(years):
        count = 0
        for _axis in range(AXES):
            noise = rng.normal(size=2 * WEEKS) if tails == "normal" else rng.standard_t(4, 2 * WEEKS)
            alarms = watch(LEVEL_UM + 0.2 * noise, threshold, better_at=better_at).alarms
            count += sum(one.at >= WEEKS for one in alarms)
        found.append(count)
    return found


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=200, help="growths of each kind")
    parser.add_argument("--years", type=int, default=100, help="years of the fleet without ageing")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(words)
    rng = np.random.default_rng(args.seed)
    threshold = threshold_for(AXES * WEEKS / FALSE_PER_YEAR)
    print(f"{AXES} axes weekly, {FALSE_PER_YEAR:g} false alarms a year in all allowed: threshold {threshold:.2f}")
    for tails in ("normal", "heavy"):
        counts = false_alarms(rng, args.years, tails)
        with_one = np.mean(np.array(counts) <= 1)
        print(
            f"false alarms a year, {tails} noise: mean {np.mean(counts):.2f} ± {np.std(counts) / math.sqrt(args.years):.2f}"
            f" (standard error), at most one in {100 * with_one:.0f} % of {args.years} years, at most {max(counts)}"
        )
    print(f"weeks until {100 * GROWTH:g} % a week is found; noise from campaign to campaign as a share of the backlash")
    for history in (8, 26, 52):
        for share in (0.01, 0.02, 0.05, 0.1):
            ours, ideal, missed = weeks_to_alarm(rng, share, history, args.repetitions)
            both = [f"{np.median(each):4.1f}, 90 % {np.quantile(each, 0.9):4.1f}" for each in (ours, ideal)]
            print(
                f"  history {history:2} weeks, noise {100 * share:3g} %: median {both[0]}; ideal {both[1]};"
                f" mean ratio {ours.mean() / ideal.mean():.2f}; not found {missed} of {args.repetitions}"
            )
    print("the same with other reference values k, history 26 weeks: mean weeks")
    for share in (0.02, 0.05):
        means = {k: weeks_to_alarm(rng, share, 26, args.repetitions, k)[0].mean() for k in (0.25, 0.5, 0.75, 1.0)}
        print(f"  noise {100 * share:g} %: " + ", ".join(f"k = {k:g}: {mean:.1f}" for k, mean in means.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
