"""One look at an axis: drive, motor and instrument at one moment."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AxisReading:
    """What is not known is None, never a made-up zero.

    time_s: since the axis was opened, or since its last job began
    motor_mm: the drive's actual position, load mm; instrument_mm: the load's position by the instrument, None before `home()` takes
    the datum; instrument_raw_mm: in the instrument's own frame
    std_um: standard deviation of one reading, where several were averaged
    target_mm, command_mm: of the last `move_to`, without and with the correction; direction: of arrival there, +1 or -1, 0 before
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

    def __repr__(self) -> str:
        seen = "–" if self.instrument_mm is None else f"{self.instrument_mm:.5f} mm"
        return f"<{self.time_s:.2f} s: motor {self.motor_mm:.5f} mm, instrument {seen}, {self.state}>"
