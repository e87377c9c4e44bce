"""Contents of a report as plain data.

Nothing here measures, fits or draws. A report says what was measured, on what, with which tables, and what came of it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.correction.tables import Band
from hil.figures.iso230 import Iso230, iso230
from hil.figures.uncertainty import UncertaintyInputs
from hil.records.rows import Floats, Records

_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff\ufffe\uffff]")


def plain(value: object) -> str:
    """Any value as text that can be drawn and written: what is no character becomes the replacement mark."""
    return _UNPRINTABLE.sub("\ufffd", str(value))


@dataclass(frozen=True)
class NamedCampaign:
    """One campaign of measurement under the name it has in the report ('before', 'after calibration', …).

    source: where the rows come from (a file name), sha256 its hash; both optional.
    """

    label: str
    records: Records
    note: str = ""
    source: str = ""
    sha256: str = ""

    def figures(self) -> Iso230 | str:
        """The campaign's ISO 230-2 figures, or the sentence that says why it has none."""
        try:
            return iso230(self.records)
        except InputError as error:
            return error.what


@dataclass(frozen=True)
class TableInForce:
    """A correction table that was in force: its name, the hash of its contents, and a word on what it is."""

    name: str
    sha256: str
    what: str = ""


@dataclass(frozen=True)
class ReportData:
    """Everything a report shows, in the order of its parts.

    campaigns        in the order of time; the first and the last are compared
    identity         what a reader must know to repeat it: axis, drive, instrument, environment, operator, …
    band             the specified accuracy that was asked for, with the signs of its sections; None without
    band_targets_mm  targets that the tables were made at: between two of different sign the band judges nothing
    tables           correction tables in force in the last campaign
    diagnosis        the JSON form of `hil diagnose`, None where none was made. A finding may carry
                     "plot": {"column": name, "unit": unit, "x": [...], "residual_um": [...], "effect_um": [...]}
    diagnosed        the campaign that the diagnosis was made on; its column residual_um is shown where it has one, else its error
    all_plots        what the extended model leaves is drawn even where the diagnosis leaves nothing unexplained
    compare          the first two campaigns are set against each other, target by target
    uncertainty      what is known of instrument and room; figures then stand with their expanded uncertainty
    signatures       what of the above is signed: file name -> by whom, or why its signature is not good
    created          date and time to print, as text; nothing is looked up, so the same data give the same bytes
    """

    title: str
    campaigns: tuple[NamedCampaign, ...]
    identity: Mapping[str, str] = field(default_factory=dict)
    band: Band | None = None
    tables: tuple[TableInForce, ...] = ()
    diagnosis: Mapping[str, Any] | None = None
    diagnosed: NamedCampaign | None = None
    notes: tuple[str, ...] = ()
    created: str = ""
    uncertainty: UncertaintyInputs | None = None
    signatures: Mapping[str, str] = field(default_factory=dict)
    compare: bool = False
    all_plots: bool = False
    band_targets_mm: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.campaigns:
            raise InputError("a report needs at least one campaign of records")
        labels = [campaign.label for campaign in self.campaigns]
        if len(set(labels)) != len(labels):
            raise InputError(f"campaigns share a label: {', '.join(labels)}")
        if self.compare and len(self.campaigns) != 2:
            raise InputError(f"a comparison is of two campaigns, not of {len(self.campaigns)}")


@dataclass(frozen=True)
class History:
    """A campaign along time. x, shape (n,), in `unit`; deviation_um is error minus the mean error of the same target and direction."""

    x: Floats
    unit: str
    timed: bool
    deviation_um: Floats


def history(records: Records) -> History:
    """The error over time less the mean of each target: drift, steps, repeatability.

    Without a complete `time_s` the row order stands in, and `timed` says so.
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
