"""Connection: the communication settings of a drive while it is open: PDOs, heartbeats both ways. `put_back` restores what was found.

These settings are not the user's parameters. Nothing here enables or moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from drivers.canopen import cia301
from drivers.canopen.node import HEARTBEAT, NmtCommand, NmtState, Node
from drivers.canopen.pdo import (
    COB_ID,
    EVENT,
    EXISTS_NOT,
    KIND,
    MAKERS_EVENT,
    SYNC_EVERY,
    Pdo,
    PdoSpec,
)
from drivers.canopen.pdo_setup import PdoRefusedError, PdoSetup, spec_of
from drivers.canopen.settings import CanOpenSettings
from drivers.canopen.sync import SYNC
from drivers.canopen.whole_pdo import PdoImage
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.cia402.wire import OBJECT_MISSING
from drivers.errors import AbortError, BridgeError, CapabilityError, InputError, ProtocolError
from drivers.undo import one_line, undo_all

QUICK_STOP_ON_ABORT = 3  # 6007h
MOST_CONSUMERS = 127  # of 1016h
SYNC_CHANGED = 0
"""Transmission type 0: taken at the next SYNC, sent at one only when it changed."""
KINDS = {SYNC_EVERY: (SYNC_EVERY, SYNC_CHANGED, EVENT, MAKERS_EVENT), EVENT: (EVENT, MAKERS_EVENT)}
"""Transmission types that serve in place of one that a drive refuses. A TPDO has to answer every SYNC: it has no other."""
OPTIONAL = (objects.TORQUE_ACTUAL, objects.VELOCITY_ACTUAL, objects.FOLLOWING_ERROR_ACTUAL)
"""Sampled objects that an axis can be moved without."""


class Connection:
    """One node's communication while a drive is open. notes: findings for the engineer, one sentence each."""

    def __init__(self, node: Node, settings: CanOpenSettings) -> None:
        self._link, self._sdo, self._monitor = node.link, node.sdo, node.monitor
        self._settings = settings
        self._pdos: PdoSetup | None = None
        self._dictionary = None if node.eds is None else node.eds.mappable_objects()
        self._before: list[tuple[Entry, int]] = []  # changed entries with their earlier values
        self.notes: list[str] = []
        self.stop_rpdo: PdoSpec | None = None
        """An RPDO that takes a controlword at once, without SYNC; None where the drive has or accepts no such RPDO."""
        self.mapped = False  # the drive's PDOs are the requested ones
        self.rpdo: PdoSpec | None = None
        """RPDO 1 as the drive accepted it; None where it accepts none: set-points can then not be streamed, see `no_stream`."""
        self.no_stream = ""
        self._guarding: Any = None  # the task that asks a guarded node

    def set_up(
        self,
        sampled: Sequence[PdoSpec],
        rpdo: PdoSpec | None,
        before_start: Callable[[Sequence[PdoSpec]], None] = lambda _sampled: None,
    ) -> None:
        """Map the TPDOs, the RPDO of set-points, and one more for the stop, as far as the drive lets them; start the node, supervise
        its heartbeat and let it consume ours. What a drive refuses is replaced by SDO and noted. rpdo: None for no PDOs at all.

        before_start: called with the TPDOs in force when the PDOs are mapped, and the node does not exchange them yet (unless it was
        operational before). Raises ProtocolError, InputError.
        """
        self.notes = []
        if rpdo is None:
            self.stop_rpdo = self.rpdo = None
            self.no_stream = "a further axis of a node goes by SDO"
            mapped: Sequence[PdoSpec] = ()
        else:
            mapped = self._map(tuple(sampled) if self._has_sync() else (), rpdo)
            if not mapped and self.no_stream == "":
                self.no_stream = "its feedback comes by SDO"
        self.mapped = True
        before_start(mapped)
        self._monitor.command(NmtCommand.START)
        if self._settings.heartbeat_s is not None:
            self._produce_heartbeat(self._settings.heartbeat_s)
        if self._settings.guard_s is not None and self._guarding is None:
            self._guard(self._settings.guard_s)

    def distrust(self, why: BridgeError) -> None:
        """Use no PDO: the drive has answered the mapping and keeps another one. They are switched off; `put_back` restores them.

        Raises as `set_up`."""
        undo_all([("", self._pdos.restore)] if self._pdos is not None else [])
        for image in [] if self._pdos is None else self._pdos.found:
            if image.pdo.transmit and image.exists:
                with suppress(AbortError):
                    self._set_for_now(image.pdo.setting(COB_ID), image.numbers[False, COB_ID] | EXISTS_NOT)
        self.stop_rpdo = self.rpdo = None
        self.no_stream = "its PDOs are not those that were set up"
        self.notes.append(
            f"{self._sdo.name} answers a mapping of its PDOs and keeps its own ({why}): it is sampled by SDO"
        )

    def _has_sync(self) -> bool:
        """Whether the drive knows SYNC (1005h). Raises ProtocolError for another identifier than the usual one."""
        try:
            identifier = self._sdo.read(cia301.SYNC_COB_ID) & 0x7FF
        except AbortError:
            self.notes.append(f"{self._sdo.name} has no SYNC (1005h): it is sampled by SDO")
            return False
        if identifier != SYNC:
            raise ProtocolError(f"{self._sdo.name}: {cia301.SYNC_COB_ID} is not {SYNC:03X}h")
        return True

    def _produce_heartbeat(self, period_s: float) -> None:
        """Ask the drive for a heartbeat; where it has none, the answers to the samples are its sign of life."""
        try:
            self._set_for_now(cia301.PRODUCER_HEARTBEAT, round(1000 * period_s))
        except AbortError as error:
            if self._guard_node(period_s):
                self.notes.append(f"{self._sdo.name} produces no heartbeat: {self._how_guarded()}")
            else:
                self.notes.append(
                    f"{self._sdo.name} produces no heartbeat ({error}): it counts as lost when a sample is not answered"
                )
            return
        self._monitor.expect_heartbeat(self._settings.heartbeat_grace * period_s)

    # -- node guarding, where there is no heartbeat ----------------------------------------------------------------------------
    def _guard_node(self, period_s: float) -> bool:
        """Ask for the node's state by remote frames (node guarding), which it watches in turn (life guarding: 100Ch times 100Dh).

        False, with nothing changed, where the drive has or takes no guard time."""
        already, guard_s = len(self._before), self._settings.guard_s
        factor = 0 if guard_s is None else min(255, max(2, math.ceil(guard_s / period_s)))
        try:
            self._set_for_now(cia301.GUARD_TIME, round(1000 * period_s))
            self._set_for_now(cia301.LIFE_FACTOR, factor)
        except AbortError:
            undo_all(self._steps_back(already))
            return False
        before = self._monitor.heartbeats
        self._guarding = self._link.request_periodically(HEARTBEAT + self._sdo.node_id, period_s)
        if not self._link.wait(lambda: self._monitor.heartbeats > before, self._settings.sample_timeout_s):
            self._end_guarding()  # the interface or the drive has no remote frames
            undo_all(self._steps_back(already))
            return False
        self._monitor.expect_heartbeat(self._settings.heartbeat_grace * period_s)
        return True

    def _how_guarded(self) -> str:
        """What node guarding does, as the end of a sentence."""
        if self._settings.guard_s is None:
            return "it is watched by node guarding (100Ch)"
        return "it is watched by node guarding, and by it watches its master (100Ch, 100Dh)"

    def _end_guarding(self) -> None:
        task, self._guarding = self._guarding, None
        if task is not None:
            task.stop()

    def _map(self, sampled: tuple[PdoSpec, ...], rpdo: PdoSpec) -> tuple[PdoSpec, ...]:
        """Map the TPDOs, the RPDO, and an event-driven RPDO 2 of 6040h alone for the stop; returns the TPDOs in force.

        Each refusal of the drive is answered by leaving out what it refuses: an object that is not needed, a transmission type for
        another one, a whole PDO. Without a TPDO of status and position the axis is sampled by SDO.
        """
        node_id = self._sdo.node_id
        stop = PdoSpec(2, False, 0x300 + node_id, EVENT, (objects.CONTROLWORD,), only_stops=True)
        wanted = {spec.pdo: spec for spec in (*sampled, rpdo, stop)}
        kinds = {spec.pdo: _kinds(spec) for spec in wanted.values()}
        for used in kinds.values():
            next(used)
        refusals: dict[Pdo, BridgeError] = {}
        refuse = True
        while True:
            self._pdos = PdoSetup(self._sdo, node_id, tuple(wanted.values()))
            try:
                self._pdos.apply(self._dictionary, refuse=refuse)
                break
            except PdoRefusedError as error:
                self._do_without(wanted, kinds, error)
                refusals[error.spec.pdo] = error
            except InputError as error:  # a set-point RPDO without the statusword sent is refused by the linter
                if rpdo.pdo in wanted and not any(spec.transmit for spec in wanted.values()):
                    refusals[rpdo.pdo] = error
                    del wanted[rpdo.pdo]
                elif refuse and refusals and all(spec.transmit for spec in wanted.values()):
                    refuse = False  # PDOs of the drive itself, which it does not let be changed, and that are not used
                else:
                    raise
            except (AbortError, ProtocolError) as error:  # of one that is in the way, or that reads back otherwise
                if not wanted:
                    raise
                last = next(reversed(wanted))
                refusals[last] = error
                other = next(kinds[last], None) if last == stop.pdo else None
                if other is None:
                    del wanted[last]
                else:
                    wanted[last] = replace(stop, kind=other)
        fixed = None if any(not spec.transmit for spec in wanted.values()) else self._fixed_stop()
        self.stop_rpdo = wanted.get(stop.pdo, fixed)
        self.rpdo = wanted.get(rpdo.pdo)
        in_force = tuple(wanted[spec.pdo] for spec in sampled if spec.pdo in wanted)
        if in_force and in_force[0].pdo != sampled[0].pdo:
            in_force = ()
        self._note_pdos(refusals, sampled, in_force)
        return in_force

    def _do_without(
        self, wanted: dict[Pdo, PdoSpec], kinds: dict[Pdo, Iterator[int]], refused: PdoRefusedError
    ) -> None:
        """Leave out what was refused. Status and position go together: without them no TPDO is set up."""
        place = refused.spec.pdo
        spec = wanted[place]
        if refused.entry in OPTIONAL and len(spec.entries) > 1:
            wanted[place] = replace(spec, entries=tuple(entry for entry in spec.entries if entry != refused.entry))
        elif refused.kind and (kind := next(kinds[place], None)) is not None:
            wanted[place] = replace(spec, kind=kind)
        else:
            del wanted[place]
            if objects.STATUSWORD in spec.entries:
                for other in [other for other, found in wanted.items() if found.transmit]:
                    del wanted[other]

    def _fixed_stop(self) -> PdoSpec | None:
        """An RPDO of the drive as it is that carries 6040h alone and acts at once."""
        images: Sequence[PdoImage] = () if self._pdos is None else self._pdos.found
        for image in images:
            alone = image.mapped == (objects.CONTROLWORD.mapping,)
            if alone and not image.pdo.transmit and image.exists and image.numbers[False, KIND] >= MAKERS_EVENT:
                return replace(spec_of(image), only_stops=True)
        return None

    def _note_pdos(
        self, refusals: dict[Pdo, BridgeError], sampled: tuple[PdoSpec, ...], in_force: tuple[PdoSpec, ...]
    ) -> None:
        """What is used instead of what the drive refused, one sentence each."""
        name = self._sdo.name
        if not in_force and sampled:
            why = refusals.get(sampled[0].pdo)
            self.notes.append(f"{name} is sampled by SDO, as it takes no TPDO of status and position ({why})")
        elif sampled:
            kept = {entry for spec in in_force for entry in spec.entries}
            lost = [entry for spec in sampled for entry in spec.entries if entry not in kept]
            if lost:
                self.notes.append(f"{name} does not map {', '.join(str(entry) for entry in lost)}: left out")
        if self.rpdo is None:
            why = refusals.get(Pdo.numbered(1, transmit=False))
            self.no_stream = f"it takes no RPDO of set-points ({why})"
        if self.stop_rpdo is None:
            how = "by SDO alone" if self.rpdo is None else "by RPDO 1, which waits for SYNC, and by SDO"
            why = refusals.get(Pdo.numbered(2, transmit=False))
            self.notes.append(f"{name} takes no event-driven RPDO 2 ({why}): a stop goes {how}")

    def put_back(self, *, unwatched: bool = True) -> None:
        """Restore everything that was found; the node is pre-operational afterwards. Every step is tried, see `undo_all`.

        unwatched: the drive stops consuming our heartbeat too. Not for an axis that may still move: it stops once our heartbeat ends.
        """
        self.stop_rpdo, self.mapped = None, False
        pdos: list[tuple[str, Callable[[], None]]] = [] if self._pdos is None else [("", self._pdos.restore)]
        undo_all(
            [
                ("node not pre-operational", partial(self._monitor.command, NmtCommand.PRE_OPERATIONAL)),
                *pdos,
                *(self._steps_back(0) if unwatched else ()),
                *([("", self._end_guarding)] if unwatched else ()),
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
            if self._guards_instead():
                return
            self.notes.append(
                f"{self._sdo.name} does not watch its master ({one_line(error)}): when this process or the cable dies,"
                " it goes on with the move it was given"
            )
            return
        self._link.produce_heartbeat(master_id, guard_s / 4)
        self._link.send(
            HEARTBEAT + master_id, bytes((NmtState.OPERATIONAL,))
        )  # a drive starts to supervise with the first one

    def _guards_instead(self) -> bool:
        """Node guarding in place of the heartbeat, for a drive that watches its master by it alone; False where it cannot."""
        period_s = self._settings.heartbeat_s
        if period_s is None or self._sdo.node_id == self._settings.master_id:
            return False
        try:
            self._sdo.read(cia301.CONSUMER_COUNT)
        except AbortError:
            pass
        else:
            return False  # it could watch a heartbeat, and does not for another reason
        try:
            self._sdo.write(cia301.PRODUCER_HEARTBEAT, 0)  # a node that produces a heartbeat is not guarded
        except AbortError:
            return False  # without a heartbeat, guarding was tried before
        if not self._guard_node(period_s):
            self._sdo.write(cia301.PRODUCER_HEARTBEAT, round(1000 * period_s))
            return False
        self.notes.append(f"{self._sdo.name} consumes no heartbeat (1016h): {self._how_guarded()}")
        return True

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
        count = self._sdo.read(cia301.CONSUMER_COUNT)
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


def _kinds(spec: PdoSpec) -> Iterator[int]:
    """Transmission types that serve for a PDO, the best first."""
    return iter((spec.kind,) if spec.transmit else KINDS[spec.kind])
