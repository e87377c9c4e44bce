"""The hand-shake of a control's M codes: which number the wires show, and when MFIN goes on and off. No I/O.

    code and strobe on → the code is handled → MFIN on → strobe off → MFIN off

Source: JPH08348B2, embodiment: the control gives M90 to M93, waits, and goes on at MFIN (steps S57 and S73). What ends a
wait, and what is done about a second code or a lost wire, is not in the document.
"""

from __future__ import annotations

from enum import Enum

from drivers.errors import SafetyError
from hil.probe.machine_file import CodesConfig


class CodeError(SafetyError):
    """The control's wires contradict the hand-shake; nothing moves, and MFIN is off."""


class HandshakePhase(Enum):
    """Where the hand-shake is."""

    UNPROVEN = "the strobe has not been seen off yet"
    WAITING = "no strobe"
    SETTLING = "a strobe, whose code has to stay the same for settle_s"
    FOREIGN = "the strobe of a code that is not of the probe"
    WORKING = "the code is being handled"
    DONE = "MFIN is on, the strobe has to go"


def number_shown(config: CodesConfig, inputs: int) -> int | None:
    """The number that the inputs show; None without strobe. Raises CodeError for a dead cable, two lines, or no digit."""
    if config.alive_bit is not None and not inputs >> config.alive_bit & 1:
        raise CodeError(
            f"input {config.alive_bit}, by which the control shows that it is there, is off: control off or cable broken?"
        )
    levels = [inputs >> bit & 1 for bit in config.code_bits]
    if config.coding == "lines":
        if sum(levels) > 1:
            on = [bit for bit, level in zip(config.code_bits, levels, strict=True) if level]
            raise CodeError(f"inputs {on} are on at once, expected the line of one code")
        strobe = any(levels) if config.strobe_bit is None else inputs >> config.strobe_bit & 1
        return config.first + levels.index(1) if strobe and any(levels) else None
    if config.strobe_bit is None or not inputs >> config.strobe_bit & 1:
        return None
    number = sum(level << place for place, level in enumerate(levels))
    if config.coding == "bcd":
        digits = f"{number:x}"
        if not digits.isdecimal():
            raise CodeError(f"the code's inputs show {number:X}h, which is no number in BCD")
        number = int(digits)
    return config.first + number


class HandShake:
    """One control's hand-shake. `saw` takes each reading of the wires; `mfin` is the level that the acknowledge has to have.

    After a CodeError it is over: MFIN is off and stays so.
    """

    def __init__(self, config: CodesConfig, now_s: float) -> None:
        self._config = config
        self.phase = HandshakePhase.UNPROVEN
        self.number: int | None = None
        self._since_s = now_s

    @property
    def mfin(self) -> bool:
        return self.phase is HandshakePhase.DONE

    def saw(self, inputs: int, now_s: float) -> int | None:
        """Takes a reading; returns the number of a code that is to be handled now. Raises CodeError."""
        try:
            number = number_shown(self._config, inputs)
            return self._step(number, now_s)
        except CodeError:
            self._enter(HandshakePhase.UNPROVEN, now_s)
            raise

    def done(self, now_s: float) -> None:
        """The code was handled."""
        self._enter(HandshakePhase.DONE, now_s)

    def _enter(self, phase: HandshakePhase, now_s: float) -> None:
        self.phase, self._since_s = phase, now_s

    def _step(self, number: int | None, now_s: float) -> int | None:
        config, waited_s = self._config, now_s - self._since_s
        if self.phase in (HandshakePhase.WORKING, HandshakePhase.DONE):
            self._hold(number, waited_s, now_s)
        elif number is None:
            self._enter(HandshakePhase.WAITING, now_s)
        elif self.phase is HandshakePhase.UNPROVEN:
            if waited_s > config.release_s:
                raise CodeError(
                    f"the strobe of M{number} has been on for {config.release_s:g} s since the start: a code that was given"
                    " before, or a wire that is stuck? Expected it off once; nothing was moved"
                )
        elif self.phase is HandshakePhase.WAITING or (self.phase is HandshakePhase.SETTLING and number != self.number):
            self.number = number
            self._enter(HandshakePhase.SETTLING, now_s)
        elif self.phase is HandshakePhase.SETTLING and waited_s >= config.settle_s:
            if number in config.numbers:
                self._enter(HandshakePhase.WORKING, now_s)
                return number
            self._enter(HandshakePhase.FOREIGN, now_s)
        return None

    def _hold(self, number: int | None, waited_s: float, now_s: float) -> None:
        """While a code is handled, and until its strobe is gone, it is the only one."""
        config, working = self._config, self.phase is HandshakePhase.WORKING
        if number is None and not working:
            self._enter(HandshakePhase.WAITING, now_s)
        elif number is None:
            raise CodeError(
                f"the strobe of M{self.number} went off before MFIN: wire broken, or control reset? The axes were stopped"
            )
        elif number != self.number:
            when = "while" if working else "with the strobe still on after"
            raise CodeError(f"M{number} came {when} M{self.number} was handled; MFIN is not given for either")
        elif waited_s > (config.work_s if working else config.release_s):
            raise CodeError(
                f"M{number} was not handled within {config.work_s:g} s; the axes were stopped"
                if working
                else f"the strobe of M{number} is still on {config.release_s:g} s after MFIN; MFIN was taken back"
            )
