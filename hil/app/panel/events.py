"""The log of events on the screen: a drawer that every page has, and the alarms that stand, each with cause and remedy."""

from __future__ import annotations

import csv
import io
from functools import partial

from nicegui import ui

from hil.desk.desk import Desk
from hil.desk.event_log import LogEntry, LogKind
from hil.desk.plan import text_key
from hil.ui.screen.view import View

FILTERS = ("all", "alarm", "job", "write")
SIGNS = {
    LogKind.ALARM: "!",
    LogKind.JOB: "▷",
    LogKind.WRITE: "✎",
    LogKind.STOP: "■",
    LogKind.CONTROL: "◦",
    LogKind.ACKNOWLEDGED: "✓",
}
MOST_SHOWN = 100


def sentence(view: View, entry: LogEntry) -> str:
    """What happened, in the page's language."""
    figures = {
        name: view.t.known("job", text_key(text)) if name == "job" else text for name, text in entry.figures.items()
    }
    return view.t(f"event.{entry.what}", axis=entry.axis, **figures)


def draw_events(view: View) -> None:
    """Draw the button of the bar and the drawer, closed at first."""
    t = view.t
    chosen, shown = ["all"], [(-1, "")]
    buttons: dict[str, ui.button] = {}
    drawer = view.named(ui.element("aside").classes("hil-drawer"), "events")
    drawer.move(view.client.content)
    drawer.set_visibility(False)

    def toggle() -> None:
        drawer.set_visibility(not drawer.visible)
        refresh()

    def choose(name: str) -> None:
        chosen[:] = [name]
        refresh()

    with ui.element("div").classes("hil-tools"):
        opening = view.button("events.open", toggle).props("flat")
    with drawer:
        with ui.element("div").classes("hil-line"):
            ui.label(t("events.title")).classes("hil-job-name")
            view.button("events.save", lambda: _save(view)).props("flat").classes("hil-end")
            view.button("events.close", toggle).props("flat")
        with ui.element("div").classes("hil-line"):
            for name in FILTERS:
                buttons[name] = view.button(f"events.filter.{name}", partial(choose, name)).props("flat")
        rows = view.named(ui.element("div").classes("hil-log"), "events.rows")

    def refresh() -> None:
        alarms = sum(len(desk.events.alarms()) for desk in view.desks)
        opening.say(t("events.open") + (f" {alarms}" if alarms else ""))
        now = (sum(desk.events.number for desk in view.desks), chosen[0])
        if not drawer.visible or shown == [now]:
            return
        shown[:] = [now]
        for name, button in buttons.items():
            button.classes(replace="here" if name == chosen[0] else "")
        rows.clear()
        with rows:
            for entry in entries(view, chosen[0])[:MOST_SHOWN]:
                _draw_entry(view, entry)

    view.every(refresh)


def entries(view: View, which: str) -> list[LogEntry]:
    """The entries of all axes of one filter, the newest first."""
    found = [entry for desk in view.desks for entry in desk.events.entries()]
    return sorted(
        (entry for entry in found if which in ("all", entry.kind.value)), key=lambda one: one.time, reverse=True
    )


def _draw_entry(view: View, entry: LogEntry) -> None:
    with ui.element("div").classes(f"hil-entry {entry.kind.value}"):
        ui.label(entry.time.astimezone().strftime("%Y-%m-%d %H:%M:%S")).classes("hil-name")
        ui.label(SIGNS[entry.kind])
        ui.label(entry.axis)
        with ui.element("div"):
            ui.label(sentence(view, entry))
            more = [entry.who, view.t.said(entry.cause), view.t(f"remedy.{entry.remedy}") if entry.remedy else ""]
            ui.label(" · ".join(filter(None, more))).classes("hil-name")


def _save(view: View) -> None:
    """All entries as CSV, in the page's language."""
    out = io.StringIO()
    table = csv.writer(out)
    table.writerow(["time", "axis", "kind", "event", "who", "cause", "remedy"])
    for entry in entries(view, "all"):
        remedy = view.t(f"remedy.{entry.remedy}") if entry.remedy else ""
        table.writerow(
            [entry.when, entry.axis, entry.kind.value, sentence(view, entry), entry.who, entry.cause, remedy]
        )
    ui.download(out.getvalue().encode("utf-8-sig"), "events.csv", "text/csv")


def draw_alarm(view: View) -> None:
    """Draw the latest alarm that stands, of any axis: what, when, where, why, and what to do. It is there until it is acknowledged."""
    t = view.t
    shown: list[tuple[Desk, LogEntry]] = []
    card = view.named(ui.element("section").classes("hil-alarm").props("role=alert"), "alarm")
    with card:
        ui.label("!").classes("hil-alarm-sign")
        with ui.element("div"):
            what = view.named(ui.label().classes("hil-alarm-what"), "alarm.what")
            cause = view.named(ui.label(), "alarm.cause")
            remedy = view.named(ui.label(), "alarm.remedy")
        view.button("alarm.acknowledge", lambda: _acknowledge(view, shown))

    def refresh() -> None:
        standing = [(desk, entry) for desk in view.desks for entry in desk.events.alarms()]
        found = max(standing, key=lambda one: one[1].time, default=None)
        card.set_visibility(found is not None)
        if found is None or shown == [found]:
            return
        shown[:] = [found]
        entry = found[1]
        what.set_text(f"{entry.axis}: {sentence(view, entry)}")
        when = entry.time.astimezone().strftime("%Y-%m-%d %H:%M:%S")
        cause.set_text(f"{when} · {t.said(entry.cause)}")
        remedy.set_text(t(f"remedy.{entry.remedy}") if entry.remedy else "")

    view.every(refresh)


def _acknowledge(view: View, shown: list[tuple[Desk, LogEntry]]) -> None:
    for desk, entry in shown:
        desk.events.acknowledge(entry.number, view.who)
