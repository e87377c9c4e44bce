"""What a drive is told for a target: by the correction in force, by where the axis came from, by what is known at that moment.

Values only: nothing here waits, looks or moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.errors import StateError
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.compensation import Command, Compensation, MotionHistory


class Steering:
    """compensation: in force, None leaves commands as they are; history: of the motion so far, None while it is unknown, as after a
    stop, and with it the direction of arrival; bound: of the axis, which no correction exceeds."""

    def __init__(self) -> None:
        self.compensation: Compensation | None = None
        self.bound: CorrectionBound = CAREFUL
        self.history: MotionHistory | None = None
        self._commanded_mm = math.nan  # known whenever the history is

    def lose(self) -> None:
        """Where the axis is, and where it came from, is not known any more."""
        self.history = None

    def stands(self, history: MotionHistory, commanded_mm: float) -> None:
        """The axis came this way, by this last command."""
        self.history, self._commanded_mm = history, commanded_mm

    def given(self, command: Command) -> None:
        """The drive has this command: the motion goes on from there."""
        self.stands(command.history, command.command_mm)

    @property
    def commanded_mm(self) -> float:
        """The last command, NaN while the history is unknown."""
        return math.nan if self.history is None else self._commanded_mm

    @property
    def known_history(self) -> MotionHistory:
        """The motion so far. Raises StateError while it is unknown."""
        if self.history is None:
            raise StateError(
                "where the axis came from is unknown, and with it the direction of arrival: prepare() or take_datum() first"
            )
        return self.history

    def command(self, target_mm: float, known: Mapping[str, float]) -> Command:
        """For a target, from what is known when it is issued (`Compensation.command`). Raises StateError, CorrectionBoundError."""
        history = self.known_history
        if self.compensation is None:
            return Command(target_mm, target_mm, 0.0, history.moved_to(target_mm))
        return self.compensation.command(target_mm, history, known, self.bound)

    def check_way(self, command: Command) -> None:
        """Raises StateError where the correction would turn the motion to the command's target around."""
        travel_mm = abs(command.target_mm - self.known_history.position_mm)
        if travel_mm and not (command.command_mm - self._commanded_mm) * command.history.direction > 0:
            raise StateError(
                f"the correction at {command.target_mm:g} mm ({command.correction_um:+.1f} µm) turns a motion of"
                f" {travel_mm * 1000:.1f} µm around: the direction of arrival would not be the one it is for;"
                " take a longer way (overrun_mm)"
            )
