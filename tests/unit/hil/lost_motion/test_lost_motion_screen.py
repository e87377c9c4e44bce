"""What is drawn of lost motion and of a circle, made of what was measured."""

from itertools import pairwise
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from hil.lost_motion.circle.figures import Circle, Trace
from hil.lost_motion.circle.job import AFTER, BEFORE, Axes, DrivenCircle
from hil.lost_motion.circle.procedure import CircleRun
from hil.lost_motion.estimate import ReversalFit, estimate
from hil.lost_motion.fit import MeasuredReversal
from hil.lost_motion.page_data import circle_curves, rise_curves

AMOUNT_UM = 30.0
MOTOR_MM = np.concatenate([[0.0], np.geomspace(0.002, 2.0, 14)])


@pytest.fixture(scope="module")
def found() -> ReversalFit:
    """A load that lags by a single exponential over the motor's travel."""
    lag_um = AMOUNT_UM * -np.expm1(-MOTOR_MM / 0.05)
    return estimate([MeasuredReversal(way, MOTOR_MM, -way * lag_um) for way in (1, -1, 1)], 0.0002)


def test_the_curve_in_force_goes_through_the_points(found: ReversalFit) -> None:
    drawn = rise_curves(found)
    assert [one.in_force for one in drawn.fitted].count(True) == 1
    assert {one.name for one in drawn.fitted} == {"two tanh", "tanh", "exponential", "dead zone", "straight pieces"}
    assert {way: len(points) for way, points in drawn.measured.items()} == {1: 2 * len(MOTOR_MM), -1: len(MOTOR_MM)}
    curve = np.array(next(one.points for one in drawn.fitted if one.in_force))
    points = np.array([*drawn.measured[1], *drawn.measured[-1]])
    late = points[points[:, 0] > 0.1]  # where a straight line between two points of the curve is near enough to it
    assert len(late) > 10
    assert np.interp(late[:, 0], curve[:, 0], curve[:, 1]) == pytest.approx(late[:, 1], abs=0.05 * AMOUNT_UM)
    assert float(curve[-1, 1]) == pytest.approx(AMOUNT_UM, rel=0.02)


def test_the_beginning_is_in_micrometres(found: ReversalFit) -> None:
    drawn = rise_curves(found, beginning=True)
    ends = [x for points in (*drawn.measured.values(), *(one.points for one in drawn.fitted)) for x, _ in points]
    assert max(ends) == pytest.approx(3.0 * AMOUNT_UM, rel=0.02)
    assert [x for x, _ in drawn.measured[-1]] == pytest.approx([1000.0 * x for x in MOTOR_MM if x < 0.09])


def driven(sense: int) -> DrivenCircle:
    """A bump of 20 µm at 100 to 110° along the sense, and none with the correction."""
    angle = np.linspace(-60.0, 300.0, 7201)
    bump = np.where((angle > 100.0) & (angle < 110.0), 20.0, 0.0)
    traces = {BEFORE: Trace(angle, bump), AFTER: Trace(angle, 0.0 * bump)}
    runs = {name: CircleRun(trace, angle, np.zeros((len(angle), 2)), 0) for name, trace in traces.items()}
    return DrivenCircle(cast(Axes, (None, None)), Circle((0.0, 0.0), sense=sense), runs, Path())


@pytest.mark.parametrize(("sense", "where"), [(1, 105.0), (-1, 255.0)])
def test_a_bump_is_where_it_is_on_the_machine(sense: int, where: float) -> None:
    shown = circle_curves(driven(sense))
    assert (list(shown.traces), shown.ring_um) == ([BEFORE, AFTER], 5.0)
    for trace in shown.traces.values():
        angles = [None if point is None else point[1] for point in trace]
        assert angles.count(None) == 1  # once around: through 0 only there
        known = [angle for angle in angles if angle is not None]
        assert (min(known) >= 0.0, max(known) < 360.0, len(known) <= 1802) == (True, True, True)
        steps = [abs(b - a) for a, b in pairwise(angles) if a is not None and b is not None]
        assert max(steps) < 1.0
    bump = [point[1] for point in shown.traces[BEFORE] if point is not None and point[0] > 1.0]
    assert np.mean(bump) == pytest.approx(where, abs=0.5)
