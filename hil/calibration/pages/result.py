"""What calibration and verification found: the accuracy with its decision, the band, the curves and the figures."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from functools import partial

from nicegui import ui

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig
from hil.calibration.job import VERIFY
from hil.calibration.page_data import SHOWN, STAGES, CalibrationScreen, MeasuredStage
from hil.calibration.pages.typed_tables import TypedTables
from hil.correction.tables import Band, SignedSections
from hil.figures.verdict import Accuracy, Decision
from hil.ui.screen.drawings import Curve, Options, RedrawnChart, curves
from hil.ui.screen.pieces import FolderContents, ScreenTable, tables_written
from hil.ui.screen.view import Refresh, View

Kept = FolderContents[CalibrationScreen]
BAND, BAND_PLUS, BAND_MINUS = "#009e7333", "#0072b240", "#d55e0040"
"""Of the band: where both directions have one sign; of the + and of the − direction where they differ."""
_SIGN = {1: "+", -1: "−"}
COLOUR = {"before": 1, "after": 0, "verified": 2, "uncorrected": 4}
_STAMPS = (Decision.PASS, Decision.FAIL, Decision.UNDECIDED)


def draw_accuracy(view: View, kept: Kept) -> Refresh:
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

    tables = FolderContents(view, partial(tables_written, view.desk))

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
        decision.set_text(view.t(old) if found is None else f"{_decided(view, found)}{_moved(view, found)}")
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


def _moved(view: View, found: Accuracy) -> str:
    """Where the mean of the verification lies off the tables' zero, with what that means; else ""."""
    if found.mean is None or not found.moved:
        return ""
    mean, spread = view.t.number(found.mean.value_um, 2, sign=True), view.t.number(found.mean.U_um, 2)
    return f" · {view.t('calibrate.decided.moved', mean=mean, spread=spread)}"


def _figure(view: View, stage: MeasuredStage | None, name: str) -> str:
    """A figure with its expanded uncertainty, where that is known."""
    if stage is None or name not in stage.figures_um:
        return "–"
    known = stage.u95_um.get(name)
    text = view.t.number(stage.figures_um[name], 2)
    return text if known is None else f"{text} ± {view.t.number(known, 2)}"


def draw_band(view: View, axis: AxisConfig, kept: Kept, typed: TypedTables) -> Refresh:
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


def draw_curves(view: View, axis: AxisConfig, kept: Kept) -> tuple[ui.element, Refresh]:
    with view.card("calibrate.curves", name="calibrate.curves.card") as card:
        drawing = RedrawnChart(view, "calibrate.curves")

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


def draw_figures(view: View, axis: AxisConfig, kept: Kept) -> Refresh:
    """The figures of ISO 230-2, each with its uncertainty where known."""
    t = view.t
    with view.card("calibrate.figures", name="calibrate.figures.card").classes("full-width"):
        columns = ["calibrate.head.figure", *(f"calibrate.stage.{name}" for name in STAGES)]
        table = ScreenTable(view, "calibrate.figures", columns)
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
