"""What goes wrong behind a button is told on the screen, whatever it is; nothing is left behind by it. Drawn without a browser."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, cast

import pytest
from nicegui import ui
from support.bench_axis import lay_out
from support.screen import Draw, Screen, brought, inside

from hil.app.panel.frame import Page, draw_page
from hil.axis.axis_file import load_axis
from hil.backlash import page as backlash
from hil.calibration import page as calibrate
from hil.desk.control import SILENT_S, DeskControl
from hil.desk.desk import Desk
from hil.diagnosis.loop import page as close_loop
from hil.lost_motion.circle import page as circle
from hil.parameters import page as parameters
from hil.parameters.job import LARGEST_BYTES
from hil.ui.screen.pieces import FolderContents
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import View


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(load_axis(lay_out(tmp_path)))


def draw_circle(view: View) -> None:
    circle.draw_circle(view, cast(Any, view.desk.axis))


def draw_loop(view: View) -> None:
    close_loop.draw_loop(view, cast(Any, view.desk.axis), FolderContents(view, lambda: cast(Any, None)))


@pytest.mark.parametrize(
    ("draw", "fields", "button"),
    [
        (backlash.draw, ("backlash.speed", "backlash.runs"), "backlash.start"),
        (draw_circle, ("circle.radius", "circle.feed"), "circle.start"),
        (draw_loop, ("loop.runs", "loop.rows", "loop.warm_up"), "loop.start"),
        (calibrate.draw, ("calibrate.seed",), "calibrate.verify"),
    ],
    ids=["backlash", "circle", "loop", "calibrate"],
)
def test_a_field_that_was_cleared_is_named(draw: Draw, fields: tuple[str, ...], button: str, desk: Desk) -> None:
    async def work() -> None:
        screen = Screen(desk, draw, "de")
        for name in fields:
            field = screen.named(name)
            before, field.value = field.value, None
            await screen.presses(button)
            assert screen.told() == [f"„{Texts('de')(name)}“ ist leer: Dort wird eine Zahl gebraucht."]
            field.value = before
            for note in screen.all(ui.notification):
                note.delete()

    inside(work)


def test_what_nobody_foresaw_is_told_with_the_file_of_its_traceback(desk: Desk) -> None:
    def fail() -> None:
        raise ZeroDivisionError("nobody foresaw this")

    async def work() -> None:
        screen = Screen(desk, lambda view: view.button("button.close", fail))
        await screen.presses("button.close")
        assert screen.told() == [f"ZeroDivisionError: nobody foresaw this; the traceback is in {desk.errors.path}"]
        assert 'raise ZeroDivisionError("nobody foresaw this")' in desk.errors.path.read_text()

    inside(work)


def test_a_folder_that_cannot_be_read_is_told_once(desk: Desk) -> None:
    def read() -> None:
        raise ValueError("no such thing was ever written here")

    async def work() -> None:
        screen = Screen(desk, lambda view: FolderContents(view, read))
        for _ in range(3):
            await screen.refreshes()
        (told,) = screen.told()
        assert told.startswith("ValueError: no such thing was ever written here; ")
        assert desk.errors.path.read_text().count("Traceback") == 1

    inside(work)


def draw_frame(view: View) -> None:
    draw_page(view, Page("overview", lambda _view: None), ())


@pytest.mark.parametrize(
    ("draw", "button", "asked"),
    [
        (draw_frame, "role.become_builder", "role.key_password"),
        (calibrate.draw, "calibrate.open", "calibrate.password"),
    ],
    ids=["role", "tables"],
)
def test_nothing_typed_stays_when_the_asking_is_cut_off(draw: Draw, button: str, asked: str, desk: Desk) -> None:
    async def work() -> None:
        screen = Screen(desk, draw)
        asking = screen.begins(button)
        await screen.asked()
        screen.named(asked).value = "secret"
        for task in asking:
            task.cancel()
        await asyncio.gather(*asking, return_exceptions=True)
        assert screen.all(ui.dialog) == []
        assert [one.value for one in screen.all(ui.input) if one.value] == []

    inside(work)


class Brought:
    """A file that a browser brings."""

    name = "brought.toml"
    read_times = 0

    def __init__(self, size_bytes: int) -> None:
        self.size_bytes = size_bytes

    def size(self) -> int:
        return self.size_bytes

    async def read(self) -> bytes:
        self.read_times += 1
        return b""


@pytest.mark.parametrize(
    ("in_control", "size_bytes", "word", "read_times"),
    [
        (False, 10, "does not hold control", 0),
        (True, LARGEST_BYTES + 1, f"at most {LARGEST_BYTES}", 0),
        (True, LARGEST_BYTES, "brought.toml", 1),  # what was read is no set
    ],
)
def test_a_file_is_read_only_from_the_holder_of_control_and_not_too_large(
    in_control: bool, size_bytes: int, word: str, read_times: int, desk: Desk
) -> None:
    async def work() -> None:
        screen = Screen(desk, parameters.draw, token=desk.control.take("test") if in_control else None)
        (upload,), file = screen.all(ui.upload), Brought(size_bytes)
        await brought(upload, file)
        (told,) = screen.told()
        assert word in told
        assert file.read_times == read_times

    inside(work)


def test_a_page_without_its_browser_is_no_sign_of_life(desk: Desk) -> None:
    now_s = [0.0]

    async def work() -> None:
        desk.control = DeskControl(lambda: now_s[0])
        screen = Screen(desk, draw_frame, token=desk.control.take("test"))
        for tab, silent_s in ((None, SILENT_S), ("a tab", 0.0)):
            screen.client.tab_id = tab
            now_s[0] += SILENT_S if tab is None else 1.0
            await screen.refreshes()
            holder = desk.control.holder()
            assert holder is not None
            assert holder.silent_s == silent_s

    inside(work)
