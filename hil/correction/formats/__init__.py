"""Foreign file formats: compensation tables of CNC controllers, and measurements of other programs.

One module per format, without I/O: the command line names, reads and writes the files. The module of a controller's format has a
frozen settings class, `export` and `dump` (tables to text) and `load` (text to tables); that of a measurement has `load` (text to
records).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.errors import InputError
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
from hil.correction.formats.common import Export, enough
from hil.correction.tables import TableSet
from hil.records.rows import Records


@dataclass(frozen=True)
class Controller:
    """A controller's format: its settings class, the conversion of tables to a file (`export`) and of a file to tables (`load`)."""

    name: str
    settings: type[Any]
    export: Callable[[TableSet, Any], Export]
    load: Callable[[str, Any], TableSet]


@dataclass(frozen=True)
class Measurement:
    """A format of measurements: its settings class, and the conversion of a file to records (`load`)."""

    name: str
    settings: type[Any]
    load: Callable[[str, Any], Records]


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

CONTROLLERS: tuple[Controller, ...] = (
    Controller("linuxcnc", linuxcnc.LinuxCncSettings, linuxcnc.export, linuxcnc.load),
    Controller("sinumerik", sinumerik.SinumerikSettings, sinumerik.export, sinumerik.load),
    Controller("fanuc", fanuc.FanucSettings, fanuc.export, fanuc.load),
    Controller("twincat", twincat.TwinCatSettings, twincat.export, twincat.load),
    Controller("grblhal", grbl.GrblHalSettings, grbl.export_grblhal, grbl.load_grblhal),
    Controller("fluidnc", grbl.FluidNcSettings, grbl.export_fluidnc, grbl.load_fluidnc),
    Controller("mach3", mach.Mach3Settings, mach.export, mach.load),
    Controller("mach4", mach.Mach4Settings, mach.export, mach.load),
)

MEASUREMENTS: tuple[Measurement, ...] = (
    Measurement("keysight", keysight.KeysightSettings, keysight.load),
    Measurement("renishaw", renishaw.RenishawSettings, renishaw.load),
    Measurement("lines", lines.LinesSettings, lines.load),
    Measurement("csv", measured_csv.MeasuredCsvSettings, measured_csv.load),
    Measurement("iso-wide", wide_iso.WideIsoSettings, wide_iso.load),
)
