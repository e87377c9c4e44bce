"""A procedure of a user as a job on the screen, drawn without a browser."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.bench_axis import PASSWORDS, lay_out
from support.screen import Screen, inside, is_visible

from hil.app.panel.bar import draw_bar
from hil.app.panel.pages import overview, pages
from hil.app.panel.server import unfinished_work
from hil.axis.axis_file import load_axis
from hil.correction.compensation import Compensation
from hil.correction.store import SealedStore
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.desk.desk import Desk
from hil.desk.progress import Phase
from hil.script import page
from hil.script.procedure_file import load_procedure
from hil.script.procedure_job import Carried, procedure_job

Until = Callable[[Callable[[], bool], str], None]
CREEP = Path(__file__).parents[4] / "hil/examples/creep.py"


def test_a_procedure_is_started_with_its_parameters_and_shows_its_rows(tmp_path: Path, until: Until) -> None:
    creep = load_procedure(CREEP)
    own = [one for one in pages(None, creep) if one.name == "procedure"]
    assert len(own) == len(pages(None, creep)) - len(pages(None)) == 1
    with Desk(load_axis(lay_out(tmp_path)), pace=0.0) as desk:
        until(lambda: desk.live.connected, "the axis is looked at")
        token = desk.control.take("test")

        async def work() -> None:
            screen = Screen(desk, partial(page.draw, procedure=creep), "de", token=token)
            await screen.refreshes()
            assert screen.named("procedure.targets_mm").value == "100,20,100,20,100"
            assert not screen.named("procedure.left_over").visible, "nothing was broken off"
            screen.named("procedure.watch_s").value = "a while"
            await screen.presses("procedure.start")
            assert screen.told() == ["watch_s is 'a while', expected a number"]
            screen = Screen(desk, partial(page.draw, procedure=creep), "de", token=token)
            screen.named("procedure.targets_mm").value = "60,20"
            screen.named("procedure.watch_s").value = "1"
            screen.named("procedure.instrument_zeroed").value = True
            started = screen.begins("procedure.start")
            asked = await screen.asked()
            assert any("20,000" in line and "60,000 mm" in line for line in asked), asked
            assert any("Messgerät" in line and "genullt" in line for line in asked), asked
            assert screen.named("question.yes").text == "Auf X starten"
            screen.begins("question.yes")
            await asyncio.gather(*started)
            bar = Screen(desk, lambda view: draw_bar(view, own[0]), "de", token=token)
            async with asyncio.timeout(60.0):
                while (job := desk.last(creep.kind)) is not None and job.running:
                    await bar.refreshes()
                    await screen.refreshes()
                    await asyncio.sleep(0.01)
            await screen.refreshes()

        inside(work)
        job = desk.last(creep.kind)
        assert job is not None
        assert job.phase is Phase.DONE
        carried = job.result
        assert isinstance(carried, Carried)
        assert carried.records.runs == [1, 2]
        assert sorted(set(carried.records.target_mm)) == [20.0, 60.0]
        drawn = desk.graph(creep.kind).series
        assert [round(y, 6) for _, y in drawn["run 1"]] == [
            round(float(error), 6) for error in carried.records.error_um[carried.records.run == 1]
        ]


def test_a_procedure_can_be_started_with_the_stored_correction_in_force(tmp_path: Path, until: Until) -> None:
    creep, axis = load_procedure(CREEP), load_axis(lay_out(tmp_path))
    store = SealedStore.of(axis, PASSWORDS["HIL_PASSWORD"], PASSWORDS["HIL_KEY_PASSWORD"])
    places, errors_um = np.array([0.0, 300.0]), np.array([-7.0, -7.0])
    store.save(Compensation(TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(places, errors_um, errors_um))))
    with Desk(axis, pace=0.0) as desk:
        until(lambda: desk.live.connected, "the axis is looked at")
        token = desk.control.take("test")

        async def work() -> None:
            screen = Screen(desk, partial(page.draw, procedure=creep), token=token)
            screen.named("procedure.targets_mm").value = "60"
            screen.named("procedure.watch_s").value = "1"
            await screen.refreshes()
            assert screen.named("procedure.start").enabled
            assert not is_visible(screen.named("procedure.ready.tables"))
            screen.named("procedure.correction").value = True
            await screen.refreshes()
            assert not screen.named("procedure.start").enabled, "the tables are not opened"
            opening = screen.begins("procedure.fix.tables")
            await screen.asked()
            screen.named("calibrate.password").value = PASSWORDS["HIL_PASSWORD"]
            screen.begins("calibrate.password.yes")
            await asyncio.gather(*opening)
            await screen.refreshes()
            assert screen.named("procedure.start").enabled
            started = screen.begins("procedure.start")
            await screen.asked()
            screen.begins("question.yes")
            await asyncio.gather(*started)

        inside(work)
        until(lambda: not desk.job().running, "it is over")  # type: ignore[union-attr]
        job = desk.last(creep.kind)
        assert job is not None
        assert job.error == ""
        carried = job.result
        assert isinstance(carried, Carried)
        given_um = (carried.records.command_mm - carried.records.target_mm) * 1000.0
        assert given_um == pytest.approx(-7.0, abs=0.01)


def test_a_run_that_was_broken_off_is_gone_on_with_as_it_was_begun(tmp_path: Path, until: Until) -> None:
    file, watched = tmp_path / "creep.py", "            for reading in"
    until_told = "            if run == 2 and not Path(__file__).with_name('go-on').exists():\n"
    broken_off = f"{until_told}                raise OSError('is cut off')\n{watched}"
    text = CREEP.read_text().replace(watched, broken_off)
    file.write_text(text.replace("import hil\n", "from pathlib import Path\n\nimport hil\n", 1))
    creep = load_procedure(file)
    axis = load_axis(lay_out(tmp_path))
    with Desk(axis, pace=0.0) as desk:
        until(lambda: desk.live.connected, "the axis is looked at")
        token = desk.control.take("test")
        desk.run(token, procedure_job(axis, creep(targets_mm=(60.0, 20.0), watch_s=1.0)))
        until(lambda: not desk.job().running, "it is cut off")  # type: ignore[union-attr]
        (tmp_path / "go-on").touch()
        work_left = partial(unfinished_work, pages=pages(None, creep))
        assert [(one.kind, one.page) for one in work_left(axis)] == [("run-creep", "procedure")]

        async def work() -> None:
            overview_shown = Screen(desk, overview.draw, token=token, unfinished=work_left)
            await overview_shown.refreshes()
            await overview_shown.refreshes()
            assert overview_shown.named("overview.left_over").visible
            screen = Screen(desk, partial(page.draw, procedure=creep), token=token, unfinished=work_left)
            await screen.refreshes()
            await screen.refreshes()
            assert screen.named("procedure.targets_mm").value == "100,20,100,20,100"
            card = list(screen.named("procedure.left_over").descendants())
            assert screen.named("procedure.resume") in card
            assert screen.named("procedure.discard.run-creep") in card
            going_on = screen.begins("procedure.resume")
            assert any("20.000" in line and "60.000 mm" in line for line in await screen.asked())
            screen.begins("question.yes")
            await asyncio.gather(*going_on)

        inside(work)
        until(lambda: not desk.job().running, "it is over")  # type: ignore[union-attr]
        job = desk.last(creep.kind)
        assert job is not None
        assert job.error == ""
        carried = job.result
        assert isinstance(carried, Carried)
        assert carried.campaign.name == "run-creep-001"
        assert carried.records.target_mm.tolist() == [60.0, 60.0, 20.0, 20.0]
        assert work_left(axis) == ()
