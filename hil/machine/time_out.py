"""Why a motion is not over in its time: the likeliest reason by what the drive shows, and what the drive says. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.drive import DriveSample

STANDS_MM_S = 0.05
"""Below this an axis stands: a position loop against a stop trembles by less."""
STANDS_SHARE = 0.02
"""… or below this share of the speed asked for."""
PUSHES_PERCENT = 50.0
"""Torque at standstill, of rated, from which a drive pushes against something: friction and a balanced weight take less."""
BEHIND_MM = 0.1
"""Following error at standstill from which a motor does not get where its set-point is: above any position window."""


@dataclass(frozen=True)
class Motion:
    """What was asked for. target_mm, speed_mm_s: None, 0.0 for homing, whose are the drive's own."""

    what: str
    target_mm: float | None = None
    speed_mm_s: float = 0.0


def likely_reason(motion: Motion, sample: DriveSample, speed_mm_s: float) -> str:  # noqa: PLR0911  (one for each reason)
    """speed_mm_s: signed, as the positions of the last second show it."""
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
    if sample.limited:
        return "a target beyond a software limit of the drive, whose internal limit is active"
    if torque >= PUSHES_PERCENT:
        return "an end stop or a jam: it stands and pushes"
    if behind >= BEHIND_MM:
        return (
            "a following error: it stands, and its set-point is elsewhere (an end stop, a jam, a brake that is closed)"
        )
    if left_mm is not None and abs(left_mm) <= BEHIND_MM:
        return "it stands at its target, and the drive does not say that it arrived (its position window)"
    return "it stands, and the drive's set-point too: an override of 0, a halt, or an order that was not taken"


def what_it_says(sample: DriveSample, speed_mm_s: float, complaints: Sequence[str]) -> str:
    """What the drive shows and says, as figures."""
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
