"""What a screen shows that was started after the measurement, and all unfinished work on one card; drawn without a browser."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from nicegui import ui
from support import backlash_axis
from support.bench_axis import lay_out
from support.screen import Draw, Screen, inside

from drivers.errors import InputError
from hil.app.panel.pages import overview, pages
from hil.app.panel.server import unfinished_work
from hil.axis.axis_file import AxisConfig, load_axis, load_drive_axis
from hil.backlash import job, page
from hil.backlash.settings import NOTE
from hil.calibration import page as calibration
from hil.calibration.job import calibration_plan, verification_plan
from hil.desk.control import NotInControlError
from hil.desk.desk import Desk
from hil.desk.progress import Phase
from hil.desk.unfinished import UnfinishedWork
from hil.lost_motion import page as lost_motion
from hil.lost_motion.job import measuring_plan
from hil.records.journal import Campaign
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import Button

COLUMNS = ("run", "direction", "target_mm", "measured_mm")
Until = Callable[[Callable[[], bool], str], None]


def test_the_last_backlash_is_shown(tmp_path: Path, until: Until) -> None:
    axis = load_drive_axis(backlash_axis.lay_out(tmp_path))
    with Desk(axis, pace=0.0) as before:
        until(lambda: before.live.connected, "the axis is looked at")
        before.run(before.control.take("test"), job.measuring_job(axis, job.backlash_config(axis)))
        until(lambda: not before.job().running, "it is measured")  # type: ignore[union-attr]
        measured = page.backlash_screen(before)
    figures = Texts("en")

    async def work() -> None:
        screen = Screen(Desk(axis), page.draw)
        await screen.refreshes()
        await screen.refreshes()
        assert screen.named("backlash.mean").text == figures.number(measured.mean_um, 2) != "–"
        for name, way in (("plus_minus", -1), ("minus_plus", 1)):
            assert screen.named(f"backlash.{name}").text == figures.number(measured.by_direction_um[way], 2)
        assert "before the last start" in screen.named("backlash.kept").text

    inside(work)


def test_the_last_lost_motion_is_shown(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    folder = axis.store.directory / "lost-motion-001"
    folder.mkdir(parents=True)
    proof = {"before": {"rms_um": 9.0}, "after": {"rms_um": 0.5}, "over_compensation_um": 1.0}
    form = {
        "amount_um": 20.0,
        "parameters": {"amount_um": {"value": 20.0, "std": 0.25}},
        "rise": {"shape": "tanh"},
        "proof": proof,
    }
    (folder / "result.json").write_text(json.dumps(form))

    async def work() -> None:
        screen = Screen(Desk(axis), lost_motion.draw)
        await screen.refreshes()
        await screen.refreshes()
        shown = {
            name: screen.named(f"lost_motion.{name}").text
            for name in ("amount", "std", "shape", "after", "before", "over")
        }
        assert shown == {
            "amount": "20.00",
            "std": "0.250",
            "shape": "tanh",
            "after": "0.50",
            "before": "9.00",
            "over": "5.0",
        }

    inside(work)


def test_a_backlash_that_was_not_found_is_not_done(tmp_path: Path, until: Until) -> None:
    axis = load_drive_axis(backlash_axis.lay_out(tmp_path, "canopen", backlash_axis.QUICK + "steps = 20\n"))
    with Desk(axis, pace=0.0) as desk:
        until(lambda: desk.live.connected, "the axis is looked at")
        desk.run(desk.control.take("test"), job.measuring_job(axis, job.backlash_config(axis)))
        until(lambda: not desk.job().running, "it is over")  # type: ignore[union-attr]
        ended = desk.last(job.MEASURE)
        assert ended is not None
        assert ended.phase is Phase.WITHOUT_RESULT


def test_every_kind_of_unfinished_work_is_on_one_card(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    kinds = ("calibrate", "verify", "uncorrected", "lost-motion", "close-loop")
    for kind in kinds:
        folder = axis.store.directory / f"{kind}-001"
        folder.mkdir(parents=True)
        (folder / "campaign.json").write_text(json.dumps({"kind": kind, "axis": "X"}))
        (folder / "rows.csv").write_text("run\n")
    (axis.store.directory / NOTE).write_text("{}")
    assert [one.kind for one in unfinished_work(axis, pages(None))] == [*kinds, "settings"]

    async def work() -> None:
        screen = Screen(Desk(axis), overview.draw)
        await screen.refreshes()
        await screen.refreshes()
        card = screen.named("overview.left_over")
        links = [one for one in card.descendants() if isinstance(one, ui.link)]
        assert card.visible
        assert len(links) == len(kinds) + 1
        offered = [one for one in card.descendants() if isinstance(one, Button)]
        thrown = {str(one.props["data-name"]).rpartition(".")[2]: one.enabled for one in offered}
        assert thrown == dict.fromkeys(
            kinds, False
        )  # control has to be held; settings are to be put back, not thrown away
        assert {one.props["href"].rpartition("/")[2] for one in links} == {
            "calibrate",
            "lost_motion",
            "diagnosis",
            "backlash",
        }

    inside(work)


def broken_off(axis: AxisConfig, kind: str = "calibrate") -> Campaign:
    """A campaign with two readings and a third that a power cut tore."""
    campaign = Campaign.numbered(axis.store.directory, axis.purpose(kind), resume=False)
    with campaign.rows("measure", COLUMNS) as rows:
        for target_mm in (20.0, 40.0):
            rows.append(dict(zip(COLUMNS, (1.0, 1.0, target_mm, target_mm), strict=True)))
    with (campaign.directory / "measure.csv").open("a", encoding="utf-8") as file:
        file.write("1,1,6")
    return campaign


@pytest.mark.parametrize(
    ("kind", "draw", "button"),
    [
        ("calibrate", calibration.draw, "calibrate.resume.calibrate"),
        ("uncorrected", calibration.draw, "calibrate.resume.uncorrected"),
        ("lost-motion", lost_motion.draw, "lost_motion.resume"),
    ],
)
def test_going_on_stands_on_top_and_asks_with_what_is_left(kind: str, draw: Draw, button: str, tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    how = lost_motion.lost_motion.lost_motion_config(axis)
    count = {
        "calibrate": calibration_plan(axis),
        "uncorrected": verification_plan(axis, 1),
        "lost-motion": measuring_plan(axis, how),
    }[kind].positions
    broken_off(axis, kind)
    desk = Desk(axis)

    async def work() -> None:
        screen = Screen(desk, draw, token=desk.control.take("test"))
        await screen.refreshes()
        await screen.refreshes()
        assert screen.named(button) in list(screen.named(f"{button.partition('.')[0]}.left_over").descendants())
        assert "hil-go" in screen.named(button).classes
        asking = screen.begins(button)
        lines = await screen.asked()
        assert lines[0].startswith(f"2 of {count} positions are measured and kept; {count - 2} are left, at least ")
        assert not [line for line in lines if "will be captured" in line or "Rows will be written" in line]
        assert screen.named("question.yes").text == "Go on"
        screen.begins("question.no")
        await asyncio.gather(*asking)

    inside(work)


def test_what_is_discarded_is_named_first_and_not_offered_again(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    campaign = broken_off(axis)
    before = sorted(path.name for path in campaign.directory.iterdir())
    desk = Desk(axis)

    async def work() -> None:
        screen = Screen(desk, overview.draw, token=desk.control.take("test"))
        await screen.refreshes()
        await screen.refreshes()
        asking = screen.begins("overview.discard.calibrate")
        lines = await screen.asked()
        assert "Calibration" in lines[0]
        assert "2 readings" in lines[0]
        assert unfinished_work(axis, pages(None))  # nothing happens by the question alone
        assert screen.named("question.yes").text == "Discard what was measured"
        screen.begins("question.yes")
        await asyncio.gather(*asking)

    inside(work)
    assert unfinished_work(axis, pages(None)) == ()
    assert sorted(path.name for path in campaign.directory.iterdir()) == sorted([*before, "discarded"])
    assert [one.what for one in desk.events.entries()] == ["discarded"]
    with pytest.raises(InputError, match="was discarded"):
        Campaign.numbered(axis.store.directory, axis.purpose("calibrate"), resume=True)
    assert Campaign.numbered(axis.store.directory, axis.purpose("calibrate"), resume=False).directory.name.endswith("2")


def test_only_who_holds_control_discards_and_nothing_that_is_to_be_put_back(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    broken_off(axis)
    (axis.store.directory / NOTE).write_text("{}")
    desk = Desk(axis)
    calibration, settings = unfinished_work(axis, pages(None))
    with pytest.raises(NotInControlError):
        desk.discard("guessed", calibration)
    with pytest.raises(InputError, match="cannot be discarded"):
        desk.discard(desk.control.take("test"), settings)
    assert unfinished_work(axis, pages(None)) == (calibration, settings)


# -- an interrupted calibration ------------------------------------------------------------------------------------
def test_an_interrupted_calibration_is_found_until_it_is_finished(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    assert unfinished_work(axis, pages(None)) == ()
    campaign = Campaign.numbered(axis.store.directory, axis.purpose("calibrate"), resume=False)
    assert unfinished_work(axis, pages(None)) == ()  # nothing was measured
    with campaign.rows("measure", ["run", "direction", "target_mm", "measured_mm"]):
        pass
    assert unfinished_work(axis, pages(None)) == (UnfinishedWork("calibrate", "calibrate", "calibrate-001"),)
    campaign.finish()
    (axis.store.directory / "backlash-before.json").write_text("{}")
    assert unfinished_work(axis, pages(None)) == (UnfinishedWork("settings", "backlash", "X-campaign"),)
