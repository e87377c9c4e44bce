"""Tables entered by hand: typed or brought as a file, stored as they are or beside a calibration."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from nicegui import events, ui

from drivers.errors import InputError
from drivers.files import decode_text
from hil.axis.axis_file import AxisConfig
from hil.calibration import job as calibrate
from hil.calibration.job import STRAIGHTNESS, Across, TablePart, beside_stored, kept_text, manual_tables, parts_of
from hil.calibration.straightness import StraightnessResult
from hil.correction.compensation import Compensation
from hil.correction.manual import read_backlash, read_signs, read_straightness
from hil.correction.tables import DirectionalTable, SignedSections, SingleTable
from hil.desk.job import Job
from hil.ui.screen.pieces import FolderContents, Latest, ScreenTable
from hil.ui.screen.view import Refresh, View

TYPED, TYPED_STRAIGHTNESS = "typed-tables.csv", "typed-straightness.csv"
TYPED_BACKLASH, TYPED_SIGNS = "typed-backlash.csv", "typed-signs.csv"
"""Files in the axis's folder that keep what was typed here."""
LARGEST_BYTES = 1_000_000


def across_axis(view: View, axis: AxisConfig) -> Across:
    """With its own tables as far as they are opened at its desk here. Raises InputError for an axis file without [straightness]."""
    across = Across.of(axis, None)
    at = next((desk for desk in view.desks if desk.axis.path.resolve() == across.axis.path.resolve()), None)
    return across if at is None else replace(across, store=at.rights.store)


async def across_of(view: View, axis: AxisConfig) -> Across | None:
    """None where the stored tables move no other axis. Raises what opening them raises."""
    store = view.desk.rights.store
    if axis.straightness is None or store is None:
        return None
    stored = await view.in_worker_thread(store.stored)
    return across_axis(view, axis) if isinstance(stored, Compensation) and stored.moves_axis else None


def asking(view: View, across: Across | None) -> Callable[[Job], Awaitable[bool]]:
    """Asks and starts a job; one that connects that axis too is lent the axis's desk, where the server has it."""
    if across is None:
        return view.ask_and_run
    path = across.axis.path.resolve()
    return partial(view.ask_and_run, lent=[desk for desk in view.desks if desk.axis.path.resolve() == path])


class TypedTables:
    """What is entered by hand, typed or brought as a file: tables (manual mode), a straightness correction and a backlash measured by
    other means, which are also stored with a calibration, and the signs of its specified value."""

    def __init__(self, view: View, axis: AxisConfig) -> None:
        self._view, self._axis = view, axis
        self._areas: dict[str, ui.textarea] = {}

    def draw(self) -> Refresh:
        """Draws the card, closed at first; returns its refresh."""
        view, t = self._view, self._view.t
        stored = FolderContents(view, self._stored)
        with (
            view.card("calibrate.manual.title", name="calibrate.manual"),
            ui.expansion(t("calibrate.manual.open")) as more,
        ):
            view.named(more, "calibrate.manual.more")
            ui.markdown(t("calibrate.manual.steps"))
            with ui.element("div").classes("hil-grid wide"):
                for name in ("table", "backlash", "straightness"):
                    self._area(name)
                if self._axis.correction.band is not None:
                    self._area("signs", _signs_csv(self._axis.correction.signs))
                parts = ScreenTable(
                    view, "calibrate.stored", [f"calibrate.stored.{name}" for name in ("part", "figures")], words=2
                )
            with ui.row().classes("items-center"):
                upload = ui.upload(
                    label=t("calibrate.manual.bring"),
                    on_upload=self._bring,
                    on_rejected=self._refused,
                    auto_upload=True,
                    max_file_size=LARGEST_BYTES,
                )
                view.named(upload.classes("hil-upload").props("flat accept=.csv"), "calibrate.manual.bring")
                store = view.button("calibrate.manual.store", self._store)
                enter = view.button("calibrate.manual.enter", self._enter)
                withdraw = view.button("calibrate.manual.withdraw", self._withdraw).props("outline")
                correction = self._axis.correction
                form = "split" if correction.straightness_share else "combined" if correction.combined else "separate"
                view.named(ui.label(t(f"calibrate.form.{form}")).classes("hil-name"), "calibrate.manual.form")
            straight = view.value("calibrate.straight", "µm", small=True)
        opened: list[object] = []
        latest = Latest()

        def refresh() -> None:
            rights = view.desk.rights
            now = rights.store if view.in_control else None
            writable = now is not None and now.builder_key is not None
            why_not = view.why_not(builder=True) or ("" if writable else t("why.tables"))
            store.allow(why_not)
            for button in (enter, withdraw):
                button.allow(why_not or ("" if stored.value else t("why.nothing_stored")))
            if opened != [now]:
                opened[:] = [now]
                stored.again()
            if latest.is_new(stored.value):
                parts.show(
                    [[t(f"calibrate.part.{name}"), _short(view, one)] for name, one in (stored.value or {}).items()]
                )
            job = view.desk.last(STRAIGHTNESS)
            found = None if job is None else job.result
            if isinstance(found, StraightnessResult):
                before, after = found.before, found.after
                figures = [
                    f"{t.number(one.range_um, 2)} ± {t.number(one.range_expanded_um, 2)}" for one in (before, after)
                ]
                straight.set_text(" → ".join(figures))

        return refresh

    def straightness(self) -> DirectionalTable | None:
        """The typed straightness correction, None for none. Raises InputError naming the line."""
        path = self._kept("straightness", TYPED_STRAIGHTNESS)
        return None if path is None else read_straightness(path)

    def backlash(self) -> SingleTable | None:
        """The typed backlash, None for none. Raises InputError naming the line."""
        path = self._kept("backlash", TYPED_BACKLASH)
        return None if path is None else read_backlash(path)

    def signs(self) -> tuple[SignedSections, ...]:
        """The signs that stand there now, at first the axis file's. Raises InputError naming the line."""
        return read_signs(self._axis.store.directory / TYPED_SIGNS, self._text("signs"))

    def _text(self, name: str) -> str:
        return str(self._areas[name].value or "") if name in self._areas else ""

    def _kept(self, name: str, file: str) -> Path | None:
        """The file that keeps what was typed, None where nothing was."""
        text = self._text(name)
        return kept_text(self._axis, file, text) if text.strip() else None

    def _area(self, name: str, text: str = "") -> None:
        key = f"calibrate.manual.{name}"
        with ui.element("div"):
            ui.label(self._view.t(key)).classes("hil-name")
            area = ui.textarea(value=text).props("outlined").classes("full-width")
            self._areas[name] = self._view.named(area, key)

    def _stored(self) -> dict[str, TablePart]:
        """The parts of the stored tables, as far as this browser may read them."""
        store = self._view.desk.rights.store if self._view.in_control else None
        stored = None if store is None else store.stored()
        return {} if stored is None else parts_of(stored.tables)

    async def _bring(self, event: events.UploadEventArguments) -> None:
        async def fill() -> None:
            self._view.desk.control.require(self._view.token)
            text = decode_text(await event.file.read(), event.file.name, older=True)
            columns = {
                "straightness": "deviation_um",
                "signs": "from_mm",
                "table": "plus_um",
                "backlash": "backlash_um",
            }
            name = next((name for name, column in columns.items() if column in text and name in self._areas), "table")
            self._areas[name].set_value(text)

        await self._view.attempt(fill)

    def _refused(self) -> None:
        limit = self._view.t.number(LARGEST_BYTES / 1e6, 1)
        self._view.show_error(InputError(self._view.t("parameters.refused", kinds=".csv", megabytes=limit)))

    async def _store(self) -> None:
        """Asks, part by part with what is stored now and what will be, and stores."""
        path = kept_text(self._axis, TYPED, self._text("table"))
        tables = manual_tables(self._axis, path, self.straightness(), self.backlash())
        await self._ask_and_run(calibrate.manual_job(self._axis, tables), parts_of(tables))

    async def _enter(self) -> None:
        """Asks, and enters the backlash beside the stored pitch."""
        store, backlash = self._view.desk.rights.store, self.backlash()
        if store is None or backlash is None:
            raise InputError(self._view.t("field.empty", field=self._view.t("calibrate.manual.backlash")))
        how = partial(beside_stored, store, self._axis, backlash, alone=False)
        entered = await self._view.in_worker_thread(how)
        if isinstance(entered, Compensation):
            await self._ask_and_run(calibrate.entering_job(self._axis, backlash), parts_of(entered.tables))

    async def _withdraw(self) -> None:
        """Asks, and takes what is stored out of force."""
        await self._ask_and_run(calibrate.withdrawal_job(self._axis), {})

    async def _ask_and_run(self, job: Job, new: Mapping[str, TablePart]) -> None:
        """new: the parts that will be stored, shown beside those of now."""
        view, t = self._view, self._view.t
        read = await view.in_worker_thread(self._stored)
        old: dict[str, TablePart] = read if isinstance(read, dict) else {}
        lines = [
            t(
                "calibrate.change",
                part=t(f"calibrate.part.{name}"),
                old=_short(view, old.get(name)),
                new=_short(view, new.get(name)),
            )
            for name in dict.fromkeys((*old, *new))
        ]
        await view.ask_and_run(job, changes=lines)


def _signs_csv(signs: Sequence[SignedSections]) -> str:
    """As `read_signs` reads it."""
    rows = [f"{one.from_mm!r},{one.to_mm!r},{one.plus:d},{one.minus:d}" for one in signs]
    return "\n".join(["from_mm,to_mm,plus,minus", *rows, ""])


def _short(view: View, part: TablePart | None) -> str:
    """A part in short, with its unit; a dash for none."""
    t = view.t
    if part is None:
        return "–"
    return t("calibrate.short", low=t.number(part.low_um, 2), high=t.number(part.high_um, 2), places=part.places)
