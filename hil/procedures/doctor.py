"""Preflight: is everything there, and are the units what the axis file says? Asked of the drive, and proven by a small move against
the instrument.

Each check says what it found in one sentence; the first that fails in a way that makes moving unsafe ends the list.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.drive import Capability, DriveState
from drivers.errors import BridgeError, RemoteError
from hil.procedures.drive_units import compare_units
from hil.procedures.lookout import SLICE_S
from hil.procedures.session import AxisSession

PROOF_TRAVEL_MM = 2.0
CAREFUL_TRAVEL_MM = 0.1
"""Moved first: units that are wrong by orders of magnitude must not be proven by a motion as much too long."""
GROSS_RATIO = 5.0
RATIO_TOLERANCE = 0.02
"""A wrong gear or lead is off by far more than this; backlash and pitch error over the proof travel by far less."""


@dataclass(frozen=True)
class Check:
    """One finding of the preflight."""

    name: str
    good: bool
    detail: str


def doctor(session: AxisSession, *, move: bool = True, trust_file: bool = False) -> list[Check]:
    """Run the preflight on an entered session. With `move` the axis is enabled and moved by `PROOF_TRAVEL_MM`, up and back.

    trust_file: what the drive says of its units is told and not held against the axis file, for drives whose factory values mean
    nothing. Returns all checks made; nothing raises but a lost link. An axis found disabled is disabled again.
    """
    checks = [_drive(session)]
    if checks[-1].good:
        checks.append(_limits(session))
        checks.append(_scaling(session, trust_file))
        checks += _own_table(session)
        checks.append(_instrument(session))
        checks += [Check("note", True, note) for note in session.drive.notes]
    if move and all(check.good for check in checks):
        checks.append(_units(session))
    return checks


def _drive(session: AxisSession) -> Check:
    sample = session.drive.sample()
    if sample.state in (DriveState.FAULT, DriveState.FAULT_REACTION):
        code = "without an error code" if sample.fault_code is None else f"with error code {sample.fault_code:04X}h"
        return Check("drive", False, f"is in {sample.state.value} {code}; find the cause, then reset it")
    missing = {Capability.PROFILE_POSITION} - session.drive.capabilities
    if missing:
        return Check("drive", False, "cannot do profile position")
    can = ", ".join(sorted(capability.value for capability in session.drive.capabilities))
    return Check("drive", True, f"answers, is {sample.state.value}, at {sample.position_load_mm:.4f} mm; can do {can}")


def _limits(session: AxisSession) -> Check:
    limits = session.drive.limits
    position = session.drive.sample().position_load_mm
    text = f"travel {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm, at {position:.4f} mm"
    inside = limits.travel_min_mm <= position <= limits.travel_max_mm
    homing = " (will be homed first)" if session.how.home and not inside else ""
    return Check("limits", inside or session.how.home, text + homing)


def _scaling(session: AxisSession, trust_file: bool) -> Check:
    try:
        verdict = compare_units(session.drive.reported_scaling(), session.drive.scaling)
    except RemoteError as error:
        return Check("scaling", False, f"the drive's own units cannot be read: {error}")
    if trust_file and not verdict.agrees:
        return Check("scaling", True, f"{verdict.detail}; the axis file is trusted as asked, the move decides")
    return Check("scaling", verdict.agrees, verdict.detail)


def _own_table(session: AxisSession) -> list[Check]:
    """Whether the drive corrects the axis itself; nothing where it has no table."""
    table = session.drive.correction_table
    if table is None:
        return []
    name = table.description.name
    try:
        if not table.enabled():
            return [Check("drive's table", True, f"its {name} is switched off, the bridge may correct")]
        points = len(table.read().plus)
    except RemoteError as error:
        return [Check("drive's table", False, f"its {name} is not where its map says: {error}")]
    text = f"the drive corrects by its {name} of {points} points; nothing is calibrated or corrected by the bridge meanwhile"
    return [Check("drive's table", True, text)]


def _instrument(session: AxisSession) -> Check:
    try:
        session.await_instrument()
        readings = session.watch(max(1.0, 4 * SLICE_S))
    except BridgeError as error:
        return Check("instrument", False, str(error))
    positions = [reading.position_mm for reading in readings if reading.position_mm is not None]
    lost = sum(reading.lost_before for reading in readings)
    if not positions:
        return Check("instrument", False, "gives no readings")
    noise_um = float(np.std(positions)) * 1000.0
    return Check("instrument", True, f"{len(positions)} readings in 1 s, {lost} lost, noise {noise_um:.3f} µm at rest")


def _units(session: AxisSession) -> Check:
    """Move a little and compare with the instrument: its direction and amount tell wrong units from right ones."""
    drive = session.drive
    enabled_here = drive.sample().state is not DriveState.ENABLED
    if enabled_here:
        drive.enable()
    try:
        ratio = _ratio(session)
    finally:
        if enabled_here:
            drive.disable()
    return Check("units", abs(ratio - 1.0) <= RATIO_TOLERANCE, explain_ratio(ratio))


def _ratio(session: AxisSession) -> float:
    """Instrument travel over commanded travel: of a careful step, and where that is not grossly too long, of the proof's."""
    careful = _step_ratio(session, CAREFUL_TRAVEL_MM)
    return careful if abs(careful) > GROSS_RATIO else _step_ratio(session, PROOF_TRAVEL_MM)


def _step_ratio(session: AxisSession, step_mm: float) -> float:
    """A step to take up the backlash, a second one that is measured, and back to where it was."""
    drive, velocity = session.drive, session.how.velocity_mm_s
    here = drive.sample().position_load_mm
    up = here + 2 * step_mm <= drive.limits.travel_max_mm
    step = step_mm if up else -step_mm
    start, end = here + step, here + 2 * step
    session.move_uncorrected(start, velocity)
    first = session.raw_average()
    session.move_uncorrected(end, velocity)
    second = session.raw_average()
    session.move_uncorrected(here, velocity)
    return (second - first) / step


def explain_ratio(ratio: float) -> str:
    """What a ratio of measured to commanded travel means, in words."""
    text = f"the table moved {ratio:.5f} mm for each mm commanded"
    if abs(ratio - 1.0) <= RATIO_TOLERANCE:
        return text
    if abs(ratio) <= RATIO_TOLERANCE:
        return f"{text}: it does not follow the motor, or the instrument does not look at it"
    if ratio < 0:
        sign = "direction is reversed ([scaling] direction or [instrument] direction)"
        return f"{text}: {sign}" + ("" if abs(ratio + 1.0) <= RATIO_TOLERANCE else f", and {_factor(-ratio)}")
    return f"{text}: {_factor(ratio)}"


def _factor(ratio: float) -> str:
    for factor, cause in (
        (2.0, "a factor of 2: wavelength_fraction, or a double-start screw"),
        (0.5, "a factor of 1/2: wavelength_fraction, or encoder counts before quadrature"),
        (4.0, "a factor of 4: encoder quadrature or wavelength_fraction"),
        (0.25, "a factor of 1/4: encoder quadrature or wavelength_fraction"),
        (10.0, "a factor of 10: feed per revolution"),
        (0.1, "a factor of 1/10: feed per revolution"),
    ):
        if abs(ratio / factor - 1.0) <= RATIO_TOLERANCE:
            return cause
    return "gear ratio, feed or encoder counts are wrong by that factor"
