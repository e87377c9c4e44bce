"""A simulated µMD interferometer: measures the feed axis's true position and sends lines over a pseudo-terminal.

Optics, air and set-up errors are in `interferometer`, the wire is `terminal`; the line is formatted here without the decoder's code,
which it tests. Lines that a full terminal loses leave a gap in the sequence.
"""

from __future__ import annotations

import random

from sim_backends.faults import Fault, FaultKind, FaultSchedule
from sim_backends.interferometer import Interferometer, LaserParameters
from sim_backends.plant.axis import FeedAxis
from sim_backends.terminal import TerminalInstrument

__all__ = ["Interferometer", "LaserParameters", "SimulatedLaser"]

_NS = 1_000_000_000
_ERROR_WORD = {FaultKind.HEAD_ERROR: 0x400, FaultKind.BEAM_LOST: 0x800}


class SimulatedLaser(TerminalInstrument):
    """The instrument on its pseudo-terminal."""

    def __init__(
        self,
        axis: FeedAxis,
        parameters: LaserParameters | None = None,
        faults: tuple[Fault, ...] = (),
        *,
        start_ns: int = 0,
        wait_for_arrival: bool = True,
    ) -> None:
        self.parameters = p = parameters or LaserParameters()
        self.interferometer = Interferometer(axis, p)
        self._axis = axis
        self._garbage = random.Random(p.seed + 1)
        self._optics = random.Random(p.seed + 3)
        self._start_ns = start_ns
        self._taken = 0
        self._sequence = 0
        self._displacement = 0
        self._angle_counts = [0, 0]
        self._runaway = 0  # counts gained or lost while the beam was lost
        super().__init__(
            faults,
            first_ns=self._due_ns(1),
            latency_s=p.latency_s,
            jitter_s=p.jitter_s,
            seed=p.seed + 2,
            wait_for_arrival=wait_for_arrival,
        )

    def configure(self, parameters: LaserParameters) -> None:
        """Change the set-up while it runs; the rate stays."""
        self.parameters = parameters
        self.interferometer.configure(parameters)

    def schedule(self, faults: tuple[Fault, ...]) -> None:
        self._faults = FaultSchedule(faults)

    def add_faults(self, faults: tuple[Fault, ...]) -> None:
        """Add to the schedule of faults, while the laser runs."""
        self._faults.add(faults)

    # -- lines ---------------------------------------------------------------------------------------------------------
    def _due_ns(self, number: int) -> int:
        return self._start_ns + round(number * _NS / self.parameters.rate_hz)

    def _act(self, time_ns: int) -> int:
        self._taken += 1
        self._sample(time_ns)
        return self._due_ns(self._taken + 1)

    def _sample(self, time_ns: int) -> None:
        faults, time_s = self._begin_sample(time_ns), time_ns / _NS
        self._sequence += 1
        if FaultKind.RESTART in faults:
            self._sequence = 1
            self._runaway = -round(self.interferometer.units(time_s))
        head, beam = FaultKind.HEAD_ERROR in faults, FaultKind.BEAM_LOST in faults
        p = self.parameters
        reference = round(p.reference_hz / p.rate_hz)
        units = self.interferometer.units(time_s, faults.get(FaultKind.GLITCH, 0.0))
        if beam or head:
            self._runaway -= reference
        nearest = round(units)
        displacement = nearest + self._runaway
        change = displacement - self._displacement
        self._displacement = displacement
        phase = round((units - nearest) * 256.0) & 0x1FF
        measured = max(0, reference + change)
        if head:
            reference, measured, phase = 0, 0, _ERROR_WORD[FaultKind.HEAD_ERROR]
        elif beam:
            measured, phase = 0, _ERROR_WORD[FaultKind.BEAM_LOST]
        elif FaultKind.OVERSPEED in faults:
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
            text += self._beside(beside, reference, lost=head or beam)
        elif p.angle_urad_per_unit is not None:
            beside = (self._axis.pitch_urad / p.angle_urad_per_unit, self._axis.yaw_urad / p.angle_urad_per_unit)
            text += self._beside(beside, reference, lost=head or beam)
        self._send(text, b"\r\n", time_ns, faults, self._garbage)

    def _beside(self, beside: tuple[float, float], reference: int, *, lost: bool) -> bytes:
        """Fields of axes 2 and 3: what their optics measure, in units of them."""
        text = b""
        for index, units in enumerate(beside):
            nearest = round(units)
            change, self._angle_counts[index] = nearest - self._angle_counts[index], nearest
            phase = round((units - nearest) * 256.0) & 0x1FF
            text += b" %d %d %d %d" % (0 if lost else max(0, reference + change), nearest, change, phase)
        return text

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
