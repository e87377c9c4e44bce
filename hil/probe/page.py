"""Page of the touch probe (system D): M90 from start to the run-out in force, contacts and drawing, history,
corrections and a bore.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import ui

from hil.app.panel.drawings import Drawing
from hil.app.panel.pieces import Latest, Reading, Table, draw_where
from hil.app.panel.view import View
from hil.probe import job as probe
from hil.probe.job import MeasuredRunOut
from hil.probe.machine_file import MODES
from hil.probe.page_data import (
    ProbeRecord,
    angle_deg,
    ball_positions,
    contacts,
    last_at,
    measured_at,
    probe_record,
    std_um,
    worst_closure_um,
    writable,
)
from hil.probe.pages.at_probe import ProbePage
from hil.probe.pages.correct import draw_corrections
from hil.probe.pages.history import draw_history
from hil.probe.pages.spindle_drawing import around_the_spindle
from hil.probe.runout import RunOut
from hil.records.rows import UM_PER_MM

Refresh = Callable[[], None]
Kept = Reading[ProbeRecord]


def draw(view: View) -> None:
    """Draws the page."""
    if view.probe is None:
        view.named(ui.label(view.t("probe.none")).classes("hil-note"), "probe.none")
        return
    at = ProbePage(view, view.probe)
    view.how("probe.instructions", "probe.steps")
    messages = view.messages("probe.messages")
    kept: Kept = Reading(view, lambda: probe_record(at.config, at.store))
    mode, settings = _draw_settings(at)
    parts = [settings]
    with ui.element("div").classes("hil-grid"):
        parts += [draw_where(view, "probe", lambda: last_at(view.desks)), _draw_run_out(at), _draw_in_force(at, kept)]
    with ui.element("div").classes("hil-grid wide"):
        parts += [_draw_contacts(at), _draw_drawing(at)]
    parts += [draw_corrections(at, kept, mode), draw_history(view, kept)]
    seen: list[object] = []

    def refresh() -> None:
        job = last_at(view.desks)
        result = None if job is None else job.result
        refusal = result.refusal if isinstance(result, MeasuredRunOut) else None
        messages.show(job, refusal or ("" if kept.value is None else kept.value.trouble))
        now = [None if job is None else (job.number, job.phase), at.store]
        if now != seen:
            seen[:] = now
            kept.again()
        for part in parts:
            part()

    view.every(refresh)


# -- what it takes ---------------------------------------------------------------------------------------------------------
def _draw_settings(at: ProbePage) -> tuple[ui.select, Refresh]:
    """Mode, start, state of the store, and the other axes that must be under this browser's control."""
    view, t, sealed = at.view, at.view.t, at.config.store.sealed
    names = ", ".join(axis.name for axis in at.config.axes.values())
    modes = {mode: t(f"probe.modes.{mode}") for mode in MODES}

    async def start() -> None:
        store = at.store
        if store is not None:
            await at.ask_and_run(probe.measuring_job(at.config, store, str(mode.value)))

    with ui.row().classes("items-center hil-fields"):
        machine = t("probe.machine", name=at.config.name, axes=names)
        view.named(ui.label(machine).classes("hil-name"), "probe.machine")
        mode = view.named(ui.select(modes, label=t("probe.mode"), value=at.config.probe.mode), "probe.mode")
        start_button = view.button("probe.start", start).classes("hil-go")
        state = view.named(ui.label().classes("hil-name"), "probe.store")
        opening = view.button("probe.open", partial(_ask_passwords, at)).props("outline")
    needs = view.named(ui.label().classes("hil-note"), "probe.needs")
    opening.set_visibility(sealed)

    def refresh() -> None:
        store = at.store
        start_button.allow(at.why_not() or ("" if writable(store) else t("why.run_out_store")))
        open_to = "not_opened" if store is None else "writable" if writable(store) else "readable"
        state.set_text(t(f"probe.stores.{open_to if sealed else 'plain'}"))
        opening.allow("" if view.in_control else t("why.control"))
        missing = ", ".join(desk.name for desk in at.not_controlled)
        needs.set_text(t("probe.needs", axes=missing) if missing else "")
        needs.set_visibility(bool(missing))

    return mode, refresh


async def _ask_passwords(at: ProbePage) -> None:
    """Asks for the reading password of the sealed run-out, and that of its builder's key for measuring."""
    view = at.view
    fields = ("probe.reading_password", "probe.key_password")
    given = await view.ask_passwords(*fields, yes="probe.open.yes", go="go.store", why="probe.open_why")
    if given is not None:
        token = view.token
        await view.attempt(lambda: view.in_worker_thread(lambda: view.desk.open_probe(token, at.config, *given)))


# -- M90 -------------------------------------------------------------------------------------------------------------------
def _draw_contacts(at: ProbePage) -> Refresh:
    """The contacts as they are measured, and the closure."""
    view, t = at.view, at.view.t
    with view.card("probe.contacts", name="probe.contacts.card"):
        heads = [f"probe.head.{name}" for name in ("turn", "angle", "feed", "pulses")]
        table = Table(view, "probe.contacts", heads, words=0)
        closure = view.value("probe.closure", "µm", small=True)
        limit = t("probe.limit", limit=t.number(at.config.block.closure_limit_um, 1))
        view.named(ui.label(limit).classes("hil-name"), "probe.limit")
    shown: list[object] = [None]

    def refresh() -> None:
        found = contacts(at.config, last_at(view.desks, [probe.MEASURE]))
        if shown != [found]:
            shown[:] = [found]
            rows = [
                [str(one.turn), f"{one.angle_deg}°", t.number(one.feed_mm, 4), t.number(one.pulses, 0)] for one in found
            ]
            table.show(rows)
        measured = measured_at(view.desks)
        worst_um = None if measured is None else worst_closure_um(measured.measurement)
        closure.set_text(t.number(worst_um, 2, sign=True))

    return refresh


def _draw_run_out(at: ProbePage) -> Refresh:
    """The result of the last measurement."""
    view, t = at.view, at.view.t
    with view.card("probe.run_out"):
        size = view.value("probe.size", "µm")
        with ui.element("div").classes("hil-lines"):
            fill = draw_values(view, "probe")
            std = view.value("probe.std", "µm", small=True)
            verdict = view.value("probe.verdict", small=True)

    def refresh() -> None:
        measured = measured_at(view.desks)
        found = None if measured is None else measured.measurement.run_out
        size.set_text(t.number(None if found is None else found.size_um, 2))
        fill(found)
        known_um = None if measured is None else std_um(at.config, measured.measurement)
        std.set_text("–" if known_um is None else t.number(known_um, 2))
        said = "refused" if measured is not None and measured.refusal is not None else "stored"
        verdict.set_text("–" if measured is None else t(f"probe.verdicts.{said}"))

    return refresh


def draw_values(view: View, name: str) -> Callable[[RunOut | None], None]:
    """Δx, Δy, the angle and the radius, with element names that begin with `name`; returns the function that fills
    them.
    """
    t = view.t
    x = view.value("probe.x", "µm", small=True, name=f"{name}.x")
    y = view.value("probe.y", "µm", small=True, name=f"{name}.y")
    angle = view.value("probe.angle", "°", small=True, name=f"{name}.angle")
    radius = view.value("probe.radius", "mm", small=True, name=f"{name}.radius")

    def fill(found: RunOut | None) -> None:
        x.set_text(t.number(None if found is None else UM_PER_MM * found.x_mm, 2, sign=True))
        y.set_text(t.number(None if found is None else UM_PER_MM * found.y_mm, 2, sign=True))
        angle.set_text(t.number(None if found is None else angle_deg(found), 1))
        radius.set_text(t.number(None if found is None else found.tip_radius_mm, 4))

    return fill


def _draw_drawing(at: ProbePage) -> Refresh:
    """The ball about the spindle axis at the four angles."""
    view, t = at.view, at.view.t
    with view.card("probe.drawing", name="probe.drawing.card"):
        ui.label(t("probe.drawing_note")).classes("hil-name")
        drawing = Drawing(view, "probe.drawing", "round")
    names = {name: t(f"probe.drawn.{name}") for name in ("run_out", "circle", "contacts")}

    def refresh() -> None:
        measured = measured_at(view.desks)
        if measured is not None:
            shown = ball_positions(at.config, measured.measurement)
            drawing.show(measured, lambda: around_the_spindle(view, shown, names))

    return refresh


# -- in force --------------------------------------------------------------------------------------------------------------
def _draw_in_force(at: ProbePage, kept: Kept) -> Refresh:
    """The run-out in force, and since when."""
    view, t = at.view, at.view.t
    with view.card("probe.in_force"), ui.element("div").classes("hil-lines"):
        since = view.value("probe.since", small=True)
        fill = draw_values(view, "probe.in_force")
    latest = Latest()

    def refresh() -> None:
        if kept.value is None or not latest.is_new(kept.value):
            return
        fill(kept.value.in_force)
        when = kept.value.since
        closed = "sealed" if at.store is None else "nothing"
        since.set_text(t(f"probe.no_{closed}") if when is None else when.astimezone().strftime("%Y-%m-%d %H:%M:%S"))

    return refresh
