"""The index follows the campaigns: what is unchanged is not read again, what cannot be read is said, a kill loses nothing."""

from __future__ import annotations

import json
import os
import re
import shutil
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pytest
from support.fleet import HEADER, rows, write_campaign

from drivers.errors import InputError
from hil.fleet import index as the_index
from hil.fleet import read
from hil.fleet.index import STATE, Updated, read_table, state_of, update
from hil.records.files import held
from hil.records.rows import read_csv

BEGUN = datetime(2026, 1, 5, 8, tzinfo=UTC)


def fleet(root: Path, axes: int = 3, weeks: int = 2) -> Path:
    rng = np.random.default_rng(1)
    for axis in range(axes):
        for week in range(weeks):
            write_campaign(
                root / f"A{axis}-campaign" / f"verify-{week + 1:03d}",
                f"A{axis}",
                BEGUN + timedelta(weeks=week),
                rows(rng, 10.0, targets=4, runs=2),
            )
    return root


@pytest.fixture(autouse=True)
def _here(monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process: the executors have their own test."""
    monkeypatch.setattr(the_index, "completed", lambda work, tasks, **_: ((task, work(task)) for task in tasks))


def made(root: Path, **how: bool) -> Updated:
    return update(root, root / "fleet-index", **how)


def counts(found: Updated) -> tuple[int, int, int, int]:
    return found.found, found.read, found.kept, found.gone


def campaigns(root: Path) -> list[str]:
    return sorted(read_table(root / "fleet-index", "campaigns", ("campaign",))["campaign"].to_pylist())


def test_rows_and_results_are_those_of_the_campaigns(tmp_path: Path) -> None:
    root = fleet(tmp_path)
    found = made(root)
    assert counts(found) == (6, 6, 0, 0)
    assert found.rows == 6 * 16
    state = state_of(root / "fleet-index")
    assert (state.complete, state.of) == (True, str(root))
    table = read_table(root / "fleet-index", "rows")
    own = read_csv(root / "A1-campaign" / "verify-002" / "verify.csv")
    here = [one for one in table.to_pylist() if one["campaign"] == "A1-campaign/verify-002"]
    for name in own.columns:
        assert [one[name] for one in here] == own[name].tolist()
    assert {(one["axis"], one["pass"], one["begun"]) for one in here} == {("A1", "verify", BEGUN + timedelta(weeks=1))}
    backlash = [
        one for one in read_table(root / "fleet-index", "results").to_pylist() if one["quantity"] == "backlash_um"
    ]
    assert len(backlash) == 6
    assert all(abs(one["value"] - 10.0) < 1.5 for one in backlash)


def test_duckdb_reads_it(tmp_path: Path) -> None:
    """A foreign reader, with the query of the page."""
    made(fleet(tmp_path))
    page = re.search(
        r"^rows = .*?^print\(duckdb\.sql\(f(.*?)\)\)$", (files("hil") / "docs/fleet.md").read_text(), re.M | re.S
    )
    assert page is not None
    place = f"{tmp_path}/fleet-index/part-*/rows.parquet"
    query = page[1].strip('"').replace("{rows}", place) + " ORDER BY axis"
    found = duckdb.sql(query).fetchall()
    assert [(axis, count) for axis, count, _ in found] == [("A0", 32), ("A1", 32), ("A2", 32)]
    own = np.concatenate([read_csv(path).uncorrected_error_um for path in sorted(tmp_path.glob("A0*/*/verify.csv"))])
    assert 1000.0 * found[0][2] == pytest.approx(float(own.mean()))


def test_what_is_unchanged_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = fleet(tmp_path)
    made(root)
    asked: list[str] = []
    real = read.read_campaign
    monkeypatch.setattr(read, "read_campaign", lambda path: asked.append(path.name) or real(path))
    assert counts(made(root)) == (6, 0, 6, 0)
    assert not asked
    write_campaign(
        root / "A9-campaign" / "verify-001", "A9", BEGUN, rows(np.random.default_rng(2), 5.0, targets=4, runs=2)
    )
    path = root / "A0-campaign" / "verify-001" / "verify.csv"
    path.write_text(path.read_text() + "# a note\n")
    shutil.rmtree(root / "A2-campaign" / "verify-002")
    found = made(root)
    assert counts(found) == (6, 2, 4, 1)
    assert len(asked) == 2
    assert campaigns(root) == sorted(set(campaigns(root)))
    assert len(read_table(root / "fleet-index", "rows")) == found.rows
    assert ("A0-campaign/verify-001", "verify.csv was changed since it was closed") not in found.unread  # it only grew
    assert counts(made(root, again=True)) == (6, 6, 0, 0)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda d: (d / "campaign.json").write_text("{"), "campaign.json"),
        (lambda d: (d / "campaign.json").write_text("[" * 5000), ""),
        (lambda d: (d / "campaign.json").write_text('{"axis": "\\ud800", "kind": "verify"}'), None),
        (lambda d: (d / "verify.csv").write_text(f"{HEADER}\n1,+1,0,0,zero,0,20,20\n"), "measured_mm is 'zero'"),
        (
            lambda d: (d / "verify.csv").write_text((d / "verify.csv").read_text().replace("+1", "-1", 1)),
            "was changed since",
        ),
        (lambda d: (d / "verify.csv").write_bytes(b"\xff\xfe\x00"), "verify.csv ends with an incomplete line"),
        (lambda d: (d / "verify.csv").write_text("run,direction\n1,1\n"), "lacks target_mm"),
        (lambda d: (d / "result.json").write_text("{}"), "result.json holds no lost motion"),
        (lambda d: os.truncate(d / "verify.csv", 10**9), "1000 MB, expected at most 200"),
        (
            lambda d: (d / "wide.csv").write_text(
                f"{HEADER},{','.join(f'c{k}' for k in range(300))}\n1,+1,0,0,0,0,20,20{',1' * 300}\n"
            ),
            "308 columns, expected at most 200",
        ),
    ],
)
def test_what_cannot_be_read_is_listed_with_its_reason(tmp_path: Path, spoil: object, said: str | None) -> None:
    root = fleet(tmp_path, axes=2, weeks=1)
    assert callable(spoil)
    spoil(root / "A0-campaign" / "verify-001")
    found = made(root)
    assert len(campaigns(root)) == 2
    if said is None:
        assert not found.unread
        return
    ((where, why),) = found.unread
    assert where == "A0-campaign/verify-001"
    assert said in why
    assert "\n" not in why
    assert made(root).unread == found.unread  # also where it is not read again
    assert any(one["campaign"].startswith("A1") for one in read_table(root / "fleet-index", "results").to_pylist())


def test_a_program_error_in_one_campaign_is_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise LookupError("nobody\nforesaw this")

    monkeypatch.setattr(read, "of_pass", broken)
    found = made(fleet(tmp_path, axes=1, weeks=1))
    assert found.unread == (("A0-campaign/verify-001", "LookupError: nobody foresaw this"),)
    assert found.rows == 0


@pytest.mark.skipif(os.geteuid() == 0, reason="root may look into every directory")
def test_a_closed_directory_is_listed(tmp_path: Path) -> None:
    root = fleet(tmp_path, axes=2, weeks=1)
    (root / "A0-campaign").chmod(0)
    try:
        assert made(root).unread == (("A0-campaign", "cannot be read: Permission denied"),)
    finally:
        (root / "A0-campaign").chmod(0o755)


@pytest.mark.parametrize("parts_until_killed", [0, 1, 2])
def test_a_killed_run_leaves_whole_parts_and_the_next_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parts_until_killed: int
) -> None:
    root = fleet(tmp_path)
    monkeypatch.setattr(the_index, "BATCH", 2)
    real, done = Path.rename, []

    def killed(path: Path, target: Path) -> Path:
        if path.name.startswith(".new-"):
            if len(done) == parts_until_killed:
                raise KeyboardInterrupt
            done.append(path)
        return real(path, target)

    monkeypatch.setattr(Path, "rename", killed)
    with pytest.raises(KeyboardInterrupt):
        made(root)
    monkeypatch.setattr(Path, "rename", real)
    assert not state_of(root / "fleet-index").complete
    assert len(campaigns(root)) == 2 * parts_until_killed
    found = made(root)
    assert counts(found) == (6, 6 - 2 * parts_until_killed, 2 * parts_until_killed, 0)
    assert state_of(root / "fleet-index").complete
    assert len(set(campaigns(root))) == len(campaigns(root)) == 6
    assert not list((root / "fleet-index").glob(".*"))


def test_a_kill_while_a_part_is_changed_never_shows_a_campaign_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = fleet(tmp_path)
    made(root)
    shutil.rmtree(root / "A0-campaign" / "verify-001")
    real = Path.rename

    def killed(path: Path, target: Path) -> Path:
        if path.name.startswith(".new-"):
            raise KeyboardInterrupt
        return real(path, target)

    monkeypatch.setattr(Path, "rename", killed)
    with pytest.raises(KeyboardInterrupt):
        made(root)
    monkeypatch.setattr(Path, "rename", real)
    assert campaigns(root) == []
    assert counts(made(root)) == (5, 5, 0, 0)
    assert len(campaigns(root)) == 5


def test_a_damaged_part_is_read_again(tmp_path: Path) -> None:
    root = fleet(tmp_path)
    made(root)
    (root / "fleet-index" / "part-000001" / "rows.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"rows\.parquet"):
        read_table(root / "fleet-index", "rows")
    assert counts(made(root)) == (6, 6, 0, 0)
    assert len(read_table(root / "fleet-index", "rows")) == 96


def test_small_parts_are_joined(tmp_path: Path) -> None:
    root = fleet(tmp_path, axes=1, weeks=1)
    for week in range(1, 10):
        made(root)
        text = rows(np.random.default_rng(week), 10.0, targets=4, runs=2)
        write_campaign(root / "A0-campaign" / f"verify-{week + 1:03d}", "A0", BEGUN + timedelta(weeks=week), text)
    found = made(root)
    assert len(list((root / "fleet-index").glob("part-*"))) < the_index.MOST_SMALL
    assert len(set(campaigns(root))) == 10
    assert len(read_table(root / "fleet-index", "rows")) == found.rows == 160


def test_only_an_index_is_written_over_and_by_one_at_a_time(tmp_path: Path) -> None:
    root = fleet(tmp_path / "fleet", axes=1, weeks=1)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "part-000001").write_text("mine")
    with pytest.raises(InputError, match=STATE):
        update(root, tmp_path / "mine")
    assert (tmp_path / "mine" / "part-000001").read_text() == "mine"
    with pytest.raises(InputError, match="is no directory"):
        made(tmp_path / "nowhere")
    made(root)
    with held(root / "fleet-index"), pytest.raises(InputError, match="in use"):
        made(root)
    with pytest.raises(InputError, match="hil fleet index"):
        state_of(tmp_path / "mine")
    (root / "fleet-index" / STATE).write_text(json.dumps({"format": 0, "of": "", "complete": True, "unread": []}))
    with pytest.raises(InputError, match="format 0"):
        state_of(root / "fleet-index")


def test_columns_that_few_campaigns_have_are_null_elsewhere(tmp_path: Path) -> None:
    root = fleet(tmp_path / "k=v", axes=1, weeks=1)
    text = "1,+1,0,0.001,3\n1,-1,0,0.002,\n"
    header = "run,direction,target_mm,measured_mm,coolant"
    write_campaign(root / "B" / "verify-001", "B", BEGUN, text, header=header)
    made(root)
    table = read_table(root / "fleet-index", "rows")
    assert "k" not in table.column_names
    assert table.filter(pa.compute.is_valid(table["coolant"]))["coolant"].to_pylist() == [3.0]
