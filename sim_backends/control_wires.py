"""A numerical control beside the drives: it gives auxiliary codes on wires and waits for MFIN, as a part program does.

Knows no bus and no drive: `Wires` are levels at the terminals of a drive or of an I/O module, which the faces show. The way a control
gives a code is that of the machine builders' manuals: code, strobe some ms later, wait for MFIN, strobe off, wait for MFIN to go.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

_MS = 1_000_000
STROBE_DELAY_NS = 16 * _MS  # code before strobe, and MFIN before the strobe's end
PAUSE_NS = 300 * _MS  # between two codes
RELEASE_LIMIT_NS = 10_000 * _MS  # MFIN has to be gone by then
STEP_NS = 4 * _MS
IDLE_STEP_NS = 60_000_000_000


@dataclass
class Wires:
    """Levels at the terminals, one bit each: inputs as the control drives them, outputs as the drive does."""

    inputs: int = 0
    outputs: int = 0


class ControlFault(Enum):
    """What the control, or a wire to it, does wrong."""

    STROBE_LOST = "the strobe goes off while the code is handled"
    CODE_CHANGED = "another code is given while one is handled"
    STROBE_STUCK = "the strobe stays on after MFIN"
    ALIVE_LOST = "every wire is off while the code is handled"
    ALIVE_LOST_WAITING = "every wire is off before the first code"
    BOUNCE = "the strobe is on for some ms before the code"


BREAKING = (ControlFault.STROBE_LOST, ControlFault.CODE_CHANGED, ControlFault.ALIVE_LOST)
"""Faults while a code is handled, after which the control gives no other."""


@dataclass
class SimulatedControl:
    """Gives the codes of `program` one after the other. lines: line[k] of the code `first` + k alone, without binary coding.

    finished: codes for which MFIN came and went; alarm: why the program stopped, "" if it did not.
    """

    wires: Wires
    program: Sequence[int]
    strobe_bit: int | None
    code_bits: Sequence[int]
    mfin_bit: int
    alive_bit: int | None = None
    first: int = 90
    coding: str = "binary"
    fault: ControlFault | None = None
    fault_after_ns: int = 100 * _MS
    finished: list[int] = field(default_factory=list)
    alarm: str = ""
    _phase: str = "pause"
    _since_ns: int = 0

    def tick(self, now_ns: int, _dt_s: float = 0.0) -> None:
        """Time has advanced to now_ns."""
        waited_ns = now_ns - self._since_ns
        alive = 0 if self.alive_bit is None else 1 << self.alive_bit
        if self.alarm or len(self.finished) == len(self.program):
            self.wires.inputs = self.wires.inputs if self.alarm else alive
            return
        code = self._pattern(self.program[len(self.finished)])
        strobe = 0 if self.strobe_bit is None else 1 << self.strobe_bit
        mfin = bool(self.wires.outputs >> self.mfin_bit & 1)
        if self._phase == "pause":
            self.wires.inputs = self._idle(alive, strobe, waited_ns)
            if waited_ns >= PAUSE_NS:
                self._go("code", now_ns)
        elif self._phase == "code":
            self.wires.inputs = alive | (0 if self.strobe_bit is None else code)
            if waited_ns >= STROBE_DELAY_NS:
                self._go("strobe", now_ns)
        elif self._phase == "strobe":
            self.wires.inputs = alive | code | strobe
            if self.fault in BREAKING and waited_ns >= self.fault_after_ns:
                self._disturb(alive, strobe, code)
                self.alarm = str(self.fault)
            elif mfin:
                self._go("mfin", now_ns)
        elif self._phase == "mfin":
            if waited_ns >= STROBE_DELAY_NS and self.fault is not ControlFault.STROBE_STUCK:
                self.wires.inputs = alive
                self._go("release", now_ns)
        elif not mfin:
            self.finished.append(self.program[len(self.finished)])
            self._go("pause", now_ns)
        elif waited_ns > RELEASE_LIMIT_NS:
            self.alarm = "MFIN does not go off"

    def bearable(self, _now_ns: int) -> int:
        """Longest time until the next tick, ns."""
        return IDLE_STEP_NS if self.alarm or len(self.finished) == len(self.program) else STEP_NS

    def _idle(self, alive: int, strobe: int, waited_ns: int) -> int:
        """Levels without a code."""
        if self.fault is ControlFault.ALIVE_LOST_WAITING:
            return 0
        bounces = self.fault is ControlFault.BOUNCE and 100 * _MS <= waited_ns < 118 * _MS
        return alive | strobe if bounces else alive

    def _go(self, phase: str, now_ns: int) -> None:
        self._phase, self._since_ns = phase, now_ns

    def _disturb(self, alive: int, strobe: int, code: int) -> None:
        if self.fault is ControlFault.STROBE_LOST:
            self.wires.inputs = alive | code if strobe else alive
        elif self.fault is ControlFault.CODE_CHANGED:
            other = next(self._pattern(one) for one in range(self.first, self.first + 4) if self._pattern(one) != code)
            self.wires.inputs = alive | other | strobe
        else:
            self.wires.inputs = 0

    def _pattern(self, code: int) -> int:
        """Levels of the code's wires."""
        number = code - self.first
        if self.coding == "lines":
            return 1 << self.code_bits[number] if 0 <= number < len(self.code_bits) else 0
        if self.coding == "bcd":
            number = sum(int(digit) << 4 * place for place, digit in enumerate(reversed(str(number))))
        return sum((number >> place & 1) << bit for place, bit in enumerate(self.code_bits))
