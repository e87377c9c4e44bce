"""CanOpenDrive: a CiA-402 servo drive behind the `ServoDrive` abstraction.

Opens a CANopen node safely, leaves it as it was found, distributes its motions, and holds what is not motion (probe, parameters,
table). Sampling and stopping are in `stopping`, power states in `power`, moves in `motion`, homing in `homing`. One link may carry
several drives; the code that made the link closes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from drivers.canopen.connection import Connection
from drivers.canopen.correction_table import CanOpenCorrectionTable
from drivers.canopen.eds_text import summary
from drivers.canopen.homing import Homing
from drivers.canopen.identity import Identity, object_of, read_identity, stores_on_command, unit_objects
from drivers.canopen.kept_settings import KeptSettings
from drivers.canopen.modes import OperationModes
from drivers.canopen.motion import MotionParts, ProfileMotion
from drivers.canopen.named_parameters import NamedParameters
from drivers.canopen.node import NmtState
from drivers.canopen.own_limits import OwnLimits
from drivers.canopen.pdo import PdoSpec
from drivers.canopen.pdo_lint import Finding
from drivers.canopen.power import PowerStage
from drivers.canopen.sampling import Sampler, sampled_pdos
from drivers.canopen.settings import CanOpenSettings, HomingSettings
from drivers.canopen.stopping import StoppableNode
from drivers.canopen.stream import AxesBySync, OneAxisStream
from drivers.canopen.touch_probe import CanOpenTouchProbe
from drivers.cia402 import objects
from drivers.cia402.error_codes import error_text
from drivers.cia402.modes import Mode
from drivers.cia402.objects import Entry
from drivers.cia402.state_machine import Command, Status, decode_state
from drivers.cia402.units import motion_units, read_units, readings
from drivers.drive import (
    FAULTS,
    Capability,
    DriveSample,
    DriveState,
    DriveZero,
    HomingSpeeds,
    ServoDrive,
)
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    DriveFaultError,
    InputError,
    MotionTimeoutError,
    NoAnswerError,
    ProtocolError,
    StateError,
    TransportError,
)
from drivers.scaling import MotionScaling, ReportedScaling
from drivers.set_points import SetPointSettings
from drivers.shutdown import Left
from drivers.undo import undo_all

__all__ = ["CanOpenDrive", "CanOpenSettings", "HomingSettings", "Identity"]


STRAYS_MM = 1.0
"""How far outside its way an axis may be seen while it takes a set-point: more than moves overshoot, and than a load sags."""


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
        self.power = PowerStage(self.sdo, self.clock, self.settings.power, self.way_out)
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
            settings = self.settings
            self.units = motion_units(
                partial(self.sdo.read_if_shown, absent=None),
                self.scaling,
                velocity=settings.velocity_unit,
                acceleration=settings.acceleration_unit,
                vendor=self.identity.vendor_id
                if self.node.eds is None
                else self.node.eds.maker(self.identity.vendor_id),
            )
            self.sampler.specs = sampled_pdos(self.sdo, self.node_id)
            self.kept = KeptSettings(self.sdo)
            self.modes = OperationModes(self.sdo, self.kept, self.clock, settings.mode_timeout_s)
            self.modes.find(settings.modes, self.notes)
            self.own_limits = OwnLimits(self.sdo, self.kept, self.units, self._highest, self.notes)
            self.motion = ProfileMotion(
                MotionParts(
                    self.sdo, self.power, self.sampler, self.kept, self.modes, self.own_limits, self.units, self.notes
                ),
                self.clock,
                handshake_s=settings.handshake_timeout_s,
                strays=round(STRAYS_MM * self.scaling.counts_per_load_mm),
            )
            self.homing = Homing(self.sdo, self.power, self.motion, self.kept)
            self._has_probe = self.sdo.read_if_shown(objects.PROBE_FUNCTION, None) is not None
            self._stores = stores_on_command(self.sdo)
            self._note_ramps()
            if self.node.eds is not None:
                if not self.identity.vendor_id:
                    self.notes.append(
                        f"drive {self.name} reports no vendor (1018h:1): it is that of the maker's file (eds)"
                    )
                self.notes += self.node.eds.doubts(self.identity.vendor_id or None, self.identity.product_code or None)
                self.notes += [f"the maker's file (eds): {note}" for note in summary(self.node.eds.notes)]
            self.own_limits.note(self.limits.max_velocity_mm_s, self.limits.max_acceleration_mm_s2)
            self._set_up()
            self.notes += self.connection.notes
            self._note_modes()
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

    def _note_modes(self) -> None:
        """What stands in for a mode that the drive lacks."""
        mode = self.modes.streaming
        if mode is None:
            return
        named = mode.name.lower().replace("_", " ")
        if not self.modes.has(Mode.PROFILE_POSITION):
            self.notes.append(
                f"drive {self.name} has no profile position: it is moved by set-points ({named}), one with every second sample, and"
                " holds the last one when none comes"
            )
        if self.connection.no_stream:
            self.notes.append(f"drive {self.name}: set-points are not streamed: {self.connection.no_stream}")
        elif mode is Mode.INTERPOLATED_POSITION:
            self.notes.append(
                f"drive {self.name} has no cyclic synchronous position: streams use interpolated position (60C1h)"
            )

    def _require_units(self) -> None:
        """Raise CapabilityError before motion where the drive's units of it are not known."""
        if self.units.ambiguous:
            raise CapabilityError(f"drive {self.name} cannot be moved: {self.units.ambiguous}")

    @property
    def pdo_findings(self) -> list[Finding]:
        """Findings of the PDO linter when the PDOs were set up."""
        self._require_open()
        return self.connection.pdo_findings

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

    def _answers(self) -> bool:
        try:
            self.sdo.read_if_shown(objects.STATUSWORD, 0)
        except TransportError:
            return False
        except BridgeError:
            return True
        return True

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

    def reported_scaling(self) -> tuple[ReportedScaling, ...]:
        """Units by 608Fh, 6091h, 6092h and 60A8h."""
        self._require_open()
        return readings(read_units(self.sdo))

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

    def motion_scaling(self) -> MotionScaling:
        """Units by the axis file, 60A9h and 60AAh, 608Bh to 608Eh, 6094h to 6097h, the maker's manual or the standard."""
        self._require_open()
        return self.units

    # -- zero, warnings, errors ------------------------------------------------------------------------------------------
    def zero(self) -> DriveZero:
        """Zero by 6098h and 607Ch as the next homing will use them, and 1018h."""
        self._require_open()
        asked, sdo, identity = self.settings.homing, self.sdo, self.identity
        method, home_mm = asked.method, asked.home_position_mm
        if self.modes.has(Mode.HOMING):
            method = sdo.read(objects.HOMING_METHOD) if method is None else method
            home_mm = (
                self.scaling.load_mm(self.sdo.read_if_shown(objects.HOME_OFFSET, 0)) if home_mm is None else home_mm
            )
        facts: dict[str, int | str] = {}
        if identity is not None:
            facts = {"vendor": identity.vendor_id, "product": identity.product_code, "serial": identity.serial}
        return DriveZero(method, home_mm, facts)

    def homing_speeds(self) -> HomingSpeeds:
        """Of the axis file, else of 6099h in the drive's unit of velocity."""
        self._require_open()
        asked, scaling = self.settings.homing, self.scaling

        def speed(stated: float | None, entry: objects.Entry) -> float | None:
            if stated is not None or self.units.ambiguous:
                return stated
            return self.units.mm_s(self.sdo.read_if_shown(entry, 0)) or None

        return HomingSpeeds(
            speed(asked.speed_switch_mm_s, objects.HOMING_SPEED_SWITCH),
            speed(asked.speed_zero_mm_s, objects.HOMING_SPEED_ZERO),
            scaling.encoder_counts_per_motor_rev * scaling.resolution_load_mm,
            None
            if self.units.ambiguous
            else self.units.mm_s2(self.sdo.read_if_shown(objects.HOMING_ACCELERATION, 0)) or None,
        )

    def says_homed(self) -> bool | None:
        """6041h bit 12 in homing mode, which a disabled drive is put into; a drive may have forgotten it with the change of mode."""
        self._require_open()
        if self.homing.homed is not None or not self.modes.has(Mode.HOMING):
            return self.homing.homed
        if decode_state(self.sdo.read(objects.STATUSWORD)) is DriveState.SWITCH_ON_DISABLED:
            self.set_mode(Mode.HOMING, until_enabled=True)
            if self.modes.is_shown():
                self.homing.believe(self.sdo.read(objects.STATUSWORD))
        return self.homing.homed

    def fault_text(self, code: int) -> str:
        """As the standard has it (CiA 301, CiA 402)."""
        return error_text(code)

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
            self._parameters = NamedParameters(self.node, self.units)
        return self._parameters

    @property
    def correction_table(self) -> CanOpenCorrectionTable | None:
        """The table by the map that the drive was given; None without one."""
        self._require_open()
        return None if self.node.table is None else CanOpenCorrectionTable(self.node, self.node.table)

    def _stream(self, settings: SetPointSettings) -> OneAxisStream:
        return OneAxisStream(self, settings)

    def _stream_with(self, others: Sequence[ServoDrive], settings: SetPointSettings) -> AxesBySync:
        in_step = [self, *(drive for drive in others if isinstance(drive, CanOpenDrive) and drive.link is self.link)]
        if len(in_step) <= len(others):
            names = ", ".join(drive.name for drive in (self, *others))
            raise CapabilityError(
                f"drives {names} are not all on one CAN bus, so that no SYNC could pace them together"
            )
        return AxesBySync(in_step, settings)

    # -- enabling --------------------------------------------------------------------------------------------------------
    def _enable(self) -> None:
        self.power.stopped = False
        self.way_out.over()
        self._require_units()
        self.set_mode(self.modes.resting, until_enabled=True)
        if self.power.state() is DriveState.QUICK_STOP and self._quick_stop_holds():
            with self._no_motion_after_errors():
                if not self._comes(self._rests(), self.settings.power.stop_s):
                    raise MotionTimeoutError(f"drive {self.name}: still moving in quick stop, not enabled")
                self.power.resume_from_quick_stop(self.motion.stay)
            return
        try:
            self.power.enable(self.motion.stay)
            self.modes.confirm()
        except BaseException as error:
            # a brake that opens later would complete an enabling that was given up
            self._send(Command.DISABLE_VOLTAGE.word)
            with self.way_out.step(last=False):
                undo_all([("", partial(self.power.write, Command.DISABLE_VOLTAGE.word))], during=error)
            raise

    def reset_fault(self) -> None:
        """Send the rising edge of the reset bit; the axis stays disabled. Raises DriveFaultError when the cause is still there."""
        self._require_open()
        self.power.reset_fault()

    # -- modes and profile moves -----------------------------------------------------------------------------------------
    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        self.homing.under_way = False
        self._require_units()
        velocity = self.units.velocity_units(velocity_mm_s)
        self.own_limits.check_velocity(velocity)
        with self._no_motion_after_errors():
            self.motion.move(
                self.scaling.motor_counts(position_load_mm),
                velocity,
                self.units.acceleration_units(self.limits.max_acceleration_mm_s2),
            )

    # -- homing ----------------------------------------------------------------------------------------------------------
    def _start_homing(self) -> None:
        self._require_units()
        with self._no_motion_after_errors():
            self.homing.start(self.settings.homing, self.units)

    def home(self, timeout_s: float, *, attempts: int = 1) -> DriveSample:
        """Home and wait for it, at most `timeout_s` seconds per attempt; a homing that fails is repeated, `attempts` times in all.

        Raises DriveFaultError after the last failure, MotionTimeoutError when an attempt does not end in time (the axis is stopped).
        """
        for attempt in range(1, max(1, attempts) + 1):
            self.start_homing()
            try:
                return self.wait_for(lambda sample: sample.homed is True or sample.state in FAULTS, timeout_s, "homed")
            except DriveFaultError:
                if attempt >= attempts:
                    raise
            except MotionTimeoutError:
                self.quick_stop()
                raise
        raise StateError(f"drive {self.name}: homing was given no attempt")
