"""Speed and memory of the diagnosis, printed with -s: one ordinary campaign, and one of 100 000 rows in a process of its own.

What is wanted on a quiet machine: 1 s, 10 s and 500 MB. It computes in one thread, so that processor time is what it takes there;
a busy machine makes that longer too, and the bounds leave room for it.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from study.truth_machines import Machine, Plan

from hil.diagnosis import diagnose
from hil.records.rows import Records

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parents[1]
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


@pytest.mark.parametrize(
    "effects", [(), ("cyclic",), ("thermal_drift",)], ids=lambda effects: "+".join(effects) or "clean"
)
def test_an_ordinary_campaign(effects: tuple[str, ...], record_property: Callable[[str, object], None]) -> None:
    columns, _ = Machine(5, effects, (1.5,) * len(effects)).campaign(0, Plan())
    keep = [*list(columns)[:14], *[name for name in ("time_s", "measured_mm") if name not in list(columns)[:14]]]
    records = Records.of({name: columns[name] for name in keep})
    best_s = min(_seconds(records) for _ in range(3))
    print(f"\n{len(records)} rows × {len(keep)} columns: {best_s:.2f} s")
    record_property("seconds", best_s)
    assert best_s < 2.5


def _seconds(records: Records) -> float:
    start = time.process_time()
    diagnose(records)
    return time.process_time() - start


@pytest.mark.parametrize(("runs", "targets"), [(8, 6250), (1250, 40)], ids=["long runs", "many runs"])
def test_a_hundred_thousand_rows(runs: int, targets: int, record_property: Callable[[str, object], None]) -> None:
    code = LARGE.format(runs=runs, targets=targets)
    done = subprocess.run([sys.executable, "-c", code], cwd=TESTS, capture_output=True, text=True, check=True)
    rows, seconds, peak_mb, *names = done.stdout.split()
    print(f"\n{rows} rows, {runs} runs: {float(seconds):.1f} s, at most {float(peak_mb):.0f} MB")
    record_property("seconds", float(seconds))
    record_property("peak_mb", float(peak_mb))
    assert rows == "100000"
    assert names == ["cyclic"]
    assert float(seconds) < 20.0
    assert float(peak_mb) <= 500.0
