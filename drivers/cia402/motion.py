"""ProfileMotion: orders to move one open drive, in its own units; set-points that move nothing; halt.

A move is given to a drive with profile position (`given_move`), and fed with set-points to one without it (`fed_move`). Limits and
millimetres are in `drive`.
"""

from __future__ import annotations

from contextlib import suppress

from drivers.cia402 import objects, words
from drivers.cia402.fed_move import FedMove
from drivers.cia402.given_move import GivenMove
from drivers.cia402.modes import Mode
from drivers.cia402.motion_parts import MotionParts, MoveOrder
from drivers.cia402.power import RUN
from drivers.cia402.state_machine import Control
from drivers.errors import AbortError
from drivers.standstill import arrived_within_counts


class ProfileMotion:
    """The motion of one open drive; `_move` is the one in progress."""

    def __init__(self, parts: MotionParts) -> None:
        self._parts = parts
        window_counts = words.window(parts.access.read_if_shown(objects.POSITION_WINDOW, 0)) or 0
        self._near_counts = arrived_within_counts(parts.units.scaling.counts_per_load_mm, window_counts)
        self._move: GivenMove | FedMove | None = None

    # -- modes -----------------------------------------------------------------------------------------------------------
    def set_mode(self, mode: Mode, *, until_enabled: bool = False) -> None:
        """Change the mode of operation; the controlword is not written, so the axis stays held. until_enabled: see
        `OperationModes.change`.

        Set-points of the new mode are first made to mean "stay". Raises CapabilityError for a mode that the drive does not have,
        ProtocolError when it does not follow.
        """
        modes = self._parts.modes
        modes.require(mode)
        if modes.mode is mode:
            return
        if mode not in (Mode.PROFILE_POSITION, Mode.HOMING):
            self.stay()
        self._move = None
        modes.change(mode, until_enabled=until_enabled)

    def stay(self) -> None:
        """Write set-points that move nothing: target position := actual position, target velocity and torque := 0."""
        self._move = None
        has, write = self._parts.modes.has, self._parts.kept.set
        here = self._parts.access.read(objects.POSITION_ACTUAL)
        if has(Mode.PROFILE_POSITION) or has(Mode.CYCLIC_POSITION):
            write(objects.TARGET_POSITION, here, always=True)
        if has(Mode.INTERPOLATED_POSITION):
            with suppress(AbortError):  # some take it in that mode only
                write(objects.INTERPOLATION_TARGET, here, always=True)
        if has(Mode.PROFILE_VELOCITY) or has(Mode.CYCLIC_VELOCITY):
            write(objects.TARGET_VELOCITY, 0, always=True)
        if has(Mode.CYCLIC_TORQUE):
            write(objects.TARGET_TORQUE, 0, always=True)

    # -- moves -----------------------------------------------------------------------------------------------------------
    def move(self, order: MoveOrder) -> None:
        """Give an absolute set-point; returns once it is acknowledged. It replaces the move in progress.

        Raises LimitError when the drive limits the target, ProtocolError for a handshake that is not acknowledged,
        FollowingErrorError for an axis that moves elsewhere meanwhile, DriveFaultError.
        """
        mode = self._parts.modes.resting
        if mode is Mode.PROFILE_POSITION:
            move = GivenMove(self._parts, order, self._near_counts)
            path = move.path(None if self._move is None else self._move.target_counts)
            self.set_mode(mode)
            move.hand_over(path)
            self._move = move
            move.taken(path)
        else:
            changed = self._parts.modes.mode is not mode
            self.set_mode(mode)
            if not isinstance(self._move, FedMove):
                self._move = FedMove(self._parts, self._near_counts)
            self._move.go(order, anew=changed)

    def arrived(self) -> bool | None:
        """Whether the axis is at the target of a move whose end the drive does not show; None where bit 10 shows it."""
        return None if self._move is None else self._move.arrived()

    def look(self, status: int) -> None:
        """Evaluate a sample for the move in progress. Raises LimitError, see `GivenMove.look`."""
        if self._move is not None and not self._move.look(status):
            self._move = None

    # -- halt ------------------------------------------------------------------------------------------------------------
    def halt(self) -> None:
        """Set the halt bit: stop with the ramp of 605Dh and stay enabled."""
        self._parts.power.write(RUN | Control.HALT)
