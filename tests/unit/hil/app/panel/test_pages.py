"""What pages show of their axis, drawn without a browser: in which frame, and what is read of its folder beside the server's loop."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import pytest
from support.bench_axis import lay_out
from support.screen import Screen, inside, is_visible

from hil.app.panel.pages import overview, pages
from hil.app.panel.server import unfinished_work
from hil.axis.axis_file import DriveAxis, load_axis
from hil.desk.desk import Desk
from hil.desk.job import Job, Workplace
from hil.desk.plan import Plan
from hil.lost_motion import page as lost_motion

Until = Callable[[Callable[[], bool], str], None]
Seen = TypeVar("Seen")


@pytest.fixture
def desk(tmp_path: Path, until: Until) -> Iterator[Desk]:
    with Desk(load_axis(lay_out(tmp_path)), pace=0.0) as one:
        until(lambda: one.live.instrument_mm is not None, "the axis and its instrument are looked at")
        yield one


def does(desk: Desk, token: str, work: Callable[[Workplace], object], until: Until) -> None:
    """A job, to its end."""
    desk.run(token, Job("test", Plan(desk.name, "bench"), work))
    until(lambda: not desk.job().running, "the job is over")  # type: ignore[union-attr]


def figures(screen: Screen) -> dict[str, str]:
    """Names and values of what is visible of the measured position."""
    names = ("overview.measured", "overview.measured_raw")
    return {name: screen.named(name).text for name in names if is_visible(screen.named(name))}


def test_the_instruments_own_zero_is_not_shown_as_the_position_of_the_load(desk: Desk, until: Until) -> None:
    token = desk.control.take("test")
    seen: list[dict[str, str]] = []

    async def work() -> None:
        screen = Screen(desk, overview.draw, token=token)
        seen.append(figures(screen))
        does(desk, token, lambda place: place.machine().session.prepare(), until)
        until(lambda: desk.trace()[-1].instrument_load_mm is not None, "it is looked at again")
        await screen.refreshes()
        seen.append(figures(screen))

    inside(work)
    before, after = seen
    assert list(before) == ["overview.measured_raw"]
    assert list(after) == ["overview.measured"]
    live = desk.live
    assert live.instrument_mm == pytest.approx(live.position_load_mm, abs=0.1)
    assert abs(float(before["overview.measured_raw"].replace("−", "-")) - float(after["overview.measured"])) > 1.0
    curve = [one.instrument_load_mm for one in desk.trace() if one.instrument_load_mm is not None]
    assert curve == pytest.approx([live.position_load_mm] * len(curve), abs=0.1)


@pytest.mark.parametrize("reads", ["unfinished_work", "kept_lost_motion"])
def test_the_folder_is_read_beside_the_loop_and_after_a_job(
    reads: str, desk: Desk, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[int] = []
    counts: list[int] = []

    def noted(read: Callable[[Any], Seen]) -> Callable[[DriveAxis], Seen]:
        def seen(axis: DriveAxis) -> Seen:
            threads.append(threading.get_ident())
            return read(axis)

        return seen

    work_left = partial(unfinished_work, pages=pages(None))
    unfinished = noted(work_left) if reads == "unfinished_work" else work_left
    if reads == "kept_lost_motion":
        monkeypatch.setattr(lost_motion, reads, noted(getattr(lost_motion, reads)))

    async def work() -> None:
        token = desk.control.take("test")
        screen = Screen(desk, lost_motion.draw, token=token, unfinished=unfinished)
        for _ in range(2):
            for _ in range(5):
                await screen.refreshes()
            counts.append(len(threads))
            does(desk, token, lambda _place: None, until)

    inside(work)
    assert counts == [1, 2]
    assert threading.get_ident() not in threads
