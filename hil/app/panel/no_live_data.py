"""The banner NO LIVE DATA: since when, and what is silent."""

from __future__ import annotations

import json
import time

from nicegui import ui

from drivers.instrument import ReadingStatus
from hil.axis.axis_file import AxisConfig
from hil.desk.desk import Desk
from hil.ui.screen.view import View

BEAT_S = 0.1
"""Interval between two messages from which a page knows that the server is there, s: a seventh of what the page's script waits."""
UNUSED = "backlash"
"""First word of the kinds of jobs that do not read the instrument."""
REASONS = ("server", "drive", "unread", "connecting", "job", "instrument", "signal", "signal_back")
"""Why there is no live data: a line each under `no_data` in the texts."""


def draw_no_live_data(view: View) -> None:
    """The banner of lost data. The page's script shows it, as the server may be what is lost; the server only says what it hears."""
    t = view.t
    banner = ui.element("section").classes("hil-gone").props(f'hidden role=alert data-axis="{view.desk.name}"')
    with view.named(banner, "no-data"):
        since = view.named(ui.label().classes("hil-gone-title"), "no-data.since")
        since.props["data-text"] = t("no_data.since", time="{time}", seconds="{seconds}")
        for reason in REASONS:
            ui.label(t(f"no_data.{reason}", axis=view.desk.name)).props(f"hidden data-why={reason}")
        trouble = view.named(ui.label(), "no-data.trouble")

    def beat() -> None:
        heard = {desk.name: _heard(desk) for desk in view.desks}
        view.client.run_javascript(f"hilBeat({json.dumps(heard)}, {1e3 * time.monotonic():.1f})")

    def refresh() -> None:
        trouble.set_text(t.said(view.desk.live.trouble))

    view.every(refresh)
    view.every(beat, seconds=BEAT_S)


def _heard(desk: Desk) -> dict[str, object]:
    """How long ago the sources of a desk were heard and were live, s, why they are not, and whether its axis moves or may move."""
    silence, live, job = desk.silence, desk.live, desk.job()
    running = job is not None and job.running
    why = {"drive": "unread" if live.connected and running else ""}  # where it is silent nevertheless
    if not live.connected and not live.trouble:
        why["drive"] = "job" if running else "connecting"
    lost = {"drive": silence.drive_lost_s, "instrument": silence.instrument_lost_s}
    heard: dict[str, object] = {"drive": silence.drive_s, "busy": running or live.moving, "why": why, "lost": lost}
    if isinstance(desk.axis, AxisConfig):
        heard["instrument"] = silence.instrument_s if silence.good else None
        if silence.instrument_s is not None and not silence.good:
            back = live.instrument_status is ReadingStatus.LOST_BEFORE and not running
            why["instrument"] = "signal_back" if back else "signal"
        if job is not None and running and job.kind.startswith(UNUSED):
            why["instrument"] = "unused"  # its figures are old, which is no alarm
    return heard
