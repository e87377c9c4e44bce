"""What each number of the diagnosis's policy does: every one halved and doubled on the same random machines.

`python tests/study/policy.py [--machines N] [--only name,name] [--json LINES]` prints, for each number and factor, how many verdicts
(names in order, or whether something is unexplained) changed, how many right ones were won and lost, and the mean change of the RMS on
a fresh campaign over the noise. The campaigns are small and the causes weak, so that many verdicts are near a decision. Seeds are
those for tuning. A machine whose diagnosis never reads a number is not diagnosed again for it; the last column counts those that do.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from study.own_catalogue import Case, cases, in_turn
from study.truth_machines import Machine, Plan

from hil.diagnosis import diagnose, fit_model
from hil.diagnosis.policy import Policy, in_force
from hil.records.rows import Records

TUNING_SEED = 7_000_001
"""No figure that is reported comes from this seed."""
FACTORS = (0.5, 2.0)
WEAKER = 0.6
"""Factor on the strength of every cause of the study, so that more verdicts are near a decision."""
SMALL = Plan(runs=6, targets=16)


@dataclass(frozen=True)
class Said:
    """Of one machine: the names and whether something is unexplained, whether that is right, RMS on a fresh campaign over noise."""

    names: tuple[str, ...]
    unexplained: bool
    right: bool
    fresh: float


def machines(count: int) -> list[Case]:
    """So many machines, all kinds in turn."""
    todo = in_turn(cases(-(-count // 6), TUNING_SEED))[:count]
    return [replace(case, strength=tuple(WEAKER * s for s in case.strength)) for case in todo]


class Watched(Policy):
    """The usual policy, which notes the numbers that are read."""

    def __getattribute__(self, name: str) -> object:
        value = super().__getattribute__(name)
        if isinstance(value, float):
            super().__getattribute__("__dict__").setdefault("_read", set()).add(name)
        return value

    @property
    def read(self) -> frozenset[str]:
        """The numbers read so far."""
        return frozenset(self.__dict__.get("_read", ()))


def say(case: Case, numbers: Policy) -> Said:
    """What is said of a machine under a policy."""
    machine = Machine(case.seed, case.effects, case.strength, case.noise)
    columns, parts = machine.campaign(0, SMALL)
    declared = None
    if case.kind == "appeared":
        declared = fit_model(Records.of(replace(machine, effects=(), strength=()).campaign(2, SMALL)[0]))
    with in_force(numbers):
        found = diagnose(Records.of(columns), declared)
    fresh = Records.of(machine.campaign(1, SMALL)[0])
    left_um = fresh.uncorrected_error_um - found.extended.error_um(fresh.columns)
    names = tuple(finding.effect for finding in found.findings)
    if case.kind == "clean":
        right = not names and not found.unexplained
    elif case.kind == "outside":
        right = found.unexplained
    elif case.kind == "pair":
        right = set(names) == set(case.effects)
    else:
        right = names[:1] == case.effects
    return Said(names, found.unexplained, right, float(np.sqrt(np.mean(left_um**2)) / parts["sigma"]))


def varied() -> Iterator[tuple[str, float, Policy]]:
    """Every number halved and doubled; a share not beyond 1."""
    for name, (value, unit, _, _) in Policy.table().items():
        for factor in FACTORS:
            other = min(value * factor, 0.999) if unit == "1" and value < 1.0 else value * factor
            yield name, factor, Policy(**{name: other})


def line(name: str, factor: float, before: Sequence[Said], after: Sequence[Said], readers: int) -> str:
    """One line of the table."""
    pairs = list(zip(before, after, strict=True))
    changed = sum((a.names, a.unexplained) != (b.names, b.unexplained) for a, b in pairs)
    won = sum(b.right and not a.right for a, b in pairs)
    lost = sum(a.right and not b.right for a, b in pairs)
    fresh = float(np.mean([b.fresh - a.fresh for a, b in pairs]))
    return f"| {name} | ×{factor:g} | {changed} | {won} | {lost} | {fresh:+.3f} | {readers} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=24)
    parser.add_argument("--only", default="", help="numbers, by comma")
    parser.add_argument("--json", type=Path, help="append every verdict here, one a line")
    args = parser.parse_args()
    todo = machines(args.machines)
    only = [name for name in args.only.split(",") if name]
    before, read = [], []
    for case in todo:
        watched = Watched()
        before.append(say(case, watched))
        read.append(watched.read)
    right = sum(said.right for said in before)
    print(
        f"{len(todo)} machines of seed {TUNING_SEED}, {right} right, fresh {np.mean([s.fresh for s in before]):.3f}\n"
    )
    print("| number | factor | verdicts changed | won | lost | fresh RMS / noise | read by |")
    print("|---|---|---|---|---|---|---|", flush=True)
    for name, factor, numbers in varied():
        if only and name not in only:
            continue
        after = [
            say(case, numbers) if name in known else said for case, said, known in zip(todo, before, read, strict=True)
        ]
        print(line(name, factor, before, after, sum(name in known for known in read)), flush=True)
        if args.json:
            with args.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"number": name, "factor": factor, "said": [asdict(s) for s in after]}) + "\n")


if __name__ == "__main__":
    main()
