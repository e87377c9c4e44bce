"""Foreign file formats: compensation tables of CNC controllers, and measurements of other programs.

One module per format, without I/O: the command line names, reads and writes the files. The module of a controller's format has a
frozen settings class, `export` and `dump` (tables to text) and `load` (text to tables); that of a measurement has `load` (text to
records).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hil.correction.formats import fanuc, keysight, linuxcnc, measured_csv, sinumerik, twincat, wide_iso
from hil.correction.formats.common import Export
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


CONTROLLERS: tuple[Controller, ...] = (
    Controller("linuxcnc", linuxcnc.LinuxCncSettings, linuxcnc.export, linuxcnc.load),
    Controller("sinumerik", sinumerik.SinumerikSettings, sinumerik.export, sinumerik.load),
    Controller("fanuc", fanuc.FanucSettings, fanuc.export, fanuc.load),
    Controller("twincat", twincat.TwinCatSettings, twincat.export, twincat.load),
)

MEASUREMENTS: tuple[Measurement, ...] = (
    Measurement("keysight", keysight.KeysightSettings, keysight.load),
    Measurement("csv", measured_csv.MeasuredCsvSettings, measured_csv.load),
    Measurement("iso-wide", wide_iso.WideIsoSettings, wide_iso.load),
)
