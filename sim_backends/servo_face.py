"""Interfaces of a servo's firmware: to its faces above, to the mechanics below. Protocols only.

Units are the drive's own: motor counts, counts/s, counts/s², torque in 0.1 % of rated.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Protocol

from sim_backends.own_table import OwnTable


class MotionMode(Enum):
    """Modes of the set-point generator."""

    IDLE = "idle"  # hold the demand position
    PROFILE_POSITION = "profile position"
    PROFILE_VELOCITY = "profile velocity"
    HOMING = "homing"
    CYCLIC_POSITION = "cyclic synchronous position"
    CYCLIC_VELOCITY = "cyclic synchronous velocity"
    CYCLIC_TORQUE = "cyclic synchronous torque"


class Mechanics(Protocol):
    """The load of the motor: a plant, or a load without errors."""

    def step(self, motor_rev: float, dt_s: float) -> None:
        """Turn the shaft to `motor_rev` revolutions within dt_s seconds."""

    @property
    def friction_permille(self) -> float:
        """Torque it puts on the motor, 0.1 % of rated, with the sign of the motion it opposes."""


class Compensation(Protocol):
    """The backlash compensation of a servo."""

    def follow(self, amount: Callable[[], float], accelerated: Callable[[], bool]) -> None:
        """From now on add so many motor counts at a reversal, quickly or not."""


class OwnCorrection(Protocol):
    """The stage at which a servo adds a table of its own to the demand of the shaft."""

    def follow(self, table: OwnTable) -> None:
        """From now on add this table."""


class Servo(Protocol):
    """What a face may use of a servo. Readings are of the present simulated time.

    Motion orders are without effect while unpowered or while a stop runs or holds, as on a real drive.
    """

    @property
    def backlash(self) -> Compensation:
        """Its backlash compensation, for a face to connect to its parameters."""

    @property
    def table(self) -> OwnCorrection:
        """The stage of its own correction table, for a face that has one."""

    @property
    def fast_inputs(self) -> list[Callable[[int], None]]:
        """Callbacks for a pulse on a fast input; each is called with its number, 1 or 2, at the time of the pulse."""

    @property
    def powered(self) -> bool: ...
    @property
    def stopping(self) -> bool:
        """Quick stop or halt ramp still running, or held by it."""

    @property
    def homed(self) -> bool: ...
    @property
    def homing_error(self) -> bool: ...
    @property
    def target_reached(self) -> bool: ...
    @property
    def mode(self) -> MotionMode: ...
    @property
    def fault_code(self) -> int:
        """0 = none; error codes of IEC 61800-7-201 / CiA-402 (603Fh)."""

    @property
    def position_demand_counts(self) -> int: ...
    @property
    def position_actual_counts(self) -> int: ...
    @property
    def velocity_actual_counts_s(self) -> int: ...
    @property
    def torque_actual_permille(self) -> int: ...
    @property
    def following_error_counts(self) -> int: ...
    @property
    def positive_limit_switch(self) -> bool: ...
    @property
    def negative_limit_switch(self) -> bool: ...
    @property
    def home_switch(self) -> bool: ...

    # orders
    def power_on(self) -> None: ...
    def power_off(self) -> None: ...
    def quick_stop(self, deceleration_counts_s2: float) -> None: ...
    def halt(self, deceleration_counts_s2: float) -> None: ...
    def resume(self) -> None:
        """End a halt or a quick stop that holds; the demand stays unchanged."""

    def move_absolute(self, target_counts: int, velocity_counts_s: float, acceleration_counts_s2: float) -> None: ...
    def move_velocity(self, velocity_counts_s: float, acceleration_counts_s2: float) -> None: ...
    def start_homing(
        self, method: int, speed_switch_counts_s: float, speed_zero_counts_s: float, offset_counts: int
    ) -> None: ...
    def cyclic_position(self, target_counts: int) -> None: ...
    def cyclic_velocity(self, velocity_counts_s: float) -> None: ...
    def cyclic_torque(self, torque_permille: int) -> None: ...
    def raise_fault(self, code: int) -> None: ...
    def reset_fault(self) -> None: ...
    def advance(self, now_ns: int, dt_s: float) -> None: ...
