"""The choice of the next measurement, tested on random machines: a standard test without sensors, then the runs asked for.

Each machine holds one effect and was calibrated before it appeared. It is measured by a standard bidirectional test at fixed targets,
without any sensor; the causes that look alike there are named. Then the run asked for is measured on the same machine, up to
`ROUNDS` times, and the most probable cause at the end is compared with the true one. Run by hand for the whole study
(`python tests/study/next_study.py --machines 170`), with few machines by a test.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from study.planned_machine import AGAINST, ALONG, IN_TIME, USUAL_CROSS_MM, USUAL_LOAD_KG, PlannedMachine

from hil.diagnosis import fit_model
from hil.diagnosis.joining import is_set, joined
from hil.diagnosis.next.next_measurement import Outlook, outlook
from hil.diagnosis.next.planned_run import Means, PlannedRun, motion_columns
from hil.records.rows import Records

EFFECTS = (*AGAINST, *ALONG, *IN_TIME)
ROUNDS = 4
FEEDS_MM_S = (40.0, 10.0, 2.5)
Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Case:
    effect: str
    seed: int
    strength: float


@dataclass(frozen=True)
class Outcome:
    """first: the causes left after the standard test; asked: the runs; last: the causes left at the end, with weights."""

    case: Case
    first: tuple[str, ...]
    asked: tuple[str, ...]
    last: tuple[tuple[str, float], ...]
    minutes: float

    @property
    def confused(self) -> bool:
        return len(self.first) > 1

    @property
    def named(self) -> bool:
        """Whether the true cause was among those left after the standard test."""
        return self.case.effect in self.first

    @property
    def right(self) -> bool:
        return bool(self.last) and self.last[0][0] == self.case.effect


def cases(machines: int, seed: int = 1) -> Iterator[Case]:
    rng = np.random.default_rng(seed)
    for index in range(machines):
        yield Case(EFFECTS[index % len(EFFECTS)], int(rng.integers(1 << 30)), float(rng.uniform(1.5, 4.0)))


def standard_test(machine: PlannedMachine, rng: np.random.Generator, runs: int = 5, targets: int = 13) -> Columns:
    """ISO 230-2: the same targets up and down, run after run."""
    spacing = (machine.high_mm - machine.low_mm) / targets
    at = machine.low_mm + spacing * (np.arange(targets) + 0.5) + rng.uniform(-0.15, 0.15, targets) * spacing
    at = np.round(at, 3)
    rows, now = [], 0.0
    for run in range(1, runs + 1):
        for direction, way in ((1, at), (-1, at[::-1])):
            since = 5.0
            for index, target in enumerate(way):
                since += abs(target - way[index - 1]) if index else 0.0
                now += 6.0 + spacing / 50.0
                rows.append((run, direction, target, now, since, machine.high_mm - machine.low_mm))
    names = ("run", "direction", "target_mm", "time_s", "since_reversal_mm", "stroke_mm")
    return dict(zip(names, np.array(rows).T, strict=True))


def written(columns: Columns, rows: slice, more: tuple[str, ...] = ()) -> Records:
    """Records of some rows, as a user writes them down."""
    names = ("run", "direction", "target_mm", "measured_mm", "time_s", *more)
    return Records.of({name: columns[name][rows] for name in dict.fromkeys(names)})


def appended(plan: Columns, run: PlannedRun, means: Means) -> Columns:
    """The plan followed by a run that begins ten minutes later; NaN for values that are not given."""
    more = motion_columns(run.points, means, start_s=float(plan["time_s"][-1]) + 600.0)
    n, m = len(plan["run"]), len(more["run"])
    return {
        name: np.concatenate([plan.get(name, np.full(n, np.nan)), more.get(name, np.full(m, np.nan))])
        for name in dict.fromkeys([*plan, *more])
    }


def run(case: Case) -> Outcome:
    rng = np.random.default_rng([case.seed, 41])
    in_motion = case.effect == "velocity_lag" or (case.effect in AGAINST and rng.random() < 0.5)
    machine = PlannedMachine(case.seed, case.effect, case.strength, feed_mm_s=FEEDS_MM_S[0] if in_motion else 0.0)
    means = Means(
        machine.low_mm,
        machine.high_mm,
        levels={"load_kg": (USUAL_LOAD_KG, 2 * USUAL_LOAD_KG), "pos_y_mm": (USUAL_CROSS_MM, -USUAL_CROSS_MM)},
        feeds_mm_s=FEEDS_MM_S if in_motion else (),
    )
    always: tuple[str, ...] = ("velocity_mm_s",) if in_motion else ()
    plan = standard_test(machine, rng)
    rows = len(plan["run"])
    before = PlannedMachine(case.seed, feed_mm_s=machine.feed_mm_s, noise=1)
    declared = fit_model(written(before.measure(plan, rows), slice(0, rows)))
    parts = [written(machine.measure(plan, rows), slice(0, rows), always)]
    look = outlook(parts[0], declared, means)
    first = look
    asked: list[PlannedRun] = []
    while look.best is not None and len(asked) < ROUNDS:
        asked.append(look.best.run)
        start = len(plan["run"])
        plan = appended(plan, asked[-1], means)
        measured = machine.measure(plan, rows)
        always = (*always, *(name for name in asked[-1].adds if not is_set(name)))  # an added sensor remains
        more = (*always, "since_reversal_mm", "stroke_mm", *asked[-1].adds)
        parts.append(written(measured, slice(start, None), more))
        look = outlook(joined(parts), declared, means, made=[r.name for r in asked], seed=len(asked))
    return Outcome(
        case, _names(first), tuple(r.name for r in asked), _weights(look), round(sum(r.minutes for r in asked), 1)
    )


def _names(look: Outlook) -> tuple[str, ...]:
    return tuple(cause.id for cause in look.rivals)


def _weights(look: Outlook) -> tuple[tuple[str, float], ...]:
    return tuple((cause.id, round(cause.weight, 3)) for cause in look.rivals)


def of_json(path: Path) -> list[Outcome]:
    """The outcomes that `--json` wrote."""
    lines = map(json.loads, path.read_text(encoding="utf-8").splitlines())
    return [Outcome(Case(**one.pop("case")), **one) for one in lines]


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    confused = [o for o in outcomes if o.confused]
    figures = {
        "machines": float(len(outcomes)),
        "confused by the standard test": float(len(confused)),
        "truth among those named": float(np.mean([o.named for o in outcomes])),
        "right at the end": float(np.mean([o.right for o in outcomes])),
        "right at the end, of those confused": float(np.mean([o.right for o in confused])),
        "runs asked for, mean of those confused": float(np.mean([len(o.asked) for o in confused])),
        "minutes asked for, median of those confused": float(np.median([o.minutes for o in confused])),
    }
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=170)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effect", help="only this effect")
    parser.add_argument("--json", help="write every outcome here, one a line")
    args = parser.parse_args()
    todo = [case for case in cases(args.machines, args.seed) if args.effect in (None, case.effect)]
    outcomes = []
    for case in todo:
        outcomes.append(run(case))
        if not outcomes[-1].right or sys.stderr.isatty():
            print(outcomes[-1], file=sys.stderr, flush=True)
    if args.json:
        Path(args.json).write_text("".join(json.dumps(asdict(o)) + "\n" for o in outcomes), encoding="utf-8")
    for name, value in summary(outcomes).items():
        print(f"{name:45s} {value:8.3f}")


if __name__ == "__main__":
    main()
