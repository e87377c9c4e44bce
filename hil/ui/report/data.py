"""Contents of a report as plain data: campaigns, identity of the axis, tables in force, diagnosis, signatures.

Nothing here measures, fits or draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from drivers.errors import InputError
from hil.correction.tables import Band
from hil.figures.iso230 import Iso230, iso230
from hil.figures.uncertainty import UncertaintyInputs
from hil.figures.verdict import Accuracy, At, accuracy
from hil.records.rows import Floats, Records

if TYPE_CHECKING:  # drawings are slow to import
    from hil.ui.report.blocks import Block


@dataclass(frozen=True)
class NamedCampaign:
    """One campaign of measurement under its name in the report ('before', 'after calibration', …).

    source: file name of the rows; sha256: hash of that file; "" where there is none; corrected: whether a correction was in force,
    None: by the rows; files: number of files that the rows are from; calibrated_mm: targets of the tables as the campaign states
    them, () where it does not
    """

    label: str
    records: Records
    note: str = ""
    source: str = ""
    sha256: str = ""
    corrected: bool | None = None
    files: int = 1
    calibrated_mm: tuple[float, ...] = ()

    def figures(self) -> Iso230 | str:
        """The campaign's ISO 230-2 figures; the reason, as text, where it has none."""
        try:
            return iso230(self.records)
        except InputError as error:
            return error.what


@dataclass(frozen=True)
class TableInForce:
    """A correction table that was in force: its name, the hash of its file, and its kind."""

    name: str
    sha256: str
    what: str = ""


@dataclass(frozen=True)
class ReportData:
    """The contents of a report. Raises InputError without a campaign, and for two campaigns with one label.

    campaigns        in the order of time; the first and the last are compared
    identity         name -> value of what a reader needs to repeat it: axis, drive, instrument, environment, operator, …
    band             the specified accuracy band, with the signs of its sections; None without one
    band_targets_mm  targets of the tables: between two of them whose signs differ, means are not held against the band
    tables           correction tables in force in the last campaign
    causes           blocks on the causes of what is left, () without a diagnosis
    compare          whether the two campaigns are compared target by target; InputError unless there are two
    uncertainty      inputs on instrument and room; figures are then given with their expanded uncertainty
    signatures       file name -> who signed it, or why its signature is not good
    limit_um         largest accuracy A that is allowed, None without one
    opening          the first sentence: the result of a loop; "" for none
    created          date and time to print, as text: the clock is not read, so the same data give the same bytes
    """

    title: str
    campaigns: tuple[NamedCampaign, ...]
    identity: Mapping[str, str] = field(default_factory=dict)
    band: Band | None = None
    tables: tuple[TableInForce, ...] = ()
    causes: Sequence[Block] = ()
    notes: tuple[str, ...] = ()
    created: str = ""
    uncertainty: UncertaintyInputs | None = None
    signatures: Mapping[str, str] = field(default_factory=dict)
    compare: bool = False
    band_targets_mm: tuple[float, ...] = ()
    limit_um: float | None = None
    opening: str = ""

    def __post_init__(self) -> None:
        if not self.campaigns:
            raise InputError("a report needs at least one campaign of records")
        labels = [campaign.label for campaign in self.campaigns]
        if len(set(labels)) != len(labels):
            raise InputError(f"campaigns share a label: {', '.join(labels)}")
        if self.compare and len(self.campaigns) != 2:
            raise InputError(f"a comparison is of two campaigns, not of {len(self.campaigns)}")

    def accuracy(self, campaign: NamedCampaign) -> Accuracy:
        """The accuracy A of one of the campaigns, with its uncertainty, against the limit."""
        calibrated_mm = (*self.band_targets_mm, *campaign.calibrated_mm)
        return accuracy(campaign.records, self.uncertainty, self.limit_um, calibrated_mm, corrected=campaign.corrected)

    def verified(self) -> Accuracy | None:
        """The accuracy of the last campaign at other targets than the tables', None without one."""
        found = [self.accuracy(campaign) for campaign in self.campaigns]
        return next((one for one in reversed(found) if one.at is At.OTHER and one.A_um is not None), None)


@dataclass(frozen=True)
class History:
    """A campaign along time, shape (n,) each.

    x: in `unit`; timed: whether x is a time, else the row number; deviation_um: error minus the mean error of the same target and
    direction
    """

    x: Floats
    unit: str
    timed: bool
    deviation_um: Floats


def history(records: Records) -> History:
    """The error less the mean of its target and direction, along time: it shows drift, steps and scatter.

    Along the row number where `time_s` is missing or incomplete.
    """
    deviation_um = np.empty(len(records))
    key = np.stack([records.direction, np.round(records.target_mm * 1e6)])
    _, group = np.unique(key, axis=1, return_inverse=True)
    for index in range(int(group.max()) + 1):
        here = group.ravel() == index
        deviation_um[here] = records.error_um[here] - records.error_um[here].mean()
    if "time_s" not in records or not np.all(np.isfinite(records["time_s"])):
        return History(np.arange(1, len(records) + 1, dtype=np.float64), "row", False, deviation_um)
    time_s = records["time_s"] - records["time_s"].min()
    long = float(time_s.max()) > 300
    return History(time_s / 60 if long else time_s, "min" if long else "s", True, deviation_um)


def environment(records: Records) -> dict[str, str]:
    """Ranges of the environment columns that the records have, by name, as text with units."""
    known = {
        "air_temp_c": ("Air temperature", "°C"),
        "air_pressure_hpa": ("Air pressure", "hPa"),
        "air_humidity_percent": ("Air humidity", "%"),
    }
    for name in records.columns:
        if name.startswith("temp_") and name.endswith("_c"):
            known[name] = (f"Temperature, {name[5:-2].replace('_', ' ')}", "°C")
    found: dict[str, str] = {}
    for name, (title, unit) in known.items():
        values = records[name][np.isfinite(records[name])] if name in records else np.empty(0)
        if len(values):
            low, high = float(values.min()), float(values.max())
            found[title] = f"{low:.2f} {unit}" if high - low < 0.005 else f"{low:.2f} to {high:.2f} {unit}"
    return found
