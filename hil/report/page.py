"""Page with campaigns, reports and history of the axis: make a report, compare two campaigns, open and save reports."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from fastapi import FastAPI
from fastapi.responses import FileResponse, PlainTextResponse, Response
from nicegui import ui

from hil.axis.axis_file import AxisConfig
from hil.desk.desk import Desk
from hil.desk.worker_process import Passes, Work
from hil.report.job import COMPARE, FOLDER, HISTORY, HISTORY_FIGURES, NAME, REPORT
from hil.report.page_data import AxisHistory, ReportFile, ReportsScreen, reports_screen
from hil.ui.screen.campaigns import Measurement
from hil.ui.screen.drawings import Curve, Options, RedrawnChart, curves
from hil.ui.screen.pieces import FolderContents, measurement_words
from hil.ui.screen.view import Refresh, View

Kept = FolderContents[ReportsScreen]
MARKS = ("circle", "rect", "diamond")
OURS = (REPORT.name, COMPARE.name, HISTORY.name)
COLUMNS = ("begun", "what", "rows", *HISTORY_FIGURES, "state")


def draw(view: View) -> None:
    axis = view.desk.axis
    if not isinstance(axis, AxisConfig):
        view.named(ui.label(view.t("reports.no_instrument")).classes("hil-note"), "reports.no_instrument")
        return
    kept: Kept = FolderContents(view, lambda: reports_screen(axis.store.directory, axis.name))
    above = ui.element("div").classes("full-width")  # a long list leaves the buttons in the window
    with view.card("reports.campaigns", name="reports.campaigns.card").classes("full-width"):
        table = _table(view)
    with above:
        parts = [_draw_buttons(view, kept, table), _fill(view, kept, table)]
    with ui.element("div").classes("hil-grid wide"):
        parts += [_draw_files(view, kept), _draw_history(view, kept)]

    view.every(*parts)


def _table(view: View) -> ui.table:
    """Table of all measurements, the newest first, with a choice."""
    words = ("begun", "what", "state")
    heads = [
        {
            "name": name,
            "label": view.t(f"reports.head.{name}"),
            "field": name,
            "align": "left" if name in words else "right",
        }
        for name in COLUMNS
    ]
    table = ui.table(columns=heads, rows=[], row_key="key", selection="multiple", pagination=5).classes("hil-table")
    table.props(
        f'flat dense wrap-cells rows-per-page-label="{view.t("reports.per_page")}" no-data-label="{view.t("reports.nothing")}"'
    )
    table.props(":pagination-label=\"(first, last, all) => first + '–' + last + ' / ' + all\"")
    table.props(":selected-rows-label=\"() => ''\"")
    return view.named(table, "reports.campaigns")


def _fill(view: View, kept: Kept, table: ui.table) -> Refresh:
    shown: list[ReportsScreen] = []

    def refresh() -> None:
        screen = kept.value
        if screen is None or shown == [screen]:
            return
        shown[:] = [screen]
        table.rows = [_row(view, one) for one in screen.measurements]
        known = {one.key for one in screen.measurements}
        table.selected = [row for row in table.selected if row["key"] in known]
        table.update()

    return refresh


def _row(view: View, one: Measurement) -> dict[str, Any]:
    t = view.t
    return {
        "begun": one.begun.strftime("%Y-%m-%d %H:%M"),
        "what": measurement_words(view, one),
        "key": one.key,
        "rows": one.rows,
        **{name: t.number(one.figures_um.get(name), 2) for name in HISTORY_FIGURES},
        "state": t(f"reports.state.{one.state}"),
    }


def _draw_buttons(view: View, kept: Kept, table: ui.table) -> Refresh:
    """Buttons: report of the chosen measurements, comparison of two, history."""
    t, desk = view.t, view.desk

    def chosen() -> list[Passes]:
        """The chosen measurements in the order of time."""
        keys = {row["key"] for row in table.selected}
        found = () if kept.value is None else kept.value.measurements
        return [Passes(one.key, one.paths) for one in reversed(found) if one.key in keys]

    def make(work: Work) -> None:
        desk.compute(view.token, work, [] if work is HISTORY else chosen())

    with ui.row().classes("items-center"):
        report = view.button("reports.report", partial(make, REPORT))
        compare = view.button("reports.compare", partial(make, COMPARE))
        history = view.button("reports.make_history", partial(make, HISTORY))
        cancel = view.button("reports.cancel", lambda: desk.cancel_computing(view.token)).props("outline")
        status = view.named(ui.label().classes("hil-name"), "reports.status")
    messages = view.named(ui.label().classes("hil-note bad"), "reports.messages")

    def refresh() -> None:
        now, count = desk.computed, len(table.selected)
        free = view.in_control and not now.running
        why = "" if free else t("why.computing" if view.in_control else "why.control")
        report.allow(why or ("" if count > 0 else t("why.no_campaign")))
        compare.allow(why or ("" if count == 2 else t("why.two_campaigns")))
        there = kept.value is not None and kept.value.history is not None
        history.allow(why or ("" if there else t("why.nothing_measured")))
        cancel.set_visibility(now.running and view.in_control)
        made = t("reports.made", files=", ".join(now.made)) if now.made and now.work in OURS else ""
        status.set_text(
            t("diagnosis.computing", seconds=t.number(now.seconds, 0)) if now.running else made or t("reports.choose")
        )
        failed = bool(now.error) and now.work in OURS
        messages.set_text(t.said(now.error) if failed else "")
        messages.set_visibility(failed)

    return refresh


def _draw_files(view: View, kept: Kept) -> Refresh:
    """Card with all reports, each with links to open and save it."""
    with view.card("reports.files", name="reports.files.card"):
        box = view.named(ui.element("div"), "reports.files")
    shown: list[tuple[ReportFile, ...]] = []

    def refresh() -> None:
        files = () if kept.value is None else kept.value.reports
        if kept.value is None or shown == [files]:
            return
        shown[:] = [files]
        box.clear()
        with box:
            if not files:
                ui.label(view.t("reports.none")).classes("hil-name")
            for number, one in enumerate(files, start=1):
                _draw_file(view, number, one)

    return refresh


def _draw_file(view: View, number: int, one: ReportFile) -> None:
    t, axis = view.t, view.desk.name
    with (
        ui.row()
        .classes("items-center full-width no-wrap hil-nav")
        .style("border-bottom: 1px solid var(--line); min-height: 52px")
    ):
        with ui.element("div").style("flex: 1"):
            ui.label(f"{t(f'reports.kind.{one.kind}')} {one.name.partition('-')[2].removesuffix('.html')}").style(
                "font-size: 1.15rem"
            )
            ui.label(one.made.strftime("%Y-%m-%d %H:%M")).classes("hil-name")
        opened = ui.link(t("reports.open"), address(axis, one.name), new_tab=True)
        view.named(opened.style("color: var(--mark); font-weight: 600"), f"reports.open.{number}")
        if one.paper:
            paper = ui.link(t("reports.paper"), address(axis, one.paper, save=True))
            view.named(paper.style("color: var(--mark); font-weight: 600"), f"reports.paper.{number}")


def _draw_history(view: View, kept: Kept) -> Refresh:
    """Card with the figures over time and their trend lines."""
    with view.card("reports.history", name="reports.history.card"):
        drawing = RedrawnChart(view, "reports.history")
        trend = view.named(ui.label().style("white-space: pre-line; font-size: 1.15rem"), "reports.trend")

    def refresh() -> None:
        history = None if kept.value is None else kept.value.history
        if history is None:
            return
        drawing.show(history, partial(_options, view, history))
        trend.set_text("\n".join(_trend(view, history, name) for name in HISTORY_FIGURES))

    return refresh


def _options(view: View, history: AxisHistory) -> Options:
    t = view.t
    drawn = [
        Curve(name, history.points(name), number, mark)
        for number, (name, mark) in enumerate(zip(HISTORY_FIGURES, MARKS, strict=True))
    ]
    lines = [
        Curve(t("reports.line", figure=name), history.line(name), number)
        for number, name in enumerate(HISTORY_FIGURES)
        if history.line(name)
    ]
    x = t("reports.days", begun=history.begun.strftime("%Y-%m-%d"), name=t.measurement(history.usual))
    return curves(view, x, t("reports.figure_y"), [*drawn, *lines])


def _trend(view: View, history: AxisHistory, name: str) -> str:
    t, found = view.t, history.trends[name]
    if found is None:
        return t("reports.no_trend", figure=name)
    slope, std = t.number(found.slope_um, 2, sign=True), t.number(2.0 * found.std_um, 2)
    return t("reports.trend", figure=name, slope=slope, spread=std)


ALONE = {"Content-Security-Policy": "sandbox allow-scripts allow-modals", "X-Content-Type-Options": "nosniff"}
"""Headers that keep a report's page from the screen's cookies and from requests to the server."""


def serve_reports(app: FastAPI, desks: Mapping[str, Desk]) -> None:
    """Add the addresses /axis/<axis>/reports/<name>; with ?save the file is downloaded."""

    @app.get("/axis/{axis}/reports/{name}")
    async def report(axis: str, name: str, save: str | None = None) -> Response:
        path = desks[axis].axis.store.directory / FOLDER / name if axis in desks and NAME.fullmatch(name) else None
        if path is None or not path.is_file():
            return PlainTextResponse("there is no such report", status_code=404)
        kind = "attachment" if save is not None else "inline"
        return FileResponse(path, headers=ALONE, filename=f"{axis}-{name}", content_disposition_type=kind)


def address(axis: str, name: str, *, save: bool = False) -> str:
    """Address of a report's file. save: for download."""
    return f"/axis/{axis}/reports/{name}" + ("?save" if save else "")
