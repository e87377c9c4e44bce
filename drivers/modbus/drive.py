"""ModbusDrive: any Modbus servo drive, driven by its register map alone.

There is no drive model in this file: states, transitions, hand-shakes and units come from a `DriveMap`. Fixed here are the rules for
every drive: the target is the actual position when power comes on; a fault is never left by enabling; a move that was not acknowledged
does not count as running; a start bit is never sent twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.clock import NS_PER_S, Clock
from drivers.drive import Capability, DriveSample, DriveState, DriveZero
from drivers.errors import (
    BridgeError,
    CapabilityError,
    MotionTimeoutError,
    StateError,
)
from drivers.limits import DriveLimits
from drivers.modbus.correction_table import ModbusCorrectionTable
from drivers.modbus.drive_map import DriveMap, StreamMap
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_facts import FactLedger, Proof
from drivers.modbus.needs import Needs
from drivers.modbus.raw_parameters import ModbusLine, ModbusRawParameters
from drivers.modbus.stopping import StoppableUnit
from drivers.modbus.touch_probe import ModbusTouchProbe
from drivers.modbus.wear import WearLedger
from drivers.modbus.word_order_evidence import judge_orders
from drivers.named_parameters import NamedParameters
from drivers.paced_stream import HostPacedDrive
from drivers.scaling import AxisScaling, ReportedScaling
from drivers.shutdown import Left
from drivers.undo import undo_all

ANSWERS = 3
"""Number of samples by which the time of an answer is judged: one alone may have been delayed by the host."""


class ModbusDrive(StoppableUnit, HostPacedDrive):
    """One unit on a link as a drive. Several drives may share the link; it is closed when the last of them closes.

    wear: where writes to the EEPROM are counted; ledger: where the facts of the map that were proven are kept.
    """

    def __init__(
        self,
        name: str,
        scaling: AxisScaling,
        limits: DriveLimits,
        clock: Clock,
        *,
        link: ModbusLink,
        unit: int,
        drive_map: DriveMap,
        wear: WearLedger | None = None,
        ledger: FactLedger | None = None,
    ) -> None:
        super().__init__(name, scaling, limits, clock, link=link, unit=unit, drive_map=drive_map)
        self._ledger = ledger
        self._weak = drive_map.weak()
        self._proving = False
        self._needs = Needs(name, drive_map, self.access, self.commands)
        self.raw = ModbusRawParameters(name, ModbusLine(link), unit, drive_map, wear=wear, access=self.access)
        self._parameters = NamedParameters(self.raw)

    # -- connection ------------------------------------------------------------------------------------------------
    def open(self) -> None:
        """Connect and take one sample; writes nothing. Raises StateError when it is open already, InputError for a travel that its
        registers do not hold, LinkLostError, NoAnswerError."""
        if self._open:
            raise StateError(f"drive {self.name} is already open")
        self.values.check_held(self.limits.ends_mm)
        self.link.open()
        self._open = True
        try:
            self.homing.forget()
            self.moves.under_way = None
            self.commands.forget()
            self.way_out.over()
            self.link.limit_by(self.unit, self.way_out)
            self._needs.require()
            self.access.note(self.map.quick_stop)
            self.sample()
        except BaseException:
            self._open = False
            self.link.close()
            raise

    def _put_back(self, left: Left) -> None:
        """Mode, speeds and ramps of a disabled axis, and the needs of the map."""
        settings = [("", self.commands.put_back)] if left is Left.OFF else []
        undo_all([*settings, ("", self._needs.put_back)])

    def _release(self) -> None:
        self._open = False
        self.link.close()

    @property
    def capabilities(self) -> frozenset[Capability]:
        """The capabilities that the map describes."""
        found = {Capability.PROFILE_POSITION, Capability.PARAMETERS}
        if self.map.homing is not None:
            found.add(Capability.HOMING)
        if self.map.stream is not None:
            found.add(Capability.STREAMING)
        if self.map.probes:
            found.add(Capability.TOUCH_PROBE)
        if self.map.torque is not None:
            found.add(Capability.TORQUE_ACTUAL)
        if self.map.store is not None:
            found.add(Capability.STORE)
        return frozenset(found)

    def reported_scaling(self) -> tuple[ReportedScaling, ...]:
        """Units by the map's [drive.scaling]: constants of the model, or its registers."""
        self._require_open()
        return (self.raw.reported_scaling(),)

    def unit_parameters(self) -> dict[str, int | float]:
        """The registers that the map's [drive.scaling] names."""
        self._require_open()
        return self.raw.unit_parameters()

    # -- facts of the map --------------------------------------------------------------------------------------------
    def preflight(self) -> tuple[tuple[str, bool, str], ...]:
        """Needs of the map, word orders judged by the values found, and the facts that are still to be proven."""
        self._require_open()
        names = [name for name in self.map.wide() if self.registers[name].readable]
        order = judge_orders({name: (self.registers[name], words) for name, words in self.access.words(names).items()})
        good = order.agrees and (order.supported or self.map.speed_is_narrow)
        checks = [("word order", good, order.detail)] if names else []
        waiting = [text for proof in Proof if proof.value in self.unproven() for text in self._weak[proof]]
        if waiting:
            checks.append(("facts", True, f"to be proven on this drive before use: {'; '.join(waiting)}"))
        elif self._weak:
            checks.append(("facts", True, "everything in its map that is assumed was proven on this drive"))
        return tuple(checks)

    def unproven(self) -> frozenset[str]:
        done = frozenset[Proof]() if self._ledger is None else self._ledger.proven()
        return frozenset(proof.value for proof in self._weak if proof not in done and proof is not Proof.PERSON)

    @contextmanager
    def proving(self) -> Iterator[None]:
        before, self._proving = self._proving, True
        try:
            yield
        finally:
            self._proving = before

    def proven(self, what: frozenset[str]) -> None:
        if self._ledger is not None and self._weak:
            self._ledger.add(frozenset(Proof(each) for each in what) & self._weak.keys())

    def _require_proven(self, verb: str, *, homing: bool = False) -> None:
        """Raise StateError for facts that this order rests on and nobody has proven on this drive."""
        waiting = set() if self._proving else {each for each in self.unproven() if (each == "homing") is homing}
        if waiting:
            text = next(text for proof in Proof if proof.value in waiting for text in self._weak[proof])
            option = " --home" if homing else ""
            raise StateError(
                f"drive {self.name} cannot {verb}: its register map rests on facts that are not proven on this drive, such as"
                f" {text}; prove them by: hil doctor AXIS.toml{option}"
            )

    @property
    def correction_table(self) -> ModbusCorrectionTable | None:
        """The table by the map's [drive.correction_table]; None without one."""
        self._require_open()
        blocks = self.map.table
        return None if blocks is None else ModbusCorrectionTable(self.name, self.access, blocks, self.raw.wear)

    # -- reading ---------------------------------------------------------------------------------------------------
    def zero(self) -> DriveZero:
        """Zero by the map's [drive.homing] and identity."""
        self._require_open()
        identity: dict[str, int | str] = {"map": self.registers.name}
        identity |= {name: str(self._parameters.read(name)) for name in self.map.identity}
        homing = self.map.homing
        if homing is None:
            return DriveZero(identity=identity)
        names = [name for name in (homing.method, homing.home_position) if name is not None]
        raw = self.access.read(names) if names else {}
        method = None if homing.method is None else int(raw[homing.method])
        if method is not None and homing.makers_method:
            # another one makes another zero; what it seeks only the manual says
            identity |= {"homing by the maker's method": method}
            method = None
        return DriveZero(method, self.values.load_mm(raw, homing.home_position), identity)

    def says_homed(self) -> bool | None:
        """A flag that is valid in homing mode only is read in that mode, which a disabled drive is put into; the drive may
        have lost it with the change of mode."""
        self._require_open()
        homing = self.map.homing
        if self.homing.homed is None and homing is not None and self.power.state() is DriveState.SWITCH_ON_DISABLED:
            return self.homing.ask(homing)
        return self.homing.homed

    # -- states ----------------------------------------------------------------------------------------------------
    def _enable(self) -> None:
        self._require_open()
        self._require_proven("enable")
        self.commands.stopped = False
        self.way_out.over()
        try:
            self._enable_by_steps()
        except BridgeError as error:  # a drive that was too slow for a step must not be enabled afterwards
            undo_all([("not disabled", self.disable)], during=error)
            raise

    def _enable_by_steps(self) -> None:
        state = self.power.state()
        if state is DriveState.NOT_READY:
            self.power.await_ready()
        elif state is DriveState.QUICK_STOP and not self._seen_at_rest():
            raise MotionTimeoutError(f"drive {self.name}: still moving in quick stop, not enabled")
        self._needs.arrange()
        self.moves.set_mode()
        self.power.enable(self._target_here)

    def _target_here(self) -> None:
        """Target := actual, so that switching power on moves nothing."""
        with self.moves.target_kept():
            self._write_here(self.map.move.target)
        self.moves.under_way = None

    def _write_here(self, target: str) -> None:
        counts = 0.0
        if not (self.map.move.relative and target == self.map.move.target):
            counts = self.values.position_counts(self.access.read([self.map.position]))
        self.access.write({target: self.values.raw(counts, target)})

    def reset_fault(self) -> None:
        """Acknowledge by the map's sequence; leaves the axis disabled. Raises DriveFaultError when the cause is still there."""
        self._require_open()
        self.power.reset_fault()

    # -- motion ----------------------------------------------------------------------------------------------------
    def _start_homing(self) -> None:
        homing = self.map.homing
        if homing is None:
            why = self.map.without_homing
            raise StateError(f"drive {self.name}: its register map has no homing{why and ': ' + why}")
        if homing.at_power_on and self.falls_without_power:
            raise StateError(
                f"drive {self.name} homes only as its power comes on, so it has to be taken off first: gravity can move the axis"
                " and no brake is stated"
            )
        self._require_proven("home", homing=True)
        self.moves.under_way = None
        with self._no_motion_after_errors():
            self.homing.begin(homing, self._disable)

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        raw = self.access.read(self.map.sampled())
        move = self.moves.planned(position_load_mm, velocity_mm_s, raw)  # refuses before anything is written
        with self._no_motion_after_errors():
            self.homing.leave(raw)
            self.moves.make_ready(raw)
            self.moves.begin(move)

    # -- streams ---------------------------------------------------------------------------------------------------
    @property
    def _set_points(self) -> StreamMap:
        if self.map.stream is None:
            raise CapabilityError(f"drive {self.name}: its register map has no cyclic set-point")
        return self.map.stream

    def cycle_s(self) -> float:
        """By the wire, and by the time that this drive takes to answer: the shortest of `ANSWERS` samples."""
        target, plan = self.registers[self._set_points.target], self.access.plan(self.map.sampled())
        took_s = math.inf
        for _ in range(ANSWERS):
            sample = self.sample()
            took_s = min(took_s, (sample.time_ns - sample.earliest_ns) / NS_PER_S)
        answer_s = max(0.0, took_s - plan.wire_s) / len(plan.requests)
        return max(took_s, plan.wire_s) + answer_s + self.link.cost.write_s(target.table, target.span.count)

    @property
    def least_period_s(self) -> float:
        return self._set_points.least_period_s

    def begin_stream(self) -> DriveSample:
        """Target := actual, then the mode in which the drive follows it; a sample. Raises CapabilityError."""
        stream = self._set_points
        self._require_enabled("stream")
        with self._no_motion_after_errors():
            self.homing.leave(self.access.read(self.map.sampled()))
            self._write_here(stream.target)
            self.commands.set_mode(stream.mode, stream.mode_shown, stream.timeout_s)
            self.commands.start(stream.start, "stream", stream.timeout_s)
            return self.sample()

    def send_set_point(self, position_load_mm: float) -> None:
        """The next set-point, load mm."""
        target = self._set_points.target
        counts = float(self.scaling.motor_counts(position_load_mm))
        self.commands.write({target: self.values.raw(counts, target)})

    def end_stream(self) -> None:
        """Return to the mode of moves, held where it is."""
        with self._no_motion_after_errors():
            self._target_here()
            self.moves.set_mode()

    # -- touch probe and parameters --------------------------------------------------------------------------------------
    def _touch_probe(self) -> ModbusTouchProbe:
        return ModbusTouchProbe(
            self.name,
            self.clock,
            self.map.probes,
            self.access,
            lambda raw, name: self.scaling.load_mm(self.values.counts(raw, name)),
        )

    @property
    def parameters(self) -> NamedParameters:
        """Parameters by the names of the register map."""
        return self._parameters
