"""Who is on a CAN bus: asked by SDO, or only listened to. Nothing is ever written.

What may go in: reading standard objects of nodes nobody has opened. A node is asked for its device type (1000h); whoever answers,
be it with a refusal, is there. Where another master is at work, its SDO conversations share the channel: listen instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from drivers.canopen import objects
from drivers.canopen.bus import CanLink
from drivers.canopen.cia402 import decode_state
from drivers.canopen.node import HEARTBEAT, NmtState
from drivers.canopen.objects import Entry
from drivers.canopen.sdo import SdoClient, read_together
from drivers.drive import DriveState
from drivers.errors import AbortError, NoAnswerError, ProtocolError

ALL_NODES = range(1, 128)
AT_ONCE = 8
"""Requests sent in a row: a CAN interface's queue holds ten frames by default."""

_DRIVE_PROFILE = 402
_FUNCTIONS = {
    0x080: "EMCY",
    0x180: "TPDO1",
    0x280: "TPDO2",
    0x380: "TPDO3",
    0x480: "TPDO4",
    0x580: "SDO answer",
    0x700: "heartbeat",
}
"""Identifiers that a node sends with by the pre-defined connection set (CiA-301, 7.3.5); others may use them too."""


@dataclass(frozen=True)
class FoundNode:
    """One node. What it did not tell is None; `heard` is what arrived with its identifiers while the bus was watched.

    state and fault_code are those of a CiA-402 drive; statusword is 6041h as it came.
    """

    node_id: int
    answers_sdo: bool = False
    heard: tuple[str, ...] = ()
    nmt_state: NmtState | None = None
    device_type: int | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial: int | None = None
    device_name: str | None = None
    statusword: int | None = None
    state: DriveState | None = None
    position_counts: int | None = None
    fault_code: int | None = None

    @property
    def profile(self) -> int | None:
        """The device profile's number, 402 for a drive."""
        return None if self.device_type is None else self.device_type & 0xFFFF


class _Ear:
    """Sorts what comes over the bus by the node that it is likely from."""

    def __init__(self) -> None:
        self.heard: dict[int, list[str]] = {}
        self.states: dict[int, NmtState] = {}

    def __call__(self, _time_ns: int, cob_id: int, data: bytes) -> None:
        function, node_id = cob_id & 0x780, cob_id & 0x7F
        if not node_id or function not in _FUNCTIONS:
            return
        if function == HEARTBEAT:
            state = _nmt_state(data)
            if state is None:
                return
            self.states[node_id] = state
        names = self.heard.setdefault(node_id, [])
        if _FUNCTIONS[function] not in names:
            names.append(_FUNCTIONS[function])


def listen(link: CanLink, duration_s: float) -> list[FoundNode]:
    """Nodes that were heard within `duration_s`, ascending; not a frame is sent."""
    ear = _Ear()
    link.watch(ear)
    try:
        link.wait(lambda: False, duration_s)
    finally:
        link.unwatch(ear)
    return [
        FoundNode(node_id, heard=tuple(ear.heard[node_id]), nmt_state=ear.states.get(node_id))
        for node_id in sorted(ear.heard)
    ]


def scan(
    link: CanLink,
    node_ids: Iterable[int] = ALL_NODES,
    *,
    timeout_s: float = 0.1,
    progress: Callable[[int], None] = lambda _done: None,
) -> list[FoundNode]:
    """Ask every node id for its device type, and who answers for the rest; ascending. Reads only.

    timeout_s: how long an answer may take; progress: told how many ids are done. Those that do not answer but were heard are
    listed too: a node that is stopped speaks no SDO.
    Raises LinkLostError when the bus does not take a frame, as without any other node to acknowledge it.
    """
    ear = _Ear()
    link.watch(ear)
    wanted = sorted(set(node_ids))
    found: dict[int, FoundNode] = {}
    try:
        for first in range(0, len(wanted), AT_ONCE):
            found.update(_ask(link, wanted[first : first + AT_ONCE], timeout_s))
            progress(min(first + AT_ONCE, len(wanted)))
        link.poll()
    finally:
        link.unwatch(ear)
    for node_id in wanted:
        node = found.get(node_id, FoundNode(node_id))
        heard = tuple(name for name in ear.heard.get(node_id, ()) if name != "SDO answer")
        if heard or node.answers_sdo:
            found[node_id] = replace(node, heard=heard, nmt_state=ear.states.get(node_id))
    return [found[node_id] for node_id in sorted(found)]


def _ask(link: CanLink, node_ids: Sequence[int], timeout_s: float) -> dict[int, FoundNode]:
    """Those of a few nodes that answer."""
    clients = [SdoClient(link, node_id, f"node {node_id}", timeout_s=timeout_s) for node_id in node_ids]
    try:
        answers = read_together([(client, objects.DEVICE_TYPE) for client in clients], timeout_s)
        return {
            client.node_id: _details(client, answer if isinstance(answer, int) else None)
            for client, answer in zip(clients, answers, strict=True)
            if not isinstance(answer, NoAnswerError)
        }
    finally:
        for client in clients:
            client.close()


def _details(client: SdoClient, device_type: int | None) -> FoundNode:
    node = FoundNode(
        client.node_id,
        answers_sdo=True,
        device_type=device_type,
        vendor_id=_number(client, objects.VENDOR_ID),
        product_code=_number(client, objects.PRODUCT_CODE),
        revision=_number(client, objects.REVISION),
        serial=_number(client, objects.SERIAL_NUMBER),
        device_name=_text(client, objects.DEVICE_NAME),
    )
    if node.profile != _DRIVE_PROFILE:
        return node
    statusword = _number(client, objects.STATUSWORD)
    return replace(
        node,
        statusword=statusword,
        state=None if statusword is None else decode_state(statusword),
        position_counts=_number(client, objects.POSITION_ACTUAL),
        fault_code=_number(client, objects.ERROR_CODE) or None,
    )


def _number(client: SdoClient, entry: Entry) -> int | None:
    """An object's value; None where the node refuses it, does not answer, or answers something else."""
    try:
        return client.read(entry)
    except (AbortError, NoAnswerError, ProtocolError):
        return None


def _text(client: SdoClient, entry: Entry) -> str | None:
    try:
        return client.read_text(entry)
    except (AbortError, NoAnswerError, ProtocolError):
        return None


def _nmt_state(data: bytes) -> NmtState | None:
    try:
        return NmtState(data[0] & 0x7F) if len(data) == 1 else None
    except ValueError:
        return None
