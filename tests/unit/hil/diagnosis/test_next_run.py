"""What can be asked for on a machine: by itself, of a person, and what a change of the optics brings with it."""

from __future__ import annotations

import pytest

from drivers.errors import CapabilityError
from hil.diagnosis.loop import command as close_loop
from hil.diagnosis.next.feasible import feasible_runs
from hil.diagnosis.next.planned_run import Means
from hil.machine.conditions import AskedConditions


def test_a_person_can_be_asked_for_the_axis_files_levels_and_for_the_optics() -> None:
    asked: list[tuple[str, float]] = []
    conditions = AskedConditions({"load_kg": (0.0, 80.0)}, lambda name, value: asked.append((name, value)))
    conditions.set("load_kg", 80.0)
    conditions.set("abbe_offset_mm", 150.0)
    conditions.set("abbe_offset_mm", 150.0)
    assert asked == [("load_kg", 80.0), ("abbe_offset_mm", 150.0)]
    assert conditions.read() == {"load_kg": 80.0, "abbe_offset_mm": 150.0}
    with pytest.raises(CapabilityError):
        conditions.set("pos_y_mm", 1.0)


def test_nobody_is_asked_without_a_terminal_and_a_no_is_a_no(monkeypatch: pytest.MonkeyPatch) -> None:
    assert close_loop._consent(None) is None, "a test has no terminal"
    assert close_loop._consent("none") is None
    consent = close_loop._consent("ask")
    assert consent is not None
    run = next(plan for plan in feasible_runs(Means(0.0, 400.0)) if plan.person)
    said = iter(["y", "no", ""])
    monkeypatch.setattr("builtins.input", lambda _: next(said))
    assert [consent(run) for _ in range(3)] == [True, False, False]
