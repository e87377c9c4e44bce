"""The screen's page on parameter sets: backup, compare, verify, download, store, restore, resume and rollback."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from nicegui import events, ui

from hil.app.jobs.job import Job
from hil.app.panel.pieces import Reading, Table
from hil.app.panel.view import View
from hil.parameters import job as parameters
from hil.parameters.job import LARGEST_BYTES, keep_set, require_size, set_files
from hil.parameters.journal import Download
from hil.parameters.page_data import ParameterRow, parameters_screen
from hil.parameters.set_file import ParameterSet

Refresh = Callable[[], None]
COLUMNS = ("address", "name", "held", "wanted", "unit", "outcome")
FIGURES = ("held", "wanted")


@dataclass(frozen=True)
class Stored:
    """Contents of the axis's folder: files with sets, and an interrupted download."""

    sets: tuple[Path, ...]
    cut_off: Download | None


def draw(view: View) -> None:
    """Draw the page."""
    with view.card("parameters.instructions"):
        ui.markdown(view.t("parameters.steps"))
    messages = view.messages("parameters.messages")
    stored = Reading(view, lambda: Stored(set_files(view.desk.axis), parameters.unfinished(view.desk.axis)))
    parts = [_draw_interrupted(view, stored)]
    with view.card("parameters.set"):
        choice = _draw_choice(view, stored)
        parts.append(_draw_buttons(view, choice))
    parts += [_draw_outcome(view), _draw_differences(view)]

    def refresh() -> None:
        shown = parameters_screen(view.desk)
        messages.show(shown.job, "\n".join(map(view.t.said, shown.warnings)))
        for part in parts:
            part()

    view.every(refresh)


def _draw_interrupted(view: View, stored: Reading[Stored]) -> Refresh:
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
            button.set_enabled(view.can_start and view.is_builder)

    return refresh


async def _recover(view: View, *, forward: bool) -> None:
    await view.ask_and_run(parameters.recover_job(view.desk.axis, forward=forward))


def _draw_choice(view: View, stored: Reading[Stored]) -> ui.select:
    """Choice of the file with the set: a stored one, or an upload."""
    axis = view.desk.axis
    with ui.row().classes("items-center hil-fields"):
        choice = ui.select({}, label=view.t("parameters.file")).style("min-width: 26rem")
        view.named(choice, "parameters.file")
        brought: list[str] = []

        async def bring(event: events.UploadEventArguments) -> None:
            async def keep() -> None:
                view.desk.control.require(view.token)
                require_size(event.file.name, event.file.size())
                brought[:] = [str(keep_set(axis, event.file.name, await event.file.read()))]

            await view.attempt(keep)
            stored.again()

        upload = ui.upload(
            label=view.t("parameters.bring"), on_upload=bring, auto_upload=True, max_file_size=LARGEST_BYTES
        )
        view.named(upload.classes("hil-upload").props("flat accept=.toml,.dcf,.cdcf"), "parameters.bring")

    def offer() -> None:
        found = {} if stored.value is None else {str(path): path.name for path in stored.value.sets}
        if found != choice.options:
            choice.set_options(found, value=choice.value if choice.value in found else None)
        if brought and brought[0] in found:
            choice.set_value(brought.pop())

    view.every(offer)
    return choice


def _draw_buttons(view: View, choice: ui.select) -> Refresh:
    """Buttons of the jobs. Those that write to the drive need the builder's role."""
    axis = view.desk.axis

    def chosen() -> ParameterSet:
        return parameters.load_set(str(choice.value), axis)

    def with_set(make: Callable[[ParameterSet], Job]) -> Callable[[], Awaitable[bool]]:
        return lambda: view.ask_and_run(make(chosen()))

    def looking(kind: str) -> Callable[[], None]:
        return lambda: view.desk.run(view.token, parameters.compare_job(axis, chosen(), kind))

    with ui.row():
        backup = view.button("parameters.backup", lambda: view.ask_and_run(parameters.backup_job(axis)))
        comparing = [
            view.button("parameters.compare", looking(parameters.COMPARE)),
            view.button("parameters.verify", looking(parameters.VERIFY)),
        ]
        writing = [
            view.button("parameters.download", with_set(lambda contents: parameters.download_job(axis, contents))),
            view.button("parameters.store", with_set(lambda contents: parameters.store_job(axis, contents))),
        ]
        restore = view.button("parameters.restore", lambda: view.ask_and_run(parameters.restore_job(axis)))

    def refresh() -> None:
        can, builder, there = view.can_start, view.is_builder, bool(choice.value)
        backup.set_enabled(can)
        restore.set_enabled(can and builder)
        for button in comparing:
            button.set_enabled(can and there)
        for button in writing:
            button.set_enabled(can and there and builder)

    return refresh


def _draw_outcome(view: View) -> Refresh:
    """Progress and outcome of the job."""
    t = view.t
    with ui.element("div").classes("hil-grid"):
        with view.card("parameters.drive"):
            outcome = view.value("parameters.outcome", small=True)
            backup = view.named(ui.label().classes("hil-name"), "parameters.backed_up")
        with view.card("parameters.differences", name="parameters.counts"):
            differing = view.value("parameters.differing")
            same = view.value("parameters.same", small=True)
        with view.card("parameters.progress", name="parameters.progress.card"):
            step = view.value("parameters.step", small=True)
            bar = ui.linear_progress(value=0.0, show_value=False).props("size=24px rounded")
            view.named(bar, "parameters.progress")

    def refresh() -> None:
        shown = parameters_screen(view.desk)
        job, kept = shown.job, shown.backup
        outcome.set_text(t(f"parameters.outcomes.{shown.outcome}") if shown.outcome else "–")
        figures = {} if kept is None else {"count": kept.parameters, "path": kept.path, "left": kept.unreadable}
        backup.set_text("" if kept is None else t("parameters.backed_up", **figures))
        differing.set_text("–" if shown.differing is None else str(shown.differing))
        same.set_text("–" if shown.same is None else str(shown.same))
        step.set_text(view.stage(job))
        bar.set_value(0.0 if job is None or not job.total else round(job.done / job.total, 3))

    return refresh


def _draw_differences(view: View) -> Refresh:
    with view.card("parameters.differences"):
        heads, figures = ([f"parameters.head.{name}" for name in names] for names in (COLUMNS, FIGURES))
        table = Table(view, "parameters.table", heads, figures=figures, tall=True)
    drawn: list[tuple[int, object]] = []  # the job whose rows are there, and how far it was

    def refresh() -> None:
        shown = parameters_screen(view.desk)
        if shown.job is not None and drawn != [(shown.job.number, shown.job.phase)]:
            drawn[:] = [(shown.job.number, shown.job.phase)]
            table.show([_cells(view, row) for row in shown.rows])

    return refresh


def _cells(view: View, row: ParameterRow) -> list[str]:
    outcome = row.why or view.t(f"parameters.rows.{row.outcome}")
    return [row.address, row.name, row.held, row.wanted, row.unit, outcome]
