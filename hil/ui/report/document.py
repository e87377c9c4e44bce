"""The report document: its blocks (`content`), one HTML page (`render_html`), its drawings as files (`render_files`).

The page loads nothing from elsewhere, which its content security policy enforces. The same data give the same bytes. Importing this
module loads matplotlib, which takes time: commands import it where they need it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import FigureBase

from hil.correction.tables import Band, SectionMeans, judge
from hil.figures import FIGURES
from hil.figures.error_figures import rms
from hil.figures.iso230 import Iso230, symbol
from hil.figures.uncertainty import Budget
from hil.figures.verdict import PLUS_MINUS, At, Decision
from hil.records.rows import Floats
from hil.ui.report import compare, markup, plots
from hil.ui.report import uncertainty as uncertainty_part
from hil.ui.report.blocks import (
    Block,
    Bullets,
    DataTable,
    Drawing,
    Facts,
    Framed,
    Heading,
    Paragraph,
    ReportTable,
    TextSpan,
    Tile,
    Tiles,
    said,
    walk,
)
from hil.ui.report.data import NamedCampaign, ReportData, environment, history
from hil.ui.report.markup import header, page
from hil.ui.report.svg import LIGHT, PAGE, Ground, Theme, file_bytes, inline_svg


def inline(drawing: Drawing) -> str:
    """The drawing as an <svg> element in the page's own colours."""
    return inline_svg(drawing.figure(PAGE), drawing.key, drawing.description)


def html(blocks: Iterable[Block], drawn: Callable[[Drawing], str] = inline) -> str:
    """The markup of blocks, one line per block. drawn(): the markup of a drawing."""
    return "\n".join(part for part in (_block(block, drawn) for block in blocks) if part)


def _block(block: Block, drawn: Callable[[Drawing], str]) -> str:  # noqa: PLR0911  (one for each kind)
    match block:
        case Heading():
            tag = f'<span class="tag">{markup.text(block.tag)}</span>' if block.tag else ""
            return f"<h{block.level}>{markup.text(block.text)}{tag}</h{block.level}>"
        case Paragraph():
            return _paragraph(block)
        case Bullets():
            return markup.paragraph_list(block.items, block.style)
        case Tiles():
            return '<div class="tiles">' + "".join(map(_tile_markup, block.tiles)) + "</div>"
        case Facts():
            return markup.definitions(block.facts)
        case ReportTable():
            css = {"meaning": "numbers meaning"}.get(block.style, block.style)
            return markup.table(block.head, block.rows, css=css, caption=block.caption)
        case DataTable():
            return markup.data_table(
                block.identifier, block.title, block.columns, heads=block.heads, unfolded=block.unfolded
            )
        case Drawing():
            return markup.figure(drawn(block), block.caption)
        case Framed():
            return f'<section class="finding">{html(block.blocks, drawn)}</section>'


def _paragraph(block: Paragraph) -> str:
    css = f' class="{block.style}"' if block.style else ""
    words = []
    for span in block.spans:
        said = markup.text(span.text)
        match span.style:
            case "strong":
                said = f"<strong>{said}</strong>"
            case "muted":
                said = f'<span class="muted">{said}</span>'
        words.append(said)
    return f"<p{css}>{''.join(words)}</p>"


def _tile_markup(tile: Tile) -> str:
    css = {True: "better", False: "worse", None: ""}[tile.good]
    unit = f" <small>{markup.text(tile.unit)}</small>" if tile.unit else ""
    below = markup.text(tile.below)
    if tile.verdict:
        below += f' <span class="{css}">{markup.text(tile.verdict)}</span>'
    under = f'<div class="from">{below}</div>' if below else ""
    on_value = f" {css}" if css and not tile.verdict else ""
    return (
        f'<div class="tile"><div class="name">{markup.text(tile.name)}</div>'
        f'<div class="value{on_value}">{markup.text(tile.value)}{unit}</div>{under}</div>'
    )


MAX_UNFOLDED_TARGETS = 60
"""Largest number of targets at which the table per target is shown unfolded."""

SIGNS = (
    "Error = measured − target, in µm, with the correction that was in force; ↑ is direction +, ↓ direction −; s is the"
    " standard deviation over the runs (n − 1). A, E, M, R and B as defined in ISO 230-2:2014, clause 3."
)
"""Definitions of signs, symbols and figures, in the footer of a report."""


def content(data: ReportData) -> list[Block]:
    """All blocks of a report in order, without the title."""
    parts: list[Block] = [Paragraph((TextSpan(data.opening, "strong"),))] if data.opening else []
    parts += [*_verdict(data), *_tiles(data), *_identity(data)]
    if len(data.campaigns) > 1:
        parts += _comparison(data)
    parts += _figures_table(data)
    if data.compare:
        parts += compare.section(*data.campaigns)
    for index, campaign in enumerate(data.campaigns, start=1):
        parts += _campaign(index, campaign, data)
    parts += data.causes
    parts += uncertainty_part.section(budgets(data), [campaign.label for campaign in data.campaigns])
    parts += [*_tables_in_force(data), *_signatures(data)]
    return [*parts, Heading("Notes"), Bullets(data.notes)] if data.notes else parts


def under_title(data: ReportData) -> str:
    """The line below the title: axis, date and time."""
    axis = data.identity.get("Axis", "")
    return " · ".join(part for part in (f"Axis: {axis}" if axis else "", data.created) if part)


def render_html(data: ReportData) -> str:
    """The report as an HTML page. The same data give the same text."""
    footer = f"<footer>{SIGNS} The data behind every drawing are inside this file as JSON; nothing is loaded from elsewhere.</footer>"
    return page(data.title, [header(data.title, under_title(data)), html(content(data)), footer])


def budgets(data: ReportData) -> list[Budget | str | None]:
    """The uncertainty budget of each campaign's figures, see `uncertainty.budget_of`."""
    return [uncertainty_part.budget_of(campaign, data.uncertainty) for campaign in data.campaigns]


def render_files(data: ReportData) -> dict[str, bytes]:
    """File name -> contents of each drawing of the report, PNG on a white ground."""
    drawings = [block for block in walk(content(data)) if isinstance(block, Drawing)]
    return {f"{drawing.file}.png": file_bytes(drawing.figure(LIGHT), "png") for drawing in drawings}


def before_after_image(campaigns: Sequence[NamedCampaign]) -> bytes:
    """The campaigns side by side on one scale, PNG."""
    return file_bytes(plots.before_after_plot(campaigns, LIGHT), "png")


def _verdict(data: ReportData) -> list[Block]:
    """The accuracy at other targets against the limit, in one sentence, and what its ± is; where it was not measured, that."""
    found = data.verified()
    if found is None:
        last = data.accuracy(data.campaigns[-1])
        said_last = f"{data.campaigns[-1].label}: {last}." if last.A_um is not None else ""
        lead = "Accuracy at other targets than the tables' was not measured"
        return [Paragraph((TextSpan(f"{lead}.", "strong"), TextSpan(f" {said_last}" if said_last else "")), "callout")]
    style = "" if found.good else "callout"
    return [Paragraph((TextSpan(f"{found}.", "strong"),), style), said(f"{'; '.join(found.explained())}.", "muted")]


def _tiles(data: ReportData) -> list[Block]:
    """Large: the verdict at other targets. Below it, labelled: the figures of the last campaign, compared with the first."""
    first, last = data.campaigns[0], data.campaigns[-1]
    one, other = first.figures(), last.figures()
    at, proof = data.accuracy(last).at, data.verified()
    values: list[tuple[str, float | None, float | None]] = []
    names = [("E", "Systematic deviation E"), ("R", "Repeatability R"), ("B", "Reversal value B")]
    for name, title in names if at is At.OTHER else [("A", f"A {at.value}"), *names]:
        pair = [figures.figures()[name] if isinstance(figures, Iso230) else None for figures in (one, other)]
        values.append((title, pair[0], pair[1]))
    values.append(("RMS error", rms(first.records.error_um), rms(last.records.error_um)))
    good = {Decision.PASS: True, Decision.FAIL: False}.get(proof.decision) if proof is not None else None
    top = [] if proof is None else [Tile("Accuracy A at other targets", proof.value, "µm", proof.reason, good=good)]
    found = "" if first is last else first.label
    tiles = [_tile(*value, was=found) for value in values if value[2] is not None]
    if at is At.CALIBRATED:
        tiles = [replace(tile, good=None) for tile in tiles]
    if data.band is not None and isinstance(other, Iso230):
        tiles.append(_band_tile(other, data.band, data.band_targets_mm, judged=at is not At.CALIBRATED))
    if at is At.OTHER:
        return [Tiles((*top, *tiles))]
    label = said(f"{last.label}, {at.value}:", "muted")
    return [*([Tiles(tuple(top))] if top else []), label, Tiles(tuple(tiles))]


def _tile(title: str, first: float | None, last: float | None, *, was: str) -> Tile:
    """was: the label of the campaign that `first` is of, "" for none."""
    value = markup.number(last)
    if not was or first is None or last is None:
        return Tile(title, value, "µm")
    below = f"{was}: {markup.number(first)} µm"
    return Tile(title, value, "µm", below, markup.change(first, last), None if last == first else last < first)


def _band_tile(figures: Iso230, band: Band, targets_mm: Sequence[float], *, judged: bool) -> Tile:
    """Number of target means within the band, which has the sign of their section and direction; those not judged are left out.

    judged: whether it is coloured as good or bad; at the tables' own targets it proves nothing
    """
    none = np.full(figures.m, np.nan)
    up, down = (none if mean is None else mean for mean in (figures.mean_up, figures.mean_down))
    means = SectionMeans(figures.target_mm, up, down, np.nan)
    outside, unlike = judge(means, band, targets_mm)
    total = int(np.isfinite(up).sum() + np.isfinite(down).sum()) - len(unlike)
    below = "target means" + (f", {len(unlike)} not judged" if unlike else "")
    return Tile(
        f"Inside {band}", f"{total - len(outside)} of {total}", below=below, good=not outside if judged else None
    )


def _identity(data: ReportData) -> list[Block]:
    facts = dict(data.identity)
    for name, value in environment(data.campaigns[-1].records).items():
        facts.setdefault(name, value)
    return [Heading("Identity"), Facts(facts)] if facts else []


def _comparison(data: ReportData) -> list[Block]:
    def draw(theme: Theme, ground: Ground) -> FigureBase:
        return plots.before_after_plot(data.campaigns, theme, data.band, ground)

    names = "; ".join(campaign.label for campaign in data.campaigns)
    caption = f"Error against position on one scale: {names}. Positive: the axis stands further than it was asked to."
    return [Heading("Comparison"), Drawing("compare", "before-after", draw, "Campaigns on one scale", caption)]


def _figures_table(data: ReportData) -> list[Block]:
    all_figures = [campaign.figures() for campaign in data.campaigns]
    compare = len(data.campaigns) > 1
    spreads = budgets(data)
    head = ("Figure, µm", *(campaign.label for campaign in data.campaigns), *(["change"] if compare else []), "")
    rows = []
    for name, meaning in FIGURES.items():
        values = [figures.figures()[name] if isinstance(figures, Iso230) else None for figures in all_figures]
        last = [markup.change(values[0], values[-1])] if compare else []
        if name == "B_mean" and compare:
            last = ["–"]
        cells = [uncertainty_part.stated(value, name, known) for value, known in zip(values, spreads, strict=True)]
        rows.append((symbol(name), *cells, *last, meaning))
    spread: list[tuple[str, list[float]]] = [
        ("RMS error", [rms(campaign.records.error_um) for campaign in data.campaigns]),
        ("largest error", [float(np.max(np.abs(campaign.records.error_um))) for campaign in data.campaigns]),
    ]
    for title, numbers in spread:
        last = [markup.change(numbers[0], numbers[-1])] if compare else []
        rows.append((title, *map(markup.number, numbers), *last, "over all rows"))
    shape = [
        f"{figures.m} targets, {figures.n} runs" if isinstance(figures, Iso230) else f"{len(campaign.records)} rows"
        for figures, campaign in zip(all_figures, data.campaigns, strict=True)
    ]
    rows.append(("campaign", *shape, *([""] if compare else []), "per direction"))
    places = tuple(data.accuracy(campaign).at.value for campaign in data.campaigns)
    rows.append(("targets", *places, *([""] if compare else []), "compared with those of the tables"))
    known = [said(f"{PLUS_MINUS}.", "muted")] if any(isinstance(one, Budget) for one in spreads) else []
    return [Heading("Figures of ISO 230-2:2014"), *known, ReportTable(head, tuple(rows), "meaning")]


def _campaign(index: int, campaign: NamedCampaign, data: ReportData) -> list[Block]:
    def error(theme: Theme, ground: Ground) -> FigureBase:
        return plots.error_plot(campaign, theme, data.band, ground)

    def along_time(theme: Theme, ground: Ground) -> FigureBase:
        return plots.history_plot(campaign, theme, ground)

    figures = campaign.figures()
    key = f"campaign-{index}"
    along = history(campaign.records)
    source = [campaign.note]
    if campaign.source:
        source.append(f"Source: {campaign.source}" + (f", SHA-256 {campaign.sha256}" if campaign.sha256 else ""))
    caption = "Error (measured − target) against position, each run and the mean ± 2s of each direction."
    description = f"Error against position, {campaign.label}"
    parts: list[Block] = [
        Heading(campaign.label),
        *(said(line, "muted") for line in source if line),
        Drawing(f"error{index}", f"{key}-error", error, description, caption),
    ]
    if isinstance(figures, Iso230):
        parts += [_per_target(f"data-{key}-targets", figures), Bullets(tuple(figures.notes), "remarks")]
    else:
        parts.append(said(f"No ISO 230-2 figures: {figures}.", "callout"))
    order = "" if along.timed else " The records hold no time; the order of the rows stands in."
    caption = (
        f"What is left along time: each error minus the mean of its target and direction, bars are run means.{order}"
    )
    description = f"Deviation along time, {campaign.label}"
    columns = {**campaign.records.columns, "error_um": campaign.records.error_um, "deviation_um": along.deviation_um}
    return [
        *parts,
        Drawing(f"time{index}", f"{key}-time", along_time, description, caption),
        DataTable(f"data-{key}-records", "Records behind these drawings", columns),
    ]


def _per_target(identifier: str, figures: Iso230) -> DataTable:
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
    return DataTable(
        identifier,
        "Per target",
        {name: values for name, (_, values) in columns.items() if values is not None},
        heads={name: head for name, (head, _) in columns.items()},
        unfolded=figures.m <= MAX_UNFOLDED_TARGETS,
    )


def _tables_in_force(data: ReportData) -> list[Block]:
    if not data.tables:
        return []
    rows = tuple((table.name, table.what, table.sha256) for table in data.tables)
    return [Heading("Correction tables in force"), ReportTable(("Table", "What", "SHA-256"), rows, "hash")]


def _signatures(data: ReportData) -> list[Block]:
    if not data.signatures:
        return []
    return [Heading("Signatures"), ReportTable(("File", "Signature"), tuple(data.signatures.items()), "hash")]
