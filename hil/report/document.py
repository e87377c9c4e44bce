"""A report as one HTML file: data in, text out. The file refers to nothing outside itself and says so in its own policy.

`render_html` gives the page, `render_files` the same drawings as files of their own, `before_after_image` the comparison alone. The
same data give the same bytes. (Importing this module loads matplotlib, which takes a moment: a command imports it when it needs it.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from hil.iso230 import FIGURES, Iso230
from hil.records import Floats, Records
from hil.report import compare, markup, plots
from hil.report import diagnosis as diagnosis_part
from hil.report import uncertainty as uncertainty_part
from hil.report.data import NamedCampaign, ReportData, environment, history
from hil.report.page import header, page
from hil.report.svg import LIGHT, PAGE, file_bytes, inline_svg
from hil.uncertainty import Budget

MAX_UNFOLDED_TARGETS = 60
"""The table per target stands open up to this length."""


def render_html(data: ReportData) -> str:
    """The whole page. Same data, same text."""
    body = [
        _header(data),
        _tiles(data),
        _identity(data),
        _comparison(data) if len(data.campaigns) > 1 else "",
        _figures_table(data),
        compare.section(*data.campaigns) if data.compare else "",
        *(_campaign(index, campaign, data) for index, campaign in enumerate(data.campaigns, start=1)),
        diagnosis_part.section(data.diagnosis, data.diagnosed) if data.diagnosis is not None else "",
        uncertainty_part.section(budgets(data), [campaign.label for campaign in data.campaigns]),
        _tables_in_force(data),
        _signatures(data),
        "<h2>Notes</h2>" + markup.paragraph_list(data.notes) if data.notes else "",
        _footer(),
    ]
    return page(data.title, body)


def budgets(data: ReportData) -> list[Budget | str | None]:
    """The uncertainty of each campaign's figures."""
    return [uncertainty_part.budget_of(campaign, data.uncertainty) for campaign in data.campaigns]


def render_files(data: ReportData, kind: str = "png") -> dict[str, bytes]:
    """Every drawing of the report as a file of its own on a white ground, by file name; `kind` is "png" or "svg"."""
    return {f"{name}.{kind}": file_bytes(figure, kind) for name, figure in drawings(data).items()}


def drawings(data: ReportData) -> dict[str, Figure]:
    """Every drawing of the report by name, for a white ground."""
    drawn: dict[str, Figure] = {}
    if len(data.campaigns) > 1:
        drawn["before-after"] = plots.before_after_plot(data.campaigns, LIGHT, data.band_um)
    for index, campaign in enumerate(data.campaigns, start=1):
        drawn[f"campaign-{index}-error"] = plots.error_plot(campaign, LIGHT, data.band_um)
        drawn[f"campaign-{index}-time"] = plots.history_plot(campaign, LIGHT)
    if data.diagnosis is not None:
        drawn |= diagnosis_part.finding_figures(data.diagnosis, data.diagnosed, LIGHT)
    if data.compare:
        found = compare.difference(data.campaigns[0].records, data.campaigns[1].records)
        if len(found.target_mm):
            drawn["difference"] = compare.difference_figure(found, LIGHT)
    return drawn


def before_after_image(
    campaigns: Sequence[NamedCampaign], kind: str = "png", band_um: tuple[float, float] | None = None
) -> bytes:
    """The campaigns side by side on one scale, as a PNG or SVG file."""
    return file_bytes(plots.before_after_plot(campaigns, LIGHT, band_um), kind)


def rms_um(records: Records) -> float:
    """Root mean square of the error as measured, over all rows, µm."""
    return float(np.sqrt(np.mean(records.error_um**2)))


def _header(data: ReportData) -> str:
    axis = data.identity.get("Axis", "")
    under = " · ".join(part for part in (f"Axis: {axis}" if axis else "", data.created) if part)
    return header(data.title, under)


def _tiles(data: ReportData) -> str:
    first, last = data.campaigns[0], data.campaigns[-1]
    one, other = first.figures(), last.figures()
    values: list[tuple[str, float | None, float | None]] = []
    for name, title in (
        ("A", "Accuracy A"),
        ("E", "Systematic deviation E"),
        ("R", "Repeatability R"),
        ("B", "Reversal value B"),
    ):
        pair = [figures.figures()[name] if isinstance(figures, Iso230) else None for figures in (one, other)]
        values.append((title, pair[0], pair[1]))
    values.append(("RMS error", rms_um(first.records), rms_um(last.records)))
    tiles = [_tile(*value, compare=first is not last) for value in values if value[2] is not None]
    if data.band_um is not None and isinstance(other, Iso230):
        tiles.append(_band_tile(other, data.band_um))
    return '<div class="tiles">' + "".join(tiles) + "</div>"


def _tile(title: str, first: float | None, last: float | None, *, compare: bool) -> str:
    comparison = ""
    if compare and first is not None and last is not None:
        better = "better" if last < first else "worse" if last > first else ""
        comparison = (
            f'<div class="from">as found {markup.number(first)} µm '
            f'<span class="{better}">{markup.text(diagnosis_part.change(first, last))}</span></div>'
        )
    return (
        f'<div class="tile"><div class="name">{markup.text(title)}</div>'
        f'<div class="value">{markup.number(last)} <small>µm</small></div>{comparison}</div>'
    )


def _band_tile(figures: Iso230, band_um: tuple[float, float]) -> str:
    means = np.concatenate([mean for mean in (figures.mean_up, figures.mean_down) if mean is not None])
    inside = int(np.sum((means >= band_um[0]) & (means <= band_um[1])))
    css = "better" if inside == len(means) else "worse"
    return (
        f'<div class="tile"><div class="name">Inside {band_um[0]:g} to {band_um[1]:g} µm</div>'
        f'<div class="value {css}">{inside} of {len(means)}</div><div class="from">target means</div></div>'
    )


def _identity(data: ReportData) -> str:
    facts = dict(data.identity)
    for name, value in environment(data.campaigns[-1].records).items():
        facts.setdefault(name, value)
    return "<h2>Identity</h2>" + markup.definitions(facts) if facts else ""


def _comparison(data: ReportData) -> str:
    svg = inline_svg(plots.before_after_plot(data.campaigns, PAGE, data.band_um), "compare", "Campaigns on one scale")
    names = "; ".join(campaign.label for campaign in data.campaigns)
    caption = f"Error against position on one scale: {names}. Positive: the axis stands further than it was asked to."
    return "<h2>Comparison</h2>" + markup.figure(svg, caption)


def _figures_table(data: ReportData) -> str:
    all_figures = [campaign.figures() for campaign in data.campaigns]
    compare = len(data.campaigns) > 1
    spreads = budgets(data)
    head = ["Figure, µm", *(campaign.label for campaign in data.campaigns), *(["change"] if compare else []), ""]
    rows = []
    for name, meaning in FIGURES.items():
        values = [figures.figures()[name] if isinstance(figures, Iso230) else None for figures in all_figures]
        last = [diagnosis_part.change(values[0], values[-1])] if compare else []
        if name == "B_mean" and compare:
            last = ["–"]
        cells = [uncertainty_part.stated(value, name, known) for value, known in zip(values, spreads, strict=True)]
        rows.append([symbol(name), *cells, *last, meaning])
    spread: list[tuple[str, list[float]]] = [
        ("RMS error", [rms_um(campaign.records) for campaign in data.campaigns]),
        ("largest error", [float(np.max(np.abs(campaign.records.error_um))) for campaign in data.campaigns]),
    ]
    for title, numbers in spread:
        last = [diagnosis_part.change(numbers[0], numbers[-1])] if compare else []
        rows.append([title, *map(markup.number, numbers), *last, "over all rows"])
    shape = [
        f"{figures.m} targets, {figures.n} runs" if isinstance(figures, Iso230) else f"{len(campaign.records)} rows"
        for figures, campaign in zip(all_figures, data.campaigns, strict=True)
    ]
    rows.append(["campaign", *shape, *([""] if compare else []), "per direction"])
    return "<h2>Figures of ISO 230-2:2014</h2>" + markup.table(head, rows, css="numbers meaning")


def _campaign(index: int, campaign: NamedCampaign, data: ReportData) -> str:
    figures = campaign.figures()
    key = f"campaign-{index}"
    along = history(campaign.records)
    parts = [f"<h2>{markup.text(campaign.label)}</h2>"]
    source = [campaign.note]
    if campaign.source:
        source.append(f"Source: {campaign.source}" + (f", SHA-256 {campaign.sha256}" if campaign.sha256 else ""))
    parts += [f'<p class="muted">{markup.text(line)}</p>' for line in source if line]
    svg = inline_svg(
        plots.error_plot(campaign, PAGE, data.band_um), f"error{index}", f"Error against position, {campaign.label}"
    )
    parts.append(
        markup.figure(svg, "Error (measured − target) against position, each run and the mean ± 2s of each direction.")
    )
    if isinstance(figures, Iso230):
        parts.append(_per_target(f"data-{key}-targets", figures))
        parts.append(markup.paragraph_list(figures.notes, "remarks"))
    else:
        parts.append(f'<p class="callout">No ISO 230-2 figures: {markup.text(figures)}.</p>')
    svg = inline_svg(plots.history_plot(campaign, PAGE), f"time{index}", f"Deviation along time, {campaign.label}")
    order = "" if along.timed else " The records hold no time; the order of the rows stands in."
    parts.append(
        markup.figure(
            svg,
            f"What is left along time: each error minus the mean of its target and direction, bars are run means.{order}",
        )
    )
    columns = {**campaign.records.columns, "error_um": campaign.records.error_um, "deviation_um": along.deviation_um}
    parts.append(markup.data_table(f"data-{key}-records", "Records behind these drawings", columns))
    return "\n".join(parts)


def _per_target(identifier: str, figures: Iso230) -> str:
    columns: dict[str, tuple[str, Floats | None]] = {
        "target_mm": ("target, mm", figures.target_mm),
        "mean_up_um": ("x̄↑, µm", figures.mean_up),
        "mean_down_um": ("x̄↓, µm", figures.mean_down),
        "s_up_um": ("s↑, µm", figures.s_up),
        "s_down_um": ("s↓, µm", figures.s_down),
        "B_um": ("B, µm", figures.B_i),
        "R_up_um": ("R↑, µm", figures.R_up_i),
        "R_down_um": ("R↓, µm", figures.R_down_i),
        "R_um": ("R, µm", figures.R_i),
    }
    return markup.data_table(
        identifier,
        "Per target",
        {name: values for name, (_, values) in columns.items() if values is not None},
        heads={name: head for name, (head, _) in columns.items()},
        unfolded=figures.m <= MAX_UNFOLDED_TARGETS,
    )


def _tables_in_force(data: ReportData) -> str:
    if not data.tables:
        return ""
    rows = [[table.name, table.what, table.sha256] for table in data.tables]
    return "<h2>Correction tables in force</h2>" + markup.table(["Table", "What", "SHA-256"], rows, css="hash")


def _signatures(data: ReportData) -> str:
    if not data.signatures:
        return ""
    return "<h2>Signatures</h2>" + markup.table(["File", "Signature"], data.signatures.items(), css="hash")


def symbol(name: str) -> str:
    """A figure's name as it is printed."""
    return "B̄" if name == "B_mean" else name.replace("_up", "↑").replace("_down", "↓")


def _footer() -> str:
    return (
        "<footer>Error = measured − target, in µm, with the correction that was in force; ↑ is direction +, ↓ direction −; s is the "
        "standard deviation over the runs (n − 1). A, E, M, R and B as defined in ISO 230-2:2014, clause 3. The data behind every "
        "drawing are inside this file as JSON; nothing is loaded from elsewhere.</footer>"
    )
