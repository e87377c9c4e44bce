"""The view that a page is given: its axis's desk, the texts, and functions to draw and to start jobs. Pages keep no state."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar
from weakref import WeakKeyDictionary

from nicegui import Client, run, ui
from nicegui.element import Element

from drivers.errors import InputError
from hil.axis.axis_file import DriveAxis
from hil.desk.control import NotInControlError
from hil.desk.desk import Desk
from hil.desk.error_log import one_line
from hil.desk.job import Job
from hil.desk.plan import text_key
from hil.desk.progress import Progress
from hil.desk.roles import Role
from hil.desk.unfinished import UnfinishedWork
from hil.ui.screen.browsers import Browser
from hil.ui.screen.plan_question import plan_question
from hil.ui.screen.texts import Texts

Refresh = Callable[[], None]
"""Draw a part of a page again."""
AnyElement = TypeVar("AnyElement", bound=Element)
_shown_errors: WeakKeyDictionary[Client, ui.notification] = WeakKeyDictionary()
REFRESH_S = 0.2
"""Interval between two refreshes of a page, s."""


class Button(ui.button):
    """A button that says below its text why it cannot be pressed."""

    def __init__(self, text: str, press: Callable[[], object]) -> None:
        super().__init__(on_click=press, color=None)
        with self, ui.element("div"):
            self._label = ui.label(text)
            self._why = ui.label().classes("hil-why")
            self._why.set_visibility(False)

    def say(self, text: str) -> None:
        self._label.set_text(text)

    def allow(self, why_not: str = "") -> None:
        """Let it be pressed, or grey it and say why."""
        self.set_enabled(not why_not)
        if self._why.text != why_not:
            self._why.set_text(why_not)
            self._why.set_visibility(bool(why_not))


@dataclass(frozen=True)
class View:
    """One page in one browser. t: the texts in its language; desks: of all axes of the server; unfinished: reads the
    interrupted work in an axis's folder."""

    desk: Desk
    desks: Sequence[Desk]
    t: Texts
    browser: Browser
    client: Client
    unfinished: Callable[[DriveAxis], tuple[UnfinishedWork, ...]]

    # -- who is there --------------------------------------------------------------------------------------------------
    @property
    def token(self) -> str | None:
        """This browser's last token of control; None for none."""
        return self.browser.tokens.get(self.desk.name)

    @property
    def who(self) -> str:
        """This browser's name."""
        return self.t("control.browser", number=self.browser.number)

    @property
    def in_control(self) -> bool:
        """Whether this browser holds control."""
        return self.desk.control.holds(self.token)

    @property
    def is_builder(self) -> bool:
        """Whether this browser holds control in the builder's role."""
        return self.in_control and self.desk.rights.role is Role.BUILDER

    def why_not(self, *, builder: bool = False) -> str:
        """Why this browser cannot start a job now, in its language; "" where it can. builder: a job that needs the builder's role."""
        job = self.desk.job()
        if not self.in_control:
            return self.t("why.control")
        if not self.desk.live.connected:
            return self.t("why.connection")
        if job is not None and job.running:
            return self.t("why.job")
        return self.t("why.builder") if builder and not self.is_builder else ""

    @property
    def can_start(self) -> bool:
        """Whether this browser holds control, the axis is connected, and no job runs."""
        return not self.why_not()

    # -- drawing -------------------------------------------------------------------------------------------------------
    def card(self, key: str, name: str = "", *, live: str = "") -> Element:
        """A frame with a heading; use with `with`. name: as `named`, default the key; live: as for `live`."""
        card = self.named(ui.element("section").classes("hil-card"), name or key)
        if live:
            self.live(card, live)
        with card:
            ui.label(self.t(key)).classes("hil-name")
        return card

    def named(self, element: AnyElement, name: str) -> AnyElement:
        """Set an element's name for tests and style sheets (data-name); returns the element."""
        element.props(f'data-name="{name}"')
        return element

    def live(self, element: AnyElement, source: str, desk: Desk | None = None) -> AnyElement:
        """Name the source of an element's figures, "drive" or "instrument". The page's script marks them once it is silent."""
        return element.props(f'data-live="{(desk or self.desk).name}.{source}"')

    def fold(self, key: str) -> ui.expansion:
        """A card with a heading that opens and closes, closed at first; use with `with`."""
        return self.named(ui.expansion(self.t(key)).classes("hil-card hil-fold"), key)

    def how(self, key: str, steps: str) -> None:
        """How a job is done, folded away; F1 opens it. key: of the heading; steps: of the text, Markdown."""
        with self.fold(key).props("data-how"):
            ui.markdown(self.t(steps))

    def value(self, key: str, unit: str = "", *, small: bool = False, name: str = "") -> ui.label:
        """A figure with its name and unit, legible from two metres; set its text with `.set_text`."""
        with ui.element("div"):
            ui.label(self.t(key)).classes("hil-name")
            with ui.element("div"):
                figure = ui.label("–").classes("hil-value" + (" small" if small else "")).style("display: inline")
                if unit:
                    ui.label(unit).classes("hil-unit").style("display: inline")
        return self.named(figure, name or key)

    def button(self, key: str, action: Callable[[], object], *, name: str = "") -> Button:
        """A button with the text of a key; its action's errors are shown."""

        async def press() -> None:
            await self.attempt(action)

        return self.named(Button(self.t(key), press), name or key)

    def every(self, *parts: Callable[[], None], seconds: float = REFRESH_S) -> None:
        """Call each of these every `seconds` while the page is open."""

        def refresh() -> None:
            for part in parts:
                part()

        refresh()
        ui.timer(seconds, refresh)

    def stage(self, job: Progress | None) -> str:
        """The step of a running job, or how a job ended."""
        if job is None:
            return "–"
        if not job.running:
            return self.t(f"phase.{job.phase.value}")
        count = f"({job.done}/{job.total})" if job.total else ""
        stage = self.t.measurement(job.stage, job.kind)
        said = " ".join(filter(None, (self.t.said(job.message), count)))
        return ": ".join(filter(None, (stage, said)))

    def number_of(self, field: ui.number) -> float:
        """The value of a field. Raises InputError, in the page's language, for an empty one."""
        if field.value is None:
            raise InputError(self.t("field.empty", field=field.label))
        return float(field.value)

    def messages(self, name: str) -> Messages:
        """A note for errors and warnings, hidden while there are none."""
        return Messages(self, self.named(ui.label().classes("hil-note bad"), name))

    # -- doing ---------------------------------------------------------------------------------------------------------
    async def attempt(self, action: Callable[[], object]) -> bool:
        """Call the action, which may be a coroutine function; False after an error, which is shown as one line. For a program error
        the line names the file with the traceback."""
        try:
            done = action()
            if hasattr(done, "__await__"):
                await done
        except Exception as error:  # noqa: BLE001  every error is shown
            self.show_error(error)
            return False
        return True

    async def in_worker_thread(self, work: Callable[[], object]) -> object:
        """Run work of more than a few milliseconds (opening a key, reading files) in a worker thread; returns its result."""
        return await run.io_bound(work)

    def show_error(self, error: BaseException) -> None:
        """Show an error as a note that stays until it is closed, or until the next error takes its place."""
        if isinstance(error, NotInControlError):
            text = self.t("control.not_yours")
        elif isinstance(error, OSError):
            text = one_line(error)
        else:
            text = self.t.said(self.desk.errors.line_of(error))
        before = _shown_errors.get(self.client)
        if before is not None and not before.is_deleted:
            before.delete()
        with self.client.content:
            close = self.t("button.close")
            note = ui.notification(text, type="negative", position="bottom-right", timeout=None, close_button=close)
        _shown_errors[self.client] = note

    async def ask_and_run(self, job: Job, lent: Sequence[Desk] = (), changes: Sequence[str] = ()) -> bool:
        """Ask with the plan of motions and writes, then start the job. True if it was started.

        lent: desks of other axes that the job connects itself; changes: what is written, each with its old and new value (`change`)
        """
        if not self.in_control:
            self.show_error(NotInControlError())
            return False
        kind = "going_on" if job.plan.measured else text_key(job.kind)
        go = self.t(f"go.{kind}", axis=self.desk.name)
        if not await self.ask([*changes, *plan_question(job.plan, self.t)], go):
            return False
        tokens = {desk: self.browser.tokens.get(desk.name) for desk in lent}
        started = await self.attempt(lambda: self.desk.run(self.token, job, tokens, changes))
        if started:
            self.client.run_javascript("hilFocusStop()")
        return started

    def change(self, name: str, old: str, new: str, unit: str = "") -> str:
        """A line that says what is written: parameter, old and new value, unit."""
        return self.t("plan.change", name=name, old=old or "–", new=new or "–", unit=unit).strip()

    async def finished(self, job: Job) -> Progress | None:
        """Run a job that asks nothing and wait for its end, without blocking the page. None where it was not started."""
        started = await self.attempt(lambda: self.desk.run(self.token, job))
        return await self.ended(job.kind) if started else None

    async def ended(self, kind: str) -> Progress | None:
        """Wait for the end of the last job of a kind, and until its axis is connected again, without blocking the page."""
        while (now := self.desk.last(kind)) is not None and (now.running or self._is_connecting):
            await asyncio.sleep(REFRESH_S / 4)
        return now

    @property
    def _is_connecting(self) -> bool:
        return not self.desk.live.connected and not self.desk.live.trouble

    async def ask(self, lines: Iterable[str], go: str) -> bool:
        """A question. go: text of the button that does it; the other one, and Esc, leave everything as it is."""
        with self.dialog() as dialog:
            with dialog, ui.card().classes("hil-card"):
                for line in lines:
                    self.named(ui.label(line), "question.line")
                with ui.row():
                    yes = ui.button(go, on_click=lambda: dialog.submit(True), color=None).classes("hil-go")
                    self.named(yes.props("autofocus"), "question.yes")  # Enter confirms
                    no = ui.button(self.t("button.cancel"), on_click=lambda: dialog.submit(False), color=None)
                    self.named(no, "question.no")
            return bool(await dialog)

    async def ask_passwords(self, *fields: str, yes: str, go: str, why: str = "") -> tuple[str, ...] | None:
        """Ask for passwords in fields with these keys; None where it was cancelled. why: key of a line above them; yes: name of the
        button that goes on, go: key of its text."""
        with self.dialog() as dialog:
            with dialog, ui.card().classes("hil-card"):
                if why:
                    ui.label(self.t(why))
                given = [ui.input(self.t(key), password=True).props("autocomplete=off") for key in fields]
                given[0].props("autofocus")
                for field, key in zip(given, fields, strict=True):
                    self.named(field, key).on("keydown.enter", lambda: dialog.submit(True))
                with ui.row():
                    confirm = ui.button(self.t(go), on_click=lambda: dialog.submit(True), color=None)
                    self.named(confirm.classes("hil-go"), yes)
                    ui.button(self.t("button.cancel"), on_click=lambda: dialog.submit(False), color=None)
            return tuple(str(field.value or "") for field in given) if await dialog else None

    @contextmanager
    def dialog(self) -> Iterator[ui.dialog]:
        """An empty dialog, to be filled and awaited. At the end of the block it is deleted with the entries in it."""
        with self.client.content:
            dialog = ui.dialog()
        try:
            yield dialog
        finally:
            if not dialog.is_deleted:  # true when its page was closed meanwhile
                dialog.delete()


@dataclass(frozen=True)
class Messages:
    """Note with the errors and warnings of an axis and its job."""

    view: View
    label: ui.label

    def show(self, job: Progress | None, warning: str = "") -> None:
        """Show them. warning: in the procedure's words."""
        t = self.view.t
        lines = [self.view.desk.live.trouble, t.said(warning)]
        if job is not None:
            lines += [t.said(job.error), *map(t.said, job.messages)]
            lines += [t("header.stopping")] if job.stopping else []
        text = "\n".join(line for line in lines if line)
        self.label.set_text(text)
        self.label.set_visibility(bool(text))
