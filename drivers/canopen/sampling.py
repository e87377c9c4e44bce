"""Sampler: fresh values of one drive by SYNC and the synchronous TPDOs that answer it.

While another producer owns SYNC (a stream on this link, another program) the same values are read by SDO, and the TPDOs do not
answer SYNC.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.canopen import objects
from drivers.canopen.bus import FrameHandler
from drivers.canopen.node import Node
from drivers.canopen.objects import DataType, Entry
from drivers.canopen.pdo import EXISTS_NOT, OBJECT_MISSING, SYNC_EVERY, PdoSpec, wanted_image
from drivers.canopen.sdo import SdoClient
from drivers.canopen.sync import SYNC
from drivers.errors import AbortError, BridgeError, NoAnswerError, ProtocolError, TransportError


def exists(sdo: SdoClient, entry: Entry) -> bool:
    """Whether the drive has this object. Raises as `SdoClient.read`."""
    try:
        sdo.read(entry)
    except AbortError as error:
        if error.code in OBJECT_MISSING:
            return False
        raise
    return True


def sampled_pdos(sdo: SdoClient, node_id: int) -> tuple[PdoSpec, ...]:
    """TPDO 1 with status, position and torque, TPDO 2 with velocity and following error; objects that a drive lacks are left out."""
    first = [objects.STATUSWORD, objects.POSITION_ACTUAL]
    if exists(sdo, objects.TORQUE_ACTUAL):
        first.append(objects.TORQUE_ACTUAL)
    second = [entry for entry in (objects.VELOCITY_ACTUAL, objects.FOLLOWING_ERROR_ACTUAL) if exists(sdo, entry)]
    specs = [PdoSpec(1, True, 0x180 + node_id, SYNC_EVERY, tuple(first))]
    if second:
        specs.append(PdoSpec(2, True, 0x280 + node_id, SYNC_EVERY, tuple(second)))
    return tuple(specs)


class Sampler:
    """The latest values of a drive, and the time at which they were received."""

    def __init__(self, node: Node, timeout_s: float) -> None:
        self._link, self._sdo, self._monitor = node.link, node.sdo, node.monitor
        self.specs: Sequence[PdoSpec] = ()  # see `sampled_pdos`
        self._timeout_s = timeout_s
        self.values: dict[Entry, int] = {}
        self.heard_ns = 0
        self.missed = 0  # SYNCs that were not answered in time
        self.by_sdo = False  # a stream uses the TPDOs
        self.node_id = node.node_id
        self._in_sync = True  # the TPDOs answer SYNC
        self._awaited: set[int] = set()
        self._short_tpdo: ProtocolError | None = None  # a TPDO too short, received since the last request
        self._receivers: dict[int, FrameHandler] = {}

    @property
    def statusword(self) -> int:
        """6041h as last received."""
        return self.values[objects.STATUSWORD]

    @property
    def position_counts(self) -> int:
        """6064h as last received, counts."""
        return self.values[objects.POSITION_ACTUAL]

    def subscribe(self) -> None:
        """Listen to the TPDOs; they answer SYNC from now on or are switched off by `settle`."""
        self._link.sync.followers.append(self)
        for spec in self.specs:
            receiver = self._receivers[spec.cob_id] = self._receiver(spec)
            self._link.subscribe(spec.cob_id, receiver)

    def unsubscribe(self) -> None:
        """Stop listening."""
        for cob_id, receiver in self._receivers.items():
            self._link.unsubscribe(cob_id, receiver)
        self._receivers = {}
        if self in self._link.sync.followers:
            self._link.sync.followers.remove(self)

    def mapped(self) -> None:
        """To be called when the TPDOs were mapped anew: they answer SYNC."""
        self._in_sync = True

    def settle(self) -> bool:
        """Have the TPDOs answer SYNC, or not, as its owner needs; whether this link may send SYNC. Raises as an SDO write does."""
        ours = not (self.by_sdo or self._link.sync.taken)
        if not self.by_sdo and ours is not self._in_sync:
            for spec in self.specs:
                self._sdo.write(_cob_id(spec), wanted_image(spec).cob_id | (0 if ours else EXISTS_NOT))
            self._in_sync = ours
        return ours

    def leave_sync(self) -> bool:
        """For a stream that begins on this link: whether the TPDOs no longer answer its SYNC."""
        try:
            self.settle()
        except BridgeError:
            return False  # they still answer, and count in the load
        return self.by_sdo or not self._in_sync

    def refresh(self) -> None:
        """Request all values now. Raises NoAnswerError when two SYNCs go unanswered, LinkLostError when the node is lost."""
        self._link.poll()
        self._monitor.check()
        for _ in range(2):
            if not self._settled():
                self._read()
                return
            if self._answered(send=True):
                return
            self._monitor.check()
        raise NoAnswerError(
            f"{self._sdo.name}: node {self._sdo.node_id} does not answer SYNC within {self._timeout_s:g} s"
        )

    def heard_by_sync(self) -> bool:
        """Request all values by one SYNC, sent here or by its owner, whatever the heartbeat says; False where the TPDOs do not come.

        Raises LinkLostError.
        """
        self._link.poll()
        try:
            ours = self._settled()
        except (TransportError, ProtocolError):  # SDO does not answer: the TPDOs stay as they are
            ours = not self._link.sync.foreign_runs
        if self.by_sdo or not self._in_sync:
            return False
        try:
            return self._answered(send=ours)
        except ProtocolError:
            return False

    def refresh_somehow(self) -> None:
        """For shutting down, when the heartbeat may be missing and one of the two channels lost: request by SYNC, else by SDO.

        Raises NoAnswerError, LinkLostError when neither is answered; AbortError, ProtocolError.
        """
        if not self.heard_by_sync():
            self._read()

    def _answered(self, *, send: bool) -> bool:
        """Whether all TPDOs answer one SYNC, sent here or by its owner."""
        self._awaited, self._short_tpdo = {spec.cob_id for spec in self.specs}, None
        if send:
            self._link.send(SYNC, b"")
        answered = self._link.wait(self._complete, self._timeout_s)
        if self._short_tpdo is not None:
            raise self._short_tpdo
        if answered:
            return True
        self.missed += 1
        return False

    def _settled(self) -> bool:
        """As `settle`; a drive whose TPDOs cannot be switched off answers every SYNC."""
        try:
            return self.settle()
        except AbortError:
            return not (self.by_sdo or self._link.sync.taken)

    def _read(self) -> None:
        for spec in self.specs:
            for entry in spec.entries:
                self.values[entry] = self._sdo.read(entry)
        self.heard_ns = self._link.clock.now_ns()

    def _complete(self) -> bool:
        return not self._awaited or self._short_tpdo is not None

    def _receiver(self, spec: PdoSpec) -> Callable[[int, bytes], None]:
        entries, codec, cob_id = spec.entries, spec.codec, spec.cob_id

        def receive(time_ns: int, data: bytes) -> None:
            if len(data) < codec.size:
                text = f"{self._sdo.name}: {spec} came with {len(data)} bytes, {codec.size} are mapped"
                self._short_tpdo = ProtocolError(
                    text
                )  # raised in the call that requested the sample, not in one that waits for another frame
                return
            self.values.update(zip(entries, codec.unpack_from(data), strict=True))
            self._awaited.discard(cob_id)
            self.heard_ns = time_ns

        return receive


def _cob_id(spec: PdoSpec) -> Entry:
    return Entry(spec.communication, 1, DataType.U32, "COB-ID")
