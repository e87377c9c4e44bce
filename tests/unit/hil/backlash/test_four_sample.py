"""The published rule, to the letter: rising or level twice, then falling; the peak is the step before the fall."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import InputError
from hil.backlash.result import first_peak_um, four_sample
from hil.backlash.trace import ReversalTrace


@pytest.mark.parametrize(
    ("torques", "peak_um"),
    [
        ([1.0, 2.0, 3.0, 2.9], 2.0),  # the least it takes
        ([1.0, 1.0, 1.0, 0.9], 2.0),  # level counts as rising
        ([2.0, 1.0, 3.0, 2.0], None),  # T(n-2) < T(n-3)
        ([1.0, 3.0, 2.0, 1.0], None),  # T(n-1) < T(n-2)
        ([1.0, 2.0, 3.0, 3.0], None),  # T(n) is not below T(n-1)
        ([1.0, 2.0, 3.0], None),  # three are not four
        (
            [5.0, 3.0, 1.0, 0.5, 2.0, 4.0, 6.0, 7.0, 6.9, 9.0, 8.0],
            7.0,
        ),  # falls, rises, breaks away: the first peak counts
        ([-5.0, -3.0, -1.0, 0.5, 2.0, 4.0, 6.0, 5.0], 6.0),  # of the magnitude: signed torque through zero
        ([-1.0, -2.0, -3.0, -2.9], 2.0),
        ([9.0, 8.0, 8.0, 8.5, 8.4, 3.0], 3.0),  # a ripple on the way down is a peak to it
    ],
)
def test_literal_sequences(torques: list[float], peak_um: float | None) -> None:
    assert first_peak_um(range(len(torques)), torques) == peak_um


def test_it_speaks_at_the_fourth_sample_and_not_before() -> None:
    assert first_peak_um([0.0, 1.0, 2.0], [1.0, 2.0, 3.0]) is None
    assert first_peak_um([0.0, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 2.0]) == 2.0


def test_of_a_trace_it_takes_one_reading_a_step_and_the_motors_own_distance() -> None:
    positions = np.array([10.0, 9.9991, 9.9980, 9.9970])
    torques = np.array([[1.0, 9.0], [-2.0, 0.0], [-3.0, 0.0], [-2.5, 9.0]])
    assert four_sample(ReversalTrace(-1, positions, torques)) == pytest.approx(2.0)


def test_a_trace_knows_its_shape() -> None:
    with pytest.raises(InputError, match="expected \\+1 or -1"):
        ReversalTrace(0, np.zeros(3), np.zeros((3, 1)))
    with pytest.raises(InputError, match="one row of torques"):
        ReversalTrace(1, np.zeros(3), np.zeros((2, 1)))
