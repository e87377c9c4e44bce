"""A procedure of a user as a job on the screen, drawn without a browser."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path

from support.bench_axis import lay_out
from support.screen import Screen, inside

from hil.app.panel.bar import draw_bar
from hil.app.panel.pages import pages
from hil.axis.axis_file import load_axis
from hil.desk.desk import Desk
from hil.desk.progress import Phase
from hil.script import page
from hil.script.procedure_file import load_procedure
from hil.script.procedure_job import Carried

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
            assert not screen.named("procedure.resume").enabled, "nothing was broken off"
            screen.named("procedure.watch_s").value = "a while"
            await screen.presses("procedure.start")
            assert screen.told() == ["watch_s is 'a while', expected a number"]
            screen = Screen(desk, partial(page.draw, procedure=creep), "de", token=token)
            screen.named("procedure.targets_mm").value = "60,20"
            screen.named("procedure.watch_s").value = "1"
            started = screen.begins("procedure.start")
            asked = await screen.asked()
            assert any("20,000" in line and "60,000 mm" in line for line in asked), asked
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
