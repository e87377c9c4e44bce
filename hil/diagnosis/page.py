"""Page of the diagnosis (system E): the residual of a stored campaign, the effect that causes it, its rivals; and the
loop on the axis.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import ui

from hil.app.desk.campaigns import Measurement
from hil.app.jobs import worker_process as aside
from hil.app.panel.drawings import Curve, Drawing, Options, curves
from hil.app.panel.pieces import Reading, Table
from hil.app.panel.view import View
from hil.app.report.job import Wanted
from hil.axis.axis_file import AxisConfig
from hil.diagnosis.loop.page import draw_loop
from hil.diagnosis.page_data import Curves, DiagnosisScreen, ShownDiagnosis, ShownFinding, diagnosis_screen
from hil.diagnosis.pages.sentences import parameter, sentence

Refresh = Callable[[], None]
Kept = Reading[DiagnosisScreen]
MARKS = {1: (5, False), -1: (1, True)}
"""Colour of a direction, and whether its triangle is inverted."""
SURE = 0.999
"""Largest confidence that is shown as a number."""


def draw(view: View) -> None:
    """Draws the page."""
    axis = view.desk.axis
    if not isinstance(axis, AxisConfig):
        view.named(ui.label(view.t("diagnosis.no_instrument")).classes("hil-note"), "diagnosis.no_instrument")
        return
    chosen = {"key": ""}
    kept: Kept = Reading(view, lambda: diagnosis_screen(axis, chosen["key"]))
    parts = [_draw_choice(view, kept, chosen)]
    with ui.element("div").classes("hil-grid"):
        parts += [_draw_figures(view, kept), _draw_verdict(view, kept), _draw_next(view, kept)]
    with view.card("diagnosis.residual", name="diagnosis.residual.card").classes("w-full"):
        residual = Drawing(view, "diagnosis.residual")
    found = view.named(ui.element("div").classes("w-full"), "diagnosis.findings")
    parts += [_draw_rest(view, kept), draw_loop(view, axis, kept)]
    drawn: list[ShownDiagnosis | None] = []

    def refresh() -> None:
        for part in parts:
            part()
        shown = None if kept.value is None else kept.value.shown
        if kept.value is None or drawn == [shown]:
            return
        drawn[:] = [shown]
        found.clear()
        if shown is not None:
            position = shown.position
            if position is not None:
                residual.show(shown, partial(_options, view, position))
            with found:
                for number, finding in enumerate(shown.findings, start=1):
                    _draw_finding(view, number, finding)

    view.every(refresh)


def _draw_choice(view: View, kept: Kept, chosen: dict[str, str]) -> Refresh:
    """Selection of the measurement; start and cancel."""
    t, desk = view.t, view.desk

    def choose(key: object) -> None:
        if isinstance(key, str) and key != chosen["key"]:
            chosen["key"] = key
            kept.again()

    async def start() -> None:
        of = None if kept.value is None else kept.value.chosen
        if of is not None:
            desk.compute(view.token, aside.request(aside.DIAGNOSE, [Wanted(of.key, of.paths)]))

    with ui.row().classes("items-end"):
        select = ui.select({}, label=t("diagnosis.campaign"), on_change=lambda event: choose(event.value))
        view.named(select.style("min-width: 24rem"), "diagnosis.campaign")
        start_button = view.button("diagnosis.start", start)
        cancel = view.button("diagnosis.cancel", lambda: desk.cancel_computing(view.token)).props("outline")
        status = view.named(ui.label().classes("hil-name"), "diagnosis.status")
    messages = view.named(ui.label().classes("hil-note bad"), "diagnosis.messages")

    def refresh() -> None:
        screen, now = kept.value, desk.computed
        if screen is not None:
            options = {one.key: _words(view, one) for one in screen.choices}
            key = None if screen.chosen is None else screen.chosen.key
            if select.options != options or select.value != key:
                chosen["key"] = key or ""
                select.set_options(options, value=key)
        ours = now.work == aside.DIAGNOSE
        start_button.set_enabled(
            view.in_control and not now.running and screen is not None and screen.chosen is not None
        )
        cancel.set_visibility(ours and now.running and view.in_control)
        status.set_text(t("diagnosis.computing", seconds=t.number(now.seconds, 0)) if now.running else "")
        messages.set_text(t.said(now.error) if ours else "")
        messages.set_visibility(ours and bool(now.error))

    return refresh


def _words(view: View, one: Measurement) -> str:
    return view.t("diagnosis.choice", campaign=one.key, begun=one.begun.strftime("%Y-%m-%d %H:%M"), rows=one.rows)


def _draw_figures(view: View, kept: Kept) -> Refresh:
    """Residual before and after, on rows that were not fitted, and the noise floor."""
    t = view.t
    with view.card("diagnosis.figures"):
        after = view.value("diagnosis.after", "µm")
        before = view.value("diagnosis.before", "µm", small=True)
        peaks = view.value("diagnosis.peaks", "µm", small=True)
        noise = view.value("diagnosis.noise", "µm", small=True)

    def refresh() -> None:
        shown = None if kept.value is None else kept.value.shown
        rms, peak = ({}, {}) if shown is None else (shown.rms_um, shown.peak_um)
        after.set_text(t.number(rms.get("after"), 2))
        before.set_text(t.number(rms.get("before"), 2))
        peaks.set_text(f"{t.number(peak.get('before'), 2)} → {t.number(peak.get('after'), 2)}")
        noise.set_text("–" if shown is None else f"{t.number(shown.noise_um[0])} ± {t.number(shown.noise_um[1])}")

    return refresh


def _draw_verdict(view: View, kept: Kept) -> Refresh:
    """The findings; the unexplained part and the columns that it follows."""
    t = view.t
    with view.card("diagnosis.verdict"):
        found = view.value("diagnosis.found", small=True)
        unexplained = view.value("diagnosis.unexplained", small=True)
        carriers = view.named(ui.label().classes("hil-name").style("white-space: pre-line"), "diagnosis.carriers")
        state = view.value("diagnosis.recommended", small=True)

    def refresh() -> None:
        shown = None if kept.value is None else kept.value.shown
        if shown is None:
            for label in (found, unexplained, state):
                label.set_text("–")
            carriers.set_text(t("diagnosis.none_yet"))
            return
        names = [_effect(view, one.effect) for one in shown.findings]
        found.set_text(" · ".join(names) or t("diagnosis.nothing"))
        unexplained.set_text(t("diagnosis.is_unexplained" if shown.unexplained else "diagnosis.all_explained"))
        unexplained.classes(replace=f"hil-value small hil-{'bad' if shown.unexplained else 'good'}")
        carriers.set_text(
            "\n".join(
                f"{' × '.join(map(t.said, columns))}: {t.number(rms, 2)} ± {t.number(std, 2)} µm"
                for columns, rms, std in shown.carriers
            )
        )
        old = "" if shown.current else f" · {t('diagnosis.old')}"
        state.set_text(t("diagnosis.yes" if shown.recommended else "diagnosis.no") + old)

    return refresh


def _draw_next(view: View, kept: Kept) -> Refresh:
    """The next measurement."""
    t = view.t
    with view.card("diagnosis.next"):
        run = view.value("diagnosis.next_run", small=True)
        rows = view.value("diagnosis.rows", small=True)

    def refresh() -> None:
        shown = None if kept.value is None else kept.value.shown
        run.set_text("–" if shown is None else t.said(shown.next_run) or t("diagnosis.no_next"))
        run.style("font-size: 1.3rem")
        rows.set_text("–" if shown is None else str(shown.rows))

    return refresh


def _options(view: View, drawn: Curves) -> Options:
    """The residual as points, the effect as a line of the same direction."""
    t = view.t
    over = _effect(view, t.said(drawn.over))
    points = [
        Curve(
            f"{t('diagnosis.left')} {'+' if sign > 0 else '−'}",
            values,
            MARKS[sign][0],
            "triangle",
            turned=MARKS[sign][1],
        )
        for sign, values in drawn.residual.items()
    ]
    mark = "" if drawn.smooth else "circle"
    lines = [
        Curve(f"{over} {'+' if sign > 0 else '−'}", values, 2 if sign > 0 else 3, mark)
        for sign, values in drawn.laid_over.items()
    ]
    options = curves(view, t.said(drawn.label), t("diagnosis.plot_y"), [*points, *lines])
    options["legend"] |= {"itemWidth": 18, "itemHeight": 12}
    return options


def _draw_finding(view: View, number: int, finding: ShownFinding) -> None:
    """One effect: confidence, action, parameters, rivals, and its curve along its own column."""
    t, name = view.t, f"diagnosis.finding.{number}"
    with ui.element("div").classes("hil-grid wide").style("margin-bottom: 1rem"):
        with view.named(ui.element("section").classes("hil-card"), name):
            ui.label(f"{number}. {_effect(view, finding.effect)}").classes("hil-value small")
            sure = finding.confidence
            weight = (
                "–" if sure is None else f"> {t.number(100 * SURE, 1)}" if sure > SURE else t.number(100.0 * sure, 1)
            )
            said = t("diagnosis.confidence", percent=weight)
            view.named(ui.label(f"{said} · {t.known('diagnosis.action', finding.action)}"), f"{name}.confidence")
            view.named(ui.label(sentence(t, finding)).classes("hil-note"), f"{name}.explanation")
            heads = [f"diagnosis.head.{one}" for one in ("parameter", "value", "std")]
            parameters = Table(view, f"{name}.parameters", heads)
            parameters.show(
                [
                    [parameter(t, one), t.significant(value), t.significant(std, 2)]
                    for one, value, std in finding.parameters
                ]
            )
            rivals = Table(
                view, f"{name}.rivals", [f"diagnosis.head.{one}" for one in ("rival", "separate", "weight")], words=2
            )
            rivals.show(
                [
                    [_effect(view, one), t.said(apart), f"{t.number(_percent(share), 1)} %"]
                    for one, share, apart in finding.rivals
                ]
            )
            if not finding.rivals:
                view.named(ui.label(t("diagnosis.no_rivals")).classes("hil-name"), f"{name}.no_rivals")
        if finding.curves is not None:
            with view.named(ui.element("section").classes("hil-card"), f"{name}.card"):
                ui.label(t("diagnosis.along")).classes("hil-name")
                Drawing(view, f"{name}.curves").show(finding, partial(_options, view, finding.curves))


def _draw_rest(view: View, kept: Kept) -> Refresh:
    """What this campaign cannot show, and notes."""
    t = view.t
    with ui.element("div").classes("hil-grid wide"):
        with view.card("diagnosis.blind", name="diagnosis.blind.card"):
            blind = Table(view, "diagnosis.blind", ["diagnosis.head.effect", "diagnosis.head.why"], words=2)
        with view.card("diagnosis.notes", name="diagnosis.notes.card"):
            notes = view.named(ui.label("–").style("white-space: pre-line"), "diagnosis.notes")
    drawn: list[ShownDiagnosis | None] = []

    def refresh() -> None:
        shown = None if kept.value is None else kept.value.shown
        if drawn == [shown]:
            return
        drawn[:] = [shown]
        blind.show([] if shown is None else [[_effect(view, one), t.said(why)] for one, why in shown.blind])
        notes.set_text("–" if shown is None else "\n".join(map(t.said, shown.notes)) or t("diagnosis.no_notes"))

    return refresh


def _effect(view: View, name: str) -> str:
    return view.t.known("effect", name)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
