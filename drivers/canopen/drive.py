"""CanOpenDrive: a CiA-402 servo drive behind the `ServoDrive` abstraction.

Opens a CANopen node safely, leaves it as it was found, distributes its motions, and holds what is not motion (probe, parameters,
table). Sampling and stopping are in `stopping`; power states, moves and homing in `drivers.cia402`. One link may carry
several drives; the code that made the link closes it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from drivers.canopen import cia301
from drivers.canopen.connection import Connection
from drivers.canopen.correction_table import CanOpenCorrectionTable
from drivers.canopen.eds_text import summary
from drivers.canopen.identity import Identity, object_of, read_identity, unit_objects
from drivers.canopen.node import NmtState
from drivers.canopen.pdo import PdoSpec
from drivers.canopen.raw_parameters import CanOpenRawParameters
from drivers.canopen.sampling import Sampler, sampled_pdos
from drivers.canopen.settings import CanOpenSettings
from drivers.canopen.side_by_side import CanLine
from drivers.canopen.stopping import StoppableNode
from drivers.canopen.stream import CyclicStream
from drivers.canopen.touch_probe import CanOpenTouchProbe
from drivers.cia402 import objects
from drivers.cia402.homing import HomingSettings
from drivers.cia402.modes import Mode
from drivers.cia402.objects import Entry
from drivers.cia402.state_machine import Status
from drivers.drive import (
    Capability,
    ServoDrive,
)
from drivers.errors import (
    AbortError,
    InputError,
    NoAnswerError,
    ProtocolError,
    StateError,
)
from drivers.named_parameters import NamedParameters
from drivers.set_points import SetPointSettings
from drivers.shutdown import Left
from drivers.undo import undo_all

__all__ = ["CanOpenDrive", "CanOpenSettings", "HomingSettings", "Identity"]


class CanOpenDrive(StoppableNode):
    """One node as a drive. identity: of the device, known once open."""

    identity: Identity | None = None
    _has_probe = _stores = False
    _parameters: NamedParameters | None = None

    # -- connection ------------------------------------------------------------------------------------------------------
    @property
    def is_open(self) -> bool:
        return self._open

    def open(self) -> None:
        """Find the node, read its identity and capabilities, map the PDOs, supervise its heartbeat. Nothing is enabled or moved.

        Raises StateError when it is open already, InputError for a travel that 32 bits do not hold in counts, ProtocolError for a node
        that is no CiA-402 drive, TransportError, AbortError."""
        if self._open:
            raise StateError(f"drive {self.name} is already open")
        for place in (*self.limits.ends_mm, self.settings.homing.home_position_mm or 0.0):
            if what := self.scaling.unheld(place):
                raise InputError(f"drive {self.name}: an end of its travel, or its home position, {what}")
        self.way_out.over()
        self.node.open(self.settings.sdo_timeout_s, self.settings.axis, self.way_out)
        self.sdo, self.monitor = self.node.sdo, self.node.monitor
        self.sampler = Sampler(self.node, self.settings.sample_timeout_s)
        self._stream_axis = None
        self.notes = []
        self.connection = Connection(self.node, self.settings)
        try:
            self.link.listen()
            try:
                self.identity = read_identity(self.sdo)
            except NoAnswerError as error:
                if self.monitor.state is not NmtState.STOPPED:
                    raise
                raise NoAnswerError(
                    f"{error}; its heartbeat says NMT stopped, where a node answers no SDO: start it"
                ) from error
            self.monitor.expect_heartbeat(math.inf)  # what was read before a restart may not hold after it
            self.sampler.specs = sampled_pdos(self.sdo, self.node_id)
            vendor, eds = self.identity.vendor_id, self.node.eds
            self._take_up(self.sdo, self.sampler, vendor if eds is None else eds.maker(vendor))
            self._has_probe = self.sdo.read_if_shown(objects.PROBE_FUNCTION, None) is not None
            self._stores = bool(self.sdo.read_if_shown(cia301.STORE_ALL, 0) & cia301.ON_COMMAND)
            if eds is not None:
                if not vendor:
                    self.notes.append(
                        f"drive {self.name} reports no vendor (1018h:1): it is that of the maker's file (eds)"
                    )
                self.notes += eds.doubts(vendor or None, self.identity.product_code or None)
                self.notes += [f"the maker's file (eds): {note}" for note in summary(eds.notes)]
            self._set_up()
            self.notes += self.connection.notes
            self._note_streams()
            self._open = True
            self.sample()
        except BaseException as error:
            with self.way_out.step(last=True):
                undo_all([("", self.connection.put_back)], during=error)
            self._release()
            raise

    def _set_up(self) -> None:
        """Set up PDOs and heartbeats, and SYNC as its owner needs."""

        def settle(sampled: Sequence[PdoSpec]) -> None:
            self.sampler.mapped(sampled)
            self.sampler.subscribe()
            with suppress(AbortError):  # a drive whose TPDOs cannot be switched off answers every SYNC
                self.sampler.settle()

        self.connection.set_up(self.sampler.specs, self.rpdo if self.settings.axis == 1 else None, settle)
        try:
            self.sampler.prove()
        except ProtocolError as error:
            self.sampler.unsubscribe()
            self.sampler.mapped(())
            self.connection.distrust(error)

    def _highest(self, entry: Entry) -> float | None:
        """The largest value of an object by its maker's file; None without a file, or a limit in it."""
        if self.node.eds is None:
            return None
        found = self.node.eds.entries.get((self.sdo.index_of(entry), entry.subindex))
        return None if found is None else found.high

    def _note_streams(self) -> None:
        """Why set-points are not streamed, or what stands in for cyclic synchronous position."""
        if self.modes.streaming is None:
            return
        if self.connection.no_stream:
            self.notes.append(f"drive {self.name}: set-points are not streamed: {self.connection.no_stream}")
        elif self.modes.streaming is Mode.INTERPOLATED_POSITION:
            self.notes.append(
                f"drive {self.name} has no cyclic synchronous position: streams use interpolated position (60C1h)"
            )

    def _identity_facts(self) -> dict[str, int | str]:
        identity = self.identity
        if identity is None:
            return {}
        return {"vendor": identity.vendor_id, "product": identity.product_code, "serial": identity.serial}

    def close(self) -> None:
        """See `StoppableDrive.close`; works without the node's heartbeat, and over SDO or PDO alone."""
        if self._open:
            self.monitor.expect_heartbeat(None)  # a missing heartbeat must not prevent the stop
        super().close()

    def _put_back(self, left: Left) -> None:
        """Mode, speeds, ramps of a disabled axis, and the communication."""
        self.sdo.read(objects.STATUSWORD)  # without an answer each setting would cost a time-out of its own
        steps = [("", self.kept.put_back)] if left is Left.OFF else []
        communication = partial(self.connection.put_back, unwatched=left is not Left.UNKNOWN)
        undo_all([*steps, ("", communication)])

    def _ask(self) -> None:
        self.sdo.read(objects.STATUSWORD)

    def _release(self) -> None:
        self._open = False
        self.sampler.unsubscribe()
        self.node.close()

    @property
    def capabilities(self) -> frozenset[Capability]:
        """From 6502h and from the objects that answered; known once open."""
        self._require_open()
        found = {Capability.PARAMETERS}
        if self.modes.has(Mode.HOMING):
            found.add(Capability.HOMING)
        if self.modes.has(Mode.PROFILE_POSITION) or self.modes.streaming is not None:
            found.add(Capability.PROFILE_POSITION)
        if self.modes.streaming is not None and not self.connection.no_stream:
            found.add(Capability.STREAMING)
        if objects.TORQUE_ACTUAL in self.sampler.specs[0].entries:
            found.add(Capability.TORQUE_ACTUAL)
        if self._has_probe:
            found.add(Capability.TOUCH_PROBE)
        if self._stores:
            found.add(Capability.STORE)
        return frozenset(found)

    def unit_parameters(self) -> dict[str, int]:
        """608Fh, 6091h, 6092h, 6093h, 607Eh and 60A8h."""
        self._require_open()
        return unit_objects(self.sdo)

    def read_number(self, name: str) -> tuple[str, int | float]:
        """An object such as "2201h" or "2201h:01", whole and not negative, or a parameter by its name."""
        key = object_of(name)
        if key is None:
            return super().read_number(name)
        self._require_open()
        return f"{key[0]:04X}h:{key[1]:02X}", int.from_bytes(self.sdo.read_bytes(*key), "little")

    # -- warnings ------------------------------------------------------------------------------------------

    def complaints(self) -> tuple[str, ...]:
        """The warning bit of the last statusword, and the last emergency unless it reported that the errors are gone."""
        self._require_open()
        told = ["a warning (bit 7 of the statusword)"] if self.sampler.statusword & Status.WARNING else []
        if self.monitor.last_error_code():
            told.append(f"emergency: {self.monitor.log[-1]}")
        return tuple(told)

    # -- touch probe, parameters, table, streams -------------------------------------------------------------------------
    def _touch_probe(self) -> CanOpenTouchProbe:
        return CanOpenTouchProbe(self.node, self.scaling)

    @property
    def parameters(self) -> NamedParameters:
        """Parameters by the drive's EDS where one was given, and the standard's objects."""
        self._require_open()
        if self._parameters is None:
            self._parameters = NamedParameters(CanOpenRawParameters(self.node, CanLine(self.link), units=self.units))
        return self._parameters

    @property
    def correction_table(self) -> CanOpenCorrectionTable | None:
        """The table by the map that the drive was given; None without one."""
        self._require_open()
        return None if self.node.table is None else CanOpenCorrectionTable(self.node, self.node.table)

    def _stream(self, settings: SetPointSettings, others: Sequence[ServoDrive]) -> CyclicStream:
        return CyclicStream([self, *others], settings)
