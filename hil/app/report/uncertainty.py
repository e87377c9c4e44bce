"""The uncertainty section of a report: inputs on instrument and room, and the uncertainty of the figures."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.errors import InputError
from hil.app.report import markup
from hil.app.report.blocks import Block, Heading, Table, said
from hil.app.report.data import NamedCampaign
from hil.figures.iso230 import Iso230
from hil.figures.uncertainty import Budget, UncertaintyInputs, budget


def budget_of(campaign: NamedCampaign, inputs: UncertaintyInputs | None) -> Budget | str | None:
    """A campaign's uncertainty budget; a sentence with the reason where it has none; None without inputs on the instrument."""
    figures = campaign.figures()
    if inputs is None or not isinstance(figures, Iso230):
        return None
    try:
        return budget(inputs, figures, campaign.records)
    except InputError as error:
        return error.what


def stated(value: float | None, name: str, known: Budget | str | None) -> str:
    """A figure with its expanded uncertainty where there is one."""
    text = markup.number(value)
    if value is None or not isinstance(known, Budget) or name not in known.figures_um:
        return text
    return f"{text} ± {markup.number(known.figures_um[name])}"


def section(budgets: Sequence[Budget | str | None], labels: Sequence[str]) -> list[Block]:
    """The whole part, empty where nothing was known."""
    parts: list[Block] = []
    for label, known in zip(labels, budgets, strict=True):
        if isinstance(known, str):
            parts.append(said(f"No uncertainty for {label}: {known}.", "callout"))
        elif known is not None:
            rows = tuple((one.name, markup.number(one.expanded_um), one.how) for one in known.contributions)
            head = ("Contribution", "U, µm (k = 2)", "")
            parts.append(Table(head, rows, "meaning", f"{label}: over {known.length_mm:g} mm"))
    if not parts:
        return []
    lead = (
        "Figures stand with their expanded uncertainty (k = 2), from the contributions of ISO/TR 230-9 propagated to each. How they"
        " would scatter if the campaign were made again is not in it."
    )
    return [Heading("Uncertainty of measurement"), said(lead), *parts]
