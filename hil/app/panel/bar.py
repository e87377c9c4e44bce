"""The status bar of every page: axes by state, job with step and time, control, events, language. And the rail of the pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from nicegui import ui

from drivers.drive import DriveState
from hil.app.panel.events import draw_events
from hil.desk.desk import Desk
from hil.desk.plan import text_key
from hil.desk.progress import Phase, Progress
from hil.desk.roles import Role
from hil.desk.unfinished import UnfinishedWork
from hil.ui.screen.pieces import FolderContents, ask_for_builder, show_share, take_control
from hil.ui.screen.texts import LANGUAGES, Texts
from hil.ui.screen.view import View

S_PER_MIN, S_PER_H = 60, 3600
CHINESE, FALL_BACK = "zh", "en"
NO_CHINESE = "hil-no-chinese"
"""Event of a browser without a font for it."""
ICONS = {"idle": "○", "enabled": "●", "running": "▶", "wait": "?", "fault": "!", "stopped": "■", "nodata": "⊘"}
"""A sign for each state, beside its colour and its word."""
_STOPPED = (DriveState.QUICK_STOP,)
_FAULT = (DriveState.FAULT, DriveState.FAULT_REACTION)


@dataclass(frozen=True)
class Page:
    """One page. name: in its address, and key of its title (`page.<name>` in the texts); draw: draws its elements.

    several: shown with several axes only; jobs: first words of the kinds of jobs that it starts, those of no page are jobs of the
    calibration; resumes: kinds of campaigns that it goes on with.
    """

    name: str
    draw: Callable[[View], None]
    several: bool = False
    jobs: tuple[str, ...] = ()
    resumes: tuple[str, ...] = ()


def axis_state(desk: Desk) -> str:
    """The state of an axis, of `ICONS`: the worst of those that hold."""
    live, job = desk.live, desk.job()
    running = job is not None and job.running
    if not live.connected and not running:
        return "nodata"
    if live.state in _FAULT or desk.events.alarms():
        return "fault"
    if live.state in _STOPPED:
        return "stopped"
    if desk.question is not None:
        return "wait"
    if running or live.moving:
        return "running"
    return "enabled" if live.state is DriveState.ENABLED else "idle"


def duration(t: Texts, seconds: float | None) -> str:
    """A time as m:ss, from an hour on h:mm:ss; a dash for none."""
    if seconds is None:
        return "–"
    whole = round(seconds)
    hours, minutes, rest = whole // S_PER_H, whole // S_PER_MIN % S_PER_MIN, whole % S_PER_MIN
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def draw_bar(view: View, page: Page) -> None:
    bar = view.named(ui.element("header").classes("hil-bar"), "bar")
    with bar:
        with ui.element("nav").classes("hil-axes"):
            chips = [_draw_axis(view, desk, page) for desk in view.desks]
        job = _draw_job(view)
        _draw_control(view)
        draw_events(view)
        _draw_looks(view)
    shown = [""]

    def refresh() -> None:
        for chip in chips:
            chip()
        job()
        state = axis_state(view.desk)
        if shown != [state]:
            shown[:] = [state]
            bar.classes(replace=f"hil-bar {state}")

    view.every(refresh)


def _draw_axis(view: View, desk: Desk, page: Page) -> Callable[[], None]:
    here = " here" if desk is view.desk else ""
    with ui.link(target=f"/axis/{desk.name}/{page.name}").classes(f"hil-axis{here}"):
        ui.label(desk.name).classes("hil-axis-name")
        chip = view.live(view.named(ui.label().classes("hil-chip"), f"chip.{desk.name}"), "drive", desk)
        chip.props["data-stale"] = f"{ICONS['nodata']} {view.t('chip.nodata')}"
    shown = [""]

    def refresh() -> None:
        state = axis_state(desk)
        if shown != [state]:
            shown[:] = [state]
            chip.classes(replace=f"hil-chip {state}")
            chip.set_text(f"{ICONS[state]} {view.t(f'chip.{state}')}")

    return refresh


def _draw_job(view: View) -> Callable[[], None]:
    t, desk = view.t, view.desk
    with view.live(ui.element("div").classes("hil-job"), "drive"):
        with ui.element("div").classes("hil-line"):
            job = view.named(ui.label().classes("hil-job-name"), "header.job")
            number = view.named(ui.label().classes("hil-job-step"), "header.number")
            step = view.named(ui.label().classes("hil-cut"), "header.step")
            percent = view.named(ui.label().classes("hil-end"), "header.percent")
        track = view.named(
            ui.linear_progress(0.0, show_value=False, size="9px", color=None).props("rounded"), "header.progress"
        )
        with ui.element("div").classes("hil-line"):
            state = view.named(ui.label(), "header.state")
            elapsed = view.named(ui.label().classes("hil-end"), "header.elapsed")
            left = view.named(ui.label().classes("hil-end"), "header.left")

    def refresh() -> None:
        live, now = desk.live, desk.job()
        running = now is not None and now.running
        word = t("header.lost", why=t.said(live.trouble)) if live.trouble else t(f"state.{live.state.name}")
        state.set_text(word if live.connected or live.trouble else t("header.connecting"))
        job.set_text(_doing(view))
        of = now.step if now is not None and running and not now.stopping and now.step != (1, 1) else None
        number.set_text("" if of is None else t("bar.step", number=of[0], count=of[1]))
        number.set_visibility(of is not None)
        step.set_text(view.stage(now) if now is not None and running else _last(view, now))
        track.set_visibility(now is not None)
        counted = now is not None and now.phase is not Phase.WITHOUT_RESULT
        percent.set_text(f"{t.number(100.0 * now.share, 0)} %" if now is not None and counted else "")
        show_share(track, now)
        elapsed.set_text(
            "" if now is None else t("bar.elapsed" if running else "bar.took", time=duration(t, now.elapsed_s))
        )
        left.set_text(t("bar.left", time=duration(t, now.left_s)) if now is not None and running and now.left_s else "")

    return refresh


def _doing(view: View) -> str:
    """The running job; else how the axis came to rest after the last stop; else that there is none."""
    now, rest, t = view.desk.job(), view.desk.came_to_rest, view.t
    if now is not None and now.running:
        return t("header.stopping") if now.stopping else t(f"job.{text_key(now.kind)}")
    if view.desk.computed.running:
        return t("bar.computing", seconds=t.number(view.desk.computed.seconds, 0))
    if rest is None:
        return t("bar.no_job")
    return t("stop.rest", milliseconds=t.number(1e3 * rest.after_s, 0), way=t.number(rest.way_mm, 2))


def _last(view: View, job: Progress | None) -> str:
    return (
        ""
        if job is None
        else view.t("bar.last", job=view.t(f"job.{text_key(job.kind)}"), how=view.t(f"phase.{job.phase.value}"))
    )


# -- the rail ----------------------------------------------------------------------------------------------------------
def draw_rail(view: View, here: Page, pages: Sequence[Page]) -> None:
    """Draw the links to the pages, with a mark where a job runs or work is unfinished."""
    marks: dict[str, ui.label] = {}
    with view.named(ui.element("nav").classes("hil-rail").props(f"lang={view.t.language}"), "navigation"):
        for one in (page for page in pages if len(view.desks) > 1 or not page.several):
            with ui.link(target=f"/axis/{view.desk.name}/{one.name}").classes("here" if one is here else ""):
                ui.label(view.t(f"page.{one.name}"))
                marks[one.name] = ui.label().classes("hil-mark")
    kept: FolderContents[tuple[UnfinishedWork, ...]] = FolderContents(view, lambda: view.unfinished(view.desk.axis))
    shown: dict[str, str] = {}

    def refresh() -> None:
        job, left = view.desk.job(), {one.page for one in kept.value or ()}
        for name, mark in marks.items():
            of_it = job is not None and _page_of(job, pages) == name
            running = of_it and job is not None and job.running
            failed = of_it and job is not None and job.phase is Phase.FAILED and bool(view.desk.events.alarms())
            state = "running" if running else "fault" if failed else "wait" if name in left else ""
            if shown.get(name) != state:
                shown[name] = state
                mark.classes(replace=f"hil-mark {state}")
                mark.set_text(ICONS[state] if state else "")

    view.every(refresh)


def _page_of(job: Progress, pages: Sequence[Page]) -> str:
    return next((page.name for page in pages if job.kind.startswith(page.jobs)), "calibrate")


# -- control and role --------------------------------------------------------------------------------------------------
def _draw_control(view: View) -> None:
    """The holder of control, and the buttons that apply."""
    with ui.element("div").classes("hil-tools"):
        who = view.named(ui.label().classes("hil-who"), "control.who")
        take = view.button("control.take", partial(take_control, view))
        release = view.button("control.release", lambda: _release(view))
        over = view.button("control.take_over", lambda: _take_over(view))
        builder = view.button("role.become_builder", partial(ask_for_builder, view))
        operator = view.button("role.become_operator", lambda: view.desk.become_operator(view.token))

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


def _release(view: View) -> None:
    view.desk.release_control(view.token, view.who)


async def _take_over(view: View) -> None:
    if await view.ask([view.t("control.ask_take_over")], view.t("go.take_over")):
        view.browser.tokens[view.desk.name] = view.desk.take_control(view.who, over=True)


def _draw_looks(view: View) -> None:
    def speak(language: str) -> None:
        view.browser.language, view.browser.undrawn = language, False
        ui.navigate.reload()

    def fall_back() -> None:
        """Instead of Chinese as boxes: English, and a note on top of the page; the choice names it in letters."""
        browser, asked = view.browser, view.t.language == CHINESE
        browser.chinese, browser.undrawn = False, browser.undrawn or asked
        if asked:
            browser.language = FALL_BACK
            ui.navigate.reload()
        else:
            language.set_options(_languages(view), value=view.t.language)

    def light() -> None:
        view.browser.dark = not view.browser.dark
        ui.navigate.reload()

    with ui.element("div").classes("hil-looks"):
        language = ui.select(_languages(view), value=view.t.language, on_change=lambda event: speak(event.value))
        view.named(language.props("dense borderless"), "language")
        key = "button.light" if view.browser.dark else "button.dark"
        looks = (
            view.button(key, light, name="looks")
            .props("flat")
            .props(f'aria-label="{view.t(key)}" title="{view.t(key)}"')
        )
        looks.say("◐")
    ui.on(NO_CHINESE, fall_back)
    view.client.run_javascript(f"hilDrawsChinese() || emitEvent('{NO_CHINESE}')")


def _languages(view: View) -> dict[str, str]:
    return LANGUAGES if view.browser.chinese else {**LANGUAGES, CHINESE: view.t("language.chinese")}
