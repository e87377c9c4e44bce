"""A simulated µMD interferometer: measures the feed axis's true position and sends lines over a pseudo-terminal.

Optics, air and set-up errors are in `interferometer`, the wire is `terminal`; the line is formatted here without the decoder's code,
which it tests. Lines that a full terminal loses leave a gap in the sequence.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

from sim_backends.faults import Fault, FaultKind, FaultSchedule
from sim_backends.interferometer import Interferometer, LaserParameters
from sim_backends.plant.axis import FeedAxis
from sim_backends.terminal import DelayedLine, InstrumentTerminal

__all__ = ["Interferometer", "LaserParameters", "SimulatedLaser"]

_NS = 1_000_000_000
_ERROR_WORD = {FaultKind.HEAD_ERROR: 0x400, FaultKind.BEAM_LOST: 0x800}


@dataclass
class _Line:
    """Faults in force for one line."""

    head: bool = False
    beam: bool = False
    overspeed: bool = False
    extra_um: float = 0.0
    silent: bool = False
    half: bool = False
    garbage: int = 0
    line_end: bytes = b"\r\n"


class SimulatedLaser:
    """The instrument on its pseudo-terminal. `path` is what a reader opens; `close` it at the end.

    pulse: its trigger output, called at the exact time of each sample.
    """

    pulse: Callable[[], None] | None = None

    def __init__(
        self,
        axis: FeedAxis,
        parameters: LaserParameters | None = None,
        faults: tuple[Fault, ...] = (),
        *,
        start_ns: int = 0,
        wait_for_arrival: bool = True,
    ) -> None:
        self.parameters = parameters or LaserParameters()
        self.interferometer = Interferometer(axis, self.parameters)
        self._wire = InstrumentTerminal(wait_for_arrival=wait_for_arrival)
        self.path = self._wire.path
        self.counters = self._wire.counters
        p = self.parameters
        self._line = DelayedLine(self._wire, p.latency_s, p.jitter_s, p.seed + 2)
        self._axis = axis
        self._faults = FaultSchedule(faults)
        self._garbage = random.Random(self.parameters.seed + 1)
        self._optics = random.Random(self.parameters.seed + 3)
        self._start_ns = start_ns
        self._taken = 0
        self._sequence = 0
        self._displacement = 0
        self._angle_counts = [0, 0]
        self._runaway = 0  # counts gained or lost while the beam was lost
        self._next_ns = self._due_ns(1)

    def close(self) -> None:
        """Close the terminal; readers then see the port vanish."""
        self._wire.close()

    @property
    def is_open(self) -> bool:
        return self._wire.is_open

    def configure(self, parameters: LaserParameters) -> None:
        """Change the set-up while it runs; the rate stays."""
        self.parameters = parameters
        self.interferometer.configure(parameters)

    def schedule(self, faults: tuple[Fault, ...]) -> None:
        self._faults = FaultSchedule(faults)

    def add_faults(self, faults: tuple[Fault, ...]) -> None:
        """Add to the schedule of faults, while the laser runs."""
        self._faults.add(faults)

    # -- time ----------------------------------------------------------------------------------------------------------
    def _due_ns(self, number: int) -> int:
        return self._start_ns + round(number * _NS / self.parameters.rate_hz)

    def bearable(self, now_ns: int) -> int:
        """For SimClock: ns until the next sample, so that it is taken at its time."""
        return min(self._next_ns, self._line.next_ns) - now_ns if self._wire.is_open else _NS

    def advance(self, now_ns: int, dt_s: float) -> None:
        """Take the samples that are due."""
        if not self._wire.is_open:
            return
        while self._next_ns <= now_ns:
            self._taken += 1
            self._sample(self._next_ns)
            self._next_ns = self._due_ns(self._taken + 1)
        self._line.release(now_ns)

    def _sample(self, time_ns: int) -> None:
        time_s = time_ns / _NS
        self.counters.samples += 1
        self._sequence += 1
        if self.pulse is not None:
            self.pulse()
        line = _Line() if time_s < self._faults.next_s else self._line_faults(time_s)
        p = self.parameters
        reference = round(p.reference_hz / p.rate_hz)
        units = self.interferometer.units(time_s, line.extra_um)
        if line.beam or line.head:
            self._runaway -= reference
        nearest = round(units)
        displacement = nearest + self._runaway
        change = displacement - self._displacement
        self._displacement = displacement
        phase = round((units - nearest) * 256.0) & 0x1FF
        measured = max(0, reference + change)
        if line.head:
            reference, measured, phase = 0, 0, _ERROR_WORD[FaultKind.HEAD_ERROR]
        elif line.beam:
            measured, phase = 0, _ERROR_WORD[FaultKind.BEAM_LOST]
        elif line.overspeed:
            measured = 2 * reference + 1
        code, data = self._slow()
        text = b"%d %d %d %d %d %d %d %d" % (
            reference,
            measured,
            displacement,
            change,
            phase,
            self._sequence,
            code,
            data,
        )
        if p.straightness_um_per_unit is not None:
            lateral_um = self._axis.lateral_um + self._optics.gauss(0.0, p.straightness_noise_um)
            beside = (lateral_um / p.straightness_um_per_unit, 0.0)
            text += self._beside(beside, reference, lost=line.head or line.beam)
        elif p.angle_urad_per_unit is not None:
            beside = (self._axis.pitch_urad / p.angle_urad_per_unit, self._axis.yaw_urad / p.angle_urad_per_unit)
            text += self._beside(beside, reference, lost=line.head or line.beam)
        if line.half:
            text = text[: len(text) * 2 // 3]
        text += line.line_end
        if line.garbage:
            text += self._garbage.randbytes(line.garbage)
        if not line.silent:
            self._line.put(text, time_ns)

    def _beside(self, beside: tuple[float, float], reference: int, *, lost: bool) -> bytes:
        """Fields of axes 2 and 3: what their optics measure, in units of them."""
        text = b""
        for index, units in enumerate(beside):
            nearest = round(units)
            change, self._angle_counts[index] = nearest - self._angle_counts[index], nearest
            phase = round((units - nearest) * 256.0) & 0x1FF
            text += b" %d %d %d %d" % (0 if lost else max(0, reference + change), nearest, change, phase)
        return text

    def _line_faults(self, time_s: float) -> _Line:
        line = _Line()
        for fault in self._faults.active(time_s):
            if fault.kind is FaultKind.BEAM_LOST:
                line.beam = True
            elif fault.kind is FaultKind.HEAD_ERROR:
                line.head = True
            elif fault.kind is FaultKind.OVERSPEED:
                line.overspeed = True
            elif fault.kind is FaultKind.GLITCH:
                line.extra_um += fault.size
            elif fault.kind is FaultKind.SILENCE:
                line.silent = True
            elif fault.kind is FaultKind.HALF_LINE:
                line.half = True
            elif fault.kind is FaultKind.GARBAGE:
                line.garbage = int(fault.size) or 8
            elif fault.kind is FaultKind.LINE_ENDS:
                line.line_end = (b"\n", b"\r", b"\r\n")[self._sequence % 3]
            elif fault.kind is FaultKind.RESTART:
                self._sequence = 1
                self._runaway = -round(self.interferometer.units(time_s))
        return line

    def _slow(self) -> tuple[int, int]:
        """One slow value per line (lsCode, lsData), in turn as the firmware sends them."""
        turn = self._sequence & 0x1F
        if turn == 1:
            return 10, 5704
        if turn == 2:
            return 8, round(self.parameters.rate_hz * 100.0)
        if 3 <= turn <= 6:
            return turn, self._sensor(turn) if self.parameters.sensors_fitted else -1
        return 0, 0

    def _sensor(self, code: int) -> int:
        readings = self._axis.sensors.readings
        if code == 3:
            return round(readings.air_c * 100.0)
        if code == 4:
            return round(readings.temps_c[self.parameters.material_place] * 100.0)
        return round(readings.air_pressure_hpa * 100.0) if code == 5 else round(readings.air_humidity_percent * 10.0)

    def settle(self) -> None:
        """Send what was sampled since the last call; return once it is at the reader's end."""
        self._wire.settle()
