"""Time and memory of the diagnosis: an ordinary campaign with the start of the program, three sizes, and a million rows.

Each in a process of its own. It computes in one thread, so its processor time is what it takes on a quiet host; the bounds leave room
for a busy one.
"""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from statistics import median

import numpy as np
import pytest
from study.truth_machines import Machine, Plan
from support.bench import Record, installed, row

from hil.records.rows import Records, to_csv

pytestmark = pytest.mark.outside

TESTS = Path(__file__).parents[1]
MEASURED = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, check=False)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
"""
LARGE = """
import resource, time
from hil.diagnosis import diagnose
from hil.records.rows import Records
from study.truth_machines import Machine, Plan
columns, _ = Machine(5, ("cyclic",), (2.0,)).campaign(0, Plan(runs={runs}, targets={targets}))
records = Records.of(columns)
start = time.process_time()
found = diagnose(records)
seconds = time.process_time() - start
peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(len(records), seconds, peak_mb, *(finding.effect for finding in found.findings))
"""


def _ran(command: list[str], env: dict[str, str]) -> tuple[float, float]:
    """Processor seconds and largest memory, MB, of a command of the program, with its start."""
    words = [sys.executable, "-c", MEASURED, sys.executable, "-m", "hil.app", *command]
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=True)
    seconds, peak_mb = map(float, done.stdout.split())
    return seconds, peak_mb


@pytest.mark.parametrize(
    "effects", [(), ("cyclic",), ("thermal_drift",)], ids=lambda effects: "+".join(effects) or "clean"
)
def test_an_ordinary_campaign(effects: tuple[str, ...], record_property: Record, tmp_path: Path) -> None:
    columns, _ = Machine(5, effects, (1.5,) * len(effects)).campaign(0, Plan())
    keep = [*list(columns)[:14], *[name for name in ("time_s", "measured_mm") if name not in list(columns)[:14]]]
    records = Records.of({name: columns[name] for name in keep})
    path, out = tmp_path / "records.csv", tmp_path / "out.json"
    path.write_text(to_csv(records))
    env = installed(tmp_path / "compiled")
    rounds, alone = [], []
    for _ in range(4):
        rounds.append(_ran(["diagnose", str(path), "--json", str(out)], env))
        alone.append(float(json.loads(out.read_text())["seconds"]))
    assert {one["effect"] for one in json.loads(out.read_text())["findings"]} == set(effects)
    what = "+".join(effects) or "nothing to find"
    usual_s = median(seconds for seconds, _ in rounds[1:])
    for name, value in (("program start included, ", usual_s), ("", median(alone[1:]))):
        said = f"diagnosis, {len(records)} rows × {len(keep)} columns, {name}{what}"
        row(record_property, said, value, 1.0, "s", beside="asked", asked="≤ 1")
    assert usual_s < 5.0


@cache
def _large(runs: int, targets: int) -> tuple[int, float, float, list[str]]:
    code = LARGE.format(runs=runs, targets=targets)
    done = subprocess.run([sys.executable, "-c", code], cwd=TESTS, capture_output=True, text=True, check=True)
    rows, seconds, peak_mb, *names = done.stdout.split()
    return int(rows), float(seconds), float(peak_mb), names


@pytest.mark.parametrize(("runs", "targets"), [(8, 6250), (1250, 40)], ids=["long runs", "many runs"])
def test_a_hundred_thousand_rows(runs: int, targets: int, record_property: Record) -> None:
    rows, seconds, peak_mb, names = _large(runs, targets)
    assert rows == 100_000
    assert names == ["cyclic"]
    row(record_property, f"diagnosis, 100,000 rows in {runs} runs", seconds, 5.0, "s", beside="asked", asked="≤ 5 s")
    row(
        record_property,
        f"diagnosis, 100,000 rows in {runs} runs, memory",
        peak_mb,
        400.0,
        "MB",
        beside="asked",
        asked="≤ 400 MB",
    )
    assert seconds < 20.0
    assert peak_mb <= 400.0


def test_growth_over_three_sizes(record_property: Record) -> None:
    sizes = [(8, 391), (8, 1563), (8, 6250)]
    found = [_large(*size) for size in sizes]
    exponent = float(np.polyfit(np.log([rows for rows, *_ in found]), np.log([s for _, s, *_ in found]), 1)[0])
    for rows, seconds, peak_mb, names in found:
        print(f"{rows} rows: {seconds:.2f} s, {peak_mb:.0f} MB, {names}")
    name = f"diagnosis, exponent of growth, {found[0][0]:,} to {found[-1][0]:,} rows"
    row(record_property, name, exponent, 1.0, "", beside="linear", asked="≤ 1.1")
    assert exponent < 1.3


def test_a_million_rows_end(record_property: Record) -> None:
    rows, seconds, peak_mb, names = _large(8, 62_500)
    assert (rows, names) == (1_000_000, ["cyclic"])
    row(record_property, "diagnosis, a million rows", seconds, 10.0, "s", beside="asked of 100,000", asked="ends")
    row(record_property, "diagnosis, a million rows, memory", peak_mb, 500.0, "MB", beside="asked of 100,000")
