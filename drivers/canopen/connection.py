"""Connection: the communication settings of a drive while it is open: PDOs, heartbeats both ways. `put_back` restores what was found.

These settings are not the user's parameters. Nothing here enables or moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from drivers.canopen import objects
from drivers.canopen.node import HEARTBEAT, NmtCommand, NmtState, Node
from drivers.canopen.objects import DataType, Entry
from drivers.canopen.pdo import EVENT, MAKERS_EVENT, OBJECT_MISSING, PdoSpec
from drivers.canopen.pdo_lint import Finding
from drivers.canopen.pdo_setup import PdoSetup
from drivers.canopen.settings import CanOpenSettings
from drivers.canopen.sync import SYNC
from drivers.errors import AbortError, BridgeError, CapabilityError, ProtocolError
from drivers.undo import one_line, undo_all

QUICK_STOP_ON_ABORT = 3  # 6007h
MOST_CONSUMERS = 127  # of 1016h


class Connection:
    """One node's communication while a drive is open. notes: findings for the engineer, one sentence each."""

    def __init__(self, node: Node, settings: CanOpenSettings) -> None:
        self._link, self._sdo, self._monitor = node.link, node.sdo, node.monitor
        self._settings = settings
        self._pdos: PdoSetup | None = None
        self._dictionary = None if node.eds is None else node.eds.mappable_objects()
        self._before: list[tuple[Entry, int]] = []  # changed entries with their earlier values
        self.pdo_findings: list[Finding] = []
        self.notes: list[str] = []
        self.stop_rpdo: PdoSpec | None = None
        """An RPDO that takes a controlword at once, without SYNC; None where the drive has or accepts no such RPDO."""
        self.mapped = False  # the drive's PDOs are the requested ones

    def set_up(self, pdos: tuple[PdoSpec, ...], before_start: Callable[[], None] = lambda: None) -> None:
        """Map the PDOs, and one more for the stop; start the node, supervise its heartbeat and let it consume ours.

        before_start: called when the PDOs are mapped, and the node does not exchange them yet (unless it was operational before).
        Raises ProtocolError, AbortError, InputError.
        """
        self.notes = []
        self._map(pdos)
        self.mapped = True
        before_start()
        if self._sdo.read_or(objects.SYNC_COB_ID, SYNC) & 0x7FF != SYNC:
            raise ProtocolError(f"{self._sdo.name}: {objects.SYNC_COB_ID} is not {SYNC:03X}h")
        self._monitor.command(NmtCommand.START)
        if self._settings.heartbeat_s is not None:
            self._set_for_now(objects.PRODUCER_HEARTBEAT, round(1000 * self._settings.heartbeat_s))
            self._monitor.expect_heartbeat(self._settings.heartbeat_grace * self._settings.heartbeat_s)
        if self._settings.guard_s is not None:
            self._guard(self._settings.guard_s)

    def _map(self, pdos: tuple[PdoSpec, ...]) -> None:
        """Map them with an event-driven RPDO 2 of 6040h alone, for the stop; without it where the drive refuses."""
        node_id = self._sdo.node_id
        stop = PdoSpec(2, False, 0x300 + node_id, EVENT, (objects.CONTROLWORD,), only_stops=True)
        refused: BridgeError | None = None
        for kind in (EVENT, MAKERS_EVENT):
            self._pdos = PdoSetup(self._sdo, node_id, (*pdos, replace(stop, kind=kind)))
            try:
                self.pdo_findings = self._pdos.apply(self._dictionary)
            except (AbortError, ProtocolError) as error:
                refused = error
            else:
                self.stop_rpdo = replace(stop, kind=kind)
                return
        self.stop_rpdo = None
        self._pdos = PdoSetup(self._sdo, node_id, pdos)
        self.pdo_findings = self._pdos.apply(self._dictionary)
        self.notes.append(
            f"{self._sdo.name} takes no event-driven RPDO 2 ({refused}): a stop goes by RPDO 1, which waits for SYNC, and by SDO"
        )

    def put_back(self, *, unwatched: bool = True) -> None:
        """Restore everything that was found; the node is pre-operational afterwards. Every step is tried, see `undo_all`.

        unwatched: the drive stops consuming our heartbeat too. Not for an axis that may still move: it stops once our heartbeat ends.
        """
        self.stop_rpdo, self.mapped = None, False
        pdos = [] if self._pdos is None else [("", self._pdos.restore)]
        undo_all(
            [
                ("node not pre-operational", partial(self._monitor.command, NmtCommand.PRE_OPERATIONAL)),
                *pdos,
                *(self._steps_back(0) if unwatched else ()),
            ]
        )

    def _steps_back(self, kept: int) -> Sequence[tuple[str, Callable[[], None]]]:
        """The calls that restore the settings changed since there were `kept` of them, the last first."""
        changed = self._before[kept:][::-1]
        return [(f"{entry} not put back", partial(self._set_back, entry, value)) for entry, value in changed]

    def _set_back(self, entry: Entry, value: int) -> None:
        self._sdo.write(entry, value)
        self._before.remove((entry, value))

    def _set_for_now(self, entry: Entry, value: int) -> None:
        before = self._sdo.read(entry)
        if before != value:
            self._sdo.write(entry, value)
            self._before.append((entry, before))

    # -- the drive consumes our heartbeat ------------------------------------------------------------------------------------
    def _guard(self, guard_s: float) -> None:
        """Have the drive stop by itself when our heartbeat is missing for `guard_s`; a drive that cannot is left unchanged, with a
        note.

        1016h makes it notice, 6007h sets its reaction. Without 6007h (it is optional) it reacts as its manufacturer decided: CiA-301
        has it send the heartbeat error 8130h, and a CiA-402 drive goes through its fault reaction (605Eh) on a communication error.
        """
        master_id, already = self._settings.master_id, len(self._before)
        try:
            consumer = self._free_consumer(master_id)
            self._choose_reaction()
            self._set_for_now(consumer, master_id << 16 | round(1000 * guard_s))
        except (AbortError, CapabilityError) as error:
            undo_all(self._steps_back(already), during=error)
            self.notes.append(
                f"{self._sdo.name} does not watch its master ({one_line(error)}): when this process or the cable dies,"
                " it goes on with the move it was given"
            )
            return
        self._link.produce_heartbeat(master_id, guard_s / 4)
        self._link.send(
            HEARTBEAT + master_id, bytes((NmtState.OPERATIONAL,))
        )  # a drive starts to supervise with the first one

    def _choose_reaction(self) -> None:
        """Set 6007h to quick stop. A drive without it, or that does not let it be set, keeps its own reaction, which is noted."""
        try:
            self._set_for_now(objects.ABORT_OPTION, QUICK_STOP_ON_ABORT)
        except AbortError as error:
            why = "it has no 6007h" if error.code in OBJECT_MISSING else f"6007h cannot be set: {error}"
            self.notes.append(
                f"{self._sdo.name} watches its master, but its own reaction holds when this process or the cable dies"
                f" ({why}); most drives go into the fault 8130h and stop"
            )

    def _free_consumer(self, master_id: int) -> Entry:
        """The entry of 1016h that consumes our heartbeat already, or an unused one. Raises CapabilityError, AbortError."""
        if self._sdo.node_id == master_id:
            raise CapabilityError(f"{master_id} is its own node id")
        count = self._sdo.read(Entry(0x1016, 0, DataType.U8, "consumer heartbeat time"))
        free: Entry | None = None
        for subindex in range(1, min(count, MOST_CONSUMERS) + 1):
            entry = Entry(0x1016, subindex, DataType.U32, "consumer heartbeat time")
            setting = self._sdo.read(entry)
            if setting >> 16 & 0x7F == master_id:
                return entry
            if free is None and not (setting >> 16 & 0x7F and setting & 0xFFFF):
                free = entry
        if free is None:
            raise CapabilityError("every entry of 1016h watches another node")
        return free
