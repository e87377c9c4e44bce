"""The command for a target: computed from the correction in force, the motion history and the sensors. Does no I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.errors import StateError
from hil.correction.bound import BEYOND_WITH_STRAIGHTNESS, CAREFUL, CorrectionBound
from hil.correction.compensation import Compensation, CorrectedSetPoint, MotionHistory
from hil.correction.streamed import StreamedCorrection
from hil.records.rows import UM_PER_MM


class CommandState:
    """What commands are computed from, and the last command.

    bound: of the axis, which no correction may exceed; by_estimate: in a stream the lost motion rises with the estimated actual
    position, and not with the set-points.
    """

    def __init__(self) -> None:
        self.bound: CorrectionBound = CAREFUL
        self.by_estimate = False
        self._compensation: Compensation | None = None
        self._history: MotionHistory | None = None
        self._commanded_mm = math.nan  # known whenever the history is
        self._stream: StreamedCorrection | None = None  # knows the history and the last command while it runs

    @property
    def compensation(self) -> Compensation | None:
        """The correction in force, None leaves commands as they are. Setting it ends a stream."""
        return self._compensation

    @compensation.setter
    def compensation(self, compensation: Compensation | None) -> None:
        self._end_stream()
        self._compensation = compensation

    def forget(self) -> None:
        """Mark the motion history as unknown."""
        self._end_stream()
        self._history = None

    def set_position(self, history: MotionHistory, commanded_mm: float) -> None:
        """Set the motion history and the last command, mm."""
        self._end_stream()
        self._history, self._commanded_mm = history, commanded_mm

    def issued(self, command: CorrectedSetPoint) -> None:
        """Record a command that the drive has accepted."""
        self.set_position(command.history, command.command_mm)

    @property
    def history(self) -> MotionHistory | None:
        """Of the motion so far, None while it is unknown, as after a stop."""
        return self._history if self._stream is None else self._stream.history

    @property
    def commanded_mm(self) -> float:
        """The last command, mm; NaN while the history is unknown."""
        if self._stream is not None:
            return self._stream.commanded_mm
        return math.nan if self._history is None else self._commanded_mm

    @property
    def known_history(self) -> MotionHistory:
        """The motion history. Raises StateError while it is unknown."""
        history = self.history
        if history is None:
            raise StateError(
                "the motion so far is unknown, and with it the direction of arrival: prepare() or take_datum() first"
            )
        return history

    # -- set-points of a stream --------------------------------------------------------------------------------------------
    def stream(self, known: dict[str, float]) -> StreamedCorrection:
        """Begin a stream with the correction in force. known: record columns at this moment (`StreamedCorrection`).

        It ends with the next command from place to place, with another correction, and when the motion becomes unknown. Raises
        StateError while the history is unknown, and as `StreamedCorrection`.
        """
        history, commanded_mm = self.known_history, self.commanded_mm
        stream = StreamedCorrection(
            self._compensation, history, commanded_mm, known, self.bound, by_estimate=self.by_estimate
        )
        self.set_position(history, commanded_mm)
        self._stream = stream
        return stream

    def _end_stream(self) -> None:
        if self._stream is not None:
            self._history, self._commanded_mm = self._stream.history, self._stream.commanded_mm
            self._stream.end()
            self._stream = None

    def found_at(self, position_load_mm: float) -> None:
        """Take note of where the drive shows the axis in a cycle of a stream.

        The estimated actual position is that less the correction of the last set-point. It lies behind by the following error and has
        the encoder's noise, so it is taken to move in the commanded direction only: otherwise a correction that the motor has not yet
        made would look like a motion back, and undo itself.
        """
        stream = self._stream
        if not self.by_estimate or stream is None or self._compensation is None:
            return
        history = stream.history
        actual = history if stream.actual is None else stream.actual  # the stream has just begun, at rest
        estimated_mm = position_load_mm - (stream.commanded_mm - history.position_mm)
        ahead = (estimated_mm - actual.position_mm) * history.direction > 0.0
        stream.actual = actual.moved_to(estimated_mm) if ahead else actual

    # -- commands from place to place --------------------------------------------------------------------------------------
    def command(self, target_mm: float, known: Mapping[str, float], *, across_um: float = 0.0) -> CorrectedSetPoint:
        """The command for a target, mm. known: record columns at this moment (`Compensation.command`). Ends a stream.

        across_um: what other axes add to this one for their straightness: a part of the motion, so that the axis's own correction is
        that of the place and the direction it gives.
        Raises StateError while the history is unknown, CorrectionBoundError for a correction beyond the bound, `across_um` included.
        """
        self._end_stream()
        history = self.known_history
        target_mm += across_um / UM_PER_MM
        if self._compensation is None:
            command = CorrectedSetPoint(target_mm, target_mm, 0.0, history.moved_to(target_mm))
        else:
            command = self._compensation.command(target_mm, history, known, self.bound)
        total_um = command.correction_um + across_um
        if across_um and not abs(total_um) <= self.bound.max_um:
            self.bound.check_values(BEYOND_WITH_STRAIGHTNESS, target_mm, command.history.direction, total_um)
        return command

    def check_way(self, command: CorrectedSetPoint) -> None:
        """Raises StateError where the correction would reverse the motion to the command's target."""
        travel_mm = abs(command.target_mm - self.known_history.position_mm)
        if travel_mm and not (command.command_mm - self.commanded_mm) * command.history.direction > 0:
            raise StateError(
                f"the correction at {command.target_mm:g} mm ({command.correction_um:+.1f} µm) turns a motion of"
                f" {travel_mm * 1000:.1f} µm around: the direction of arrival would not be the one it is for;"
                " take a longer way (overrun_mm)"
            )
