"""Elements shared by several pages: position and step of the axis, contents of its folder, results, tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Generic, TypeVar

from nicegui import run, ui
from nicegui.element import Element

from drivers.instrument import ReadingStatus
from hil.axis.axis_file import AxisConfig
from hil.desk.desk import Desk
from hil.desk.progress import Progress
from hil.ui.screen.campaigns import Measurement
from hil.ui.screen.view import Button, View


def draw_where(
    view: View, page: str, job: Callable[[], Progress | None], *, progress: bool = False
) -> Callable[[], None]:
    """Draw the card with the axis's position and the present step; returns its refresh function. page: prefix of the names; job:
    whose step is shown; progress: with a bar that says how far it is."""
    with view.card(f"{page}.where", live="drive"):
        with ui.element("div").classes("hil-lines"):
            position = view.value("overview.position", "mm", small=True, name=f"{page}.position")
            remaining = view.value("overview.remaining", "mm", small=True, name=f"{page}.remaining")
        ui.label(view.t(f"{page}.step")).classes("hil-name")
        step = view.named(ui.label("–"), f"{page}.step")
        bar = (
            view.named(ui.linear_progress(0.0, show_value=False, size="12px", color=None), f"{page}.progress")
            if progress
            else None
        )

    def refresh() -> None:
        shown = job()
        position.set_text(view.t.number(view.desk.live.position_load_mm))
        remaining.set_text(view.t.number(view.desk.live.remaining_mm))
        step.set_text(view.stage(shown))
        if bar is not None:
            show_share(bar, shown)

    return refresh


def show_share(bar: ui.linear_progress, job: Progress | None) -> None:
    """How far a job is, in the colour of how it runs or ended."""
    bar.set_value(0.0 if job is None else round(job.share, 3))
    bar.classes(replace="" if job is None else job.phase.value)


def lead(main: Button | None, buttons: Sequence[Button]) -> None:
    """Make one of these the main button, that of the next step, and none of them for None."""
    for button in buttons:
        button.classes(add="hil-go" if button is main else "", remove="" if button is main else "hil-go")


class Tabs:
    """The jobs of one page, of which one is shown at a time. keys: of their names; the first is shown at first."""

    def __init__(self, view: View, page: str, keys: Sequence[str]) -> None:
        self._buttons: dict[str, Button] = {}
        with ui.element("nav").classes("hil-tabs"):
            for key in keys:
                self._buttons[key] = view.button(f"{page}.tab.{key}", partial(self.show, key)).props("flat")
        self._panels: dict[str, Element] = {key: ui.element("div").classes("hil-tab") for key in keys}
        self.show(keys[0])

    def panel(self, key: str) -> Element:
        """The place of a job's elements; use with `with`."""
        return self._panels[key]

    def show(self, key: str) -> None:
        for name, panel in self._panels.items():
            panel.set_visibility(name == key)
            self._buttons[name].classes(remove="" if name == key else "here", add="here" if name == key else "")


class Steps:
    """The steps of a job, one beside the other: what is done, what runs, what comes.

    keys: of their names, "steps.<page>.<key>"; usual: how many a job has that does not number them, None for all
    """

    def __init__(self, view: View, page: str, keys: Sequence[str], usual: int | None = None) -> None:
        self._usual = len(keys) if usual is None else usual
        self._boxes: list[Element] = []
        with view.named(ui.element("ol").classes("hil-steps"), f"{page}.steps"):
            for number, key in enumerate(keys, start=1):
                with ui.element("li").classes("hil-step") as box:
                    ui.label(str(number)).classes("hil-step-number")
                    ui.label(view.t(f"steps.{page}.{key}")).classes("hil-step-name")
                self._boxes.append(box)
        self._shown: list[str] = []

    def show(self, states: Sequence[str]) -> None:
        """The state of each: "done", "now", "broken", or "" for one that comes."""
        for box, state in zip(self._boxes, states if list(states) != self._shown else (), strict=False):
            box.classes(replace=f"hil-step {state}")
        self._shown = list(states)

    def follow(self, job: Progress | None, before: Sequence[str] = ()) -> None:
        """Show how far a job is. before: the states without one."""
        count = self._usual if job is None or job.step is None else job.step[1]
        for number, box in enumerate(self._boxes, start=1):
            box.set_visibility(number <= count)
        if job is None:
            self.show([*before, *[""] * (count - len(before))])
        elif job.carried_out:
            self.show(["done"] * count)
        else:
            at = 0 if job.step is None else job.step[0]
            here = "now" if job.running else "broken"
            self.show(["done" if number < at else here if number == at else "" for number in range(1, count + 1)])


@dataclass(frozen=True)
class StartCondition:
    """A condition of a start. key: of what is missing, "ready.<key>"; fix: key of the button that puts it right, and what it does;
    figures: of places in that text, which are filled anew at each look."""

    key: str
    met: Callable[[], bool]
    fix: tuple[str, Callable[[], object]] | None = None
    done_by_itself: bool = False
    figures: Callable[[], dict[str, str]] = dict


def draw_ready(view: View, page: str, *more: StartCondition, builder: bool = False) -> Callable[[], None]:
    """Draw what is missing for a start, each with the button that puts it right, or that nothing is; returns its refresh. builder: the
    job needs the builder's role; more: further conditions."""
    desk = view.desk

    def held(*, elsewhere: bool) -> bool:
        return not view.in_control and (desk.control.holder() is not None) is elsewhere

    checks = [
        StartCondition("control", lambda: not held(elsewhere=False), ("control.take", partial(take_control, view))),
        StartCondition("control_elsewhere", lambda: not held(elsewhere=True)),
        StartCondition("connection", lambda: desk.live.connected),
    ]
    if builder:
        fix = ("role.become_builder", partial(ask_for_builder, view))
        checks.append(StartCondition("builder", lambda: not view.in_control or view.is_builder, fix))
    checks += more
    with view.named(ui.element("ul").classes("hil-ready"), f"{page}.ready") as box:
        rows = [(check, _draw_check(view, page, check)) for check in checks]
        with ui.element("li").classes("met") as all_met:
            ui.label(view.t("ready.all")).classes("hil-wide")

    def refresh() -> None:
        job = view.desk.job()
        box.set_visibility(job is None or not job.running)
        missing = {check.key for check, _ in rows if not check.met()}
        for check, (row, text) in rows:
            row.set_visibility(check.key in missing)
            text.set_text(view.t(f"ready.{check.key}", **check.figures()))
        all_met.set_visibility(not missing)

    return refresh


def _draw_check(view: View, page: str, check: StartCondition) -> tuple[Element, ui.label]:
    """Its row, and the text in it."""
    with ui.element("li").classes("itself" if check.done_by_itself else "missing") as row:
        text = view.named(ui.label().classes("hil-wide"), f"{page}.ready.{check.key}")
        if check.fix is not None:
            key, action = check.fix
            view.button(key, action, name=key if key.startswith(f"{page}.") else f"{page}.fix.{check.key}")
    return row, text


_USABLE = (None, ReadingStatus.GOOD, ReadingStatus.LOST_BEFORE)
"""States of the instrument's signal with which a job can begin: it acknowledges a loss."""


def measured_checks(view: View) -> tuple[StartCondition, ...]:
    """Conditions of a job that measures with the instrument: its signal; and that the axis is homed by the job, if it is not yet."""
    desk = view.desk
    return (
        StartCondition("signal", lambda: desk.live.instrument_status in _USABLE),
        StartCondition("homing", lambda: desk.live.homed is not False, done_by_itself=True),
    )


def tables_check(view: View, corrects: Callable[[], bool] = lambda: True) -> StartCondition:
    """Condition of a job that corrects: the tables can be read. corrects: whether the job does. The password is not kept."""

    async def ask() -> None:
        given = await view.ask_passwords("calibrate.password", yes="calibrate.password.yes", go="go.tables")
        if given is not None:
            token = view.token
            await view.attempt(lambda: view.in_worker_thread(lambda: view.desk.read_tables(token, *given)))

    readable = lambda: not corrects() or view.desk.rights.store is not None or not view.in_control  # noqa: E731
    return StartCondition("tables", readable, ("calibrate.open", ask))


def take_control(view: View) -> None:
    """Take control of the axis. Raises ControlHeldError."""
    view.browser.tokens[view.desk.name] = view.desk.take_control(view.who)


async def ask_for_builder(view: View) -> None:
    """Ask for the passwords of the builder's role: of the key, and of the tables where they are to be changed."""
    fields = ("role.key_password", "role.reading_password")
    given = await view.ask_passwords(*fields, yes="role.yes", go="go.builder", why="role.why")
    if given is not None:
        token = view.token
        await view.attempt(lambda: view.in_worker_thread(lambda: view.desk.become_builder(token, *given)))


def tables_written(desk: Desk) -> datetime | None:
    """When the stored tables were written, by their file; None without a file. Reads the disk."""
    path = desk.axis.tables_path if isinstance(desk.axis, AxisConfig) else None
    return datetime.fromtimestamp(path.stat().st_mtime).astimezone() if path is not None and path.exists() else None


def measurement_words(view: View, one: Measurement) -> str:
    """What was measured, in words: the job, and which of its measurements where it has several."""
    job = view.t.known("job", one.kind)
    name = one.key.rpartition("/")[2]
    part = "" if name == one.kind else view.t.measurement(name, one.kind)
    return f"{job}, {part}" if part else job


Found = TypeVar("Found")
LOOK_S = 0.5


class FolderContents(Generic[Found]):
    """Contents of the axis's folder for a page: read in a worker thread, again after each job and computation.

    value: the last contents, None before the first reading. They are of what was there when that reading began: while a job runs, and
    for a moment after it, `current` is False.
    """

    def __init__(self, view: View, read: Callable[[], Found]) -> None:
        self._view, self._read = view, read
        self._of: object = None
        self._read_of: object = None
        self.value: Found | None = None
        ui.timer(LOOK_S, self._look)

    def again(self) -> None:
        self._of = None

    @property
    def current(self) -> bool:
        """Whether no job or computation has begun or ended since the contents were read."""
        return self._read_of == self._now()

    def _now(self) -> tuple[object, ...]:
        job, computed = self._view.desk.job(), self._view.desk.computed
        return None if job is None else (job.number, job.phase), computed.number, computed.running

    async def _look(self) -> None:
        now = self._now()
        if now == self._of:
            return
        self._of = now
        await self._view.attempt(self._read_aside)

    async def _read_aside(self) -> None:
        now = self._now()
        self.value = await run.io_bound(self._read)
        self._read_of = now


class Latest:
    """The result shown at one place of a page. Results are compared by identity."""

    def __init__(self) -> None:
        self._shown: object = None

    def is_new(self, result: object) -> bool:
        """Whether the result is not shown yet; it then counts as shown. None is never new."""
        new = result is not None and result is not self._shown
        self._shown = result if new else self._shown
        return new


class ScreenTable:
    """A table. columns: keys of the headings; the first `words` columns are text, the others figures, unless `figures` names those.

    tall: with its own scroll bar; on_row: called with the number of a row that is pressed
    """

    def __init__(
        self,
        view: View,
        name: str,
        columns: Sequence[str],
        *,
        words: int = 1,
        figures: Sequence[str] | None = None,
        tall: bool = False,
        on_row: Callable[[int], None] | None = None,
    ) -> None:
        right = columns[words:] if figures is None else figures
        heads = [
            {"name": key, "label": view.t(key), "field": key, "align": "right" if key in right else "left"}
            for key in columns
        ]
        self._columns = tuple(columns)
        self._table = ui.table(columns=heads, rows=[], row_key="row").classes("hil-table")
        self._table.props("flat dense wrap-cells hide-bottom :rows-per-page-options=[0]")
        if tall:
            self._table.props("virtual-scroll").classes("tall")
        if on_row is not None:
            self._table.classes("hil-choice")
            self._table.on("rowClick", lambda event: on_row(int(event.args[1]["row"])), [[], ["row"], None])
        view.named(self._table, name)

    def mark(self, number: int | None) -> None:
        """Mark a row as chosen, None for none."""
        self._table.selected = [] if number is None else [self._table.rows[number]]

    def show(self, rows: Sequence[Sequence[str]]) -> None:
        self._table.rows = [
            {"row": number, **dict(zip(self._columns, row, strict=True))} for number, row in enumerate(rows)
        ]
        self._table.update()
