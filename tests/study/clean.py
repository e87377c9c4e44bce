"""How often the diagnosis says anything of machines that have nothing but a table and noise.

`python tests/study/clean.py --machines 320 [--seed N] [--json LINES]` prints, for each kind of noise, the share with a finding
and with anything said (Wilson intervals of 95 %), and what was said. The noise is of normal or heavy-tailed rows, with memory, with
offsets of runs, growing with speed, or all of these; the campaigns are bidirectional passes or shuffled, at fixed or fresh targets.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from study.truth_machines import NOISES, Array, Columns, Machine, Plan

from hil.diagnosis import diagnose
from hil.records.rows import Records

TUNING_SEED = 8_000_001
KINDS = (*NOISES, "speed", "mixed")
PLANS = (Plan(), Plan(shuffled=True), Plan(scatter="fixed"), Plan(runs=6, targets=16, scatter="random", shuffled=True))
UM_PER_MM = 1000.0


@dataclass(frozen=True)
class Said:
    """Of one machine: findings, what carries something unexplained, and the seconds it took."""

    kind: str
    plan: int
    seed: int
    names: tuple[str, ...]
    unexplained: bool
    carriers: tuple[str, ...]
    seconds: float


def memory(rng: np.random.Generator, run: Array) -> Array:
    """Noise of unit size that remembers a few rows within each run."""
    rho = rng.uniform(0.3, 0.85)
    slow = rng.normal(size=len(run))
    for i in range(1, len(run)):
        if run[i] == run[i - 1]:
            slow[i] = rho * slow[i - 1] + math.sqrt(1.0 - rho**2) * slow[i]
    return slow


def noise(kind: str, columns: Columns, rng: np.random.Generator) -> Array:
    """Noise of about unit size, (n,): "speed" grows with it; "mixed" has heavy tails, memory, offsets and growth at once."""
    n = len(columns["run"])
    white = rng.standard_t(rng.uniform(3.5, 8.0), n) if kind == "mixed" else rng.normal(size=n)
    speed = np.abs(columns["velocity_mm_s"])
    grown = white * (1.0 + rng.uniform(0.5, 2.5) * speed / max(float(np.max(speed)), 1e-9))
    if kind == "speed":
        return grown
    offsets = rng.normal(size=64)[columns["run"].astype(int)]
    return grown + rng.uniform(0.2, 0.7) * memory(rng, columns["run"]) + rng.uniform(0.0, 0.5) * offsets


def machine(kind: str, plan: Plan, seed: int) -> Records:
    """The rows of a machine without any effect."""
    own = kind not in NOISES
    columns, parts = Machine(seed, (), (), "normal" if own else kind).campaign(0, plan)
    if own:
        other = noise(kind, columns, np.random.default_rng([seed, 77])) * float(parts["sigma"])
        columns = {**columns, "measured_mm": columns["measured_mm"] + (other - parts["noise"]) / UM_PER_MM}
    return Records.of(columns)


def said_of(count: int, seed: int) -> Iterator[Said]:
    """What is said of so many machines, kinds and campaigns in turn."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        kind, plan = KINDS[i % len(KINDS)], (i // len(KINDS)) % len(PLANS)
        number = int(rng.integers(1 << 30))
        started = time.process_time()
        found = diagnose(machine(kind, PLANS[plan], number))
        took = time.process_time() - started
        carriers = tuple(str(one) for one in found.carriers)
        yield Said(kind, plan, number, tuple(f.effect for f in found.findings), found.unexplained, carriers, took)


def wilson(hits: int, count: int) -> str:
    """A share with its 95 % interval, in %."""
    if not count:
        return "-"
    z2 = 1.96**2
    middle = (hits + z2 / 2) / (count + z2)
    half = 1.96 / (count + z2) * math.sqrt(hits * (count - hits) / count + z2 / 4)
    return f"{100 * hits / count:.1f} % ({100 * max(middle - half, 0.0):.1f} to {100 * (middle + half):.1f})"


def report(outcomes: Sequence[Said]) -> Iterator[str]:
    """Lines of the table."""
    yield "| noise | machines | a finding | anything said |"
    yield "|---|---|---|---|"
    for kind in (*KINDS, "all"):
        mine = [one for one in outcomes if kind in (one.kind, "all")]
        found = wilson(sum(bool(one.names) for one in mine), len(mine))
        anything = wilson(sum(bool(one.names) or one.unexplained for one in mine), len(mine))
        yield f"| {kind} | {len(mine)} | {found} | {anything} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=320)
    parser.add_argument("--seed", type=int, default=TUNING_SEED)
    parser.add_argument("--json", type=Path, help="append every outcome here, one a line")
    args = parser.parse_args()
    outcomes = []
    for one in said_of(args.machines, args.seed):
        outcomes.append(one)
        if one.names or one.unexplained:
            print(one.kind, PLANS[one.plan], one.seed, *one.names, *one.carriers, flush=True)
        if args.json:
            with args.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(one)) + "\n")
    print("\n".join(report(outcomes)))


if __name__ == "__main__":
    main()
