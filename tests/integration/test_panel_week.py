"""Some hours of what an axis tells its screen, compressed; a week: `python tests/study/panel_week.py`."""

from __future__ import annotations

from pathlib import Path

import pytest
from study.panel_week import RATE_HZ, run

pytestmark = pytest.mark.outside


def test_hours_of_states_and_events_are_accounted_for(tmp_path: Path) -> None:
    found = run(0.1, 1, tmp_path, restart_every_s=2000.0)
    assert found.good, found
    assert found.points == 0.1 * 86_400 * RATE_HZ
    assert found.events == 720
    assert found.largest_standing >= 1
    assert found.memory_mb[-1] - found.memory_mb[1] < 5.0
