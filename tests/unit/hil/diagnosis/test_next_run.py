"""What can be asked for on a machine: by itself, of a person, and what a change of the optics brings with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.bench_axis import PASSWORDS, lay_out

from drivers.errors import CapabilityError, InputError
from hil.app.main import main
from hil.diagnosis.loop.procedure import Turning
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


def test_nobody_is_asked_without_a_terminal_and_a_no_is_a_no(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in PASSWORDS.items():
        monkeypatch.setenv(name, value)
    path, loops = lay_out(tmp_path), list[Turning]()

    def looped(_machine: object, _store: object, turning: Turning, *_: object, **__: object) -> None:
        loops.append(turning)
        raise InputError("far enough")

    monkeypatch.setattr("hil.diagnosis.loop.command.run_loop", looped)
    for person in ([], ["--person", "none"], ["--person", "ask"]):
        assert main(["close-loop", str(path), *person]) == 2
    assert [one.consent is None for one in loops] == [True, True, False]
    run = next(plan for plan in feasible_runs(Means(0.0, 400.0)) if plan.person)
    said, consent = iter(["y", "no", ""]), loops[-1].consent
    assert consent is not None
    monkeypatch.setattr("builtins.input", lambda _: next(said))
    assert [consent(run) for _ in range(3)] == [True, False, False]
