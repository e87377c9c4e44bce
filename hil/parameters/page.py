"""The screen's page on parameters: list, change, backup, compare, verify, download, store, restore, resume and rollback."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from nicegui import events, ui

from drivers.errors import InputError
from hil.axis.axis_file import DriveAxis
from hil.desk.job import Job
from hil.parameters import job as parameters
from hil.parameters.compare import Comparison
from hil.parameters.job import LARGEST_BYTES, backed_up_at, keep_set, require_size, set_files
from hil.parameters.journal import Download
from hil.parameters.listing import ListedParameter, Listing, changed, titled
from hil.parameters.outcome import BackedUp, Outcome, ParameterRow, kept_outcome
from hil.parameters.page_data import ParametersScreen, parameters_screen
from hil.parameters.set_file import ParameterSet
from hil.parameters.wiring import journal_of
from hil.ui.screen.pieces import FolderContents, ScreenTable, Tabs, show_share
from hil.ui.screen.view import Refresh, View

COLUMNS = ("address", "name", "held", "wanted", "unit", "outcome")
FIGURES = ("held", "wanted")
KINDS = ".toml,.dcf,.cdcf"
"""Ends of the names of files that may be brought."""
MOST_CHANGES = 12
"""Changes named in a question; the table below names all."""


@dataclass(frozen=True)
class ParameterFolder:
    """Contents of the axis's folder: files with sets, an interrupted download, whether a download can be taken back, and the outcome
    of the last job."""

    sets: tuple[Path, ...]
    cut_off: Download | None
    downloaded: bool
    outcome: Outcome | None


def _stored(axis: DriveAxis) -> ParameterFolder:
    downloaded = journal_of(axis).last_change() is not None
    return ParameterFolder(set_files(axis), parameters.unfinished(axis), downloaded, kept_outcome(axis))


def draw(view: View) -> None:
    """Draw the page: outcome, step, set and buttons beside the parameters that differ."""
    messages = view.messages("parameters.messages")
    stored = FolderContents(view, partial(_stored, view.desk.axis))
    parts = [_draw_interrupted(view, stored)]
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            parts += [_draw_outcome(view, stored), _draw_progress(view)]
            with view.card("parameters.set"):
                choice = _draw_choice(view, stored)
            parts.append(_draw_buttons(view, choice, stored))
        with ui.element("div").classes("hil-main"):
            parts.append(_draw_tables(view, stored))
            view.how("parameters.instructions", "parameters.steps")

    def tell() -> None:
        shown = _shown(view, stored)
        messages.show(shown.latest, "\n".join(map(view.t.said, shown.warnings)))

    view.every(tell, *parts)


def _shown(view: View, stored: FolderContents[ParameterFolder]) -> ParametersScreen:
    return parameters_screen(view.desk, None if stored.value is None else stored.value.outcome)


def _draw_interrupted(view: View, stored: FolderContents[ParameterFolder]) -> Refresh:
    """Card of an interrupted download, with the buttons to finish or undo it."""
    box = view.named(ui.element("section").classes("hil-card"), "parameters.interrupted")
    with box:
        note = view.named(ui.label().classes("hil-note bad"), "parameters.unfinished")
        with ui.row():
            finish = view.button("parameters.resume", lambda: _recover(view, forward=True))
            take_back = view.button("parameters.rollback", lambda: _recover(view, forward=False))

    def refresh() -> None:
        cut_off, job = None if stored.value is None else stored.value.cut_off, view.desk.job()
        # What a running download has in its journal is not cut off: only what is read once it is over counts.
        box.set_visibility(cut_off is not None and stored.current and not (job is not None and job.running))
        if cut_off is not None:
            note.set_text(view.t("parameters.unfinished", name=cut_off.set_name, began=cut_off.began))
        for button in (finish, take_back):
            button.allow(view.why_not(builder=True))

    return refresh


async def _recover(view: View, *, forward: bool) -> None:
    await view.ask_and_run(parameters.recover_job(view.desk.axis, forward=forward))


def _draw_choice(view: View, stored: FolderContents[ParameterFolder]) -> ui.select:
    """Choice of the file with the set: a stored one, or an upload."""
    axis = view.desk.axis
    with ui.element("div").classes("hil-set"):
        choice = ui.select({}, label=view.t("parameters.file")).props("dense options-dense")
        view.named(choice.classes("full-width"), "parameters.file")
        brought: list[str] = []

        async def bring(event: events.UploadEventArguments) -> None:
            async def keep() -> None:
                view.desk.control.require(view.token)
                require_size(event.file.name, event.file.size())
                brought[:] = [str(keep_set(axis, event.file.name, await event.file.read()))]

            choice.set_value(None)  # until the file is there: what was chosen before is not meant any more
            await view.attempt(keep)
            stored.again()

        def refused() -> None:
            limit = view.t.number(LARGEST_BYTES / 1e6, 1)
            view.show_error(InputError(view.t("parameters.refused", kinds=KINDS, megabytes=limit)))

        upload = ui.upload(
            label=view.t("parameters.bring"),
            on_upload=bring,
            on_rejected=refused,
            auto_upload=True,
            max_file_size=LARGEST_BYTES,
        )
        view.named(upload.classes("hil-upload").props(f"flat accept={KINDS}"), "parameters.bring")

    taken = [0]  # the last backup whose file was chosen

    def offer() -> None:
        backup = view.desk.last(parameters.BACKUP)
        if backup is not None and backup.number != taken[0] and isinstance(backup.result, BackedUp):
            taken[0] = backup.number
            brought[:] = [str(backup.result.path)]
            stored.again()
        found = {} if stored.value is None else {str(path): _set_words(view, path) for path in stored.value.sets}
        if found != choice.options:
            choice.set_options(found, value=choice.value if choice.value in found else None)
        if brought and brought[0] in found:
            choice.set_value(brought.pop())

    view.every(offer)
    return choice


def _set_words(view: View, path: Path) -> str:
    """A set by its file's name; a backup by its date."""
    at = backed_up_at(view.desk.axis, path)
    return path.name if at is None else view.t("parameters.backup_of", date=at.strftime("%Y-%m-%d %H:%M:%S"))


def _draw_buttons(view: View, choice: ui.select, stored: FolderContents[ParameterFolder]) -> Refresh:
    """Buttons of the jobs. Those that write to the drive need the builder's role."""
    axis = view.desk.axis

    def chosen() -> ParameterSet:
        return parameters.load_set(str(choice.value), axis)

    def with_set(make: Callable[[ParameterSet], Job]) -> Callable[[], Awaitable[bool]]:
        return lambda: _ask_with_changes(view, chosen(), make)

    def looking(kind: str) -> Callable[[], None]:
        return lambda: view.desk.run(view.token, parameters.compare_job(axis, chosen(), kind))

    with ui.element("div").classes("hil-buttons"):
        backup = view.button("parameters.backup", lambda: view.ask_and_run(parameters.backup_job(axis)))
        backup.classes("hil-go")
        comparing = [
            view.button("parameters.compare", looking(parameters.COMPARE)),
            view.button("parameters.verify", looking(parameters.VERIFY)),
        ]
        writing = [
            view.button("parameters.download", with_set(lambda contents: parameters.download_job(axis, contents))),
            view.button("parameters.store", with_set(lambda contents: parameters.store_job(axis, contents))),
        ]
        restore = view.button("parameters.restore", lambda: _restore(view))

    def refresh() -> None:
        no_file = "" if choice.value else view.t("why.no_file")
        backup.allow(view.why_not())
        downloaded = stored.value is not None and stored.value.downloaded
        restore.allow(view.why_not(builder=True) or ("" if downloaded else view.t("why.nothing_downloaded")))
        for button in comparing:
            button.allow(view.why_not() or no_file)
        for button in writing:
            button.allow(view.why_not(builder=True) or no_file)

    return refresh


async def _ask_with_changes(view: View, contents: ParameterSet, make: Callable[[ParameterSet], Job]) -> bool:
    """Compare the drive with the set, and ask with what differs: parameter, old and new value, unit; whether the job was started. A
    set that the drive would refuse is refused here."""
    job = make(contents)
    compared = await view.finished(parameters.compare_job(view.desk.axis, contents))
    if compared is None or not isinstance(compared.result, Comparison):
        return False  # the error is shown on the page
    if compared.result.objections:
        view.show_error(InputError(str(compared.result.objections[0])))
        return False
    rows = parameters_screen(view.desk).rows
    changes = [
        view.change(titled(row.address, row.name), row.held, row.wanted, row.unit) for row in rows[:MOST_CHANGES]
    ]
    if len(rows) > MOST_CHANGES:
        changes.append(view.t("parameters.more_changes", count=len(rows) - MOST_CHANGES))
    return await view.ask_and_run(job, changes=changes or [view.t("parameters.no_change")])


async def _restore(view: View) -> None:
    axis = view.desk.axis
    await _ask_with_changes(view, parameters.set_before_last(axis), lambda _contents: parameters.restore_job(axis))


def _draw_outcome(view: View, stored: FolderContents[ParameterFolder]) -> Refresh:
    """The outcome of the last job, and the numbers of parameters."""
    t = view.t
    with view.card("parameters.outcome", name="parameters.outcome.card"):
        outcome = view.named(ui.label("–").classes("hil-headline"), "parameters.outcome")
        with ui.element("div").classes("hil-lines"):
            differing = view.value("parameters.differing", small=True)
            same = view.value("parameters.same", small=True)
        backup = view.named(ui.label().classes("hil-name"), "parameters.backed_up")
        before = view.named(ui.label().classes("hil-name"), "parameters.kept")

    def refresh() -> None:
        shown = _shown(view, stored)
        kept, at = shown.backup, shown.at
        outcome.set_text(t(f"parameters.outcomes.{shown.outcome}") if shown.outcome else "–")
        figures = {} if kept is None else {"count": kept.parameters, "left": kept.unreadable}
        backup.set_text("" if kept is None else t("parameters.backed_up", **figures))
        before.set_text("" if at is None else t("parameters.kept", date=at.astimezone().strftime("%Y-%m-%d %H:%M")))
        differing.set_text("–" if shown.differing is None else str(shown.differing))
        same.set_text("–" if shown.same is None else str(shown.same))

    return refresh


def _draw_progress(view: View) -> Refresh:
    """The step of the running job, and how far it is."""
    with view.card("parameters.progress", name="parameters.progress.card"):
        step = view.named(ui.label("–"), "parameters.step")
        bar = ui.linear_progress(value=0.0, show_value=False, size="12px", color=None)
        view.named(bar, "parameters.progress")

    def refresh() -> None:
        job = parameters_screen(view.desk).latest
        step.set_text(view.stage(job))
        show_share(bar, job)

    return refresh


def _draw_tables(view: View, stored: FolderContents[ParameterFolder]) -> Refresh:
    """All parameters, and what the last job found or changed; what came last is turned to."""
    axis, tabs = view.desk.axis, Tabs(view, "parameters", ("all", "differences"))

    async def write(contents: ParameterSet) -> bool:
        started = await _ask_with_changes(view, contents, lambda one: parameters.download_job(axis, one))
        tabs.show("all")  # the comparison before the question turned away
        return started

    with tabs.panel("all"):
        listed = AllParameters(view, write)
    with tabs.panel("differences"):
        differences = _draw_differences(view, stored)
    turned = [parameters_screen(view.desk).latest]

    def refresh() -> None:
        listed.refresh()
        differences()
        job = parameters_screen(view.desk).latest
        if job is not None and not job.running and (turned[0] is None or turned[0].number != job.number):
            turned[:] = [job]
            tabs.show("all" if job.kind == parameters.READ else "differences")

    return refresh


def _draw_differences(view: View, stored: FolderContents[ParameterFolder]) -> Refresh:
    with view.card("parameters.differences"):
        heads, figures = ([f"parameters.head.{name}" for name in names] for names in (COLUMNS, FIGURES))
        table = ScreenTable(view, "parameters.table", heads, figures=figures, tall=True)
        none = view.named(ui.label().classes("hil-empty"), "parameters.none")
    drawn: list[object] = []  # the job whose rows are there, and how far it was; else the outcome of before

    def refresh() -> None:
        shown = _shown(view, stored)
        none.set_visibility(not shown.rows)
        none.set_text(view.t("parameters.none_differ" if shown.same is not None else "parameters.not_compared"))
        now = shown.at if shown.job is None else (shown.job.number, shown.job.phase)
        if drawn != [now]:
            drawn[:] = [now]
            table.show([_cells(view, row) for row in shown.rows])

    return refresh


def _cells(view: View, row: ParameterRow) -> list[str]:
    outcome = row.why or view.t(f"parameters.rows.{row.outcome}")
    return [row.address, row.name, row.held, row.wanted, row.unit, outcome]


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
            heads = [f"parameters.head.{name}" for name in ("address", "name", "value", "unit", "access")]
            figures = ("parameters.head.value",)
            self._table = ScreenTable(view, "parameters.all", heads, figures=figures, tall=True, on_row=self._choose)
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
        self._table.show([_listed_cells(self._view, one) for one in self._found])
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


def _listed_cells(view: View, one: ListedParameter) -> list[str]:
    access = "read" if one.refusal else "write"
    return [one.entry.address, one.info.name, one.value, one.entry.unit, view.t(f"parameters.access.{access}")]


def _why_not(view: View, one: ListedParameter) -> str:
    return view.t("why.not_readable") if one.error else ""
