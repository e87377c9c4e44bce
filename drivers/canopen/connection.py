"""What is set up in a drive for as long as we are connected: PDOs, heartbeats both ways. `put_back` leaves everything as it was found.

What may go in: communication settings that are not the user's parameters. Nothing here enables or moves.
"""

from __future__ import annotations

from contextlib import suppress

from drivers.canopen import objects
from drivers.canopen.bus import CanLink
from drivers.canopen.node import HEARTBEAT, SYNC, NmtCommand, NmtState, NodeMonitor
from drivers.canopen.objects import DataType, Entry
from drivers.canopen.pdo import PdoSpec
from drivers.canopen.pdo_lint import Dictionary, Finding
from drivers.canopen.pdo_setup import PdoSetup
from drivers.canopen.sdo import SdoClient
from drivers.canopen.settings import CanOpenSettings
from drivers.errors import AbortError, CapabilityError, ProtocolError

QUICK_STOP_ON_ABORT = 3  # 6007h
MOST_CONSUMERS = 127  # of 1016h


class Connection:
    """One node's communication while a drive is open. notes: what the engineer should know of it."""

    def __init__(
        self,
        link: CanLink,
        sdo: SdoClient,
        monitor: NodeMonitor,
        settings: CanOpenSettings,
        dictionary: Dictionary | None,
    ) -> None:
        self._link = link
        self._sdo = sdo
        self._monitor = monitor
        self._settings = settings
        self._pdos: PdoSetup | None = None
        self._dictionary = dictionary
        self._before: list[tuple[Entry, int]] = []  # what was changed, as it stood
        self.pdo_findings: list[Finding] = []
        self.notes: list[str] = []

    def set_up(self, pdos: tuple[PdoSpec, ...]) -> None:
        """Map the PDOs, start the node, supervise its heartbeat and have it watch ours."""
        self.notes = []
        self._pdos = PdoSetup(self._sdo, self._sdo.node_id, pdos)
        self.pdo_findings = self._pdos.apply(self._dictionary)
        if self._sdo.read_or(objects.SYNC_COB_ID, SYNC) & 0x7FF != SYNC:
            raise ProtocolError(f"{self._sdo.name}: {objects.SYNC_COB_ID} is not {SYNC:03X}h")
        self._monitor.command(NmtCommand.START)
        if self._settings.heartbeat_s is not None:
            self._set_for_now(objects.PRODUCER_HEARTBEAT, round(1000 * self._settings.heartbeat_s))
            self._monitor.expect_heartbeat(self._settings.heartbeat_grace * self._settings.heartbeat_s)
        if self._settings.guard_s is not None:
            self._guard(self._settings.guard_s)

    def put_back(self) -> None:
        """Everything as it was found; the node is pre-operational afterwards."""
        self._monitor.command(NmtCommand.PRE_OPERATIONAL)
        if self._pdos is not None:
            self._pdos.restore()
        while self._before:
            entry, value = self._before[-1]
            self._sdo.write(entry, value)
            self._before.pop()

    def _set_for_now(self, entry: Entry, value: int) -> None:
        before = self._sdo.read(entry)
        if before != value:
            self._sdo.write(entry, value)
            self._before.append((entry, before))

    # -- the drive watches us ----------------------------------------------------------------------------------------------
    def _guard(self, guard_s: float) -> None:
        """Have the drive stop by itself when it no longer hears us; a drive that cannot is left as it was, and noted."""
        master_id, already = self._settings.master_id, len(self._before)
        try:
            consumer = self._free_consumer(master_id)
            self._set_for_now(objects.ABORT_OPTION, QUICK_STOP_ON_ABORT)
            self._set_for_now(consumer, master_id << 16 | round(1000 * guard_s))
        except (AbortError, CapabilityError) as error:
            while len(self._before) > already:
                entry, value = self._before.pop()
                with suppress(AbortError):
                    self._sdo.write(entry, value)
            self.notes.append(
                f"{self._sdo.name} does not watch its master ({error}): when this process or the cable dies,"
                " it goes on with the move it was given"
            )
            return
        self._link.produce_heartbeat(master_id, guard_s / 4)
        self._link.send(HEARTBEAT + master_id, bytes((NmtState.OPERATIONAL,)))  # a drive guards from the first on

    def _free_consumer(self, master_id: int) -> Entry:
        """The entry of 1016h that watches us already, or one that watches nobody. Raises CapabilityError, AbortError."""
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
