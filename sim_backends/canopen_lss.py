"""LSS slave (CiA-305): a simulated drive without a node id, which answers nothing but LSS, and its start once it has one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.canopen_wire import SimWire
from sim_backends.servo import Servo

REQUESTS, ANSWERS = 0x7E5, 0x7E4
NO_ID = 0xFF
TABLE_ENTRIES = (0, 1, 2, 3, 4, 6, 7, 8)


@dataclass(frozen=True)
class Identity:
    """The four numbers of 1018h."""

    vendor_id: int = 0x4E1
    product_code: int = 0x402
    revision: int = 0x10000
    serial: int = 1

    @property
    def parts(self) -> tuple[int, int, int, int]:
        """The four numbers in the order of LSS."""
        return self.vendor_id, self.product_code, self.revision, self.serial


class LssSlave:
    """Answers LSS requests. begin(node_id): called when the first id was given and LSS has released the node.

    stored_node_id: the id kept without power.
    """

    def __init__(self, identity: Identity, node_id: int | None, begin: Callable[[int], None]) -> None:
        self.identity = identity
        self.node_id = node_id
        self.stored_node_id = node_id
        self._begin = begin
        self._pending = NO_ID if node_id is None else node_id
        self._configuring = False
        self._matching = 0  # number of parts of a selection that matched so far
        self._scan_part = 0

    def handle(self, request: bytes) -> bytes | None:
        """The answer to one request, None where there is none."""
        if len(request) != 8:
            return None
        command = request[0]
        if command == 0x04:
            self._switch(request[1])
            return None
        if 0x40 <= command <= 0x43:
            return self._select(command - 0x40, request)
        if command == 0x4C:
            return self._answer(0x50) if self.node_id is None else None
        if command == 0x51:
            return self._scan(request)
        return self._configure(command, request) if self._configuring else None

    @staticmethod
    def _answer(command: int, data: bytes = b"") -> bytes:
        return (bytes((command,)) + data).ljust(8, b"\0")

    def _switch(self, state: int) -> None:
        self._configuring = state == 1
        if not self._configuring and self.node_id is None and self._pending != NO_ID:
            self.node_id = self._pending
            self._begin(self.node_id)

    def _select(self, part: int, request: bytes) -> bytes | None:
        fits = int.from_bytes(request[1:5], "little") == self.identity.parts[part]
        self._matching = self._matching + 1 if fits and self._matching == part else int(fits and part == 0)
        if self._matching == 4:
            self._matching = 0
            self._configuring = True
            return self._answer(0x44)
        return None

    def _scan(self, request: bytes) -> bytes | None:
        if self.node_id is not None or self._configuring:
            return None
        number, bit, part, following = int.from_bytes(request[1:5], "little"), request[5], request[6], request[7]
        if bit == 0x80:
            self._scan_part = 0
            return self._answer(0x4F)
        if part != self._scan_part or part > 3 or bit > 31:
            return None
        if (number ^ self.identity.parts[part]) >> bit:
            return None
        if bit == 0 and following != part:
            self._scan_part = following
            self._configuring = part == 3
        return self._answer(0x4F)

    def _configure(self, command: int, request: bytes) -> bytes | None:
        if command == 0x11:
            good = 1 <= request[1] <= 127 or request[1] == NO_ID
            if good:
                self._pending = request[1]
            return self._answer(command, bytes((not good,)))
        if command == 0x13:
            return self._answer(command, bytes((not (request[1] == 0 and request[2] in TABLE_ENTRIES),)))
        if command == 0x17:
            self.stored_node_id = self._pending
            return self._answer(command)
        if 0x5A <= command <= 0x5D:
            return self._answer(command, self.identity.parts[command - 0x5A].to_bytes(4, "little"))
        if command == 0x5E:
            return self._answer(command, bytes((NO_ID if self.node_id is None else self.node_id,)))
        return None


class NewDrive:
    """A drive without a node id on the simulated wire; `slave` is there once it has been given one."""

    def __init__(self, wire: SimWire, servo: Servo, identity: Identity) -> None:
        self._servo = servo
        self._node = wire.add_node()
        self._clock = wire.clock
        self.lss = LssSlave(identity, None, self._begin)
        self.slave: CanOpenSlave | None = None
        self._node.connect(self._on_frame, self._tick, self._due_ns)

    def _begin(self, node_id: int) -> None:
        parameters = {(0x1018, number): part for number, part in enumerate(self.lss.identity.parts, start=1)}
        self.slave = CanOpenSlave(self._servo, node_id, self._node.send, parameters=parameters)
        self.slave.boot(self._clock.now_ns())

    def _on_frame(self, cob_id: int, data: bytes, now_ns: int) -> None:
        if cob_id == REQUESTS:
            answer = self.lss.handle(data)
            if answer is not None:
                self._node.send(ANSWERS, answer)
        elif self.slave is not None:
            self.slave.on_frame(cob_id, data, now_ns)

    def _tick(self, now_ns: int) -> None:
        if self.slave is not None:
            self.slave.tick(now_ns)

    def _due_ns(self) -> int | None:
        return None if self.slave is None else self.slave.due_ns()
