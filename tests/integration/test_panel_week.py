"""Some hours of what an axis tells its screen, compressed; a week: `python tests/study/panel_week.py`."""

from __future__ import annotations

from pathlib import Path

import pytest
from study.panel_week import RATE_HZ, Board, EventLog, run

pytestmark = pytest.mark.outside


def test_hours_of_states_and_events_are_accounted_for(tmp_path: Path) -> None:
    found = run(0.1, 1, tmp_path, restart_every_s=2000.0)
    assert found.good, found
    assert found.points == 0.1 * 86_400 * RATE_HZ
    assert found.events == 720
    assert found.largest_standing >= 1
    assert found.memory_mb[-1] - found.memory_mb[1] < 5.0


def test_a_point_or_an_alarm_that_is_lost_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trace, alarms = Board.trace, EventLog.alarms
    monkeypatch.setattr(Board, "trace", lambda self, since=0: trace(self, since + (since == 1000)))
    assert run(0.01, 1, tmp_path, restart_every_s=1e9).out_of_order == 1
    monkeypatch.undo()
    seen: list[EventLog] = []

    def forgetful(self: EventLog) -> tuple[object, ...]:
        seen.append(self)
        return alarms(self) if self is seen[0] else ()

    monkeypatch.setattr(EventLog, "alarms", forgetful)
    assert run(0.05, 1, tmp_path / "again", restart_every_s=4000.0).alarms_lost > 0
