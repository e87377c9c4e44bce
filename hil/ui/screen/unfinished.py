"""The card of interrupted work on top of a page: what, since when, how much is measured; to go on with it, or to discard it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from nicegui import ui

from hil.desk.plan import text_key
from hil.desk.unfinished import UnfinishedWork
from hil.ui.screen.pieces import FolderContents
from hil.ui.screen.view import Button, View


@dataclass(frozen=True)
class GoOn:
    """How a page goes on with one kind of work. key: of the button's text, and its name; why_not: why it cannot be pressed now."""

    key: str
    action: Callable[[], object]
    why_not: Callable[[], str]


def draw_unfinished(view: View, page: str, go_on: Mapping[str, GoOn] | None = None) -> Callable[[], bool]:
    """Draw the card; returns whether it shows any.

    page: prefix of the names; go_on: of this page, by kind of work; None: every kind, with the way to its page
    """
    t = view.t
    card = view.named(ui.element("section").classes("hil-card hil-left"), f"{page}.left_over")
    kept: FolderContents[tuple[UnfinishedWork, ...]] = FolderContents(view, partial(_interrupted, view))
    shown: list[tuple[UnfinishedWork, ...]] = [()]
    buttons: list[tuple[Button, Callable[[], str]]] = []
    card.set_visibility(False)

    def control() -> str:
        return "" if view.in_control else t("why.control")

    def draw_work(work: UnfinishedWork) -> None:
        with ui.element("div").classes("hil-line"):
            ui.label(_words(view, work)).classes("hil-wide")
            if go_on is None:
                ui.link(t("overview.go_to"), f"/axis/{view.desk.name}/{work.page}").classes("hil-link")
            else:
                way = go_on[work.kind]
                buttons.append((view.button(way.key, way.action).classes("hil-go"), way.why_not))
            if work.rows is not None:
                discard = view.button("overview.discard", partial(_discard, view, work, kept))
                buttons.append((view.named(discard, f"{page}.discard.{work.kind}"), control))

    def refresh() -> None:
        found = tuple(one for one in kept.value or () if go_on is None or one.kind in go_on)
        if found != shown[0]:
            shown[0] = found
            buttons.clear()
            card.clear()
            card.set_visibility(bool(found))
            with card:
                ui.label(t("overview.unfinished", count=len(found))).classes("hil-name")
                for one in found:
                    draw_work(one)
        for button, why_not in buttons:
            button.allow(why_not())

    view.every(refresh)
    return lambda: bool(shown[0])


async def _discard(view: View, work: UnfinishedWork, kept: FolderContents[tuple[UnfinishedWork, ...]]) -> None:
    """Ask with what is lost, then give it up."""
    t = view.t
    lines = [t("overview.ask_discard", work=_words(view, work), rows=work.rows), t("overview.discard_lost")]
    if await view.ask(lines, t("go.discard")):
        view.desk.discard(view.token, work)
        kept.again()


def _words(view: View, work: UnfinishedWork) -> str:
    since = "" if work.since is None else work.since.strftime("%Y-%m-%d %H:%M")
    return view.t(f"overview.left.{text_key(work.kind)}", place=work.place, since=since)


def _interrupted(view: View) -> tuple[UnfinishedWork, ...]:
    """Interrupted work; none while a job runs, which may be resuming it."""
    job = view.desk.job()
    return () if job is not None and job.running else view.unfinished(view.desk.axis)
