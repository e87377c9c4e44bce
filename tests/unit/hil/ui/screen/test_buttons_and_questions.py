"""Greyed buttons say why, questions before writing name old and new value, and switches say what runs; drawn without a browser."""

from __future__ import annotations

import asyncio
import queue
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from nicegui import ui
from support import backlash_axis
from support.bench_axis import PASSWORDS, lay_out, write_keys
from support.screen import Screen, begun_by, inside, is_visible

from hil.app.panel.bar import draw_bar
from hil.app.panel.pages import overview, pages
from hil.axis.axis_file import load_axis, load_drive_axis
from hil.backlash import page as backlash
from hil.calibration import page as calibrate
from hil.calibration.job import UNCORRECTED, VERIFY
from hil.desk.desk import Desk
from hil.desk.job import Job, Workplace
from hil.desk.plan import Move, Plan
from hil.desk.progress import JobLog, Phase
from hil.diagnosis import page as diagnosis
from hil.lost_motion import page as lost_motion
from hil.machine.events import Event
from hil.parameters import page as parameters
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import Button

FREE = {
    "overview.pause",
    "diagnosis.tab.campaign",
    "diagnosis.tab.loop",
    "parameters.tab.all",
    "parameters.tab.differences",
}
FIXES = ".fix.control"
"""End of the names of buttons that take control."""
"""Buttons that anybody may press."""
Until = Callable[[Callable[[], bool], str], None]


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(load_axis(lay_out(tmp_path)))


@contextmanager
def running(
    desk: Desk, token: str, kind: str, until: Until, moves: tuple[Move, ...] = ()
) -> Iterator[Callable[[Event], None]]:
    """A job of this kind on a connected axis, until its block is left; what is called passes an event on from it."""
    events = queue.Queue[Event | None]()

    def work(place: Workplace) -> None:
        for event in iter(events.get, None):
            place.listener(event)
            events.task_done()

    def tell(event: Event) -> None:
        events.put(event)
        events.join()

    until(lambda: desk.live.connected, "the axis is connected")
    desk.run(token, Job(kind, Plan("X", "bench", moves), work))
    try:
        yield tell
    finally:
        events.put(None)
        until(lambda: not desk.job().running, "the job is over")  # type: ignore[union-attr]


@pytest.mark.parametrize("page", [page for page in pages(None) if not page.several], ids=lambda page: page.name)
def test_nothing_that_needs_control_is_lit_without_it_and_each_says_why(page: object, desk: Desk) -> None:
    async def work() -> None:
        screen = Screen(desk, page.draw)  # type: ignore[attr-defined]
        await screen.refreshes()
        why = Texts("en")("why.control")
        shown = [one for one in screen.all(Button) if is_visible(one) and one.props["data-name"] not in FREE]
        shown = [one for one in shown if not one.props["data-name"].endswith(FIXES)]
        lit = [one.props["data-name"] for one in shown if one.enabled]
        assert not lit
        for button in shown:
            assert why in [label.text for label in button.descendants() if isinstance(label, ui.label)]

    inside(work)


def test_power_off_and_reset_fault_say_what_they_miss(tmp_path: Path, until: Until) -> None:
    with Desk(load_axis(lay_out(tmp_path)), pace=0.0) as connected:
        until(lambda: connected.live.connected, "the axis is looked at")
        token = connected.control.take("test")

        async def work() -> None:
            screen = Screen(connected, overview.draw, token=token)
            await screen.refreshes()
            for name, why in (("power_off", "without power"), ("reset_fault", "no fault")):
                button = screen.named(f"overview.{name}")
                assert not button.enabled
                assert any(why in one.text for one in button.descendants() if isinstance(one, ui.label))

        inside(work)


@pytest.mark.parametrize(("kind", "with_it"), [(UNCORRECTED, False), (VERIFY, True)])
def test_the_switch_of_the_correction_says_how_the_verification_runs(
    kind: str, with_it: bool, desk: Desk, until: Until
) -> None:
    """After a reload too; it can be set again once the run is over."""

    async def work() -> None:
        token = desk.control.take("test")
        with running(desk, token, kind, until):
            screen = Screen(desk, calibrate.draw, token=token)
            switch = screen.named("calibrate.correction")
            assert switch.value is with_it
            await screen.refreshes()
            assert (switch.value, switch.enabled) == (with_it, False)
        await screen.refreshes()
        assert switch.enabled

    with desk:
        inside(work)


@pytest.mark.parametrize(("done", "total"), [(0, 0), (47, 50), (50, 50)])
def test_progress_ends_at_the_whole_of_a_job_that_is_done(done: int, total: int) -> None:
    log = JobLog(1, "test", Plan("X", "bench"))
    log.hear(Event("measure", done=done, total=total))
    for carried_out in (Phase.DONE, Phase.WITHOUT_RESULT):
        log.end(carried_out)
        assert log.progress().share == 1.0
    log.end(Phase.STOPPED)
    assert log.progress().share == (done / total if total else 0.0)


@pytest.mark.parametrize(
    ("kind", "stages", "numbers"),
    [
        ("calibrate", ["measure", "round-1", "round-2"], [(1, 3), (2, 3), (2, 3)]),
        ("verify", ["verify"], [(3, 3)]),
        ("backlash", ["run 1 of 3, + → −", "run 3 of 3, − → +"], [(1, 3), (3, 3)]),
        ("lost motion", ["strokes", "fit", "before", "after"], [(1, 4), (2, 4), (3, 4), (4, 4)]),
        (
            "close-loop",
            ["measure", "round-1", "before-1 warming", "before-1", "diagnose", "next-1", "diagnose", "after-2"],
            [(1, 5), (2, 5), (3, 5), (3, 5), (4, 5), (4, 5), (4, 5), (5, 5)],
        ),
        ("parameters download", ["look", "write"], [(1, 2), (2, 2)]),
        ("uncorrected", ["uncorrected"], [None]),
    ],
)
def test_a_job_says_which_of_its_steps_runs(
    kind: str, stages: list[str], numbers: list[tuple[int, int] | None]
) -> None:
    log = JobLog(1, kind, Plan("X", "bench"))
    found = []
    for stage in stages:
        log.hear(Event(stage, done=1, total=9))
        found.append(log.progress().step)
    assert found == numbers


def test_a_loop_with_passes_in_motion_has_their_steps_too() -> None:
    log = JobLog(1, "close-loop", Plan("X", "bench", (Move("feeds 20", 0.0, 1.0, 20.0),)))
    found = []
    for stage in ("diagnose", "after-1", "motion-before", "diagnose", "motion-after"):
        log.hear(Event(stage))
        found.append(log.progress().step)
    assert found == [(number, 8) for number in (4, 5, 6, 7, 8)]


def test_the_bar_names_job_and_step(desk: Desk, until: Until) -> None:
    async def work() -> None:
        tell(Event("round-1", "20.000 mm", 3, 16))
        screen = Screen(desk, lambda view: draw_bar(view, pages(None)[0]), "de")
        t = Texts("de")
        assert screen.named("header.job").text == t("job.calibrate")
        assert screen.named("header.number").text == t("bar.step", number=2, count=3)
        said = f"{t.said('20.000')} mm (3/16)"
        assert screen.named("header.step").text == f"{t('pass.round', number=1)}: {said}"

    with desk, running(desk, desk.control.take("test"), "calibrate", until) as tell:
        inside(work)


@pytest.mark.parametrize(
    ("name", "stages"),
    [
        ("calibrate", ["measure", "round-1"]),
        ("verify", ["verify"]),
        ("lost motion", ["strokes", "fit", "before", "after"]),
        ("close-loop", ["measure", "round-1", "before-1", "diagnose", "after-1"]),
        ("close-loop in motion", ["measure", "after-1", "motion-before", "diagnose", "motion-after"]),
    ],
)
def test_the_bar_counts_the_tiles_that_the_page_shows(name: str, stages: list[str], desk: Desk, until: Until) -> None:
    kind, _, moving = name.partition(" in ")
    page, title = {"lost motion": (lost_motion.draw, "lost_motion"), "close-loop": (diagnosis.draw, "loop")}.get(
        kind, (calibrate.draw, "calibrate")
    )
    moves = (Move("feeds 20", 0.0, 1.0, 20.0),) if moving else ()

    async def work() -> None:
        screen = Screen(desk, lambda view: (draw_bar(view, pages(None)[0]), page(view)))
        refresh = screen.quick_timers()
        for stage in stages:
            tell(Event(stage, done=1, total=9))
            refresh()
            tiles = [one for one in screen.named(f"{title}.steps").default_slot.children if one.visible]
            now = [number for number, one in enumerate(tiles, start=1) if "now" in one.classes]
            assert screen.named("header.number").text == Texts("en")("bar.step", number=now[0], count=len(tiles)), stage

    with desk, running(desk, desk.control.take("test"), kind, until, moves) as tell:
        inside(work)


@pytest.mark.parametrize(("reached", "percent", "colour"), [(True, "100 %", "done"), (False, "", "without_result")])
def test_a_job_that_did_not_find_what_it_was_for_is_not_done(
    reached: bool, percent: str, colour: str, tmp_path: Path, until: Until
) -> None:
    """Neither in the bar, nor in the log of events, nor as written."""
    with Desk(load_drive_axis(backlash_axis.lay_out(tmp_path)), pace=0.0) as desk:
        until(lambda: desk.live.connected, "the axis is connected")
        job = Job("backlash", Plan("X", "bench"), lambda _place: reached, reached=bool)
        desk.run(desk.control.take("test"), job, changes=("2201h: 0 → 1",))
        until(lambda: not desk.job().running, "it is over")  # type: ignore[union-attr]

        async def work() -> None:
            screen = Screen(desk, lambda view: draw_bar(view, pages(None)[0]))
            assert screen.named("header.percent").text == percent
            assert colour in screen.named("header.progress").classes
            ended = "done" if reached else "ended without a result"
            assert screen.named("header.step").text == f"last: backlash, {ended}"

        inside(work)
        assert {entry.what for entry in desk.events.entries()} == {"started", colour} | (
            {"wrote"} if reached else set()
        )


def test_a_question_before_writing_names_parameter_old_and_new_value_and_unit(tmp_path: Path, until: Until) -> None:
    write_keys(tmp_path)
    with Desk(load_drive_axis(backlash_axis.lay_out(tmp_path, "canopen")), pace=0.0) as connected:
        until(lambda: connected.live.connected, "the axis is looked at")
        token = connected.control.take("test")
        connected.become_builder(token, PASSWORDS["HIL_KEY_PASSWORD"])
        how = backlash.backlash.backlash_config(connected.axis)
        connected.run(token, backlash.backlash.measuring_job(connected.axis, how))
        until(lambda: not connected.job().running, "it is measured")  # type: ignore[union-attr]
        connected.run(token, backlash.backlash.look_job(connected.axis, how))
        until(lambda: not connected.job().running, "it is read")  # type: ignore[union-attr]
        shown = backlash.backlash_screen(connected)
        assert shown.parameter is not None
        assert shown.mean_um is not None
        new = shown.parameter.amount_of(shown.mean_um)
        figures = Texts("en")
        wanted = (
            f"2201h: {shown.parameter.amount:g} ({figures.number(shown.parameter.amount / 100.0, 2)} µm)"
            f" → {new:g} ({figures.number(new / 100.0, 2)} µm)"
        )

        async def work() -> None:
            screen = Screen(connected, backlash.draw, token=token)
            writing = screen.begins("backlash.write")
            assert wanted in await screen.asked()
            assert screen.named("question.yes").text == Texts("en")("go.backlash_write") == "Write the value"
            assert screen.named("question.no").text == "Cancel"
            for task in writing:
                task.cancel()
            await asyncio.gather(*writing, return_exceptions=True)

        inside(work)


CHANGES = (
    ("following window", "1234", "6065h:00 following error window: 20000 → 1234 counts"),
    ("6066h", "0x64", "6066h:00 following error time out: 50 → 100 ms"),
    ("window", "-1", "-1 does not fit U32"),
    ("window", "far", "expected a whole number"),
)
"""What is searched for and typed, and what is asked or told then."""


def test_a_parameter_is_found_and_changed_by_the_question_of_a_download(tmp_path: Path, until: Until) -> None:
    write_keys(tmp_path)
    with Desk(load_drive_axis(backlash_axis.lay_out(tmp_path, "canopen")), pace=0.0) as connected:
        until(lambda: connected.live.connected, "the axis is looked at")
        token = connected.control.take("test")
        connected.become_builder(token, PASSWORDS["HIL_KEY_PASSWORD"])
        connected.run(token, parameters.parameters.read_job(connected.axis))
        until(lambda: not connected.job().running, "it is read")  # type: ignore[union-attr]
        until(lambda: connected.live.connected, "the axis is looked at again")

        def found(searched: str) -> Screen:
            screen = Screen(connected, parameters.draw, token=token)
            refresh = screen.quick_timers()
            refresh()
            screen.named("parameters.search").set_value(searched)
            assert len(screen.named("parameters.all").rows) < 5
            begun_by(screen.named("parameters.search"), "keydown.enter")  # the first that was found
            refresh()
            return screen

        async def work() -> None:
            for searched, typed, answer in CHANGES:
                screen = found(searched)
                screen.named("parameters.edit.value").set_value(typed)
                writing = screen.begins("parameters.change")
                lines = await screen.asked()
                assert any(answer in line for line in (*lines, *screen.told())), (lines, screen.told())
                assert bool(lines) is ("→" in answer)
                for task in writing:
                    task.cancel()
                await asyncio.gather(*writing, return_exceptions=True)
            screen = found("serial")
            assert "1018h:04 serial number · 1 · is read only" in screen.named("parameters.edit.what").text
            assert not screen.named("parameters.change").visible

        inside(work)
