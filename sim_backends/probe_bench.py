"""A machine with a probe in its spindle: X, Y and spindle servos, one contact that depends on all three, and inputs connected to it.

Connects clock, servos, probe and inputs. Positions of the motors are positions of the table and the spindle; the errors of screws
are in `bench`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.scaling import AxisScaling
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.control_wires import SimulatedControl, Wires
from sim_backends.probe import ProbeParameters, SimulatedProbe
from sim_backends.probe_latch import ProbeLatch
from sim_backends.servo import ServoParameters, SimulatedServo

_IDLE_STEP_NS = 60_000_000_000


@dataclass(frozen=True)
class AxisOfBench:
    """A servo's units (mm, or degrees for a spindle), its travel and its first position. The home switch is at 0."""

    scaling: AxisScaling
    low: float
    high: float
    start: float = 0.0

    @property
    def servo(self) -> ServoParameters:
        per_unit = self.scaling.direction * self.scaling.counts_per_load_mm
        low, high = sorted((self.low * per_unit, self.high * per_unit))
        counts = self.scaling.encoder_counts_per_motor_rev
        return ServoParameters(
            counts_per_rev=counts,
            start_counts=float(round(self.start * per_unit)),
            negative_limit_counts=low - 1.0 * counts,
            positive_limit_counts=high + 1.0 * counts,
            negative_stop_counts=low - 1.5 * counts,
            positive_stop_counts=high + 1.5 * counts,
            home_switch_counts=0.0,
        )


class ProbeBench:
    """axes: those of "x", "y", "z" and "spindle" that the machine has. Absolute encoders: every servo knows its position.

    spindle_sense: +1 where a rising position turns the spindle counter-clockwise, −1 where it turns it clockwise; normally_closed: the
    inputs are active without contact.

    Call `watch_probe` once, after every face of the servos on a wire is attached to the clock.
    """

    def __init__(
        self,
        axes: Mapping[str, AxisOfBench],
        probe: ProbeParameters,
        spindle_sense: int = 1,
        *,
        normally_closed: bool = False,
        clock: SimClock | None = None,
    ) -> None:
        self.clock = clock or SimClock()
        self.axes = dict(axes)
        self._sense = spindle_sense
        self._idle = normally_closed
        self._seen_counts: list[int] = []
        self.probe = SimulatedProbe(probe)
        self.servos: dict[str, SimulatedServo] = {}
        self._units: list[tuple[ProbeLatch, int]] = []
        self.control: SimulatedControl | None = None
        for name, axis in axes.items():
            servo = SimulatedServo(BareShaft(), axis.servo)
            servo.homed = True
            self.clock.attach(servo.advance, bearable=servo.bearable)
            self.servos[name] = servo

    def place(self, name: str) -> float:
        """Position of an axis, mm or degrees; 0 for one that the machine does not have."""
        if name not in self.servos:
            return 0.0
        return self.axes[name].scaling.load_mm(self.servos[name].position_actual_counts)

    def contact(self, name: str) -> Callable[[int], bool]:
        """The input's level as a function of one axis's motor counts, with the other axes at their present positions."""
        scaling = self.axes[name].scaling

        def closed(position_counts: int) -> bool:
            places = {other: self.place(other) for other in ("x", "y", "z", "spindle") if other != name}
            places[name] = scaling.load_mm(position_counts)
            return (
                self.probe.closed(places["x"], places["y"], self._sense * places["spindle"], places["z"]) != self._idle
            )

        return closed

    def wire(self, name: str, unit: ProbeLatch, number: int) -> None:
        """Wire the probe to an input of an axis's drive."""
        unit.attach(number, self.contact(name))
        self._units.append((unit, number))

    def give_codes_at(self, wires: Wires) -> None:
        """Connect the control, if there is one, to the terminals of a drive."""
        if self.control is not None:
            self.control.wires = wires
            self.control.tick(self.clock.now_ns())
            self.clock.attach(self.control.tick, bearable=self.control.bearable)

    def watch_probe(self) -> None:
        """From now on the probe follows the machine's position, and every input the contact as the other axes move."""
        self.clock.attach(self._follow, bearable=lambda _now_ns: _IDLE_STEP_NS)
        self._follow(0, 0.0)

    def _follow(self, _now_ns: int, _dt_s: float) -> None:
        counts = [servo.position_actual_counts for servo in self.servos.values()]
        if counts == self._seen_counts:
            return
        self._seen_counts = counts
        signals = self.probe.follow(
            self.place("x"), self.place("y"), self._sense * self.place("spindle"), self.place("z")
        )
        level = signals != self._idle
        for unit, number in self._units:
            if bool(unit.inputs >> number - 1 & 1) != level:
                unit.set_input(number, level)
