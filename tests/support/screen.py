"""A page of the operator's screen, drawn without a browser in an event loop of the test's own."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from inspect import signature
from typing import Any, cast

from nicegui import Client, core, ui
from nicegui.element import Element
from nicegui.events import UploadEventArguments
from nicegui.page import page

from hil.app.panel.pages import pages
from hil.app.panel.server import unfinished_work
from hil.axis.axis_file import DriveAxis
from hil.desk.desk import Desk
from hil.desk.unfinished import UnfinishedWork
from hil.ui.screen.browsers import Browser
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import View

Draw = Callable[[View], object]
WITHOUT_PROCEDURE = partial(unfinished_work, pages=pages(None))
"""Unfinished work of a screen that was started without a procedure of a user."""


def begun_by(element: Element, event: str = "") -> set[asyncio.Task[Any]]:
    """What an element's listeners, of one event or of all, set going."""
    before = asyncio.all_tasks()
    for listener in element._event_listeners.values():
        if event in ("", listener.type):
            handler = cast(Callable[..., object], listener.handler)
            handler(*[None] * len(signature(handler).parameters))
    return asyncio.all_tasks() - before


async def brought(upload: ui.upload, file: object) -> None:
    """What a page does with a file that a browser brings."""
    (handler,) = upload._upload_handlers
    await cast(Any, handler)(UploadEventArguments(sender=upload, client=upload.client, file=cast(Any, file)))


class Screen:
    """A page of a desk that is not connected, drawn inside the loop of a test."""

    def __init__(
        self,
        desk: Desk,
        draw: Draw,
        language: str = "en",
        token: str | None = None,
        unfinished: Callable[[DriveAxis], tuple[UnfinishedWork, ...]] = WITHOUT_PROCEDURE,
    ) -> None:
        self.desk, self.client = desk, Client(page("/"), request=None)
        tokens = {} if token is None else {desk.name: token}
        self.view = View(
            desk,
            (desk, Desk(desk.axis)),
            Texts(language),
            Browser(1, language, tokens=tokens),
            self.client,
            unfinished,
        )
        with self.client:
            draw(self.view)
        self._timers = [(one.callback, one.parent_slot) for one in self.all(ui.timer)]

    def all(self, kind: type) -> list[Any]:
        return [one for one in self.client.elements.values() if isinstance(one, kind)]

    def named(self, name: str) -> Any:
        return next(one for one in self.client.elements.values() if one.props.get("data-name") == name)

    def told(self) -> list[str]:
        return [one.message for one in self.all(ui.notification)]

    def begins(self, name: str) -> set[asyncio.Task[Any]]:
        """Press a button; what it set going."""
        return begun_by(self.named(name))

    async def presses(self, name: str) -> None:
        """A button, until all that it does is done."""
        await asyncio.gather(*self.begins(name))

    async def asked(self) -> list[str]:
        """The lines of the question, once one is asked; none where something is told instead."""
        async with asyncio.timeout(60.0):
            while not any(one.value for one in self.all(ui.dialog)) and not self.told():
                await asyncio.sleep(0.01)
        return [one.text for one in self.all(ui.label) if one.props.get("data-name") == "question.line"]

    def quick_timers(self) -> Callable[[], None]:
        """Calls the timers that await nothing, once: the page's own refresh."""

        def call() -> None:
            for callback, place in self._timers:
                if not asyncio.iscoroutinefunction(callback):
                    with place:
                        callback()

        return call

    async def refreshes(self) -> None:
        """Every timer, once."""
        for callback, place in self._timers:
            with place:
                done = callback()
                if done is not None:
                    await done


def is_visible(element: Element) -> bool:
    """Itself, and all that it is in."""
    around = element.parent_slot
    return element.visible and (around is None or is_visible(around.parent))


def inside(work: Callable[[], Awaitable[None]]) -> None:
    """In an event loop as the server's."""

    async def served() -> None:
        core.loop = asyncio.get_running_loop()
        try:
            await work()
        finally:
            core.loop = None

    asyncio.run(served())
