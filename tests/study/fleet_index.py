"""The index of a large fleet: time and memory of indexing, of an unchanged second run and of queries, against reading the CSV files.

    python tests/study/fleet_index.py                   1,250, 2,500, 5,000 and 10,000 campaigns of 250 rows
    python tests/study/fleet_index.py --campaigns 400 800

Each fleet is written to a temporary directory and removed afterwards. Each step is a process of its own; its time is
that of all its processes, its memory that of the largest. Prints the exponent of growth, by a straight line through the
logarithms.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from support.fleet import rows, write_campaign

BEGUN = datetime(2024, 1, 1, 8, tzinfo=UTC)
QUERY = """import duckdb
found = duckdb.sql("SELECT axis, avg((measured_mm - target_mm) * 1000) FROM '{index}/part-*/rows.parquet' GROUP BY axis").fetchall()
assert found
"""
READ = """import pathlib
from collections import defaultdict
from hil.records.rows import read_csv
sums = defaultdict(lambda: [0.0, 0])
for path in pathlib.Path('{root}').glob('*/*/verify.csv'):
    records = read_csv(path)
    one = sums[path.parts[-3]]
    one[0] += records.error_um.sum()
    one[1] += len(records)
assert sums
"""
STEPS = {
    "index": ["-m", "hil.app", "fleet", "index", "{root}", "--processes", "{processes}"],
    "index, nothing new": ["-m", "hil.app", "fleet", "index", "{root}"],
    "trend": ["-m", "hil.app", "fleet", "trend", "{root}", "--json", "{json}"],
    "DuckDB: mean error by axis over all rows": ["-c", QUERY],
    "reading the CSV files: the same mean": ["-c", READ],
}
MEASURED = (
    "import resource, subprocess, sys, time\nbegan = time.monotonic()\nstatus = subprocess.run(sys.argv[1:],"
    " stdout=subprocess.DEVNULL).returncode\nused = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
    "print(time.monotonic() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, status)"
)


def write_fleet(root: Path, campaigns: int, axes: int) -> None:
    """`campaigns` campaigns of 250 rows, of this many axes in turn, a week apart."""
    rng = np.random.default_rng(1)
    for number in range(campaigns):
        week, axis = divmod(number, axes)
        directory = root / f"A{axis:03d}-campaign" / f"verify-{week + 1:04d}"
        text = rows(rng, 10.0 + rng.normal(0.0, 0.2))
        write_campaign(directory, f"A{axis:03d}", BEGUN + timedelta(weeks=week), text)


def measured(words: Sequence[str]) -> tuple[float, float, float]:
    """Seconds, processor seconds and largest memory of one process, MB, of a Python command."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, sys.executable, *words], capture_output=True, text=True, check=True
    )
    seconds, processor_s, memory_mb, status = map(float, done.stdout.split())
    if status not in (0.0, 1.0):
        raise SystemExit(done.stderr)
    return seconds, processor_s, memory_mb


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaigns", type=int, nargs="+", default=[1250, 2500, 5000, 10_000])
    parser.add_argument("--axes", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(words)
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in STEPS}
    for campaigns in args.campaigns:
        with tempfile.TemporaryDirectory(prefix="hil-fleet-") as place:
            root = Path(place) / "fleet"
            began = time.monotonic()
            write_fleet(root, campaigns, args.axes)
            print(f"{campaigns} campaigns, {250 * campaigns:,} rows (written in {time.monotonic() - began:.0f} s)")
            index = root / "fleet-index"
            names = {"root": root, "index": index, "json": Path(place) / "trend.json", "processes": args.processes}
            for name, step in STEPS.items():
                command = [word.format(**names) if "{" in word else word for word in step]
                seconds, processor_s, memory_mb = measured(command)
                found[name].append((seconds, processor_s, memory_mb))
                print(f"  {name}: {seconds:.1f} s, processor {processor_s:.1f} s, {memory_mb:.0f} MB", flush=True)
            size_mb = sum(path.stat().st_size for path in index.rglob("*.parquet")) / 1e6
            csv_mb = sum(path.stat().st_size for path in root.glob("*/*/*.csv")) / 1e6
            print(f"  Parquet {size_mb:.0f} MB, CSV {csv_mb:.0f} MB")
    if len(args.campaigns) > 1:
        x = np.log(np.array(args.campaigns, dtype=float))
        for name, each in found.items():
            exponent = np.polyfit(x, np.log([processor_s for _, processor_s, _ in each]), 1)[0]
            print(f"{name}: processor time grows with campaigns to the {exponent:.2f}")
    if args.json:
        args.json.write_text(json.dumps({"campaigns": args.campaigns, "steps": found}, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
