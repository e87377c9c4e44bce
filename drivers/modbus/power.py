"""State changes of a Modbus drive by the transitions of its register map, with the reason when it does not move.

Holds states and the writes that change them; it knows no positions. The caller writes the target before it enables.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.drive import FAULTS, DriveSample, DriveState
from drivers.errors import DriveFaultError, MotionTimeoutError, ProtocolError, StateError
from drivers.modbus.commands import POLL_S
from drivers.modbus.drive_map import StateChange
from drivers.modbus.drive_values import Unit
from drivers.way_out import WayOut

_BOOT_S = 5.0  # longest time in not ready to switch on, s

StateTest = Callable[[DriveState], bool]


class PowerStates:
    """sample(): of the drive, for the fault code in an error."""

    def __init__(self, unit: Unit, *, way_out: WayOut, sample: Callable[[], DriveSample]) -> None:
        self._unit = unit
        self._way_out = way_out
        self._sample = sample

    def state(self) -> DriveState:
        """The state, read now. Raises ProtocolError for one that is not in the map."""
        return self._unit.values.state(dict(self._unit.access.integers(self._unit.map.state_registers)))

    def await_ready(self) -> None:
        """Wait until the drive has started up. Raises MotionTimeoutError."""
        self._await("ready", lambda now: now is not DriveState.NOT_READY, _BOOT_S)

    def can_disable(self, state: DriveState) -> bool:
        """Whether the map leads out of this state by taking power off."""
        return any(state in transition.sources for transition in self._unit.map.disable)

    # -- sequences of transitions ------------------------------------------------------------------------------------
    def enable(self, before_power: Callable[[], None]) -> None:
        """Go to ENABLED; `before_power()` is called right before the step that switches on.

        Raises DriveFaultError in a fault, StateError where the map has no way, ProtocolError where it has a loop,
        MotionTimeoutError."""
        for _ in range(len(self._unit.map.enable) + 1):
            state = self.state()
            if state is DriveState.ENABLED:
                return
            transition = self._from(self._unit.map.enable, state, "enable")
            if DriveState.ENABLED in transition.targets:
                before_power()
            self._walk(transition, "enable")
        raise ProtocolError(
            f"drive {self._unit.name}: enabling led back to an earlier state, it is {self.state().value}"
        )

    def disable(self, state: DriveState) -> None:
        """Take the power off from this state, of an axis at rest. Raises StateError, MotionTimeoutError."""
        self._walk(self._from(self._unit.map.disable, state, "disable"), "disable", off=True)

    def post_off(self, state: DriveState) -> None:
        """The writes of `disable`, sent without waiting. Never raises for a drive without an answer."""
        for transition in self._unit.map.disable:
            if state in transition.sources:
                self._unit.access.post(transition.writes)
                return

    def reset_fault(self) -> None:
        """Acknowledge by the map's sequence; leaves the axis disabled. Raises DriveFaultError when the cause is still there."""
        state = self.state()
        if state is DriveState.FAULT_REACTION:
            state = self._await("end of the fault reaction", lambda now: now is not state, _BOOT_S)
        if state not in FAULTS:
            return
        transition = self._from(self._unit.map.reset_fault, state, "reset the fault")
        self._unit.commands.give_stopped(transition.writes)
        try:
            state = self._await("reset", lambda now: now not in FAULTS, transition.timeout_s)
        except MotionTimeoutError as error:
            sample = self._sample()
            if sample.state not in FAULTS:
                raise
            raise DriveFaultError(
                f"drive {self._unit.name}: the fault stays, its cause is still there", sample.fault_code
            ) from error
        if self.can_disable(state) and state not in transition.targets:
            self.disable(state)  # a stop that was sent in the fault is still in force

    def _from(self, transitions: tuple[StateChange, ...], state: DriveState, verb: str) -> StateChange:
        for transition in transitions:
            if state in transition.sources:
                return transition
        if state in FAULTS:
            raise DriveFaultError(
                f"drive {self._unit.name} cannot {verb}: it is in {state.value}", self._sample().fault_code
            )
        raise StateError(f"drive {self._unit.name} cannot {verb} from {state.value}")

    def _walk(self, transition: StateChange, verb: str, *, off: bool = False) -> None:
        """off: takes the power off, which is allowed after a stop and ends in a fault as well."""
        (self._unit.commands.take_power if off else self._unit.commands.give)(transition.writes)
        state = self._await(
            f"{verb}: {' or '.join(target.value for target in transition.targets)} (mains, STO and enable input in order?)",
            lambda now: now in transition.targets or now in FAULTS,
            self._way_out.power_off_s(transition.timeout_s) if off else transition.timeout_s,
            transition.remedy,
        )
        if state in FAULTS and not off:
            raise DriveFaultError(f"drive {self._unit.name}: fault while trying to {verb}", self._sample().fault_code)

    def _await(self, what: str, good: StateTest, timeout_s: float, remedy: str = "") -> DriveState:
        timeout_s = self._way_out.within_s(timeout_s)
        deadline = self._unit.clock.deadline(timeout_s)
        while True:
            last = deadline.expired
            state = self.state()
            if good(state):
                return state
            if last:
                raise MotionTimeoutError(
                    f"drive {self._unit.name}: {what} not within {timeout_s:.3g} s, it is {state.value}{remedy and '; ' + remedy}"
                )
            self._unit.clock.sleep_s(POLL_S)
