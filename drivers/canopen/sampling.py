"""Sampler: fresh values of one drive by SYNC and the synchronous TPDOs that answer it.

While another producer owns SYNC (a stream on this link, another program) the same values are read by SDO, and the TPDOs do not
answer SYNC.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.canopen.bus import FrameHandler
from drivers.canopen.node import Node
from drivers.canopen.pdo import COB_ID, EXISTS_NOT, SYNC_EVERY, PdoSpec
from drivers.canopen.sdo import SdoClient
from drivers.canopen.sync import SYNC
from drivers.cia402 import objects
from drivers.cia402.objects import Entry
from drivers.errors import AbortError, BridgeError, NoAnswerError, ProtocolError, TransportError

ANSWER_WITHIN_S = 0.5
"""Time within which a SYNC that is not answered is sent again, s of listening (`Listening`): the default limit of the heartbeat.
Processes on two cores, four of them computing without a pause, kept an answer back for up to 0.2 s."""
LEAST_ASKED = 2
PROOFS = 3
"""Tries to see a position by SYNC between two by SDO: an encoder at rest is noisy."""
AGREES_COUNTS = 16
"""Tolerance of that, counts: noise of a fine encoder."""


def sampled_pdos(sdo: SdoClient, node_id: int) -> tuple[PdoSpec, ...]:
    """TPDO 1 with status, position and torque, TPDO 2 with velocity and following error; objects that a drive lacks are left out.

    Raises AbortError, naming the object, for a drive without status or position."""
    for entry in (objects.STATUSWORD, objects.POSITION_ACTUAL):
        sdo.read(entry)
    first = [objects.STATUSWORD, objects.POSITION_ACTUAL]

    def shown(*entries: Entry) -> list[Entry]:
        return [entry for entry in entries if sdo.read_if_shown(entry, None) is not None]

    first += shown(objects.TORQUE_ACTUAL)
    second = shown(objects.VELOCITY_ACTUAL, objects.FOLLOWING_ERROR_ACTUAL)
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
        self.asked_ns = 0  # before the values were taken
        self.tpdos_in_stream = False  # a stream has them; see `StoppableNode.begin_streaming`
        self.without_pdos = False  # the drive takes no TPDO of status and position: every sample is read by SDO
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

    @property
    def by_sdo(self) -> bool:
        """Whether no TPDO is there for samples: a stream uses them, or the drive takes none."""
        return self.tpdos_in_stream or self.without_pdos

    @property
    def by_own_sync(self) -> bool:
        """Whether samples are to be requested by SYNC sent on this link."""
        return not (self.by_sdo or self._link.sync.taken)

    def subscribe(self) -> None:
        """Listen to the TPDOs; they answer SYNC from now on or are switched off by `settle`."""
        if self.without_pdos:
            return
        self._link.sync.followers.append(self)
        for spec in self.specs:
            receiver = self._receivers[spec.cob_id] = self._receiver(spec)
            self._link.subscribe(spec.cob_id, receiver)

    def unsubscribe(self) -> None:
        for cob_id, receiver in self._receivers.items():
            self._link.unsubscribe(cob_id, receiver)
        self._receivers = {}
        if self in self._link.sync.followers:
            self._link.sync.followers.remove(self)

    def mapped(self, specs: Sequence[PdoSpec]) -> None:
        """To be called when the TPDOs were mapped anew: they answer SYNC. Without any, all is read by SDO."""
        self.without_pdos = not specs
        if specs:
            self.specs = specs
        self._in_sync = True

    def settle(self) -> bool:
        """Have the TPDOs answer SYNC, or not, as its owner needs; whether this link may send SYNC. Raises as an SDO write does."""
        ours = self.by_own_sync
        if not self.by_sdo and ours is not self._in_sync:
            for spec in self.specs:
                self._sdo.write(spec.pdo.setting(COB_ID), spec.cob_id_entry | (0 if ours else EXISTS_NOT))
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
        """Request all values now, by SYNC again and again until `ANSWER_WITHIN_S` have passed, at least twice.

        Raises NoAnswerError when no SYNC is answered, LinkLostError when the node is lost.
        """
        self._link.poll()
        self._monitor.check_restart()  # the heartbeat: once those that were sent before an answer have been received
        listened_s, asked = 0.0, 0
        while self._settled():
            if not self._answered(send=True):
                listened_s += self._timeout_s
            elif not asked or self._proven():
                break
            else:
                listened_s += ANSWER_WITHIN_S
            asked += 1
            if asked >= LEAST_ASKED and listened_s >= ANSWER_WITHIN_S:
                self._monitor.check()
                raise NoAnswerError(
                    f"{self._sdo.name}: node {self._sdo.node_id} does not answer SYNC within {self._timeout_s:g} s, asked"
                    f" {asked} times"
                )
        else:
            self._read()
        self._monitor.check(answered=True)

    def prove(self) -> None:
        """Make sure that the TPDOs carry what was mapped: the position by SYNC lies between two that are read by SDO.

        Raises ProtocolError for a drive that keeps another mapping than it has answered, and as `refresh`."""
        if self.by_sdo or not self._in_sync:
            return
        for _ in range(PROOFS):
            before = self._sdo.read(objects.POSITION_ACTUAL)
            self.refresh()
            after = self._sdo.read(objects.POSITION_ACTUAL)
            least, most = min(before, after) - AGREES_COUNTS, max(before, after) + AGREES_COUNTS
            if least <= self.position_counts <= most:
                return
        raise ProtocolError(
            f"{self._sdo.name}: TPDO 1 says the position is {self.position_counts}, 6064h {before} to {after}"
        )

    def _proven(self) -> bool:
        """Whether, after a SYNC was not answered, a single one is answered in time. Until then an answer may be that to an earlier
        SYNC, with old values; these have come when no TPDO came for twice the time between two SYNCs."""
        ended = self._link.clock.deadline(2 * ANSWER_WITHIN_S)
        while not ended.expired:
            heard_ns = self.heard_ns
            if not self._link.wait(lambda heard_ns=heard_ns: self.heard_ns != heard_ns, 2 * self._timeout_s):  # type: ignore[misc]
                return self._answered(send=True)
        return False

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
        self.asked_ns = self._link.clock.now_ns()
        if send:
            self._link.send(SYNC, b"")
        answered = self._link.wait(self._complete, self._timeout_s)
        if self._short_tpdo is not None:
            raise self._short_tpdo
        return answered

    def _settled(self) -> bool:
        """As `settle`; a drive whose TPDOs cannot be switched off answers every SYNC."""
        try:
            return self.settle()
        except AbortError:
            return self.by_own_sync

    def _read(self) -> None:
        self.asked_ns = self._link.clock.now_ns()
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
            self.heard_ns = time_ns
            self._awaited.discard(cob_id)  # last: another thread may wait for it

        return receive
