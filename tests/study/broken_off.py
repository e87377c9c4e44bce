"""Verbs killed, interrupted and left without power at random moments, then resumed: `python tests/study/broken_off.py`.

Four verbs, four homing methods, 200 moments each, which the three kinds of interruption use in turn. Prints each run that was not
correct, and the ends of the second processes.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from itertools import groupby
from pathlib import Path

if __name__ == "__main__":  # the folder of a script is first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from hostile.kills import BROKEN_OFF, HOMING, WAYS, breaks, run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--verb", action="append", choices=BROKEN_OFF)
    parser.add_argument("--homing", action="append", choices=HOMING)
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    chosen = breaks(args.moments, tuple(args.verb or BROKEN_OFF), tuple(args.homing or HOMING))
    began_s, found = time.monotonic(), []
    for _, cases in groupby(chosen, key=lambda case: (case.verb, case.method)):
        # processes of their own: what a killed program leaves open stays open in them, and there are 1024 descriptors
        with ProcessPoolExecutor(args.processes) as pool:
            for one in pool.map(run, cases, chunksize=4):
                found.append(one)
                if one.complaints:
                    print(f"{one.case}: {one.ended}; {'; '.join(one.complaints)}", flush=True)
    print(f"{'homing':8} {'broken off by':14} {'runs':>5} {'bad':>5}  second life")
    for method in args.homing or HOMING:
        for way in WAYS:
            these = [one for one in found if (one.case.method, one.case.way) == (method, way)]
            ends = ", ".join(f"{name} {count}" for name, count in Counter(one.ended for one in these).most_common())
            print(f"{method:8} {way:14} {len(these):5} {sum(bool(one.complaints) for one in these):5}  {ends}")
    bad = sum(bool(one.complaints) for one in found)
    print(f"{len(found)} runs in {time.monotonic() - began_s:.0f} s: {bad} were not right")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
