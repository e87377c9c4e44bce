"""Simulated displays and gauges: they measure the feed axis's true position and use their makers' protocols on a pseudo-terminal.

Kinds: "nd2xx" (a HEIDENHAIN display, answers Ctrl-B and ESC A0200), "mitutoyo" (a counter that sends by itself) and "ascii" (a number
with its unit, by itself). Lines are formatted here without the decoders' code, which they test. Faults are
those of `faults`: a lost beam is a scale that is not read (with the device's own message), a restart is a count that begins at 0.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

from drivers.errors import InputError
from sim_backends import GAUGE_KINDS
from sim_backends.faults import Fault, FaultKind
from sim_backends.plant.axis import FeedAxis
from sim_backends.terminal import TerminalInstrument

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


class SimulatedGauge(TerminalInstrument):
    """The instrument on its pseudo-terminal."""

    def __init__(
        self,
        axis: FeedAxis,
        parameters: GaugeParameters | None = None,
        faults: tuple[Fault, ...] = (),
        *,
        wait_for_arrival: bool = True,
    ) -> None:
        self.parameters = p = parameters or GaugeParameters()
        self._axis = axis
        self._rng = random.Random(p.seed)
        self._offset_mm = 0.0  # lost by a restart
        self._asked = b""
        self._period_ns = round(_NS / (p.pulse_hz or p.rate_hz))
        super().__init__(
            faults,
            first_ns=_LISTEN_NS if self._is_asked else self._period_ns,
            latency_s=p.latency_s + (p.answer_s if p.kind == "nd2xx" else 0.0),
            jitter_s=p.jitter_s,
            seed=p.seed + 1,
            wait_for_arrival=wait_for_arrival,
        )

    @property
    def _is_asked(self) -> bool:
        return self.parameters.kind == "nd2xx" and self.parameters.pulse_hz is None

    def _act(self, time_ns: int) -> int:
        if self._is_asked:
            self._listen(time_ns)
            return time_ns + _LISTEN_NS
        self._sample(time_ns)
        return time_ns + self._period_ns

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
        faults, p = self._begin_sample(time_ns), self.parameters
        shift_um = faults.get(FaultKind.GLITCH, 0.0) + p.drift_um_per_h * time_ns / _NS / 3600.0
        shift_um += self._rng.gauss(0.0, p.noise_um)
        value_mm = p.direction * (self._axis.position_mm - p.zero_mm + shift_um / 1000.0)
        if FaultKind.RESTART in faults:
            self._offset_mm = value_mm
        steps = None if _UNREAD & faults.keys() else round((value_mm - self._offset_mm) / p.resolution_mm)
        line = self._count_line(steps) if count else self._text(steps)
        self._send(line, b"\r" if p.kind == "mitutoyo" else b"\r\n", time_ns, faults, self._rng)

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
