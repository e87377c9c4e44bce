"""A download of 40 parameters with each kind of fault at every frame: `python tests/study/params_every_frame.py [EVERY]`.

Prints a table; EVERY takes each n-th frame only (default 1: every frame). Tests marked `outside` run it with some frames.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

if __name__ == "__main__":  # the folder of a script is first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from support.parameter_faults import KINDS, Run, cases, one_run
from support.parameter_rigs import maker_eds


@dataclass
class Tally:
    """Results of the runs of one kind. broken: those that did not end entirely old or entirely new, as reported."""

    kind: str
    runs: int = 0
    endings: Counter[str] = field(default_factory=Counter)
    broken: list[str] = field(default_factory=list)

    def add(self, place: str, run: Run) -> None:
        self.runs += 1
        ending = run.at_last or run.said
        self.endings["nothing to finish" if ending is None else ending.name.lower().replace("_", " ")] += 1
        if not run.whole:
            self.broken.append(f"{self.kind} at {place}: {run}")

    def __str__(self) -> str:
        told = ", ".join(f"{count} {name}" for name, count in self.endings.most_common())
        return f"{self.kind}: {self.runs} runs, {len(self.broken)} broken ({told})"


def study(kind: str, folder: Path, every: int = 1, first: int = 0) -> Tally:
    """All runs of a kind, or each n-th from the `first` on; an interrupted download is finished both ways, in two runs."""
    eds = maker_eds(folder, 40)
    clean = one_run(eds, folder / "clean")
    if not clean.whole:
        return Tally(kind, broken=[f"without a fault: {clean}"])
    tally = Tally(kind)
    for number, (faults, dies_at) in enumerate(cases(clean, kind)):
        if number % every != first % every:
            continue
        for forward in (True, False):
            place = folder / f"{number}-{forward}"
            run = one_run(eds, place, *faults, dies_at=dies_at, forward=forward)
            shutil.rmtree(place, ignore_errors=True)
            tally.add(f"{number}, {'resume' if forward else 'rollback'}", run)
            if run.at_last is None:
                break
    return tally


def main() -> int:
    every = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    tallies = []
    for kind in KINDS:
        with tempfile.TemporaryDirectory() as folder:
            tallies.append(study(kind, Path(folder), every))
        print(tallies[-1], flush=True)
        for line in tallies[-1].broken:
            print("   ", line)
    runs, broken = sum(tally.runs for tally in tallies), sum(len(tally.broken) for tally in tallies)
    print(f"{runs} runs, {broken} broken")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
