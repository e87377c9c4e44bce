"""Likely reason of a motion that times out, from the drive's last sample. Does no I/O."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.drive import DriveSample

STANDS_MM_S = 0.05
"""Speed below which an axis counts as standing, mm/s: above the oscillation of a position loop against a stop."""
STANDS_SHARE = 0.02
"""Share of the commanded speed below which an axis counts as standing."""
PUSHES_PERCENT = 50.0
"""Torque at standstill, % of rated, from which a drive counts as pushing: above friction and a balanced weight."""
BEHIND_MM = 0.1
"""Following error at standstill, mm, from which the motor counts as blocked: above any position window."""


@dataclass(frozen=True)
class Motion:
    """A commanded motion. what: its name, for messages; target_mm, speed_mm_s: None and 0.0 for a homing, where the drive has its
    own."""

    what: str
    target_mm: float | None = None
    speed_mm_s: float = 0.0


def likely_reason(motion: Motion, sample: DriveSample, speed_mm_s: float) -> str:  # noqa: PLR0911  (one for each reason)
    """The likely reason, as a phrase. speed_mm_s: signed, from the positions of the last second."""
    torque, behind = abs(sample.torque_percent or 0.0), abs(sample.following_error_mm or 0.0)
    left_mm = None if motion.target_mm is None else motion.target_mm - sample.position_load_mm
    if abs(speed_mm_s) > max(STANDS_MM_S, STANDS_SHARE * motion.speed_mm_s):
        if left_mm is None:
            return "it is still under way"
        if left_mm * speed_mm_s < 0.0 and abs(left_mm) > BEHIND_MM:
            return "it moves away from its target"
        if abs(left_mm) <= BEHIND_MM:
            return "it does not come to rest at its target"
        return f"still under way, slower than the {motion.speed_mm_s:g} mm/s asked for: an override, or a speed limit of the drive"
    if torque >= PUSHES_PERCENT:
        return "an end stop or a jam: it stands and pushes"
    if left_mm is not None and abs(left_mm) <= BEHIND_MM > behind:
        return "it stands at its target, and the drive does not say that it arrived (its position window)"
    if sample.limited:
        return "an internal limit of the drive that is active: of its current, velocity or position"
    if behind >= BEHIND_MM:
        return (
            "a following error: it stands, and its set-point is elsewhere (an end stop, a jam, a brake that is closed)"
        )
    return "it stands, and the drive's set-point too: an override of 0, a halt, or an order that was not taken"


def drive_report(sample: DriveSample, speed_mm_s: float, complaints: Sequence[str]) -> str:
    """The drive's sample and complaints as one line of figures. speed_mm_s: as for `likely_reason`."""
    parts = [sample.state.value, f"at {sample.position_load_mm:.4f} mm, {speed_mm_s:.3f} mm/s"]
    if sample.torque_percent is not None:
        parts.append(f"torque {sample.torque_percent:.0f} %")
    if sample.following_error_mm is not None:
        parts.append(f"following error {sample.following_error_mm:.4f} mm")
    if sample.limited:
        parts.append("internal limit active")
    if sample.fault_code:
        parts.append(f"error code {sample.fault_code:04X}h")
    return ", ".join((*parts, *complaints))
