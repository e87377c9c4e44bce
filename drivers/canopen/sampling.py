"""Fresh values of one drive: SYNC out, the synchronous TPDOs that answer it in.

What may go in: which values are sampled, and asking for them. While a stream owns SYNC the same values are read by SDO.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen import objects
from drivers.canopen.bus import CanLink, FrameHandler
from drivers.canopen.node import SYNC, NodeMonitor
from drivers.canopen.objects import Entry
from drivers.canopen.pdo import OBJECT_MISSING, SYNC_EVERY, PdoSpec
from drivers.canopen.sdo import SdoClient
from drivers.errors import AbortError, NoAnswerError, ProtocolError


def exists(sdo: SdoClient, entry: Entry) -> bool:
    """Whether the drive has this object."""
    try:
        sdo.read(entry)
    except AbortError as error:
        if error.code in OBJECT_MISSING:
            return False
        raise
    return True


def sampled_pdos(sdo: SdoClient, node_id: int) -> tuple[PdoSpec, ...]:
    """TPDO 1 with status, position and torque, TPDO 2 with velocity and following error; what a drive lacks is left out."""
    first = [objects.STATUSWORD, objects.POSITION_ACTUAL]
    if exists(sdo, objects.TORQUE_ACTUAL):
        first.append(objects.TORQUE_ACTUAL)
    second = [entry for entry in (objects.VELOCITY_ACTUAL, objects.FOLLOWING_ERROR_ACTUAL) if exists(sdo, entry)]
    specs = [PdoSpec(1, True, 0x180 + node_id, SYNC_EVERY, tuple(first))]
    if second:
        specs.append(PdoSpec(2, True, 0x280 + node_id, SYNC_EVERY, tuple(second)))
    return tuple(specs)


class Sampler:
    """The latest values of a drive, and the moment they came in."""

    def __init__(
        self, link: CanLink, sdo: SdoClient, monitor: NodeMonitor, specs: tuple[PdoSpec, ...], *, timeout_s: float
    ) -> None:
        self._link = link
        self._sdo = sdo
        self._monitor = monitor
        self.specs = specs
        self._timeout_s = timeout_s
        self.values: dict[Entry, int] = {}
        self.heard_ns = 0
        self.missed = 0  # SYNCs that were not answered in time
        self.by_sdo = False  # a stream owns SYNC
        self._awaited: set[int] = set()
        self._receivers: dict[int, FrameHandler] = {}

    @property
    def statusword(self) -> int:
        """As last heard."""
        return self.values[objects.STATUSWORD]

    @property
    def position_counts(self) -> int:
        """As last heard."""
        return self.values[objects.POSITION_ACTUAL]

    def subscribe(self) -> None:
        """Listen to the TPDOs."""
        for spec in self.specs:
            receiver = self._receivers[spec.cob_id] = self._receiver(spec)
            self._link.subscribe(spec.cob_id, receiver)

    def unsubscribe(self) -> None:
        """Stop listening."""
        for cob_id, receiver in self._receivers.items():
            self._link.unsubscribe(cob_id, receiver)
        self._receivers = {}

    def refresh(self) -> None:
        """Ask for all values now. Raises NoAnswerError when two SYNCs go unanswered, LinkLostError when the node is lost."""
        self._link.poll()
        self._monitor.check()
        if self.by_sdo:
            for spec in self.specs:
                for entry in spec.entries:
                    self.values[entry] = self._sdo.read(entry)
            self.heard_ns = self._link.clock.now_ns()
            return
        for _ in range(2):
            self._awaited = {spec.cob_id for spec in self.specs}
            self._link.send(SYNC, b"")
            if self._link.wait(self._complete, self._timeout_s):
                return
            self.missed += 1
            self._monitor.check()
        raise NoAnswerError(
            f"{self._sdo.name}: node {self._sdo.node_id} does not answer SYNC within {self._timeout_s:g} s"
        )

    def _complete(self) -> bool:
        return not self._awaited

    def _receiver(self, spec: PdoSpec) -> Callable[[int, bytes], None]:
        entries, codec, cob_id = spec.entries, spec.codec, spec.cob_id

        def receive(time_ns: int, data: bytes) -> None:
            if len(data) < codec.size:
                raise ProtocolError(f"{self._sdo.name}: {spec} came with {len(data)} bytes, {codec.size} are mapped")
            self.values.update(zip(entries, codec.unpack_from(data), strict=True))
            self._awaited.discard(cob_id)
            self.heard_ns = time_ns

        return receive
