"""Page of calibration and verification (system A): the plan in words, the errors while measured, figures before and
after, the band.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path

from nicegui import events, ui

from drivers.errors import InputError
from hil.app.desk.progress import Phase, Progress
from hil.app.jobs.job import Job
from hil.app.panel.drawings import Curve, Drawing, Options, curves
from hil.app.panel.pieces import (
    Check,
    Latest,
    Reading,
    Steps,
    Table,
    draw_ready,
    draw_where,
    measured_checks,
    tables_written,
)
from hil.app.panel.plots import JobPlot
from hil.app.panel.view import View
from hil.app.panel.zero_switches import ZeroSwitches
from hil.axis.axis_file import AxisConfig
from hil.calibration import job as calibrate
from hil.calibration.job import (
    CALIBRATE,
    ENTER,
    MANUAL,
    STRAIGHTNESS,
    UNCORRECTED,
    VERIFY,
    WITHDRAW,
    Across,
    Part,
    beside_stored,
    kept_text,
    manual_tables,
    parts_of,
    with_signs,
)
from hil.calibration.page_data import SHOWN, STAGES, CalibrationScreen, MeasuredStage, Resumable, calibration_screen
from hil.calibration.straightness import StraightnessResult
from hil.correction.compensation import Compensation
from hil.correction.manual import read_backlash, read_signs, read_straightness
from hil.correction.tables import Band, SignedSections, SingleTable
from hil.figures.verdict import Accuracy, Decision

Refresh = Callable[[], None]
Kept = Reading[CalibrationScreen]
KINDS = (CALIBRATE, VERIFY, UNCORRECTED)
SHOWN_KINDS = (*KINDS, STRAIGHTNESS, MANUAL, ENTER, WITHDRAW)
TYPED, TYPED_STRAIGHTNESS = "typed-tables.csv", "typed-straightness.csv"
TYPED_BACKLASH, TYPED_SIGNS = "typed-backlash.csv", "typed-signs.csv"
"""Files in the axis's folder that keep what was typed here."""
LARGEST_BYTES = 1_000_000
BAND, BAND_PLUS, BAND_MINUS = "#009e7333", "#0072b240", "#d55e0040"
"""Of the band: where both directions have one sign; of the + and of the − direction where they differ."""
_SIGN = {1: "+", -1: "−"}
COLOUR = {"before": 1, "after": 0, "verified": 2, "uncorrected": 4}
"""Colour of each stage's curves."""


def draw(view: View) -> None:
    """Draws the page."""
    axis = view.desk.axis
    if not isinstance(axis, AxisConfig):
        view.named(ui.label(view.t("calibrate.no_instrument")).classes("hil-note"), "calibrate.no_instrument")
        return
    kept: Kept = Reading(view, partial(calibration_screen, axis))
    messages = view.messages("calibrate.messages")
    typed = TypedTables(view, axis)
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            parts = [
                _draw_accuracy(view, kept),
                draw_where(view, "calibrate", lambda: view.desk.last_of(KINDS), progress=True),
                _draw_buttons(view, axis, kept, typed),
            ]
        with ui.element("div").classes("hil-main"):
            steps = Steps(view, "calibrate", ("found", "tables", "verified"))
            live = _draw_live(view)
            curves_card, curves_refresh = _draw_curves(view, axis, kept)
            view.how("calibrate.plan", "calibrate.steps")
    parts += [live.refresh, curves_refresh, _draw_band(view, axis, kept, typed), _draw_figures(view, axis, kept)]
    parts += [_draw_plan(view, axis), typed.draw()]

    def refresh() -> None:
        job = view.desk.last_of(KINDS)
        running = job is not None and job.running
        messages.show(view.desk.last_of(SHOWN_KINDS))
        steps.show(_steps(kept.value, job))
        live.card.set_visibility(running)
        curves_card.set_visibility(not running)
        for part in parts:
            part()

    view.every(refresh)


def _steps(screen: CalibrationScreen | None, job: Progress | None) -> list[str]:
    """The state of each step: what runs by the job, the others by what is on disk."""
    stages = {} if screen is None else screen.stages
    verified = screen is not None and screen.verified is not None
    states = ["done" if known else "" for known in ("before" in stages, "after" in stages, verified)]
    if job is None or job.phase is Phase.DONE or job.kind == UNCORRECTED:
        return states
    at = 2 if job.kind == VERIFY else 0 if job.step is None else job.step[0] - 1
    return [*states[:at], "now" if job.running else "broken", *[""] * (2 - at)]


@dataclass(frozen=True)
class LiveErrors:
    """The plot of the errors as they are measured, in its card."""

    card: ui.element
    plot: JobPlot

    def refresh(self) -> None:
        """Draw new points."""
        self.plot.refresh()


def _draw_live(view: View) -> LiveErrors:
    with view.card("calibrate.live", name="calibrate.live.card") as card:
        x, y = view.t("calibrate.plot_x"), view.t("calibrate.plot_y")
        return LiveErrors(card, JobPlot(view, KINDS, x, y, name="calibrate.live", dots=True))


def _draw_plan(view: View, axis: AxisConfig) -> Refresh:
    """The moves and writes of a calibration, in words, and whether the tables can be read and written."""
    t, rights = view.t, view.desk.rights
    with view.fold("calibrate.would"):
        lines = view.question(calibrate.calibration_plan(axis))
        view.named(ui.label("\n".join(lines)).classes("hil-note"), "calibrate.plan.lines")
        opened = view.named(ui.label().classes("hil-name"), "calibrate.opened")

    def refresh() -> None:
        store = rights.store if view.in_control else None
        state = "not_opened" if store is None else "readable" if store.builder_key is None else "writable"
        opened.set_text(t(f"calibrate.{state}"))

    return refresh


def _draw_buttons(view: View, axis: AxisConfig, kept: Kept, typed: TypedTables) -> Refresh:
    """Start, verify, resume, and the straightness by the instrument."""
    t, desk = view.t, view.desk
    zero: ZeroSwitches

    async def start_new() -> None:
        signed, straightness, backlash = with_signs(axis, typed.signs()), typed.straightness(), typed.backlash()
        job = calibrate.calibration_job(signed, straightness=straightness, backlash=backlash, zero=zero.said())
        await zero.run(view.ask_and_run, job)

    async def verify() -> None:
        corrects, of_targets, said = bool(corrected.value), int(view.number_of(seed)), zero.said(anew=False)
        across = await _across(view, axis) if corrects else None
        signed = with_signs(axis, typed.signs())
        job = calibrate.verification_job(signed, corrected=corrects, seed=of_targets, zero=said, across=across)
        await zero.run(_asking(view, across), job)

    async def measure_straightness() -> None:
        across = _across_axis(view, axis)
        job = calibrate.straightness_job(axis, across, seed=int(view.number_of(seed)), zero=zero.said(anew=False))
        await zero.run(_asking(view, across), job)

    async def resume(kind: str) -> None:
        await _resume(view, axis, kept, kind, zero, typed=typed)

    opened = lambda: desk.rights.store is not None or not view.in_control  # noqa: E731
    tables = Check("tables", opened, ("calibrate.open", lambda: _ask_password(view)))
    ready = draw_ready(view, "calibrate", tables, *measured_checks(view), builder=True)
    with ui.element("div").classes("hil-buttons"):
        start = view.button("calibrate.start", start_new).classes("hil-go")
        verifying = view.button("calibrate.verify", verify)
        resuming = {kind: view.button(f"calibrate.resume.{kind}", partial(resume, kind)) for kind in KINDS}
    with view.fold("calibrate.more"):
        straightening = view.button("calibrate.straighten", measure_straightness)
        straightening.set_visibility(axis.straightness is not None)
        corrected, show_correction = _draw_correction_switch(view)
        seed = view.named(
            ui.number(t("calibrate.seed"), value=1, min=0, max=10_000, precision=0), "calibrate.seed"
        ).style("width: 14rem")
        zero = ZeroSwitches(view, "calibrate", anew=True)

    def refresh() -> None:
        store = desk.rights.store if view.in_control else None
        writable = store is not None and store.builder_key is not None
        why_not, of_builder = view.why_not(), view.why_not(builder=True) or ("" if writable else t("why.tables"))
        for button in (start, straightening):
            button.allow(of_builder)
        verifying.allow(why_not or ("" if store is not None or not corrected.value else t("why.tables_read")))
        ready()
        show_correction()
        zero.refresh()
        unfinished = {} if kept.value is None else kept.value.unfinished
        readable = why_not or ("" if store is not None else t("why.tables_read"))
        hindered = {CALIBRATE: of_builder, VERIFY: readable, UNCORRECTED: why_not}
        for kind, button in resuming.items():
            button.set_visibility(kind in unfinished)
            button.allow(hindered[kind])

    return refresh


def _draw_correction_switch(view: View) -> tuple[ui.switch, Refresh]:
    """Whether a verification corrects. While one runs the switch says how it runs, whoever started it."""
    desk, kinds = view.desk, (VERIFY, UNCORRECTED)
    last = desk.last_of(kinds)
    with_it = last is None or not last.running or last.kind == VERIFY
    switch = view.named(ui.switch(view.t("calibrate.correction"), value=with_it), "calibrate.correction")

    def refresh() -> None:
        job = desk.job()
        under_way = job is not None and job.running and job.kind in kinds
        switch.set_enabled(not under_way)
        if under_way and job is not None:
            switch.set_value(job.kind == VERIFY)

    return switch, refresh


async def _resume(
    view: View, axis: AxisConfig, kept: Kept, kind: str, zero: ZeroSwitches, *, typed: TypedTables
) -> None:
    """Go on with the campaign that was broken off, with the targets, signs and backlash it was begun with."""
    begun = (kept.value.unfinished if kept.value is not None else {}).get(kind, Resumable("", 1))
    across, as_begun = None, with_signs(axis, begun.signs)
    if kind == CALIBRATE:
        straightness, backlash = typed.straightness(), begun.backlash
        job = calibrate.calibration_job(
            as_begun, straightness=straightness, backlash=backlash, resume=True, zero=zero.said()
        )
    else:
        said, across = zero.said(anew=False), await _across(view, axis) if kind == VERIFY else None
        how = {"corrected": kind == VERIFY, "resume": True}
        job = calibrate.verification_job(as_begun, seed=begun.seed, zero=said, across=across, **how)
    await zero.run(_asking(view, across), job)


# -- the axis that straightness moves ------------------------------------------------------------------------------------
def _across_axis(view: View, axis: AxisConfig) -> Across:
    """With its own tables as far as they are opened at its desk here. Raises InputError for an axis file without [straightness]."""
    across = Across.of(axis, None)
    at = next((desk for desk in view.desks if desk.axis.path.resolve() == across.axis.path.resolve()), None)
    return across if at is None else replace(across, store=at.rights.store)


async def _across(view: View, axis: AxisConfig) -> Across | None:
    """None where the stored tables move no other axis. Raises what opening them raises."""
    store = view.desk.rights.store
    if axis.straightness is None or store is None:
        return None
    stored = await view.in_worker_thread(store.stored)
    return _across_axis(view, axis) if isinstance(stored, Compensation) and stored.moves_axis else None


def _asking(view: View, across: Across | None) -> Callable[[Job], Awaitable[bool]]:
    """Asks and starts a job; one that connects that axis too is lent the axis's desk, where the server has it."""
    if across is None:
        return view.ask_and_run
    path = across.axis.path.resolve()
    return partial(view.ask_and_run, lent=[desk for desk in view.desks if desk.axis.path.resolve() == path])


# -- typed tables ----------------------------------------------------------------------------------------------------------
class TypedTables:
    """What is entered by hand, typed or brought as a file: tables (manual mode), a straightness correction and a backlash measured by
    other means, which are also stored with a calibration, and the signs of its specified value."""

    def __init__(self, view: View, axis: AxisConfig) -> None:
        self._view, self._axis = view, axis
        self._areas: dict[str, ui.textarea] = {}

    def draw(self) -> Refresh:
        """Draws the card, closed at first; returns its refresh."""
        view, t = self._view, self._view.t
        stored = Reading(view, self._stored)
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
                parts = Table(
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

    def straightness(self) -> SingleTable | None:
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
            area = ui.textarea(value=text).props("outlined").classes("w-full")
            self._areas[name] = self._view.named(area, key)

    def _stored(self) -> dict[str, Part]:
        """The parts of the stored tables, as far as this browser may read them."""
        store = self._view.desk.rights.store if self._view.in_control else None
        stored = None if store is None else store.stored()
        return {} if stored is None else parts_of(stored.tables)

    async def _bring(self, event: events.UploadEventArguments) -> None:
        async def fill() -> None:
            self._view.desk.control.require(self._view.token)
            text = (await event.file.read()).decode("utf-8-sig", "replace")
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

    async def _ask_and_run(self, job: Job, new: Mapping[str, Part]) -> None:
        """new: the parts that will be stored, shown beside those of now."""
        view, t = self._view, self._view.t
        read = await view.in_worker_thread(self._stored)
        old: dict[str, Part] = read if isinstance(read, dict) else {}
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


def _short(view: View, part: Part | None) -> str:
    """A part in short, with its unit; a dash for none."""
    t = view.t
    if part is None:
        return "–"
    return t("calibrate.short", low=t.number(part.low_um, 2), high=t.number(part.high_um, 2), places=part.places)


async def _ask_password(view: View) -> None:
    """Asks for the reading password of the tables; it is not kept."""
    given = await view.ask_passwords("calibrate.password", yes="calibrate.password.yes", go="go.tables")
    if given is not None:
        token = view.token
        await view.attempt(lambda: view.in_worker_thread(lambda: view.desk.read_tables(token, *given)))


def _draw_accuracy(view: View, kept: Kept) -> Refresh:
    """The accuracy A of ISO 230-2: large at other targets, with the decision; small at the calibrated ones, and before."""
    with view.card("calibrate.accuracy"):
        verified = view.value("calibrate.verified", "µm").classes("pair")
        stamp = view.named(ui.label().classes("hil-stamp"), "calibrate.stamp")
        limit = LimitBar(view, "calibrate.limit")
        decision = view.named(ui.label().classes("hil-name"), "calibrate.decision")
        when = view.named(ui.label().classes("hil-name"), "calibrate.stamped")
        with ui.element("div").classes("hil-lines"):
            now = view.value("calibrate.now", "µm", small=True)
            before = view.value("calibrate.before", "µm", small=True)

    tables = Reading(view, partial(tables_written, view.desk))

    def refresh() -> None:
        screen = kept.value
        stages = {} if screen is None else screen.stages
        proof = None if screen is None else screen.verified
        when.set_text(_stamped(view, proof, tables.value))
        verified.set_text(_figure(view, proof, "A"))
        found = None if proof is None else proof.accuracy
        stamped = found is not None and found.A_um is not None and found.decision in _STAMPS
        stamp.set_visibility(stamped)
        limit.show(found)
        if stamped and found is not None:
            stamp.set_text(view.t(f"calibrate.stamp.{found.decision.name.lower()}"))
            stamp.classes(replace=f"hil-stamp {found.decision.name.lower()}")
        old = "calibrate.decided.old" if "verified" in stages else "calibrate.decided.none"
        decision.set_text(view.t(old) if found is None else _decided(view, found))
        for figure, name in ((now, "after"), (before, "before")):
            figure.set_text(_figure(view, stages.get(name), "A"))

    return refresh


def _stamped(view: View, proof: MeasuredStage | None, tables: datetime | None) -> str:
    """When and from where the axis was verified, and of when its tables are."""
    t, form = view.t, "%Y-%m-%d %H:%M"
    there = t("calibrate.none_in_force") if tables is None else t("calibrate.in_force", date=tables.strftime(form))
    if proof is None:
        return there
    done = (
        one.who
        for one in view.desk.events.entries()
        if one.what == "done" and one.figures.get("job") == VERIFY and one.time >= proof.begun
    )
    who, date = next(done, ""), proof.begun.strftime(form)
    verified = t("calibrate.stamped_by", date=date, who=who) if who else t("calibrate.stamped", date=date)
    return f"{verified} · {there}"


_STAMPS = (Decision.PASS, Decision.FAIL, Decision.UNDECIDED)


class LimitBar:
    """A ± U on a bar that ends at one and a half times the limit, with the limit as a line. Hidden without a limit."""

    def __init__(self, view: View, name: str) -> None:
        self._box = view.named(ui.element("div").classes("hil-limit"), name)
        with self._box:
            self._range, self._point, self._line = (
                ui.element("div").classes(f"hil-limit-{one}") for one in ("u", "a", "l")
            )
        self._box.set_visibility(False)

    def show(self, found: Accuracy | None) -> None:
        """Draw it."""
        there = found is not None and bool(found.limit_um) and found.A_um is not None
        self._box.set_visibility(there)
        if not there or found is None or found.limit_um is None or found.A_um is None:
            return
        per_um, spread_um = 100.0 / (1.5 * found.limit_um), found.U_um or 0.0
        low, high = (min(100.0, max(0.0, per_um * (found.A_um + sign * spread_um))) for sign in (-1, 1))
        self._range.style(f"left: {low:.1f}%; width: {high - low:.1f}%")
        self._point.style(f"left: {min(100.0, per_um * found.A_um):.1f}%")
        self._line.style(f"left: {per_um * found.limit_um:.1f}%")


def _decided(view: View, found: Accuracy) -> str:
    """The decision on the accuracy against its limit, with the rule."""
    if found.A_um is None:
        return view.t("calibrate.decided.no_figure", why=view.t.said(found.missing))
    limit = "–" if found.limit_um is None else view.t.number(found.limit_um, 2)
    unknown = found.decision is Decision.UNDECIDED and found.U_um is None
    return view.t(f"calibrate.decided.{'unknown' if unknown else found.decision.name.lower()}", limit=limit)


def _figure(view: View, stage: MeasuredStage | None, name: str) -> str:
    """A figure with its expanded uncertainty, where that is known."""
    if stage is None or name not in stage.figures_um:
        return "–"
    known = stage.u95_um.get(name)
    text = view.t.number(stage.figures_um[name], 2)
    return text if known is None else f"{text} ± {view.t.number(known, 2)}"


def _draw_band(view: View, axis: AxisConfig, kept: Kept, typed: TypedTables) -> Refresh:
    """The band with the signs asked for now, whether every section is inside, and which are not; the same at other targets."""
    t, band = view.t, axis.correction.band
    with view.card("calibrate.band"):
        verified = view.value("calibrate.verified_band", small=band is None)
        verdict = view.value("calibrate.verdict", small=True)
        asked = view.value("calibrate.asked", small=True)
        outside = view.named(ui.label().classes("hil-name"), "calibrate.outside")
        signs = view.named(ui.label().classes("hil-name").style("white-space: pre-line"), "calibrate.signs")
        not_judged = view.named(ui.label().classes("hil-name"), "calibrate.not_judged")
    asked.set_text(
        t("calibrate.no_band") if band is None else f"{t.number(band.low_um, 1)} … {t.number(band.high_um, 1)} µm"
    )
    signs.set_visibility(band is not None)

    def refresh() -> None:
        stages = {} if kept.value is None else kept.value.stages
        proven = None if kept.value is None else kept.value.verified
        for figure, stage in ((verified, proven), (verdict, stages.get("after"))):
            known = stage is not None and stage.outside is not None
            figure.set_text(
                t("calibrate.outside_is" if stage.outside else "calibrate.inside_is") if known and stage else "–"
            )
        if proven is not None and proven.outside is not None:
            verified.classes(replace=f"hil-value hil-{'bad' if proven.outside else 'good'}")
        last = stages.get("after")
        if last is not None and last.outside is not None:
            places = [f" · {t.number(one.target_mm, 1)} mm {'+' if one.direction > 0 else '−'}" for one in last.outside]
            inside = t("calibrate.sections", inside=last.sections - len(last.outside), total=last.sections)
            outside.set_text(inside + "".join(places))
        signs.set_text("\n".join(_signs_said(view, axis, typed, last)))
        proof = stages.get("verified")
        unlike = () if proof is None else proof.not_judged
        between = [f"{t.number(one.target_mm, 1)} mm {'+' if one.direction > 0 else '−'}" for one in unlike]
        not_judged.set_text(t("calibrate.not_judged", places=", ".join(between)) if between else "")

    return refresh


def _signs_said(view: View, axis: AxisConfig, typed: TypedTables, last: MeasuredStage | None) -> list[str]:
    """The signs as they stand there now, whether they are the axis file's, and those of the last calibration where it had others."""
    band, t = axis.correction.band, view.t
    if band is None:
        return []
    try:
        now = typed.signs()
    except InputError as error:
        return [t("calibrate.signs_unread", why=error.what)]
    lines = [t("calibrate.signs_now", signs=_signs_text(view, now))]
    if now != axis.correction.signs:
        lines.append(t("calibrate.signs_file", signs=_signs_text(view, axis.correction.signs)))
    if last is not None and last.band is not None and last.band.signs != now:
        lines.append(t("calibrate.signs_last", signs=_signs_text(view, last.band.signs)))
    return lines


def _signs_text(view: View, signs: Sequence[SignedSections]) -> str:
    """Each stretch with the signs of its + and its - direction."""
    t = view.t
    parts = [
        f"{t.number(one.from_mm, 1)} … {t.number(one.to_mm, 1)} mm {_SIGN[one.plus]}/{_SIGN[one.minus]}"
        for one in signs
    ]
    return "; ".join([*parts, t("calibrate.signs_rest" if parts else "calibrate.signs_none")])


def _draw_curves(view: View, axis: AxisConfig, kept: Kept) -> tuple[ui.element, Refresh]:
    with view.card("calibrate.curves", name="calibrate.curves.card") as card:
        drawing = Drawing(view, "calibrate.curves")

    def refresh() -> None:
        screen = kept.value
        if screen is not None and screen.stages:
            drawing.show(screen, lambda: _curves(view, axis, screen))

    return card, refresh


def _curves(view: View, axis: AxisConfig, screen: CalibrationScreen) -> Options:
    """Mean errors along the axis: + as triangles, − as inverted triangles, a colour for each stage, the band behind."""
    t = view.t
    drawn = [
        Curve(
            f"{t(f'calibrate.stage.{name}')} {'+' if sign > 0 else '−'}",
            points,
            COLOUR[name],
            "triangle",
            turned=sign < 0,
        )
        for name, stage in screen.stages.items()
        for sign, points in stage.means_um.items()
        if points
    ]
    options = curves(view, t("calibrate.plot_x"), t("calibrate.plot_y"), drawn)
    for series in options["series"]:
        series |= {"type": "line", "showSymbol": True, "lineStyle": {"width": 1.5}}
    band = next((stage.band for name in ("after", *STAGES) if (stage := screen.stages.get(name))), axis.correction.band)
    if band is not None and options["series"]:
        areas = _areas(band, screen)
        options["series"][0]["markArea"] = {"silent": True, "data": areas}
        ends = [float(corner["yAxis"]) for area in areas for corner in area]
        label = options["yAxis"].get("axisLabel", {})
        options["yAxis"] |= {
            "axisLabel": {**label, "showMinLabel": False, "showMaxLabel": False},  # too close to their neighbours
            ":min": f"shown => Math.floor(Math.min(shown.min, {min(ends)}))",
            ":max": f"shown => Math.ceil(Math.max(shown.max, {max(ends)}))",
        }
    return options


def _areas(band: Band, screen: CalibrationScreen) -> list[list[Options]]:
    """The band behind the curves: of both directions where they have one sign, else blue for + and orange for −."""
    if not band.signs:
        return [[{"yAxis": band.low_um, "itemStyle": {"color": BAND}}, {"yAxis": band.high_um}]]
    places = [x for stage in screen.stages.values() for points in stage.means_um.values() for x, _ in points]
    areas: list[list[Options]] = []
    for start, end, plus, minus in band.stretches(min(places), max(places)):
        both = {BAND: plus} if plus == minus else {BAND_PLUS: plus, BAND_MINUS: minus}
        for colour, one in both.items():
            corner = {"xAxis": start, "yAxis": one.low_um, "itemStyle": {"color": colour}}
            areas.append([corner, {"xAxis": end, "yAxis": one.high_um}])
    return areas


def _draw_figures(view: View, axis: AxisConfig, kept: Kept) -> Refresh:
    """The figures of ISO 230-2, each with its uncertainty where known."""
    t = view.t
    with view.card("calibrate.figures", name="calibrate.figures.card").classes("w-full"):
        columns = ["calibrate.head.figure", *(f"calibrate.stage.{name}" for name in STAGES)]
        table = Table(view, "calibrate.figures", columns)
        known = "calibrate.uncertain" if axis.uncertainty is not None else "calibrate.not_uncertain"
        view.named(ui.label(t(known)).classes("hil-name"), "calibrate.uncertainty")
    shown: list[CalibrationScreen] = []

    def refresh() -> None:
        screen = kept.value
        if screen is None or shown == [screen]:
            return
        shown[:] = [screen]
        figures = [
            [t(f"calibrate.figure.{name}"), *(_figure(view, screen.stages.get(one), name) for one in STAGES)]
            for name in SHOWN
        ]
        begun = [
            screen.stages[name].begun.strftime("%Y-%m-%d %H:%M") if name in screen.stages else "–" for name in STAGES
        ]
        table.show([*figures, [t("calibrate.begun"), *begun]])

    return refresh
