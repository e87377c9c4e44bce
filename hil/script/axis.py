"""An axis as one object for scripts and for procedures of users: it is looked at and moved."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from drivers.clock import NS_PER_S
from drivers.drive import DriveSample, DriveState
from drivers.errors import CapabilityError, InputError, LimitError, StateError
from hil.axis.axis_file import AxisConfig, DriveAxis, load_drive_axis
from hil.desk.rows import AxisReading, Rows
from hil.machine.events import Listener
from hil.script.given import Passwords

if TYPE_CHECKING:  # drivers and fits load slowly
    from drivers.instrument import Reading
    from hil.desk.axis_thread import DeskConnection
    from hil.desk.plan import Move
    from hil.desk.zero_statement import ZeroStatement
    from hil.machine.session import AxisSession
    from hil.machine.supervisor import Supervisor

ROUNDED = 1e-9
"""What a place (mm) and, as a share, a velocity may be beyond a planned move: they are sums and quotients of set-points."""


@dataclass(frozen=True)
class _Arrival:
    """The last move, as `AxisReading` names it."""

    target_mm: float
    command_mm: float
    direction: int
    since_reversal_mm: float | None = None
    stroke_mm: float | None = None


class Axis:
    """An axis that is looked at and moved, as a procedure of yours is given it."""

    def __init__(
        self, file: DriveAxis, passwords: Passwords, on_event: Listener, connection: DeskConnection | None = None
    ) -> None:
        self.file = file
        self._passwords = passwords
        self._listener = on_event
        self._connection = connection
        self._alone: Supervisor | None = None  # of a drive without an instrument
        self._opened_ns = 0
        self._homed = False  # the datum is taken, and the history known
        self._last: _Arrival | None = None
        self._moves: tuple[Move, ...] | None = None  # that a procedure may make; None: no procedure runs
        self._first_run = 1

    @property
    def name(self) -> str:
        """Name of the axis in its file."""
        return self.file.name

    @property
    def first_run(self) -> int:
        """The first run that a procedure has to measure: 1, or the one that was interrupted."""
        return self._first_run

    def __repr__(self) -> str:
        return f"<axis {self.name} of {self.file.path}{'' if self._connection else ', not open'}>"

    def confine(self, moves: tuple[Move, ...], first_run: int, begun_ns: int) -> None:
        """For the job of a procedure: the axis is homed, and moves within these moves alone. begun_ns: when its time began."""
        self._moves, self._first_run, self._opened_ns, self._homed = moves, first_run, begun_ns, True

    def hold(self) -> None:
        """For the job of a procedure that an error ends: no further move is one that its plan names."""
        self._moves = ()

    def _require(self) -> DeskConnection:
        if self._connection is None:
            raise StateError(f'axis {self.name} is not open, expected: with hil.open("{self.file.path}") as axis')
        return self._connection

    @property
    def _supervisor(self) -> Supervisor:
        session = self._require().session
        if session is not None:
            return session.supervisor
        if self._alone is None:
            raise StateError(f"axis {self.name} is not open")
        return self._alone

    def _session(self) -> AxisSession:
        session = self._require().session
        if session is None:
            raise CapabilityError(f"axis {self.name} has no instrument: its file ends with the drive")
        return session

    # -- looking -------------------------------------------------------------------------------------------------------
    def read(self) -> AxisReading:
        """Drive, motor and instrument. At rest the instrument is averaged over reading_s, under power after a dwell. Raises
        MeasurementLostError without readings."""
        connection = self._require()
        session, drive = connection.session, connection.drive
        if session is None:
            return self._reading(self._supervisor.axes[0].look()[0], None)
        enabled = drive.sample().state is DriveState.ENABLED
        if self._homed and enabled:
            found = session.read_position()
            return self._reading(found.sample, found.position_load_mm, std_um=found.std_um)
        if enabled:
            return self._reading(drive.sample(), None, raw_mm=session.raw_average())
        positions = [one.position_mm for one in session.watch(session.how.reading_s) if one.position_mm is not None]
        if not positions:
            session.await_instrument()
        raw_mm = sum(positions) / len(positions) if positions else None
        return self._reading(drive.sample(), None, raw_mm=raw_mm)

    def watch(self, seconds: float, every_s: float = 0.05) -> Iterator[AxisReading]:
        """Yield readings for this time, as they come. An error of drive or instrument stops the axis and is raised."""
        axis, clock = self._supervisor.axes[0], self._require().drive.clock
        deadline, due_ns = clock.deadline(seconds), clock.now_ns()
        while not deadline.expired:
            due_ns = max(clock.now_ns(), due_ns + round(every_s * NS_PER_S))
            with self._supervisor.stopping_on_error():
                clock.sleep_until_ns(min(due_ns, deadline.end_ns))
                sample, readings = axis.look()
            yield self._with(sample, readings)

    def _with(self, sample: DriveSample, readings: Sequence[Reading]) -> AxisReading:
        session = self._require().session
        good = [one for one in readings if one.position_mm is not None]
        if session is None or not good:
            return self._reading(sample, None)
        if not self._homed:
            return self._reading(sample, None, raw_mm=good[-1].position_mm)
        return self._reading(sample, session.load_position_mm(good[-1]))

    def _reading(
        self,
        sample: DriveSample,
        instrument_mm: float | None,
        *,
        raw_mm: float | None = None,
        std_um: float | None = None,
    ) -> AxisReading:
        last = {} if self._last is None else asdict(self._last)
        return AxisReading(
            (sample.time_ns - self._opened_ns) / NS_PER_S,
            sample.state.value,
            sample.position_load_mm,
            instrument_mm,
            raw_mm,
            std_um,
            sample.velocity_mm_s,
            sample.torque_percent,
            sample.following_error_mm,
            sample.homed,
            sample.fault_code,
            sensors=self._sensors(),
            **last,
        )

    def _sensors(self) -> dict[str, float]:
        session = self._require().session
        known = {} if session is None else session.known()
        return {name: value for name, value in known.items() if name not in ("time_s", "velocity_mm_s")}

    # -- moving --------------------------------------------------------------------------------------------------------
    def home(self, *, corrected: bool = False, new_zero: bool = False, instrument_zeroed: bool = False) -> None:
        """Enable, home if the axis file says so, and set the instrument's datum at the reference position.

        corrected: whether the stored correction is in force afterwards; new_zero, instrument_zeroed: as the options of the verbs.
        """
        session = self._require().session
        if self._moves is not None:
            raise StateError(f"axis {self.name} is homed already: a procedure begins so")
        self._last = None
        if session is None:
            self._supervisor.get_ready(home=True)
            self._homed = True
            return
        store = self._passwords.store(self._measured_file(), writing=False) if corrected else None
        compensation = None if store is None else store.load()
        self._homed = False
        session.compensation = None
        with stated(new_zero, instrument_zeroed).applied(session):
            session.prepare(None, compensation)
        session.compensation = compensation
        self._homed = True

    def move_to(self, position_mm: float, velocity_mm_s: float | None = None) -> None:
        """Move to a position, mm of the load, and return on arrival.

        velocity_mm_s: None takes that of [measurement]. Raises StateError before `home()` and after a stop, LimitError for a target
        outside the travel, and the error that stops the axis.
        """
        connection = self._require()
        session, sample = connection.session, connection.drive.sample()
        lost = session is not None and session.history is None
        if not self._homed or lost or sample.state is not DriveState.ENABLED:
            raise StateError(f"axis {self.name} is {sample.state.value} and not ready to move, expected home() first")
        connection.drive.limits.check_target(position_mm)
        velocity = self._velocity(velocity_mm_s)
        self._check_planned(position_mm, velocity)
        if session is None:
            before_mm = sample.position_load_mm if self._last is None else self._last.target_mm
            came = 0 if position_mm == before_mm else 1 if position_mm > before_mm else -1
            self._supervisor.move(position_mm, velocity)
            direction = came or (0 if self._last is None else self._last.direction)
            self._last = _Arrival(position_mm, position_mm, direction)
            return
        command = session.move_to(position_mm, velocity)
        way = command.history
        self._last = _Arrival(
            position_mm, command.command_mm, way.direction, way.since_reversal_mm, way.stroke_or_long_mm
        )

    def _check_planned(self, position_mm: float, velocity_mm_s: float) -> None:
        """Raises LimitError for a move that a running procedure has not planned."""
        moves = self._moves
        if moves is not None and not any(
            one.low_mm - ROUNDED <= position_mm <= one.high_mm + ROUNDED
            and velocity_mm_s <= one.velocity_mm_s * (1.0 + ROUNDED)
            for one in moves
        ):
            raise LimitError(f"{position_mm:g} mm at {velocity_mm_s:g} mm/s is no move that plan() names")

    def _velocity(self, velocity_mm_s: float | None) -> float:
        if velocity_mm_s is not None:
            return velocity_mm_s
        if not isinstance(self.file, AxisConfig):
            raise InputError("has no [measurement] velocity_mm_s, expected one with the call", path=self.file.path)
        return self.file.measurement.velocity_mm_s

    def disable(self) -> None:
        """Switch off the power of the drive."""
        connection = self._require()
        connection.drive.disable()
        self._homed, self._last = False, None
        if connection.session is not None:
            connection.session.command_state.forget()

    def stream(self, positions_mm: Iterable[float], period_s: float, *, following_error_mm: float = 1.0) -> Rows:
        """Follow set-points, one each period, from where the axis stands; corrected after `home(corrected=True)`.

        Returns time_s, target_mm and motor_mm of each period. Raises StateError before `home()`, and LimitError for a target outside
        the travel. Any error stops the axis.
        """
        from drivers.set_points import SetPointSettings, SetPointStream  # noqa: PLC0415

        session = self._session()
        if not self._homed:
            raise StateError(f"axis {self.name}: expected home() before stream()")
        targets: list[float] = []
        found: list[tuple[int, float]] = []

        def path() -> Iterator[tuple[float, float]]:
            before_mm = session.command_state.known_history.position_mm
            for target_mm in positions_mm:
                self._check_planned(target_mm, abs(target_mm - before_mm) / period_s)
                targets.append(target_mm)
                yield target_mm, (target_mm - before_mm) / period_s
                before_mm = target_mm

        def at(stream: SetPointStream) -> None:
            found.append(stream.found[0])

        session.stream_along(path(), SetPointSettings(period_s, following_error_mm), at)
        self._last = None
        times = [(time_ns - self._opened_ns) / NS_PER_S for time_ns, _ in found]
        return Rows.from_lists(time_s=times, target_mm=targets[: len(found)], motor_mm=[place for _, place in found])

    def _measured_file(self, **given: Any) -> AxisConfig:
        """The axis file with these values in its sections, checked as its own. Raises CapabilityError without an instrument."""
        used = {section: values for section, values in given.items() if values}
        axis = load_drive_axis(self.file.path, used) if used else self.file
        if not isinstance(axis, AxisConfig):
            raise CapabilityError(f"axis {self.name} has no instrument: its file ends with the drive")
        return axis


def stated(new_zero: bool, instrument_zeroed: bool) -> ZeroStatement:
    from hil.desk.zero_statement import ZeroStatement  # noqa: PLC0415  (drivers load slowly)

    return ZeroStatement(new_zero, instrument_zeroed)
