"""Work over processes and over Dask's workers: everything is done once, also where a worker is killed half-way."""

from __future__ import annotations

import os
import signal
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import LocalCluster
from support.fleet import killed_always, killed_once, rows, worked, write_campaign

from drivers.errors import InputError, StateError
from hil.fleet import executor, index
from hil.fleet.executor import completed


@pytest.mark.outside
def test_local_processes() -> None:
    found = dict(completed(worked, range(20), processes=2))
    assert {number: square for number, (square, _) in found.items()} == {number: number**2 for number in range(20)}
    assert os.getpid() not in {process for _, process in found.values()}
    assert list(completed(worked, [], processes=2)) == []


@pytest.mark.outside
def test_a_killed_process_loses_no_task(tmp_path: Path) -> None:
    marks = [str(tmp_path / name) for name in "abc"]
    Path(marks[0]).write_text("")
    Path(marks[2]).write_text("")
    assert dict(completed(killed_once, marks, processes=2)) == dict.fromkeys(marks, "done")
    with pytest.raises(StateError, match="died 3 times"):
        list(completed(killed_always, [1], processes=1))


@pytest.fixture(scope="module")
def cluster() -> Any:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as found:
        yield found


@pytest.mark.outside
def test_dask_workers_one_of_which_is_killed_half_way(cluster: Any) -> None:
    results: dict[int, tuple[int, int]] = {}
    killed = 0
    for number, result in completed(worked, range(200), scheduler=cluster.scheduler_address):
        assert number not in results
        results[number] = result
        if len(results) == 60:
            killed = result[1]
            os.kill(killed, signal.SIGKILL)
    assert {number: square for number, (square, _) in results.items()} == {number: number**2 for number in range(200)}
    processes = {process for _, process in results.values()}
    assert killed in processes
    assert len(processes) >= 2


@pytest.mark.outside
def test_an_index_made_by_dask_workers_one_of_which_is_killed_is_that_of_this_computer(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(1)
    for number in range(60):
        place = tmp_path / "fleet" / f"A{number % 4}-campaign" / f"verify-{number:03d}"
        text = rows(rng, 10.0, targets=4, runs=2)
        write_campaign(place, f"A{number % 4}", datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=number), text)
    monkeypatch.setattr(index, "BATCH", 3)
    killed = []

    def kill_one(done: int, _all: int) -> None:
        if done >= 15 and not killed:
            killed.append(cluster.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    there = index.update(tmp_path / "fleet", tmp_path / "there", scheduler=cluster.scheduler_address, progress=kill_one)
    here = index.update(tmp_path / "fleet", tmp_path / "here", processes=1)
    assert killed
    assert there == here
    for name in ("campaigns", "results", "rows"):
        both = [index.read_table(tmp_path / place, name).to_pylist() for place in ("there", "here")]
        assert sorted(both[0], key=str) == sorted(both[1], key=str)


def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executor, "CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.1:1", "nonsense://", ""):
        with pytest.raises(InputError):
            list(completed(worked, [1], scheduler=address))
