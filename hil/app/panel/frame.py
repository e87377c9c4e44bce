"""The frame of every page: stop button, control, role, navigation, language and colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from nicegui import ui

from hil.app.desk.roles import Role
from hil.app.panel.question import draw_question
from hil.app.panel.texts import LANGUAGES
from hil.app.panel.view import View


@dataclass(frozen=True)
class Page:
    """One page. name: in its address, and key of its title (`page.<name>` in the texts); draw: draws its elements.

    several: shown with several axes only.
    """

    name: str
    draw: Callable[[View], None]
    several: bool = False


def draw_page(view: View, page: Page, pages: Sequence[Page]) -> None:
    """Draw frame and content of a page."""
    ui.dark_mode(view.browser.dark)
    ui.page_title(f"{view.desk.name} · {view.t(f'page.{page.name}')}")
    _draw_lost(view)
    _draw_stop(view)
    with ui.header(elevated=False).classes("hil-header"):
        with ui.column().classes("gap-1 w-full"):
            _draw_axes(view, page)
            _draw_control(view)
        _draw_navigation(view, page, pages)
    draw_question(view)
    page.draw(view)


def _draw_lost(view: View) -> None:
    """A warning that the page's own script shows when a stop did not reach the server."""
    lost = view.named(ui.element("div").classes("hil-lost").props("hidden role=alert"), "stop-lost")
    with lost:
        ui.label(view.t("stop.lost"))


def _draw_stop(view: View) -> None:
    with view.named(ui.element("button").props(f'aria-label="{view.t("stop.hint")}"'), "stop"):
        ui.label(view.t("stop.stop"))
        ui.label(view.t("stop.keys")).style("font-size: 1rem; font-weight: 400; letter-spacing: 0")


def _draw_axes(view: View, page: Page) -> None:
    with ui.row().classes("items-center hil-nav gap-2"):
        for desk in view.desks:
            here = " here" if desk is view.desk else ""
            ui.link(view.t("header.axis", name=desk.name), f"/axis/{desk.name}/{page.name}").classes(here)
        state = view.named(ui.label().classes("hil-name"), "header.state")
        job = view.named(ui.label().classes("hil-name"), "header.job")

    def refresh() -> None:
        live = view.desk.live
        trouble = view.t("header.lost", why=live.trouble) if live.trouble else view.t(f"state.{live.state.name}")
        state.set_text(trouble if live.connected or live.trouble else view.t("header.connecting"))
        job.set_text(_doing(view))

    view.every(refresh)


def _doing(view: View) -> str:
    """The running job; else how the axis came to rest after the last stop; "" for neither."""
    now, rest, t = view.desk.job(), view.desk.came_to_rest, view.t
    if now is not None and now.running:
        return t("header.stopping") if now.stopping else t("header.running", job=t(f"job.{_key(now.kind)}"))
    if rest is None:
        return ""
    return t("stop.rest", milliseconds=t.number(1e3 * rest.after_s, 0), way=t.number(rest.way_mm, 2))


def _key(kind: str) -> str:
    return kind.replace(" ", "_")


# -- control and role --------------------------------------------------------------------------------------------------
def _draw_control(view: View) -> None:
    """The holder of control, and the buttons that apply."""
    with ui.row().classes("items-center gap-2"):
        who = view.named(ui.label(), "control.who")
        take = view.button("control.take", lambda: _take(view))
        release = view.button("control.release", lambda: view.desk.control.release(view.token))
        over = view.button("control.take_over", lambda: _take_over(view))
        builder = view.button("role.become_builder", lambda: _ask_passwords(view))
        operator = view.button("role.become_operator", lambda: view.desk.become_operator(view.token))
        _draw_looks(view)

    def refresh() -> None:
        holder, mine = view.desk.control.holder(), view.in_control
        if mine:
            who.set_text(view.t(f"role.mine.{view.desk.rights.role.value}"))
        else:
            who.set_text(view.t("control.free") if holder is None else view.t("control.held", name=holder.name))
        take.set_visibility(holder is None)
        release.set_visibility(mine)
        over.set_visibility(holder is not None and not mine and holder.lost)
        builder.set_visibility(mine and view.desk.rights.role is Role.OPERATOR)
        operator.set_visibility(view.is_builder)
        if view.client.has_socket_connection:  # the server keeps a page for a while after its browser has gone
            view.desk.control.sign_of_life(view.token)

    view.every(refresh)


def _name(view: View) -> str:
    return view.t("control.browser", number=view.browser.number)


def _take(view: View) -> None:
    view.browser.tokens[view.desk.name] = view.desk.control.take(_name(view))


async def _take_over(view: View) -> None:
    if await view.ask([view.t("control.ask_take_over"), view.t("plan.ask")]):
        view.browser.tokens[view.desk.name] = view.desk.control.take_over(_name(view))


async def _ask_passwords(view: View) -> None:
    """Ask for the passwords of the builder's role: of the key, and of the tables where they are to be changed."""
    fields = ("role.key_password", "role.reading_password")
    given = await view.ask_passwords(*fields, yes="role.yes", why="role.why")
    if given is not None:
        token = view.token
        await view.attempt(lambda: view.in_worker_thread(lambda: view.desk.become_builder(token, *given)))


# -- looks and navigation ----------------------------------------------------------------------------------------------
def _draw_looks(view: View) -> None:
    def speak(language: str) -> None:
        view.browser.language = language
        ui.navigate.reload()

    def light() -> None:
        view.browser.dark = not view.browser.dark
        ui.navigate.reload()

    language = ui.select(LANGUAGES, value=view.t.language, on_change=lambda event: speak(event.value))
    view.named(language.props("dense borderless"), "language")
    view.button("button.light" if view.browser.dark else "button.dark", light, name="looks").props("outline")


def _draw_navigation(view: View, here: Page, pages: Sequence[Page]) -> None:
    with view.named(ui.row().classes("hil-nav w-full gap-1"), "navigation"):
        for one in (page for page in pages if len(view.desks) > 1 or not page.several):
            link = ui.link(view.t(f"page.{one.name}"), f"/axis/{view.desk.name}/{one.name}")
            link.classes("here" if one is here else "")
