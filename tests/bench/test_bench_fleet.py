"""The index of a fleet of 1,000 campaigns of 250 rows against reading their CSV files; 10,000: `python tests/study/fleet_index.py`."""

from __future__ import annotations

from pathlib import Path

from study.fleet_index import STEPS, measured, write_fleet
from support.bench import Record, row

CAMPAIGNS = 1000


def test_index_and_query(record_property: Record, tmp_path: Path) -> None:
    root = tmp_path / "fleet"
    write_fleet(root, CAMPAIGNS, 200)
    names = {"root": root, "index": root / "fleet-index", "json": tmp_path / "trend.json", "processes": 1}
    found = {}
    for name, step in STEPS.items():
        found[name] = measured([word.format(**names) if "{" in word else word for word in step])
    read_s = found["reading the CSV files: the same mean"][1]
    for name, (_, processor_s, memory_mb) in list(found.items())[:-1]:
        what = f"{CAMPAIGNS:,} campaigns, 250,000 rows: {name}"
        row(record_property, what, processor_s, read_s, "s", beside="reading the CSV files")
        print(f"largest process {memory_mb:.0f} MB")
    assert found["index"][2] < 500.0
    assert found["DuckDB: mean error by axis over all rows"][1] < read_s
