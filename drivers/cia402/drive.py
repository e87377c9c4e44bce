"""Cia402Drive: a drive by CiA 402 behind the `ServoDrive` abstraction, whatever wire carries its objects.

A wire's drive derives from it. It opens the node, calls `_take_up`, and says how a controlword leaves at once and what the axis shows.
Power states are in `power`, moves in `motion`, homing in `homing`.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import partial

from drivers.cia402 import objects
from drivers.cia402.error_codes import error_text
from drivers.cia402.homing import Homing
from drivers.cia402.kept_settings import KeptSettings
from drivers.cia402.modes import Mode
from drivers.cia402.motion import ProfileMotion
from drivers.cia402.motion_parts import MotionParts, MoveOrder
from drivers.cia402.objects import Entry
from drivers.cia402.operation_modes import OperationModes
from drivers.cia402.own_limits import OwnLimits
from drivers.cia402.power import RUN, PowerStage
from drivers.cia402.settings import Cia402Settings
from drivers.cia402.state_machine import QUICK_STOP_ENDINGS, Command, Control, Status, decode_state
from drivers.cia402.units import motion_units, read_units, readings
from drivers.cia402.wire import ObjectAccess, ProcessImage
from drivers.clock import Clock
from drivers.drive import FAULTS, DriveSample, DriveState, DriveZero, HomingSpeeds
from drivers.errors import CapabilityError, MotionTimeoutError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling, MotionScaling, ReportedScaling
from drivers.shutdown import StoppableDrive
from drivers.standstill import Standstill
from drivers.undo import undo_all

STRAYS_MM = 1.0
"""How far outside its way an axis may be seen while it takes a set-point: more than moves overshoot, and than a load sags."""


class Cia402Drive(StoppableDrive):
    """One drive under power. notes: findings of `open` for an engineer.

    Raises from its methods, besides what ServoDrive names: what the wire raises, AbortError (a refused access, naming object and
    reason), ProtocolError.
    """

    access: ObjectAccess
    image: ProcessImage
    power: PowerStage
    kept: KeptSettings
    modes: OperationModes
    own_limits: OwnLimits
    motion: ProfileMotion
    homing: Homing
    units: MotionScaling
    """Of its velocities and accelerations on the wire; known once open."""

    def __init__(
        self, name: str, scaling: AxisScaling, limits: DriveLimits, clock: Clock, settings: Cia402Settings
    ) -> None:
        super().__init__(name, scaling, limits, clock)
        self.settings = settings
        self.notes: list[str] = []
        self.stop_lets_go = True
        self._fault_code: int | None = None

    # -- what the wire gives, besides that of `StoppableDrive` -------------------------------------------------------------
    @abstractmethod
    def _send_word(self, word: int, *, every_way: bool = True) -> None:
        """Send a controlword that stops the axis or takes its power, by every way there is, the fastest first, without waiting.

        Never raises, and takes no lock of this program: for any thread, and a signal handler. every_way: False leaves out a way whose
        answer would have to be waited for before the next request.
        """

    def _highest(self, entry: Entry) -> float | None:
        """The largest value that the maker's file allows for an object; None without a file, or a limit in it."""
        del entry
        return None

    def _identity_facts(self) -> dict[str, int | str]:
        """What tells this drive from others."""
        return {}

    def _take_up(self, access: ObjectAccess, image: ProcessImage, vendor: int) -> None:
        """To be called by `open`: read what the drive is, and write nothing but modes that are tried at standstill. vendor: 1018h:1.

        Raises as `ObjectAccess.read`, InputError for a unit in the settings that is none."""
        settings = self.settings
        self.access, self.image = access, image
        self.power = PowerStage(access, self.clock, settings.power, self.way_out)
        self.units = motion_units(
            partial(access.read_if_shown, absent=None),
            self.scaling,
            velocity=settings.velocity_unit,
            acceleration=settings.acceleration_unit,
            vendor=vendor,
        )
        self.kept = KeptSettings(access)
        self.modes = OperationModes(access, self.kept, self.clock, settings.mode_timeout_s)
        self.modes.find(settings.modes, self.notes)
        self.own_limits = OwnLimits(access, self.kept, self.units, self._highest, self.notes)
        self.motion = ProfileMotion(
            MotionParts(
                access,
                image,
                self.power,
                self.kept,
                self.modes,
                self.own_limits,
                self.units,
                self.notes,
                self.clock,
                settings.handshake_timeout_s,
                round(STRAYS_MM * self.scaling.counts_per_load_mm),
            )
        )
        self.homing = Homing(access, self.power, self.motion, self.kept)
        self._note_ramps()
        self._note_modes()
        self.own_limits.note(self.limits.max_velocity_mm_s, self.limits.max_acceleration_mm_s2)

    # -- reading -------------------------------------------------------------------------------------------------------
    def sample(self) -> DriveSample:
        """A fresh sample. following_error_mm is demand − actual, as in 60F4h, mm.

        Raises what the wire raises, DriveFaultError once when a homing that was started failed, ProtocolError once when it ended
        elsewhere than announced, LimitError (with a halt) when the drive limits the target of the move in progress.
        """
        self._require_open()
        self.image.refresh()
        status = self.image.statusword
        state = decode_state(status)
        if state in FAULTS:
            if self._fault_code is None:
                self._fault_code = self.power.error_code()
            self.homing.under_way = False
        else:
            self._fault_code = None
        velocity = self.image.values.get(objects.VELOCITY_ACTUAL)
        slow = velocity is None or Standstill.is_slow(self.units.load_mm_s(velocity))
        homing = self.homing.under_way
        self.homing.look(self.image.heard_ns, status, self.image.position_counts, slow=slow)
        if homing and self.homing.homed:
            self.homing.homed = False
            self.check_home(self.scaling.load_mm(self.image.position_counts))
            self.homing.homed = True
        self.motion.look(status)
        return self._as_sample()

    def _as_sample(self) -> DriveSample:
        """The values received last."""
        values, scaling, status = self.image.values, self.scaling, self.image.statusword
        velocity = values.get(objects.VELOCITY_ACTUAL)
        torque = values.get(objects.TORQUE_ACTUAL)
        error = values.get(objects.FOLLOWING_ERROR_ACTUAL)
        arrived = self.motion.arrived()
        reached = bool(status & Status.TARGET_REACHED) if arrived is None else arrived
        if self.homing.without_bit_10 and self.modes.mode is Mode.HOMING:
            reached = velocity is None or Standstill.is_slow(self.units.load_mm_s(velocity))
        return DriveSample(
            self.image.heard_ns,
            decode_state(status),
            scaling.load_mm(self.image.position_counts),
            reached and not self.homing.under_way and decode_state(status) is DriveState.ENABLED,
            None if velocity is None else self.units.load_mm_s(velocity),
            None if torque is None else scaling.direction * torque / 10.0,
            None if error is None else scaling.load_mm(error),
            self.homing.homed,
            self._fault_code,
            limited=bool(status & Status.INTERNAL_LIMIT),
            since_ns=self.image.asked_ns,
            supplied=bool(status & Status.VOLTAGE_ENABLED),
        )

    # -- units, zero, errors -------------------------------------------------------------------------------------------
    def _require_units(self) -> None:
        """Raise CapabilityError before motion where the drive's units of it are not known."""
        if self.units.ambiguous:
            raise CapabilityError(f"drive {self.name} cannot be moved: {self.units.ambiguous}")

    def reported_scaling(self) -> tuple[ReportedScaling, ...]:
        """Units by 608Fh, 6091h, 6092h and 60A8h."""
        self._require_open()
        return readings(read_units(self.access))

    def motion_scaling(self) -> MotionScaling:
        """Units by the axis file, 60A9h and 60AAh, 608Bh to 608Eh, 6094h to 6097h, the maker's manual or the standard."""
        self._require_open()
        return self.units

    def zero(self) -> DriveZero:
        """Zero by 6098h and 607Ch as the next homing will use them."""
        self._require_open()
        method, home_mm = self.settings.homing.method, self.settings.homing.home_position_mm
        if self.modes.has(Mode.HOMING):
            if method is None:
                method = self.access.read(objects.HOMING_METHOD)
            if home_mm is None:
                home_mm = self.scaling.load_mm(self.access.read_if_shown(objects.HOME_OFFSET, 0))
        return DriveZero(method, home_mm, self._identity_facts())

    def homing_speeds(self) -> HomingSpeeds:
        """Of the axis file, else of 6099h in the drive's unit of velocity."""
        self._require_open()
        asked, scaling = self.settings.homing, self.scaling

        def speed(stated: float | None, entry: Entry) -> float | None:
            if stated is not None or self.units.ambiguous:
                return stated
            return self.units.mm_s(self.access.read_if_shown(entry, 0)) or None

        return HomingSpeeds(
            speed(asked.speed_switch_mm_s, objects.HOMING_SPEED_SWITCH),
            speed(asked.speed_zero_mm_s, objects.HOMING_SPEED_ZERO),
            scaling.encoder_counts_per_motor_rev * scaling.resolution_load_mm,
            None
            if self.units.ambiguous
            else self.units.mm_s2(self.access.read_if_shown(objects.HOMING_ACCELERATION, 0)) or None,
        )

    def says_homed(self) -> bool | None:
        """6041h bit 12 in homing mode, which a disabled drive is put into; a drive may have forgotten it with the change of mode."""
        self._require_open()
        if self.homing.homed is not None or not self.modes.has(Mode.HOMING):
            return self.homing.homed
        if decode_state(self.access.read(objects.STATUSWORD)) is DriveState.SWITCH_ON_DISABLED:
            self.set_mode(Mode.HOMING, until_enabled=True)
            if self.modes.is_shown():
                self.homing.believe(self.access.read(objects.STATUSWORD))
        return self.homing.homed

    def fault_text(self, code: int) -> str:
        """As the standard has it (CiA 301, CiA 402)."""
        return error_text(code)

    # -- enabling ------------------------------------------------------------------------------------------------------
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
            self._send_word(Command.DISABLE_VOLTAGE.word)
            with self.way_out.step(last=False):
                undo_all([("", partial(self.power.write, Command.DISABLE_VOLTAGE.word))], during=error)
            raise

    def reset_fault(self) -> None:
        """Send the rising edge of the reset bit; the axis stays disabled. Raises DriveFaultError when the cause is still there."""
        self._require_open()
        self.power.reset_fault()

    # -- motion --------------------------------------------------------------------------------------------------------
    def set_mode(self, mode: Mode, *, until_enabled: bool = False) -> None:
        """Change the mode of operation; see `ProfileMotion.set_mode`, also for the errors."""
        self._require_open()
        with self._no_motion_after_errors():
            self.motion.set_mode(mode, until_enabled=until_enabled)
        self.homing.under_way = False

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        self.homing.under_way = False
        self._require_units()
        velocity = self.units.velocity_units(velocity_mm_s)
        self.own_limits.check_velocity(velocity)
        with self._no_motion_after_errors():
            acceleration = self.units.acceleration_units(self.limits.max_acceleration_mm_s2)
            self.motion.move(MoveOrder(self.scaling.motor_counts(position_load_mm), velocity, acceleration))

    def _start_homing(self) -> None:
        self._require_units()
        with self._no_motion_after_errors():
            self.homing.start(self.settings.homing, self.units)

    def home(self, timeout_s: float) -> DriveSample:
        """Home and wait for it, at most `timeout_s` seconds. Raises DriveFaultError when it fails, MotionTimeoutError when it does not
        end in time (the axis is stopped).
        """
        self.start_homing()
        try:
            return self.wait_for(lambda sample: sample.homed is True or sample.state in FAULTS, timeout_s, "homed")
        except MotionTimeoutError:
            self.quick_stop()
            raise

    # -- how it is stopped and disabled --------------------------------------------------------------------------------
    @property
    def stopped(self) -> bool:
        return self.power.stopped

    def send_stop(self) -> None:
        """See `_send_word`. No command enables the axis until `enable`."""
        if self._open:
            self.power.stopped = True
            self._send_word(Command.QUICK_STOP.word)

    def _halt(self) -> None:
        self._send_word(RUN | Control.HALT, every_way=False)
        self.motion.halt()

    def _repeat_stop(self) -> None:
        self.power.write(Command.QUICK_STOP.word)

    def _why_enabled(self) -> str:
        return self.power.why(DriveState.ENABLED, self.power.statusword())

    def _power_off(self) -> None:
        self.power.disable()

    def _send_power_off(self, shown: DriveState) -> None:
        del shown  # it is one command in every state
        self._send_word(Command.DISABLE_VOLTAGE.word)

    def _quick_stop_holds(self) -> bool:
        ending = QUICK_STOP_ENDINGS.get(self.access.read_if_shown(objects.QUICK_STOP_OPTION, 2))
        return ending is not None and ending.stays

    # -- notes ---------------------------------------------------------------------------------------------------------
    def _note_ramps(self) -> None:
        """Note, once, properties of the quick stop that an engineer should know; nothing is written.

        A ramp flatter than that of a move overshoots the move's target; one that ends without power lets an axis fall that gravity
        can move.
        """
        self.stop_lets_go = not self._quick_stop_holds()
        if self.falls_without_power and self.stop_lets_go:
            self.notes.append(
                f"drive {self.name}: gravity can move this axis and no brake is stated, but after a quick stop (605Ah) its drive"
                " switches its power off"
            )
        quick = self.access.read_if_shown(objects.QUICK_STOP_DECELERATION, 0)
        quick_mm_s2 = self.units.mm_s2(quick)
        if 0 < quick_mm_s2 < self.limits.max_acceleration_mm_s2 * (1 - 1e-6):
            self.notes.append(
                f"drive {self.name}: quick stop (6085h) brakes with {quick_mm_s2:g} mm/s²,"
                f" moves with up to {self.limits.max_acceleration_mm_s2:g} mm/s²: a stop may overshoot the target"
            )
        braking_mm_s2 = quick_mm_s2 or self.limits.max_acceleration_mm_s2
        self.way_out.braking_s = min(self.limits.max_velocity_mm_s / braking_mm_s2, self.settings.power.stop_s)

    def _note_modes(self) -> None:
        """What stands in for profile position where the drive lacks it."""
        mode = self.modes.streaming
        if mode is None or self.modes.has(Mode.PROFILE_POSITION):
            return
        named = mode.name.lower().replace("_", " ")
        self.notes.append(
            f"drive {self.name} has no profile position: it is moved by set-points ({named}), one with every second sample, and"
            " holds the last one when none comes"
        )
