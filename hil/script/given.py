"""What a script gives beside the axis file: values of a call, and passwords."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypedDict

from hil.axis.axis_file import AxisConfig

if TYPE_CHECKING:  # cryptography loads slowly
    from hil.correction.store import SealedStore


class Measuring(TypedDict, total=False):
    """Keys of [measurement] that a call gives in place of the axis file's."""

    targets_mm: Sequence[float]
    runs: int
    velocity_mm_s: float
    overrun_mm: float
    dwell_s: float
    reading_s: float
    reference_mm: float
    settle_um: float
    settle_within_s: float


class Reversing(TypedDict, total=False):
    """Keys of [lost_motion] that a call gives in place of the axis file's."""

    at_mm: float
    stroke_mm: float
    places: int
    finest_um: float
    runs: int
    proof_moves: int
    shortest_rise_um: float


class Winding(TypedDict, total=False):
    """Keys of [backlash] that a call gives in place of the axis file's."""

    reference_plus_mm: float
    reference_minus_mm: float
    travel_velocity_mm_s: float
    run_in_mm: float
    step_um: float
    steps: int
    readings: int
    settle_s: float
    velocity_mm_s: float
    feed: str
    creep_um_s: float
    runs: int
    method: str
    reversals: str
    scale: float


class RealTime:
    """Waits of clocks without an operator's stop; simulated time passes as fast as it can."""

    def real(self, duration_s: float) -> None:
        """Sleep."""
        time.sleep(duration_s)

    def simulated(self, now_ns: int) -> None:
        """Do not wait."""


class Passwords:
    """Passwords that a script gives; None: not given."""

    def __init__(self, reading: str | None, key: str | None) -> None:
        self._reading, self.key = reading, key

    def store(self, axis: AxisConfig, *, writing: bool) -> SealedStore:
        """The axis's store. Raises as `hil.ui.terminal.passwords.password` and `SealedStore.of`."""
        from hil.correction.store import SealedStore  # noqa: PLC0415
        from hil.ui.terminal.axis_options import has_tables  # noqa: PLC0415  (cryptography loads slowly)
        from hil.ui.terminal.options import KEY, READING  # noqa: PLC0415
        from hil.ui.terminal.passwords import password  # noqa: PLC0415

        key, reading, usual = self.key, self._reading, axis.store
        if writing and key is None:
            key = password(None, KEY, "builder key's password", os.environ, usual=usual.key_password_file)
        if reading is None:
            new = writing and not has_tables(axis)
            reading = password(None, READING, "reading password", os.environ, usual=usual.password_file, new=new)
        return SealedStore.of(axis, reading, key if writing else None)
