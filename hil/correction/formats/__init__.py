"""Foreign file formats: compensation tables of CNC controllers, and measurements of other programs.

One module per format, without I/O: the command line names, reads and writes the files. The module of a controller's format has a
frozen settings class, `export` (tables to text) and `load` (text to tables); that of a measurement has `load` (text to
records).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.correction import WIDE_ISO_CELLS
from hil.correction.formats import (
    fanuc,
    grbl,
    keysight,
    lines,
    linuxcnc,
    mach,
    measured_csv,
    renishaw,
    sinumerik,
    twincat,
    wide_iso,
)
from hil.correction.formats.common import Export, enough, refuse_errors_as_positions, refuse_positions, refuse_turned
from hil.correction.tables import TableSet
from hil.records.rows import Records


@dataclass(frozen=True)
class Controller:
    """A controller's format: its settings class, the conversion of tables to a file (`export`) and of a file to tables (`load`), and
    the remedy where a file's values are read as what they are not (`refuse_positions`).
    """

    name: str
    settings: type[Any]
    export: Callable[[TableSet, Any], Export]
    load: Callable[[str, Any], TableSet]
    remedy: str

    def read(self, text: str, settings: Any) -> TableSet:
        """The tables of a file. Raises InputError, also as `refuse_positions`."""
        tables = self.load(text, settings)
        refuse_positions(tables, self.remedy.format(**vars(settings)))
        return tables


@dataclass(frozen=True)
class MeasurementFormat:
    """A format of measurements: its settings class, the conversion of a file to records (`load`), and the remedy."""

    name: str
    settings: type[Any]
    load: Callable[[str, Any], Records]
    remedy: str

    def read(self, text: str, settings: Any) -> Records:
        """The rows of a file. Raises InputError, also as `refuse_errors_as_positions` and `refuse_turned`."""
        records = self.load(text, settings)
        refuse_errors_as_positions(records, self.remedy)
        refuse_turned(records)
        return records


def export_within(controller: Controller, tables: TableSet, settings: Any) -> Export:
    """A controller's file that deviates from the tables by no more than `settings.tolerance_um`, resampling and rounding together.

    A format's own tolerance is of its parts; that of the resampling is narrowed until the whole keeps what was asked for. Raises
    InputError where the format cannot keep it, with the least deviation found: asked for, that one is kept.
    """
    asked = settings.tolerance_um
    part = "resampling_um" if hasattr(settings, "resampling_um") else "tolerance_um"
    best_um, refused = np.inf, None
    for resampling_um in (asked, *(step for step in _RESAMPLING_UM if step < asked)):
        try:
            made = controller.export(tables, replace(settings, **{part: resampling_um}))
        except InputError as error:
            refused = refused or error
            if np.isfinite(best_um):  # narrower still needs more points than fit
                break
            continue
        if made.deviation_um <= asked + _ROUNDING_UM:
            return made
        if resampling_um < asked:  # a step of the ladder, which is tried for each larger tolerance too
            best_um = min(best_um, made.deviation_um)
    if refused is not None and not np.isfinite(best_um):
        raise refused
    reached = f" The best it reaches is {enough(best_um)} µm." if np.isfinite(best_um) else ""
    raise InputError(
        f"{controller.name} cannot keep {asked:g} µm: rounding to its steps, the distance of its points and, with one table for"
        f" both directions, a constant backlash add up to more.{reached} Allow that (tolerance_um), or choose finer steps of the"
        " format"
    )


_RESAMPLING_UM = tuple(10.0 * 0.7**step for step in range(20))
"""Deviations by resampling that are tried, µm, 10 to 0.01: the widest points with which the whole keeps the tolerance are written."""
_ROUNDING_UM = 1e-9
"""Of the comparison itself."""

_SCREW_MAP = (
    "below the header commanded_mm,real_mm stand positions, below position_mm,error_mm (or error_positive_mm,error_negative_mm)"
    " expected less actual position: give the header that is right"
)
_ERRORS = "write the errors (measured less target) in place of the positions, or the other way round"
CONTROLLERS: tuple[Controller, ...] = (
    Controller(
        "linuxcnc",
        linuxcnc.LinuxCncSettings,
        linuxcnc.export,
        linuxcnc.load,
        "the file is not of COMP_FILE_TYPE {comp_type} but of the other one: give that (comp_type)",
    ),
    Controller(
        "sinumerik",
        sinumerik.SinumerikSettings,
        sinumerik.export,
        sinumerik.load,
        "a value is what the control subtracts, in mm: write errors in place of positions",
    ),
    Controller(
        "fanuc",
        fanuc.FanucSettings,
        fanuc.export,
        fanuc.load,
        "it was read with a detection unit of {detection_unit_um:g} µm (detection_unit_um) and 3624 in {setting_unit_mm:g} mm"
        " (setting_unit_mm): give those of the control",
    ),
    Controller(
        "twincat",
        twincat.TwinCatSettings,
        twincat.export,
        twincat.load,
        "a value is actual less commanded position in 0.1 µm: write errors in place of positions",
    ),
    Controller(
        "grblhal",
        grbl.GrblHalSettings,
        grbl.export_grblhal,
        grbl.load_grblhal,
        "the steps per mm of before were {steps_per_mm} (steps_per_mm): give those the file was made with",
    ),
    Controller(
        "fluidnc",
        grbl.FluidNcSettings,
        grbl.export_fluidnc,
        grbl.load_fluidnc,
        "the steps per mm of before were {steps_per_mm} (steps_per_mm): give those the file was made with",
    ),
    Controller("mach3", mach.Mach3Settings, mach.export, mach.load, _SCREW_MAP),
    Controller("mach4", mach.Mach4Settings, mach.export, mach.load, _SCREW_MAP),
)

MEASUREMENTS: tuple[MeasurementFormat, ...] = (
    MeasurementFormat("keysight", keysight.KeysightSettings, keysight.load, f"LinearErr holds errors: {_ERRORS}"),
    MeasurementFormat("renishaw", renishaw.RenishawSettings, renishaw.load, f"DEVIATIONS holds µm: {_ERRORS}"),
    MeasurementFormat(
        "lines",
        lines.LinesSettings,
        lines.load,
        "name the group of the pattern measured_<unit> for positions, error_<unit> for errors (pattern)",
    ),
    MeasurementFormat(
        "csv",
        measured_csv.MeasuredCsvSettings,
        measured_csv.load,
        "give measured_mm=HEADER for positions, error_um=HEADER for errors, with :UNIT where it is another (columns)",
    ),
    MeasurementFormat(
        "iso-wide",
        wide_iso.WideIsoSettings,
        wide_iso.load,
        f"give {', '.join(WIDE_ISO_CELLS)}, as the cells are (cells)",
    ),
)
