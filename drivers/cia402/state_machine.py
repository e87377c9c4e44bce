"""The CiA 402 state machine (IEC 61800-7-201) as data, without I/O, for drive and master alike.

Bit patterns, transitions and pure functions over them, in the form that both the drive (which obeys a controlword) and the master
(which chooses one) can use. Because both sides of the tests use this file, it is checked against literal vectors written from the
standard (tests/wire), never against itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntFlag

from drivers.drive import DriveState

START = DriveState.UNKNOWN  # the state machine's "start": no statusword received yet


class Status(IntFlag):
    """Statusword 6041h, bits that mean the same in every mode."""

    READY_TO_SWITCH_ON = 0x0001
    SWITCHED_ON = 0x0002
    OPERATION_ENABLED = 0x0004
    FAULT = 0x0008
    VOLTAGE_ENABLED = 0x0010
    QUICK_STOP_INACTIVE = 0x0020  # 0 while a quick stop is asked for
    SWITCH_ON_DISABLED = 0x0040
    WARNING = 0x0080
    REMOTE = 0x0200  # 0: the drive ignores the controlword
    TARGET_REACHED = 0x0400
    INTERNAL_LIMIT = 0x0800
    # by mode of operation
    SETPOINT_ACKNOWLEDGE = 0x1000  # profile position
    FOLLOWING_ERROR = 0x2000  # profile position, cyclic position
    SPEED_ZERO = 0x1000  # profile velocity
    HOMING_ATTAINED = 0x1000  # homing
    HOMING_ERROR = 0x2000  # homing
    FOLLOWS_COMMAND = 0x1000  # cyclic modes: 0 while the drive ignores the set-points


class Control(IntFlag):
    """Controlword 6040h."""

    SWITCH_ON = 0x0001
    ENABLE_VOLTAGE = 0x0002
    QUICK_STOP_INACTIVE = 0x0004  # 0 asks for a quick stop
    ENABLE_OPERATION = 0x0008
    NEW_SETPOINT = 0x0010  # profile position, on its rising edge
    CHANGE_IMMEDIATELY = 0x0020  # profile position
    RELATIVE = 0x0040  # profile position
    HOMING_START = 0x0010  # homing, while 1
    INTERPOLATE = 0x0010  # interpolated position, while 1
    FAULT_RESET = 0x0080  # on its rising edge
    HALT = 0x0100


@dataclass(frozen=True)
class Pattern:
    """Bits that must match: `word & mask == value`."""

    mask: int
    value: int

    def matches(self, word: int) -> bool:
        """Whether a word has these bits."""
        return word & self.mask == self.value


STATE_PATTERNS: tuple[tuple[DriveState, Pattern], ...] = (
    (DriveState.NOT_READY, Pattern(0x4F, 0x00)),
    (DriveState.SWITCH_ON_DISABLED, Pattern(0x4F, 0x40)),
    (DriveState.READY, Pattern(0x6F, 0x21)),
    (DriveState.SWITCHED_ON, Pattern(0x6F, 0x23)),
    (DriveState.ENABLED, Pattern(0x6F, 0x27)),
    (DriveState.QUICK_STOP, Pattern(0x6F, 0x07)),
    (DriveState.FAULT_REACTION, Pattern(0x4F, 0x0F)),
    (DriveState.FAULT, Pattern(0x4F, 0x08)),
)


def _match_state(low_bits: int) -> DriveState:
    for state, pattern in STATE_PATTERNS:
        if pattern.matches(low_bits):
            return state
    return DriveState.UNKNOWN


_STATES = tuple(_match_state(low_bits) for low_bits in range(0x80))  # the patterns look at bits 0 to 6 only


def decode_state(statusword: int) -> DriveState:
    """The state that a statusword shows; UNKNOWN for a pattern that is not in the standard."""
    return _STATES[statusword & 0x7F]


def state_bits(state: DriveState) -> int:
    """The statusword bits 0-3, 5 and 6 of a state; bits outside its pattern are 0."""
    for known, pattern in STATE_PATTERNS:
        if known is state:
            return pattern.value
    return 0


class Command(Enum):
    """Device control commands: the controlword bits 0-3 and 7 that mean them, and the word a master sends."""

    SHUTDOWN = (Pattern(0x87, 0x06), 0x06)
    SWITCH_ON = (Pattern(0x8F, 0x07), 0x07)  # the same word is "disable operation" when enabled
    ENABLE_OPERATION = (Pattern(0x8F, 0x0F), 0x0F)
    DISABLE_VOLTAGE = (Pattern(0x82, 0x00), 0x00)
    QUICK_STOP = (Pattern(0x86, 0x02), 0x02)

    def __init__(self, pattern: Pattern, word: int) -> None:
        self.pattern = pattern
        self.word = word


def decode_command(controlword: int) -> Command | None:
    """The command in a controlword; None while bit 7 is set, which commands only a fault reset on its rising edge."""
    for command in Command:
        if command.pattern.matches(controlword):
            return command
    return None


def is_fault_reset(previous_controlword: int, controlword: int) -> bool:
    """Whether this change resets a fault: the rising edge of bit 7; a bit that stays set resets nothing more."""
    return bool(controlword & ~previous_controlword & Control.FAULT_RESET)


class TransitionCause(Enum):
    """Causes of a transition other than a command."""

    AUTOMATIC = "as soon as the state's work is done"
    FAULT = "a fault occurred"
    FAULT_RESET = "the rising edge of controlword bit 7"


@dataclass(frozen=True)
class Transition:
    """One numbered transition of the standard's state diagram."""

    number: int
    source: DriveState
    target: DriveState
    causes: tuple[Command | TransitionCause, ...]


TRANSITIONS: tuple[Transition, ...] = (
    Transition(0, START, DriveState.NOT_READY, (TransitionCause.AUTOMATIC,)),
    Transition(1, DriveState.NOT_READY, DriveState.SWITCH_ON_DISABLED, (TransitionCause.AUTOMATIC,)),
    Transition(2, DriveState.SWITCH_ON_DISABLED, DriveState.READY, (Command.SHUTDOWN,)),
    Transition(3, DriveState.READY, DriveState.SWITCHED_ON, (Command.SWITCH_ON, Command.ENABLE_OPERATION)),
    Transition(4, DriveState.SWITCHED_ON, DriveState.ENABLED, (Command.ENABLE_OPERATION,)),
    Transition(5, DriveState.ENABLED, DriveState.SWITCHED_ON, (Command.SWITCH_ON,)),
    Transition(6, DriveState.SWITCHED_ON, DriveState.READY, (Command.SHUTDOWN,)),
    Transition(7, DriveState.READY, DriveState.SWITCH_ON_DISABLED, (Command.DISABLE_VOLTAGE, Command.QUICK_STOP)),
    Transition(8, DriveState.ENABLED, DriveState.READY, (Command.SHUTDOWN,)),
    Transition(9, DriveState.ENABLED, DriveState.SWITCH_ON_DISABLED, (Command.DISABLE_VOLTAGE,)),
    Transition(
        10, DriveState.SWITCHED_ON, DriveState.SWITCH_ON_DISABLED, (Command.DISABLE_VOLTAGE, Command.QUICK_STOP)
    ),
    Transition(11, DriveState.ENABLED, DriveState.QUICK_STOP, (Command.QUICK_STOP,)),
    Transition(
        12, DriveState.QUICK_STOP, DriveState.SWITCH_ON_DISABLED, (Command.DISABLE_VOLTAGE, TransitionCause.AUTOMATIC)
    ),
    Transition(14, DriveState.FAULT_REACTION, DriveState.FAULT, (TransitionCause.AUTOMATIC,)),
    Transition(15, DriveState.FAULT, DriveState.SWITCH_ON_DISABLED, (TransitionCause.FAULT_RESET,)),
    Transition(16, DriveState.QUICK_STOP, DriveState.ENABLED, (Command.ENABLE_OPERATION,)),
)
FAULT_TRANSITION = 13  # from every state that is not already in the fault branch


def next_state(state: DriveState, cause: Command | TransitionCause) -> tuple[int, DriveState] | None:
    """(transition number, target state) of a cause in a state; None where the standard has no such transition.

    605Ah decides whether AUTOMATIC holds in quick stop (transition 12) and whether 16 is allowed, see `QUICK_STOP_ENDINGS`.
    """
    if cause is TransitionCause.FAULT:
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
            return None
        return FAULT_TRANSITION, DriveState.FAULT_REACTION
    for transition in TRANSITIONS:
        if transition.source is state and cause in transition.causes:
            return transition.number, transition.target
    return None


class Ramp(Enum):
    """How an axis is brought to rest (option codes 605Ah to 605Eh)."""

    NONE = "power off, the axis coasts"
    SLOW_DOWN = "slow-down ramp 6084h"
    QUICK_STOP = "quick stop ramp 6085h"
    CURRENT_LIMIT = "on the current limit"
    VOLTAGE_LIMIT = "on the voltage limit"


@dataclass(frozen=True)
class QuickStopEnding:
    """605Ah: the ramp, and whether the drive stays in quick stop active (holding, 16 open) after it."""

    ramp: Ramp
    stays: bool


QUICK_STOP_ENDINGS: dict[int, QuickStopEnding] = {
    0: QuickStopEnding(Ramp.NONE, stays=False),
    1: QuickStopEnding(Ramp.SLOW_DOWN, stays=False),
    2: QuickStopEnding(Ramp.QUICK_STOP, stays=False),
    3: QuickStopEnding(Ramp.CURRENT_LIMIT, stays=False),
    4: QuickStopEnding(Ramp.VOLTAGE_LIMIT, stays=False),
    5: QuickStopEnding(Ramp.SLOW_DOWN, stays=True),
    6: QuickStopEnding(Ramp.QUICK_STOP, stays=True),
    7: QuickStopEnding(Ramp.CURRENT_LIMIT, stays=True),
    8: QuickStopEnding(Ramp.VOLTAGE_LIMIT, stays=True),
}

ENABLE_STEPS: dict[DriveState, Command] = {
    DriveState.SWITCH_ON_DISABLED: Command.SHUTDOWN,
    DriveState.READY: Command.SWITCH_ON,
    DriveState.SWITCHED_ON: Command.ENABLE_OPERATION,
}
"""The command that leads one state nearer to ENABLED; a state that is absent is waited for or left by an explicit decision."""

DISABLE_STEPS: dict[DriveState, Command] = {
    DriveState.ENABLED: Command.SWITCH_ON,  # transition 5, disable operation
    DriveState.SWITCHED_ON: Command.SHUTDOWN,
    DriveState.READY: Command.DISABLE_VOLTAGE,
    DriveState.QUICK_STOP: Command.DISABLE_VOLTAGE,
}
"""The command that leads one state nearer to SWITCH_ON_DISABLED."""
