"""The diagnosis part of a report, from the JSON form of `hil diagnose`; a missing key is left out, never guessed.

Words and tables are in here; `views` selects what is plotted of each finding, `plots` draws it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from matplotlib.figure import FigureBase

from hil.diagnosis.report import left_over
from hil.figures.error_figures import rms
from hil.figures.verdict import FITTED_PLUS_MINUS
from hil.ui.report import markup, plots
from hil.ui.report.blocks import (
    Block,
    Bullets,
    DataTable,
    Drawing,
    Framed,
    Heading,
    Paragraph,
    ReportTable,
    TextSpan,
    said,
)
from hil.ui.report.data import NamedCampaign
from hil.ui.report.svg import Ground, Theme
from hil.ui.report.views import (
    ResidualView,
    estimate_of,
    finding_view,
    list_of,
    object_of,
    objects_of,
    position_view,
    value_of,
    with_residual,
    with_unit,
)

ACTIONS = {
    "compensate": "compensate in the machine",
    "fix-setup": "fix the set-up, do not compensate",
    "re-measure": "measure again before acting",
}


def section(diagnosis: Mapping[str, Any], campaign: NamedCampaign | None, *, all_plots: bool = False) -> list[Block]:
    """The part of a report on what is left. diagnosis: the JSON form of `hil diagnose`; a finding may have
    "plot": {"column": name, "unit": unit, "x": [...], "residual_um": [...], "effect_um": [...]}

    campaign: the diagnosed one; its residual_um is drawn where the diagnosis has one number per row, else its error; None: no plots
    all_plots: with the extended model's residual, even where nothing is unexplained
    """
    diagnosed = None if campaign is None else with_residual(campaign, diagnosis)
    findings = objects_of(diagnosis.get("findings"))
    parts: list[Block] = [Heading("What is left, and why"), *_summary(diagnosis)]
    if any("±" in str(one.get("explanation")) for one in findings):
        parts.append(said(f"{FITTED_PLUS_MINUS}.", "muted"))
    if diagnosis.get("unexplained"):
        parts.append(_unexplained(diagnosis))
    elif not findings:
        parts.append(said("No effect was found beyond the declared model and the noise floor."))
    if diagnosed is not None:
        parts += _residual(diagnosed, findings)
    parts += [_finding(i, one, diagnosed, alone=len(findings) == 1) for i, one in enumerate(findings, start=1)]
    if diagnosis.get("unexplained") or all_plots:
        parts += left_over.section(diagnosis)
    blind = tuple(f"{one.get('effect')}: {one.get('reason')}" for one in objects_of(diagnosis.get("blind_to")))
    if blind:
        parts += [Heading("What this campaign cannot show", 3), Bullets(blind, "remarks")]
    return [*parts, Bullets(tuple(map(str, list_of(diagnosis.get("notes")))), "remarks")]


def opening(diagnosis: Mapping[str, Any], before: NamedCampaign, after: NamedCampaign) -> str:
    """The loop in one sentence: what was found, how large, how sure, and the error in the two campaigns."""
    found = [_in_short(one) for one in objects_of(diagnosis.get("findings"))]
    what = (
        f"Found (± is U, k = 2, about 95 %): {'; '.join(found)}."
        if found
        else "No effect was found beyond the declared model."
    )
    if diagnosis.get("unexplained"):
        what += " More is left that nothing in the catalogue explains."
    floor = value_of(diagnosis, "noise_floor_um")
    noise = "" if floor is None else f" (noise {markup.number(floor)} µm)"
    errors = [rms(one.records.error_um) for one in (before, after)]
    sizes = [markup.number(one) for one in errors]
    verb = "did not change:" if sizes[0] == sizes[1] else "fell" if errors[1] < errors[0] else "grew"
    return (
        f"{what} The error {verb} from {sizes[0]} µm RMS ({before.label}, {len(before.records)} rows) to {sizes[1]} µm RMS"
        f" ({after.label}, {len(after.records)} rows measured anew){noise}."
    )


def _in_short(finding: Mapping[str, Any]) -> str:
    """An effect, its first parameters with twice their standard errors (k = 2), and how sure it is."""
    sizes = []
    for name, form in object_of(finding.get("parameters")).items():
        if (known := estimate_of(form)) is not None:
            word, unit = with_unit(name)
            spread = f"± {markup.significant(2.0 * known.std, 2)}" if known.is_symmetric else f"({_range(form)})"
            sizes.append(
                f"{word.replace('_', ' ')} {markup.significant(known.value)} {spread}" + (f" {unit}" if unit else "")
            )
    sure = value_of(finding, "confidence")
    told = [*sizes[:2], *([] if sure is None else [f"confidence {percent(sure)}"])]
    return f"{finding.get('effect')}" + (f" ({', '.join(told)})" if told else "")


def _range(form: object) -> str:
    """The interval of a parameter at 95 %; "" where the result, an older one, has none."""
    known = estimate_of(form)
    return "" if known is None or known.profiled is None else " to ".join(map(markup.significant, known.profiled))


def _unexplained(diagnosis: Mapping[str, Any]) -> Paragraph:
    """The columns that the unexplained part follows, its size, and whether it is corrected."""
    carried = "; ".join(map(_carrier, objects_of(diagnosis.get("carried_by"))))
    along = f" It shows along: {carried}." if carried else ""
    asked_for = [str(one.get("explanation")) for one in objects_of(diagnosis.get("non_parametric"))]
    done = " Nothing was compensated for it."
    if asked_for:
        done = f" The extended model corrects it all the same, because that was asked for: {' '.join(asked_for)}"
    left = TextSpan("Structure is left that nothing in the catalogue explains.", "strong")
    return Paragraph((left, TextSpan(f"{along}{done}")), "callout")


def _carrier(form: Mapping[str, Any]) -> str:
    names = ", ".join(map(str, list_of(form.get("columns"))))
    rms, spread = value_of(form, "rms_um"), value_of(form, "rms_std_um")
    if rms is None or spread is None:
        return names
    return f"{names} ({markup.significant(rms, 3)} ± {markup.significant(2.0 * spread, 2)} µm RMS, k = 2)"


def _summary(diagnosis: Mapping[str, Any]) -> list[Block]:
    held_out = object_of(diagnosis.get("held_out"))
    rows = []
    for key, name in (("rms_um", "RMS residual, µm"), ("peak_um", "largest residual, µm")):
        before, after = value_of(diagnosis.get("before"), key), value_of(diagnosis.get("after"), key)
        if before is not None and after is not None:
            rows.append((name, markup.number(before), markup.number(after), markup.change(before, after)))
    facts = []
    if (floor := value_of(diagnosis, "noise_floor_um")) is not None:
        spread = value_of(diagnosis, "noise_floor_std_um")
        plus = f" ± {markup.number(2.0 * spread)}" if spread is not None else ""
        dof = value_of(diagnosis, "noise_floor_dof")
        freedom = f" ({dof:.0f} degrees of freedom)" if dof else ""
        known = ", k = 2" if plus else ""
        facts.append(f"Noise floor from repeats: {markup.number(floor)}{plus} µm{freedom}{known}.")
    elif (within := value_of(object_of(diagnosis.get("noise")), "within_run_um")) is not None:
        facts.append(f"No true repeats; the model's noise within a run is {markup.number(within)} µm.")
    if declared := list_of(diagnosis.get("declared")):
        facts.append(f"Declared model: {', '.join(map(str, declared))}.")
    if held_out:
        facts.append(
            f"Both columns are on {held_out.get('rows', '?')} rows that were not fitted ({held_out.get('how', 'how is not stated')})."
        )
    head = ("", "declared model", "with the effects found", "change")
    table = [ReportTable(head, tuple(rows), "numbers")] if rows else []
    return [said(" ".join(facts)), *table]


def _residual(diagnosed: NamedCampaign, findings: list[Mapping[str, Any]]) -> list[Block]:
    view = position_view(diagnosed.records, findings)
    columns = {"run": diagnosed.records.run, "direction": view.direction, "target_mm": view.x}
    columns |= {"residual_um": view.residual_um, "laid_over_um": view.over_um}
    caption = f"Residual of the declared model against position; laid over: {view.over}. Their difference is the residual with"
    caption += " the effects found: the table above has the figures of both."
    if "explained_um" not in diagnosed.records:
        caption = f"Residual of {diagnosed.label} against position; laid over: {view.over}."
    return [
        Drawing("residual", "residual", _drawer(view), "Residual against position", caption),
        DataTable("data-residual", "Data of this drawing", columns),
    ]


def _finding(index: int, finding: Mapping[str, Any], diagnosed: NamedCampaign | None, *, alone: bool) -> Framed:
    effect = str(finding.get("effect", "unnamed"))
    action = str(finding.get("action", ""))
    confidence = value_of(finding, "confidence")
    sure = f" · confidence {percent(confidence)}" if confidence is not None else ""
    parts: list[Block] = [
        Heading(f"{index}. {effect}", 3, ACTIONS.get(action, action or "no action stated")),
        Paragraph((TextSpan(str(finding.get("explanation", ""))), TextSpan(sure, "muted"))),
    ]
    rows = tuple(
        (
            name,
            markup.significant(value_of(value, "value")),
            markup.significant(value_of(value, "std"), 2),
            _range(value),
        )
        for name, value in object_of(finding.get("parameters")).items()
    )
    if rows:
        parts.append(
            ReportTable(("parameter", "value", "standard uncertainty (k = 1)", "interval at 95 %"), rows, "numbers")
        )
    for rival in objects_of(finding.get("rivals")):
        share = value_of(rival, "confidence")
        weight = f" ({percent(share)})" if share is not None else ""
        apart = f"{weight}. To tell them apart: {rival.get('separate_by', 'not stated')}"
        parts.append(Paragraph((TextSpan("Rival: "), TextSpan(str(rival.get("effect")), "strong"), TextSpan(apart))))
    if (view := finding_view(finding, diagnosed, alone=alone)) is not None:
        columns = {
            "x": view.x,
            "direction": view.direction,
            "residual_um": view.residual_um,
            "laid_over_um": view.over_um,
        }
        caption = f"{view.of} against {view.label[0].lower() + view.label[1:]}; laid over: {view.over}."
        parts += [
            Drawing(f"finding{index}", f"finding-{index}", _drawer(view), f"Residual and {effect}", caption),
            DataTable(f"data-finding-{index}", f"Data of this drawing (x is {view.label})", columns),
        ]
    return Framed(tuple(parts))


def percent(share: float) -> str:
    """A probability in percent; never rounded to 0 or 100."""
    if 0.9995 <= share <= 1:
        return "above 99.9 %"
    return "below 0.1 %" if 0 <= share < 0.0005 else f"{100 * share:.1f} %"


def _drawer(view: ResidualView) -> Callable[[Theme, Ground], FigureBase]:
    def draw(theme: Theme, ground: Ground) -> FigureBase:
        return plots.residual_plot(
            view.x,
            view.residual_um,
            view.over_um,
            view.direction,
            theme,
            x_label=view.label,
            over=view.over,
            ground=ground,
        )

    return draw
