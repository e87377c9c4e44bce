"""The formulas of a touch probe's run-out (JPH08348B2): from four contacts to the ball's position in the spindle, and
to corrections.

Frames: machine mm; a rising axis position moves the probe, seen from the work, in the axis's own direction. The
spindle's frame coincides with the machine's at its angle 0 and turns counter-clockwise seen along the spindle axis. No
I/O.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from drivers.errors import BridgeError, InputError
from hil.records.rows import UM_PER_MM

ANGLES_DEG = (0, 90, 180, 270)


class MeasurementRefusedError(BridgeError):
    """A measurement that contradicts itself or the known data of the probe; nothing is stored."""


class CorrectionCode(Enum):
    """The axes that a correction moves, named by the default codes; [codes] of a machine file may give them others, since
    the source's table of the codes is missing.
    """

    M91 = "M91"  # X
    M92 = "M92"  # Y
    M93 = "M93"  # both

    @property
    def in_x(self) -> bool:
        return self is not CorrectionCode.M92

    @property
    def in_y(self) -> bool:
        return self is not CorrectionCode.M91


@dataclass(frozen=True)
class FourFeeds:
    """N_0, N_90, N_180, N_270: feed of the axis from the start to the contact, mm, at each angle of the spindle."""

    n_0_mm: float
    n_90_mm: float
    n_180_mm: float
    n_270_mm: float

    @property
    def closure_um(self) -> float:
        """(N_0 + N_180) − (N_90 + N_270), µm: 0 for a ball that keeps its position in the spindle and a clean face."""
        return UM_PER_MM * ((self.n_0_mm + self.n_180_mm) - (self.n_90_mm + self.n_270_mm))

    def check_closure(self, limit_um: float) -> None:
        """Raises MeasurementRefusedError, naming both sums, unless they agree within the limit, µm."""
        if not abs(self.closure_um) <= limit_um:
            raise MeasurementRefusedError(
                f"the contacts do not close: N0 + N180 = {self.n_0_mm + self.n_180_mm:.4f} mm, N90 + N270 ="
                f" {self.n_90_mm + self.n_270_mm:.4f} mm, {self.closure_um:+.1f} µm apart, expected at most {limit_um:g} µm"
                " (a chip on block or ball? a tool that is not seated?); nothing was stored"
            )


@dataclass(frozen=True)
class RunOut:
    """The ball's centre in the spindle's frame, mm, and its effective radius, mm (pre-travel subtracted).

    closure_um: of the contacts it was computed from
    """

    x_mm: float
    y_mm: float
    tip_radius_mm: float
    closure_um: float = 0.0

    @property
    def size_um(self) -> float:
        """Distance of the ball's centre from the spindle axis, µm."""
        return UM_PER_MM * math.hypot(self.x_mm, self.y_mm)

    def at(self, spindle_deg: float) -> tuple[float, float]:
        """Offset of the ball's centre from the spindle axis in the machine's x and y, mm, at an angle of the
        spindle.
        """
        cos, sin = math.cos(math.radians(spindle_deg)), math.sin(math.radians(spindle_deg))
        return cos * self.x_mm - sin * self.y_mm, sin * self.x_mm + cos * self.y_mm

    def correction_mm(self, code: CorrectionCode, spindle_deg: float = 0.0) -> tuple[float, float]:
        """Moves of X and Y, mm, by which the spindle axis comes to where the ball's centre was."""
        x_mm, y_mm = self.at(spindle_deg)
        return (x_mm if code.in_x else 0.0), (y_mm if code.in_y else 0.0)


def run_out(feeds: FourFeeds, distance_mm: float, *, facing: int = 1, pretravel_mm: float = 0.0) -> RunOut:
    """Run-out and radius from four feeds. Raises InputError for another `facing` than 1 or -1.

    distance_mm: l, from the spindle axis at the start to the face; facing: +1 for a face met by feeding X in +
    direction, −1 for one met in − direction; pretravel_mm: travel of the ball between contact and signal, by which
    feeds are longer
    Source: N_0 = l − r − Δx, N_90 = l − r + Δy, N_180 = l − r + Δx, N_270 = l − r − Δy for facing +1; for −1 the signs
    of Δ are reversed.
    """
    if facing not in (1, -1):
        raise InputError(f"facing is {facing}, expected 1 or -1")
    mean_mm = (feeds.n_0_mm + feeds.n_90_mm + feeds.n_180_mm + feeds.n_270_mm) / 4.0
    return RunOut(
        x_mm=facing * (feeds.n_180_mm - feeds.n_0_mm) / 2.0,
        y_mm=facing * (feeds.n_90_mm - feeds.n_270_mm) / 2.0,
        tip_radius_mm=distance_mm - mean_mm + pretravel_mm,
        closure_um=feeds.closure_um,
    )


def mean_feeds(turns: Sequence[FourFeeds]) -> FourFeeds:
    """The mean of several turns of the spindle, mm."""
    count = len(turns)
    return FourFeeds(
        sum(turn.n_0_mm for turn in turns) / count,
        sum(turn.n_90_mm for turn in turns) / count,
        sum(turn.n_180_mm for turn in turns) / count,
        sum(turn.n_270_mm for turn in turns) / count,
    )


def run_out_std_um(turns: Sequence[FourFeeds], step_mm: float) -> float | None:
    """Standard uncertainty of Δx, and of Δy, from the scatter of these turns, µm; None of one turn.

    step_mm: resolution of the positions. From the scatter of the feeds about the mean of their angle, pooled over the
    four angles; each of Δx and Δy is half the difference of two means. Source: JCGM 100:2008, 4.2.3, 4.3.7 and 5.1.2.
    """
    count = len(turns)
    if count < 2:
        return None
    squares = 0.0
    for angle_deg in ANGLES_DEG:
        feeds = [float(getattr(turn, f"n_{angle_deg}_mm")) for turn in turns]
        squares += sum((feed - sum(feeds) / count) ** 2 for feed in feeds)
    of_mean = squares / (len(ANGLES_DEG) * (count - 1)) / count
    return UM_PER_MM * math.sqrt((of_mean + step_mm**2 / 12.0) / 2.0)


def check_repeat(turns: Sequence[FourFeeds], limit_um: float) -> None:
    """Raises MeasurementRefusedError, naming the angle and both feeds, unless each angle's feeds agree within the
    limit, µm.
    """
    for angle_deg in ANGLES_DEG:
        feeds = [float(getattr(turn, f"n_{angle_deg}_mm")) for turn in turns]
        spread_um = UM_PER_MM * (max(feeds) - min(feeds))
        if not spread_um <= limit_um:
            raise MeasurementRefusedError(
                f"the contact at {angle_deg}° does not repeat: {min(feeds):.4f} and {max(feeds):.4f} mm, {spread_um:.1f} µm"
                f" apart, expected at most {limit_um:g} µm (a chip that came or went?); nothing was stored"
            )


def check_radius(found: RunOut, nominal_mm: float, limit_um: float) -> None:
    """Raises MeasurementRefusedError, naming both radii (mm), unless the one found is the ball's within the limit, µm.

    A layer under all four contacts alike does not affect the closure; it shows in the radius only.
    """
    off_um = UM_PER_MM * (found.tip_radius_mm - nominal_mm)
    if not abs(off_um) <= limit_um:
        raise MeasurementRefusedError(
            f"the ball's radius comes out as {found.tip_radius_mm:.4f} mm, {off_um:+.1f} µm off its {nominal_mm:.4f} mm, expected"
            f" at most {limit_um:g} µm (a chip all over the face? a wrong face_mm?); nothing was stored"
        )


@dataclass(frozen=True)
class Centring:
    """A bore touched on both sides; x_mm and y_mm: the spindle's positions at contact (low, high).

    pretravel_mm: of each contact
    """

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]
    run_out: RunOut
    spindle_deg: float = 0.0
    pretravel_mm: float = 0.0

    @property
    def middle_mm(self) -> tuple[float, float]:
        """Half the travel: position of the spindle with the *ball* in the middle of the bore, mm."""
        return sum(self.x_mm) / 2.0, sum(self.y_mm) / 2.0

    @property
    def centre_mm(self) -> tuple[float, float]:
        """The bore's centre: where the spindle axis has to go, mm."""
        x_mm, y_mm = self.run_out.at(self.spindle_deg)
        return self.middle_mm[0] + x_mm, self.middle_mm[1] + y_mm

    @property
    def diameter_mm(self) -> float:
        """The bore's diameter, mm, from the travel in Y, which goes through the middle."""
        return self.y_mm[1] - self.y_mm[0] + 2.0 * (self.run_out.tip_radius_mm - self.pretravel_mm)


# -- other measurements ----------------------------------------------------------------------------------------------------
Point = tuple[float, float]


@dataclass(frozen=True)
class Touch:
    """One contact: the axis that was fed ("x" or "y"), its direction, and where the spindle axis was, mm."""

    axis: str
    direction: int
    at_mm: Point

    @property
    def index(self) -> int:
        """Number of the axis that was fed: 0 for x, 1 for y."""
        return 0 if self.axis == "x" else 1


@dataclass(frozen=True)
class Ball:
    """The ball as it stood in the spindle during a measurement.

    offset_mm: of its centre from the spindle axis, in the machine's x and y; reach_mm: from its centre to the face at the
    moment of the signal (radius less pre-travel)
    """

    offset_mm: Point
    reach_mm: float

    @classmethod
    def of(cls, known: RunOut, spindle_deg: float, pretravel_mm: float = 0.0) -> Ball:
        """With the run-out in force, at an angle of the spindle."""
        return cls(known.at(spindle_deg), known.tip_radius_mm - pretravel_mm)

    @property
    def uncorrected(self) -> Ball:
        """The same ball, taken as if it ran true."""
        return Ball((0.0, 0.0), self.reach_mm)

    def centre_mm(self, touch: Touch) -> Point:
        return touch.at_mm[0] + self.offset_mm[0], touch.at_mm[1] + self.offset_mm[1]

    def face_mm(self, touch: Touch) -> float:
        """Position of a face at right angles to the axis that was fed."""
        return self.centre_mm(touch)[touch.index] + touch.direction * self.reach_mm

    def angle_deg(self, first: Touch, second: Touch) -> float:
        """Angle of a face from the axis along it, −90 to 90, counter-clockwise from +x to +y."""
        (x_1, y_1), (x_2, y_2) = self.centre_mm(first), self.centre_mm(second)
        along, across = (x_2 - x_1, y_2 - y_1) if first.axis == "y" else (y_2 - y_1, -(x_2 - x_1))
        return math.degrees(math.atan(across / along))

    def inclined_face_mm(self, first: Touch, second: Touch, across_mm: float) -> float:
        """Where a face through two contacts meets the line at across_mm (of the other axis) along the axis that was fed.

        The centres of the ball are on a line parallel to the face, reach_mm before it.
        """
        fed, other = first.index, 1 - first.index
        one, two = self.centre_mm(first), self.centre_mm(second)
        slope = (two[fed] - one[fed]) / (two[other] - one[other])
        return one[fed] + slope * (across_mm - one[other]) + first.direction * self.reach_mm * math.hypot(1.0, slope)


def boss_mm(ball: Ball, low: Touch, high: Touch) -> tuple[float, float]:
    """Middle and width of what was touched from both sides along one axis; low: fed in + direction from the low side."""
    one, two = ball.face_mm(low), ball.face_mm(high)
    return (one + two) / 2.0, two - one
