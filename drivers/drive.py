"""ServoDrive: the abstraction of a drive that moves one axis.

Backends (CANopen, Modbus, the in-process virtual drive) implement the underscored methods; the public ones check limits and
states first, so that no backend can move an axis outside its limits or enable it unsafely. All calls are synchronous and
short: a motion is *started*, and the caller watches its samples (see `hil.machine.supervisor`). Positions are load mm as the motor
encoder sees them (`scaling` converts); where the table is, only an instrument measures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from typing import Self

from drivers.clock import NS_PER_S, Clock
from drivers.correction_table import CorrectionTable
from drivers.errors import (
    AbortError,
    CapabilityError,
    DriveFaultError,
    InputError,
    MotionTimeoutError,
    ProtocolError,
    StateError,
)
from drivers.limits import DriveLimits
from drivers.parameters import DriveParameters
from drivers.scaling import AxisScaling, MotionScaling, ReportedScaling
from drivers.set_points import SetPointSettings, SetPointStream
from drivers.touch_probe import TouchProbe
from drivers.way_out import WayOut

TAKES_THE_PLACE = (35, 37)
"""Homing methods (6098h) that do not move. 1 to 34 search a switch or the index, so they move; negative ones are the maker's."""
_HOMING_SHARE = 0.1
"""Share of the axis's largest velocity that an unknown speed to the home position is taken for."""
_LATCH_S = 0.05
"""Time that a drive may take to begin to brake after the home position, s: five slow control cycles."""


class DriveState(Enum):
    """State of the power stage in CiA-402 terms (IEC 61800-7-201); every backend maps its own states onto these."""

    UNKNOWN = "unknown"  # no statusword received yet
    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"


FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION)
"""States that show a fault."""
WITHOUT_POWER = (DriveState.NOT_READY, DriveState.SWITCH_ON_DISABLED, DriveState.READY, DriveState.FAULT)
"""States in which the power stage is off: parameters are written in these only."""


class Capability(Enum):
    """What a drive may or may not be able to do; checked before motion, so that a refusal comes before motion."""

    PROFILE_POSITION = "profile position"
    HOMING = "homing"
    STREAMING = "cyclic synchronous position"
    TORQUE_ACTUAL = "torque actual value"
    TOUCH_PROBE = "touch probe"
    PARAMETERS = "parameter access"
    STORE = "store parameters"


@dataclass(frozen=True)
class DriveSample:
    """One reading of the drive. What a backend cannot tell is None, never a made-up zero.

    time_ns: the clock's time at which the values were received; check `age_ns` before using them. since_ns: before they were asked
    for, None where time_ns is exact; where this process or the wire is delayed, the values are of any moment between the two.
    target_reached: False without power. limited: the drive reports that a limit of its own is active (CiA-402: statusword bit 11,
    internal limit), such as a software limit. supplied: the power stage has its supply (CiA-402: statusword bit 4, voltage enabled);
    without mains, and with safe torque off on most drives, it has not.
    """

    time_ns: int
    state: DriveState
    position_load_mm: float
    target_reached: bool
    velocity_mm_s: float | None = None
    torque_percent: float | None = None
    following_error_mm: float | None = None
    homed: bool | None = None
    fault_code: int | None = None
    limited: bool | None = None
    since_ns: int | None = None
    supplied: bool | None = None

    @property
    def earliest_ns(self) -> int:
        """The earliest time at which the values can have been taken, ns."""
        return self.time_ns if self.since_ns is None else self.since_ns

    def age_ns(self, now_ns: int) -> int:
        return now_ns - self.time_ns


@dataclass(frozen=True)
class DriveZero:
    """The origin of a drive's positions, as far as the drive reports it; what it does not report is None.

    method: of its next homing, the number of 6098h (negative numbers are the manufacturer's); home_position_mm: the position assigned
    to the home position (607Ch), load mm; identity: of the device, plain values by name
    """

    method: int | None = None
    home_position_mm: float | None = None
    identity: Mapping[str, int | str] = field(default_factory=dict)


@dataclass(frozen=True)
class HomingSpeeds:
    """Speeds of a drive's next homing, mm/s: towards the switch, and to the edge or the index; None where it is not known. turn_mm:
    travel of one turn of the motor; ramp_mm_s2: its acceleration."""

    switch_mm_s: float | None = None
    zero_mm_s: float | None = None
    turn_mm: float = 0.0
    ramp_mm_s2: float | None = None

    def stop_mm(self, limits: DriveLimits) -> float:
        """Longest way from the home position to where the axis comes to rest, mm; of what is not known, by the limits of the axis."""
        speed = self.zero_mm_s or self.switch_mm_s or _HOMING_SHARE * limits.max_velocity_mm_s
        return speed * speed / (2.0 * (self.ramp_mm_s2 or limits.max_acceleration_mm_s2)) + _LATCH_S * speed


class ServoDrive(ABC):
    """One axis's drive. notes: findings of `open` for an engineer, one sentence each.

    corrected_outside: the caller adds a correction to the set-points at present; the drive's own table is then not switched on.
    on_look: called with each sample that the supervising code has taken. before_homing: called before any homing; refuses it by
    raising. homed_elsewhere: called when a homing has ended in another frame than announced.
    destination_load_mm: target of the last profile move, load mm.
    falls_without_power: gravity can move the axis and no brake holds it; its power is taken off only once it was seen at rest.
    way_out: time limit for shutting it down; None for a drive without a wire.
    """

    notes: Sequence[str] = ()
    way_out: WayOut | None = None
    corrected_outside = False
    falls_without_power = False
    on_look: Callable[[DriveSample], None] | None = None
    before_homing: Callable[[], None] | None = None
    homed_elsewhere: Callable[[], None] | None = None
    destination_load_mm: float | None = None

    def __init__(self, name: str, scaling: AxisScaling, limits: DriveLimits, clock: Clock) -> None:
        self.name = name
        self.scaling = scaling
        self.limits = limits
        self.clock = clock

    # -- connection ------------------------------------------------------------------------------------------------
    @abstractmethod
    def open(self) -> None:
        """Connect and read what is needed; moves nothing, enables nothing, writes no motion parameter. Raises TransportError."""

    @abstractmethod
    def close(self) -> None:
        """Release the wire; never raises for a link that is already lost. An enabled axis is disabled first."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    @property
    @abstractmethod
    def capabilities(self) -> frozenset[Capability]:
        """What this drive supports."""

    def require(self, *capabilities: Capability) -> None:
        """Raise CapabilityError naming the capabilities that are missing."""
        missing = [capability.value for capability in capabilities if capability not in self.capabilities]
        if missing:
            raise CapabilityError(f"drive {self.name} cannot do: {', '.join(missing)}")

    # -- reading ---------------------------------------------------------------------------------------------------
    @abstractmethod
    def sample(self) -> DriveSample:
        """A fresh sample, requested now."""

    # -- what is not known of the drive ----------------------------------------------------------------------------------
    def preflight(self) -> tuple[tuple[str, bool, str], ...]:
        """Checks of its own that need no motion: name, whether it is good, and the finding in one sentence. Writes nothing.

        A backend whose drive is described by a file that may be wrong overrides this.
        """
        return ()

    def unproven(self) -> frozenset[str]:
        """What of the drive's description has to be proven before it is used, by what proves it: reading, enabling, move, stop,
        homing. A backend that is described by a file overrides this."""
        return frozenset()

    @contextmanager
    def proving(self) -> Iterator[None]:
        """Inside, the axis may be enabled and moved in spite of `unproven`, for what proves it."""
        yield

    def proven(self, what: frozenset[str]) -> None:
        """Remember what was proven, for this drive and its present description."""
        del what

    def complaints(self) -> tuple[str, ...]:
        """Messages of the drive beside its samples: a warning, its last emergency. No request is sent.

        A backend whose drive reports such things overrides this.
        """
        return ()

    def fault_text(self, code: int) -> str:
        """An error code of this drive in words. A backend that knows what its codes mean overrides this."""
        return f"error code {code:04X}h"

    def reported_scaling(self) -> tuple[ReportedScaling, ...]:
        """The units that the drive itself reports, read now: each possible interpretation, the likeliest first.

        Raises as reading a parameter does. A backend whose drive reports them overrides this.
        """
        return ()

    def unit_parameters(self) -> Mapping[str, int | float]:
        """The parameters that decide what one count is, by address and as read now: encoder, gear, feed, factor, polarity.

        Those that the drive does not have are left out. Raises as reading a parameter does. A backend that reads them overrides this.
        """
        return {}

    def read_number(self, name: str) -> tuple[str, int | float]:
        """A parameter that is a number: its address in parameter sets, and its present value. Raises as reading a parameter does,
        InputError for one that is no number."""
        value = self.parameters.read(name)
        if not isinstance(value, int | float):
            raise InputError(f"parameter {name} is {value!r}, expected a number")
        return name, value

    def motion_scaling(self) -> MotionScaling | None:
        """Units of velocity and acceleration on the wire, and what says so; None for a backend whose map states them."""
        return None

    def zero(self) -> DriveZero:
        """The origin of the positions, read now. Raises as reading a parameter does. A backend that can read it overrides this."""
        return DriveZero()

    def homing_speeds(self) -> HomingSpeeds:
        """Speeds of the next homing, read now. Raises as reading a parameter does. A backend that can read them overrides this."""
        return HomingSpeeds()

    def says_homed(self) -> bool | None:
        """Whether the drive still has a zero from an earlier homing; None where it does not report that. Moves nothing.

        For an axis that is not enabled: a backend may change the mode of operation to ask.
        """
        return self.sample().homed

    # -- states ----------------------------------------------------------------------------------------------------
    def enable(self) -> None:
        """Target := actual position, then power on, until ENABLED.

        Raises DriveFaultError in a fault state: only `reset_fault` resets a fault.
        """
        state = self.sample()
        if state.state in FAULTS:
            raise DriveFaultError(
                f"drive {self.name} is in {state.state.value}; reset the fault before enabling", state.fault_code
            )
        self._enable()

    @abstractmethod
    def _enable(self) -> None: ...

    @abstractmethod
    def disable(self) -> None:
        """Stop if moving, then power off, until no longer ENABLED."""

    @abstractmethod
    def quick_stop(self) -> None:
        """Decelerate as fast as the drive is set up to: `send_stop`, then wait for the confirmation. Works, as far as the wire allows,
        in any state. Raises TransportError or RemoteError when no confirmation came; the stop was sent all the same.
        """

    @abstractmethod
    def send_stop(self) -> None:
        """Send the quick stop by the fastest frames of the wire, without waiting for an answer. Never raises.

        For any thread and for a signal handler: it takes no lock that another thread may hold while it waits.
        """

    @abstractmethod
    def reset_fault(self) -> None:
        """Acknowledge a fault; leaves the axis disabled."""

    # -- motion ----------------------------------------------------------------------------------------------------
    def start_homing(self) -> None:
        """Start the drive's own homing; `sample().homed` turns True when it is done. Raises what `before_homing` raises, before
        motion."""
        self.require(Capability.HOMING)
        self._require_enabled("home")
        if self.before_homing is not None:
            self.before_homing()
        self._start_homing()

    @abstractmethod
    def _start_homing(self) -> None: ...

    def check_home(self, shown_load_mm: float) -> None:
        """For a backend whose homing has just ended: compare the place that it shows, mm, with the one that was announced.

        Makers differ in the sign of the home offset. Raises ProtocolError; the drive's positions are then not the axis's.
        """
        try:
            zero = self.zero()
        except AbortError:  # nothing was announced
            return
        announced_mm = zero.home_position_mm
        if not announced_mm:
            return
        stop_mm = 0.0 if zero.method in TAKES_THE_PLACE else self.homing_speeds().stop_mm(self.limits)
        near_mm = max(stop_mm, 0.5 * abs(announced_mm))
        if abs(shown_load_mm - announced_mm) <= near_mm:
            return
        if self.homed_elsewhere is not None:
            self.homed_elsewhere()
        other = abs(shown_load_mm + announced_mm) <= near_mm
        sign = ", the other sign: its zero lies the home offset from home" if other else ""
        raise ProtocolError(
            f"drive {self.name}: homing is refused: its home position was to show {announced_mm:g} mm and shows {shown_load_mm:.4g}"
            f" mm{sign}; set home_position_mm = 0 (607Ch) and the travel from there"
        )

    def start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        """Start a profile move to an absolute position (mm, mm/s); returns once the drive has acknowledged the set-point.

        Raises LimitError outside the limits, StateError unless enabled. `sample().target_reached` turns False before this
        returns and True again when the move is over.
        """
        self.limits.check_target(position_load_mm)
        self.limits.check_velocity(velocity_mm_s)
        self._require_enabled("move")
        self._start_move(position_load_mm, velocity_mm_s)
        self.destination_load_mm = position_load_mm

    def looked_at(self, sample: DriveSample) -> None:
        """To be called with each sample by the code that supervises the axis."""
        if self.on_look is not None:
            self.on_look(sample)

    @abstractmethod
    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None: ...

    def stream(self, settings: SetPointSettings, others: Sequence[ServoDrive] = ()) -> SetPointStream:
        """Set-points at a fixed period, for this drive and for others of its kind that move together with it: a context manager around
        the enabled axes. Raises CapabilityError, also for drives that no common clock can pace.

        InputError, on entering it, for a period that a drive or its wire cannot keep.
        """
        for drive in (self, *others):
            drive.require(Capability.STREAMING)
        return self._stream(settings, others)

    def _stream(self, settings: SetPointSettings, others: Sequence[ServoDrive]) -> SetPointStream:
        del settings, others
        raise CapabilityError(f"drive {self.name} cannot do: {Capability.STREAMING.value}")

    def _require_enabled(self, verb: str) -> DriveSample:
        sample = self.sample()
        if sample.state in FAULTS:
            raise DriveFaultError(f"drive {self.name} cannot {verb}: {sample.state.value}", sample.fault_code)
        if sample.state is not DriveState.ENABLED:
            raise StateError(f"drive {self.name} cannot {verb}: it is {sample.state.value}")
        return sample

    # -- touch probe, parameters, correction table -----------------------------------------------------------------------
    def touch_probe(self) -> TouchProbe:
        """The drive's touch-probe function. It keeps the last latch: make one and keep it. Raises CapabilityError."""
        self.require(Capability.TOUCH_PROBE)
        return self._touch_probe()

    def _touch_probe(self) -> TouchProbe:
        raise CapabilityError(f"drive {self.name} cannot do: {Capability.TOUCH_PROBE.value}")

    @property
    def parameters(self) -> DriveParameters:
        """The drive's parameters by name. Raises CapabilityError where it has none."""
        raise CapabilityError(f"drive {self.name} cannot do: {Capability.PARAMETERS.value}")

    @property
    def correction_table(self) -> CorrectionTable | None:
        """The table by which the open drive corrects its axis itself; None where it has none, or no map describes it."""
        return None

    # -- waiting, for backends and simple scripts --------------------------------------------------------------------
    def wait_for(
        self, condition: Callable[[DriveSample], bool], timeout_s: float, what: str, *, poll_s: float = 0.01
    ) -> DriveSample:
        """Sample every `poll_s` seconds until the condition holds. Raises MotionTimeoutError naming `what` after `timeout_s`."""
        deadline = self.clock.deadline(timeout_s)
        while True:
            sample = self.sample()
            self.looked_at(sample)
            if condition(sample):
                return sample
            if deadline.expired:
                raise MotionTimeoutError(
                    f"drive {self.name}: {what} not within {timeout_s:g} s, it is {sample.state.value}"
                )
            self.clock.sleep_until_ns(min(deadline.end_ns, self.clock.now_ns() + round(poll_s * NS_PER_S)))
