"""StoppableNode: the part of a CANopen drive that a stream needs: its samples, how a stop leaves, how its power is taken off.

A sample is requested: SYNC is sent and the synchronous TPDOs that answer it are waited for, so it is never older than the call.
While another producer owns SYNC (`sync.Sync`) the values are read by SDO.

A stop is sent over every channel, the fastest first, before anything is read: `send_stop`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial

from drivers.canopen.bus import STOP_SEND_S, CanLink
from drivers.canopen.connection import Connection
from drivers.canopen.eds import EdsFile
from drivers.canopen.node import Node, NodeMonitor
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.sampling import Sampler
from drivers.canopen.sdo import SdoClient
from drivers.canopen.settings import CanOpenSettings
from drivers.canopen.stream_axis import StreamAxis
from drivers.canopen.sync import SYNC
from drivers.canopen.table_map import TableMap
from drivers.cia402 import objects
from drivers.cia402.drive import Cia402Drive
from drivers.cia402.state_machine import decode_state
from drivers.clock import Clock
from drivers.drive import DriveSample
from drivers.errors import BridgeError, StateError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling


class StoppableNode(Cia402Drive):
    """One node under power. `open` of the derived class creates the parts, with nothing enabled or moved.

    `sample` raises NoAnswerError when the node does not answer SYNC (twice), LinkLostError when its heartbeat stopped or it restarted.
    """

    settings: CanOpenSettings
    sdo: SdoClient
    monitor: NodeMonitor
    sampler: Sampler
    connection: Connection

    def __init__(
        self,
        name: str,
        scaling: AxisScaling,
        limits: DriveLimits,
        clock: Clock,
        *,
        link: CanLink,
        node_id: int,
        settings: CanOpenSettings | None = None,
        eds: EdsFile | None = None,
        table: TableMap | None = None,
    ) -> None:
        super().__init__(name, scaling, limits, clock, settings or CanOpenSettings())
        self.node = Node(name, link, node_id, eds, table)
        self.link = link
        self.node_id = node_id
        self._stream_axis: StreamAxis | None = None
        self.rpdo = PdoSpec(1, False, 0x200 + node_id, SYNC_EVERY, (objects.CONTROLWORD, objects.TARGET_POSITION))

    # -- streaming -------------------------------------------------------------------------------------------------------
    @property
    def is_streaming(self) -> bool:
        """Whether a `stream.CyclicStream` paces this drive; its samples are read by SDO meanwhile, as SYNC belongs to the stream."""
        return self.sampler.tpdos_in_stream

    def begin_streaming(self, axis: StreamAxis) -> None:
        """A stream takes SYNC and the PDOs; it restores the PDOs before `end_streaming`. Raises StateError while another one does."""
        self._require_open()
        if self.is_streaming:
            raise StateError(f"drive {self.name} is streaming already")
        self.sampler.tpdos_in_stream = True
        self.sampler.unsubscribe()
        self._stream_axis = axis

    def end_streaming(self) -> None:
        """To be called when the PDOs are those of `open` again."""
        self._stream_axis = None
        self.sampler.tpdos_in_stream = False
        self.sampler.subscribe()

    # -- how it is stopped and disabled ------------------------------------------------------------------------------------

    def _glance(self) -> DriveSample | None:
        axis = self._stream_axis
        if axis is not None:
            axis.fresh = False
            self.link.send(SYNC, b"")
            if not self.link.wait(lambda: axis.fresh, self.settings.sample_timeout_s):
                return None
            place_mm = self.scaling.load_mm(axis.position_counts)
            return DriveSample(axis.heard_ns, decode_state(axis.status), place_mm, target_reached=False)
        if not self.sampler.by_own_sync:
            return self._look()
        return self._as_sample() if self.sampler.heard_by_sync() else None

    def _look(self) -> DriveSample:
        self.sampler.refresh_somehow()
        return self._as_sample()

    def _stop_arrives(self, error: BridgeError) -> bool:
        return self.link.takes_frames or super()._stop_arrives(error)

    def _send_word(self, word: int, *, every_way: bool = True) -> None:
        """See `Cia402Drive._send_word`; a failure of one channel does not prevent the others. The way that is left out is SDO."""
        ways = self._ways(word)
        for way in ways if every_way else ways[:-1]:
            with suppress(Exception):
                way()

    def _ways(self, word: int) -> list[Callable[[], None]]:
        """The channels, the fastest first. Where the set-points of a stream carry a controlword they carry the command too: one that
        waits in the drive for the next SYNC would enable the axis. SYNC is sent only where it is ours, or where no other producer is
        heard. SDO is the last."""
        stop, axis = self.connection.stop_rpdo, self._stream_axis
        by_set_point = None if axis is None else axis.command(word)
        ways: list[Callable[[], None]] = []
        if stop is not None:
            ways.append(partial(self.link.send, stop.cob_id, stop.codec.pack(word), STOP_SEND_S))
        if by_set_point is not None:
            ways.append(partial(self.link.send_message, by_set_point, STOP_SEND_S))
        elif axis is None and stop is None and self.connection.mapped and self.connection.rpdo is not None:
            place = self.sampler.values.get(objects.POSITION_ACTUAL, 0)
            ways.append(partial(self.link.send, self.rpdo.cob_id, self.rpdo.codec.pack(word, place), STOP_SEND_S))
        if stop is None and ways and not self.link.sync.foreign_runs:
            ways.append(partial(self.link.send, SYNC, b"", STOP_SEND_S))
        ways.append(partial(self.sdo.send_at_once, objects.CONTROLWORD, word))
        return ways
