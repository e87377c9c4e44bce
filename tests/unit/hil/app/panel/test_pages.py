"""What pages show of their axis, drawn without a browser: in which frame, and what is read of its folder beside the server's loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import pytest
from nicegui import Client, core, ui
from nicegui.element import Element
from nicegui.page import page
from support.bench_axis import lay_out

from hil.app.panel.pages import overview
from hil.axis.axis_file import DriveAxis, load_axis
from hil.desk.desk import Desk
from hil.desk.job import Job, Workplace
from hil.desk.plan import Plan
from hil.lost_motion import page as lost_motion
from hil.ui.screen import unfinished
from hil.ui.screen.browsers import Browser
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import View

Until = Callable[[Callable[[], bool], str], None]
Seen = TypeVar("Seen")


@pytest.fixture
def desk(tmp_path: Path, until: Until) -> Iterator[Desk]:
    with Desk(load_axis(lay_out(tmp_path)), pace=0.0) as one:
        until(lambda: one.live.instrument_mm is not None, "the axis and its instrument are looked at")
        yield one


class Drawn:
    """A page in the browser that holds control, and its timers in our hands."""

    def __init__(self, desk: Desk, draw: Callable[[View], None]) -> None:
        self._desk, self._token = desk, desk.control.take("test")
        client = Client(page("/"), request=None)
        with client:
            draw(View(desk, (), Texts("en"), Browser(1, "en", tokens={desk.name: self._token}), client))
        timers = [one for one in client.elements.values() if isinstance(one, ui.timer)]
        self._calls = [(one.callback, one.parent_slot or client) for one in timers]
        self._elements = client.elements

    async def refreshes(self) -> None:
        """Every timer, once."""
        for callback, place in self._calls:
            assert callback is not None
            with place:
                done = callback()
                if done is not None:
                    await done

    def does(self, work: Callable[[Workplace], object], until: Until) -> None:
        """A job, to its end."""
        self._desk.run(self._token, Job("test", Plan(self._desk.name, "bench"), work))
        until(lambda: not self._desk.job().running, "the job is over")  # type: ignore[union-attr]

    def figures(self) -> dict[str, str]:
        """Names and values of what is visible of the measured position."""
        named = {str(one.props.get("data-name")): one for one in self._elements.values()}
        return {
            name: figure.text
            for name in ("overview.measured", "overview.measured_raw")
            if isinstance(figure := named[name], ui.label) and _visible(figure)
        }


def _visible(element: Element) -> bool:
    around = element.parent_slot
    return element.visible and (around is None or _visible(around.parent))


def looked_at(desk: Desk, draw: Callable[[View], None], look: Callable[[Drawn], Awaitable[Seen]]) -> Seen:
    """Draw a page in an event loop as the server's, and look at it there."""

    async def served() -> Seen:
        core.loop = asyncio.get_running_loop()
        try:
            return await look(Drawn(desk, draw))
        finally:
            core.loop = None

    return asyncio.run(served())


def test_the_instruments_own_zero_is_not_shown_as_the_position_of_the_load(desk: Desk, until: Until) -> None:
    async def look(drawn: Drawn) -> tuple[dict[str, str], dict[str, str]]:
        before = drawn.figures()
        drawn.does(lambda place: place.machine().session.prepare(), until)
        until(lambda: desk.trace()[-1].instrument_load_mm is not None, "it is looked at again")
        await drawn.refreshes()
        return before, drawn.figures()

    before, after = looked_at(desk, overview.draw, look)
    assert list(before) == ["overview.measured_raw"]
    assert list(after) == ["overview.measured"]
    live = desk.live
    assert live.instrument_mm == pytest.approx(live.position_load_mm, abs=0.1)
    assert abs(float(before["overview.measured_raw"].replace("−", "-")) - float(after["overview.measured"])) > 1.0
    curve = [one.instrument_load_mm for one in desk.trace() if one.instrument_load_mm is not None]
    assert curve == pytest.approx([live.position_load_mm] * len(curve), abs=0.1)


@pytest.mark.parametrize(("of", "reads"), [(unfinished, "unfinished_work"), (lost_motion, "kept_lost_motion")])
def test_the_folder_is_read_beside_the_loop_and_after_a_job(
    of: Any, reads: str, desk: Desk, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[int] = []
    read = getattr(of, reads)

    def seen(axis: DriveAxis) -> object:
        threads.append(threading.get_ident())
        return read(axis)

    monkeypatch.setattr(of, reads, seen)

    async def look(drawn: Drawn) -> list[int]:
        counts = []
        for _ in range(2):
            for _ in range(5):
                await drawn.refreshes()
            counts.append(len(threads))
            drawn.does(lambda _place: None, until)
        return counts

    assert looked_at(desk, lost_motion.draw, look) == [1, 2]
    assert threading.get_ident() not in threads
