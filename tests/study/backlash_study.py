"""Backlash by torque on machines drawn at random: `python tests/study/backlash_study.py --write` measures each by steps and by
creep, and puts error, coverage and refusals of fit and rule into `hil/docs/backlash_accuracy.md`.

The truth is a simulated laser on the table (`support.torque_machines`), which shares no code with what is judged. Friction, preload
and load differ from machine to machine, and from run to run within one: what the laser sees is the mean.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from support.torque_machines import (  # noqa: E402  (the checkout's own packages)
    crept_curve,
    laser_lost_motion_um,
    noisy_crept_trace,
    noisy_trace,
    some_train,
    torque_curve,
)

from hil.backlash.result import Reversal, fitted_lost_motion, mean_um  # noqa: E402
from sim_backends.plant.drive_train import DriveTrain  # noqa: E402

PAGE = ROOT / "hil/docs/backlash_accuracy.md"
LEAST_UM, MOST_UM, RUNS, CREEP_UM_S = 5.0, 100.0, 3, 20.0
STEP_S = 0.16
"""Time of one step of 1 µm at the usual settings: 0.1 s at rest, four readings, and the move."""
FRICTION_CHANGES, PRELOAD_CHANGES = 0.02, 0.01
"""Standard deviation from run to run, relative."""
FEEDS = ("steps", "creep")


@dataclass(frozen=True)
class Drawn:
    """One machine as the laser sees it. lost_um: asked of the drawing; kinds: what is special about it"""

    train: DriveTrain
    load_kg: float
    noise_permille: float
    laser_um: float
    kinds: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What one way of feeding found on one machine; None: refused."""

    machine: Drawn
    feed: str
    fit_um: float | None
    u95_um: float
    rule_um: float | None
    seconds: float


def drawn(seed: int) -> Drawn:
    """A machine of 5 to 100 µm, evenly in the logarithm, whose stiffness is set so that it has that lost motion."""
    rng = random.Random(seed)
    wanted_um = LEAST_UM * (MOST_UM / LEAST_UM) ** rng.random()
    train, kinds = some_train(rng.getrandbits(30)), []
    guide = replace(train.guide, per_kg_n=rng.uniform(0.1, 0.5))
    load_kg = rng.choice((0.0, rng.uniform(100.0, 1500.0)))
    if rng.random() < 0.25:
        kinds.append("stick-slip")
        guide = replace(guide, static_excess=rng.uniform(0.2, 0.5), stribeck_mm_s=rng.uniform(0.5, 2.0))
    if rng.random() < 0.3:  # preload lost, a clearance, other lubrication
        kinds.append("aged")
        train = replace(train, nut_n_per_um=train.nut_n_per_um * rng.uniform(0.5, 0.9), gap_um=rng.uniform(0.0, 12.0))
        guide = replace(guide, sliding_n=guide.sliding_n * rng.uniform(0.6, 1.6))
    if rng.random() < 0.25:
        kinds.append("vertical")
        train = replace(train, weight_n=rng.uniform(500.0, 3000.0))
    if load_kg:
        kinds.append("loaded")
    train = replace(train, guide=guide)
    for _ in range(4):
        train = _softer(train, wanted_um / laser_lost_motion_um(train, load_kg))
    noise = rng.uniform(0.3, 2.0)
    return Drawn(train, load_kg, noise, laser_lost_motion_um(train, load_kg), tuple(kinds))


def _softer(train: DriveTrain, factor: float) -> DriveTrain:
    """The same forces over `factor` times the travel."""
    return replace(
        train,
        coupling_n_per_um=train.coupling_n_per_um / factor,
        nut_n_per_um=train.nut_n_per_um / factor,
        hardening_per_um=train.hardening_per_um / factor,
        gap_um=train.gap_um * factor,
    )


def measured(seed: int) -> list[Outcome]:
    """Three runs in both directions, by steps and by creep, with the friction and preload of each run."""
    machine, rng = drawn(seed), np.random.default_rng(seed)
    reach_um = 1.5 * machine.laser_um + 25.0
    found: dict[str, list[Reversal]] = {feed: [] for feed in FEEDS}
    for run in range(1, RUNS + 1):
        for direction in (-1, 1):
            train = _on_the_day(machine.train, rng)
            steps = torque_curve(train, direction, machine.load_kg, steps=int(reach_um))
            creep = crept_curve(train, direction, machine.load_kg, reach_um=reach_um, um_per_s=CREEP_UM_S)
            found["steps"].append(Reversal.of(run, noisy_trace(steps, machine.noise_permille, rng)))
            found["creep"].append(Reversal.of(run, noisy_crept_trace(creep, machine.noise_permille, rng)))
    seconds = {"steps": reach_um * STEP_S, "creep": reach_um / CREEP_UM_S}
    return [_outcome(machine, feed, found[feed], seconds[feed]) for feed in FEEDS]


def _on_the_day(train: DriveTrain, rng: np.random.Generator) -> DriveTrain:
    friction, preload = 1.0 + rng.normal(0.0, FRICTION_CHANGES), 1.0 + rng.normal(0.0, PRELOAD_CHANGES)
    guide = replace(train.guide, sliding_n=train.guide.sliding_n * friction)
    return replace(train, nut_n_per_um=train.nut_n_per_um * preload, guide=guide)


def _outcome(machine: Drawn, feed: str, reversals: Sequence[Reversal], seconds: float) -> Outcome:
    fit, rule = fitted_lost_motion(reversals), mean_um(reversals, "four-sample")
    if fit is None:
        return Outcome(machine, feed, None, 0.0, rule, seconds)
    return Outcome(machine, feed, fit.mean_um, fit.u95_um, rule, seconds)


# -- figures ---------------------------------------------------------------------------------------------------------------
HEAD = (
    "machines",
    "number",
    "refused",
    "error, %: median",
    "95 % below",
    "truth in U95, %",
    "U95, %",
    "rule: error, %",
)


def row(name: str, outcomes: Sequence[Outcome]) -> list[str]:
    """The cells of HEAD."""
    fits = [(o.fit_um - o.machine.laser_um, o.u95_um, o.machine.laser_um) for o in outcomes if o.fit_um is not None]
    covered = sum(abs(error) <= u95 for error, u95, _ in fits)
    return [
        name,
        str(len(outcomes)),
        str(len(outcomes) - len(fits)),
        *_median_and_95([100.0 * abs(error) / laser for error, _, laser in fits]),
        f"{100.0 * covered / len(fits):.0f}" if fits else "–",
        f"{np.median([100.0 * u95 / laser for _, u95, laser in fits]):.1f}" if fits else "–",
        _median_and_95([100.0 * abs(o.rule_um / o.machine.laser_um - 1.0) for o in outcomes if o.rule_um is not None])[
            0
        ],
    ]


def _median_and_95(percent: Sequence[float]) -> list[str]:
    return [f"{np.median(percent):.1f}", f"{np.quantile(percent, 0.95):.1f}"] if percent else ["–", "–"]


def tables(outcomes: Sequence[Outcome]) -> str:
    """Both feeds by size, steps by kind as well, as Markdown."""
    sizes: dict[str, Callable[[Drawn], bool]] = {"all": lambda _: True}
    for low, high in ((5, 10), (10, 20), (20, 50), (50, 100)):
        sizes[f"{low} to {high} µm"] = lambda m, low=low, high=high: low <= m.laser_um < high  # type: ignore[misc]
    kinds: dict[str, Callable[[Drawn], bool]] = {}
    for kind in sorted({kind for o in outcomes for kind in o.machine.kinds}):
        kinds[kind] = lambda m, kind=kind: kind in m.kinds  # type: ignore[misc]
    text = []
    for feed in FEEDS:
        shown = sizes | kinds if feed == "steps" else sizes
        rows = [row(name, [o for o in outcomes if o.feed == feed and of(o.machine)]) for name, of in shown.items()]
        title = "By steps of 1 µm" if feed == "steps" else f"By a creep of {CREEP_UM_S:g} µm/s"
        seconds = np.median([o.seconds for o in outcomes if o.feed == feed])
        text += [f"## {title}", "", *_markdown(HEAD, rows), "", f"A reversal takes {seconds:.0f} s (median).", ""]
    return "\n".join(text)


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


def main() -> int:
    """Runs the study. Status 1 where the intervals of a feed hold the truth on fewer than 90 % of the machines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=500)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", action="store_true", help=f"put the figures into {PAGE.relative_to(ROOT)}")
    args = parser.parse_args()
    with ProcessPoolExecutor(args.workers) as pool:
        seeds = range(args.first_seed, args.first_seed + args.machines)
        outcomes = [one for found in pool.map(measured, seeds, chunksize=5) for one in found]
    text = tables(outcomes)
    print(text)
    if args.write:
        above = PAGE.read_text(encoding="utf-8").split("## By steps")[0]
        PAGE.write_text(above + text, encoding="utf-8")
    good = True
    for feed in FEEDS:
        fits = [o for o in outcomes if o.feed == feed and o.fit_um is not None]
        good &= sum(abs(o.fit_um - o.machine.laser_um) <= o.u95_um for o in fits if o.fit_um is not None) >= 0.9 * len(
            fits
        )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
