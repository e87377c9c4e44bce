"""The CiA-402 state tables against literal patterns of IEC 61800-7-201 (statusword: table 30, controlword: table 28, figure 9).

Master and simulated drive share these tables, so nothing here may be computed from them.
"""

import pytest

from drivers.cia402 import state_machine
from drivers.cia402.modes import HomingStatus, Mode, decode_homing
from drivers.cia402.state_machine import Command, TransitionCause, decode_command, decode_state
from drivers.drive import DriveState as S


# x bits of the standard's patterns are tried both as 0 and as 1
def _words(pattern: str) -> list[int]:
    digits = pattern.replace(" ", "")
    assert len(digits) == 16
    words = [0]
    for digit in digits:
        options = (0, 1) if digit == "x" else (int(digit),)
        words = [word << 1 | option for word in words for option in options]
    return words


@pytest.mark.parametrize(
    ("pattern", "state"),
    [
        ("xxxx xxxx x0xx 0000", S.NOT_READY),
        ("xxxx xxxx x1xx 0000", S.SWITCH_ON_DISABLED),
        ("xxxx xxxx x01x 0001", S.READY),
        ("xxxx xxxx x01x 0011", S.SWITCHED_ON),
        ("xxxx xxxx x01x 0111", S.ENABLED),
        ("xxxx xxxx x00x 0111", S.QUICK_STOP),
        ("xxxx xxxx x0xx 1111", S.FAULT_REACTION),
        ("xxxx xxxx x0xx 1000", S.FAULT),
    ],
)
def test_statusword_patterns(pattern: str, state: S) -> None:
    assert {decode_state(word) for word in _words(pattern)} == {state}


@pytest.mark.parametrize("word", [0x0004, 0x000C, 0x0041, 0x0002, 0x0067, 0x0009])
def test_patterns_that_the_standard_does_not_have_are_unknown(word: int) -> None:
    assert decode_state(word) is S.UNKNOWN


@pytest.mark.parametrize(
    ("pattern", "command"),
    [
        ("xxxx xxxx 0xxx x110", Command.SHUTDOWN),
        ("xxxx xxxx 0xxx 0111", Command.SWITCH_ON),
        ("xxxx xxxx 0xxx xx0x", Command.DISABLE_VOLTAGE),
        ("xxxx xxxx 0xxx x01x", Command.QUICK_STOP),
        ("xxxx xxxx 0xxx 1111", Command.ENABLE_OPERATION),
    ],
)
def test_controlword_patterns(pattern: str, command: Command) -> None:
    assert {decode_command(word) for word in _words(pattern)} == {command}


def test_words_with_the_reset_bit_command_nothing_else() -> None:
    assert {decode_command(word) for word in _words("xxxx xxxx 1xxx xxxx")} == {None}


@pytest.mark.parametrize(
    ("command", "word"),
    [
        (Command.SHUTDOWN, 0x06),
        (Command.SWITCH_ON, 0x07),
        (Command.ENABLE_OPERATION, 0x0F),
        (Command.DISABLE_VOLTAGE, 0x00),
        (Command.QUICK_STOP, 0x02),
    ],
)
def test_the_words_a_master_sends(command: Command, word: int) -> None:
    assert command.word == word


def test_only_the_rising_edge_resets_a_fault() -> None:
    assert state_machine.is_fault_reset(0x0000, 0x0080)
    assert state_machine.is_fault_reset(0x000F, 0x008F)
    assert not state_machine.is_fault_reset(0x0080, 0x0080)
    assert not state_machine.is_fault_reset(0x0080, 0x0000)
    assert not state_machine.is_fault_reset(0x0000, 0x000F)


# number, from, cause, to: figure 9, written out
ARROWS = [
    (0, S.UNKNOWN, TransitionCause.AUTOMATIC, S.NOT_READY),
    (1, S.NOT_READY, TransitionCause.AUTOMATIC, S.SWITCH_ON_DISABLED),
    (2, S.SWITCH_ON_DISABLED, Command.SHUTDOWN, S.READY),
    (3, S.READY, Command.SWITCH_ON, S.SWITCHED_ON),
    (4, S.SWITCHED_ON, Command.ENABLE_OPERATION, S.ENABLED),
    (5, S.ENABLED, Command.SWITCH_ON, S.SWITCHED_ON),
    (6, S.SWITCHED_ON, Command.SHUTDOWN, S.READY),
    (7, S.READY, Command.DISABLE_VOLTAGE, S.SWITCH_ON_DISABLED),
    (7, S.READY, Command.QUICK_STOP, S.SWITCH_ON_DISABLED),
    (8, S.ENABLED, Command.SHUTDOWN, S.READY),
    (9, S.ENABLED, Command.DISABLE_VOLTAGE, S.SWITCH_ON_DISABLED),
    (10, S.SWITCHED_ON, Command.DISABLE_VOLTAGE, S.SWITCH_ON_DISABLED),
    (10, S.SWITCHED_ON, Command.QUICK_STOP, S.SWITCH_ON_DISABLED),
    (11, S.ENABLED, Command.QUICK_STOP, S.QUICK_STOP),
    (12, S.QUICK_STOP, TransitionCause.AUTOMATIC, S.SWITCH_ON_DISABLED),
    (12, S.QUICK_STOP, Command.DISABLE_VOLTAGE, S.SWITCH_ON_DISABLED),
    (13, S.NOT_READY, TransitionCause.FAULT, S.FAULT_REACTION),
    (13, S.SWITCH_ON_DISABLED, TransitionCause.FAULT, S.FAULT_REACTION),
    (13, S.READY, TransitionCause.FAULT, S.FAULT_REACTION),
    (13, S.SWITCHED_ON, TransitionCause.FAULT, S.FAULT_REACTION),
    (13, S.ENABLED, TransitionCause.FAULT, S.FAULT_REACTION),
    (13, S.QUICK_STOP, TransitionCause.FAULT, S.FAULT_REACTION),
    (14, S.FAULT_REACTION, TransitionCause.AUTOMATIC, S.FAULT),
    (15, S.FAULT, TransitionCause.FAULT_RESET, S.SWITCH_ON_DISABLED),
    (16, S.QUICK_STOP, Command.ENABLE_OPERATION, S.ENABLED),
]


@pytest.mark.parametrize(("number", "source", "cause", "target"), ARROWS)
def test_each_arrow_of_the_figure(number: int, source: S, cause: Command | TransitionCause, target: S) -> None:
    assert state_machine.next_state(source, cause) == (number, target)


def test_no_arrow_but_those_of_the_figure() -> None:
    drawn = {(source, cause) for _, source, cause, _ in ARROWS}
    # "enable operation" in one word from ready to switch on: 3, which 4 then follows (note to the figure)
    drawn.add((S.READY, Command.ENABLE_OPERATION))
    drawn.add((S.UNKNOWN, TransitionCause.FAULT))  # 13 leaves from anywhere
    for state in S:
        for cause in (*Command, *TransitionCause):
            if (state, cause) not in drawn:
                assert state_machine.next_state(state, cause) is None, (state, cause)


def test_bits_of_the_statusword() -> None:
    """IEC 61800-7-201, table 29, and the modes' own bits 10, 12 and 13."""
    assert {name: int(bit) for name, bit in state_machine.Status.__members__.items()} == {
        "READY_TO_SWITCH_ON": 1 << 0,
        "SWITCHED_ON": 1 << 1,
        "OPERATION_ENABLED": 1 << 2,
        "FAULT": 1 << 3,
        "VOLTAGE_ENABLED": 1 << 4,
        "QUICK_STOP_INACTIVE": 1 << 5,
        "SWITCH_ON_DISABLED": 1 << 6,
        "WARNING": 1 << 7,
        "REMOTE": 1 << 9,
        "TARGET_REACHED": 1 << 10,
        "INTERNAL_LIMIT": 1 << 11,
        "SETPOINT_ACKNOWLEDGE": 1 << 12,
        "SPEED_ZERO": 1 << 12,
        "HOMING_ATTAINED": 1 << 12,
        "FOLLOWS_COMMAND": 1 << 12,
        "FOLLOWING_ERROR": 1 << 13,
        "HOMING_ERROR": 1 << 13,
    }


def test_bits_of_the_controlword() -> None:
    """IEC 61800-7-201, table 27, and the bits 4 to 6 of profile position, homing and interpolated position."""
    assert {name: int(bit) for name, bit in state_machine.Control.__members__.items()} == {
        "SWITCH_ON": 1 << 0,
        "ENABLE_VOLTAGE": 1 << 1,
        "QUICK_STOP_INACTIVE": 1 << 2,
        "ENABLE_OPERATION": 1 << 3,
        "NEW_SETPOINT": 1 << 4,
        "HOMING_START": 1 << 4,
        "INTERPOLATE": 1 << 4,
        "CHANGE_IMMEDIATELY": 1 << 5,
        "RELATIVE": 1 << 6,
        "FAULT_RESET": 1 << 7,
        "HALT": 1 << 8,
    }


def test_numbers_of_the_modes() -> None:
    assert {mode.name: int(mode) for mode in Mode} == {
        "NONE": 0,
        "PROFILE_POSITION": 1,
        "PROFILE_VELOCITY": 3,
        "HOMING": 6,
        "INTERPOLATED_POSITION": 7,
        "CYCLIC_POSITION": 8,
        "CYCLIC_VELOCITY": 9,
        "CYCLIC_TORQUE": 10,
    }


@pytest.mark.parametrize(
    ("state", "bits"),
    [
        (S.UNKNOWN, 0x00),
        (S.NOT_READY, 0x00),
        (S.SWITCH_ON_DISABLED, 0x40),
        (S.READY, 0x21),
        (S.SWITCHED_ON, 0x23),
        (S.ENABLED, 0x27),
        (S.QUICK_STOP, 0x07),
        (S.FAULT_REACTION, 0x0F),
        (S.FAULT, 0x08),
    ],
)
def test_bits_that_a_drive_in_a_state_shows(state: S, bits: int) -> None:
    assert state_machine.state_bits(state) == bits


def test_the_way_up_and_the_way_down() -> None:
    """A master's words on the way to operation enabled, 06 07 0F, and back, 07 06 00; out of a fault none leads by itself."""
    assert {state: step.word for state, step in state_machine.ENABLE_STEPS.items()} == {
        S.SWITCH_ON_DISABLED: 0x06,
        S.READY: 0x07,
        S.SWITCHED_ON: 0x0F,
    }
    assert {state: step.word for state, step in state_machine.DISABLE_STEPS.items()} == {
        S.ENABLED: 0x07,
        S.SWITCHED_ON: 0x06,
        S.READY: 0x00,
        S.QUICK_STOP: 0x00,
    }


def test_which_homing_has_failed() -> None:
    assert [status.name for status in HomingStatus if status.failed] == ["ERROR_MOVING", "ERROR_STANDSTILL"]


def test_supported_mode_bits() -> None:
    """6502h: pp bit 0, pv bit 2, hm bit 5, ip bit 6, csp bit 7, csv bit 8, cst bit 9."""
    assert [mode.supported_bit for mode in Mode] == [0x0, 0x1, 0x4, 0x20, 0x40, 0x80, 0x100, 0x200]


@pytest.mark.parametrize(
    ("statusword", "homing"),
    [
        (0x0237, HomingStatus.IN_PROGRESS),
        (0x0637, HomingStatus.INTERRUPTED),
        (0x1237, HomingStatus.ATTAINED_NOT_REACHED),
        (0x1637, HomingStatus.COMPLETED),
        (0x2237, HomingStatus.ERROR_MOVING),
        (0x2637, HomingStatus.ERROR_STANDSTILL),
        (0x3237, None),
        (0x3637, None),
        # the internal limit, bit 11, and what is above bit 13 have no say
        (0x0A37, HomingStatus.IN_PROGRESS),
        (0x0E37, HomingStatus.INTERRUPTED),
        (0xDE37, HomingStatus.COMPLETED),
    ],
)
def test_homing_bits_13_12_10(statusword: int, homing: HomingStatus | None) -> None:
    assert decode_homing(statusword) is homing


def test_quick_stop_endings() -> None:
    """605Ah: 1 to 4 end in switch on disabled, 5 to 8 stay in quick stop active; 0 takes the power away at once."""
    assert [code for code, ending in state_machine.QUICK_STOP_ENDINGS.items() if ending.stays] == [5, 6, 7, 8]
    assert [code for code, ending in state_machine.QUICK_STOP_ENDINGS.items() if not ending.stays] == [0, 1, 2, 3, 4]
    ramps = ["NONE", *["SLOW_DOWN", "QUICK_STOP", "CURRENT_LIMIT", "VOLTAGE_LIMIT"] * 2]
    assert [ending.ramp.name for ending in state_machine.QUICK_STOP_ENDINGS.values()] == ramps
