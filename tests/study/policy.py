"""What each number of the diagnosis's policy does: every one halved and doubled, or its rule switched off, on the same machines.

`python tests/study/policy.py [--grammar] [--off] [--machines N] [--only name,name] [--json LINES]` prints, for each number and
change, how many verdicts (names in order with whether each is sure, and whether something is unexplained) changed, how many right
ones were won and lost, and the mean change of the RMS on a fresh campaign over the noise. The machines are this project's own, small
campaigns of weak causes, so that many verdicts are near a decision; with --grammar those of the grammar, of every lot in turn.
Seeds are those for tuning. A machine whose diagnosis never reads a number is not diagnosed again for it; the last column counts those
that do.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from study.grammar.judge import outcome
from study.grammar.machine import LOTS, SEEDS
from study.grammar.report import right
from study.own_catalogue import Case, cases, in_turn
from study.truth_machines import Machine, Plan

from hil.diagnosis import diagnose, fit_model
from hil.diagnosis.policy import USUAL, Policy, in_force
from hil.records.rows import Records

TUNING_SEED = 7_000_001
"""No figure that is reported comes from this seed."""
FIRST_OF_GRAMMAR = 20_000
"""Of the grammar's tuning seeds, the first used here."""
FACTORS = (0.5, 2.0)
NEVER, ALWAYS = 0.0, 1e9
OFF = {
    "temperature": 1.0,
    "no_further": NEVER,
    "in_table": NEVER,
    "shape": NEVER,
    "outgrown": ALWAYS,
    "equivalent": 1.0,
    "slow_alike": ALWAYS,
    "trimmed": ALWAYS,
    "by_signs": ALWAYS,
    "nearly_all": ALWAYS,
    "beyond_repeats": ALWAYS,
    "unpredicted": ALWAYS,
    "worse_left_out": ALWAYS,
    "unsure_beyond": ALWAYS,
    "opposed": NEVER,
    "most_times": ALWAYS,
    "whole_opposed_from": ALWAYS,
    "far_off": ALWAYS,
    "most_uneven": ALWAYS,
    "pseudo_rows": NEVER,
    "most_offset": 4.0,
    "outlier_tail": NEVER,
    "least_confidence": NEVER,
    "sure_name": NEVER,
    "small_jump": NEVER,
    "wander": NEVER,
}
"""The value of a number with which its rule does nothing."""
WEAKER = 0.6
"""Factor on the strength of every cause of the study, so that more verdicts are near a decision."""
SMALL = Plan(runs=6, targets=16)


@dataclass(frozen=True)
class Said:
    """Of one machine: the names and whether each is sure, whether something is unexplained, whether that is right, RMS on a fresh
    campaign over noise.
    """

    names: tuple[tuple[str, bool], ...]
    unexplained: bool
    right: bool
    fresh: float


Say = Callable[[Policy], Said]
"""What is said of one machine under a policy."""


def own_machines(count: int) -> Iterator[Say]:
    """So many machines of this project, all kinds in turn."""
    for case in in_turn(cases(-(-count // 6), TUNING_SEED))[:count]:
        yield partial(said_of_own, replace(case, strength=tuple(WEAKER * s for s in case.strength)))


def machines_of_grammar(count: int) -> Iterator[Say]:
    """So many machines of the grammar, of every lot in turn."""
    for number in range(count):
        turn, lot = divmod(number, len(LOTS))
        yield partial(said_of_grammar, LOTS[lot], SEEDS["tuning"][FIRST_OF_GRAMMAR + turn])


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


def said_of_own(case: Case, numbers: Policy) -> Said:
    """What is said of a machine of this project."""
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
        is_right = not names and not found.unexplained
    elif case.kind == "outside":
        is_right = found.unexplained
    elif case.kind == "pair":
        is_right = set(names) == set(case.effects)
    else:
        is_right = names[:1] == case.effects
    sure = tuple((finding.effect, finding.confidence >= USUAL.sure) for finding in found.findings)
    return Said(sure, found.unexplained, is_right, float(np.sqrt(np.mean(left_um**2)) / parts["sigma"]))


def said_of_grammar(lot: str, seed: int, numbers: Policy) -> Said:
    """What the public verbs say of a machine of the grammar; nothing where one refuses."""
    with in_force(numbers):
        found = outcome(lot, seed)
    if "error" in found:
        return Said((), False, False, math.nan)
    said = found["said"]
    sure = tuple((finding["effect"], finding["confidence"] >= USUAL.sure) for finding in said["findings"])
    return Said(sure, said["unexplained"], right(found), found["fresh_um"] / found["fresh_noise_um"])


def varied(*, off: bool) -> Iterator[tuple[str, str, Policy]]:
    """Every number halved and doubled, a share not beyond 1, or those whose rules can be switched off without them."""
    for name, (value, unit, _, _) in Policy.table().items():
        if off and name in OFF:
            yield name, "off", Policy(**{name: OFF[name]})
        for factor in () if off else FACTORS:
            other = min(value * factor, 0.999) if unit == "1" and value < 1.0 else value * factor
            yield name, f"×{factor:g}", Policy(**{name: other})


def line(name: str, change: str, before: Sequence[Said], after: Sequence[Said], readers: int) -> str:
    """One line of the table."""
    pairs = list(zip(before, after, strict=True))
    changed = sum((a.names, a.unexplained) != (b.names, b.unexplained) for a, b in pairs)
    won = sum(b.right and not a.right for a, b in pairs)
    lost = sum(a.right and not b.right for a, b in pairs)
    fresh = float(np.nanmean([b.fresh - a.fresh for a, b in pairs]))
    return f"| {name} | {change} | {changed} | {won} | {lost} | {fresh:+.3f} | {readers} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=24)
    parser.add_argument("--grammar", action="store_true", help="machines of the grammar, not this project's own")
    parser.add_argument("--off", action="store_true", help="switch rules off instead of halving and doubling")
    parser.add_argument("--only", default="", help="numbers, by comma")
    parser.add_argument("--json", type=Path, help="append every verdict here, one a line")
    args = parser.parse_args()
    todo = list((machines_of_grammar if args.grammar else own_machines)(args.machines))
    only = [name for name in args.only.split(",") if name]
    before, read = [], []
    for say in todo:
        watched = Watched()
        before.append(say(watched))
        read.append(watched.read)
    right_ones = sum(said.right for said in before)
    of = (
        f"the grammar, tuning seeds from {SEEDS['tuning'][FIRST_OF_GRAMMAR]}" if args.grammar else f"seed {TUNING_SEED}"
    )
    fresh = float(np.nanmean([said.fresh for said in before]))
    print(f"{len(todo)} machines of {of}, {right_ones} right, fresh {fresh:.3f}\n")
    print("| number | change | verdicts changed | won | lost | fresh RMS / noise | read by |")
    print("|---|---|---|---|---|---|---|", flush=True)
    for name, change, numbers in varied(off=args.off):
        if only and name not in only:
            continue
        after = [say(numbers) if name in known else said for say, said, known in zip(todo, before, read, strict=True)]
        print(line(name, change, before, after, sum(name in known for known in read)), flush=True)
        if args.json:
            with args.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"number": name, "change": change, "said": [asdict(s) for s in after]}) + "\n")


if __name__ == "__main__":
    main()
