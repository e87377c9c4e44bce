"""Stored measurements of an axis, as the screen lists them, the newest first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from hil.figures.history import FoundCampaign, Pass, find_campaigns
from hil.figures.iso230 import Iso230
from hil.records.journal import measurement_of

Points = tuple[tuple[float, float], ...]
STATES = ("torn", "changed", "open", "closed")
"""From the worst to the best."""


@dataclass(frozen=True)
class Measurement:
    """One or more passes of a campaign, measured in one condition of the machine.

    key: unique in the axis's folder; state: of its worst pass; figures_um: figures of ISO 230-2, those that it has, µm.
    """

    key: str
    kind: str
    begun: datetime
    paths: tuple[Path, ...]
    rows: int
    runs: int
    state: str
    figures_um: Mapping[str, float]


def measurements(directory: Path) -> list[Measurement]:
    """Measurements in an axis's folder, the newest first; those without a readable row are left out."""
    if not directory.is_dir():
        return []
    found = [one for campaign in find_campaigns([directory]) for one in _of(campaign)]
    return sorted(found, key=lambda one: (one.begun.timestamp(), one.key), reverse=True)


def _of(campaign: FoundCampaign) -> Iterable[Measurement]:
    groups: dict[str, list[Pass]] = {}
    for one in campaign.passes:
        if one.records is not None:
            groups.setdefault(measurement_of(one.name), []).append(one)
    for name, passes in groups.items():
        figures = passes[0].figures() if len(passes) == 1 else ""
        known = figures.figures() if isinstance(figures, Iso230) else {}
        yield Measurement(
            f"{campaign.directory.name}/{name}",
            campaign.kind,
            passes[0].begun,
            tuple(one.path for one in passes),
            sum(len(one.records) for one in passes if one.records is not None),
            sum(len(one.records.runs) for one in passes if one.records is not None),
            min((one.state for one in passes), key=STATES.index),
            {figure: value for figure, value in known.items() if value is not None},
        )
