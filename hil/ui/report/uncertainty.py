"""The uncertainty section of a report: inputs on instrument and room, and the uncertainty of the figures."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.errors import InputError
from hil.figures.iso230 import Iso230
from hil.figures.uncertainty import Budget, UncertaintyInputs, budget
from hil.ui.report import markup
from hil.ui.report.blocks import Block, Heading, ReportTable, said
from hil.ui.report.data import NamedCampaign


def budget_of(campaign: NamedCampaign, inputs: UncertaintyInputs | None) -> Budget | str | None:
    """A campaign's uncertainty budget; the reason, as text, where it cannot be made; None without inputs or ISO 230-2 figures."""
    figures = campaign.figures()
    if inputs is None or not isinstance(figures, Iso230):
        return None
    try:
        return budget(inputs, figures, campaign.records)
    except InputError as error:
        return error.what


def stated(value: float | None, name: str, known: Budget | str | None) -> str:
    """A figure, µm, as text, with its expanded uncertainty where the budget has one. name: as in `Iso230.figures`."""
    text = markup.number(value)
    if value is None or not isinstance(known, Budget) or name not in known.figures_um:
        return text
    return f"{text} ± {markup.number(known.figures_um[name])}"


def section(budgets: Sequence[Budget | str | None], labels: Sequence[str]) -> list[Block]:
    """The blocks of this section, one table per campaign; none where no campaign has a budget or a reason."""
    parts: list[Block] = []
    for label, known in zip(labels, budgets, strict=True):
        if isinstance(known, str):
            parts.append(said(f"No uncertainty for {label}: {known}.", "callout"))
        elif known is not None:
            rows = tuple((one.name, markup.number(one.expanded_um), one.how) for one in known.contributions)
            head = ("Contribution", "U, µm (k = 2)", "")
            of = known.lead.replace("_up", "↑").replace("_down", "↓")
            parts.append(
                ReportTable(head, rows, "meaning", f"{label}: to {of} over {known.length_mm:g} mm; the squares add up")
            )
    if not parts:
        return []
    lead = (
        "Figures stand with their expanded uncertainty (k = 2): the contributions of ISO/TR 230-9 propagated to each, and what another"
        " choice of targets would change. What another day would change is not in it."
    )
    return [Heading("Uncertainty of measurement"), said(lead), *parts]
