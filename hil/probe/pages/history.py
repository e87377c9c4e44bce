"""The run-out over time, a part of the probe's page."""

from __future__ import annotations

from collections.abc import Callable

from hil.probe.page_data import STORED, HistoryCurves, HistoryEntry, ProbeRecord, history_curves
from hil.ui.screen.drawings import Curve, Drawing, Options, curves
from hil.ui.screen.pieces import Latest, Reading, Table
from hil.ui.screen.view import View

WORDS = ("when", "mode", "verdict")
FIGURES = ("x", "y", "radius", "closure")


def draw_history(view: View, kept: Reading[ProbeRecord]) -> Callable[[], None]:
    """A plot and a table of the measurements, the latest first; returns the refresh."""
    with view.card("probe.history", name="probe.history.card"):
        drawing = Drawing(view, "probe.history")
    with view.card("probe.measurements", name="probe.measurements.card"):
        heads = {name: f"probe.past.{name}" for name in (*WORDS[:2], *FIGURES, WORDS[2])}
        figures = [heads[name] for name in FIGURES]
        table = Table(view, "probe.measurements", list(heads.values()), figures=figures, tall=True)
    latest = Latest()

    def refresh() -> None:
        record = kept.value
        if record is None or not latest.is_new(record):
            return
        shown = history_curves(record.history)
        if shown is not None:
            drawing.show(record, lambda: _options(view, shown))
        table.show([_row(view, one) for one in reversed(record.history)])

    return refresh


def _options(view: View, shown: HistoryCurves) -> Options:
    t = view.t
    drawn = [
        Curve(t("probe.x"), shown.x, 0, "circle"),
        Curve(t("probe.y"), shown.y, 1, "diamond"),
        Curve(t("probe.left_out"), shown.left_out, 6, "triangle", turned=True),
    ]
    x = t(f"probe.history_x.{shown.unit}", begun=shown.begun.astimezone().strftime("%Y-%m-%d %H:%M"))
    return curves(view, x, t("probe.history_y"), drawn)


def _row(view: View, one: HistoryEntry) -> list[str]:
    t = view.t
    verdict = t.known("probe.verdicts", one.verdict.replace(" ", "_"))
    return [
        one.when.astimezone().strftime("%Y-%m-%d %H:%M:%S"),
        t.known("probe.modes", one.mode),
        t.number(one.x_um, 2, sign=True),
        t.number(one.y_um, 2, sign=True),
        t.number(one.tip_radius_mm, 4),
        t.number(one.closure_um, 2, sign=True),
        verdict if one.verdict == STORED else f"{verdict}: {t.said(one.why)}",
    ]
