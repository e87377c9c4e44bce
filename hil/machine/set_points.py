"""The command for a target: computed from the correction in force, the motion history and the sensors. Does no I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.errors import StateError
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.compensation import Command, Compensation, MotionHistory


class CommandState:
    """What commands are computed from, and the last command.

    compensation: the correction in force, None leaves commands as they are; history: of the motion so far, None while it is unknown,
    as after a stop; bound: of the axis, which no correction may exceed.
    """

    def __init__(self) -> None:
        self.compensation: Compensation | None = None
        self.bound: CorrectionBound = CAREFUL
        self.history: MotionHistory | None = None
        self._commanded_mm = math.nan  # known whenever the history is

    def forget(self) -> None:
        """Mark the motion history as unknown."""
        self.history = None

    def set_position(self, history: MotionHistory, commanded_mm: float) -> None:
        """Set the motion history and the last command, mm."""
        self.history, self._commanded_mm = history, commanded_mm

    def issued(self, command: Command) -> None:
        """Record a command that the drive has accepted."""
        self.set_position(command.history, command.command_mm)

    @property
    def commanded_mm(self) -> float:
        """The last command, mm; NaN while the history is unknown."""
        return math.nan if self.history is None else self._commanded_mm

    @property
    def known_history(self) -> MotionHistory:
        """The motion history. Raises StateError while it is unknown."""
        if self.history is None:
            raise StateError(
                "the motion so far is unknown, and with it the direction of arrival: prepare() or take_datum() first"
            )
        return self.history

    def command(self, target_mm: float, known: Mapping[str, float]) -> Command:
        """The command for a target, mm. known: record columns at this moment (`Compensation.command`).

        Raises StateError while the history is unknown, CorrectionBoundError for a correction beyond the bound.
        """
        history = self.known_history
        if self.compensation is None:
            return Command(target_mm, target_mm, 0.0, history.moved_to(target_mm))
        return self.compensation.command(target_mm, history, known, self.bound)

    def check_way(self, command: Command) -> None:
        """Raises StateError where the correction would reverse the motion to the command's target."""
        travel_mm = abs(command.target_mm - self.known_history.position_mm)
        if travel_mm and not (command.command_mm - self._commanded_mm) * command.history.direction > 0:
            raise StateError(
                f"the correction at {command.target_mm:g} mm ({command.correction_um:+.1f} µm) turns a motion of"
                f" {travel_mm * 1000:.1f} µm around: the direction of arrival would not be the one it is for;"
                " take a longer way (overrun_mm)"
            )
