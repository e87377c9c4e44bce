"""The [backlash] section of an axis file: where and how the lost motion is measured by torque, and where its value is kept."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.drive import DriveLimits
from drivers.scaling import AxisScaling
from hil.axis import reader
from hil.axis.reader import Table

METHODS = ("fitted", "four-sample")
"""Which estimate counts: the fitted wind-up curve, or the published rule of four samples. Both are always told."""

SLIDES, SLIDE_MM = 8, 0.1
"""Ways beyond the break-away, each ended by a reading: they show the torque that sliding leaves behind."""

_OBJECT = re.compile(r"([0-9A-Fa-f]{4})h(?::([0-9A-Fa-f]{2}))?")


@dataclass(frozen=True)
class BacklashConfig:
    """How it is measured, and the drive's parameters.

    reference_mm: where the axis turns back from + to -, and from - to +. parameter, acceleration: an object ("2201h", "2201h:01") or a
    register by name; None: the drive has none, and the value is kept in a file beside the axis's campaigns. parameter_um: what one
    count of it stands for.
    """

    reference_mm: tuple[float, float]
    run_in_mm: float
    step_um: float
    steps: int
    readings: int
    settle_s: float
    velocity_mm_s: float
    travel_velocity_mm_s: float
    runs: int
    method: str
    home: bool
    parameter: str | None
    parameter_um: float
    acceleration: str | None

    def turning_mm(self, direction: int) -> float:
        """Where a reversal into `direction` takes place."""
        return self.reference_mm[0] if direction < 0 else self.reference_mm[1]

    def start_mm(self, direction: int) -> float:
        """Where the way to that reversal begins, reached from the reversal itself."""
        return self.turning_mm(direction) + direction * self.run_in_mm

    def end_mm(self, direction: int) -> float:
        """The furthest that its steps, and the slides after them, may lead."""
        return self.turning_mm(direction) + direction * (self.steps * self.step_um / 1000.0 + SLIDES * SLIDE_MM)


def object_key(text: str) -> tuple[int, int] | None:
    """(index, subindex) of "2201h" or "2201h:01"; None for what is no object, and so a register's name."""
    match = _OBJECT.fullmatch(text)
    return None if match is None else (int(match[1], 16), int(match[2] or "0", 16))


def read_backlash(table: Table, limits: DriveLimits, scaling: AxisScaling, backend: str) -> BacklashConfig:
    """[backlash]; every key has a default, so that an axis file without it can be measured too."""
    middle = 0.5 * (limits.travel_min_mm + limits.travel_max_mm)
    objects = backend != "modbus"

    def setting(value: Any) -> str:
        text = reader.text(value)
        if backend == "canopen" and object_key(text) is None:
            raise ValueError
        return text

    expected = 'an object such as "2201h" or "2201h:01"' if objects else "a register's name"
    config = BacklashConfig(
        reference_mm=(
            table.take("reference_plus_mm", reader.finite, "a position in mm", middle),
            table.take("reference_minus_mm", reader.finite, "a position in mm", middle),
        ),
        run_in_mm=table.take("run_in_mm", reader.between(0.05, 100.0), "mm, 0.05 to 100", 0.5),
        step_um=table.take("step_um", reader.between(0.01, 100.0), "µm, 0.01 to 100", 1.0),
        steps=table.take("steps", reader.whole(20, 5000), "a whole number, 20 to 5000", 200),
        readings=table.take("readings", reader.whole(1, 100), "a whole number, 1 to 100", 4),
        settle_s=table.take("settle_s", reader.between(0.0, 10.0), "seconds, 0 to 10", 0.1),
        velocity_mm_s=table.take("velocity_mm_s", reader.positive, "a number > 0 in mm/s", 0.5),
        travel_velocity_mm_s=table.take(
            "travel_velocity_mm_s", reader.positive, "a number > 0 in mm/s", limits.max_velocity_mm_s / 5.0
        ),
        runs=table.take("runs", reader.whole(1, 100), "a whole number, 1 to 100", 1),
        method=table.take("method", reader.choice(*METHODS), " or ".join(METHODS), METHODS[0]),
        home=table.take("home", reader.flag, "true or false", True),
        parameter=table.take("parameter", setting, expected, None),
        parameter_um=table.take("parameter_um", reader.positive, "a number > 0 in µm", 1.0),
        acceleration=table.take("acceleration", setting, expected, None),
    )
    table.finish()
    _check(table, config, limits, scaling)
    return config


def default_backlash(path: Path, limits: DriveLimits, scaling: AxisScaling, backend: str) -> BacklashConfig:
    """What holds for an axis file that says nothing of it. Raises InputError where the travel is too short for that."""
    return read_backlash(Table(path, "", "backlash", {}), limits, scaling, backend)


def _check(table: Table, config: BacklashConfig, limits: DriveLimits, scaling: AxisScaling) -> None:
    if config.step_um / 1000.0 < scaling.resolution_load_mm:
        raise table.fail(
            "step_um", f"is {config.step_um:g}, expected at least one count, {1000.0 * scaling.resolution_load_mm:g} µm"
        )
    for key, speed in (
        ("velocity_mm_s", config.velocity_mm_s),
        ("travel_velocity_mm_s", config.travel_velocity_mm_s),
    ):
        if speed > limits.max_velocity_mm_s:
            raise table.fail(key, f"is {speed:g}, expected at most {limits.max_velocity_mm_s:g}")
    for key, direction in (("reference_plus_mm", -1), ("reference_minus_mm", 1)):
        reach = (config.turning_mm(direction), config.start_mm(direction), config.end_mm(direction))
        if not limits.travel_min_mm <= min(reach) <= max(reach) <= limits.travel_max_mm:
            raise table.fail(
                key,
                f"is {config.turning_mm(direction):g}: its run-in and steps from {min(reach):g} to {max(reach):g} mm leave the"
                f" travel {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm",
            )
