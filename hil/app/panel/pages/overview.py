"""Page with the state of one axis: position, following error, torque, instrument, correction, environment, live plots."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from hil.app.desk.desk import Desk
from hil.app.desk.live import Live
from hil.app.desk.unfinished import UnfinishedWork, unfinished_work
from hil.app.panel.pieces import Reading
from hil.app.panel.plots import LivePlot
from hil.app.panel.view import View


def draw(view: View) -> None:
    """Draw the page."""
    t = view.t
    _draw_left_over(view)
    with ui.element("div").classes("hil-grid"):
        with view.card("overview.drive"):
            state = view.value("overview.state", small=True)
            position = view.value("overview.position", "mm")
            remaining = view.value("overview.remaining", "mm", small=True)
            with ui.row():
                view.button("overview.power_off", lambda: view.desk.power_off(view.token))
                view.button("overview.reset_fault", lambda: _reset_fault(view))
        with view.card("overview.motion"):
            error = view.value("overview.following_error", "µm")
            torque = view.value("overview.torque", "%", small=True)
            velocity = view.value("overview.velocity", "mm/s", small=True)
        with view.card("overview.instrument"):
            with ui.element("div") as in_load_frame:
                measured = view.value("overview.measured", "mm")
            with ui.element("div") as in_its_own:
                measured_raw = view.value("overview.measured_raw", "mm")
            signal = view.value("overview.signal", small=True)
            age = view.value("overview.age", "s", small=True)
        with view.card("overview.correction"):
            correction = view.value("overview.correction_now", "µm")
            in_force = view.value("overview.in_force", small=True)
            ui.label(t("overview.environment")).classes("hil-name")
            air = view.named(ui.label(), "overview.environment")
    view.named(ui.label(t("overview.not_safety")).classes("hil-note"), "overview.not_safety")
    with ui.element("div").classes("hil-grid"):
        plots = [
            LivePlot(view, "overview.position", "mm", lambda point: point.position_load_mm),
            LivePlot(view, "overview.following_error", "µm", lambda point: point.following_error_um),
            LivePlot(view, "overview.torque", "%", lambda point: point.torque_percent),
            LivePlot(view, "overview.velocity", "mm/s", lambda point: point.velocity_mm_s),
            LivePlot(view, "overview.measured", "mm", lambda point: point.instrument_load_mm),
        ]

    def refresh() -> None:
        live = view.desk.live
        state.set_text(_state(view, live))
        position.set_text(t.number(live.position_load_mm))
        remaining.set_text(t.number(live.remaining_mm))
        error.set_text(t.number(live.following_error_um, 1))
        torque.set_text(t.number(live.torque_percent, 1))
        velocity.set_text(t.number(live.velocity_mm_s, 2))
        for figure in (measured, measured_raw):
            figure.set_text(t.number(live.instrument_mm, 4))
        in_load_frame.set_visibility(live.on_datum)
        in_its_own.set_visibility(not live.on_datum)
        status = live.instrument_status
        signal.set_text("–" if status is None else t(f"signal.{status.name}"))
        age.set_text(t.number(live.instrument_age_s, 2))
        correction.set_text(t.number(live.correction_um, 2, sign=True))
        in_force.set_text(live.in_force or t("overview.nothing_in_force"))
        air.set_text(_environment(view, live))
        for plot in plots:
            plot.refresh()

    view.every(refresh)


def _draw_left_over(view: View) -> None:
    """Notes of interrupted work, each a link to the page where it is resumed or restored."""
    notes = view.named(ui.column().classes("gap-1"), "overview.left_over")
    kept: Reading[tuple[UnfinishedWork, ...]] = Reading(view, partial(_left_over, view.desk))
    shown: list[tuple[UnfinishedWork, ...]] = [()]

    def refresh() -> None:
        found = kept.value or ()
        if found == shown[0]:
            return
        shown[0] = found
        notes.clear()
        with notes:
            for one in found:
                text = view.t(f"overview.left.{one.kind}", place=one.place)
                ui.link(text, f"/axis/{view.desk.name}/{one.page}").classes("hil-note")

    view.every(refresh)


def _left_over(desk: Desk) -> tuple[UnfinishedWork, ...]:
    """Interrupted work; none while a job runs, which may be resuming it."""
    job = desk.job()
    return () if job is not None and job.running else unfinished_work(desk.axis)


async def _reset_fault(view: View) -> None:
    if await view.ask([view.t("overview.ask_reset", axis=view.desk.name), view.t("plan.ask")]):
        view.desk.reset_fault(view.token)


def _state(view: View, live: Live) -> str:
    code = "" if live.fault_code is None else f" {live.fault_code:04X}h"
    return view.t(f"state.{live.state.name}") + code


def _environment(view: View, live: Live) -> str:
    air = live.environment
    if air is None:
        return "–"
    number = view.t.number
    parts = [f"{view.t('overview.air')} {number(air.air_temp_c, 2)} °C", f"{number(air.air_pressure_hpa, 1)} hPa"]
    parts.append(f"{number(air.air_humidity_percent, 0)} %")
    parts += [f"{view.t.said(place)} {number(value, 2)} °C" for place, value in sorted(air.place_temps_c.items())]
    return " · ".join(parts)
