"""One look at an axis: drive, motor and instrument at one moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.errors import InputError


@dataclass(frozen=True)
class AxisReading:
    """One look at the axis. What is not known is None, never a made-up zero.

    time_s: time since the axis was opened, or since its last job began
    motor_mm: the drive's actual position, mm of the load; instrument_mm: the load's position by the instrument, None before `home()`;
    instrument_raw_mm: as the instrument shows it
    std_um: standard deviation of one reading, if several were averaged
    target_mm, command_mm: target of the last `move_to`, without and with the correction; direction: of arrival there, +1, -1 or 0
    since_reversal_mm, stroke_mm: commanded travel since the last reversal, and length of the stroke before it, 1e6 before the first
    sensors: air, workpiece and conditions, by their columns in the record format
    """

    time_s: float
    state: str
    motor_mm: float
    instrument_mm: float | None = None
    instrument_raw_mm: float | None = None
    std_um: float | None = None
    velocity_mm_s: float | None = None
    torque_percent: float | None = None
    following_error_mm: float | None = None
    homed: bool | None = None
    fault_code: int | None = None
    target_mm: float | None = None
    command_mm: float | None = None
    direction: int = 0
    since_reversal_mm: float | None = None
    stroke_mm: float | None = None
    sensors: Mapping[str, float] = field(default_factory=dict)

    def row(self, run: int = 1) -> dict[str, float]:
        """A row of the record format. Raises InputError without a target or an instrument's position: call `home()` and `move_to()`
        first."""
        if self.instrument_mm is None or self.target_mm is None or self.command_mm is None:
            missing = "position of the instrument" if self.instrument_mm is None else "target"
            raise InputError(f"a reading has no {missing}, expected home() and move_to() before it")
        row = {"run": float(run), "direction": float(self.direction), "target_mm": self.target_mm}
        row |= {"measured_mm": self.instrument_mm, "command_mm": self.command_mm, "time_s": self.time_s}
        row |= {"motor_mm": self.motor_mm, **self.sensors}
        optional = ("since_reversal_mm", "stroke_mm", "torque_percent")
        return row | {name: value for name in optional if (value := getattr(self, name)) is not None}

    def __repr__(self) -> str:
        seen = "–" if self.instrument_mm is None else f"{self.instrument_mm:.5f} mm"
        return f"<{self.time_s:.2f} s: motor {self.motor_mm:.5f} mm, instrument {seen}, {self.state}>"
