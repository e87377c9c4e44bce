"""ServoDrive: the one abstraction of a drive that moves one axis.

Backends (CANopen, Modbus, the in-process virtual drive) implement the underscored methods; the public ones check limits and
states first, so that no backend can move an axis outside its limits or enable it unsafely. All calls are synchronous and
short: a motion is *started*, and whoever started it watches samples (see `hil.machine.supervisor`). Positions are load mm as
the motor encoder sees them (`scaling` converts); what the table really did only an instrument can tell.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Self

from drivers.clock import NS_PER_S, Clock
from drivers.correction_table import CorrectionTable
from drivers.errors import CapabilityError, DriveFaultError, LimitError, MotionTimeoutError, StateError
from drivers.parameters import DriveParameters
from drivers.scaling import AxisScaling, ReportedScaling
from drivers.set_points import SetPointGroup, SetPointSettings, SetPointStream
from drivers.shared_time import SharedTime
from drivers.toml_types import Number, Positive
from drivers.touch_probe import TouchProbe
from drivers.undo import undo_all

_LONGEST_LOOK_S = 0.1
"""Looks at a velocity run further apart than this, s, do not make the next one as late: a script may have slept."""


class DriveState(Enum):
    """What the power stage does, in the terms of CiA-402; every backend maps its own states onto these."""

    UNKNOWN = "unknown"  # nothing heard yet
    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"


class Capability(Enum):
    """What a drive may or may not be able to do; asked before moving, so that a refusal comes before motion."""

    PROFILE_POSITION = "profile position"
    PROFILE_VELOCITY = "profile velocity"
    HOMING = "homing"
    STREAMING = "cyclic synchronous position"
    TORQUE_ACTUAL = "torque actual value"
    TOUCH_PROBE = "touch probe"
    PARAMETERS = "parameter access"
    STORE = "store parameters"


@dataclass(frozen=True)
class DriveLimits:
    """What the axis file allows; a target outside is refused, never clipped. mm, mm/s, mm/s²."""

    travel_min_mm: Number
    travel_max_mm: Number
    max_velocity_mm_s: Positive
    max_acceleration_mm_s2: Positive

    def check_target(self, position_load_mm: float) -> None:
        """Raise LimitError unless the position lies within the travel (NaN lies nowhere)."""
        if not self.travel_min_mm <= position_load_mm <= self.travel_max_mm:
            raise LimitError(
                f"target {position_load_mm:.6f} mm is outside the travel"
                f" {self.travel_min_mm:g} to {self.travel_max_mm:g} mm"
            )

    def check_velocity(self, velocity_mm_s: float) -> None:
        """Raise LimitError unless 0 < velocity <= max."""
        if not 0 < velocity_mm_s <= self.max_velocity_mm_s:
            raise LimitError(f"velocity {velocity_mm_s:g} mm/s, allowed is 0 < v <= {self.max_velocity_mm_s:g} mm/s")

    def can_stop_inside(self, position_load_mm: float, velocity_mm_s: float) -> bool:
        """Whether an axis with this (signed) velocity can still be brought to rest within the travel."""
        braking_mm = velocity_mm_s * abs(velocity_mm_s) / (2.0 * self.max_acceleration_mm_s2)
        return self.travel_min_mm <= position_load_mm + braking_mm <= self.travel_max_mm


@dataclass(frozen=True)
class DriveSample:
    """One reading of the drive. What a backend cannot tell is None, never a made-up zero.

    time_ns is the clock's time when the values were received; `age_ns` is what a user checks before trusting them.
    limited: the drive says that a limit of its own is active (CiA-402: internal limit), such as a software limit of the position.
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

    def age_ns(self, now_ns: int) -> int:
        return now_ns - self.time_ns


@dataclass(frozen=True)
class DriveZero:
    """What the zero of a drive's positions rests on, as far as the drive can tell; what it cannot tell is None.

    method: of its next homing, the number of 6098h (negative ones are the maker's); home_position_mm: what the home position is
    called (607Ch), load mm; identity: who it is, plain values by name
    """

    method: int | None = None
    home_position_mm: float | None = None
    identity: Mapping[str, int | str] = field(default_factory=dict)


class ServoDrive(ABC):
    """One axis's drive. notes: what `open` found worth telling an engineer, one sentence each.

    corrected_outside: whoever commands it adds a correction of its own at present; its own table is then not switched on.
    on_look: hears each sample that whoever watches the axis has looked at. before_homing: asked before any homing, which it refuses by
    raising. destination_load_mm: where the last profile move leads.
    falls_without_power: gravity can move the axis and no brake holds it; its power is taken off only once it was seen at rest.
    """

    notes: Sequence[str] = ()
    corrected_outside = False
    falls_without_power = False
    on_look: Callable[[DriveSample], None] | None = None
    before_homing: Callable[[], None] | None = None
    destination_load_mm: float | None = None
    _watched_ns = 0  # when a velocity run was looked at last

    def __init__(self, name: str, scaling: AxisScaling, limits: DriveLimits, clock: Clock) -> None:
        self.name = name
        self.scaling = scaling
        self.limits = limits
        self.clock = clock

    # -- leaving together with others ----------------------------------------------------------------------------------
    @property
    def way_out_s(self) -> float:
        """Within which it is stopped, disabled and put back at most where it does not answer, s; 0.0 where nothing is waited for."""
        return 0.0

    def share_way_out(self, time: SharedTime) -> None:
        """It leaves together with other axes: what dead ones use up of this time is taken off its own."""
        del time

    # -- connection ------------------------------------------------------------------------------------------------
    @abstractmethod
    def open(self) -> None:
        """Connect and read what is needed; moves nothing, enables nothing, writes no motion parameter."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the wire; never raises for a link that is already dead. An enabled axis is disabled first."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    @property
    @abstractmethod
    def capabilities(self) -> frozenset[Capability]:
        """What this drive can do."""

    def require(self, *capabilities: Capability) -> None:
        """Raise CapabilityError naming what is missing."""
        missing = [capability.value for capability in capabilities if capability not in self.capabilities]
        if missing:
            raise CapabilityError(f"drive {self.name} cannot do: {', '.join(missing)}")

    # -- reading ---------------------------------------------------------------------------------------------------
    @abstractmethod
    def sample(self) -> DriveSample:
        """A fresh sample, asked for now."""

    def complaints(self) -> tuple[str, ...]:
        """What the drive said by itself beside its samples: a warning, its last emergency. Nothing is asked for it.

        A backend whose drive has a word for such things overrides this.
        """
        return ()

    def reported_scaling(self) -> tuple[ReportedScaling, ...]:
        """What the drive itself says of its units, asked now: each way in which it may be meant, the likeliest first.

        Raises as reading a parameter does. A backend whose drive has a word for them overrides this.
        """
        return ()

    def zero(self) -> DriveZero:
        """What the zero rests on, read now. Raises as reading a parameter does. A backend that can tell overrides this."""
        return DriveZero()

    def says_homed(self) -> bool | None:
        """Whether the drive has a zero from an earlier homing and has kept it; None where it cannot tell. Moves nothing.

        For an axis that is not enabled: a backend may change the mode of operation to ask.
        """
        return self.sample().homed

    # -- states ----------------------------------------------------------------------------------------------------
    def enable(self) -> None:
        """Target := actual position, then power on, until ENABLED.

        Raises DriveFaultError from a fault state: a fault is reset by its own call and by someone's decision.
        """
        state = self.sample()
        if state.state in (DriveState.FAULT, DriveState.FAULT_REACTION):
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
        """Decelerate as fast as the drive is set up to: `send_stop`, then see it confirmed. Works, as far as the wire allows, from
        any state. Raises what the wire raises when no confirmation came; the stop was sent all the same.
        """

    @abstractmethod
    def send_stop(self) -> None:
        """The quick stop by the fastest frames that the wire has, without waiting for an answer. Never raises.

        For any thread and for a signal handler: it takes no lock for which another thread could make it wait.
        """

    @abstractmethod
    def reset_fault(self) -> None:
        """Acknowledge a fault; leaves the axis disabled."""

    # -- motion ----------------------------------------------------------------------------------------------------
    def start_homing(self) -> None:
        """Start the drive's own homing; `sample().homed` tells when it is done. Raises what `before_homing` raises, before motion."""
        self.require(Capability.HOMING)
        self._require_enabled("home")
        if self.before_homing is not None:
            self.before_homing()
        self._start_homing()

    @abstractmethod
    def _start_homing(self) -> None: ...

    def start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        """Start a profile move to an absolute position; returns once the drive has acknowledged the set-point.

        Raises LimitError outside the limits, StateError unless enabled. `sample().target_reached` turns False before this
        returns and True again when the move is over.
        """
        self.limits.check_target(position_load_mm)
        self.limits.check_velocity(velocity_mm_s)
        self._require_enabled("move")
        self._start_move(position_load_mm, velocity_mm_s)
        self.destination_load_mm = position_load_mm

    def looked_at(self, sample: DriveSample) -> None:
        """Whoever watches the axis has looked at this sample."""
        if self.on_look is not None:
            self.on_look(sample)

    @abstractmethod
    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None: ...

    def start_velocity(self, velocity_mm_s: float) -> None:
        """Run at a signed velocity until told otherwise; 0 stops and stays enabled. `start_move` ends it as well.

        There is no target, so whoever starts a run has to go on sampling: a sample that finds the braking distance at the end of the
        travel quick-stops the axis and raises LimitError. Raises LimitError for a speed above the limit or a direction that leads
        out of the travel, StateError unless enabled, CapabilityError.
        """
        self.require(Capability.PROFILE_VELOCITY)
        if velocity_mm_s:
            self.limits.check_velocity(abs(velocity_mm_s))
        sample = self._require_enabled("run")
        self._watched_ns = self.clock.now_ns()
        if velocity_mm_s and not self.limits.can_stop_inside(sample.position_load_mm, velocity_mm_s):
            raise self._leaves_travel("not started", sample.position_load_mm, velocity_mm_s)
        self._start_velocity(velocity_mm_s)

    def _start_velocity(self, velocity_mm_s: float) -> None:
        raise CapabilityError(f"drive {self.name} cannot do: {Capability.PROFILE_VELOCITY.value}")

    def stream(self, settings: SetPointSettings) -> SetPointStream:
        """Set-points at a fixed period instead of moves: a context manager around the enabled axis. Raises CapabilityError.

        InputError, on entering it, for a period that the drive or its wire cannot keep.
        """
        self.require(Capability.STREAMING)
        return self._stream(settings)

    def _stream(self, settings: SetPointSettings) -> SetPointStream:
        raise CapabilityError(f"drive {self.name} cannot do: {Capability.STREAMING.value}")

    def stream_with(self, others: Sequence[ServoDrive], settings: SetPointSettings) -> SetPointGroup:
        """The same for this drive and others of its kind, in the same periods: axes that move together. Raises CapabilityError, also
        for drives that no common clock could pace."""
        for drive in (self, *others):
            drive.require(Capability.STREAMING)
        return self._stream_with(others, settings)

    def _stream_with(self, others: Sequence[ServoDrive], settings: SetPointSettings) -> SetPointGroup:
        del others, settings
        raise CapabilityError(f"drive {self.name} cannot do: {Capability.STREAMING.value} of several axes")

    def _watch_travel(self, position_load_mm: float, velocity_mm_s: float | None) -> None:
        """For a backend whose sample finds a velocity run under way: stop it while it can still stop within the travel.

        The next look may come as late as this one did, so the axis has to be able to stop from where it will be then.
        """
        now_ns, before_ns = self.clock.now_ns(), self._watched_ns
        self._watched_ns = now_ns
        if not velocity_mm_s:
            return
        ahead_mm = velocity_mm_s * min((now_ns - before_ns) / NS_PER_S, _LONGEST_LOOK_S)
        if not self.limits.can_stop_inside(position_load_mm + ahead_mm, velocity_mm_s):
            error = self._leaves_travel("stopped", position_load_mm, velocity_mm_s)
            undo_all([("not seen to stop", self.quick_stop)], during=error)
            raise error

    def _leaves_travel(self, what: str, position_load_mm: float, velocity_mm_s: float) -> LimitError:
        return LimitError(
            f"drive {self.name}: velocity run {what} at {position_load_mm:.3f} mm with {velocity_mm_s:.3f} mm/s,"
            f" travel is {self.limits.travel_min_mm:g} to {self.limits.travel_max_mm:g} mm"
        )

    def _require_enabled(self, verb: str) -> DriveSample:
        sample = self.sample()
        if sample.state in (DriveState.FAULT, DriveState.FAULT_REACTION):
            raise DriveFaultError(f"drive {self.name} cannot {verb}: {sample.state.value}", sample.fault_code)
        if sample.state is not DriveState.ENABLED:
            raise StateError(f"drive {self.name} cannot {verb}: it is {sample.state.value}")
        return sample

    # -- what stands beside the motion -----------------------------------------------------------------------------------
    def touch_probe(self) -> TouchProbe:
        """The drive's touch-probe function; it remembers what was fetched, so make one and keep it. Raises CapabilityError."""
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
        """The table by which the open drive corrects its axis itself; None where it holds none, or none was described."""
        return None

    # -- waiting, for backends and simple scripts --------------------------------------------------------------------
    def wait_for(
        self, condition: Callable[[DriveSample], bool], timeout_s: float, what: str, *, poll_s: float = 0.01
    ) -> DriveSample:
        """Sample every `poll_s` until the condition holds; MotionTimeoutError naming `what` after `timeout_s`."""
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
