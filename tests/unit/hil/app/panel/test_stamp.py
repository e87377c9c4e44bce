"""The stamp of the page Calibrate: the decision on A ± U against the limit, who verified it when, and what is in force."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from support.bench_axis import lay_out
from support.campaigns import campaign
from support.screen import Screen, inside

from hil.axis.axis_file import AxisConfig, load_axis
from hil.calibration import page
from hil.desk.desk import Desk
from hil.desk.event_log import LogKind
from hil.records.rows import to_csv
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import Button

UNCERTAIN = "\n[uncertainty]\ndevice_um = 0.1\ndevice_um_per_m = 0.5\nvariation_um = 0.4\n"
BEGUN = "2026-04-11T08:00:00+00:00"
A_UM = 4.0
"""Of rows that are 2 µm too far on the way up and 2 µm short on the way down, all alike: by ISO 230-2 A = 4 µm, R+ = R− = 0."""
STAMPED = ("pass", "fail", "undecided")


def lay_out_verified(directory: Path, limit_um: float | None, *, uncertain: bool = True) -> AxisConfig:
    """An axis that was verified, and no more."""
    correction = "" if limit_um is None else f"accuracy_limit_um = {limit_um}"
    path = lay_out(directory, correction=correction)
    path.write_text(path.read_text(encoding="utf-8") + (UNCERTAIN if uncertain else ""), encoding="utf-8")
    axis = load_axis(path)
    keeps(axis, "verify", BEGUN)
    return axis


def keeps(axis: AxisConfig, kind: str, begun: str) -> None:
    here = axis.store.directory / f"{kind}-001"
    here.mkdir(parents=True)
    (here / "campaign.json").write_text(json.dumps({"kind": kind, "axis": "X"}))
    rows = campaign(lambda c: 2.0 * c["direction"], noise_um=0.0, scatter=0.0, runs=5, targets=6)
    for name in ("measure", "round-1") if kind == "calibrate" else (kind,):
        (here / f"{name}.csv").write_text(f"# begun {begun}\n{to_csv(rows)}")
    (here / "finished").touch()


def seen(desk: Desk, language: str = "en") -> dict[str, str]:
    """What the card of the accuracy says; a stamp that is hidden is ""."""
    found = {}

    async def work() -> None:
        screen = Screen(desk, page.draw, language)
        for _ in range(2):
            await screen.refreshes()
        for name in ("verified", "stamp", "decision", "stamped"):
            element = screen.named(f"calibrate.{name}")
            found[name] = element.text if element.visible else ""
        found["look"] = " ".join(screen.named("calibrate.stamp").classes)

    inside(work)
    return found


@pytest.mark.parametrize(("limit_um", "outcome"), [(1000.0, "pass"), (0.5, "fail"), (A_UM, "undecided")])
def test_the_stamp_is_the_decision_on_a_and_its_uncertainty(tmp_path: Path, limit_um: float, outcome: str) -> None:
    """ISO 14253-1: passed where A + U is within the limit, failed where A − U is beyond it, else nothing is proven."""
    t = Texts("de")
    found = seen(Desk(lay_out_verified(tmp_path, limit_um)), "de")
    assert found["stamp"] == t(f"calibrate.stamp.{outcome}")
    assert [one for one in STAMPED if one in found["look"].split()] == [outcome]
    assert found["verified"].startswith(f"{t.number(A_UM, 2)} ± ")
    assert t.number(limit_um, 2) in found["decision"]


@pytest.mark.parametrize(
    ("kinds", "limit_um", "main"),
    [
        ((), 8.0, "calibrate.start"),
        (("calibrate",), 8.0, "calibrate.verify"),
        (("calibrate", "verify"), 1000.0, "calibrate.next.reports"),
        (("calibrate", "verify"), 0.5, "calibrate.next.diagnosis"),
        (("verify", "calibrate"), 1000.0, "calibrate.verify"),
    ],
)
def test_the_main_button_is_the_next_step(kinds: tuple[str, ...], limit_um: float, main: str, tmp_path: Path) -> None:
    path = lay_out(tmp_path, correction=f"accuracy_limit_um = {limit_um}")
    path.write_text(path.read_text(encoding="utf-8") + UNCERTAIN, encoding="utf-8")
    axis = load_axis(path)
    for day, kind in enumerate(kinds, start=10):
        keeps(axis, kind, f"2026-04-{day}T08:00:00+00:00")

    async def work() -> None:
        screen = Screen(Desk(axis), page.draw)
        for _ in range(2):
            await screen.refreshes()
        shown = [one for one in screen.all(Button) if one.visible and "hil-go" in one.classes]
        assert [one.props["data-name"] for one in shown if one.props["data-name"].startswith("calibrate.")] == [main]

    inside(work)


def test_without_limit_or_figure_there_is_no_stamp(tmp_path: Path) -> None:
    found = seen(Desk(lay_out_verified(tmp_path / "no-limit", None)))
    assert (found["stamp"], found["verified"][:7]) == ("", "4.00 ± ")
    assert "no limit given" in found["decision"]
    axis = lay_out_verified(tmp_path / "no-figure", 8.0)
    rows = campaign(lambda c: 2.0 * c["direction"], runs=1, targets=6)  # each target on one way only: no A
    (axis.store.directory / "verify-001" / "verify.csv").write_text(f"# begun {BEGUN}\n{to_csv(rows)}")
    found = seen(Desk(axis))
    assert (found["stamp"], found["verified"]) == ("", "–")
    assert found["decision"].startswith("these rows give no A: ")


def test_without_an_uncertainty_nothing_is_proven(tmp_path: Path) -> None:
    found = seen(Desk(lay_out_verified(tmp_path, 1000.0, uncertain=False)))
    assert (found["stamp"], found["verified"]) == ("NOT PROVEN", "4.00")
    assert "the uncertainty U is not known" in found["decision"]


def test_a_calibration_after_it_takes_the_stamp_away(tmp_path: Path) -> None:
    axis = lay_out_verified(tmp_path, 1000.0)
    keeps(axis, "calibrate", "2026-04-12T08:00:00+00:00")
    found = seen(Desk(axis))
    assert (found["stamp"], found["verified"]) == ("", "–")
    assert "verify again" in found["decision"]


def test_it_says_when_from_where_and_what_is_in_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.calibration.page_data.bound_tables", lambda _axis: None)  # of a file that is not read here
    axis = lay_out_verified(tmp_path, 1000.0)
    desk = Desk(axis)
    date = datetime.fromisoformat(BEGUN).astimezone().strftime("%Y-%m-%d %H:%M")
    assert seen(desk)["stamped"].startswith("verified ")
    assert seen(desk)["stamped"].endswith("No tables stored")
    axis.tables_path.parent.mkdir(parents=True, exist_ok=True)
    axis.tables_path.write_bytes(b"sealed")
    written = datetime(2026, 4, 10, 12, 0, tzinfo=UTC)
    os.utime(axis.tables_path, (written.timestamp(), written.timestamp()))
    desk.events.add(LogKind.JOB, "done", who="Browser 7", job="verify")
    of = written.astimezone().strftime("%Y-%m-%d %H:%M")
    assert seen(desk)["stamped"] == f"verified {date} from Browser 7 · Tables of {of} in force"
    desk.events.add(LogKind.JOB, "done", who="Browser 8", job="calibrate")
    assert "Browser 8" not in seen(Desk(axis))["stamped"]  # also after a restart, by the log on disk


def test_a_mean_that_has_moved_stands_beside_the_decision(tmp_path: Path) -> None:
    """Corrected rows 2 µm either way have their mean at zero; 3 µm further it is said, with its number."""
    t = Texts("de")
    axis = lay_out_verified(tmp_path, 1000.0)
    rows = campaign(lambda c: 2.0 * c["direction"], noise_um=0.0, scatter=0.0, runs=5, targets=6)
    path = axis.store.directory / "verify-001/verify.csv"
    for aside_um, said in ((0.0, False), (3.0, True)):
        there = rows.with_column("measured_mm", rows["measured_mm"] + aside_um / 1000.0)
        path.write_text(f"# begun {BEGUN}\n{to_csv(there)}")
        found = seen(Desk(load_axis(axis.path)), "de")
        moved = t("calibrate.decided.moved", mean=t.number(3.0, 2, sign=True), spread=t.number(0.0, 2))
        assert (moved in found["decision"]) == said, found["decision"]
