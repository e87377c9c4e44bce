"""The contents of the page of system C: the reversals measured, the fitted shapes, the proof, and the circle of two
axes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from drivers.errors import InputError
from drivers.files import read_text
from hil.axis.axis_file import DriveAxis
from hil.desk.desk import Desk
from hil.desk.progress import Phase, Progress
from hil.lost_motion import job as lost_motion
from hil.lost_motion.at_load import load_mm
from hil.lost_motion.circle import job as circle
from hil.lost_motion.circle.figures import ring_of
from hil.lost_motion.circle.job import DrivenCircle
from hil.lost_motion.estimate import ReversalFit
from hil.lost_motion.measured import ReversalResult
from hil.lost_motion.procedure import LostMotionProof
from hil.records.files import parse_json
from hil.records.rows import UM_PER_MM, Floats
from hil.ui.report.views import object_of, value_of

Points = list[tuple[float, float]]
FIT_POINTS, BEGINNING = 160, 3.0
MOST_POINTS = 1500
"""Most points of one plotted circle."""


@dataclass(frozen=True)
class LostMotionScreen:
    """measurement: the last one; measured: its result, None before its end; stored: it is in force"""

    measurement: Progress | None
    measured: ReversalResult | None
    stored: bool

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the result, in English."""
        return () if self.measured is None else self.measured.verdict

    @property
    def storable(self) -> bool:
        """There is a good result that is not stored yet."""
        return self.measured is not None and self.measured.raw.good and not self.stored


def lost_motion_screen(desk: Desk) -> LostMotionScreen:
    """From the present state of the desk."""
    measurement, stored = desk.last(lost_motion.MEASURE), desk.last(lost_motion.STORE)
    measured = None if measurement is None else measurement.result
    if not isinstance(measured, ReversalResult):
        measured = None
    kept = None if stored is None or stored.phase is not Phase.DONE else stored.result
    is_stored = measured is not None and isinstance(kept, ReversalResult) and kept.raw is measured.raw
    return LostMotionScreen(measurement, measured, is_stored)


@dataclass(frozen=True)
class KeptLostMotion:
    """The last result on disk. at: when it was written; values in µm, over in %, None where the file lacks one; shape: by name."""

    at: datetime
    amount_um: float | None
    std_um: float | None
    shape: str
    before_um: float | None
    after_um: float | None
    over_percent: float | None


def kept_lost_motion(axis: DriveAxis) -> KeptLostMotion | None:
    """The last result in the axis's folder, also of an earlier run of the server; None without a readable one."""
    files = sorted(axis.store.directory.glob(f"{lost_motion.CAMPAIGN}-[0-9]*/{lost_motion.RESULT}"))
    if not files:
        return None
    try:
        found = object_of(parse_json(read_text(files[-1])))
    except (InputError, ValueError):
        return None
    proof, parameters = object_of(found.get("proof")), object_of(found.get("parameters"))
    amount_um, over_um = value_of(found, "amount_um"), value_of(proof, "over_compensation_um")
    return KeptLostMotion(
        datetime.fromtimestamp(files[-1].stat().st_mtime).astimezone(),
        amount_um,
        value_of(object_of(parameters.get("amount_um")), "std"),
        str(object_of(found.get("rise")).get("shape", "")),
        value_of(object_of(proof.get("before")), "rms_um"),
        value_of(object_of(proof.get("after")), "rms_um"),
        100.0 * over_um / amount_um if amount_um and over_um is not None else None,
    )


@dataclass(frozen=True)
class FittedCurve:
    """A shape as a curve; in_force: it is the chosen one"""

    name: str
    in_force: bool
    points: Points


@dataclass(frozen=True)
class RiseCurves:
    """measured: by the direction after the reversal, the load's lag, µm, over the motor's travel since it, mm or µm"""

    measured: Mapping[int, Points]
    fitted: Sequence[FittedCurve]


def rise_curves(estimate: ReversalFit, *, beginning: bool = False) -> RiseCurves:
    """The whole travel in mm, or its beginning in µm: `BEGINNING` times the lost motion."""
    end_mm, per_mm = max(float(one.travel_mm.max()) for one in estimate.reversals), 1.0
    if beginning:
        end_mm, per_mm = min(end_mm, BEGINNING * estimate.amount_um / UM_PER_MM), UM_PER_MM
    measured: dict[int, Points] = {1: [], -1: []}
    for one in estimate.reversals:
        travel_mm, risen_um = one.rise
        inside = travel_mm <= end_mm
        measured[one.direction] += _points(per_mm * travel_mm[inside], risen_um[inside])
    motor_mm = np.linspace(0.0, end_mm, FIT_POINTS)
    fitted = []
    for contender in estimate.contenders:
        rise = contender.fitted.rise
        behind_um = UM_PER_MM * (motor_mm - load_mm(rise, motor_mm))
        fitted.append(FittedCurve(rise.shape.name, rise is estimate.rise, _points(per_mm * motor_mm, behind_um)))
    return RiseCurves(measured, fitted)


def proof_points(proof: LostMotionProof) -> tuple[Points, Points]:
    """Remaining lost motion of each fresh move, µm, in the move's own direction: before, and with the correction; over
    its number.
    """
    moves, sign = np.arange(1.0, len(proof.after_um) + 1.0), proof.after.direction
    return _points(moves, sign * proof.before_um), _points(moves, sign * proof.after_um)


def driven_circle(desk: Desk) -> DrivenCircle | None:
    """The last circle that was driven from this desk, if any."""
    last = desk.last(circle.CIRCLE)
    return last.result if last is not None and isinstance(last.result, DrivenCircle) else None


@dataclass(frozen=True)
class CircleCurves:
    """ring_um: between two rings; traces: by name, (deviation in µm, angle in degrees counter-clockwise, 0 to 360),
    None where a curve passes 0
    """

    ring_um: float
    traces: Mapping[str, list[tuple[float, float] | None]]


def circle_curves(driven: DrivenCircle) -> CircleCurves:
    """The traces for a polar plot."""
    curves: dict[str, list[tuple[float, float] | None]] = {}
    for name, trace in driven.traces.items():
        step = max(1, len(trace.angle_deg) // MOST_POINTS)
        angles = np.mod(trace.angle_deg[::step] * driven.circle.sense, 360.0)
        curve: list[tuple[float, float] | None] = []
        for point in _points(trace.deviation_um[::step], angles):
            if curve and curve[-1] is not None and abs(point[1] - curve[-1][1]) > 180.0:
                curve.append(None)
            curve.append(point)
        curves[name] = curve
    return CircleCurves(ring_of(driven.traces.values()), curves)


def _points(x: Floats, y: Floats) -> Points:
    return [(float(a), float(b)) for a, b in zip(x, y, strict=True)]
