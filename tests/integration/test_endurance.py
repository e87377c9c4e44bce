"""Streaming with faults and reconnects, in simulated time: ten minutes here, a day by `python tests/study/endurance.py`."""

from __future__ import annotations

from pathlib import Path

import pytest
from study.endurance import Account, run

from drivers.canopen.stream import CyclicStream


@pytest.mark.outside
def test_ten_minutes_with_faults_are_accounted_for(tmp_path: Path) -> None:
    found = run(1 / 6, 1, tmp_path, 600.0)
    assert found.good, found
    assert found.faults >= 3
    assert found.reconnects >= 1
    assert found.late >= 1
    assert found.cycles > 10_000
    assert found.journaled == found.read_back > 500


def test_a_set_point_that_is_not_the_command_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = CyclicStream.cycle
    monkeypatch.setattr(CyclicStream, "cycle", lambda self, values: real(self, [values[0] + 0.0002]))
    found = run(1 / 60, 1, tmp_path, 60.0)
    assert found.unlike > 1000
    assert found.rows_unlike == found.journaled > 0
    assert not found.good


def test_an_account_that_does_not_add_up_is_not_good() -> None:
    assert Account(cycles=3, fresh=2, late=1).good
    assert not Account(cycles=3, fresh=2).good
    assert not Account(cycles=2, fresh=2, missing_feedback=1).good
    assert not Account(cycles=2, fresh=2, journaled=1).good
    assert not Account(cycles=2, fresh=2, spare_feedback=1).good
    assert Account(memory_mb=[50.0, 60.0, 61.0, 62.0]).growth_mb_per_h() == pytest.approx(1.0)
