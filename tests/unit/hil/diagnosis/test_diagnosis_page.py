"""The page of the diagnosis, drawn without a browser: a choice of the campaign holds; only figures that mean something are shown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.bench_axis import lay_out
from support.campaigns import campaign, wavy
from support.screen import Screen, inside

from hil.axis.axis_file import load_axis
from hil.desk.desk import Desk
from hil.diagnosis import page as diagnosis
from hil.diagnosis.page_data import diagnosis_screen
from hil.records.rows import to_csv

CAMPAIGNS = 4


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    """Of an axis with campaigns, of which only the second is diagnosed."""
    axis = load_axis(lay_out(tmp_path))
    for number in range(1, CAMPAIGNS + 1):
        here = axis.store.directory / f"verify-{number:03d}"
        here.mkdir(parents=True)
        (here / "campaign.json").write_text(json.dumps({"kind": "verify", "axis": "X"}))
        (here / "finished").touch()
        rows = campaign(wavy, runs=2, targets=6, scatter=0.0, seed=number)
        (here / "verify.csv").write_text(f"# begun 2026-0{number}-11T08:00:00+00:00\n{to_csv(rows)}")
    return Desk(axis)


def test_every_choice_of_a_campaign_holds(desk: Desk) -> None:
    """Whenever it is made: before, while and after the folder is read."""

    async def work() -> None:
        screen = Screen(desk, diagnosis.draw)
        await screen.refreshes()
        await screen.refreshes()
        select = screen.named("diagnosis.campaign")
        assert len(select.options) == CAMPAIGNS
        refresh = screen.quick_timers()
        for key in [*select.options, *reversed(list(select.options))]:
            select.set_value(key)
            refresh()  # the page's own refresh comes before the folder is read again
            assert select.value == key
            await screen.refreshes()
            await screen.refreshes()
            assert select.value == key

    inside(work)


def diagnosed(desk: Desk, how: str | None) -> dict[str, Any]:
    """The stored diagnosis of the second campaign, with large held-out figures."""
    form = {
        "findings": [],
        "drawn": {},
        "unexplained": False,
        "before": {"rms_um": 49.07, "peak_um": 304.0},
        "after": {"rms_um": 49.07, "peak_um": 304.0},
        "held_out": {"how": how, "rows": 24},
    }
    (desk.axis.store.directory / "verify-002" / "verify.diagnosis.json").write_text(json.dumps(form))
    return form


@pytest.mark.parametrize(
    ("how", "meant"), [("leave-one-quarter-out", False), (None, False), ("leave-one-run-out", True)]
)
def test_figures_of_records_that_cannot_be_held_out_are_not_shown(how: str | None, meant: bool, desk: Desk) -> None:
    diagnosed(desk, how)

    async def work() -> None:
        screen = Screen(desk, diagnosis.draw)
        await screen.refreshes()
        await screen.refreshes()
        assert (screen.named("diagnosis.after").text == "49.07") is meant
        assert ("304" in screen.named("diagnosis.peaks").text) is meant
        assert screen.named("diagnosis.not_held_out").visible is not meant

    assert diagnosis_screen(desk.axis, "verify-002/verify").shown is not None  # type: ignore[arg-type]
    inside(work)
