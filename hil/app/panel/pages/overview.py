"""Page with the state of one axis: position, following error, torque, instrument, correction, environment, live plots."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from functools import partial
from operator import attrgetter

from nicegui import ui

from drivers.drive import DriveState
from hil.desk.desk import Desk
from hil.desk.live import Live
from hil.ui.screen.pieces import FolderContents, tables_written
from hil.ui.screen.plots import Channel, LiveChart
from hil.ui.screen.unfinished import draw_unfinished
from hil.ui.screen.view import Button, Refresh, View


def draw(view: View) -> None:
    draw_unfinished(view, "overview")
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            parts = [_draw_drive(view), _draw_instrument(view), _draw_correction(view)]
            parts.append(_draw_buttons(view))
        with ui.element("div").classes("hil-main"):
            parts.append(_draw_plots(view))

    view.every(*parts)


def _draw_drive(view: View) -> Refresh:
    t = view.t
    with view.card("overview.drive", live="drive"):
        position = view.value("overview.position", "mm")
        with ui.element("div").classes("hil-lines"):
            remaining = view.value("overview.remaining", "mm", small=True)
            state = view.value("overview.state", small=True)
            error = view.value("overview.following_error", "µm", small=True)
            torque = view.value("overview.torque", "%", small=True)
            velocity = view.value("overview.velocity", "mm/s", small=True)

    def refresh() -> None:
        live = view.desk.live
        state.set_text(_state(view, live))
        position.set_text(t.number(live.position_load_mm))
        remaining.set_text(t.number(live.remaining_mm))
        error.set_text(t.number(live.following_error_um, 1))
        torque.set_text(t.number(live.torque_percent, 1))
        velocity.set_text(t.number(live.velocity_mm_s, 2))

    return refresh


def _draw_instrument(view: View) -> Refresh:
    t = view.t
    with view.card("overview.instrument", live="instrument"), ui.element("div").classes("hil-lines"):
        with ui.element("div").classes("hil-wrap") as in_load_frame:
            measured = view.value("overview.measured", "mm", small=True)
        with ui.element("div").classes("hil-wrap") as in_its_own:
            measured_raw = view.value("overview.measured_raw", "mm", small=True)
        signal = view.value("overview.signal", small=True)
        age = view.value("overview.age", "s", small=True)

    def refresh() -> None:
        live = view.desk.live
        for figure in (measured, measured_raw):
            figure.set_text(t.number(live.instrument_mm, 4))
        in_load_frame.set_visibility(live.on_datum)
        in_its_own.set_visibility(not live.on_datum)
        status = live.instrument_status
        signal.set_text("–" if status is None else t(f"signal.{status.name}"))
        age.set_text(t.number(live.instrument_age_s, 2))

    return refresh


def _draw_correction(view: View) -> Refresh:
    t = view.t
    with view.card("overview.correction", live="drive"):
        with ui.element("div").classes("hil-lines"):
            correction = view.value("overview.correction_now", "µm", small=True)
        in_force = view.named(ui.label(), "overview.in_force")
        air = view.named(ui.label().classes("hil-name"), "overview.environment")
    tables: FolderContents[datetime | None] = FolderContents(view, partial(tables_written, view.desk))

    def refresh() -> None:
        live = view.desk.live
        correction.set_text(t.number(live.correction_um, 2, sign=True))
        made = tables.value
        date = "–" if made is None else made.strftime("%Y-%m-%d %H:%M")
        in_force.set_text(t("overview.tables_of", date=date) if live.in_force else t("overview.nothing_in_force"))
        air.set_text(_environment(view, live))

    return refresh


def _draw_buttons(view: View) -> Refresh:
    t = view.t
    with ui.element("div").classes("hil-buttons"):
        power_off = view.button("overview.power_off", lambda: view.desk.power_off(view.token))
        reset_fault = view.button("overview.reset_fault", lambda: _reset_fault(view))
    view.named(ui.label(t("overview.not_safety")).classes("hil-name"), "overview.not_safety")

    def refresh() -> None:
        state = view.desk.live.state
        powered = state in (DriveState.ENABLED, DriveState.SWITCHED_ON, DriveState.QUICK_STOP)
        power_off.allow(view.why_not() or ("" if powered else t("why.no_power")))
        reset_fault.allow(view.why_not() or ("" if state is DriveState.FAULT else t("why.no_fault")))

    return refresh


def _draw_plots(view: View) -> Refresh:
    """The live chart with its channels to choose from."""
    t, limits = view.t, view.desk.axis.limits
    fastest = limits.max_velocity_mm_s
    channels = [
        Channel(
            "overview.position", "mm", attrgetter("position_load_mm"), (limits.travel_min_mm, limits.travel_max_mm)
        ),
        Channel("overview.velocity", "mm/s", attrgetter("velocity_mm_s"), (-fastest, fastest)),
        Channel("overview.torque", "%", attrgetter("torque_percent")),
        Channel("overview.following_error", "µm", attrgetter("following_error_um")),
        Channel("overview.measured", "mm", attrgetter("instrument_load_mm")),
    ]
    usual = [one.key for one in channels[:4]]
    held: list[tuple[Button, LiveChart]] = []
    chart: LiveChart
    with view.card("overview.last_minute", name="overview.plots"):
        with ui.element("div").classes("hil-buttons"):
            names = {one.key: t(one.key) for one in channels}
            choice = ui.select(names, value=usual, multiple=True, on_change=lambda event: chart.choose(event.value))
            view.named(
                choice.props("dense options-dense").style("min-width: 12rem; max-width: calc(100% - 9rem)"),
                "overview.channels",
            )
            pause = view.button("overview.pause", partial(_hold, view, held))
        chart = LiveChart(view, "plot.overview", channels)
        chart.choose(usual)
    held.append((pause, chart))

    def refresh() -> None:
        allowed = view.desk.live.limits
        for key, limit in (
            ("overview.torque", allowed.torque_percent),
            ("overview.following_error", allowed.following_error_um),
        ):
            chart.limit(key, *(() if limit is None else (-limit, limit)))
        chart.refresh()

    return refresh


def _hold(view: View, held: list[tuple[Button, LiveChart]]) -> None:
    for button, chart in held:
        button.say(view.t("overview.go_on" if chart.pause() else "overview.pause"))


async def _reset_fault(view: View) -> None:
    if await view.ask([view.t("overview.ask_reset", axis=view.desk.name)], view.t("go.reset_fault")):
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


def draw_axes(view: View) -> None:
    with ui.element("div").classes("hil-grid"):
        parts = [_draw_axis(view, desk) for desk in view.desks]

    view.every(*parts)


def _draw_axis(view: View, desk: Desk) -> Callable[[], None]:
    t = view.t
    card = view.live(ui.element("section").classes("hil-card"), "drive", desk)
    with view.named(card, f"axes.{desk.name}"):
        ui.link(t("header.axis", name=desk.name), f"/axis/{desk.name}/overview").classes("hil-name")
        state = ui.label().classes("hil-name")
        position = view.value("overview.position", "mm", name=f"axes.{desk.name}.position")
        channel = Channel("overview.following_error", "µm", attrgetter("following_error_um"))
        plot = LiveChart(view, f"plot.axes.{desk.name}", [channel], desk)

    def refresh() -> None:
        live = desk.live
        state.set_text(t("header.lost", why=live.trouble) if live.trouble else t(f"state.{live.state.name}"))
        position.set_text(t.number(live.position_load_mm))
        plot.refresh()

    return refresh
