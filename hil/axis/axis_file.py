"""The axis file: everything a procedure may know about an axis, read once, checked, frozen.

TOML. A key nobody reads is an error, so that a misspelt limit cannot be ignored; a value of the wrong type or out of range is refused
with the file, the line, the value and what was expected. The example in hil/examples/axis.toml shows every section.
"""

from __future__ import annotations

import itertools
import re
import tomllib
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from drivers.drive import DriveLimits
from drivers.errors import InputError
from drivers.scaling import AxisScaling
from hil.axis import reader
from hil.axis.backlash import BacklashConfig, read_backlash
from hil.axis.connections import BENCH_MACHINES, DriveConfig, HomingConfig, read_drive
from hil.axis.instrument import DisplayConfig, InstrumentConfig, read_instrument
from hil.axis.lost_motion import LostMotionConfig, read_lost_motion
from hil.axis.reader import Table
from hil.axis.uncertainty import read_uncertainty
from hil.correction.bound import CAREFUL, MAX_CORRECTION_UM, MAX_SLOPE_UM_PER_MM, CorrectionBound
from hil.correction.tables import Band, TableMode
from hil.figures.uncertainty import UncertaintyInputs
from hil.machine.agreement import REVERSAL_UM, AgreementLimits
from hil.records.files import read_text
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
    "iso_targets",
    "load_axis",
    "load_drive_axis",
    "read_toml",
]

_CLOSEST_MM = 0.01  # between two targets: far less than any section, far more than targets are rounded to


@dataclass(frozen=True)
class MeasurementConfig:
    """What a calibration measures, and how."""

    targets_mm: tuple[float, ...]
    runs: int
    velocity_mm_s: float
    overrun_mm: float
    dwell_s: float
    reading_s: float
    reference_mm: float
    home: bool
    seed: int
    settle_um: float | None = None
    settle_within_s: float | None = None
    reference_within_um: float = REFERENCE_WITHIN_UM


@dataclass(frozen=True)
class CorrectionConfig:
    """What system A is to reach, how the tables are kept, and the bound of any correction of the axis."""

    mode: TableMode
    band: Band | None
    max_rounds: int
    fine_step_um: float
    fine_range_um: float
    combined: bool
    straightness_share: float
    bound: CorrectionBound = CAREFUL


@dataclass(frozen=True)
class StoreConfig:
    """Where campaigns and sealed tables go, and with whose keys. Paths are absolute."""

    directory: Path
    builder_key: Path
    builder_public: Path


@dataclass(frozen=True)
class ConditionsConfig:
    """What beside the axis may be varied in an exploring campaign: record column -> levels. Asked of a person, or set on the bench."""

    levels: dict[str, tuple[float, ...]]


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


@dataclass(frozen=True)
class AxisConfig(DriveAxis):
    """One axis that is measured."""

    instrument: InstrumentConfig
    measurement: MeasurementConfig
    correction: CorrectionConfig
    conditions: ConditionsConfig
    lost_motion: LostMotionConfig | None = field(default=None, kw_only=True)  # None: the file says nothing of it
    uncertainty: UncertaintyInputs | None = field(default=None, kw_only=True)

    @property
    def agreement(self) -> AgreementLimits:
        """What the instrument may differ from the motor by."""
        instrument = self.instrument
        return AgreementLimits(instrument.agrees_within_um, self.largest_reversal_um, instrument.latency_s)

    @property
    def tables_path(self) -> Path:
        """Where the axis's tables are kept, sealed."""
        return self.store.directory / "tables.sealed"

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
            "correction": {
                **{name: value for name, value in asdict(self.correction).items() if name != "bound"},
                "mode": self.correction.mode.value,
            },
        }


def load_axis(path: str | Path) -> AxisConfig:
    """Read an axis file. Raises InputError, one line, naming file, line, value and what was expected."""
    return _axis(read_toml(path))


def load_drive_axis(path: str | Path) -> DriveAxis:
    """Read an axis file that may end with its drive: without [instrument] and [measurement], nothing is measured along the axis.

    Raises InputError as `load_axis`.
    """
    root = read_toml(path)
    if {"instrument", "measurement"} & set(root.keys_left()):
        return _axis(root)
    name, limits, scaling, drive, more = _moving(root)
    store = _store(root.child("store", required=False), root.path, name)
    backlash = _backlash(root, limits, scaling, drive)
    root.finish(("axis", "scaling", "drive", "store", "backlash"))
    return DriveAxis(root.path, name, limits, scaling, drive, store, backlash=backlash, **more)


def read_toml(path: str | Path) -> Table:
    """The root table of a TOML file. Raises InputError naming file and line."""
    path = Path(path)
    text = read_text(path).removeprefix("\ufeff")
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        match = re.search(r"at line (\d+)", str(error))
        what = re.sub(r" \(at .*\)$", "", str(error))
        line = int(match[1]) if match else text.rstrip().count("\n") + 1
        raise InputError(f"is not TOML: {what}", path=path, line=line) from error
    except (ValueError, RecursionError) as error:  # an integer of thousands of digits, brackets in brackets in brackets
        raise InputError(
            "is not TOML that could be read: a number too long, or too deeply nested", path=path
        ) from error
    return Table(path, text, "", values)


def _moving(root: Table) -> tuple[str, DriveLimits, AxisScaling, DriveConfig, dict[str, Any]]:
    """[axis], [scaling] and [drive]; last, more of [axis] by the fields of `DriveAxis`."""
    axis = root.child("axis")
    name = axis.take("name", reader.name, "a name of letters, digits, _ . -")
    limits = _limits(axis)
    vertical = axis.take("vertical", reader.flag, "true or false", False)
    brake = axis.take("brake", reader.flag, "true or false", False)
    reversal_um = axis.take("largest_reversal_um", reader.not_negative, "a number >= 0 in µm", REVERSAL_UM)
    absolute = axis.take("absolute_encoder", reader.flag, "true or false", False)
    more = {
        "falls_without_power": vertical and not brake,
        "largest_reversal_um": reversal_um,
        "absolute_encoder": absolute,
    }
    axis.finish(("name", "travel_min_mm", "travel_max_mm", "max_velocity_mm_s", "max_acceleration_mm_s2"))
    return name, limits, _scaling(root.child("scaling")), read_drive(root.child("drive")), more


def _axis(root: Table) -> AxisConfig:
    name, limits, scaling, drive, more = _moving(root)
    instrument = read_instrument(root.child("instrument"), has_port=drive.backend != "bench")
    measurement = _measurement(root.child("measurement"), limits)
    correction = _correction(root.child("correction", required=False), measurement.runs)
    store = _store(root.child("store", required=False), root.path, name)
    conditions = _conditions(root.child("conditions", required=False))
    backlash = _backlash(root, limits, scaling, drive)
    lost_motion = None
    if "lost_motion" in root.keys_left():
        lost_motion = read_lost_motion(root.child("lost_motion"), limits, measurement.targets_mm)
    uncertainty = None
    if "uncertainty" in root.keys_left():
        uncertainty = read_uncertainty(root.child("uncertainty"))
    known = ("axis", "scaling", "drive", "instrument", "measurement", "correction", "store", "conditions")
    root.finish((*known, "backlash", "lost_motion", "uncertainty"))
    return AxisConfig(
        *(root.path, name, limits, scaling, drive, store),
        *(instrument, measurement, correction, conditions),
        backlash=backlash,
        **more,
        lost_motion=lost_motion,
        uncertainty=uncertainty,
    )


def _backlash(root: Table, limits: DriveLimits, scaling: AxisScaling, drive: DriveConfig) -> BacklashConfig | None:
    if "backlash" not in root.keys_left():
        return None
    return read_backlash(root.child("backlash"), limits, scaling, drive.backend)


def _limits(table: Table) -> DriveLimits:
    low = table.take("travel_min_mm", reader.finite, "a number in mm")
    high = table.take("travel_max_mm", reader.finite, "a number in mm")
    if not low < high:
        raise table.fail("travel_max_mm", f"is {high:g}, expected more than travel_min_mm, {low:g}")
    return DriveLimits(
        low,
        high,
        table.take("max_velocity_mm_s", reader.positive, "a number > 0 in mm/s"),
        table.take("max_acceleration_mm_s2", reader.positive, "a number > 0 in mm/s²"),
    )


def _scaling(table: Table) -> AxisScaling:
    scaling = AxisScaling(
        table.take("encoder_counts_per_motor_rev", reader.whole(1, 2**40), "a whole number > 0"),
        table.take("feed_mm_per_shaft_rev", reader.positive, "a number > 0 in mm"),
        table.take("motor_revs_per_shaft_rev", reader.ratio, 'a whole number or a fraction such as "5/2"', Fraction(1)),
        table.take("direction", reader.choice(1, -1), "1 or -1", 1),
    )
    table.finish()
    return scaling


def _measurement(table: Table, limits: DriveLimits) -> MeasurementConfig:
    seed = table.take("seed", reader.whole(0, 2**31), "a whole number >= 0", 1)
    targets = table.take("targets_mm", reader.numbers, "a list of positions in mm", None)
    if targets is None:
        first = table.take("first_mm", reader.finite, "a position in mm")
        last = table.take("last_mm", reader.finite, "a position in mm")
        sections = table.take("sections", reader.whole(2, 10_000), "a whole number >= 2")
        offset = table.take("random_offset", reader.share, "a share of the spacing, 0 to 1", 0.3)
        if not first < last:
            raise table.fail("last_mm", f"is {last:g}, expected more than first_mm, {first:g}")
        targets = iso_targets(first, last, sections, offset, seed)
        given = "sections"
    else:
        given = "targets_mm"
    if len(targets) < 2 or any(later - earlier < _CLOSEST_MM for earlier, later in itertools.pairwise(targets)):
        raise table.fail(
            given, f"gives {len(targets)} targets, expected at least 2, ascending by at least {_CLOSEST_MM:g} mm"
        )
    config = MeasurementConfig(
        targets_mm=targets,
        runs=table.take("runs", reader.whole(1, 1000), "a whole number > 0", 5),
        velocity_mm_s=table.take("velocity_mm_s", reader.positive, "a number > 0 in mm/s"),
        overrun_mm=table.take("overrun_mm", reader.positive, "a number > 0 in mm", 1.0),
        dwell_s=table.take("dwell_s", reader.not_negative, "a number >= 0 in s", 1.0),
        reading_s=table.take("reading_s", reader.positive, "a number > 0 in s", 0.5),
        reference_mm=table.take("reference_mm", reader.finite, "a position in mm", targets[0]),
        home=table.take("home", reader.flag, "true or false", True),
        seed=seed,
        settle_um=table.take("settle_um", reader.positive, "a number > 0 in µm", None),
        settle_within_s=table.take("settle_within_s", reader.between(0.1, 3600.0), "seconds, 0.1 to 3600", None),
        reference_within_um=table.take(
            "reference_within_um", reader.positive, "a number > 0 in µm", REFERENCE_WITHIN_UM
        ),
    )
    table.finish()
    if config.velocity_mm_s > limits.max_velocity_mm_s:
        raise table.fail("velocity_mm_s", f"is {config.velocity_mm_s:g}, expected at most {limits.max_velocity_mm_s:g}")
    low, high = limits.travel_min_mm + config.overrun_mm, limits.travel_max_mm - config.overrun_mm
    for key, target in [*((given, target) for target in targets), ("reference_mm", config.reference_mm)]:
        if not low <= target <= high:
            raise table.fail(
                key,
                f"target {target:g} mm with its overrun of {config.overrun_mm:g} mm leaves the travel"
                f" {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm",
            )
    return config


def _band(value: Any) -> Band:
    low, high = reader.numbers(value)
    return Band(low, high)


def iso_targets(first_mm: float, last_mm: float, sections: int, offset_share: float, seed: int) -> tuple[float, ...]:
    """Targets P_i = first + (i - 1)·p + r, ISO 230-2: r random within ±share/2 of the spacing, ends kept, whole µm.

    A spacing that is a multiple of the screw's or the encoder's pitch would hide a cyclic error; random offsets show it.
    """
    grid = np.linspace(first_mm, last_mm, sections)
    spacing = grid[1] - grid[0]
    offsets = np.random.default_rng(seed).uniform(-0.5, 0.5, sections) * offset_share * spacing
    offsets[0], offsets[-1] = abs(offsets[0]), -abs(offsets[-1])
    return tuple(round(float(target), 3) for target in grid + offsets)


def _correction(table: Table, runs: int) -> CorrectionConfig:
    config = CorrectionConfig(
        mode=table.take("mode", TableMode, "bidirectional or unidirectional+backlash", TableMode.BIDIRECTIONAL),
        band=table.take("band_um", _band, "[low, high] in µm", None),
        max_rounds=table.take("max_rounds", reader.whole(1, 100), "a whole number > 0", 4),
        fine_step_um=table.take("fine_step_um", reader.positive, "a number > 0 in µm", 0.1),
        fine_range_um=table.take("fine_range_um", reader.positive, "a number > 0 in µm", 3.0),
        combined=table.take("combined", reader.flag, "true or false", False),
        straightness_share=table.take("straightness_share", reader.share, "a share, 0 to 1", 0.0),
        bound=CorrectionBound(
            table.take("max_correction_um", reader.positive, "a number > 0 in µm", MAX_CORRECTION_UM),
            table.take("max_slope_um_per_mm", reader.positive, "a number > 0 in µm/mm", MAX_SLOPE_UM_PER_MM),
        ),
    )
    table.finish()
    if config.band is not None and runs < 2:
        raise table.fail(
            "band_um", f"needs the machine's repeatability, but [measurement] runs is {runs}, expected 2 or more"
        )
    if config.fine_range_um < config.fine_step_um:
        raise table.fail(
            "fine_range_um", f"is {config.fine_range_um:g}, expected at least one step, {config.fine_step_um:g}"
        )
    return config


def _conditions(table: Table) -> ConditionsConfig:
    names = [name for name in table.keys_left() if name == "load_kg" or re.fullmatch(r"pos_[a-z]\w*_mm", name)]
    levels = {name: table.take(name, reader.numbers, "a list of levels") for name in names}
    table.finish(("load_kg", "pos_<axis>_mm"))
    return ConditionsConfig(levels)


def _store(table: Table, path: Path, name: str) -> StoreConfig:
    base = path.resolve().parent

    def place(value: Any) -> Path:
        return base / reader.text(value)

    config = StoreConfig(
        directory=table.take("directory", place, "a folder", base / f"{name}-campaign"),
        builder_key=table.take("builder_key", place, "a file", base / "builder.key"),
        builder_public=table.take("builder_public", place, "a file", base / "builder.pub"),
    )
    table.finish()
    return config
