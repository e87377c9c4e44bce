"""Velocity runs of a Modbus drive by its register map: a signed target velocity, or a jog in one direction.

The drive decides whether one may begin, and stops one that was not confirmed; it supervises the travel.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.clock import NS_PER_S
from drivers.errors import CapabilityError
from drivers.modbus.codec import Raw
from drivers.modbus.drive_map import RunMap
from drivers.modbus.drive_values import Unit
from drivers.modbus.map_roles import Writes
from drivers.modbus.profile_moves import ProfileMoves


@dataclass(frozen=True)
class RunOrder:
    """One order of a velocity. target: for the velocity register, None to end a jog. jog: the order of its direction, for a drive that
    jogs."""

    run: RunMap
    target: Raw | None
    jog: Writes

    @property
    def is_jog(self) -> bool:
        """Whether the drive jogs, with a speed without a sign."""
        return bool(self.run.forward)


class VelocityRuns:
    """The velocity runs of one drive. running: a velocity other than 0 is written in it."""

    def __init__(self, unit: Unit, moves: ProfileMoves) -> None:
        self.running = False
        self._unit = unit
        self._moves = moves
        self._jog: Writes = ()  # the order of the jog under way
        self._kept_alive_ns = 0  # when a jog was last ordered

    def forget(self) -> None:
        """For a new connection: no run is under way."""
        self.running, self._jog = False, ()

    def planned(self, velocity_mm_s: float) -> RunOrder:
        """The order of a signed velocity, mm/s. Raises CapabilityError, InputError for one outside its register; writes nothing."""
        run = self._unit.map.run
        if run is None:
            raise CapabilityError(f"drive {self._unit.name}: its register map has no velocity run")
        counts_per_s = self._unit.scaling.direction * velocity_mm_s * self._unit.scaling.counts_per_load_mm
        if not run.forward:
            return RunOrder(run, self._unit.values.raw(counts_per_s, run.target), ())
        target = self._unit.values.raw_speed(abs(counts_per_s), run.target) if counts_per_s else None
        return RunOrder(run, target, run.forward if counts_per_s > 0 else run.backward)

    def begin(self, order: RunOrder) -> None:
        """Give the order; after an error the axis may be moving. Raises MotionTimeoutError, NoAnswerError."""
        if order.is_jog:
            self._begin_jog(order)
        elif order.target is not None:
            run = order.run
            self._unit.access.write(self._moves.ramp_settings(run.acceleration, run.deceleration))
            if not self.running:
                self._write_no_velocity()  # an old velocity must not take effect with the mode
            self._unit.orders.set_mode(run.mode, run.mode_shown, run.timeout_s)
            self.running = True
            self._unit.orders.start(run.start, "velocity run", run.timeout_s)
            self._unit.orders.write({run.target: order.target})

    def _begin_jog(self, order: RunOrder) -> None:
        """Jog: the speed without its sign, then the order of its direction, which `keep_alive` repeats where it has to be."""
        self.end()
        if order.target is None:
            return
        run = order.run
        self._unit.orders.remember((run.target,))
        self._unit.access.write(
            {run.target: order.target, **self._moves.ramp_settings(run.acceleration, run.deceleration)}
        )
        self.running, self._jog = True, order.jog
        self._kept_alive_ns = self._unit.clock.now_ns()
        self._unit.orders.start(self._jog, "jog", run.timeout_s)

    def keep_alive(self) -> None:
        """Order a jog again that would end by itself. Half the time is left for the wire; a sample that is late lets it end."""
        run = self._unit.map.run
        if run is None or run.keep_alive_s is None or not (self.running and self._jog) or self._unit.orders.stopped:
            return
        age_s = (self._unit.clock.now_ns() - self._kept_alive_ns) / NS_PER_S
        if age_s >= 0.5 * run.keep_alive_s:
            self._kept_alive_ns = self._unit.clock.now_ns()
            self._unit.orders.give(self._jog)

    def end(self) -> None:
        """Write 0 to the velocity register, so that no velocity stays in the drive."""
        if self.running:
            self._write_no_velocity()
            self.running = False

    def _write_no_velocity(self) -> None:
        run = self._unit.map.run
        if self._jog and run is not None:
            self._jog = ()
            self._unit.orders.give(run.stop)
        elif run is not None:
            self._unit.access.write({run.target: self._unit.values.raw(0.0, run.target)})
