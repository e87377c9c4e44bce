"""One CANopen node: its SDO channel, its state as received (heartbeat, boot-ups, emergencies), and NMT commands to it.

The node is judged by `NodeMonitor.check`, with the frames that have come in by then; nothing here runs by itself.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import IntEnum

from drivers.canopen.bus import CanLink
from drivers.canopen.eds import EdsFile
from drivers.canopen.sdo import SdoClient
from drivers.canopen.table_map import TableMap
from drivers.cia402.error_codes import error_text
from drivers.clock import NS_PER_S
from drivers.errors import LinkLostError
from drivers.way_out import WayOut

NMT = 0x000
EMERGENCY = 0x080
HEARTBEAT = 0x700
LOG_LENGTH = 256
LATE_TIMES = 2
"""Times its limit after which the heartbeat of a node that still answers has stopped: one heartbeat and its grace were lost twice."""


class NmtCommand(IntEnum):
    """Command specifiers of NMT node control (CiA-301, 7.2.8.3.1)."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """NMT states as the heartbeat shows them (CiA-301, 7.2.8.3.2)."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


@dataclass(frozen=True)
class Emergency:
    """One EMCY as received; register is 1001h, extra the five manufacturer bytes."""

    time_ns: int
    code: int
    register: int
    extra: bytes

    def __str__(self) -> str:
        return f"{error_text(self.code)}, register {self.register:02X}h, extra {self.extra.hex()}"


class NodeMonitor:
    """Listens to heartbeat, boot-up and EMCY of a node. The log keeps the last emergencies."""

    def __init__(self, link: CanLink, node_id: int, name: str) -> None:
        self.link = link
        self.node_id = node_id
        self.name = name
        self.state: NmtState | None = None
        self.log: deque[Emergency] = deque(maxlen=LOG_LENGTH)
        self.boot_ups = 0
        self.heartbeats = 0
        self._heard_ns: int | None = None
        self._limit_ns: float | None = None
        self._expect_boot = False
        self._rebooted = False
        link.subscribe(HEARTBEAT + node_id, self._on_heartbeat)
        link.subscribe(EMERGENCY + node_id, self._on_emergency)

    def close(self) -> None:
        self.link.unsubscribe(HEARTBEAT + self.node_id, self._on_heartbeat)
        self.link.unsubscribe(EMERGENCY + self.node_id, self._on_emergency)

    def command(self, command: NmtCommand) -> None:
        """Send an NMT command to this node; only the next heartbeat confirms it. Raises LinkLostError."""
        if command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self._expect_boot = True
        self.link.send(NMT, bytes((command, self.node_id)))

    def expect_heartbeat(self, within_s: float | None) -> None:
        """From now on a heartbeat must come within this time, s, and a boot-up without a command is a restart; math.inf: none has to
        come; None: not supervised."""
        self._limit_ns = None if within_s is None else within_s * NS_PER_S
        self._heard_ns = self.link.clock.now_ns()

    def check(self, *, answered: bool = False) -> None:
        """Raise LinkLostError when the heartbeat is overdue or the node has restarted without a command.

        answered: the node has just answered a request, so that its heartbeat may be late, on a computer whose processes wait for each
        other; after `LATE_TIMES` its limit it has stopped.
        """
        self.check_restart()
        if self._limit_ns is None or self._heard_ns is None:
            return
        silent_ns = self.link.clock.now_ns() - self._heard_ns
        if silent_ns > self._limit_ns * (LATE_TIMES if answered else 1):
            raise LinkLostError(
                f"{self.name}: no heartbeat of node {self.node_id} for {silent_ns / NS_PER_S:.3f} s,"
                f" expected every {self._limit_ns / NS_PER_S:g} s at least"
            )

    def check_restart(self) -> None:
        """Raise LinkLostError when the node has restarted without a command."""
        if self._rebooted:
            raise LinkLostError(f"{self.name}: node {self.node_id} restarted by itself; open it again")

    def last_error_code(self) -> int | None:
        """The code of the last emergency, None when there was none; 0: the errors are gone."""
        return self.log[-1].code if self.log else None

    def _on_heartbeat(self, time_ns: int, data: bytes) -> None:
        if len(data) != 1:
            return
        self._heard_ns = time_ns
        self.heartbeats += 1
        try:
            self.state = NmtState(data[0] & 0x7F)
        except ValueError:
            return
        if self.state is NmtState.BOOT_UP:
            self.boot_ups += 1
            if not self._expect_boot and self._limit_ns is not None:
                self._rebooted = True
            self._expect_boot = False

    def _on_emergency(self, time_ns: int, data: bytes) -> None:
        if len(data) != 8:
            return
        self.log.append(Emergency(time_ns, int.from_bytes(data[:2], "little"), data[2], data[3:]))


class Node:
    """A drive's node, as it is passed to its parameters, streams and touch probe. name: the drive's.

    eds: the manufacturer's dictionary. table: map of the drive's own correction table. sdo and monitor belong to the present
    opening: each `open` makes new ones.
    """

    sdo: SdoClient
    monitor: NodeMonitor

    def __init__(
        self, name: str, link: CanLink, node_id: int, eds: EdsFile | None = None, table: TableMap | None = None
    ) -> None:
        self.name = name
        self.link = link
        self.node_id = node_id
        self.clock = link.clock
        self.eds = eds
        self.table = table

    def open(self, sdo_timeout_s: float = 0.5, axis: int = 1, way_out: WayOut | None = None) -> None:
        """Listen to the node; no request is sent. sdo_timeout_s: for one answer, s. axis: of a node with several. way_out: limits its
        requests while it is shut down."""
        where = f"drive {self.name}"
        self.sdo = SdoClient(self.link, self.node_id, where, timeout_s=sdo_timeout_s, axis=axis, way_out=way_out)
        self.monitor = NodeMonitor(self.link, self.node_id, where)

    def close(self) -> None:
        self.monitor.close()
        self.sdo.close()
