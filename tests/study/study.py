"""The proof figures of the diagnosis on machines drawn at random: right names, false findings, honesty, held-out worth.

Run by hand for the whole study (`python tests/study/study.py --machines 520`), in a small form by the fast suite, in full by
the slow one.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from truth_machines import DYNAMIC, NOISES, OUTSIDE, Machine, Plan

from hil.diagnosis import diagnose
from hil.effects import ALL, Action
from hil.records import Records

INSTRUMENT = frozenset(effect.id for effect in ALL if effect.action is not Action.COMPENSATE)


@dataclass(frozen=True)
class Case:
    """kind: 'weak', 'strong', 'clean', 'outside', 'pair'."""

    kind: str
    seed: int
    effects: tuple[str, ...]
    strength: tuple[float, ...]
    noise: str = "normal"
    scatter: str = "jitter"


@dataclass(frozen=True)
class Outcome:
    """What the diagnosis of a case said; residual figures are over the true noise standard deviation."""

    case: Case
    names: tuple[str, ...]
    confidences: tuple[float, ...]
    unexplained: bool
    carriers: tuple[str, ...]
    floor: float
    before: float
    after: float
    fresh: float
    ideal: float
    seconds: float


def cases(per_kind: int, seed: int = 1) -> Iterator[Case]:
    """About `per_kind` cases of each kind, spread evenly over effects and noises."""
    rng = np.random.default_rng(seed)
    for kind, low, high in (("strong", 1.5, 4.0), ("weak", 0.5, 1.5)):
        for i in range(per_kind):
            effect = DYNAMIC[i % len(DYNAMIC)]
            yield Case(kind, int(rng.integers(1 << 30)), (effect,), (float(rng.uniform(low, high)),))
    for i in range(per_kind):
        yield Case("clean", int(rng.integers(1 << 30)), (), (), NOISES[i % len(NOISES)])
    for i in range(per_kind):
        effect = OUTSIDE[i % len(OUTSIDE)]
        yield Case("outside", int(rng.integers(1 << 30)), (effect,), (float(rng.uniform(1.5, 4.0)),))
    for _ in range(per_kind // 2):
        first, second = rng.choice(DYNAMIC, 2, replace=False)
        strengths = (float(rng.uniform(1.5, 4.0)), float(rng.uniform(1.5, 4.0)))
        yield Case("pair", int(rng.integers(1 << 30)), (str(first), str(second)), strengths)


def run(case: Case) -> Outcome:
    """Diagnose a case, and apply the extended model to a fresh cold campaign of the same machine."""
    machine = Machine(case.seed, case.effects, case.strength, case.noise)
    plan = Plan(scatter=case.scatter)
    columns, parts = machine.campaign(0, plan)
    sigma = float(parts["sigma"])
    started = time.perf_counter()
    diagnosis = diagnose(Records.of(columns))
    seconds = time.perf_counter() - started
    columns, parts = machine.campaign(1, plan)
    fresh = Records.of(columns)
    left = fresh.uncorrected_error_um - diagnosis.extended.error_um(fresh.columns)
    return Outcome(
        case,
        tuple(f.effect for f in diagnosis.findings),
        tuple(round(f.confidence, 4) for f in diagnosis.findings),
        diagnosis.unexplained,
        tuple("×".join(c.columns) for c in diagnosis.carriers),
        diagnosis.noise_floor.value / sigma,
        diagnosis.before.rms_um / sigma,
        diagnosis.after.rms_um / sigma,
        float(np.sqrt(np.mean(left**2))) / sigma,
        float(np.std(parts["noise"])) / sigma,
        seconds,
    )


def run_all(todo: Iterable[Case], workers: int) -> list[Outcome]:
    todo = list(todo)
    if workers <= 1:
        return [run(case) for case in todo]
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        out = []
        for i, outcome in enumerate(pool.imap_unordered(run, todo, chunksize=4)):
            out.append(outcome)
            if sys.stderr.isatty():
                print(f"\r{i + 1}/{len(todo)}", end="", file=sys.stderr)
        return out


def _share(hits: Iterable[bool]) -> float:
    values = list(hits)
    return sum(values) / len(values) if values else float("nan")


def summary(outcomes: list[Outcome]) -> dict[str, float]:
    """The figures of the proof."""
    figures: dict[str, float] = {}
    for kind in ("strong", "weak"):
        mine = [o for o in outcomes if o.case.kind == kind]
        if mine:
            figures[f"{kind}: right first"] = _share(o.names[:1] == o.case.effects for o in mine)
            figures[f"{kind}: wrong first"] = _share(bool(o.names) and o.names[0] not in o.case.effects for o in mine)
            figures[f"{kind}: nothing beside it"] = _share(
                set(o.names) <= set(o.case.effects) and not o.unexplained for o in mine
            )
            figures[f"{kind}: called unexplained"] = _share(o.unexplained for o in mine)
    sure = [o for o in outcomes if o.case.kind in ("strong", "weak") and o.names and o.confidences[0] > 0.95]
    if sure:
        figures["confidence above 0.95: right"] = _share(o.names[0] in o.case.effects for o in sure)
    for noise in NOISES:
        mine = [o for o in outcomes if o.case.kind == "clean" and o.case.noise == noise]
        if mine:
            figures[f"clean, {noise}: finding or unexplained"] = _share(bool(o.names) or o.unexplained for o in mine)
    outside = [o for o in outcomes if o.case.kind == "outside"]
    if outside:
        figures["outside: unexplained"] = _share(o.unexplained for o in outside)
        figures["outside: confident name"] = _share(any(c > 0.9 for c in o.confidences) for o in outside)
    pairs = [o for o in outcomes if o.case.kind == "pair"]
    if pairs:
        figures["pair: both"] = _share(set(o.case.effects) <= set(o.names) for o in pairs)
        figures["pair: only both"] = _share(set(o.case.effects) == set(o.names) and not o.unexplained for o in pairs)
    known = [o for o in outcomes if o.case.kind in ("strong", "weak", "pair") and not INSTRUMENT & set(o.case.effects)]
    if known:
        ratio = np.array([o.fresh / o.ideal for o in known])
        figures["fresh RMS over noise: median"] = float(np.median(ratio))
        figures["fresh RMS over noise: 90 %"] = float(np.quantile(ratio, 0.9))
    figures["seconds: median"] = float(np.median([o.seconds for o in outcomes]))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=104, help="machines of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kinds", default="strong,weak,clean,outside,pair")
    parser.add_argument("--scatter", default="jitter")
    parser.add_argument("--json", help="write every outcome here, one a line")
    args = parser.parse_args()
    wanted = args.kinds.split(",")
    todo = [case for case in cases(args.machines, args.seed) if case.kind in wanted]
    todo = [Case(**{**asdict(case), "scatter": args.scatter}) for case in todo]
    outcomes = run_all(todo, args.workers)
    if args.json:
        Path(args.json).write_text("".join(json.dumps(asdict(o)) + "\n" for o in outcomes), encoding="utf-8")
    for name, value in summary(outcomes).items():
        print(f"{name:45s} {value:8.3f}")


if __name__ == "__main__":
    main()
