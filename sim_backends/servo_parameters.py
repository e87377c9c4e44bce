"""ServoParameters: a simulated drive with its motor and its switches as one frozen description."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.errors import InputError


@dataclass(frozen=True)
class ServoParameters:
    """A drive, its motor and its switches. Places are shaft counts, in the frame in which the axis's nominal zero is 0.

    position_gain_per_s and feed_forward (0…1) make the lag (1 − feed_forward)·v/gain; the window and time-outs supervise it.
    home_switch_counts: the switch is active below. switch_spread_counts: standard deviation of the switching points, drawn anew for
    each homing. encoder_noise_counts: standard deviation of the position shown. Torque parts: viscous in 0.1 % per rev/s, inertia in
    0.1 % per rev/s²; the current limit ends them all at peak_torque_permille.
    """

    counts_per_rev: int = 1_000_000
    start_counts: float = 0.0
    max_velocity_rev_s: float = 40.0
    max_acceleration_rev_s2: float = 400.0
    position_gain_per_s: float = 60.0
    feed_forward: float = 0.9
    following_window_counts: float = 200_000.0
    following_timeout_s: float = 0.05
    position_window_counts: float = 3.0
    position_window_s: float = 0.02
    negative_limit_counts: float = -500_000.0
    positive_limit_counts: float = 50_500_000.0
    negative_stop_counts: float = -1_000_000.0
    positive_stop_counts: float = 51_000_000.0
    home_switch_counts: float = -200_000.0
    index_offset_counts: float = 0.0
    switch_spread_counts: float = 0.0
    homing_acceleration_rev_s2: float = 100.0
    coast_rev_s2: float = 8.0
    default_cycle_s: float = 0.002
    motor_friction_permille: float = 15.0
    viscous_permille: float = 2.0
    inertia_permille: float = 0.4
    cogging_permille: float = 0.6
    cogging_per_rev: int = 8
    torque_noise_permille: float = 1.0
    encoder_noise_counts: float = 0.0
    peak_torque_permille: float = 3000.0
    seed: int = 7

    def __post_init__(self) -> None:
        for name in ("counts_per_rev", "max_velocity_rev_s", "max_acceleration_rev_s2", "position_gain_per_s"):
            if not getattr(self, name) > 0:
                raise InputError(f"servo parameter {name} is {getattr(self, name)}, expected > 0")
