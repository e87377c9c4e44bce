"""The study of the diagnosis on machines from a grammar: `python tests/study/grammar --lot strong --machines 60
--seeds tuning`.

Prints the figures of each lot and writes them, with every machine's truth and verdict, as JSON. The reporting seeds
are for figures that are published and are run once; nothing may be tuned to them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

if not __package__:  # run as a folder: its own place would hide the package
    sys.path[0] = str(Path(__file__).resolve().parents[2])

from study.grammar.judge import Outcome, outcome
from study.grammar.machine import LOTS, SEEDS
from study.grammar.report import calibration, figures, picture, right, text

from hil.fleet.executor import completed


def _numbers(seeds: str, first: int, machines: int) -> list[int]:
    numbers = list(SEEDS[seeds][first : first + machines])
    if len(numbers) < machines:
        raise SystemExit(f"there are {len(SEEDS[seeds])} {seeds} seeds")
    return numbers


def which(outcomes: Sequence[Outcome]) -> str:
    """The seeds that outcomes come from, in words."""
    numbers = sorted({one["seed"] for one in outcomes})
    parts = [(name, [number for number in numbers if number in seeds]) for name, seeds in SEEDS.items()]
    return " and ".join(f"{name} seeds {own[0]} to {own[-1]} ({len(own)})" for name, own in parts if own)


def _told(path: Path | None, outcomes: Sequence[Outcome]) -> None:
    """Prints the figures of the last lot, and writes those of all."""
    lots = list(dict.fromkeys(one["lot"] for one in outcomes))
    by_lot = {lot: [one for one in outcomes if one["lot"] == lot] for lot in lots}
    if path:
        found: dict[str, Any] = {
            "seeds": which(outcomes),
            "lots": {lot: figures(own) for lot, own in by_lot.items()},
            "confidence": calibration(outcomes),
            "missed": [one for one in outcomes if not right(one)],
            "outcomes": list(outcomes),
        }
        path.write_text(json.dumps(found, indent=1), encoding="utf-8")
    print(f"\n{lots[-1]} ({which(by_lot[lots[-1]])})", flush=True)
    for name, value in figures(by_lot[lots[-1]]).items():
        print(f"  {name}: {text(value)}", flush=True)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lot", action="append", choices=LOTS, help="may be repeated; default: all")
    parser.add_argument("--machines", type=int, default=60, help="of each lot")
    parser.add_argument("--seeds", choices=tuple(SEEDS), default="tuning")
    parser.add_argument("--first", type=int, default=0, help="how many of the seeds to pass over")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--scheduler", help="a Dask scheduler, its workers started with PYTHONPATH=.:tests")
    parser.add_argument("--json", type=Path, help="figures and outcomes, with the machines that were missed")
    parser.add_argument(
        "--together", type=Path, nargs="+", metavar="JSON", help="figures of earlier runs together; runs nothing"
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help="the reliability diagram of all lots, PNG or SVG")
    args = parser.parse_args(words)
    everything: list[Outcome] = []
    if args.together:
        earlier = [one for path in args.together for one in json.loads(path.read_text(encoding="utf-8"))["outcomes"]]
        for lot in dict.fromkeys(one["lot"] for one in earlier):
            everything += [one for one in earlier if one["lot"] == lot]
            _told(args.json, everything)
    else:
        numbers = _numbers(args.seeds, args.first, args.machines)
        for lot in args.lot or LOTS:
            work = partial(outcome, lot)
            found = dict(completed(work, numbers, scheduler=args.scheduler, processes=args.processes))
            everything += [found[number] for number in numbers]
            _told(args.json, everything)
    others = ", ".join(f"{name} {seeds[0]} to {seeds[-1]}" for name, seeds in SEEDS.items())
    print(f"\nconfidence, all lots ({which(everything)}; all seeds there are: {others})")
    for name, value in calibration(everything).items():
        print(f"  {name}: {text(value)}")
    if args.picture:
        picture(everything, args.picture)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
