"""Effects of the instrument and its set-up, switched on in a running laser: errors to be identified and not compensated.

Sizes are µm at the stated condition. Dead path and air index show only while the air changes, so the variation of the workshop's air
is increased, which the instrument's own sensors show.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from sim_backends.laser import SimulatedLaser
from sim_backends.plant.axis import FeedAxis

INDEX_PER_HPA = 0.27e-6
PRESSURE_CHANGE_HPA = 5.0

Switch = Callable[[SimulatedLaser, FeedAxis, float], None]


def switch_on(laser: SimulatedLaser, axis: FeedAxis, effect: str, size_um: float) -> None:
    """Add an effect to a running laser. Raises ValueError for an id that is not the instrument's."""
    switch = SWITCHES.get(effect)
    if switch is None:
        raise ValueError(f"effect {effect!r} is not one of the instrument's: {', '.join(SWITCHES)}")
    switch(laser, axis, size_um)


def _varied_air(axis: FeedAxis, pressure_hpa: float) -> None:
    p = axis.parameters
    ambient = replace(
        p.ambient,
        pressure_walk_hpa=max(p.ambient.pressure_walk_hpa, pressure_hpa),
        air_walk_k=max(p.ambient.air_walk_k, 0.3),
    )
    axis.reconfigure(replace(p, ambient=ambient))


def _dead_path(laser: SimulatedLaser, axis: FeedAxis, size_um: float) -> None:
    """Size: shift by 5 hPa of air pressure, with the zero set now."""
    path_mm = size_um * 1e-3 / (INDEX_PER_HPA * PRESSURE_CHANGE_HPA)
    laser.configure(replace(laser.parameters, dead_path_mm=laser.parameters.dead_path_mm + path_mm))
    _varied_air(axis, PRESSURE_CHANGE_HPA)


def _air_index(laser: SimulatedLaser, axis: FeedAxis, size_um: float) -> None:
    """Size: standard deviation at the end of the travel caused by the varying pressure, for a host that does not compensate."""
    _varied_air(axis, size_um * 1e-3 / (INDEX_PER_HPA * axis.parameters.length_mm))


def _cosine(laser: SimulatedLaser, axis: FeedAxis, size_um: float) -> None:
    """Size: amount by which it reads short at the end of the travel."""
    mrad = math.sqrt(2.0 * size_um * 1e-3 / axis.parameters.length_mm) * 1e3
    laser.configure(replace(laser.parameters, misalignment_mrad=mrad))


def _beam_drift(laser: SimulatedLaser, axis: FeedAxis, size_um: float) -> None:
    """Size: standard deviation of a 1/f drift over hours."""
    laser.configure(replace(laser.parameters, drift_um=size_um))


SWITCHES: dict[str, Switch] = {
    "dead_path": _dead_path,
    "air_index": _air_index,
    "cosine": _cosine,
    "beam_drift": _beam_drift,
}
