"""A machine with a touch probe: X, Y, the spindle and the probe's signal, supervised together.

Every motion states whether it may end in a contact. An unexpected contact, and a missing one, stop the machine before
the error is raised.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from types import TracebackType
from typing import NoReturn, Protocol, Self

from drivers.clock import Clock
from drivers.drive import Capability, DriveSample, ServoDrive
from drivers.errors import CapabilityError, InputError, SafetyError, StateError
from drivers.touch_probe import Edge, TouchProbe
from drivers.undo import Step
from hil.machine.supervisor import Supervisor, finish_despite_interrupt
from hil.machine.watched_axis import WatchedAxis
from hil.probe.machine_file import ProbeMachineConfig

SPINDLE = "spindle"
ARRIVED_WITHIN = {"x": 0.01, "y": 0.01, "z": 0.01, SPINDLE: 0.05}
"""Tolerance of arrival, mm, and degrees of the spindle; contacts are not taken from the arrival."""
PULSE_S = 2.0
"""Time limit of one pulse, s."""
POLL_S = 0.005
"""Polling interval of axis and probe, s: the ball moves some µm in it at touching speed."""


class ContactError(SafetyError):
    """The probe signalled unexpectedly, or did not signal as expected; the machine was stopped."""


class UnexpectedContactError(ContactError):
    """A contact where none is expected."""


class NoContactError(ContactError):
    """No contact within the search travel."""


class ProbeSignal(Protocol):
    """The probe's signal as one drive shows it."""

    def touching(self) -> bool:
        """Whether the probe signals now. Raises CapabilityError or InputError where the drive does not show it."""


class ControlWires(Protocol):
    """The wires of a control that gives codes. Raises what reading and writing at a drive raises."""

    def inputs(self) -> int:
        """Levels of the inputs, one bit each."""

    def set_mfin(self, on: bool) -> None:
        """Switch the acknowledge."""

    def mfin(self) -> bool:
        """The acknowledge as the drive shows it."""

    def restore(self) -> None:
        """Switch the acknowledge off and put back what was set up for it."""


class ProbeSession:
    """A context manager; entering connects, and makes every check that is possible before any motion.

    drives: "x", "spindle" and, where there are such, "y" and "z"; signals: of those that touch; touching: the axes that will
    touch; mode: "latch" or "step", the machine file's by default
    Raises what `check` raises.
    """

    def __init__(
        self,
        config: ProbeMachineConfig,
        drives: Mapping[str, ServoDrive],
        signals: Mapping[str, ProbeSignal],
        *,
        touching: Sequence[str] = ("x",),
        mode: str | None = None,
    ) -> None:
        self.drives = dict(drives)
        self._axes = {name: WatchedAxis(drive) for name, drive in drives.items()}
        self._supervisor = Supervisor(list(self._axes.values()))
        self.config = config
        self.mode = config.probe.mode if mode is None else mode
        if self.mode not in ("latch", "step"):
            raise InputError(f"mode is {self.mode!r}, expected latch or step")
        self._signals = {name: signals[name] for name in touching}
        self._latches: dict[str, TouchProbe] = {}
        self.beside: Callable[[], None] = lambda: None
        """Is called with every sample of a motion; what it raises stops the machine."""

    @property
    def clock(self) -> Clock:
        return self._supervisor.clock

    # -- coming and going --------------------------------------------------------------------------------------------
    def __enter__(self) -> Self:
        with ExitStack() as opened:
            for drive in self.drives.values():
                drive.open()
                opened.callback(drive.close)
            self._supervisor.begin()
            self.check()
            opened.pop_all()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        closing: list[Step] = [
            (f"drive {drive.name} was not let go", drive.close) for drive in reversed(self.drives.values())
        ]
        self._supervisor.leave(exc, *self._disarming(), *closing)

    def check(self) -> None:
        """Checks capabilities and state at standstill. Raises CapabilityError for what a drive cannot do, StateError
        for a probe that signals or an axis that is not homed.
        """
        home = [Capability.HOMING] if self.config.home else []
        for drive in self.drives.values():
            drive.require(Capability.PROFILE_POSITION, *home)
        for name in self._signals:
            drive = self.drives[name]
            if self.mode == "latch" and Capability.TOUCH_PROBE not in drive.capabilities:
                raise CapabilityError(
                    f"drive {drive.name} cannot do: {Capability.TOUCH_PROBE.value}; nothing was moved, expected mode step,"
                    " which needs the probe's signal only"
                )
        if self.touching():
            raise StateError(
                "the probe signals before anything has moved: expected it clear, and connected as the machine file says"
            )
        for drive in self.drives.values():
            if drive.sample().homed is False and not self.config.home:
                raise StateError(
                    f"drive {drive.name} is not homed; home it first, or let home = true in [machine] do it"
                )

    def prepare(self) -> None:
        """Enables, and homes axes that are not homed where the machine file asks for it. Raises what stops an axis."""
        self._supervisor.enable()
        for name, axis in self._axes.items():
            if self.config.home and axis.drive.sample().homed is not True:
                self._supervisor.home(axis=axis, look=self._clear(name, "homing"))
        if self.mode == "latch" and not self._latches:
            self._latches = {name: self.drives[name].touch_probe() for name in self._signals}

    def rest(self) -> None:
        """Takes the power off every axis; `prepare` enables them again."""
        for drive in self.drives.values():
            drive.disable()

    def _disarming(self) -> list[Step]:
        """Steps that disarm the armed inputs."""
        latches, self._latches = self._latches, {}
        return [
            (
                f"the probe's input of drive {self.drives[name].name} may still be armed",
                partial(finish_despite_interrupt, partial(latch.disarm, self.config.probe.input)),
            )
            for name, latch in latches.items()
        ]

    # -- the probe's signal --------------------------------------------------------------------------------------------
    def touching(self) -> bool:
        """Whether any of the inputs in use shows a contact."""
        return any(signal.touching() for signal in self._signals.values())

    def _clear(
        self, name: str, what: str, allowed: Callable[[DriveSample], bool] = lambda _sample: False
    ) -> Callable[[DriveSample], None]:
        """Checks the probe with every sample: a contact raises an error unless it is allowed there."""

        def look(sample: DriveSample) -> None:
            self.beside()
            if self.touching() and not allowed(sample):
                raise UnexpectedContactError(
                    f"the probe touched at {self._at(name, sample)} during {what}, where nothing should be;"
                    " the machine was stopped there"
                )

        return look

    def _at(self, name: str, sample: DriveSample) -> str:
        unit = "°" if name == SPINDLE else " mm"
        return f"{self.drives[name].name} = {sample.position_load_mm:.3f}{unit}"

    def place(self, name: str) -> float:
        """Position of an axis, in the unit of its axis file."""
        return self.drives[name].sample().position_load_mm

    @property
    def angle_deg(self) -> float:
        """The spindle's angle."""
        return self.config.orientation.angle_deg(self.place(SPINDLE))

    # -- moving ------------------------------------------------------------------------------------------------------
    def move(self, name: str, target: float, speed: float | None = None) -> None:
        """Moves an axis to a position (mm or degrees), at the machine file's speed or this one. Raises
        UnexpectedContactError for a contact, and what stops the axis.
        """
        if self.touching():
            raise UnexpectedContactError(
                f"the probe touches while {self.drives[name].name} is to move to {target:.3f}; nothing was moved"
            )
        self._go(name, target, self._clear(name, "a move"), speed)

    def _go(self, name: str, target: float, look: Callable[[DriveSample], None], speed: float | None = None) -> None:
        self._supervisor.move(
            target,
            self._speed(name) if speed is None else speed,
            axis=self._axes[name],
            within_mm=ARRIVED_WITHIN[name],
            slice_s=POLL_S,
            look=look,
        )

    def raise_z(self) -> None:
        """Takes Z where the ball is above everything; nothing where Z is the operator's. Raises as `move`."""
        if self.config.approach is not None:
            self.move("z", self.config.approach.safe_mm)

    def approach(self, places: Mapping[str, float], z_mm: float | None, angle_deg: float | None = None) -> None:
        """Moves the axes one after the other, with Z raised before and lowered to z_mm afterwards; angle_deg: to which the
        spindle is turned before Z is lowered. Raises as `move`; a contact on the way down stops Z.
        """
        self.raise_z()
        for name, target in places.items():
            self.move(name, target)
        if angle_deg is not None:
            self.orient(angle_deg)
        if self.config.approach is not None and z_mm is not None:
            self.move("z", z_mm, self.config.approach.lower_mm_s)

    def leave(self, found_at: Mapping[str, float]) -> None:
        """Back to where the axes were found, Z raised before and last. Raises as `move`."""
        self.raise_z()
        # every angle is clear at a start; elsewhere only the angle that was found is known to be
        for name in (SPINDLE, "x", "y", "z"):
            if name in found_at:
                self.move(name, found_at[name])

    def orient(self, angle_deg: float) -> None:
        """Turns the spindle to an angle, degrees. Raises as `move`."""
        self.move(SPINDLE, self.config.orientation.position_deg(angle_deg))

    def _speed(self, name: str) -> float:
        config = self.config
        return config.orientation.velocity_deg_s if name == SPINDLE else config.probe.position_mm_s

    # -- touching ----------------------------------------------------------------------------------------------------
    def touch(self, name: str, direction: int, search_mm: float, free_mm: float = 0.0) -> float:
        """Feeds an axis from its position until contact, and moves back; returns its position at the contact, mm.

        By pulses the contact lies between the last pulse and the one before: their middle is returned. Raises
        LimitError before any motion, NoContactError after `search_mm`, UnexpectedContactError for a contact before
        `free_mm`.
        """
        drive = self.drives[name]
        start_mm = drive.sample().position_load_mm
        drive.limits.check_target(start_mm + direction * search_mm)
        find = self._latched if self.mode == "latch" else self._stepped
        contact_mm = find(name, start_mm, direction, search_mm)
        self._retreat(name, start_mm, contact_mm, direction)
        feed_mm = direction * (contact_mm - start_mm)
        if feed_mm < free_mm:
            raise UnexpectedContactError(
                f"the probe touched after {feed_mm:.4f} mm of {drive.name}, expected {free_mm:g} mm free of contact"
            )
        return contact_mm

    def _latched(self, name: str, start_mm: float, direction: int, search_mm: float) -> float:
        """The position that the drive latched."""
        drive, latch, probe = self.drives[name], self._latches[name], self.config.probe
        latch.arm(probe.input, [Edge.NEGATIVE if probe.normally_closed else Edge.POSITIVE])
        end_mm = start_mm + direction * search_mm
        found: list[float] = []
        seen: list[float] = []

        def contact(sample: DriveSample) -> bool:
            found.extend(one.position_load_mm for one in latch.poll())
            return bool(found) or sample.target_reached

        def allowed(sample: DriveSample) -> bool:
            """A signal comes with its latch; one without is of an input that is wired to another place."""
            seen.append(sample.position_load_mm)
            return abs(seen[-1] - seen[0]) <= probe.overtravel_mm

        what = f"touching with {drive.name}"
        look = self._clear(name, what, allowed)
        axis = self._axes[name]
        self._supervisor.move_until(contact, end_mm, probe.touch_mm_s, what, axis=axis, slice_s=POLL_S, look=look)
        if not found:
            self._no_contact(name, search_mm)
        return found[0]

    def _stepped(self, name: str, start_mm: float, direction: int, search_mm: float) -> float:
        """One pulse at a time until the probe signals."""
        drive, probe = self.drives[name], self.config.probe
        close_mm = 0.5 * (probe.pulse_mm + drive.scaling.resolution_load_mm)
        for pulses in range(1, int(search_mm / probe.pulse_mm) + 1):
            self._pulse(name, start_mm + direction * pulses * probe.pulse_mm, close_mm)
            with self._supervisor.stopping_on_error():
                self.clock.sleep_s(probe.settle_s)
                if self.touching():
                    return start_mm + direction * (pulses - 0.5) * probe.pulse_mm
        self._no_contact(name, search_mm)

    def _pulse(self, name: str, target_mm: float, close_mm: float) -> None:
        """One pulse further, until the axis has arrived; the probe is checked at rest."""
        self._supervisor.move_until(
            lambda sample: sample.target_reached and abs(sample.position_load_mm - target_mm) <= close_mm,
            target_mm,
            self.config.probe.touch_mm_s,
            "a pulse",
            axis=self._axes[name],
            timeout_s=PULSE_S,
            slice_s=POLL_S,
            look=lambda _sample: self.beside(),
        )

    def _no_contact(self, name: str, search_mm: float) -> NoReturn:
        drive = self.drives[name]
        with self._supervisor.stopping_on_error():
            raise NoContactError(
                f"no contact within {search_mm:g} mm of {drive.name}, which stands at {self.place(name):.3f} mm;"
                " the machine was stopped there"
            )

    def _retreat(self, name: str, start_mm: float, contact_mm: float, direction: int) -> None:
        """Back to the start; the signal has to disappear on the way."""
        overtravel_mm = self.config.probe.overtravel_mm

        def allowed(sample: DriveSample) -> bool:
            return direction * (contact_mm - sample.position_load_mm) <= overtravel_mm

        look = self._clear(name, "the way back from a contact", allowed)
        self._go(name, start_mm, look)
        if self.touching():
            raise UnexpectedContactError(
                f"the probe still signals {abs(contact_mm - start_mm):.3f} mm away from its contact; is it stuck?"
            )
