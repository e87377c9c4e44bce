"""Playback of a recording of `machine_recording` as drive and instrument together: a procedure repeated on a recorded measurement.

The recording is cut at its orders. An order must equal the recorded one, and starts its stretch; within it, looks return what
was recorded at that time after the order. An order that was not recorded raises StateError: nothing is made up.
"""

from __future__ import annotations

from bisect import bisect_right
from math import isfinite, isnan, nan

from drivers.clock import NS_PER_S, Clock
from drivers.drive import FAULTS, Capability, DriveSample, DriveState, ServoDrive
from drivers.errors import InputError, StateError
from drivers.instrument import DistanceInstrument, Environment, Reading
from drivers.instruments.replay import Recording
from drivers.limits import DriveLimits
from drivers.machine_recording import DRIVE, HOME, INSTRUMENT, MOVE, ORDER, STATES, STATUSES
from drivers.scaling import AxisScaling

SAME_MM = 1e-6


class MachineReplay:
    """The playback position, shared by drive and instrument. Raises InputError for a file that is no such recording."""

    def __init__(self, recording: Recording, clock: Clock) -> None:
        missing = [name for name in (*ORDER, *DRIVE, *INSTRUMENT) if name not in recording.columns]
        if missing:
            raise InputError(f"is no recording of drive and instrument together, it lacks {', '.join(missing)}")
        self.clock = clock
        self.columns = recording.columns
        orders = recording.column("order")
        self._starts = [0, *(row for row in range(1, len(orders)) if orders[row] != orders[row - 1]), len(orders)]
        self._stretch = 0
        self._start_ns = clock.now_ns()

    def start(self) -> None:
        """Play from the beginning, now."""
        self._stretch, self._start_ns = 0, self.clock.now_ns()

    @property
    def first_row(self) -> int:
        """First row of the stretch being played."""
        return self._starts[self._stretch]

    def rows_until_now(self) -> int:
        """One more than the last row of the stretch that has been played by now."""
        first, end = self._starts[self._stretch : self._stretch + 2]
        times = self.columns["time_s"]
        now_s = (
            times[first] + (self.clock.now_ns() - self._start_ns + 1) / NS_PER_S
        )  # a nanosecond for the rounding of seconds
        return bisect_right(times, now_s, first, end)

    def time_ns(self, row: int) -> int:
        """The clock's time at which a row of this stretch is played, ns."""
        times = self.columns["time_s"]
        return self._start_ns + round((times[row] - times[self.first_row]) * NS_PER_S)

    def order(self, kind: int, position_mm: float) -> None:
        """Go on to the next stretch (position in mm); returns once the order had been taken. Raises StateError for another order."""
        if self._stretch + 2 >= len(self._starts):
            raise StateError("the recording ends here, expected no further command")
        row = self._starts[self._stretch + 1]
        was_kind, was_mm = self.columns["kind"][row], self.columns["ordered_mm"][row]
        if was_kind != kind or not (kind == HOME or abs(was_mm - position_mm) <= SAME_MM):
            was = "homes" if was_kind == HOME else f"moves to {was_mm:.6f} mm"
            asked = "homing" if kind == HOME else f"a move to {position_mm:.6f} mm"
            raise StateError(f"the recording {was} here, asked for was {asked}")
        self._stretch += 1
        self._start_ns = self.clock.now_ns()
        if row + 1 < self._starts[self._stretch + 1]:
            self.clock.sleep_until_ns(self.time_ns(row + 1))


class ReplayDrive(ServoDrive):
    """The drive of a recording. A move or homing other than the recorded one raises StateError."""

    def __init__(self, name: str, scaling: AxisScaling, limits: DriveLimits, replay: MachineReplay) -> None:
        super().__init__(name, scaling, limits, replay.clock)
        self._replay = replay
        self._enabled = False

    def open(self) -> None:
        self._replay.start()
        self._enabled = False

    def close(self) -> None:
        self._enabled = False

    @property
    def capabilities(self) -> frozenset[Capability]:
        return frozenset({Capability.PROFILE_POSITION, Capability.HOMING})

    def sample(self) -> DriveSample:
        columns = self._replay.columns
        row = max(self._replay.rows_until_now() - 1, 0)
        state = STATES[int(columns["state"][row])] if isfinite(columns["state"][row]) else DriveState.SWITCH_ON_DISABLED
        if state not in FAULTS:
            state = DriveState.ENABLED if self._enabled else DriveState.SWITCH_ON_DISABLED
        torque, homed = columns["torque_percent"][row], columns["homed"][row]
        return DriveSample(
            self.clock.now_ns(),
            state,
            columns["motor_mm"][row],
            # the row of an order holds the sample from before it
            target_reached=bool(columns["reached"][row] == 1) and columns["kind"][row] == 0,
            torque_percent=None if isnan(torque) else torque,
            homed=None if isnan(homed) else homed == 1,
        )

    def _enable(self) -> None:
        self._enabled = True

    def disable(self) -> None:
        self._enabled = False

    def send_stop(self) -> None:
        self._enabled = False

    def quick_stop(self) -> None:
        self._enabled = False

    def reset_fault(self) -> None:
        """Does nothing: a recorded fault stays."""

    def _start_homing(self) -> None:
        self._replay.order(HOME, nan)

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        self._replay.order(MOVE, position_load_mm)


class ReplayedInstrument(DistanceInstrument):
    """The instrument of a recording, to be used with its drive."""

    name = "replay"

    def __init__(self, replay: MachineReplay) -> None:
        self._replay = replay
        self._next = 0
        known = {*ORDER, *DRIVE, *INSTRUMENT}
        self._temps = [name for name in replay.columns if name.startswith("temp_") and name.endswith("_c")]
        self._beside = [name for name in replay.columns if name not in known and name not in self._temps]

    def open(self) -> None:
        self._next = 0

    def close(self) -> None:
        """Does nothing: no file is kept open."""

    def poll(self) -> list[Reading]:
        end = self._replay.rows_until_now()
        rows = range(max(self._next, self._replay.first_row), end)
        self._next = max(self._next, end)
        status, position = self._replay.columns["status"], self._replay.columns["laser_mm"]
        return [
            Reading(
                self._replay.time_ns(row),
                STATUSES[int(status[row])],
                None if isnan(position[row]) else position[row],
                row,
            )
            for row in rows
            if isfinite(status[row])
        ]

    def _latest(self, name: str) -> float | None:
        value = self._replay.columns[name][max(self._next - 1, 0)]
        return value if isfinite(value) else None

    def environment(self) -> Environment:
        places = {name[5:-2]: value for name in self._temps if (value := self._latest(name)) is not None}
        return Environment(
            self._replay.clock.now_ns(),
            self._latest("air_temp_c"),
            self._latest("air_pressure_hpa"),
            self._latest("air_humidity_percent"),
            places,
            {name: value for name in self._beside if (value := self._latest(name)) is not None},
        )

    @property
    def sample_rate_hz(self) -> float | None:
        return self._latest("rate_hz")
