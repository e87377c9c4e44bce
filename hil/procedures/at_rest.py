"""Reading at a target: what the instrument says of an axis that arrived, stood for its dwell and, where asked for, came to rest.

The rules for outliers, averages and rest are `hil.reading`'s; here is what is watched meanwhile, and what is too old to be used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import MeasurementLostError, MotionTimeoutError
from drivers.instrument import Reading
from hil.axis import MeasurementConfig
from hil.procedures.lookout import Lookout
from hil.reading import Average, average, creep
from hil.records import Floats

SETTLE_WITHIN_S = 10.0
"""How long the load may take to come to rest where the axis file asks for it without a time of its own."""


def average_at_rest(lookout: Lookout, how: MeasurementConfig) -> Average:
    """In the instrument's own frame. The axis is stopped whatever goes wrong.

    Raises MeasurementLostError without readings or of an unsteady signal, MotionTimeoutError for a load that does not come to rest,
    and what watching raises.
    """
    arrived_ns = lookout.clock.now_ns()
    lookout.watch(how.dwell_s)
    settle = lookout.clock.deadline(how.settle_within_s or SETTLE_WITHIN_S)
    with lookout.stopping_on_error():
        while True:
            readings = _fresh(lookout, how.reading_s, arrived_ns)
            lookout.watch_until(lambda _sample: True, 1.0, "holding the position while it was read")
            if how.settle_um is None:
                return _averaged(lookout, readings)
            seen = creep(np.array([reading.time_ns / NS_PER_S for reading in readings]), _positions(readings))
            if seen.within(how.settle_um):
                return _averaged(lookout, readings)
            if settle.expired:
                raise MotionTimeoutError(
                    f"drive {lookout.drive.name}: the load still moves by {seen.change_um:.2f} ± {2 * seen.std_um:.2f} µm"
                    f" in {how.reading_s:g} s, expected at most {how.settle_um:g} µm"
                )


def _fresh(lookout: Lookout, reading_s: float, arrived_ns: int) -> list[Reading]:
    """Readings over the reading time, none of them from before the axis arrived."""
    for _ in range(2):  # without a dwell the first look may bring nothing but what waited on the line
        readings = [r for r in lookout.watch(reading_s) if r.earliest_ns >= arrived_ns]
        if readings:
            return readings
    raise MeasurementLostError(f"instrument {lookout.instrument.name}: no reading in {reading_s:g} s")


def _averaged(lookout: Lookout, readings: Sequence[Reading]) -> Average:
    try:
        return average(_positions(readings))
    except MeasurementLostError as error:
        raise MeasurementLostError(f"instrument {lookout.instrument.name}: {error}") from error


def _positions(readings: Sequence[Reading]) -> Floats:
    return np.array([reading.position_mm for reading in readings], dtype=np.float64)
