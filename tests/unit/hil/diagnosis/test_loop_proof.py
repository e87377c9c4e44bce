"""A correction that the axis measured worse with than before does not stay in force."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.diagnosis.loop import procedure
from hil.diagnosis.loop.procedure import Turning, turn_loop
from hil.machine.events import Event
from hil.records.rows import Records

OLD: Any = SimpleNamespace(name="old")
EXTENDED: Any = SimpleNamespace(name="extended")


def rows_of(rms_um: float) -> Records:
    target = np.linspace(0.0, 300.0, 40)
    error_um = rms_um * np.tile([1.0, -1.0], 20)
    measured = target + error_um / 1000.0
    return Records.of({"run": np.ones(40), "direction": np.ones(40), "target_mm": target, "measured_mm": measured})


@pytest.mark.parametrize(
    ("before_um", "after_um", "stays"),
    [
        (7.7, 11.1, False),  # what an axis without a thermometer once did
        (7.7, 3.0, True),
        (0.30, 0.35, True),  # within twice the noise
    ],
)
def test_the_better_of_both_is_in_force_at_the_end(
    monkeypatch: pytest.MonkeyPatch, before_um: float, after_um: float, stays: bool
) -> None:
    session: Any = SimpleNamespace(compensation=OLD)
    diagnosis = SimpleNamespace(recommended=True, extended=None, noise=SimpleNamespace(within_run_um=0.2))
    explored = iter([rows_of(before_um), rows_of(after_um)])
    in_force: list[Any] = []

    def explore(*_: object) -> Records:
        in_force.append(session.compensation)
        return next(explored)

    monkeypatch.setattr(procedure, "explore", explore)
    monkeypatch.setattr(procedure, "decide", lambda *_: (SimpleNamespace(diagnosis=diagnosis), rows_of(before_um), ()))
    monkeypatch.setattr(procedure, "correction_of", lambda *_, **__: diagnosis)
    monkeypatch.setattr(procedure, "bounded", lambda *_: EXTENDED)
    stored: list[Any] = []
    told: list[Event] = []
    tables: Any = None
    campaign: Any = None
    turn = turn_loop(session, campaign, tables, stored.append, told.append, turning=Turning(plan=[SimpleNamespace()]))  # type: ignore[list-item]
    assert in_force == [OLD, EXTENDED]
    assert session.compensation is (EXTENDED if stays else OLD)
    assert turn.extended is session.compensation
    assert stored == ([EXTENDED] if stays else [EXTENDED, OLD])  # the last one stored is the one in force
    assert turn.withdrawn is not stays
    assert any(event.warning for event in told) is not stays
