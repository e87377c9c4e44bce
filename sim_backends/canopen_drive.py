"""A simulated CiA-402 drive on a CAN bus, over a simulated servo: its network functions (CiA-301).

NMT, heartbeat, SYNC and EMCY; SDO, PDO, dictionary and device profile have a module each, `canopen_station` puts the drive on a bus.
Frames come in through `on_frame`, time through `tick`, frames leave through `send`; there is no
thread and no clock inside, so the same drive runs on the simulated wire, on python-can's virtual bus and on a real one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum
from pathlib import Path

from drivers.errors import InputError
from sim_backends.canopen_dictionary import Dictionary, Item, Key, RefusedError, load_items
from sim_backends.canopen_pdo_engine import PdoEngine
from sim_backends.canopen_profile import DriveProfile
from sim_backends.canopen_sdo_server import SdoServer
from sim_backends.canopen_store import Flash, ParameterStore
from sim_backends.canopen_table import TableObjects, table_items
from sim_backends.own_table import TableForm
from sim_backends.servo import SimulatedServo

EDS = Path(__file__).with_name("servo_drive.eds")
PDO_LENGTH_ERROR = 0x8210
HEARTBEAT_ERROR = 0x8130
SYNC_ERROR = 0x8700
MISSING_SYNCS = 5
SUPERVISION_NS = 20_000_000  # longest interval at which the drive's firmware checks the servo


Send = Callable[[int, bytes], None]
"""send(cob_id, data): puts a frame on the bus."""


class NmtState(IntEnum):
    """NMT state as the heartbeat shows it (CiA-301, 7.2.8.3.2)."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class CanOpenSlave:
    """One simulated drive with its node id.

    parameters: {(index, subindex): value} laid over the EDS's defaults, as factory
    settings for a certain machine. flash: its non-volatile memory; a fresh one where None. table: the correction
    table of the drive itself, beside the EDS's objects. Raises InputError for a node id outside 1…127.
    """

    def __init__(
        self,
        servo: SimulatedServo,
        node_id: int,
        send: Send,
        *,
        parameters: Mapping[tuple[int, int], int] | None = None,
        eds: Path = EDS,
        flash: Flash | None = None,
        table: TableForm | None = None,
    ) -> None:
        if not 1 <= node_id <= 127:
            raise InputError(f"node id is {node_id}, expected 1 to 127")
        self.servo = servo
        self.node_id = node_id
        own = {} if table is None else table_items(table)
        self.dictionary = self._made_dictionary(eds, own)
        for (index, subindex), value in (parameters or {}).items():
            self.dictionary.set_number(index, subindex, value)
        self._send = send
        self.nmt_state = NmtState.BOOT_UP
        self.profile = self._made_profile(servo)
        self.table = None if table is None else TableObjects(self.dictionary, table, lambda: servo.powered)
        if self.table is not None:
            servo.table.follow(self.table.table)
        self.pdos = self._made_pdos()
        self.sdo = SdoServer(self.dictionary)
        self.store = ParameterStore(self.dictionary, flash if flash is not None else Flash(), lambda: not servo.powered)
        self._owed: list[tuple[int, bytes]] = []  # answers delayed until the memory is written
        self._now_ns = 0
        self._heartbeat_ns: int | None = None
        self._sync_ns: int | None = None  # time of the last SYNC
        self._guarded: dict[int, int] = {}  # node id -> time of its last heartbeat
        self._guard_lost: set[int] = set()
        self._asked_ns: int | None = None  # time of the master's last guarding request
        self._toggle = 0
        self._error_register = 0
        self.dictionary.on_read(0x1001, 0, lambda: self._error_register)
        self.dictionary.on_write(0x1003, 0, self._clear_history)
        self.dictionary.on_write(0x1017, 0, self._restart_heartbeat)
        for index in (0x1006, 0x6060):
            self.dictionary.on_write(index, 0, self._restart_sync_watch)

    # -- parts, for a drive with another dictionary ----------------------------------------------------------------------
    def _made_dictionary(self, eds: Path, own: Mapping[Key, Item]) -> Dictionary:
        return Dictionary({**load_items(eds, self.node_id), **own})

    def _made_profile(self, servo: SimulatedServo) -> DriveProfile:
        if (0x2201, 0) in self.dictionary.items:
            servo.backlash.follow(
                lambda: float(self.dictionary.number(0x2201)), lambda: bool(self.dictionary.number(0x2202))
            )
        return DriveProfile(self.dictionary, servo, self.emergency)

    def _made_pdos(self) -> PdoEngine:
        return PdoEngine(self.dictionary, self._transmit, self._on_short_pdo)

    def _on_short_pdo(self) -> None:
        self.emergency(PDO_LENGTH_ERROR)

    # -- power and time ------------------------------------------------------------------------------------------------
    def boot(self, now_ns: int) -> None:
        """Start after power on or a reset: boot-up message, then pre-operational."""
        self._now_ns = now_ns
        self.sdo.reset()
        self._owed.clear()
        storage_error = self.store.start()
        self.profile.reset()
        if self.table is not None:
            self.table.start()
        self.pdos.reload()
        self._guarded.clear()
        self._guard_lost.clear()
        self._asked_ns, self._toggle = None, 0
        self._error_register = 0
        self._transmit(0x700 + self.node_id, bytes((NmtState.BOOT_UP,)))
        self.nmt_state = NmtState.PRE_OPERATIONAL
        self._restart_heartbeat(self.dictionary.number(0x1017))
        if storage_error:
            self.emergency(storage_error)

    def lose_power(self, now_ns: int) -> None:
        """Cut the supply until `boot`: the axis coasts, a store in progress stays incomplete."""
        self.store.tick(now_ns)
        self.store.power_lost()
        self._owed.clear()
        self.profile.lose_power()

    def tick(self, now_ns: int) -> None:
        """Advance to now_ns: supervise, send what is due."""
        self._now_ns = now_ns
        self.profile.tick(now_ns)
        self.store.tick(now_ns)
        while self._owed and not self.store.busy:
            self._transmit(*self._owed.pop(0))
        if self.nmt_state is NmtState.OPERATIONAL:
            self.pdos.tick(now_ns)
        while self._heartbeat_ns is not None and now_ns >= self._heartbeat_ns:
            self._heartbeat_ns += 1_000_000 * max(1, self.dictionary.number(0x1017))
            self._transmit(0x700 + self.node_id, bytes((self.nmt_state,)))
        if self._guarded:
            self._watch_heartbeats()
        if self._asked_ns is not None:
            self._watch_guarding(self._asked_ns)
        if self._sync_ns is not None and self.profile.cyclic:
            self._watch_sync(self._sync_ns)

    def due_ns(self) -> int | None:
        """Latest time of the next `tick`, ns; None when nothing is scheduled."""
        times = [self._heartbeat_ns, self.store.due_ns()]
        period_ns = 1000 * self.dictionary.number(0x1006)
        if period_ns and self._sync_ns is not None and self.profile.cyclic:
            times.append(self._sync_ns + (MISSING_SYNCS + 1) * period_ns)
        return min((time_ns for time_ns in times if time_ns is not None), default=None)

    def _transmit(self, cob_id: int, data: bytes) -> None:
        self._send(cob_id, data)

    # -- frames --------------------------------------------------------------------------------------------------------
    def on_frame(self, cob_id: int, data: bytes, now_ns: int) -> None:
        """Handle a frame from the bus."""
        if now_ns > self._now_ns:
            self.tick(now_ns)
        if cob_id == 0x000:
            self._on_nmt(data)
        elif cob_id == self.dictionary.number(0x1005) & 0x7FF:
            self._sync_ns = now_ns
            if self.nmt_state is NmtState.OPERATIONAL:
                self.pdos.on_sync(now_ns)
        elif cob_id == 0x600 + self.node_id:
            if self.nmt_state is not NmtState.STOPPED:
                for answer in self.sdo.handle(data):
                    if self.store.busy:
                        self._owed.append((0x580 + self.node_id, answer))
                    else:
                        self._transmit(0x580 + self.node_id, answer)
        elif cob_id & 0x780 == 0x700:
            self._on_heartbeat(cob_id & 0x7F)
        elif self.nmt_state is NmtState.OPERATIONAL:
            self.pdos.on_frame(cob_id, data)

    def _on_nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        command = data[0]
        if command == 0x01:
            self.nmt_state = NmtState.OPERATIONAL
        elif command == 0x02:
            self.nmt_state = NmtState.STOPPED
            self.profile.abort_connection()
        elif command == 0x80:
            self.nmt_state = NmtState.PRE_OPERATIONAL
        elif command in (0x81, 0x82):
            self.boot(self._now_ns)

    def on_remote(self, cob_id: int, now_ns: int) -> None:
        """Node guarding (CiA-301, 7.2.8.2.2): answer with the state and a bit that alternates, unless a heartbeat is produced."""
        if cob_id != 0x700 + self.node_id or self._heartbeat_ns is not None:
            return
        self._transmit(cob_id, bytes((self._toggle | self.nmt_state,)))
        self._toggle ^= 0x80
        self._asked_ns = now_ns

    def _watch_guarding(self, asked_ns: int) -> None:
        """Life guarding: the master has asked once, and then not within guard time (100Ch) times life factor (100Dh)."""
        if not {(0x100C, 0), (0x100D, 0)} <= self.dictionary.items.keys():
            return
        life_ns = 1_000_000 * self.dictionary.number(0x100C) * self.dictionary.number(0x100D)
        if life_ns and self._now_ns - asked_ns > life_ns:
            self._asked_ns = None
            self.emergency(HEARTBEAT_ERROR)
            self.profile.abort_connection()

    # -- heartbeats ----------------------------------------------------------------------------------------------------
    def _restart_heartbeat(self, period_ms: int) -> None:
        self._heartbeat_ns = self._now_ns + 1_000_000 * period_ms if period_ms else None

    def _on_heartbeat(self, node_id: int) -> None:
        for subindex in (1, 2):
            if self.dictionary.number(0x1016, subindex) >> 16 & 0x7F == node_id:
                self._guarded[node_id] = self._now_ns
                self._guard_lost.discard(node_id)

    def _watch_heartbeats(self) -> None:
        for subindex in (1, 2):
            setting = self.dictionary.number(0x1016, subindex)
            node_id, time_ns = setting >> 16 & 0x7F, 1_000_000 * (setting & 0xFFFF)
            heard_ns = self._guarded.get(node_id)
            if not time_ns or heard_ns is None or node_id in self._guard_lost:
                continue
            if self._now_ns - heard_ns > time_ns:
                self._guard_lost.add(node_id)
                self.emergency(HEARTBEAT_ERROR)
                self.profile.abort_connection()

    def _restart_sync_watch(self, _value: int) -> None:
        """For a new period or mode: SYNC is missed only after it has come once."""
        self._sync_ns = None

    def _watch_sync(self, last_ns: int) -> None:
        """Supervise set-points: with 1006h set, a drive in a cyclic mode goes into a fault when SYNC stops (8700h, sync
        controller)."""
        period_ns = 1000 * self.dictionary.number(0x1006)
        if period_ns and self._now_ns - last_ns > MISSING_SYNCS * period_ns:
            self._sync_ns = None
            self.servo.raise_fault(SYNC_ERROR)

    # -- emergencies ---------------------------------------------------------------------------------------------------
    def emergency(self, code: int) -> None:
        """Send an EMCY and keep it in 1003h; code 0: the error is gone."""
        self._error_register = 0 if code == 0 else 0x01 | _register_bit(code)
        if code:
            count = min(8, self.dictionary.number(0x1003, 0) + 1)
            for subindex in range(count, 1, -1):
                self.dictionary.set_number(0x1003, subindex, self.dictionary.number(0x1003, subindex - 1))
            self.dictionary.set_number(0x1003, 1, code)
            self.dictionary.set_number(0x1003, 0, count)
        cob_id = self.dictionary.number(0x1014)
        if not cob_id & 0x80000000 and self.nmt_state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL):
            self._transmit(cob_id & 0x7FF, code.to_bytes(2, "little") + bytes((self._error_register,)) + bytes(5))

    def _clear_history(self, value: int) -> None:
        if value:
            raise RefusedError(0x06090030)
        for subindex in range(1, 9):
            self.dictionary.set_number(0x1003, subindex, 0)


def _register_bit(code: int) -> int:
    """Error register 1001h: the bit of the error code's class (CiA-301, 7.5.2.2)."""
    classes = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0x8: 0x10}
    if code >> 8 == 0x86:
        return 0x20  # motion errors are device profile specific
    return classes.get(code >> 12, 0x80 if code >> 12 == 0xF else 0)
