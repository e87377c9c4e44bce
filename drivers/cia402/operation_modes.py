"""OperationModes: the modes of operation that a drive has (6502h), the one it is in (6060h, 6061h), and the change between them."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.cia402 import objects
from drivers.cia402.kept_settings import KeptSettings
from drivers.cia402.modes import Mode
from drivers.cia402.state_machine import decode_state
from drivers.cia402.wire import ObjectAccess
from drivers.clock import Clock
from drivers.drive import FAULTS, WITHOUT_POWER
from drivers.errors import AbortError, CapabilityError, ProtocolError
from drivers.undo import undo_all

POLL_S = 0.001
TRY_S = 0.05
"""Time in which a drive at rest shows a mode that it takes, s: five slow control cycles."""
HOLDING = (0, Mode.PROFILE_POSITION, Mode.CYCLIC_POSITION, Mode.INTERPOLATED_POSITION)
"""Modes of 6061h in which an axis whose target is its position is enabled safely."""
TRIED_MODES = (
    Mode.PROFILE_POSITION,
    Mode.PROFILE_VELOCITY,
    Mode.HOMING,
    Mode.INTERPOLATED_POSITION,
    Mode.CYCLIC_POSITION,
)


class OperationModes:
    """mode: the present one. longest_s: time limit for a change, s."""

    def __init__(self, access: ObjectAccess, kept: KeptSettings, clock: Clock, longest_s: float) -> None:
        self._access = access
        self._kept = kept
        self._clock = clock
        self._longest_s = longest_s
        self._supported = 0
        shown = access.read(objects.MODE_DISPLAY)
        self.mode = Mode(shown) if shown in set(Mode) else Mode.NONE  # a maker's own, or an unknown one

    # -- which there are -------------------------------------------------------------------------------------------------
    def find(self, named: Sequence[int], notes: list[str]) -> None:
        """6502h, else the modes that the axis file names (of 6060h), else those that the drive takes at standstill, which is noted."""
        self._supported = self._access.read_if_shown(objects.SUPPORTED_MODES, 0)
        if self._supported:
            return
        if named:
            self._supported = sum(1 << (mode - 1) for mode in set(named) if mode > 0)
            return
        found = self._tried()
        names = ", ".join(mode.name.lower().replace("_", " ") for mode in found) or "none"
        how = "by trial at standstill" if found else "and it took none at standstill"
        notes.append(f"{self._access.name} does not say its modes (6502h); {how}: {names}")
        self._supported = sum(mode.supported_bit for mode in found)

    def _tried(self) -> list[Mode]:
        """Modes that 6061h shows once they are written to 6060h. An axis under power is not tried with: it has the present mode."""
        if not 0 <= self._access.read_if_shown(objects.MODE, self.mode) <= max(Mode):
            return []  # a maker's own mode could perhaps not be put back
        if not self._is_off():
            return [self.mode] if self.mode is not Mode.NONE else []
        found: list[Mode] = []
        try:
            for mode in TRIED_MODES:
                try:
                    self._kept.set(objects.MODE, mode, always=True)
                except AbortError:
                    continue
                if self._shown(mode, TRY_S) == mode:
                    found.append(mode)
        finally:
            undo_all([("", self._kept.put_back)])
        return found

    def has(self, mode: Mode) -> bool:
        """Whether 6502h lists the mode."""
        return bool(self._supported & mode.supported_bit)

    @property
    def streaming(self) -> Mode | None:
        """The mode of set-point streams: cyclic synchronous position, else interpolated position; None without either."""
        return next((mode for mode in (Mode.CYCLIC_POSITION, Mode.INTERPOLATED_POSITION) if self.has(mode)), None)

    @property
    def resting(self) -> Mode:
        """The mode in which an axis is enabled and held: profile position, else one by set-points.

        Raises CapabilityError for a drive without any of them."""
        mode = Mode.PROFILE_POSITION if self.has(Mode.PROFILE_POSITION) else self.streaming
        if mode is None:
            raise CapabilityError(
                f"{self._access.name} has no mode that moves an axis here (6502h is {self._supported:X}h)"
            )
        return mode

    # -- which it is in --------------------------------------------------------------------------------------------------
    def require(self, mode: Mode) -> None:
        """Raise CapabilityError for a mode that 6502h does not list."""
        if not self.has(mode):
            raise CapabilityError(
                f"{self._access.name} has no mode {mode.name.lower()} (6502h is {self._supported:X}h)"
            )

    def change(self, mode: Mode, *, until_enabled: bool) -> None:
        """Write it and see it confirmed (6061h). until_enabled: a drive without power may show it later, see `confirm`. Raises
        ProtocolError."""
        self._kept.set(objects.MODE, mode, always=True)
        shown = self._shown(mode, self._longest_s)
        if shown != mode and not (until_enabled and shown in HOLDING and self._is_off()):
            raise self._not_followed(mode, shown)
        self.mode = mode

    def confirm(self) -> None:
        """Make sure of the mode: some drives show it once they are enabled. Raises ProtocolError."""
        shown = self._shown(self.mode, self._longest_s)
        if shown != self.mode:
            raise self._not_followed(self.mode, shown)

    def is_shown(self) -> bool:
        """Whether 6061h shows the mode now."""
        return self._access.read(objects.MODE_DISPLAY) == self.mode

    def _shown(self, mode: Mode, within_s: float) -> int:
        deadline = self._clock.deadline(within_s)
        while (shown := self._access.read(objects.MODE_DISPLAY)) != mode and not deadline.expired:
            self._clock.sleep_s(POLL_S)
        return shown

    def _is_off(self) -> bool:
        """Whether the drive is without power for another reason than a fault."""
        state = decode_state(self._access.read(objects.STATUSWORD))
        return state in WITHOUT_POWER and state not in FAULTS

    def _not_followed(self, mode: Mode, shown: int) -> ProtocolError:
        return ProtocolError(f"{self._access.name}: mode {mode} was written, {objects.MODE_DISPLAY} stays {shown}")
