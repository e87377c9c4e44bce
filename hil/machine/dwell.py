"""Reading at a target: the axis dwells and, where the axis file asks for it, settles; then the instrument's readings are averaged.

The rules for outliers, averages and settling are in `hil.figures.reading`. The axis is watched meanwhile; readings from before its
arrival are not used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import MeasurementLostError, MotionTimeoutError
from drivers.instrument import Reading
from hil.axis.axis_file import MeasurementConfig
from hil.figures.reading import Average, average, creep, outliers
from hil.machine.supervisor import Supervisor
from hil.records.rows import Floats

SETTLE_WITHIN_S = 10.0
"""Time limit for settling, s, where the axis file gives settle_um without settle_within_s."""


def average_at_rest(supervisor: Supervisor, how: MeasurementConfig) -> Average:
    """Average of the first axis's readings, mm, in the instrument's own frame. Any error stops the axis.

    Raises MeasurementLostError when no reading comes or the readings differ too much, MotionTimeoutError when the load does not
    settle, and what `Supervisor.watch` raises.
    """
    arrived_ns = supervisor.clock.now_ns()
    supervisor.watch(how.dwell_s)
    settle = supervisor.clock.deadline(how.settle_within_s or SETTLE_WITHIN_S)
    with supervisor.stopping_on_error():
        while True:
            readings = _fresh(supervisor, how.reading_s, arrived_ns)
            supervisor.watch_until(lambda _sample: True, 1.0, "holding the position while it was read")
            if how.settle_um is None:
                return _averaged(supervisor, readings)
            seen = creep(np.array([reading.time_ns / NS_PER_S for reading in readings]), _positions(readings))
            if seen.within(how.settle_um):
                return _averaged(supervisor, readings)
            if settle.expired:
                raise MotionTimeoutError(
                    f"drive {supervisor.axes[0].drive.name}: the load still moves by"
                    f" {seen.change_um:.2f} ± {2 * seen.std_um:.2f} µm (k = 2)"
                    f" in {how.reading_s:g} s, expected at most {how.settle_um:g} µm"
                )


def _fresh(supervisor: Supervisor, reading_s: float, arrived_ns: int) -> list[Reading]:
    """Readings over the reading time, none of them from before the axis arrived."""
    for _ in range(2):  # without a dwell the first look may return only readings that were in the receive buffer
        readings = [r for r in supervisor.watch(reading_s) if r.earliest_ns >= arrived_ns]
        if readings:
            return readings
    raise MeasurementLostError(f"instrument {supervisor.axes[0].instrument_name}: no reading in {reading_s:g} s")


def _averaged(supervisor: Supervisor, readings: Sequence[Reading]) -> Average:
    axis, positions_mm = supervisor.axes[0], _positions(readings)
    kept_mm = positions_mm[~outliers(positions_mm)]
    if float(np.ptp(kept_mm)) > axis.steady_mm:  # the outlier rule needs several readings: of a few it leaves out none
        raise MeasurementLostError(
            f"instrument {axis.instrument_name}: readings of one position differ by {float(np.ptp(kept_mm)):.3f} mm, expected at most"
            f" {axis.steady_mm:g} mm while the axis stands ([instrument] instrument_agrees_within_um)"
        )
    try:
        return average(positions_mm)
    except MeasurementLostError as error:
        raise MeasurementLostError(f"instrument {supervisor.axes[0].instrument_name}: {error}") from error


def _positions(readings: Sequence[Reading]) -> Floats:
    return np.array([reading.position_mm for reading in readings], dtype=np.float64)
