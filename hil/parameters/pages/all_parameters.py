"""All parameters of the drive as a list with search, and the field that changes one."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui

from drivers.errors import InputError
from hil.parameters import job as parameters
from hil.parameters.listing import ListedParameter, Listing, changed
from hil.parameters.page_data import ParametersScreen, parameters_screen
from hil.parameters.set_file import ParameterSet
from hil.ui.screen.pieces import Table
from hil.ui.screen.view import View

COLUMNS = ("address", "name", "value", "unit", "access")
Write = Callable[[ParameterSet], Awaitable[bool]]
"""Asks with old and new value and starts the download of a set; whether it was started."""


class AllParameters:
    """The list in its card. write: how a changed value goes to the drive."""

    def __init__(self, view: View, write: Write) -> None:
        self._view, self._write = view, write
        self._listing: Listing | None = None
        self._found: tuple[ListedParameter, ...] = ()
        self._chosen: ListedParameter | None = None
        with view.card("parameters.list"):
            with ui.element("div").classes("hil-row"):
                self._search = ui.input(view.t("parameters.search"), on_change=self._show)
                view.named(self._search.props("dense clearable debounce=200 type=search"), "parameters.search")
                self._search.on("keydown.enter", lambda: self._choose(0))
                self._read = view.button("parameters.read", self._read_drive)
            heads = [f"parameters.head.{name}" for name in COLUMNS]
            figures = ("parameters.head.value",)
            self._table = Table(view, "parameters.all", heads, figures=figures, tall=True, on_row=self._choose)
            self._empty = view.named(ui.label().classes("hil-empty"), "parameters.list.empty")
            self._as_of = view.named(ui.label().classes("hil-name"), "parameters.list.at")
            self._editor = view.named(ui.element("div").classes("hil-row hil-edit"), "parameters.edit")
            with self._editor:
                self._what = view.named(ui.label(), "parameters.edit.what")
                self._field = view.named(ui.input(view.t("parameters.new")), "parameters.edit.value")
                self._field.props("dense").on("keydown.enter", lambda: view.attempt(self._change))
                self._button = view.button("parameters.change", self._change).classes("hil-go")
        self._show()

    def refresh(self) -> None:
        """Show the latest list, and what can be pressed."""
        view, shown = self._view, parameters_screen(self._view.desk)
        self._read.allow(view.why_not())
        if shown.listing is not None and shown.listing is not self._listing:
            self._take(shown.listing)
        self._as_of.set_text(self._said_of(shown))
        if self._chosen is not None:
            self._button.allow(view.why_not(builder=True) or _why_not(view, self._chosen))

    def _said_of(self, shown: ParametersScreen) -> str:
        if self._listing is None:
            return ""
        figures = {"count": len(self._found), "all": len(self._listing.parameters)}
        later = shown.latest is not None and shown.latest.kind != parameters.READ
        key = "parameters.list_old" if later else "parameters.list_at"
        return self._view.t(key, time=self._listing.at.strftime("%H:%M:%S"), **figures)

    def _read_drive(self) -> None:
        self._view.desk.run(self._view.token, parameters.read_job(self._view.desk.axis))

    def _take(self, listing: Listing) -> None:
        """Show a new list; what was chosen stays so."""
        chosen = None if self._chosen is None else self._chosen.entry.address
        self._listing = listing
        self._chosen = next((one for one in listing.parameters if one.entry.address == chosen), None)
        self._show()

    def _show(self) -> None:
        """Show what the search finds."""
        listing, words = self._listing, str(self._search.value or "")
        self._found = () if listing is None else tuple(one for one in listing.parameters if one.has(words))
        self._table.show([_cells(self._view, one) for one in self._found])
        self._empty.set_visibility(not self._found)
        self._empty.set_text(self._view.t("parameters.not_listed" if listing is None else "parameters.none_found"))
        self._show_chosen()

    def _choose(self, number: int) -> None:
        """Choose a row for editing."""
        if number < len(self._found):
            self._chosen = self._found[number]
            self._field.set_value("")
            self._show_chosen()

    def _show_chosen(self) -> None:
        one, t = self._chosen, self._view.t
        self._editor.set_visibility(one is not None)
        self._table.mark(None if one is None or one not in self._found else self._found.index(one))
        if one is None:
            return
        parts = [one.title, f"{one.value} {one.entry.unit}".rstrip()]
        parts.append(t("parameters.limits", limits=one.limits) if one.limits and not one.refusal else "")
        parts += [t.said(why) for why in (one.refusal, one.error) if why]
        self._what.set_text(" · ".join(filter(None, parts)))
        self._field.set_visibility(not one.refusal)
        self._button.set_visibility(not one.refusal)

    async def _change(self) -> None:
        """Ask with old and new value, write, and read the list again."""
        if self._chosen is None or self._listing is None or not str(self._field.value or "").strip():
            raise InputError(self._view.t("field.empty", field=self._view.t("parameters.new")))
        if await self._write(changed(self._listing, self._chosen, str(self._field.value))):
            await self._view.ended(parameters.DOWNLOAD)
            self._read_drive()


def _cells(view: View, one: ListedParameter) -> list[str]:
    access = "read" if one.refusal else "write"
    return [one.entry.address, one.info.name, one.value, one.entry.unit, view.t(f"parameters.access.{access}")]


def _why_not(view: View, one: ListedParameter) -> str:
    return view.t("why.not_readable") if one.error else ""
