"""Page of the diagnosis (system E): the residual of a stored campaign, the effect that causes it, its rivals; and the
loop on the axis.
"""

from __future__ import annotations

import re
from functools import partial
from string import Formatter

from nicegui import ui

from hil.axis.axis_file import AxisConfig
from hil.desk.worker_process import Passes, Work
from hil.diagnosis.loop.jobs.plan import CLOSE_LOOP
from hil.diagnosis.loop.page import draw_loop
from hil.diagnosis.page_data import Curves, DiagnosisScreen, ShownDiagnosis, ShownFinding, diagnosis_screen
from hil.ui.report.views import with_unit
from hil.ui.screen.campaigns import Measurement
from hil.ui.screen.drawings import Curve, Options, RedrawnChart, curves
from hil.ui.screen.pieces import FolderContents, ScreenTable, Tabs, measurement_words
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import Refresh, View

DIAGNOSE = Work("diagnose", "hil.diagnosis.job:diagnose_campaign")
Kept = FolderContents[DiagnosisScreen]
MARKS = {1: (5, False), -1: (1, True)}
"""Colour of a direction, and whether its triangle is inverted."""
SURE = 0.999
"""Largest confidence that is shown as a number."""


def draw(view: View) -> None:
    """Draws the page: the diagnosis of a stored campaign, and the loop on the axis, one of them at a time."""
    axis = view.desk.axis
    if not isinstance(axis, AxisConfig):
        view.named(ui.label(view.t("diagnosis.no_instrument")).classes("hil-note"), "diagnosis.no_instrument")
        return
    chosen = {"key": ""}
    kept: Kept = FolderContents(view, lambda: diagnosis_screen(axis, chosen["key"]))
    tabs = Tabs(view, "diagnosis", ("campaign", "loop"))
    with tabs.panel("campaign"):
        parts = [_draw_diagnosis(view, kept, chosen)]
    with tabs.panel("loop"):
        parts.append(draw_loop(view, axis, kept))
    job = view.desk.job()
    if job is not None and job.kind == CLOSE_LOOP:
        tabs.show("loop")

    view.every(*parts)


def _draw_diagnosis(view: View, kept: Kept, chosen: dict[str, str]) -> Refresh:
    """Choice, start, verdict and residual in the window; each finding, and what the campaign cannot show, below."""
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            parts = [_draw_figures(view, kept), _draw_next(view, kept), _draw_choice(view, kept, chosen)]
        with ui.element("div").classes("hil-main"):
            parts.append(_draw_verdict(view, kept))
            with view.card("diagnosis.residual", name="diagnosis.residual.card"):
                residual = RedrawnChart(view, "diagnosis.residual", empty="diagnosis.none_yet")
    found = view.named(ui.element("div").classes("full-width"), "diagnosis.findings")
    parts.append(_draw_rest(view, kept))
    drawn: list[ShownDiagnosis | None] = []

    def refresh() -> None:
        for part in parts:
            part()
        shown = None if kept.value is None else kept.value.shown
        if kept.value is None or drawn == [shown]:
            return
        drawn[:] = [shown]
        found.clear()
        if shown is None:
            residual.clear()
            return
        position = shown.position
        if position is not None:
            residual.show(shown, partial(_options, view, position))
        with found:
            for number, finding in enumerate(shown.findings, start=1):
                _draw_finding(view, number, finding)

    return refresh


def _draw_choice(view: View, kept: Kept, chosen: dict[str, str]) -> Refresh:
    """Selection of the measurement; start and cancel."""
    t, desk = view.t, view.desk

    taken: list[DiagnosisScreen] = []  # the contents that the choice was last taken from

    def choose(key: object) -> None:
        if isinstance(key, str) and key != chosen["key"]:
            chosen["key"] = key
            kept.again()

    async def start() -> None:
        of = None if kept.value is None else kept.value.choice(chosen["key"])
        if of is not None:
            desk.compute(view.token, DIAGNOSE, [Passes(of.key, of.paths)])

    messages = view.named(ui.label().classes("hil-note bad"), "diagnosis.messages")
    with view.card("diagnosis.campaign", name="diagnosis.choice"):
        select = ui.select({}, on_change=lambda event: choose(event.value)).props("dense options-dense")
        view.named(select.classes("full-width"), "diagnosis.campaign")
        status = view.named(ui.label().classes("hil-name"), "diagnosis.status")
        bar = ui.linear_progress(show_value=False, size="9px", color=None).props("indeterminate")
        view.named(bar, "diagnosis.progress")
    with ui.element("div").classes("hil-buttons"):
        start_button = view.button("diagnosis.start", start).classes("hil-go")
        cancel = view.button("diagnosis.cancel", lambda: desk.cancel_computing(view.token))

    def refresh() -> None:
        screen, now = kept.value, desk.computed
        if screen is not None and taken != [screen]:
            taken[:] = [screen]
            options = {one.key: _words(view, one) for one in screen.choices}
            read = "" if screen.chosen is None else screen.chosen.key
            if (
                chosen["key"] not in options
            ):  # nobody has chosen, or it is gone; a choice made while these were read stands
                chosen["key"] = read
            select.set_options(options, value=chosen["key"] or None)
        ours = now.work == DIAGNOSE.name
        busy = "" if view.in_control and not now.running else t("why.computing" if view.in_control else "why.control")
        start_button.allow(busy or ("" if screen is not None and screen.chosen is not None else t("why.no_campaign")))
        cancel.set_visibility(ours and now.running and view.in_control)
        status.set_text(t("diagnosis.computing", seconds=t.number(now.seconds, 0)) if now.running else "")
        status.set_visibility(now.running)
        bar.set_visibility(now.running)
        messages.set_text(t.said(now.error) if ours else "")
        messages.set_visibility(ours and bool(now.error))

    return refresh


def _words(view: View, one: Measurement) -> str:
    begun = one.begun.strftime("%Y-%m-%d %H:%M")
    return view.t("diagnosis.choice", begun=begun, what=measurement_words(view, one), rows=one.rows)


def _draw_figures(view: View, kept: Kept) -> Refresh:
    """Residual before and after, on rows that were not fitted, and the noise floor."""
    t = view.t
    with view.card("diagnosis.figures"):
        with ui.element("div") as held_out:
            after = view.value("diagnosis.after", "µm")
            with ui.element("div").classes("hil-lines"):
                before = view.value("diagnosis.before", "µm", small=True)
                peaks = view.value("diagnosis.peaks", "µm", small=True)
        not_held_out = view.named(ui.label(t("diagnosis.not_held_out")).classes("hil-note"), "diagnosis.not_held_out")
        with ui.element("div").classes("hil-lines"):
            noise = view.value("diagnosis.noise", "µm", small=True)
            rows = view.value("diagnosis.rows", small=True)

    def refresh() -> None:
        shown = None if kept.value is None else kept.value.shown
        without = shown is not None and not shown.rms_um
        not_held_out.set_visibility(without)
        held_out.set_visibility(not without)
        rms, peak = ({}, {}) if shown is None else (shown.rms_um, shown.peak_um)
        after.set_text(t.number(rms.get("after"), 2))
        before.set_text(t.number(rms.get("before"), 2))
        peaks.set_text(f"{t.number(peak.get('before'), 2)} → {t.number(peak.get('after'), 2)}" if peak else "–")
        noise.set_text("–" if shown is None else f"{t.number(shown.noise_um[0])}{_spread(view, shown.noise_um[1], 3)}")
        rows.set_text("–" if shown is None else str(shown.rows))

    return refresh


def _spread(view: View, std_um: float | None, digits: int) -> str:
    """The expanded uncertainty (k = 2) of a standard one; "" where there is none."""
    return "" if std_um is None else f" ± {view.t.number(2.0 * std_um, digits)}"


def _expanded(view: View, std_um: float | None, digits: int) -> str:
    """The expanded uncertainty (k = 2) of a standard one, named; "" where there is none."""
    return "" if std_um is None else f" ± {view.t.number(2.0 * std_um, digits)} (k = 2)"


def _draw_verdict(view: View, kept: Kept) -> Refresh:
    """The findings, the first in a sentence; the unexplained part and the columns that it follows."""
    t = view.t
    with view.card("diagnosis.verdict").classes("hil-verdict"):
        found = view.named(ui.label("–").classes("hil-headline"), "diagnosis.found")
        said = view.named(ui.label().classes("hil-clamp"), "diagnosis.sentence")
        with ui.element("div").classes("hil-line wrap"):
            ui.label(t("diagnosis.unexplained")).classes("hil-name")
            unexplained = view.named(ui.label("–").classes("hil-value small"), "diagnosis.unexplained")
            ui.label(t("diagnosis.recommended")).classes("hil-name")
            state = view.named(ui.label("–").classes("hil-value small"), "diagnosis.recommended")
        carriers = view.named(ui.label().classes("hil-name hil-clamp"), "diagnosis.carriers")

    def refresh() -> None:
        shown = None if kept.value is None else kept.value.shown
        if shown is None:
            for label in (found, unexplained, state):
                label.set_text("–")
            said.set_text(t("diagnosis.none_yet"))
            carriers.set_text("")
            return
        names = [_effect(view, one.effect) for one in shown.findings]
        found.set_text(" · ".join(names) or t("diagnosis.nothing"))
        said.set_text(sentence(t, shown.findings[0]) if shown.findings else "")
        unexplained.set_text(t("diagnosis.is_unexplained" if shown.unexplained else "diagnosis.all_explained"))
        unexplained.classes(replace=f"hil-value small hil-{'bad' if shown.unexplained else 'good'}")
        follows = [
            f"{' × '.join(map(t.said, columns))}: {t.number(rms, 2)}{_expanded(view, std, 2)} µm"
            for columns, rms, std in shown.carriers
        ]
        carriers.set_text(" · ".join(follows))
        old = "" if shown.current else f" · {t('diagnosis.old')}"
        state.set_text(t("diagnosis.yes" if shown.recommended else "diagnosis.no") + old)

    return refresh


def _draw_next(view: View, kept: Kept) -> Refresh:
    t = view.t
    with view.card("diagnosis.next"):
        run = view.named(ui.label("–").classes("hil-clamp four"), "diagnosis.next_run")

    def refresh() -> None:
        shown = None if kept.value is None else kept.value.shown
        run.set_text("–" if shown is None else t.said(shown.next_run) or t("diagnosis.no_next"))

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
            parameters = ScreenTable(view, f"{name}.parameters", heads)
            parameters.show(
                [
                    [parameter(t, one), t.significant(value), t.significant(std, 2)]
                    for one, value, std in finding.parameters
                ]
            )
            rivals = ScreenTable(
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
                RedrawnChart(view, f"{name}.curves").show(finding, partial(_options, view, finding.curves))


def _draw_rest(view: View, kept: Kept) -> Refresh:
    """What this campaign cannot show, and notes."""
    t = view.t
    with ui.element("div").classes("hil-grid wide"):
        with view.card("diagnosis.blind", name="diagnosis.blind.card"):
            blind = ScreenTable(view, "diagnosis.blind", ["diagnosis.head.effect", "diagnosis.head.why"], words=2)
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


BOUND = re.compile(r"(least|most)_(.+)")
"""A parameter of which the rows determine only a bound."""


def sentence(t: Texts, finding: ShownFinding) -> str:
    """The finding in one sentence, with figures and units."""
    form = re.sub(r"\W+", "_", finding.form)
    known = {name for name, _, _ in finding.parameters}
    ends = form, form.removesuffix("_about_a_fixed_point"), form.removeprefix("flat_"), "any"
    keys = [f"explain.{finding.effect}.{end}" for end in ends]
    if known == {"rms_um"}:
        keys = ["explain.summed.any"]
    elif all(BOUND.match(name) for name in known) and any(key in t for key in keys):
        keys = ["explain.undetermined.any"]
    inputs = [t.said(name) for name in finding.inputs]
    places: dict[str, str] = {"input": inputs[0] if inputs else "–", "inputs": " · ".join(inputs)}
    places["rms"] = t.estimate(finding.rms_um, None, "µm")
    bounds: dict[str, list[str]] = {}
    for name, value, std in finding.parameters:
        stem, unit = _split(t, name)
        if match := BOUND.fullmatch(stem):
            bounds.setdefault(match[2], []).append(t(f"bound.{match[1]}", value=t.estimate(value, None, unit)))
        places[stem] = t.estimate(value, std, unit, finding.intervals.get(name))
    places |= {stem: ", ".join(parts) for stem, parts in bounds.items()}
    if "amount_at_shortest_travel" in places:
        seen, travel = places["amount_at_shortest_travel"], places["shortest_travel"]
        places["amount"] = t("bound.at_travel", amount=seen, travel=travel)
    for key in keys if finding.form else ():
        if key in t and {place for _, place, _, _ in Formatter().parse(t(key)) if place} <= set(places):
            return t(key, **places)
    return finding.explanation


def parameter(t: Texts, name: str) -> str:
    """A parameter as a heading, such as "Period, mm"; one of a user's own effect by its own name."""
    stem, unit = _split(t, name)
    if (bound := BOUND.fullmatch(stem)) and f"parameter.{bound[2]}" in t:
        said = t(f"parameter.{bound[1]}", of=t(f"parameter.{bound[2]}"))
        return f"{said}, {unit}" if unit else said
    match = re.fullmatch(r"(.+)_(\d+)", stem)
    key, number = (f"parameter.{match[1]}", match[2]) if match else (f"parameter.{stem}", "")
    if key not in t:
        return name
    said = t(key, number=number) if number else t(key)
    return f"{said}, {unit}" if unit else said


def _split(t: Texts, name: str) -> tuple[str, str]:
    """The name of a parameter without its unit, and the unit."""
    stem, unit = with_unit(name)
    return stem, t("unit.rows") if unit == "rows" else unit
