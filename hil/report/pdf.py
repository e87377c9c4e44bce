"""A report as a PDF: pages of text with figures, tables and hashes, then every drawing on a page of its own. Same data, same bytes."""

from __future__ import annotations

import io
import textwrap
import unicodedata
from collections.abc import Iterator

import matplotlib as mpl
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from hil.iso230 import FIGURES, Iso230
from hil.report.compare import difference, verdict
from hil.report.data import ReportData, environment, plain
from hil.report.document import budgets, drawings, symbol
from hil.report.svg import LIGHT, RC
from hil.report.uncertainty import stated
from hil.uncertainty import Budget

_A4_IN = (8.27, 11.69)
_WIDE, _LINES = 124, 74  # characters of a line, lines of a page


def render_pdf(data: ReportData) -> bytes:
    """The whole file."""
    out = io.BytesIO()
    metadata = {"Title": plain(data.title), "CreationDate": None, "Producer": None, "Creator": None}
    with mpl.rc_context({**RC, "pdf.fonttype": 42}), PdfPages(out, metadata=metadata) as pages:
        lines = [part for line in _text(data) for part in _wrapped(line)]
        for start in range(0, len(lines), _LINES):
            pages.savefig(_page(lines[start : start + _LINES], title=plain(data.title) if start == 0 else ""))
        for name, figure in drawings(data).items():
            figure.set_facecolor(LIGHT.surface)
            figure.text(0.995, 0.005, name, ha="right", va="bottom", fontsize=6, color=LIGHT.muted)
            pages.savefig(figure)
    return out.getvalue()


def _page(lines: list[str], *, title: str) -> Figure:
    figure = Figure(figsize=_A4_IN, facecolor=LIGHT.surface)
    if title:
        figure.text(0.07, 0.965, title, fontsize=14, fontweight="bold", color=LIGHT.ink, va="top")
    figure.text(
        0.07,
        0.935,
        "\n".join(lines),
        family="DejaVu Sans Mono",
        fontsize=7.2,
        color=LIGHT.ink,
        va="top",
        linespacing=1.25,
    )
    return figure


def _wrapped(line: str) -> list[str]:
    return textwrap.wrap(
        plain(line), _WIDE, subsequent_indent="    ", replace_whitespace=False, drop_whitespace=False
    ) or [""]


def _text(data: ReportData) -> Iterator[str]:
    yield data.created
    yield from _block("Identity", dict(data.identity) | environment(data.campaigns[-1].records))
    yield from _figures(data)
    if data.compare:
        first, second = data.campaigns
        found = difference(first.records, second.records)
        yield from _list(f"{second.label} against {first.label}", [verdict(found)] if len(found.target_mm) else [])
    for campaign, known in zip(data.campaigns, budgets(data), strict=True):
        if isinstance(known, Budget):
            parts = {one.name: f"{one.expanded_um:6.2f} µm  {one.how}" for one in known.contributions}
            yield from _block(f"Uncertainty (k = 2) of {campaign.label}", parts)
    for campaign in data.campaigns:
        figures = campaign.figures()
        notes = list(figures.notes) if isinstance(figures, Iso230) else [f"No ISO 230-2 figures: {figures}."]
        source = [f"{campaign.source} SHA-256 {campaign.sha256}"] if campaign.source else []
        yield from _list(campaign.label, [campaign.note, *source, *notes])
    if data.diagnosis is not None:
        findings = [one for one in data.diagnosis.get("findings", []) if isinstance(one, dict)]
        said = [f"{one.get('effect')} ({one.get('action')}): {one.get('explanation', '')}" for one in findings]
        yield from _list("What is left, and why", said or ["No effect was found."])
    yield from _list(
        "Correction tables in force", [f"{one.name} {one.what} SHA-256 {one.sha256}" for one in data.tables]
    )
    yield from _block("Signatures", dict(data.signatures))
    yield from _list("Notes", list(data.notes))


def _figures(data: ReportData) -> Iterator[str]:
    """A line per figure, a column per campaign."""
    yield ""
    yield "Figures of ISO 230-2:2014, µm:"
    yield f"{'':6}" + "".join(f"{plain(campaign.label)[:20]:>22}" for campaign in data.campaigns)
    all_figures = [campaign.figures() for campaign in data.campaigns]
    for name, meaning in FIGURES.items():
        cells = [
            stated(found.figures()[name] if isinstance(found, Iso230) else None, name, known)
            for found, known in zip(all_figures, budgets(data), strict=True)
        ]
        width = 6 + sum(
            unicodedata.combining(letter) > 0 for letter in symbol(name)
        )  # a bar over a letter takes no room of its own
        yield f"{symbol(name):{width}}" + "".join(f"{cell:>22}" for cell in cells) + f"  {meaning}"


def _block(title: str, facts: dict[str, str]) -> Iterator[str]:
    if facts:
        yield ""
        yield f"{title}:"
        for name, value in facts.items():
            yield f"{name:24} {value}"


def _list(title: str, items: list[str]) -> Iterator[str]:
    kept = [item for item in items if item]
    if kept:
        yield ""
        yield f"{title}:"
        yield from kept
