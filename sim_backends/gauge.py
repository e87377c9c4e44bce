"""Simulated displays and gauges: they measure the feed axis's true position and use their makers' protocols on a pseudo-terminal.

Kinds: "nd2xx" (a HEIDENHAIN display, answers Ctrl-B and ESC A0200), "mitutoyo" (a counter that sends by itself) and "ascii" (a number
with its unit, by itself). Lines are formatted here without the decoders' code, which they test. Faults are
those of `faults`: a lost beam is a scale that is not read (with the device's own message), a restart is a count that begins at 0.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import InputError
from sim_backends import GAUGE_KINDS
from sim_backends.faults import Fault, FaultKind, FaultSchedule
from sim_backends.plant.axis import FeedAxis
from sim_backends.terminal import DelayedLine, InstrumentTerminal

_NS = 1_000_000_000
_LISTEN_NS = 1_000_000  # longest time from a request to the stored value (HEIDENHAIN ND 261: Ctrl-B, at most 1 ms)
_UNREAD = {FaultKind.BEAM_LOST, FaultKind.HEAD_ERROR, FaultKind.OVERSPEED}


@dataclass(frozen=True)
class GaugeParameters:
    """kind: one of GAUGE_KINDS; rate_hz: lines per second of those that send by themselves; answer_s: a display's time to answer, s.

    pulse_hz: a display stores and sends a value at each pulse on its external input, and is not asked; None: it is asked;
    latency_s, jitter_s: delay from a sample to its line at the reader beyond that, and its largest variation;
    resolution_mm: one step of the count; direction: it rises (+1) or falls (−1) with the axis; zero_mm: position of the axis at which
    it is zero; noise_um: white; drift_um_per_h: of the mount. Raises InputError.
    """

    kind: str = "nd2xx"
    rate_hz: float = 10.0
    pulse_hz: float | None = None
    answer_s: float = 0.02
    resolution_mm: float = 0.0001
    direction: int = 1
    zero_mm: float = 0.0
    noise_um: float = 0.05
    drift_um_per_h: float = 0.0
    latency_s: float = 0.0
    jitter_s: float = 0.0
    seed: int = 12

    def __post_init__(self) -> None:
        if self.kind not in GAUGE_KINDS:
            raise InputError(f"gauge kind {self.kind!r}, expected one of {', '.join(GAUGE_KINDS)}")


class SimulatedGauge:
    """The instrument on its pseudo-terminal; attach `advance`, `bearable` and `settle` to the clock after what moves the axis.

    pulse: its trigger output, called at the exact time of each sample.
    """

    pulse: Callable[[], None] | None = None

    def __init__(
        self,
        axis: FeedAxis,
        parameters: GaugeParameters | None = None,
        faults: tuple[Fault, ...] = (),
        *,
        start_ns: int = 0,
        wait_for_arrival: bool = True,
    ) -> None:
        self.parameters = parameters or GaugeParameters()
        self._axis = axis
        self._faults = FaultSchedule(faults)
        self._rng = random.Random(self.parameters.seed)
        self._wire = InstrumentTerminal(wait_for_arrival=wait_for_arrival)
        self.path = self._wire.path
        self.counters = self._wire.counters
        self._offset_mm = 0.0  # lost by a restart
        self._asked = b""
        p = self.parameters
        self._period_ns = round(_NS / (p.pulse_hz or p.rate_hz))
        answer_s = p.answer_s if p.kind == "nd2xx" else 0.0
        self._line = DelayedLine(self._wire, answer_s + p.latency_s, p.jitter_s, p.seed + 1)
        self._next_ns = start_ns + (_LISTEN_NS if self._is_asked else self._period_ns)

    @property
    def _is_asked(self) -> bool:
        return self.parameters.kind == "nd2xx" and self.parameters.pulse_hz is None

    def close(self) -> None:
        """Close the terminal; readers then see the port vanish."""
        self._wire.close()

    @property
    def is_open(self) -> bool:
        return self._wire.is_open

    def bearable(self, now_ns: int) -> int:
        """For SimClock: ns until the next line is due, or requests are read."""
        return min(self._next_ns, self._line.next_ns) - now_ns if self._wire.is_open else _NS

    def settle(self) -> None:
        """Send what is due; return once it is at the reader's end."""
        self._wire.settle()

    def advance(self, now_ns: int, dt_s: float) -> None:
        """Take the samples that are due, or those that were requested."""
        if not self._wire.is_open:
            return
        while self._next_ns <= now_ns:
            if self._is_asked:
                self._listen(self._next_ns)
                self._next_ns += _LISTEN_NS
            else:
                self._sample(self._next_ns)
                self._next_ns += self._period_ns
        self._line.release(now_ns)

    # -- a display that answers requests ----------------------------------------------------------------------------------
    def _listen(self, time_ns: int) -> None:
        self._asked += self._wire.heard()
        while self._asked:
            if self._asked.startswith(b"\x02"):
                self._asked = self._asked[1:]
                self._answer(time_ns, b"\x02")
            elif self._asked.startswith(b"\x1b"):
                command, end, rest = self._asked.partition(b"\r")
                if not end:
                    break
                self._asked = rest
                self._answer(time_ns, command)
            else:
                self._asked = self._asked[1:]

    def _answer(self, time_ns: int, request: bytes) -> None:
        if request in (b"\x02", b"\x1bA0200"):
            self._sample(time_ns, count=request != b"\x02")
        else:
            self._line.put(b"\x15", time_ns)

    # -- lines ------------------------------------------------------------------------------------------------------------
    def _sample(self, time_ns: int, *, count: bool = False) -> None:
        time_s = time_ns / _NS
        if self.pulse is not None:
            self.pulse()
        p = self.parameters
        self.counters.samples += 1
        faults = {fault.kind: fault.size for fault in self._faults.active(time_s)}
        shift_um = faults.get(FaultKind.GLITCH, 0.0) + p.drift_um_per_h * time_s / 3600.0
        shift_um += self._rng.gauss(0.0, p.noise_um)
        value_mm = p.direction * (self._axis.position_mm - p.zero_mm + shift_um / 1000.0)
        if FaultKind.RESTART in faults:
            self._offset_mm = value_mm
        steps = None if _UNREAD & faults.keys() else round((value_mm - self._offset_mm) / p.resolution_mm)
        line = self._count_line(steps) if count else self._text(steps)
        if FaultKind.HALF_LINE in faults:
            line = line[: len(line) * 2 // 3]
        line += self._line_end(other=FaultKind.LINE_ENDS in faults)
        if FaultKind.GARBAGE in faults:
            line += self._rng.randbytes(int(faults[FaultKind.GARBAGE]) or 8)
        if FaultKind.SILENCE not in faults:
            self._line.put(line, time_ns)

    def _count_line(self, steps: int | None) -> bytes:
        return b"\x02ENCODER ERR. " if steps is None else b"\x02%+010d" % steps

    def _text(self, steps: int | None) -> bytes:
        """The displayed text; None: the scale cannot be read."""
        kind, step_mm = self.parameters.kind, self.parameters.resolution_mm
        decimals = len(f"{step_mm:.9f}".rstrip("0").partition(".")[2])
        sign = b"-" if steps is not None and steps < 0 else b"+"
        digits = b"%.*f" % (decimals, abs(steps or 0) * step_mm)
        if kind == "nd2xx":
            return sign + digits.rjust(10) + (b" ?  " if steps is None else b"    ")
        if steps is None:
            return b"ERROR"
        return b"01A" + sign + digits.rjust(8, b"0") if kind == "mitutoyo" else sign + digits + b" mm"

    def _line_end(self, *, other: bool) -> bytes:
        if other:
            return (b"\n", b"\r", b"\r\n")[self.counters.samples % 3]
        return b"\r" if self.parameters.kind == "mitutoyo" else b"\r\n"
