"""The published rule (CN103561904): of four successive torques, the peak is the third.

|T| at steps n-3 … n; the peak is at step n-1 when T(n-2) >= T(n-3), T(n-1) >= T(n-2) and T(n) < T(n-1), and the lost
motion is the distance travelled by then. Kept as published, as the reference for the fitted curve: noise triggers it
easily.
"""

from __future__ import annotations

from collections import deque

from hil.backlash.trace import ReversalTrace


class FourSampleRule:
    """The rule with its last four samples; fed step by step."""

    def __init__(self) -> None:
        self._last: deque[tuple[float, float]] = deque(maxlen=4)

    def feed(self, distance_um: float, torque_percent: float) -> float | None:
        """Takes one more step: distance since the reversal, µm, and its torque, %. The distance at the peak once it is
        recognised, else None.
        """
        self._last.append((distance_um, abs(torque_percent)))
        if len(self._last) < 4:
            return None
        (_, t3), (_, t2), (peak_um, t1), (_, t0) = self._last
        return peak_um if t2 >= t3 and t1 >= t2 and t0 < t1 else None


def four_sample(trace: ReversalTrace) -> float | None:
    """Lost motion in µm by the first peak of the trace, one torque (the first reading) for each step; None without a peak."""
    rule = FourSampleRule()
    for distance_um, torque in zip(trace.travel_um.tolist(), trace.torque_percent[:, 0].tolist(), strict=True):
        found = rule.feed(distance_um, torque)
        if found is not None:
            return found
    return None
