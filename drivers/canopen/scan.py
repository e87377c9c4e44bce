"""Scan for nodes on a CAN bus by SDO reads, or by listening only. Nothing is written.

Reads standard objects of nodes that are not opened. A node is asked for its device type (1000h); any answer, a refusal included, shows
that it is there. Where another master works, its SDO transfers share the channel: use `listen` instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from drivers.canopen import cia301
from drivers.canopen.bus import CanLink
from drivers.canopen.node import HEARTBEAT, NmtState
from drivers.canopen.sdo import SdoClient, most_bytes
from drivers.canopen.side_by_side import CanLine
from drivers.cia402 import objects
from drivers.cia402.state_machine import decode_state
from drivers.drive import DriveState
from drivers.errors import AbortError, BridgeError, NoAnswerError, OtherAnswerError, ProtocolError
from drivers.raw_parameters import Steps

ALL_NODES = range(1, 128)
AT_ONCE = 8
"""Number of requests sent in a row: a CAN interface's queue holds ten frames by default."""

_DRIVE_PROFILE = 402
_QUIET_S = 0.0
"""Quiet time after a time-out, s. A scan only reads: a late answer is that of a read of the same object, or names another one and is
skipped."""
_NAME_BYTES = 256  # longest device name that is read
_IDENTITY = {
    "vendor_id": cia301.VENDOR_ID,
    "product_code": cia301.PRODUCT_CODE,
    "revision": cia301.REVISION,
    "serial": cia301.SERIAL_NUMBER,
    "device_name": cia301.DEVICE_NAME,
}
_DRIVE = {
    "statusword": objects.STATUSWORD,
    "position_counts": objects.POSITION_ACTUAL,
    "fault_code": objects.ERROR_CODE,
}
_FUNCTIONS = {
    0x080: "EMCY",
    0x180: "TPDO1",
    0x280: "TPDO2",
    0x380: "TPDO3",
    0x480: "TPDO4",
    0x580: "SDO answer",
    0x700: "heartbeat",
}
"""Identifiers that a node sends with by the pre-defined connection set (CiA-301, 7.3.5); other nodes may use them too."""


@dataclass(frozen=True)
class FoundNode:
    """One node. Values that it did not give are None; `heard`: frames received with its identifiers while the bus was watched.

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
    problem: str = ""
    """What it answered in place of its device type."""

    @property
    def profile(self) -> int | None:
        """Number of the device profile, 402 for a drive."""
        return None if self.device_type is None else self.device_type & 0xFFFF


class _FrameSorter:
    """Sorts received frames by the node that probably sent them."""

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
    """Nodes received within `duration_s` seconds, ascending; no frame is sent. Raises LinkLostError."""
    ear = _FrameSorter()
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
    """Ask every node id for its device type, and those that answer for further objects; ascending. Reads only.

    timeout_s: longest time for an answer, s; progress: called with the number of ids done. Nodes that do not answer but send frames
    are listed too: a stopped node answers no SDO.
    Raises LinkLostError when the bus does not take a frame, as without any other node to acknowledge it.
    """
    ear = _FrameSorter()
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
        if heard or node.answers_sdo or node.problem:
            found[node_id] = replace(node, heard=heard, nmt_state=ear.states.get(node_id))
    return [found[node_id] for node_id in sorted(found)]


def _ask(link: CanLink, node_ids: Sequence[int], timeout_s: float) -> dict[int, FoundNode]:
    """The nodes that answer, of a few."""
    clients = [
        SdoClient(link, node_id, f"node {node_id}", timeout_s=timeout_s, quiet_s=_QUIET_S) for node_id in node_ids
    ]
    try:
        answers = CanLine(link).run([_node(client) for client in clients])
    finally:
        for client in clients:
            client.close()
    nodes: dict[int, FoundNode] = {}
    for node in answers:
        if isinstance(node, BridgeError):
            raise node
        if node is not None:
            nodes[node.node_id] = node
    return nodes


def _node(client: SdoClient) -> Steps[FoundNode | None]:
    """What a node tells, None where it does not answer; after a missing answer it is asked no more. Raises LinkLostError."""
    try:
        device_type = yield from client.getting(cia301.DEVICE_TYPE, once=True)
    except OtherAnswerError as error:
        return FoundNode(client.node_id, problem=str(error))
    except NoAnswerError:
        return None
    except (AbortError, ProtocolError):
        device_type = None
    wanted = dict(_IDENTITY)
    if device_type is not None and device_type & 0xFFFF == _DRIVE_PROFILE:
        wanted |= _DRIVE
    told: dict[str, Any] = {}
    for name, entry in wanted.items():
        try:
            most = min(most_bytes(entry), _NAME_BYTES)
            told[name] = entry.unpack((yield from client.reading(entry.index, entry.subindex, most)))
        except (AbortError, ProtocolError):
            continue
        except NoAnswerError:
            break
    statusword = told.get("statusword")
    state = None if statusword is None else decode_state(statusword)
    told["fault_code"] = told.get("fault_code") or None
    return FoundNode(client.node_id, answers_sdo=True, device_type=device_type, state=state, **told)


def _nmt_state(data: bytes) -> NmtState | None:
    try:
        return NmtState(data[0] & 0x7F) if len(data) == 1 else None
    except ValueError:
        return None
