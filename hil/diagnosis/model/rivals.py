"""Rival causes that act through a quantity that was not recorded, and the measurement that separates two causes.

Physics decides which are rivals: by how much the air changes in a day, what a barometer cannot do to a machine, where a reversal acts.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from hil.diagnosis.campaign import Floats
from hil.diagnosis.result import OUTSIDE, Finding
from hil.effects import Columns, Effect
from hil.effects.base import UM_PER_MM_PPM
from hil.effects.load_deflection import is_tilt
from hil.effects.survey import OTHER_AXIS
from hil.effects.thermometers import AIR_TEMPERATURE, TEMPERATURE, is_temperature

PRESSURE = "air_pressure_hpa"
WAY_SINCE = "since_reversal_mm"
FORCES = frozenset({"load_kg", "torque_percent"})
ANGLES = ("pitch_urad", "yaw_urad")
SLOW = frozenset({"thermal_drift", "beam_drift", "datum_step"})
"""Effects that are an offset in the course of time."""
PPM_PER_UNIT = {AIR_TEMPERATURE: 0.93, PRESSURE: 0.27}
"""Change of the air's refractive index, ppm of the length, per K and per hPa (`drivers.edlen`, at 20 °C and 1013.25 hPa)."""
USUAL_SWING = {AIR_TEMPERATURE: 3.0, PRESSURE: 10.0}
"""What the air of a shop may do during a campaign where nobody logged it, K and hPa: together 5.5 ppm."""
UNWATCHED = 2.0
"""What it may do in a room without any thermometer, over that."""
LONGEST_DEAD_PATH_MM = 2000.0
"""The interferometer at the machine's end, and its reflector at the far one at the first row: more is no dead path of a machine."""
NEAR_AN_END = 0.1
"""Of the travel: runs turn there at places of their own, and a stroke that reaches no nearer is a short one."""
VARY_APART = "a campaign in which the columns the two read vary apart"
ONCE_MORE = "a second campaign under other conditions: the effect predicts it, something else does not"
"""What tells an effect from something that no effect of the catalogue explains."""
RETURN = "return to one reference point several times within a run"
"""The same of an effect that occurs once, or wanders: no campaign predicts another."""
PAUSE = 3.0
"""Usual intervals between two rows, from which somebody may have done something between them."""


def not_told_apart(
    findings: Sequence[Finding], recorded: Collection[str], columns: Columns
) -> dict[str, tuple[str, ...]]:
    """By effect, the rivals that follow a column nobody recorded, where that column goes with those that were recorded.

    The motor's torque goes with speed, load and direction: a deflection by torque where the speed is not known may be a lag; a lag
    where neither load nor torque is known may be a deflection, and beside a deflection, where one of them is not, the rest of it. A
    load and a temperature tilt the carriage: a deflection alike in both directions, or one beside a slow course, may be an arm times
    an angle that was not measured; an arm where the load is not known may be a deflection. A drift or an expansion may be the air's
    (`_may_be_of_air`), and a drift that no thermometer shows the beam's; where no thermometer of the machine is there, what the air's
    temperature does may be the machine's. A jump with a pause may be a load that was put on, or another axis that went elsewhere. Wear
    at an end of the travel may be lost motion where the way since the reversal is known from the targets alone.

    columns: completed, of the rows, (n,) each
    """
    found = {finding.effect: finding for finding in findings}
    pairs = (
        *_by_forces_and_angles(found, recorded),
        *_by_what_was_done(found, recorded, columns),
        *_by_temperatures(found, recorded, columns),
    )
    return {effect: tuple(other for mine, other in pairs if mine == effect) for effect, _ in pairs}


def _by_forces_and_angles(found: Mapping[str, Finding], recorded: Collection[str]) -> Iterator[tuple[str, str]]:
    deflection = found.get("load_deflection")
    if deflection is not None and "torque_percent" in deflection.term.needs and "velocity_mm_s" not in recorded:
        yield "load_deflection", "velocity_lag"
    elif "velocity_lag" in found and len(FORCES - set(recorded)) > (deflection is None):
        yield "velocity_lag", "load_deflection"
    slow = SLOW & set(found)
    tilts = deflection is not None and any(is_tilt(term) for term in deflection.terms)
    if deflection is not None and (slow or tilts) and not set(ANGLES) <= set(recorded):
        yield from ((name, "abbe") for name in (*sorted(slow), "load_deflection"))
    if "abbe" in found and deflection is None and "load_kg" not in recorded:
        yield "abbe", "load_deflection"


def _by_what_was_done(
    found: Mapping[str, Finding], recorded: Collection[str], columns: Columns
) -> Iterator[tuple[str, str]]:
    jump, worn = found.get("datum_step"), found.get("local_wear")
    if jump is not None and not is_within_a_pass(_course_um(jump, columns), columns):
        if "load_kg" not in recorded:
            yield "datum_step", "load_deflection"
        if not any(map(OTHER_AXIS.fullmatch, recorded)):
            yield "datum_step", "cross_axis"
    if worn is not None and WAY_SINCE not in recorded and is_worn_after_reversals(worn, columns):
        yield "local_wear", "lost_motion"


def _by_temperatures(
    found: Mapping[str, Finding], recorded: Collection[str], columns: Columns
) -> Iterator[tuple[str, str]]:
    has_thermometer = _has_thermometer(recorded)
    if "thermal_drift" in found and not _follows_a_temperature(found["thermal_drift"]):
        yield "thermal_drift", "beam_drift"
    for name, by_air in (("thermal_drift", "dead_path"), ("thermal_expansion", "air_index")):
        if by_air in found and not has_thermometer:
            did_ppm = {column: _did_ppm(column, recorded, columns) for column in PPM_PER_UNIT}
            if did_ppm[PRESSURE] <= did_ppm[AIR_TEMPERATURE]:  # no part of a machine follows a barometer
                yield by_air, name
        if name in found and _may_be_of_air(found[name], recorded, columns):
            yield name, by_air


def _has_thermometer(recorded: Collection[str]) -> bool:
    """Whether a temperature of the machine was recorded."""
    return any(TEMPERATURE.fullmatch(column) for column in recorded)


def _follows_a_temperature(finding: Finding) -> bool:
    return any(is_temperature(name) for term in finding.terms for name in term.needs)


def _did_ppm(name: str, recorded: Collection[str], columns: Columns) -> float:
    """Change of the index by one quantity over the rows, ppm; 0 where it was not recorded."""
    return PPM_PER_UNIT[name] * float(np.ptp(columns[name])) if name in recorded else 0.0


def _may_be_of_air(finding: Finding, recorded: Collection[str], columns: Columns) -> bool:
    """Whether a drift or an expansion may be what the air did to the interferometer, by its size.

    One that follows a temperature may where that of the air was not recorded and goes with it, or where it is the air's itself; a
    course of time where any of the air was not recorded. What was recorded did what it did, the rest what it usually does at most.
    """
    absent = [name for name in PPM_PER_UNIT if name not in recorded]
    has_thermometer = _has_thermometer(recorded)
    follows = _follows_a_temperature(finding)
    if follows and has_thermometer and AIR_TEMPERATURE in recorded:
        return False
    usual = dict(USUAL_SWING)
    if follows:  # the air may have done what the machine did
        named = {name for term in finding.terms for name in term.needs if is_temperature(name)}
        usual[AIR_TEMPERATURE] = max(usual[AIR_TEMPERATURE], *(float(np.ptp(columns[name])) for name in named))
    most_ppm = sum(PPM_PER_UNIT[name] * usual[name] for name in absent)
    if not has_thermometer:
        most_ppm *= UNWATCHED if AIR_TEMPERATURE in absent else 1.0
        most_ppm += sum(_did_ppm(name, recorded, columns) for name in PPM_PER_UNIT)
    if finding.effect == "thermal_drift":
        drift_um = float(np.ptp(_course_um(finding, columns)))
        return drift_um < most_ppm * UM_PER_MM_PPM * LONGEST_DEAD_PATH_MM
    return _growth_ppm(finding, columns) < most_ppm


def _course_um(finding: Finding, columns: Columns) -> Floats:
    return np.asarray(sum(term.error_um(columns) for term in finding.terms))


def _growth_ppm(finding: Finding, columns: Columns) -> float:
    """Change over the rows of what an effect adds along the travel, ppm of it; infinite at one place."""
    ends_mm = [float(end(columns["target_mm"])) for end in (np.min, np.max)]
    here_um, there_um = (
        _course_um(finding, {**columns, "target_mm": np.full_like(columns["target_mm"], at)}) for at in ends_mm
    )
    travel_mm = ends_mm[1] - ends_mm[0]
    return float(np.ptp(there_um - here_um)) / travel_mm / UM_PER_MM_PPM if travel_mm > 0.0 else math.inf


def is_within_a_pass(course_um: Floats, columns: Columns) -> bool:
    """Whether a course of the rows (n,) jumps once, between two rows of one pass that follow one another without a pause: then nobody
    put anything on the machine, and no other axis was moved.
    """
    jumps = np.flatnonzero(np.diff(course_um))
    if len(jumps) != 1 or "time_s" not in columns:
        return False
    here = int(jumps[0])
    steps_s = np.diff(columns["time_s"])
    same = all(columns[name][here] == columns[name][here + 1] for name in ("run", "direction"))
    return same and bool(0.0 <= steps_s[here] < PAUSE * np.median(steps_s))


def is_worn_after_reversals(finding: Finding, columns: Columns) -> bool:
    """Whether a worn zone holds the first row after a reversal near an end of the travel, unlike in the two directions there: upwards
    at the lower end, or downwards at the upper one.
    """
    up_um, down_um = (
        _course_um(finding, {**columns, "direction": np.full_like(columns["direction"], way)}) for way in (1.0, -1.0)
    )
    target, largest = columns["target_mm"], max(float(np.max(np.abs(up_um))), float(np.max(np.abs(down_um))))
    near_mm = NEAR_AN_END * float(np.ptp(target))
    has_turned = np.concatenate([[True], np.diff(columns["direction"]) != 0.0])
    is_odd = np.abs(up_um - down_um) > 0.5 * largest
    from_low = (target <= np.min(target) + near_mm) & (np.abs(up_um) > 0.5 * largest)
    from_high = (target >= np.max(target) - near_mm) & (np.abs(down_um) > 0.5 * largest)
    return bool(np.any(has_turned & is_odd & (from_low | from_high)))


def separating(effect: Effect, rival: str, absent: Sequence[str] = ()) -> str:
    """The measurement that separates an effect from a rival, which may follow one of these columns that nobody recorded."""
    general = VARY_APART if rival != OUTSIDE else RETURN if effect.once else ONCE_MORE
    return catalogue_says(effect, rival) or (to_record(absent) if absent else general)


def catalogue_says(effect: Effect, rival: str) -> str:
    """The measurement that the effect itself names against a rival; empty where it names none."""
    return next((known.separate_by for known in effect.rivals if known.effect == rival), "")


def to_record(columns: Sequence[str]) -> str:
    """What to do about columns that nobody recorded, one of which would tell."""
    return f"record {'one of these ' if len(columns) > 1 else ''}in every row: {'; '.join(columns)}"


def to_switch(column: str) -> str:
    """What tells a jump from a relay of a column."""
    return f"let it go back and forth once more, what switches with it comes again: {column}"


def to_show(column: str, recorded: Collection[str]) -> str:
    """What to do for one column that nobody changed, or recorded."""
    return f"measure at another value of: {column}" if column in recorded else to_record((column,))
