"""Every effect of the catalogue, switched on in a running axis, for tests of the closed loop with an incomplete model.

One function per effect id of the record format's diagnosis; each states the meaning of its size. Sizes are µm at the stated
condition and are added to the axis's present errors. States are kept: heat starts from its present value, a slip happens now.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.guideway import CrossAxis, Guideway, LoadDeflection, MountSlip, VelocityLag
from sim_backends.plant.hysteresis import LostMotion
from sim_backends.plant.parameters import PlantParameters
from sim_backends.plant.screw import CyclicError, LocalWear
from sim_backends.plant.shapes import SmoothShape

SCREW_RISE_K = 3.0
SPEED_MM_S = 100.0
CROSS_TRAVEL_MM = 400.0
TILT_URAD = 20.0

Switch = Callable[[FeedAxis, float], PlantParameters]


def switch_on(axis: FeedAxis, effect: str, size_um: float) -> None:
    """Add an effect to a running axis. Raises ValueError for an id that is not a plant's."""
    switch = SWITCHES.get(effect)
    if switch is None:
        raise ValueError(f"effect {effect!r} is not one of the plant's: {', '.join(SWITCHES)}")
    axis.reconfigure(switch(axis, size_um))


def _cyclic(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: amplitude of the lead's first harmonic; a second one of 0.3 of it, both varying by a quarter along the screw."""
    p = axis.parameters
    old = p.screw.cyclic
    cyclic = CyclicError(old.amplitude_um + size_um, p.screw.lead_mm, old.second_um + 0.3 * size_um, 0.9, 2.3, 0.25)
    return replace(p, screw=replace(p.screw, cyclic=cyclic))


def _pitch_shape(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: peak of a smooth shape over the length."""
    p = axis.parameters
    old, new = p.screw.pitch_um, SmoothShape.random(p.seed + 101, size_um, p.length_mm)
    shape = replace(old, waves=old.waves + new.waves)
    return replace(p, screw=replace(p.screw, pitch_um=shape))


def _local_wear(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: depth of a zone around 0.62 of the length, 8 % of it wide."""
    p = axis.parameters
    return replace(
        p, screw=replace(p.screw, wear=LocalWear(size_um, p.begin_mm + 0.62 * p.length_mm, 0.04 * p.length_mm))
    )


def _backlash(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: added to the distance between the two sides."""
    p = axis.parameters
    return replace(p, backlash=replace(p.backlash, amount_um=p.backlash.amount_um + size_um))


def _backlash_position(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: difference between the far end and the middle (and between the middle and the near end)."""
    p = axis.parameters
    amount = max(p.backlash.amount_um, size_um)
    half = p.length_mm / 2.0
    slope = p.backlash.slope + size_um / amount
    along = replace(p.backlash, amount_um=amount, slope=slope, middle_mm=p.begin_mm + half, half_travel_mm=half)
    return replace(p, backlash=along)


def _lost_motion(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: total lag after a reversal, half of it within about 2 mm."""
    p = axis.parameters
    more = LostMotion.spread(p.seed + 102, size_um, 2.0)
    return replace(p, lost_motion=LostMotion(p.lost_motion.elements + more.elements))


def _thermal_expansion(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: growth at the end of the travel when the screw has warmed by 3 K from now on; it warms by its own work."""
    p = axis.parameters
    state, thermal = axis.thermal.state, p.thermal
    now_c = (1.0 - thermal.base_share) * state.screw_c + thermal.base_share * state.base_c
    ppm = size_um * 1000.0 / (SCREW_RISE_K * p.length_mm)
    if thermal.expansion_ppm_per_k:
        ppm += thermal.expansion_ppm_per_k
        now_c = thermal.reference_c
    return replace(
        p,
        thermal=replace(
            thermal,
            expansion_ppm_per_k=ppm,
            reference_c=now_c,
            heating_k_per_mm=max(thermal.heating_k_per_mm, 1.2e-4),
        ),
    )


def _thermal_drift(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: final change of the offset between table and instrument, as the head warms up from now on."""
    p = axis.parameters
    rise = axis.thermal.state.head_rise_k + 3.0
    thermal = replace(p.thermal, head_rise_k=rise, head_drift_um_per_k=size_um / 3.0, head_lag_s=300.0)
    return replace(p, thermal=thermal)


def _velocity_lag(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: lag at 100 mm/s, less than in proportion above."""
    return replace(axis.parameters, velocity_lag=VelocityLag(size_um / SPEED_MM_S))


def _load_deflection(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: deflection per 100 kg at the near end."""
    p = axis.parameters
    return replace(p, load=LoadDeflection(size_um, length_mm=p.length_mm))


def _abbe(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: peak over the length, from a pitch angle of 20 µrad at most; the table's level shows it."""
    p = axis.parameters
    tilt = SmoothShape.random(p.seed + 103, TILT_URAD, p.length_mm)
    return replace(p, guideway=Guideway(pitch_urad=tilt, arm_z_mm=size_um / TILT_URAD * 1000.0))


def _cross_axis(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: bending with the other axis 400 mm out, at the near end and without the bow."""
    p = axis.parameters
    return replace(p, cross_axis=CrossAxis(size_um / CROSS_TRAVEL_MM, length_mm=p.length_mm))


def _datum_step(axis: FeedAxis, size_um: float) -> PlantParameters:
    """Size: slip of the mount, now."""
    return replace(axis.parameters, slip=MountSlip(size_um, at_s=axis.time_s))


SWITCHES: dict[str, Switch] = {
    "cyclic": _cyclic,
    "thermal_expansion": _thermal_expansion,
    "thermal_drift": _thermal_drift,
    "backlash": _backlash,
    "backlash_position": _backlash_position,
    "lost_motion": _lost_motion,
    "velocity_lag": _velocity_lag,
    "load_deflection": _load_deflection,
    "abbe": _abbe,
    "cross_axis": _cross_axis,
    "local_wear": _local_wear,
    "pitch_shape": _pitch_shape,
    "datum_step": _datum_step,
}
