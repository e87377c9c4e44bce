"""One set of records gives one verdict, whichever way it comes to the diagnosis: command, model, screen, loop, fleet, demo."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.calibration.explore import Exploration, explore, plan_runs
from hil.desk.worker_process import Passes
from hil.diagnosis.job import diagnose_campaign
from hil.diagnosis.loop.procedure import Turning, decide
from hil.fleet.causes import Task, diagnose_task
from hil.machine.events import silent
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.records.rows import to_csv

pytestmark = pytest.mark.outside

Verdict = list[tuple[str, frozenset[str]]]


def verdict(form: dict[str, Any]) -> tuple[Verdict, bool, list[list[str]]]:
    """Each finding with its rivals, whether something is unexplained, and what carries it."""
    found = [(f["effect"], frozenset(r["effect"] for r in f["rivals"])) for f in form["findings"]]
    return found, form["unexplained"], [one["columns"] for one in form["carried_by"]]


def confidences(form: dict[str, Any]) -> list[float]:
    return [f["confidence"] for f in form["findings"]]


def said_by_command(folder: Path, *arguments: str) -> dict[str, Any]:
    out = folder / "said.json"
    main(["diagnose", *arguments, "--json", str(out)])
    form = json.loads(out.read_text())
    assert isinstance(form, dict)
    return form


def test_all_ways_to_a_diagnosis_say_the_same_of_the_same_rows(tmp_path: Path) -> None:
    text = files("hil.examples").joinpath("demo_axis.toml").read_text(encoding="utf-8")
    (tmp_path / "axis.toml").write_text(text)
    axis = load_axis(tmp_path / "axis.toml")
    with connected(axis) as machine:
        campaign = Campaign.numbered(axis.store.directory, axis.purpose("demo"), resume=False)
        session = machine.session
        session.prepare(campaign.directory)
        exploration = Exploration(runs=11, rows=10, warm_up_s=20.0)
        before = explore(session, campaign, "before", plan_runs(session, exploration, 1))
        follow, rows, further = decide(session, campaign, before, Turning(exploration, most_further=0), silent)
    assert not further
    assert len(rows) == len(before)
    loop = follow.to_json()
    assert {"torque_percent", "motor_mm"} <= set(before.columns), "readings that a loop cannot put into force"
    assert loop["findings"], "rows that say nothing show nothing of the ways either"

    passes = list(campaign.directory.glob("before-*.csv"))
    by_name = sorted(passes)  # a shell's order: the tenth before the second
    assert [path.stem for path in by_name[:3]] == ["before-1", "before-10", "before-11"]
    command = said_by_command(tmp_path, *map(str, by_name))
    assert verdict(command) == verdict(loop)
    assert confidences(command) == pytest.approx(confidences(loop), abs=1e-9)

    (stored,) = diagnose_campaign(axis, [Passes("before", tuple(by_name))])
    screen = json.loads(Path(stored).read_text())
    assert verdict(screen) == verdict(loop)
    assert confidences(screen) == pytest.approx(confidences(loop), abs=1e-9)

    joined = tmp_path / "joined.csv"
    joined.write_text(to_csv(before), encoding="utf-8")
    fleet = diagnose_task(Task("axis", "campaign", "joined", datetime.now(UTC), joined, "kept.json"))
    assert verdict(fleet) == verdict(loop)
    assert confidences(fleet) == pytest.approx(confidences(loop), abs=1e-9)

    model = tmp_path / "model.json"
    assert main(["fit", *map(str, by_name), "--out", str(model)]) == 0
    with_model = said_by_command(tmp_path, *map(str, by_name), "--model", str(model))
    assert verdict(with_model) == verdict(loop)
    assert confidences(with_model) == pytest.approx(confidences(loop), abs=1e-9)


def test_the_demo_measures_what_it_gains_and_says_what_the_command_says_of_its_files(tmp_path: Path) -> None:
    out, result = tmp_path / "demo", tmp_path / "demo.json"
    assert main(["demo", "--out", str(out), "--json", str(result)]) == 0
    figures = json.loads(result.read_text())
    stages, demo = figures["stages"], figures["diagnosis"]
    assert stages["extended, explored"]["rms_um"] < 0.2 * stages["table, explored"]["rms_um"]
    assert (out / "report.html").stat().st_size > 100_000
    assert main(["demo", "--out", str(tmp_path)]) == 2, "a directory that no demo made is left alone"
    passes = [str(path) for path in sorted(out.glob("campaign/*/before-*.csv"))]
    assert len(passes) == 4
    command = said_by_command(tmp_path, *passes)
    assert verdict(command) == verdict(demo)
    assert confidences(command) == pytest.approx(confidences(demo), abs=1e-9)
    assert [name for name, _ in verdict(demo)[0]] == ["thermal_expansion", "cyclic", "lost_motion"]
