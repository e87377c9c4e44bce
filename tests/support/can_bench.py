"""Drives on the simulated wire of `can_wire`: bare motors, for tests of the bus rather than of the machine.

`CanBench` connects clock, servos, wire and drives in the right order. `sim_backends.bench` has screw, table and laser.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from support.can_wire import SimWire, WirePort

from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import EDS, CanOpenSlave
from sim_backends.canopen_faults import CanFault, FaultLayer
from sim_backends.canopen_store import Flash
from sim_backends.clock import SimClock
from sim_backends.faults import Fault
from sim_backends.own_table import TableForm
from sim_backends.servo import ServoParameters, SimulatedServo


def attach_to_wire(
    wire: SimWire,
    servo: SimulatedServo,
    node_id: int = 1,
    *,
    parameters: Mapping[tuple[int, int], int] | None = None,
    faults: Iterable[CanFault] = (),
    flash: Flash | None = None,
    table: TableForm | None = None,
    eds: Path = EDS,
    make: Callable[..., CanOpenSlave] = CanOpenSlave,
) -> CanOpenSlave:
    """Put a drive on the simulated wire and boot it; its servo has to be attached to the clock before."""
    node = wire.add_node()
    faults = tuple(faults)
    made = partial(make, servo, node_id, parameters=parameters, flash=flash, table=table, eds=eds)
    if faults:
        layer = FaultLayer(faults, node_id, node.send, made)
        slave = layer.slave
        node.connect(layer.on_frame, layer.tick, layer.due_ns)
    else:
        slave = made(node.send)
        node.connect(slave.on_frame, slave.tick, slave.due_ns)
    node.on_remote = slave.on_remote
    slave.boot(wire.clock.now_ns())
    return slave


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
