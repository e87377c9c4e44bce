"""Transitions of the CiA-402 state machine from the master's side, one command at a time, with the reason when it does not move.

Holds the controlword and state logic that needs the wire; it knows no positions. The caller writes the target before it enables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.cia402.error_codes import error_text
from drivers.cia402.objects import CONTROLWORD, ERROR_CODE, STATUSWORD
from drivers.cia402.state_machine import DISABLE_STEPS, ENABLE_STEPS, Command, Control, Status, decode_state
from drivers.cia402.wire import ObjectAccess
from drivers.clock import NS_PER_S, Clock
from drivers.drive import FAULTS, DriveState
from drivers.errors import AbortError, DriveFaultError, MotionTimeoutError, NoAnswerError, StateError
from drivers.way_out import WayOut

POLL_S = 0.002
RUN = Command.ENABLE_OPERATION.word
STANDS_S = 0.002
"""Time for which a controlword stands before one whose rising edge acts, s: a drive may look at it every millisecond only, and of two
that are closer it sees the second alone."""
KEPT_FAULT = Status.FAULT | Status.SWITCH_ON_DISABLED
"""Some show the fault bit beside switch on disabled after a reset, until a shutdown."""


@dataclass(frozen=True)
class PowerTimes:
    """Longest times of a drive, s. The enable time includes the opening of the brake, the stop time its longest ramp."""

    enable_s: float = 3.0
    disable_s: float = 3.0
    stop_s: float = 10.0
    fault_reset_s: float = 2.0


class PowerStage:
    """Controlword and statusword of one drive over SDO: every step is confirmed.

    stopped: a stop was sent since the axis was enabled last. From then on no command is sent that enables, because in the state
    quick stop active "enable operation" makes the axis continue (transition 16). Any thread may set it.
    """

    def __init__(self, access: ObjectAccess, clock: Clock, times: PowerTimes, way_out: WayOut) -> None:
        self._access = access
        self._way_out = way_out
        self._clock = clock
        self.times = times
        self.controlword = 0  # as last written by us
        self._written_ns = 0  # when
        self.stopped = False

    @property
    def _name(self) -> str:
        return self._access.name

    def statusword(self) -> int:
        """6041h, read now. Raises as `ObjectAccess.read`."""
        return self._access.read(STATUSWORD)

    def state(self) -> DriveState:
        return decode_state(self.statusword())

    def write(self, controlword: int) -> None:
        """Write 6040h and keep it. Raises StateError for a command that enables after a stop was sent, and as `ObjectAccess.write`."""
        if self.stopped and controlword & RUN == RUN:
            raise StateError(f"{self._name} was told to stop: enable it before the next command")
        self._access.write(CONTROLWORD, controlword)
        self.controlword, self._written_ns = controlword, self._clock.now_ns()

    def write_edge(self, controlword: int) -> None:
        """As `write`, for a word whose rising edge acts, once the one before has stood for `STANDS_S`."""
        until_ns = self._written_ns + round(STANDS_S * NS_PER_S)
        if self._clock.now_ns() < until_ns:
            self._clock.sleep_until_ns(until_ns)
        self.write(controlword)

    def error_code(self) -> int | None:
        """603Fh, None where the drive has no such object."""
        try:
            return self._access.read(ERROR_CODE)
        except (AbortError, NoAnswerError):
            return None

    def fault(self, what: str) -> DriveFaultError:
        """The error of a drive in a fault, with its own code. what: the sentence's middle."""
        code = self.error_code()
        return DriveFaultError(f"{self._name}{what}: {error_text(code) if code else 'no error code'}", code)

    # -- sequences of transitions ----------------------------------------------------------------------------------------
    def enable(self, before_power: Callable[[], None]) -> None:
        """Go to ENABLED; `before_power()` is called right before the command that switches on.

        Raises DriveFaultError in a fault, MotionTimeoutError naming the state in which it stays and probable reasons, StateError when
        a stop is sent meanwhile.
        """

        status = self.statusword()
        if decode_state(status) is DriveState.NOT_READY:
            self.write(Command.DISABLE_VOLTAGE.word)  # some leave it with the first controlword only
        elif status & KEPT_FAULT == KEPT_FAULT:
            self.write(Command.SHUTDOWN.word)

        def step(state: DriveState) -> Command | None:
            command = ENABLE_STEPS.get(state)
            if command is Command.ENABLE_OPERATION:
                before_power()
            return command

        self._walk(DriveState.ENABLED, step, self.times.enable_s, "enabled")

    def resume_from_quick_stop(self, before_power: Callable[[], None]) -> None:
        """Transition 16, for a drive that holds after its quick stop (605Ah 5 to 8), so that the axis is held all the time.

        Raises MotionTimeoutError."""
        before_power()
        self.write(Command.ENABLE_OPERATION.word)
        self._await(lambda state: state is DriveState.ENABLED, self.times.enable_s, "enabled out of quick stop")

    def disable(self) -> None:
        """Go down to SWITCH_ON_DISABLED; a fault counts as disabled. Raises MotionTimeoutError."""
        resting = (DriveState.SWITCH_ON_DISABLED, DriveState.FAULT, DriveState.NOT_READY)
        if self.state() in resting:
            self.write(Command.DISABLE_VOLTAGE.word)
        else:
            allowed_s = self._way_out.power_off_s(self.times.disable_s)
            self._walk(DriveState.SWITCH_ON_DISABLED, DISABLE_STEPS.get, allowed_s, "disabled", also=resting)

    def reset_fault(self) -> None:
        """Send the rising edge of bit 7, then a controlword that enables nothing. Raises DriveFaultError when the fault remains."""
        state = self._await(
            lambda state: state is not DriveState.FAULT_REACTION, self.times.stop_s, "through with its fault reaction"
        )
        self.write(Command.DISABLE_VOLTAGE.word)
        if state is not DriveState.FAULT:
            return
        self.write_edge(int(Control.FAULT_RESET))
        deadline = self._clock.deadline(self.times.fault_reset_s)
        while (state := self.state()) is DriveState.FAULT and not deadline.expired:
            self._clock.sleep_s(POLL_S)
        self.write(Command.DISABLE_VOLTAGE.word)
        if self.statusword() & KEPT_FAULT == KEPT_FAULT:
            self._clear_kept_fault()
        if state is DriveState.FAULT:
            raise self.fault(": the fault stays after a reset")

    def _clear_kept_fault(self) -> None:
        """Shut down and back: without power, from switch on disabled. Raises MotionTimeoutError."""
        self.write(Command.SHUTDOWN.word)
        self._await(lambda state: state is DriveState.READY, self.times.fault_reset_s, "free of the fault bit")
        self.write(Command.DISABLE_VOLTAGE.word)
        self._await(lambda state: state is DriveState.SWITCH_ON_DISABLED, self.times.disable_s, "disabled")

    def _walk(
        self,
        goal: DriveState,
        step: Callable[[DriveState], Command | None],
        timeout_s: float,
        what: str,
        also: tuple[DriveState, ...] = (),
    ) -> None:
        deadline = self._clock.deadline(timeout_s)
        commanded: DriveState | None = None
        while True:
            status = self.statusword()
            state = decode_state(status)
            if state is goal or state in also:
                return
            if goal is DriveState.ENABLED and state in FAULTS:
                raise self.fault(": fault while enabling")
            if deadline.expired:
                raise MotionTimeoutError(
                    f"{self._name}: not {what} within {timeout_s:.3g} s, it stays in {state.value}{self.why(state, status)}"
                )
            if state is not commanded:
                command = step(state)
                if command is not None:
                    self.write(command.word)
                    commanded = state
                    continue
            self._clock.sleep_until_ns(min(deadline.end_ns, self._clock.now_ns() + round(POLL_S * NS_PER_S)))

    def _await(self, reached: Callable[[DriveState], bool], timeout_s: float, what: str) -> DriveState:
        deadline = self._clock.deadline(timeout_s)
        while not reached(state := self.state()):
            if deadline.expired:
                raise MotionTimeoutError(f"{self._name}: not {what} within {timeout_s:g} s, it is {state.value}")
            self._clock.sleep_s(POLL_S)
        return state

    def why(self, state: DriveState, status: int) -> str:
        """Usual reasons for a drive to stay in this state, by its statusword; "" where none is known."""
        reasons = []
        if not status & Status.REMOTE:
            reasons.append("remote bit 9 is 0: the drive does not listen to the controlword (local control)")
        if not status & Status.VOLTAGE_ENABLED:
            reasons.append("voltage enabled bit 4 is 0: no mains, or safe torque off (STO) is active")
        if state is DriveState.SWITCH_ON_DISABLED and not reasons:
            reasons.append(
                "the shutdown command was taken but not obeyed: an enable input, STO or another master's RPDO"
            )
        if state is DriveState.SWITCHED_ON and not reasons:
            reasons.append(
                "power is on but operation is not: a brake or commutation that takes longer than the time-out"
            )
        if not reasons:
            return ""
        return f" (statusword {status:04X}h: {'; '.join(reasons)})"
