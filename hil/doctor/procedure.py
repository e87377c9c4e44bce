"""Preflight of an axis: checks of drive, limits, instrument and units, and small moves that prove distance against the instrument and
speed against the clock.

Each check has one sentence as its result. The first failure that makes moving unsafe ends the list.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from drivers.clock import NS_PER_S
from drivers.drive import FAULTS, Capability, DriveSample, DriveState
from drivers.errors import (
    BridgeError,
    LimitError,
    MotionTimeoutError,
    OverspeedError,
    ProtocolError,
    RemoteError,
    SafetyError,
    StateError,
)
from drivers.instrument import Reading
from drivers.limits import DriveLimits
from hil.doctor.drive_units import compare_units
from hil.machine.session import AxisSession
from hil.machine.supervisor import SLICE_S, Look
from hil.records.zero import describe_homing, explain_homing, homing_risk

PROOF_TRAVEL_MM = 2.0
"""Travel of the proof, mm."""
CAREFUL_TRAVEL_MM = 0.1
"""Travel of the first move, mm: short, as units may be wrong by orders of magnitude."""
CAREFUL_TOLERANCE = 0.3
"""Tolerance of the ratio over the first move: cyclic errors of a screw (5 µm) make 0.05 of it, a wrong unit at least 0.5."""
SLOW_SHARE = 0.01
"""Share of the axis's largest velocity for the first moves, so that a velocity wrong by a factor of 100 does not exceed it."""
CAREFUL_MM_S = 0.2
"""Speed of the first move, mm/s: with a unit of speed wrong by a factor of 100 it is 20 mm/s, 0.1 mm between two samples. A drive
that takes whole r/min is asked for one at least."""
CAREFUL_SPEED = 2.0
"""Factor by which the first move may be too fast or too slow: rounding to whole r/min makes at most 1.7, a wrong unit at least 6."""
FENCE_MM = 0.3
"""Distance from the first moves' stretch at which motor or table is stopped, mm: with the way of stopping below 1 mm."""
STOP_TRAVEL_MM = 1.0
"""Longest travel from a quick stop to rest, mm, at the slow speed of the check: a ramp of the axis needs a tenth."""
SPEED_S, SPEED_LEAST_S = 2.0, 0.5
"""Duration of the speed check, s, shortened to PROOF_TRAVEL_MM of travel, but not below the second value."""
SPEED_SLICE_S = 0.005
"""Interval between samples in the speed check, s."""
SPEED_TRIES = 4
"""Moves until the samples tell the speed, each at half the speed of the one before: on a slow bus or a busy host one may be over
between two samples."""
SPEED_TOLERANCE = 0.1
"""Relative tolerance of the speed: above the error by sample times, far below that of a wrong unit of velocity."""
RATIO_TOLERANCE = 0.02
"""Relative tolerance of the distance: above backlash and pitch error over the proof travel, far below a wrong gear or lead."""


@dataclass(frozen=True)
class Check:
    """Result of one check. detail: one sentence; risk: it does not fail, but a person has to look at it."""

    name: str
    good: bool
    detail: str
    risk: bool = False

    @property
    def verdict(self) -> str:
        """In a word or two."""
        return "NOT GOOD" if not self.good else "RISK" if self.risk else "note" if self.name == "note" else "good"


def doctor(session: AxisSession, *, move: bool = True, trust_file: bool = False, home: bool = False) -> list[Check]:
    """Run the preflight on an entered session; returns all checks made. move: the axis is enabled and moved by up to `reach_mm` and
    back.

    home: also home the axis, which proves what its drive's description says of homing. What the checks have proven of a description is
    remembered for this drive.
    trust_file: units reported by the drive are shown but do not fail a check, for drives whose factory values are meaningless.
    Raises for a lost link only. An axis found disabled is disabled again.
    """
    checks = [_drive(session)]
    if checks[-1].good:
        checks.append(_limits(session))
        checks.append(_scaling(session, trust_file))
        checks += _motion_units(session)
        checks += _description(session)
        checks += _zero(session)
        checks += _own_table(session)
        checks.append(_instrument(session))
        checks += [Check("note", True, note) for note in session.drive.notes]
    if move and all(check.good for check in checks):
        checks += _moved(session, home=home)
        if all(check.good for check in checks):
            homed = {"homing"} if home else set()
            session.drive.proven(frozenset({"reading", "enabling", "move", "stop"} | homed))
            checks += _not_homed(session)
    return checks


def _description(session: AxisSession) -> list[Check]:
    try:
        return [Check(*found) for found in session.drive.preflight()]
    except RemoteError as error:
        return [Check("registers", False, f"the drive does not fit its description: {error}")]


def _not_homed(session: AxisSession) -> list[Check]:
    if "homing" not in session.drive.unproven():
        return []
    return [
        Check(
            "homing", True, "what its description says of homing is not proven yet: hil doctor AXIS.toml --home", True
        )
    ]


def reach_mm(limits: DriveLimits) -> float:
    """Largest distance of the moves from the present position, mm."""
    return max(2.0 * PROOF_TRAVEL_MM, _speed_travel_mm(limits))


def _drive(session: AxisSession) -> Check:
    sample = session.drive.sample()
    if sample.state in FAULTS:
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
        return Check(
            "scaling",
            True,
            f"{verdict.detail}; the axis file is trusted as asked, the move decides",
            not verdict.agrees,
        )
    return Check("scaling", verdict.agrees, verdict.detail)


def _motion_units(session: AxisSession) -> list[Check]:
    """The units of velocity and acceleration, and what says so; a drive whose units are ambiguous is not moved."""
    units = session.drive.motion_scaling()
    if units is None:
        return []
    if units.ambiguous:
        return [Check("units of motion", False, units.ambiguous)]
    text = "; ".join(
        f"{what} in {unit.text}, by {unit.source} (1 is {worth:.4g} {si})"
        for what, unit, worth, si in (
            ("velocity", units.velocity, units.mm_s(1), "mm/s"),
            ("acceleration", units.acceleration, units.mm_s2(1), "mm/s²"),
        )
    )
    return [Check("units of motion", True, text)]


def _zero(session: AxisSession) -> list[Check]:
    """Source of the zero. A homing method that depends on the present position is a risk, but not a failure."""
    if not session.how.home:
        return [
            Check(
                "zero",
                True,
                "the axis is not homed ([measurement] home): its drive has to keep its zero by itself",
                True,
            )
        ]
    try:
        zero = session.drive.zero()
    except RemoteError as error:
        return [Check("zero", False, f"how the drive homes cannot be read: {error}")]
    risk = homing_risk(session.how.home, zero.method)
    named = describe_homing(True, zero.method, zero.home_position_mm)
    if explained := explain_homing(zero.method, zero.home_position_mm):
        named = f"{named}, {explained}"
    return [Check("zero", True, named if risk is None else f"{named}: {risk}", risk is not None)]


def _own_table(session: AxisSession) -> list[Check]:
    """Whether the drive corrects the axis by its own table; empty where it has none."""
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


def _moved(session: AxisSession, *, home: bool) -> list[Check]:
    """Move a little and compare with instrument and clock: direction, amount and speed tell wrong units from right ones."""
    with session.drive.proving():
        return _moved_in_doubt(session, home=home)


def _moved_in_doubt(session: AxisSession, *, home: bool) -> list[Check]:
    drive = session.drive
    enabled_here = drive.sample().state is not DriveState.ENABLED
    try:
        if not enabled_here and "enabling" in drive.unproven() and not drive.falls_without_power:
            drive.disable()
        drive.enable()
    except (MotionTimeoutError, StateError, ProtocolError) as error:
        return [Check("enabling", False, str(error))]
    try:
        checks = _proofs(session)
        if all(check.good for check in checks) and "stop" in drive.unproven():
            checks.append(_stop(session))
        if home and all(check.good for check in checks):
            checks.append(_homed(session))
        return checks
    except (OverspeedError, MotionTimeoutError) as error:
        return [Check("speed", False, f"{error}; the axis was stopped")]
    except SafetyError as error:
        return [Check("units", False, f"{error}; the axis was stopped")]
    finally:
        if enabled_here:
            drive.disable()


def _homed(session: AxisSession) -> Check:
    try:
        session.supervisor.home()
    except RemoteError as error:
        return Check("homing", False, str(error))
    at_mm = session.drive.sample().position_load_mm
    return Check("homing", True, f"homed, and stands at {at_mm:.4f} mm of the drive's new zero")


def _proofs(session: AxisSession) -> list[Check]:
    """Very slowly over very little first; only what that shows to be near the truth is moved further, then faster."""
    slow_mm_s = _slow_for(session)
    scaling = session.drive.scaling
    rpm_mm_s = scaling.feed_mm_per_shaft_rev / float(scaling.motor_revs_per_shaft_rev) / 60.0
    for careful_mm_s in _slower(session, min(slow_mm_s, max(CAREFUL_MM_S, rpm_mm_s))):
        seen: list[DriveSample] = []
        with session.axis.travel_unproven(), _fenced(session, seen) as look:
            careful = _step_ratio(session, CAREFUL_TRAVEL_MM, careful_mm_s, look)
        first = Passed.of(seen, CAREFUL_TRAVEL_MM, (0.1, 0.9))
        if first.tells(careful_mm_s, CAREFUL_SPEED):
            break
    if not first.near(careful_mm_s, CAREFUL_SPEED):
        return [Check("speed", False, first.explained(careful_mm_s))]
    if abs(careful - 1.0) > CAREFUL_TOLERANCE:
        return [Check("units", False, explain_ratio(careful))]
    speed = _speed(session)
    if not speed.good:
        return [speed]
    ratio = _step_ratio(session, PROOF_TRAVEL_MM, session.how.velocity_mm_s)
    return [speed, Check("units", abs(ratio - 1.0) <= RATIO_TOLERANCE, explain_ratio(ratio))]


@contextmanager
def _fenced(session: AxisSession, seen: list[DriveSample]) -> Iterator[Look]:
    """Stop motor and table where either leaves the stretch of the first moves: one of them may be wrong by any factor. Gives the
    function that judges the motor's samples, and adds them to `seen`; both raise LimitError."""
    seen.append(session.drive.sample())
    here_mm = seen[0].position_load_mm
    reach_mm = 2.0 * CAREFUL_TRAVEL_MM + FENCE_MM
    first_mm: list[float] = []
    before = session.axis.on_readings

    def judge(place_mm: float, from_mm: float, what: str) -> None:
        way_mm = place_mm - from_mm
        if abs(way_mm) <= reach_mm:
            return
        text = f"the {what} was {abs(way_mm):.3f} mm away when at most {2.0 * CAREFUL_TRAVEL_MM:g} mm were commanded"
        motor_mm = seen[-1].position_load_mm - here_mm if seen else 0.0
        ratio = way_mm / motor_mm if abs(motor_mm) >= 0.1 * CAREFUL_TRAVEL_MM else 1.0
        if what == "table" and abs(ratio - 1.0) > RATIO_TOLERANCE:
            raise LimitError(f"{text}; {explain_ratio(ratio, within=CAREFUL_TOLERANCE)}")
        raise LimitError(f"{text}: unit, word order or kind of target (absolute, relative) is wrong")

    def look(sample: DriveSample) -> None:
        seen.append(sample)
        judge(sample.position_load_mm, here_mm, "motor")

    def readings(new: Sequence[Reading]) -> None:
        if before is not None:
            before(new)
        for reading in new:
            if reading.position_mm is not None:
                first_mm.append(reading.position_mm)
                judge(reading.position_mm, first_mm[0], "table")
        del first_mm[1:]

    session.axis.on_readings = readings
    try:
        yield look
    finally:
        session.axis.on_readings = before


@dataclass(frozen=True)
class Passed:
    """The motor's speed over a part of a way, mm/s, by samples of which each was taken at some time between its request and its
    arrival: a busy host or bus makes the two differ. low, high: what agrees with these times; measured: by those of arrival."""

    way_mm: float
    low_mm_s: float
    high_mm_s: float
    measured_mm_s: float

    @classmethod
    def of(cls, seen: Sequence[DriveSample], travel_mm: float, part: tuple[float, float]) -> Passed:
        """Over this part of a way that began at the first sample. With fewer than two samples in it, its speed has no upper end."""
        share = [abs(one.position_load_mm - seen[0].position_load_mm) / abs(travel_mm) for one in seen]
        way_mm = abs(travel_mm) * (part[1] - part[0])
        end = next((at for at, done in enumerate(share) if done > part[1]), len(share) - 1)
        middle = [at for at in range(end + 1) if part[0] <= share[at] <= part[1]]
        if len(middle) < 2:
            start = max((at for at in range(end) if share[at] < part[0]), default=0)
            longest_s = (seen[end].time_ns - seen[start].earliest_ns) / NS_PER_S
            return cls(way_mm, way_mm / max(longest_s, 1e-9), math.inf, math.nan)
        first, last = seen[middle[0]], seen[middle[-1]]
        passed_mm = abs(last.position_load_mm - first.position_load_mm)
        longest_s = (last.time_ns - first.earliest_ns) / NS_PER_S
        shortest_s = (last.earliest_ns - first.time_ns) / NS_PER_S
        times_s = np.array([(seen[at].time_ns - first.time_ns) / NS_PER_S for at in middle])
        measured = abs(float(np.polyfit(times_s, [seen[at].position_load_mm for at in middle], 1)[0]))
        high = passed_mm / shortest_s if shortest_s > 0.0 else math.inf
        return cls(passed_mm, passed_mm / max(longest_s, 1e-9), high, measured)

    def near(self, commanded_mm_s: float, factor: float) -> bool:
        """Whether a speed within the factor of the commanded one agrees with the times, and they tell."""
        return self.tells(commanded_mm_s, factor) and not self._off(commanded_mm_s, factor)

    def tells(self, commanded_mm_s: float, factor: float) -> bool:
        """Whether the times tell the speed: by a factor of `CAREFUL_SPEED`, or that it is off."""
        return self.high_mm_s <= CAREFUL_SPEED * self.low_mm_s or self._off(commanded_mm_s, factor)

    def _off(self, commanded_mm_s: float, factor: float) -> bool:
        return self.low_mm_s > factor * commanded_mm_s or self.high_mm_s < commanded_mm_s / factor

    def explained(self, commanded_mm_s: float) -> str:
        """What is wrong, in words."""
        if not math.isnan(self.measured_mm_s) and self.tells(commanded_mm_s, 1.0 + SPEED_TOLERANCE):
            return explain_speed(self.measured_mm_s, commanded_mm_s)
        if self.low_mm_s > CAREFUL_SPEED * commanded_mm_s:
            text = f"{self.way_mm:.3g} mm were over at once when {commanded_mm_s:.3g} mm/s were commanded"
            return f"{text}: the drive's unit of velocity is wrong, or its word order"
        text = f"{self.way_mm:.3g} mm at {commanded_mm_s:.3g} mm/s were seen too seldom to tell the speed"
        return f"{text}: the bus is slow, or this computer is busy"


class _HalfWayError(SafetyError):
    """Raised by the check of the quick stop to have the axis stopped."""


def _stop(session: AxisSession) -> Check:
    """Quick-stop a slow move half way, and see where the axis comes to rest; enable anew and move back."""
    drive, slow_mm_s = session.drive, _slow_for(session)
    here = drive.sample().position_load_mm
    travel = _towards_room(session, here, PROOF_TRAVEL_MM)
    stopped_at: list[float] = []

    def look(sample: DriveSample) -> None:
        if abs(sample.position_load_mm - here) >= 0.5 * PROOF_TRAVEL_MM:
            stopped_at.append(sample.position_load_mm)
            raise _HalfWayError("half way")

    with suppress(_HalfWayError):
        session.move_uncorrected(here + travel, slow_mm_s, slice_s=SPEED_SLICE_S, look=look)
    first = drive.sample()
    drive.clock.sleep_s(0.3)
    rest = drive.sample()
    beyond_mm = abs(rest.position_load_mm - stopped_at[0]) if stopped_at else math.inf
    rests = abs(rest.position_load_mm - first.position_load_mm) <= STOP_TRAVEL_MM / 10.0
    text = f"{beyond_mm:.3f} mm to rest after a quick stop from {slow_mm_s:g} mm/s"
    if not rests or beyond_mm > STOP_TRAVEL_MM:
        drive.disable()
        return Check("quick stop", False, text if rests else f"{text}, and still moving then; the axis was disabled")
    drive.enable()
    session.move_uncorrected(here, slow_mm_s)
    return Check("quick stop", True, text)


def _step_ratio(session: AxisSession, step_mm: float, velocity_mm_s: float, look: Look | None = None) -> float:
    """Instrument travel over commanded travel: a step to take up the backlash, a second one that is measured, and back.

    look: called with each sample of the first two, which are then closer."""
    slice_s = SLICE_S if look is None else SPEED_SLICE_S
    here = session.drive.sample().position_load_mm
    step = _towards_room(session, here, 2 * step_mm) / 2
    start, end = here + step, here + 2 * step
    session.move_uncorrected(start, velocity_mm_s, slice_s=slice_s, look=look)
    first = session.raw_average()
    session.move_uncorrected(end, velocity_mm_s, slice_s=slice_s, look=look)
    second = session.raw_average()
    session.move_uncorrected(here, velocity_mm_s)
    session.watch(session.how.reading_s)  # an instrument that was lost on the way back is noticed here
    return (second - first) / step


def _slow_mm_s(limits: DriveLimits) -> float:
    return SLOW_SHARE * limits.max_velocity_mm_s


def _slow_for(session: AxisSession) -> float:
    return _in_drive_units(session, _slow_mm_s(session.drive.limits))


def _in_drive_units(session: AxisSession, velocity_mm_s: float) -> float:
    """The speed in whole units of the drive's velocity, mm/s: rpm are coarse."""
    units = session.drive.motion_scaling()
    return velocity_mm_s if units is None else units.representable_mm_s(velocity_mm_s)


def _slower(session: AxisSession, velocity_mm_s: float) -> list[float]:
    """The speeds to be tried until the samples tell them, as the drive can have them."""
    return [_in_drive_units(session, velocity_mm_s / 2.0**tried) for tried in range(SPEED_TRIES)]


def _speed_travel_mm(limits: DriveLimits) -> float:
    slow_mm_s = _slow_mm_s(limits)
    return max(CAREFUL_TRAVEL_MM, min(SPEED_S * slow_mm_s, max(PROOF_TRAVEL_MM, SPEED_LEAST_S * slow_mm_s)))


def _towards_room(session: AxisSession, here_mm: float, travel_mm: float) -> float:
    """A travel with its sign: upwards where that stays inside."""
    return travel_mm if here_mm + travel_mm <= session.drive.limits.travel_max_mm else -travel_mm


def _speed(session: AxisSession) -> Check:
    """The motor's speed by the times of its samples, over the middle half of a slow move."""
    before = session.drive.sample()
    here = before.position_load_mm
    travel_mm = _towards_room(session, here, _speed_travel_mm(session.drive.limits))
    for slow_mm_s in _slower(session, _slow_mm_s(session.drive.limits)):
        seen = [before]
        session.move_uncorrected(here + travel_mm, slow_mm_s, slice_s=SPEED_SLICE_S, look=seen.append)
        session.move_uncorrected(here, slow_mm_s)
        passed = Passed.of(seen, travel_mm, (0.25, 0.75))
        if passed.tells(slow_mm_s, 1.0 + SPEED_TOLERANCE):
            break
        before = session.drive.sample()
    if not passed.near(slow_mm_s, 1.0 + SPEED_TOLERANCE):
        return Check("speed", False, passed.explained(slow_mm_s))
    shown = [abs(one.velocity_mm_s) for one in seen[1:] if one.velocity_mm_s is not None and one.velocity_mm_s != 0.0]
    if shown and passed.measured_mm_s > 0.0:
        says_mm_s = float(np.median(shown))
        if not 1.0 / CAREFUL_SPEED <= says_mm_s / passed.measured_mm_s <= CAREFUL_SPEED:
            text = f"the drive shows {says_mm_s:.4g} mm/s while its position moves at {passed.measured_mm_s:.4g} mm/s"
            return Check("speed", False, f"{text}: the unit of the velocity shown is wrong")
    return Check(
        "speed", True, f"the motor moved at {passed.measured_mm_s:.4g} mm/s when {slow_mm_s:g} mm/s were commanded"
    )


def explain_speed(measured_mm_s: float, commanded_mm_s: float) -> str:
    """What a ratio of measured to commanded speed means, in words."""
    ratio = measured_mm_s / commanded_mm_s
    text = f"the motor moved at {measured_mm_s:.4g} mm/s when {commanded_mm_s:g} mm/s were commanded"
    if abs(ratio - 1.0) <= SPEED_TOLERANCE:
        return text
    for factor, cause in ((60.0, "minutes taken for seconds"), (1.0 / 60.0, "seconds taken for minutes")):
        if abs(ratio / factor - 1.0) <= SPEED_TOLERANCE:
            return f"{text}: {cause} in the drive's unit of velocity"
    power = round(math.log10(ratio)) if ratio > 0.0 else 0
    if power and abs(ratio / 10.0**power - 1.0) <= SPEED_TOLERANCE:
        return f"{text}: a wrong power of ten in the drive's unit of velocity"
    slower = "; or an override, or a speed limit of the drive" if ratio < 1.0 else ""
    return f"{text}: the drive's unit of velocity is wrong by that factor{slower}"


def explain_ratio(ratio: float, *, within: float = RATIO_TOLERANCE) -> str:
    """What a ratio of measured to commanded travel means, in words. within: of the causes' factors, for one measured in motion."""
    text = f"the table moved {ratio:.5f} mm for each mm commanded"
    if abs(ratio - 1.0) <= RATIO_TOLERANCE:
        return text
    if abs(ratio) <= RATIO_TOLERANCE:
        return f"{text}: it does not follow the motor, or the instrument does not look at it"
    if ratio < 0:
        sign = "direction is reversed ([scaling] direction or [instrument] direction)"
        return f"{text}: {sign}" + ("" if abs(ratio + 1.0) <= within else f", and {_factor(-ratio, within)}")
    return f"{text}: {_factor(ratio, within)}"


def _factor(ratio: float, within: float) -> str:
    for factor, cause in (
        (2.0, "a factor of 2: wavelength_fraction, or a double-start screw"),
        (0.5, "a factor of 1/2: wavelength_fraction, or encoder counts before quadrature"),
        (4.0, "a factor of 4: encoder quadrature or wavelength_fraction"),
        (0.25, "a factor of 1/4: encoder quadrature or wavelength_fraction"),
        (10.0, "a factor of 10: feed per revolution"),
        (0.1, "a factor of 1/10: feed per revolution"),
    ):
        if abs(ratio / factor - 1.0) <= within:
            return cause
    return "gear ratio, feed or encoder counts are wrong by that factor"
