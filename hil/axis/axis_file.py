"""The axis file: everything a procedure may know about an axis, read once, checked, frozen.

TOML. A key nobody reads is an error, so that a misspelt limit cannot be ignored; a value of the wrong type or out of range is refused
with the file, the line, the value and what was expected. The example in hil/examples/axis.toml shows every section.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from drivers.errors import InputError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.toml_schema import Document
from drivers.toml_types import (
    Count,
    File,
    Folder,
    Key,
    Limits,
    Name,
    NotNegative,
    Number,
    Positive,
    SchemaError,
    Share,
    Via,
    not_empty,
    one_of,
)
from hil.axis import BENCH_MACHINES
from hil.axis.agreement import REVERSAL_UM, AgreementLimits
from hil.axis.backlash import BacklashConfig, read_backlash
from hil.axis.certificate import CertificateConfig
from hil.axis.connections import DriveConfig, HomingConfig, read_drive
from hil.axis.instrument import DisplayConfig, InstrumentConfig, read_instrument
from hil.axis.lost_motion import LostMotionConfig, read_lost_motion
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.tables import INTERPOLATIONS, Band, SignedSections, TableMode
from hil.figures.uncertainty import UncertaintyInputs
from hil.figures.verdict import Accuracy, accuracy
from hil.records.rows import Records
from hil.records.zero import REFERENCE_WITHIN_UM

__all__ = [
    "BENCH_MACHINES",
    "AxisConfig",
    "ConditionsConfig",
    "CorrectionConfig",
    "DisplayConfig",
    "DriveAxis",
    "DriveConfig",
    "HomingConfig",
    "InstrumentConfig",
    "MeasurementConfig",
    "StoreConfig",
    "StraightnessConfig",
    "accuracy_of",
    "iso_targets",
    "load_axis",
    "load_drive_axis",
    "uncertainty_of",
]


def _band(ends: tuple[float, float], _: Document) -> Band:
    return Band(*ends)


FINE_TOTAL_UM = 6.0
"""How far fine steps may move one section and direction over all rounds, µm. The document searches "within ±1 µm to several µm" (S22,
S23) and names no total; this is twice the 3 µm of a round. A section that wants more has an error of another cause."""
_CLOSEST_MM = 0.01  # between two targets: far less than any section, far more than targets are rounded to


@dataclass(frozen=True)
class _AxisSection:
    """[axis] beside the limits."""

    name: Name
    vertical: bool = False
    brake: bool = False
    largest_reversal_um: NotNegative = REVERSAL_UM
    absolute_encoder: bool = False


@dataclass(frozen=True)
class _Grid:
    """Targets as [measurement] describes them; instead of them it may list them."""

    first_mm: Number
    last_mm: Number
    sections: Annotated[int, Limits(ge=2, le=10_000, description="a whole number >= 2")]
    random_offset: Share = 0.3
    seed: Count = 1

    def __post_init__(self) -> None:
        if not self.first_mm < self.last_mm:
            raise SchemaError("last_mm", f"is {self.last_mm:g}, expected more than first_mm, {self.first_mm:g}")


@dataclass(frozen=True, kw_only=True)
class MeasurementConfig:
    """What a calibration measures, and how. The order of the fields is that of `AxisConfig.purpose`."""

    targets_mm: Annotated[tuple[Number, ...], not_empty]
    runs: Annotated[int, Limits(ge=1, le=1000)] = 5
    velocity_mm_s: Positive
    overrun_mm: Positive = 1.0
    dwell_s: NotNegative = 1.0
    reading_s: Positive = 0.5
    reference_mm: Number
    home: bool = True
    seed: Count = 1
    settle_um: Positive | None = None
    settle_within_s: Annotated[float, Limits(ge=0.1, le=3600.0)] | None = None
    reference_within_um: Positive = REFERENCE_WITHIN_UM


@dataclass(frozen=True)
class CorrectionConfig:
    """What system A is to reach, how the tables are kept, and the bound of any correction of the axis."""

    mode: TableMode = TableMode.BIDIRECTIONAL
    band: Annotated[Band | None, Key("band_um"), Via(tuple[Number, Number], _band, "[low, high] in µm")] = None
    max_rounds: Annotated[int, Limits(ge=1, le=100)] = 4
    fine_step_um: Positive = 0.1
    fine_range_um: Positive = 3.0
    combined: bool = False
    interpolation: Annotated[str, one_of(*INTERPOLATIONS)] = INTERPOLATIONS[0]
    straightness_share: Share = 0.0
    bound: Annotated[CorrectionBound, Key("")] = CAREFUL
    signs: tuple[SignedSections, ...] = ()
    fine_total_um: Positive = FINE_TOTAL_UM
    accuracy_limit_um: Positive | None = None

    def __post_init__(self) -> None:
        if self.fine_range_um < self.fine_step_um:
            raise SchemaError(
                "fine_range_um", f"is {self.fine_range_um:g}, expected at least one step, {self.fine_step_um:g}"
            )
        if self.fine_total_um < self.fine_range_um:
            what = f"is {self.fine_total_um:g}, expected at least the range of one round, {self.fine_range_um:g}"
            raise SchemaError("fine_total_um", what)
        if self.signs and self.band is None:
            raise SchemaError("signs", "are given without band_um, whose signs they are")
        if self.signs and self.band is not None:
            try:
                object.__setattr__(self, "band", replace(self.band, signs=self.signs))
            except InputError as error:
                raise SchemaError("signs", error.what) from error


@dataclass(frozen=True)
class StraightnessConfig:
    """How far this axis leaves its line, and the axis that is moved against it while this one moves.

    axis_file: of that axis; at_mm: where it stands meanwhile; column: record column of the straightness optics, in µm ([instrument]
    beside); sign: +1 where the column grows as that axis moves in +, -1 where it falls
    """

    axis_file: File
    at_mm: Number
    column: Name = "straightness_um"
    sign: Annotated[int, one_of(1, -1)] = 1


@dataclass(frozen=True)
class StoreConfig:
    """Where campaigns and sealed tables go, and with whose keys. Paths are absolute.

    password_file, key_password_file: where the passwords stand that are asked for otherwise, for simulated machines; None: nowhere
    """

    directory: Folder
    builder_key: File
    builder_public: File
    password_file: File | None = None
    key_password_file: File | None = None


Column = Annotated[str, Limits(pattern=r"\A(load_kg|pos_[a-z]\w*_mm)\Z", description="load_kg or pos_<axis>_mm")]
Levels = dict[Column, Annotated[tuple[Number, ...], not_empty]]


@dataclass(frozen=True)
class ConditionsConfig:
    """What beside the axis may be varied in an exploring campaign: record column -> levels. Asked of a person, or set on the bench."""

    levels: Levels


@dataclass(frozen=True)
class DriveAxis:
    """What it takes to move an axis: its drive, its units and how far it may go."""

    path: Path
    name: str
    limits: DriveLimits
    scaling: AxisScaling
    drive: DriveConfig
    store: StoreConfig
    backlash: BacklashConfig | None = field(default=None, kw_only=True)  # None: the file says nothing of it
    falls_without_power: bool = field(default=False, kw_only=True)  # vertical, and no brake is stated
    absolute_encoder: bool = field(default=False, kw_only=True)  # the drive keeps its zero while its power is off
    largest_reversal_um: float = field(default=REVERSAL_UM, kw_only=True)  # over which the load may wait for its motor

    @property
    def zero_path(self) -> Path:
        """Where the axis's zero is kept (`hil.records.zero`)."""
        return self.store.directory / f"{self.name}.zero.json"

    @property
    def made_with_path(self) -> Path:
        """Where the drive's parameters at the last measurement are kept (`hil.records.made_with`)."""
        return self.store.directory / f"{self.name}.made-with.json"

    @property
    def tables_path(self) -> Path:
        """Where the axis's tables are kept, sealed."""
        return self.store.directory / "tables.sealed"


@dataclass(frozen=True)
class AxisConfig(DriveAxis):
    """One axis that is measured."""

    instrument: InstrumentConfig
    measurement: MeasurementConfig
    correction: CorrectionConfig
    conditions: ConditionsConfig
    lost_motion: LostMotionConfig | None = field(default=None, kw_only=True)  # None: the file says nothing of it
    uncertainty: UncertaintyInputs | None = field(default=None, kw_only=True)
    straightness: StraightnessConfig | None = field(default=None, kw_only=True)  # None: no other axis is corrected
    certificate: CertificateConfig | None = field(default=None, kw_only=True)  # None: certificates cannot be made

    @property
    def agreement(self) -> AgreementLimits:
        """What the instrument may differ from the motor by."""
        instrument = self.instrument
        return AgreementLimits(instrument.agrees_within_um, self.largest_reversal_um, instrument.latency_s)

    def across(self) -> StraightnessConfig:
        """The axis that straightness moves. Raises InputError for a file without [straightness]."""
        if self.straightness is None:
            raise InputError("has no [straightness], which names the axis that straightness moves", path=self.path)
        return self.straightness

    def purpose(self, kind: str) -> dict[str, Any]:
        """What decides which rows a campaign of this kind measures, as plain values: a resumed one must have the same."""
        return {
            "kind": kind,
            "axis": self.name,
            "limits": asdict(self.limits),
            "scaling": {name: str(value) for name, value in asdict(self.scaling).items()},
            "drive": {
                "backend": self.drive.backend,
                "machine": self.drive.machine,
                "seed": self.drive.seed,
                "homing": asdict(self.drive.homing),
                **({"simulated": True} if self.drive.simulated else {}),
                **({} if self.drive.like is None else {"like": str(self.drive.like)}),
            },
            "instrument": {
                name: value
                for name, value in asdict(self.instrument).items()
                if name not in ("port", "stale_after_s", "agrees_within_um", "resume_within_s", "place_temps")
            },
            "measurement": {
                name: list(value) if name == "targets_mm" else value
                for name, value in asdict(self.measurement).items()
                if name != "reference_within_um"
            },
            "correction": {**_purpose_of(self.correction)},
        }


def uncertainty_of(axis: AxisConfig) -> UncertaintyInputs | None:
    """The axis file's uncertainty inputs, None without. A misalignment that is not stated is taken from the beam's alignment."""
    inputs, beam = axis.uncertainty, axis.instrument.alignment
    if inputs is None or beam is None or inputs.misalignment_mm:
        return inputs
    targets = axis.measurement.targets_mm
    return replace(inputs, misalignment_mm=beam.lateral_mm(targets[-1] - targets[0]))


def accuracy_of(axis: AxisConfig, records: Records, *, corrected: bool | None = None) -> Accuracy:
    """The accuracy A of one pass along the axis with its uncertainty, against the limit. corrected: as for `accuracy`."""
    limit_um = axis.correction.accuracy_limit_um
    return accuracy(records, uncertainty_of(axis), limit_um, axis.measurement.targets_mm, corrected=corrected)


def _purpose_of(correction: CorrectionConfig) -> dict[str, Any]:
    """As plain values; what has its default and is newer than a campaign that may be resumed is left out."""
    form: dict[str, Any] = {**asdict(correction), "mode": correction.mode.value}
    del form["bound"], form["signs"], form["accuracy_limit_um"]
    if form["fine_total_um"] == FINE_TOTAL_UM:
        del form["fine_total_um"]
    if correction.band is not None and not correction.signs:
        del form["band"]["signs"]
    return form


_GRID_ONLY = {one.name for one in fields(_Grid)} - {one.name for one in fields(MeasurementConfig)}
Given = Mapping[str, Mapping[str, Any]]
"""Values by section that take the place of a file's."""


def load_axis(path: str | Path) -> AxisConfig:
    """Read an axis file. Raises InputError, one line, naming file, line, value and what was expected."""
    return _axis(Document.read(path))


def load_drive_axis(path: str | Path, given: Given = MappingProxyType({})) -> DriveAxis:
    """Read an axis file that may end with its drive: without [instrument] and [measurement], nothing is measured along the axis.

    given: checked as the file's own. Raises InputError as `load_axis`.
    """
    document = Document.read(path)
    for section, values in given.items():
        table = document.values.setdefault(section, {})
        if "targets_mm" in values:  # in place of a grid too
            for name in _GRID_ONLY:
                table.pop(name, None)
        table.update(values)
    if "instrument" in document or "measurement" in document:
        return _axis(document)
    axis = DriveAxis(**_moving(document))
    document.finish()
    return axis


def _moving(document: Document) -> dict[str, Any]:
    """What it takes to move the axis, by the fields of `DriveAxis`."""
    section = document.load(_AxisSection, "axis", beside=[DriveLimits])
    limits = document.load(DriveLimits, "axis", beside=[_AxisSection])
    if not limits.travel_min_mm < limits.travel_max_mm:
        what = f"is {limits.travel_max_mm:g}, expected more than travel_min_mm, {limits.travel_min_mm:g}"
        raise document.fail("axis.travel_max_mm", what)
    scaling = document.load(AxisScaling, "scaling")
    drive, store = read_drive(document), _store(document, section.name)
    if drive.like is not None and drive.like.resolve() == store.directory.resolve():
        what = "is the folder that this axis writes to itself, expected another [axis] name than the real axis's"
        raise document.fail("drive.like", what)
    for key, place in (
        ("axis.travel_min_mm", limits.travel_min_mm),
        ("axis.travel_max_mm", limits.travel_max_mm),
        ("drive.homing.home_position_mm", drive.homing.home_position_mm or 0.0),
    ):
        if drive.backend != "modbus" and (what := scaling.unheld(place)):  # there by the registers of its map
            raise document.fail(key, what)
    return {
        "path": document.path,
        "name": section.name,
        "limits": limits,
        "scaling": scaling,
        "drive": drive,
        "store": store,
        "backlash": read_backlash(document, limits, scaling, drive.backend) if "backlash" in document else None,
        "falls_without_power": section.vertical and not section.brake,
        "largest_reversal_um": section.largest_reversal_um,
        "absolute_encoder": section.absolute_encoder,
    }


def _axis(document: Document) -> AxisConfig:
    moving = _moving(document)
    limits = moving["limits"]
    instrument = read_instrument(document, has_port=moving["drive"].backend != "bench")
    measurement = _measurement(document, limits)
    bound = document.load(CorrectionBound, "correction", beside=[CorrectionConfig], required=False)
    correction = document.load(
        CorrectionConfig, "correction", beside=[CorrectionBound], usual={"bound": bound}, required=False
    )
    if correction.band is not None and measurement.runs < 2:
        what = f"needs the machine's repeatability, but [measurement] runs is {measurement.runs}, expected 2 or more"
        raise document.fail("correction.band_um", what)
    straightness = document.load(StraightnessConfig, "straightness") if "straightness" in document else None
    if straightness is not None and straightness.column not in (instrument.beside or {}):
        what = f"is {straightness.column!r}, expected a column of straightness optics that [instrument] beside names"
        raise document.fail("straightness.column", what)
    if straightness is not None and correction.straightness_share:
        what = "moves a part of the specified accuracy of this axis into straightness, and [straightness] corrects another axis"
        raise document.fail("correction.straightness_share", f"{what}: expected 0")
    axis = AxisConfig(
        **moving,
        instrument=instrument,
        measurement=measurement,
        correction=correction,
        conditions=ConditionsConfig(document.load(Levels, "conditions", required=False)),
        lost_motion=read_lost_motion(document, limits, measurement.targets_mm) if "lost_motion" in document else None,
        uncertainty=document.load(UncertaintyInputs, "uncertainty") if "uncertainty" in document else None,
        straightness=straightness,
        certificate=document.load(CertificateConfig, "certificate") if "certificate" in document else None,
    )
    document.finish()
    return axis


def _measurement(document: Document, limits: DriveLimits) -> MeasurementConfig:
    listed = "targets_mm" in document.table("measurement")
    usual: dict[str, Any] = {"reference_mm": None}  # None: the first target
    if not listed:
        grid = document.load(_Grid, "measurement", beside=[MeasurementConfig])
        usual["targets_mm"] = iso_targets(grid.first_mm, grid.last_mm, grid.sections, grid.random_offset, grid.seed)
    how = document.load(MeasurementConfig, "measurement", beside=[] if listed else [_Grid], usual=usual)
    key = "targets_mm" if listed else "sections"
    targets = how.targets_mm
    if len(targets) < 2 or any(later - earlier < _CLOSEST_MM for earlier, later in itertools.pairwise(targets)):
        what = f"gives {len(targets)} targets, expected at least 2, ascending by at least {_CLOSEST_MM:g} mm"
        raise document.fail(f"measurement.{key}", what)
    if how.reference_mm is None:
        how = replace(how, reference_mm=targets[0])
    if how.velocity_mm_s > limits.max_velocity_mm_s:
        what = f"is {how.velocity_mm_s:g}, expected at most {limits.max_velocity_mm_s:g}"
        raise document.fail("measurement.velocity_mm_s", what)
    low, high = limits.travel_min_mm + how.overrun_mm, limits.travel_max_mm - how.overrun_mm
    for key, target in [*((key, target) for target in targets), ("reference_mm", how.reference_mm)]:
        if not low <= target <= high:
            raise document.fail(
                f"measurement.{key}",
                f"target {target:g} mm with its overrun of {how.overrun_mm:g} mm leaves the travel"
                f" {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm",
            )
    return how


def iso_targets(first_mm: float, last_mm: float, sections: int, offset_share: float, seed: int) -> tuple[float, ...]:
    """Targets P_i = first + (i - 1)·p + r, ISO 230-2: r random within ±share/2 of the spacing, ends kept, whole µm.

    A spacing that is a multiple of the screw's or the encoder's pitch would hide a cyclic error; random offsets show it.
    """
    grid = np.linspace(first_mm, last_mm, sections)
    spacing = grid[1] - grid[0]
    offsets = np.random.default_rng(seed).uniform(-0.5, 0.5, sections) * offset_share * spacing
    offsets[0], offsets[-1] = abs(offsets[0]), -abs(offsets[-1])
    return tuple(round(float(target), 3) for target in grid + offsets)


def _store(document: Document, name: str) -> StoreConfig:
    base = document.path.resolve().parent
    usual = {
        "directory": base / f"{name}-campaign",
        "builder_key": base / "builder.key",
        "builder_public": base / "builder.pub",
    }
    return document.load(StoreConfig, "store", usual=usual, required=False)
