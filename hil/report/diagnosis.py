"""The diagnosis part of a report, from the JSON form of `hil diagnose`; what a file does not hold is left out, not guessed.

Words and tables in here, `views` decides what is drawn of each finding, `plots` draws it; the caption says what is laid over.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from hil.report import markup, plots
from hil.report.data import NamedCampaign
from hil.report.svg import PAGE, Theme, inline_svg
from hil.report.views import View, finding_view, list_of, object_of, objects_of, position_view, value_of

ACTIONS = {
    "compensate": "compensate in the machine",
    "fix-setup": "fix the set-up, do not compensate",
    "re-measure": "measure again before acting",
}


def section(diagnosis: Mapping[str, Any], diagnosed: NamedCampaign | None) -> str:
    """The whole part as HTML."""
    findings = objects_of(diagnosis.get("findings"))
    parts = ["<h2>What is left, and why</h2>", _summary(diagnosis)]
    if diagnosis.get("unexplained"):
        carried = "; ".join(
            ", ".join(map(str, list_of(one.get("columns")))) for one in objects_of(diagnosis.get("carried_by"))
        )
        along = f" It shows along: {carried}." if carried else ""
        parts.append(
            '<p class="callout"><strong>Structure is left that nothing in the catalogue explains.</strong>'
            f"{markup.text(along)} Nothing was compensated for it.</p>"
        )
    elif not findings:
        parts.append("<p>No effect was found beyond the declared model and the noise floor.</p>")
    if diagnosed is not None:
        parts.append(_residual_figure(diagnosed, findings))
    for index, finding in enumerate(findings, start=1):
        parts.append(_finding(index, finding, diagnosed, alone=len(findings) == 1))
    blind = [f"{one.get('effect')}: {one.get('reason')}" for one in objects_of(diagnosis.get("blind_to"))]
    if blind:
        parts.append("<h3>What this campaign cannot show</h3>" + markup.paragraph_list(blind, "remarks"))
    parts.append(markup.paragraph_list(map(str, list_of(diagnosis.get("notes"))), "remarks"))
    return "\n".join(part for part in parts if part)


def finding_figures(diagnosis: Mapping[str, Any], diagnosed: NamedCampaign | None, theme: Theme) -> dict[str, Figure]:
    """The figures of this part by name, for files of their own."""
    findings = objects_of(diagnosis.get("findings"))
    made = {} if diagnosed is None else {"residual": _draw(position_view(diagnosed.records, findings), theme)}
    for index, finding in enumerate(findings, start=1):
        view = finding_view(finding, diagnosed, alone=len(findings) == 1)
        if view is not None:
            made[f"finding-{index}"] = _draw(view, theme)
    return made


def _summary(diagnosis: Mapping[str, Any]) -> str:
    held_out = object_of(diagnosis.get("held_out"))
    rows = []
    for key, name in (("rms_um", "RMS residual, µm"), ("peak_um", "largest residual, µm")):
        before, after = value_of(diagnosis.get("before"), key), value_of(diagnosis.get("after"), key)
        if before is not None and after is not None:
            rows.append([name, markup.number(before), markup.number(after), change(before, after)])
    facts = []
    if (floor := value_of(diagnosis, "noise_floor_um")) is not None:
        spread = value_of(diagnosis, "noise_floor_std_um")
        plus = f" ± {markup.number(spread)}" if spread is not None else ""
        facts.append(f"Noise floor from repeats: {markup.number(floor)}{plus} µm.")
    if declared := list_of(diagnosis.get("declared")):
        facts.append(f"Declared model: {', '.join(map(str, declared))}.")
    if held_out:
        facts.append(
            f"Both columns are on {held_out.get('rows', '?')} rows that were not fitted ({held_out.get('how', 'how is not stated')})."
        )
    head = ["", "declared model", "with the effects found", "change"]
    return f"<p>{markup.text(' '.join(facts))}</p>" + (markup.table(head, rows, css="numbers") if rows else "")


def change(before: float | None, after: float | None) -> str:
    """A relative change as text, a dash where it means nothing."""
    return "–" if not before or after is None else f"{100 * (after - before) / abs(before):+.0f} %"


def _residual_figure(diagnosed: NamedCampaign, findings: list[Mapping[str, Any]]) -> str:
    view = position_view(diagnosed.records, findings)
    svg = inline_svg(_draw(view, PAGE), "residual", "Residual against position")
    columns = {"run": diagnosed.records.run, "direction": view.direction, "target_mm": view.x}
    columns |= {"residual_um": view.residual_um, "laid_over_um": view.over_um}
    caption = f"Residual of {diagnosed.label} against position; laid over: {view.over}."
    return markup.figure(svg, caption) + markup.data_table("data-residual", "Data of this drawing", columns)


def _finding(index: int, finding: Mapping[str, Any], diagnosed: NamedCampaign | None, *, alone: bool) -> str:
    effect = str(finding.get("effect", "unnamed"))
    action = str(finding.get("action", ""))
    confidence = value_of(finding, "confidence")
    sure = f" · confidence {_percent(confidence)}" if confidence is not None else ""
    parts = [
        f'<section class="finding"><h3>{index}. {markup.text(effect)}'
        f'<span class="tag">{markup.text(ACTIONS.get(action, action or "no action stated"))}</span></h3>',
        f'<p>{markup.text(finding.get("explanation", ""))}<span class="muted">{markup.text(sure)}</span></p>',
    ]
    rows = [
        [name, markup.significant(value_of(value, "value")), markup.significant(value_of(value, "std"), 2)]
        for name, value in object_of(finding.get("parameters")).items()
    ]
    if rows:
        parts.append(markup.table(["parameter", "value", "standard error"], rows, css="numbers"))
    for rival in objects_of(finding.get("rivals")):
        share = value_of(rival, "confidence")
        weight = f" ({_percent(share)})" if share is not None else ""
        parts.append(
            f"<p>Rival: <strong>{markup.text(rival.get('effect'))}</strong>{markup.text(weight)}. To tell them apart: "
            f"{markup.text(rival.get('separate_by', 'not stated'))}</p>"
        )
    if (view := finding_view(finding, diagnosed, alone=alone)) is not None:
        svg = inline_svg(_draw(view, PAGE), f"finding{index}", f"Residual and {effect}")
        columns = {
            "x": view.x,
            "direction": view.direction,
            "residual_um": view.residual_um,
            "laid_over_um": view.over_um,
        }
        caption = f"Residual against {view.label[0].lower() + view.label[1:]}; laid over: {view.over}."
        parts.append(markup.figure(svg, caption))
        parts.append(markup.data_table(f"data-finding-{index}", f"Data of this drawing (x is {view.label})", columns))
    return "\n".join(parts) + "</section>"


def _percent(share: float) -> str:
    """A probability in percent; never rounded to certainty."""
    if 0.9995 <= share <= 1:
        return "above 99.9 %"
    return "below 0.1 %" if 0 <= share < 0.0005 else f"{100 * share:.1f} %"


def _draw(view: View, theme: Theme) -> Figure:
    return plots.residual_plot(
        view.x, view.residual_um, view.over_um, view.direction, theme, x_label=view.label, over=view.over
    )
