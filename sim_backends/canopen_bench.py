"""The smallest CANopen bench: bare motors on a simulated wire, for tests of the bus rather than of the machine.

Connects clock, servos, wire and drives in the right order. `sim_backends.bench` has screw, table and laser.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sim_backends.canopen_drive import EDS, CanOpenSlave
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_station import attach_to_wire
from sim_backends.canopen_store import Flash
from sim_backends.canopen_wire import SimWire, WirePort
from sim_backends.clock import SimClock
from sim_backends.faults import Fault
from sim_backends.own_table import TableForm
from sim_backends.servo import ServoParameters, SimulatedServo


class BareShaft:
    """A motor whose only load is friction."""

    def __init__(self, friction_permille: float = 40.0) -> None:
        self._at_rev = 0.0
        self._friction = friction_permille
        self.friction_permille = 0.0

    def step(self, motor_rev: float, dt_s: float) -> None:
        """The shaft has turned to `motor_rev` revolutions."""
        del dt_s
        if motor_rev != self._at_rev:
            self.friction_permille = math.copysign(self._friction, motor_rev - self._at_rev)
        self._at_rev = motor_rev


SMALL_SERVO = ServoParameters(
    counts_per_rev=100_000,
    negative_limit_counts=-3_200_000.0,
    positive_limit_counts=3_200_000.0,
    negative_stop_counts=-3_300_000.0,
    positive_stop_counts=3_300_000.0,
)
"""100 000 counts per revolution, ±32 revolutions between the limit switches."""


@dataclass
class CanBench:
    """Drives with the given node ids on one wire. bitrate in bit/s; None: frames take no time.

    faults: {node id: faults of that node}; parameters: laid over every drive's defaults; lacking: objects that no drive has;
    refused: objects that every drive refuses to write.
    """

    node_ids: Sequence[int] = (5,)
    bitrate: int | None = None
    faults: Mapping[int, Sequence[CanFault]] = field(default_factory=dict)
    parameters: Mapping[tuple[int, int], int] = field(default_factory=dict)
    servo_parameters: ServoParameters = SMALL_SERVO
    servo_faults: Sequence[Fault] = ()
    flash: Flash | None = None  # memory of the drives (one for all): values stored in an earlier run
    lacking: Sequence[int] = ()
    refused: Sequence[tuple[int, int]] = ()
    eds: Path = EDS
    table: TableForm | None = None  # the correction table of every drive itself
    clock: SimClock = field(default_factory=SimClock)

    def __post_init__(self) -> None:
        self.servos: dict[int, SimulatedServo] = {}
        for node_id in self.node_ids:
            servo = SimulatedServo(BareShaft(), self.servo_parameters, tuple(self.servo_faults))
            self.clock.attach(servo.advance, bearable=servo.bearable)
            self.servos[node_id] = servo
        self.wire = SimWire(self.clock, self.bitrate)
        self.slaves: dict[int, CanOpenSlave] = {
            node_id: attach_to_wire(
                self.wire,
                servo,
                node_id,
                parameters=self.parameters,
                faults=tuple(self.faults.get(node_id, ())),
                flash=self.flash,
                eds=self.eds,
                table=self.table,
            )
            for node_id, servo in self.servos.items()
        }
        for slave in self.slaves.values():
            for index in self.lacking:
                slave.dictionary.remove(index)
            for index, subindex in self.refused:
                slave.dictionary.lock(index, subindex)

    @property
    def servo(self) -> SimulatedServo:
        return self.servos[self.node_ids[0]]

    @property
    def slave(self) -> CanOpenSlave:
        """The first drive."""
        return self.slaves[self.node_ids[0]]

    def port(self) -> WirePort:
        """Another node on the bus, for a master."""
        return self.wire.port()
