"""The diagnosis compared with the usual ways to choose among columns, on the same machines with the same candidate columns.

Run by hand for the table (`python tests/study/comparison.py --machines 100 --report FILE.md`), with few machines by the slow suite.
The report is rewritten after every machine, so that an interrupted run has one too.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, zip_longest
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

if __name__ in ("__main__", "__mp_main__"):  # the folder of a script stands first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from study.comparison_methods import METHODS, Data, available, judge
from study.own_catalogue import INSTRUMENT, Case, cases, run
from study.truth_machines import Machine, Plan

from hil.records.rows import Records

OURS = "hil"
KINDS = ("strong", "weak", "clean", "pair")


@dataclass(frozen=True)
class Answer:
    """Result of one method on one machine.

    names: effects found, the largest first; something: a finding, or 'unexplained'
    fresh: RMS left of a fresh campaign over that of its noise; seconds: of processor time
    """

    method: str
    case: Case
    names: tuple[str, ...]
    something: bool
    fresh: float
    seconds: float


def mixed_cases(machines: int, seed: int) -> list[Case]:
    """About as many machines as requested, the kinds in turn, each spread over its effects or noises."""
    found = list(cases(-(-machines // len(KINDS)), seed))
    kinds = [[case for case in found if case.kind == kind] for kind in KINDS]
    return [case for case in chain(*zip_longest(*kinds)) if case is not None][:machines]


def ask(case: Case) -> list[Answer]:
    """Every method on one machine, in one thread each: threads of several processes wait for each other on few cores."""
    with threadpool_limits(1):
        return _asked(case)


def _asked(case: Case) -> list[Answer]:
    machine, plan = Machine(case.seed, case.effects, case.strength, case.noise), Plan(scatter=case.scatter)
    first, _ = machine.campaign(0, plan)
    second, parts = machine.campaign(1, plan)
    fresh, noise_um = Records.of(second), float(np.std(parts["noise"]))
    started = time.process_time()
    ours = run(case)
    unsure = bool(ours.names) or ours.unexplained
    answers = [Answer(OURS, case, ours.names, unsure, ours.fresh / ours.ideal, time.process_time() - started)]
    data = Data.of(Records.of(first))
    for name, method in available().items():
        started = time.process_time()
        verdict = judge(data, method(data), fresh)
        seconds = time.process_time() - started
        answers.append(Answer(name, case, verdict.names, bool(verdict.names), verdict.fresh_um / noise_um, seconds))
    return answers


def ask_all(todo: Iterable[Case], workers: int) -> Iterator[list[Answer]]:
    """The answers machine by machine, in no particular order."""
    if workers <= 1:
        yield from map(ask, todo)
        return
    here = str(Path(__file__).parent)
    sys.path[:] = [place for place in sys.path if place != here]  # where it hides this package from the processes
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(ask, todo)


def _share(answers: list[Answer], kinds: tuple[str, ...], true: Callable[[Answer], bool]) -> float:
    mine = [true(answer) for answer in answers if answer.case.kind in kinds]
    return sum(mine) / len(mine) if mine else float("nan")


def _false(answer: Answer) -> bool:
    """Whether a wrong statement was made: an effect that is not there, or, for a clean machine, any finding."""
    return not set(answer.names) <= set(answer.case.effects) or (answer.something and not answer.case.effects)


def figures(answers: list[Answer]) -> dict[str, float]:
    """The figures of one method."""
    known = [a.fresh for a in answers if a.case.effects and not INSTRUMENT & set(a.case.effects)] or [float("nan")]
    one = ("strong", "weak")
    return {
        "right effect first": _share(answers, one, lambda a: a.names[:1] == a.case.effects),
        "right effect first, 1.5 to 4 × noise": _share(answers, one[:1], lambda a: a.names[:1] == a.case.effects),
        "right effect first, 0.5 to 1.5 × noise": _share(answers, one[1:], lambda a: a.names[:1] == a.case.effects),
        "a wrong effect named beside or instead": _share(
            answers, one, lambda a: not set(a.names) <= set(a.case.effects)
        ),
        "every effect named and nothing else": _share(
            answers, (*one, "pair"), lambda a: set(a.names) == set(a.case.effects)
        ),
        "any machine: something named that is not there": _share(answers, KINDS, _false),
        "both of two effects": _share(answers, ("pair",), lambda a: set(a.case.effects) <= set(a.names)),
        "clean machine: false finding": _share(answers, ("clean",), lambda a: a.something),
        "fresh RMS / noise, median": float(np.median(known)),
        "fresh RMS / noise, 90 %": float(np.quantile(known, 0.9)),
        "seconds, median": float(np.median([a.seconds for a in answers])),
    }


def by_method(answers: Iterable[Answer]) -> dict[str, dict[str, float]]:
    """Figures of every method that answered."""
    grouped: dict[str, list[Answer]] = {}
    for answer in answers:
        grouped.setdefault(answer.method, []).append(answer)
    return {method: figures(mine) for method, mine in grouped.items()}


def report(answers: list[Answer]) -> str:
    """The figures side by side, as Markdown."""
    table = by_method(answers)
    asked = [a.case for a in answers if a.method == OURS]
    counts = ", ".join(f"{sum(case.kind == kind for case in asked)} {kind}" for kind in KINDS)
    lines = [f"{len(asked)} machines: {counts}.", ""]
    lines += [f"NOT COMPARED: {name}, which is not installed here." for name in METHODS if name not in available()]
    lines += [f"| | {' | '.join(table)} |", "|---|" + "---:|" * len(table)]
    for name in next(iter(table.values())):
        lines.append(f"| {name} | " + " | ".join(f"{mine[name]:.3f}" for mine in table.values()) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=100)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--report", metavar="FILE.md", help="write the table here, anew after every machine")
    args = parser.parse_args()
    for name in METHODS.keys() - available().keys():
        print(f"{name} is not installed and is left out: pip install -e .[test]", file=sys.stderr)
    answers: list[Answer] = []
    for more in ask_all(mixed_cases(args.machines, args.seed), args.workers):
        answers += more
        if args.report:
            Path(args.report).write_text(report(answers), encoding="utf-8")
    print(report(answers), end="")


if __name__ == "__main__":
    main()
