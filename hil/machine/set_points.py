"""The command for a target: computed from the correction in force, the motion history and the sensors. Does no I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.errors import StateError
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.compensation import Command, Compensation, MotionHistory
from hil.records.rows import UM_PER_MM


class CommandState:
    """What commands are computed from, and the last command.

    compensation: the correction in force, None leaves commands as they are; history: of the motion so far, None while it is unknown,
    as after a stop; bound: of the axis, which no correction may exceed; by_estimate: in a stream the lost motion rises with the
    estimated actual position, and not with the set-points.
    """

    def __init__(self) -> None:
        self.compensation: Compensation | None = None
        self.bound: CorrectionBound = CAREFUL
        self.history: MotionHistory | None = None
        self.by_estimate = False
        self._actual: MotionHistory | None = None  # as estimated during a stream
        self._commanded_mm = math.nan  # known whenever the history is

    def forget(self) -> None:
        """Mark the motion history as unknown."""
        self.history = self._actual = None

    def set_position(self, history: MotionHistory, commanded_mm: float) -> None:
        """Set the motion history and the last command, mm."""
        self.history, self._commanded_mm = history, commanded_mm

    def issued(self, command: Command) -> None:
        """Record a command that the drive has accepted."""
        self.set_position(command.history, command.command_mm)

    def found_at(self, position_load_mm: float) -> None:
        """Take note of where the drive shows the axis in a cycle of a stream.

        The estimated actual position is that less the correction of the last set-point. It lies behind by the following error and has
        the encoder's noise, so it is taken to move in the commanded direction only: otherwise a correction that the motor has not yet
        made would look like a motion back, and undo itself.
        """
        if not self.by_estimate or self.history is None or self.compensation is None:
            return
        if self._actual is None:
            self._actual = self.history  # the stream has just begun, at rest
        estimated_mm = position_load_mm - (self._commanded_mm - self.history.position_mm)
        if (estimated_mm - self._actual.position_mm) * self.history.direction > 0.0:
            self._actual = self._actual.moved_to(estimated_mm)

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

    def command(
        self, target_mm: float, known: Mapping[str, float], *, across_um: float = 0.0, streamed: bool = False
    ) -> Command:
        """The command for a target, mm. known: record columns at this moment (`Compensation.command`); streamed: a set-point.

        across_um: what other axes add to this one for their straightness: a part of the motion, so that the axis's own correction is
        that of the place and the direction it gives.
        Raises StateError while the history is unknown, CorrectionBoundError for a correction beyond the bound, `across_um` included.
        """
        history = self.known_history
        self._actual = self._actual if streamed else None
        target_mm += across_um / UM_PER_MM
        if self.compensation is None:
            command = Command(target_mm, target_mm, 0.0, history.moved_to(target_mm))
        else:
            command = self.compensation.command(target_mm, history, known, self.bound, self._actual)
        total_um = command.correction_um + across_um
        if across_um and not abs(total_um) <= self.bound.max_um:
            self.bound.check_values(
                "correction with straightness not commanded", target_mm, command.history.direction, total_um
            )
        return command

    def check_way(self, command: Command) -> None:
        """Raises StateError where the correction would reverse the motion to the command's target."""
        travel_mm = abs(command.target_mm - self.known_history.position_mm)
        if travel_mm and not (command.command_mm - self._commanded_mm) * command.history.direction > 0:
            raise StateError(
                f"the correction at {command.target_mm:g} mm ({command.correction_um:+.1f} µm) turns a motion of"
                f" {travel_mm * 1000:.1f} µm around: the direction of arrival would not be the one it is for;"
                " take a longer way (overrun_mm)"
            )
