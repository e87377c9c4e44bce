"""Touch probe, parameters and correction table of the in-process drive, directly over servo, probe inputs and settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from drivers.clock import Clock
from drivers.correction_table import (
    CorrectionTable,
    Directions,
    Interpolation,
    Nodes,
    Outside,
    RawFormat,
    RawTable,
    TableDescription,
)
from drivers.drive import Capability
from drivers.errors import CapabilityError, InputError, StateError
from drivers.parameters import DriveParameters, ParameterInfo, ParameterKind, ParameterValue
from drivers.scaling import AxisScaling
from drivers.touch_probe import Edge, LatchReading, TouchProbe
from sim_backends.own_table import OwnTable, TableForm
from sim_backends.probe_latch import EdgeLatch, ProbeLatch


class VirtualTouchProbe(TouchProbe):
    """Both inputs of the drive. device_stamp is in µs of simulated time."""

    def __init__(self, name: str, clock: Clock, latch: ProbeLatch, scaling: AxisScaling) -> None:
        super().__init__(name, clock)
        self._latch = latch
        self._scaling = scaling

    def _switch_on(self, probe: int, edges: frozenset[Edge], continuous: bool) -> bool:
        self._latch.channels[probe - 1].arm(
            enabled=True, continuous=continuous, rising=Edge.POSITIVE in edges, falling=Edge.NEGATIVE in edges
        )
        return True

    def _switch_off(self, probe: int) -> None:
        self._latch.channels[probe - 1].arm(enabled=False, continuous=False, rising=False, falling=False)

    def _latched(self, wanted: Sequence[tuple[int, Edge]]) -> list[tuple[int, Edge]]:
        return [(probe, edge) for probe, edge in wanted if self._caught(probe, edge).stored]

    def _read(self, probe: int, edge: Edge) -> LatchReading:
        caught = self._caught(probe, edge)
        return LatchReading(self._scaling.load_mm(caught.position_counts), caught.stamp_us, caught.count)

    def _caught(self, probe: int, edge: Edge) -> EdgeLatch:
        found = self._latch.channels[probe - 1]
        return found.rising if edge is Edge.POSITIVE else found.falling


@dataclass
class VirtualDriveSettings:
    """Settings that a drive on a wire keeps in its objects: ramps in mm/s², homing in mm/s, and the home position in load mm."""

    acceleration_mm_s2: float = 400.0
    quick_stop_mm_s2: float = 2000.0
    homing_method: int = 21
    homing_speed_switch_mm_s: float = 20.0
    homing_speed_zero_mm_s: float = 1.0
    home_position_mm: float = -2.0
    stop_timeout_s: float = 5.0
    missing: frozenset[Capability] = field(default_factory=frozenset)  # capabilities this one lacks, for tests


@dataclass(frozen=True)
class _Setting:
    """One of the drive's settings as a parameter: its name there, and the conversion between counts and the setting."""

    info: ParameterInfo
    field: str
    to_counts: Callable[[AxisScaling, float], int]
    from_counts: Callable[[AxisScaling, int], float]


def _whole(_scaling: AxisScaling, value: float) -> int:
    return round(value)


def _same(_scaling: AxisScaling, counts: int) -> int:
    return counts


def _speed(scaling: AxisScaling, value: float) -> int:
    return scaling.motor_counts_per_s(value)


def _speed_mm(scaling: AxisScaling, counts: int) -> float:
    return counts / scaling.counts_per_load_mm


def _integer(name: str, unit: str, low: float, high: float, description: str) -> ParameterInfo:
    return ParameterInfo(name, ParameterKind.INTEGER, unit, low, high, description=description)


_MOST = float(0xFFFFFFFF)
_SETTINGS = {
    setting.info.name: setting
    for setting in (
        _Setting(_integer("homing_method", "", -128, 127, "6098h"), "homing_method", _whole, _same),
        _Setting(
            _integer("homing_speed_during_search_for_switch", "counts/s", 1, _MOST, "6099h:1"),
            "homing_speed_switch_mm_s",
            _speed,
            _speed_mm,
        ),
        _Setting(
            _integer("homing_speed_during_search_for_zero", "counts/s", 1, _MOST, "6099h:2"),
            "homing_speed_zero_mm_s",
            _speed,
            _speed_mm,
        ),
        _Setting(
            _integer("home_offset", "counts", -(2.0**31), 2.0**31 - 1, "607Ch"),
            "home_position_mm",
            AxisScaling.motor_counts,
            AxisScaling.load_mm,
        ),
        _Setting(
            _integer("quick_stop_deceleration", "counts/s2", 1, _MOST, "6085h"), "quick_stop_mm_s2", _speed, _speed_mm
        ),
    )
}
_DEVICE_NAME = ParameterInfo("manufacturer_device_name", ParameterKind.TEXT, writable=False, description="1008h")


class VirtualParameters(DriveParameters):
    """Ramps and homing of one in-process drive; writing changes its settings."""

    def __init__(self, drive_name: str, scaling: AxisScaling, settings: VirtualDriveSettings) -> None:
        self._name = drive_name
        self._scaling = scaling
        self._settings = settings

    @property
    def names(self) -> tuple[str, ...]:
        return (_DEVICE_NAME.name, *_SETTINGS)

    def describe(self, name: str) -> ParameterInfo:
        return _DEVICE_NAME if name == _DEVICE_NAME.name else self._setting(name).info

    def read(self, name: str) -> ParameterValue:
        if name == _DEVICE_NAME.name:
            return "in-process drive"
        setting = self._setting(name)
        return setting.to_counts(self._scaling, getattr(self._settings, setting.field))

    def write(self, name: str, value: ParameterValue) -> bool:
        info = self.describe(name)
        if not info.writable:
            raise CapabilityError(f"drive {self._name}: {name} cannot be written")
        low, high = info.low, info.high
        if not isinstance(value, int) or not (low is None or low <= value) or not (high is None or value <= high):
            raise InputError(f"{name} cannot be {value!r}, expected a whole number {low:.0f} to {high:.0f}")
        if self.read(name) == value:
            return False
        setting = self._setting(name)
        setattr(self._settings, setting.field, setting.from_counts(self._scaling, value))
        return True

    def _setting(self, name: str) -> _Setting:
        if name not in _SETTINGS:
            raise InputError(f"drive {self._name} has no parameter {name!r}")
        return _SETTINGS[name]


_I16, _I32, _U32 = (-32768, 32767), (-(2**31), 2**31 - 1), (0, 2**32 - 1)


class VirtualCorrectionTable(CorrectionTable):
    """Can be changed only without power and switched off, as on a wire. Positions and values are in motor counts. Raises
    StateError."""

    def __init__(self, drive: str, form: TableForm, powered: Callable[[], bool]) -> None:
        self.drive = drive
        self._powered = powered
        self._raw = RawTable()
        self.own = OwnTable(form)
        places = RawFormat("counts", form.place_counts, *_I32)
        self.description = TableDescription(
            name="error table" if form.negated else "pitch table",
            points=form.points,
            nodes=Nodes.EXPLICIT if form.explicit else Nodes.EQUIDISTANT,
            interpolation=Interpolation.STEP if form.stepped else Interpolation.LINEAR,
            outside=Outside.ZERO if form.zero_outside else Outside.HOLD,
            directions=Directions.BOTH if form.curves == 2 else Directions.BACKLASH,
            sign=-1 if form.negated else 1,
            position=places,
            value=RawFormat("counts", form.value_counts, *_I16),
            step=RawFormat("counts", form.place_counts, *_U32),
            backlash=RawFormat("counts", form.value_counts, *_I16),
            shows_applied=True,
        )

    def read(self) -> RawTable:
        return self._raw

    def _write(self, table: RawTable, present: RawTable | None) -> None:
        if self.own.enabled or self._powered():
            raise StateError(f"drive {self.drive}: its table is changed switched off and without power only")
        self._raw = table

    def enabled(self) -> bool:
        return self.own.enabled

    def _switch(self, on: bool) -> None:
        if self._powered():
            raise StateError(f"drive {self.drive}: its table is switched without power only")
        raw, own = self._raw, self.own
        own.places, own.rising, own.falling, own.backlash = raw.nodes, raw.plus, raw.minus, raw.backlash
        if on and not own.usable():
            raise StateError(f"drive {self.drive}: its table of {len(raw.plus)} points is invalid")
        own.enabled = on

    def applied(self) -> int:
        return self.own.shown()
