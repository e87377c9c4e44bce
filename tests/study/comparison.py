"""The diagnosis compared with the usual ways to choose among columns, and with a black box, on the same machines of the grammar.

Run by hand for the table (`python tests/study/comparison.py --machines 100 --report FILE.md`), with few machines by a test.
The usual ways are given the diagnosis's own candidate columns. The report is rewritten after every machine, so that an interrupted
run has one too.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

if __name__ in ("__main__", "__mp_main__"):  # the folder of a script stands first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from study.comparison_methods import BLACK_BOX, METHODS, Data, available, boosted, judge
from study.grammar.equivalence import always_there, not_wrong, right_names
from study.grammar.machine import SEEDS, Drawn, draw
from study.grammar.report import share, text

from hil.diagnosis.follow_up import diagnosed
from hil.effects.history import complete
from hil.records.rows import Records

OURS = "hil"
LOTS = ("strong", "weak", "clean", "pairs")


@dataclass(frozen=True)
class Answer:
    """Result of one method on one machine.

    named: effects found, the largest first, None of a black box; rights: of each cause the names that are right
    tolerated: names that are not wrong; something: a finding, or 'unexplained'
    fresh: RMS left of a fresh campaign over that of its noise, None where a fault of the set-up leaves an offset in it
    seconds: of processor time
    """

    method: str
    lot: str
    seed: int
    named: tuple[str, ...] | None
    rights: tuple[frozenset[str], ...]
    tolerated: frozenset[str]
    something: bool
    fresh: float | None
    seconds: float


def machines(number: int, seeds: str, first: int) -> list[tuple[str, int]]:
    """Lots by turns and seeds; machines with an older table are left out, as the other methods cannot take one."""

    def drawn() -> Iterator[tuple[str, int]]:
        for i in count(first):
            lot = LOTS[i % len(LOTS)]
            if draw(lot, SEEDS[seeds][i]).older is None:
                yield lot, SEEDS[seeds][i]

    return list(islice(drawn(), number))


def ask(machine: tuple[str, int]) -> list[Answer]:
    """Every method on one machine, in one thread each: threads of several processes wait for each other on few cores."""
    with threadpool_limits(1):
        return list(_asked(*machine))


def _asked(lot: str, seed: int) -> Iterator[Answer]:
    drawn = draw(lot, seed)
    first, fresh = Records.of(drawn.fit.records), Records.of(drawn.fresh.records)
    rights, tolerated = _names(drawn)
    noise_um = drawn.noise.sd_um(drawn.fresh.state)
    movable = not any(cause.of_set_up for cause in drawn.causes)

    def answer(method: str, started: float, named: tuple[str, ...] | None, something: bool, left_um: float) -> Answer:
        left = left_um / noise_um if movable else None
        return Answer(method, lot, seed, named, rights, tolerated, something, left, time.process_time() - started)

    started = time.process_time()
    ours = diagnosed(first, None).diagnosis
    left_um = fresh.uncorrected_error_um - ours.extended.error_um(complete(fresh.columns))
    names = tuple(finding.effect for finding in ours.findings)
    yield answer(OURS, started, names, bool(names) or ours.unexplained, float(np.sqrt(np.mean(left_um**2))))
    started = time.process_time()
    data = Data.of(first)
    columns_s = time.process_time() - started
    for name, method in available().items():
        started = time.process_time() - columns_s
        verdict = judge(data, method(data), fresh)
        yield answer(name, started, verdict.names, bool(verdict.names), verdict.fresh_um)
    started = time.process_time()
    yield answer(BLACK_BOX, started, None, False, boosted(first, fresh))


def _names(drawn: Drawn) -> tuple[tuple[frozenset[str], ...], frozenset[str]]:
    courses = [cause["course_of_time"] for cause in drawn.truth()["causes"]]
    rights = tuple(
        right_names(cause, drawn.removed, course) for cause, course in zip(drawn.causes, courses, strict=True)
    )
    beside = [*rights, *map(not_wrong, drawn.causes), always_there(drawn.older is not None)]
    return rights, frozenset().union(*beside)


def ask_all(todo: Iterable[tuple[str, int]], workers: int) -> Iterator[list[Answer]]:
    """The answers machine by machine, in no particular order."""
    if workers <= 1:
        yield from map(ask, todo)
        return
    here = str(Path(__file__).parent)
    sys.path[:] = [place for place in sys.path if place != here]  # where it hides this package from the processes
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(ask, todo)


def _first(answer: Answer) -> bool:
    return bool(answer.named) and answer.named[0] in answer.rights[0]


def _all(answer: Answer) -> bool:
    return all(set(answer.named or ()) & right for right in answer.rights)


def figures(answers: list[Answer]) -> dict[str, dict[str, float]]:
    """The figures of one method: of a black box those without names alone."""

    def of(lots: tuple[str, ...], true: Callable[[Answer], bool]) -> dict[str, float]:
        return share([true(one) for one in answers if one.lot in lots and one.named is not None])

    one, caused = ("strong", "weak"), ("strong", "weak", "pairs")
    fresh = [answer.fresh for answer in answers if answer.fresh is not None and answer.lot != "clean"] or [np.nan]
    return {
        "strong cause named first": of(one[:1], _first),
        "weak cause named first": of(one[1:], _first),
        "both of two strong causes": of(("pairs",), _all),
        "every cause named, and nothing wrong": of(caused, lambda a: _all(a) and set(a.named or ()) <= a.tolerated),
        "a wrong name, beside or instead": of(caused, lambda a: not set(a.named or ()) <= a.tolerated),
        "no cause: anything said": of(("clean",), lambda a: a.something),
        "fresh RMS / noise": {"median": float(np.median(fresh)), "90 %": float(np.quantile(fresh, 0.9))},
        "seconds": {"median": float(np.median([answer.seconds for answer in answers]))},
    }


def by_method(answers: Iterable[Answer]) -> dict[str, dict[str, dict[str, float]]]:
    """Figures of every method that answered."""
    grouped: dict[str, list[Answer]] = {}
    for answer in answers:
        grouped.setdefault(answer.method, []).append(answer)
    return {method: figures(mine) for method, mine in grouped.items()}


def report(answers: list[Answer]) -> str:
    """The figures side by side, as Markdown."""
    table = by_method(answers)
    asked = [answer for answer in answers if answer.method == OURS]
    counts = ", ".join(f"{sum(answer.lot == lot for answer in asked)} {lot}" for lot in LOTS)
    seeds = sorted(answer.seed for answer in asked)
    lines = [f"{len(asked)} machines of the grammar, seeds {seeds[0]} to {seeds[-1]}: {counts}.", ""]
    lines += [f"NOT COMPARED: {name}, which is not installed here." for name in METHODS if name not in available()]
    lines += [f"| | {' | '.join(table)} |", "|---|" + "---:|" * len(table)]
    for name in next(iter(table.values())):
        cells = [text(mine[name]) if mine[name].get("of", 1) else "names nothing" for mine in table.values()]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=100)
    parser.add_argument("--seeds", choices=tuple(SEEDS), default="tuning")
    parser.add_argument("--first", type=int, default=0, help="how many of the seeds to pass over")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--report", metavar="FILE.md", help="write the table here, anew after every machine")
    args = parser.parse_args()
    for name in METHODS.keys() - available().keys():
        print(f"{name} is not installed and is left out: pip install -e .[test]", file=sys.stderr)
    answers: list[Answer] = []
    for more in ask_all(machines(args.machines, args.seeds, args.first), args.workers):
        answers += more
        if args.report:
            Path(args.report).write_text(report(answers), encoding="utf-8")
    print(report(answers), end="")


if __name__ == "__main__":
    main()
