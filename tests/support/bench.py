"""Lines of the table of benchmarks: printed by the bench, recorded for `python tests/bench`, which writes nothing else."""

from __future__ import annotations

import gc
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

Record = Callable[[str, object], None]
ROW = "bench row"


def row(
    record: Record,
    figure: str,
    ours: float,
    other: float,
    unit: str,
    *,
    beside: str,
    ratio: float | None = None,
    asked: str = "",
) -> None:
    """Prints and records one line.

    beside: what `other` is; ratio: ours over other, where it is not that of the two medians; asked: what the ratio or the
    figure was to be, "" for nothing
    """
    ratio = ours / other if ratio is None else ratio
    cells = {
        "figure": figure,
        "ours": f"{number(ours)} {unit}".strip(),
        "beside": f"{beside}: {number(other)} {unit}".strip(),
        "ratio": number(ratio),
        "asked": asked,
    }
    print("\n" + " | ".join(cells.values()))
    record(ROW, json.dumps(cells, ensure_ascii=False))


def number(value: float) -> str:
    """Three significant digits, thousands with commas."""
    return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def installed(folder: Path) -> dict[str, str]:
    """Environment of a process that finds the program's modules compiled, as any installation does: a first run leaves them here."""
    mine = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return mine | {"PYTHONPYCACHEPREFIX": str(folder)}


def side_by_side(runs: Sequence[Callable[[], object]], rounds: int) -> list[list[float]]:
    """Processor seconds of each, shape (runs, rounds): one after the other in every round, after one round that does not count."""
    for run in runs:
        run()
    found: list[list[float]] = [[] for _ in runs]
    for _ in range(rounds):
        for run, times in zip(runs, found, strict=True):
            times.append(seconds(run))
    return found


def seconds(run: Callable[[], object]) -> float:
    """Processor seconds of this thread: what others do on this host does not count, nor what earlier tests left for the collector."""
    gc.collect()
    gc.disable()
    try:
        began = time.thread_time()
        run()
        return time.thread_time() - began
    finally:
        gc.enable()


def median_ratio(ours: Sequence[float], other: Sequence[float]) -> float:
    """Median over the rounds of ours over other."""
    return median(a / b for a, b in zip(ours, other, strict=True))
