"""Every kind of misbehaving peer x every verb that moves x seeds: `python tests/study/hostile_peers.py --all`.

Prints each case that did not end correctly, and a table of the kinds: number of runs that met them, their ends, the latest end.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

if __name__ == "__main__":  # the folder of a script is first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from hostile.judge import WIRES, Case, Outcome, cases, run


def table(outcomes: Sequence[Outcome]) -> str:
    """One line for each kind."""
    by_kind: dict[tuple[str, str], list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        by_kind[outcome.case.wire, outcome.case.kind].append(outcome)
    lines = [f"{'wire':10} {'kind':58} {'runs':>5} {'met':>5} {'bad':>5} {'latest s':>9}  ended by"]
    for (wire, kind), found in by_kind.items():
        met = [one for one in found if not one.ended.startswith("unmet")]
        ends = Counter(one.ended for one in met).most_common(4)
        latest_s = max((one.seconds for one in met if one.ended != "got over"), default=0.0)
        lines.append(
            f"{wire:10} {kind:58} {len(found):5} {len(met):5} {sum(bool(one.complaints) for one in found):5} {latest_s:9.2f}  "
            + ", ".join(f"{name} {count}" for name, count in ends)
        )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="every kind, every verb, ten seeds")
    parser.add_argument("--wire", choices=WIRES, action="append")
    parser.add_argument("--kind", help="part of a kind's name")
    parser.add_argument("--verb", action="append")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only each Nth case")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    chosen: list[Case] = [
        case
        for case in cases(args.seeds, args.wire)
        if (args.kind is None or args.kind in case.kind) and (args.verb is None or case.verb in args.verb)
    ][:: args.every]
    began_s, outcomes = time.monotonic(), []
    with ProcessPoolExecutor(args.processes) as pool:
        for outcome in pool.map(run, chosen, chunksize=4):
            outcomes.append(outcome)
            if outcome.complaints:
                print(f"{outcome.case}: {'; '.join(outcome.complaints)}", flush=True)
    bad = sum(bool(outcome.complaints) for outcome in outcomes)
    kinds = {(outcome.case.wire, outcome.case.kind) for outcome in outcomes}
    print(table(outcomes))
    print(f"{len(outcomes)} runs of {len(kinds)} kinds in {time.monotonic() - began_s:.0f} s: {bad} did not end well")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
