"""Recording of a drive and its instrument together, while a procedure moves and reads them: one file that `machine_replay` plays back.

CSV, one row for each look (one per reading in it) and one for each order, in time order: `order` counts the orders given so far,
`kind` is 1 for a row of a move, 2 of a homing, 0 of a look. Moves and homing are recorded; a recorded drive streams nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Self, TextIO

from drivers.clock import NS_PER_S, Clock
from drivers.correction_table import CorrectionTable
from drivers.drive import Capability, DriveSample, DriveState, DriveZero, HomingSpeeds, ServoDrive
from drivers.errors import InputError
from drivers.instrument import DistanceInstrument, Environment, Reading, ReadingStatus

LOOK, MOVE, HOME = 0, 1, 2
STATES, STATUSES = tuple(DriveState), tuple(ReadingStatus)
"""The codes of the columns `state` and `status`."""
ORDER = ("time_s", "order", "kind", "ordered_mm", "ordered_mm_s")
DRIVE = ("state", "motor_mm", "reached", "homed", "torque_percent")
INSTRUMENT = ("status", "laser_mm", "rate_hz", "air_temp_c", "air_pressure_hpa", "air_humidity_percent")


class MachineRecorder:
    """The file. places: of the instrument's thermometers, a column temp_<place>_c (°C) each; beside: columns of its other quantities.

    Raises InputError for a file that exists already or cannot be written.
    """

    def __init__(self, path: Path, clock: Clock, places: Sequence[str] = (), beside: Sequence[str] = ()) -> None:
        self._clock = clock
        self._start_ns = clock.now_ns()
        self._places = tuple(places)
        self._names = (*ORDER, *DRIVE, *INSTRUMENT, *(f"temp_{place}_c" for place in places), *beside)
        self._order = 0
        self._sample: DriveSample | None = None
        try:
            self._file: TextIO = path.open("x", encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be made: {error.strerror}", path=path) from error
        self._file.write("# drive and instrument, recorded together\n" + ",".join(self._names) + "\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._file.close()

    def sampled(self, sample: DriveSample) -> None:
        """Keep the drive's sample; it goes into the rows that follow."""
        self._sample = sample

    def ordered(self, kind: int, position_mm: float, velocity_mm_s: float, give: Callable[[], None]) -> None:
        """Give an order (mm, mm/s): a row before it, and one once the drive has taken it."""
        self._order += 1
        self._write({"kind": kind, "ordered_mm": position_mm, "ordered_mm_s": velocity_mm_s})
        give()
        self._write({"kind": LOOK})

    def looked(self, readings: Sequence[Reading], rate_hz: float | None, environment: Environment) -> None:
        """Write the readings that the instrument sent since the last look, one row each."""
        air = {
            "rate_hz": rate_hz,
            "air_temp_c": environment.air_temp_c,
            "air_pressure_hpa": environment.air_pressure_hpa,
            "air_humidity_percent": environment.air_humidity_percent,
        }
        air |= {f"temp_{place}_c": environment.place_temps_c.get(place) for place in self._places}
        air |= environment.beside
        if not readings:
            self._write({"kind": LOOK, **air})
        for reading in readings:
            status = STATUSES.index(reading.status)
            self._write({"kind": LOOK, "status": status, "laser_mm": reading.position_mm, **air})

    def _write(self, values: dict[str, float | None]) -> None:
        row: dict[str, float | None] = {
            "time_s": (self._clock.now_ns() - self._start_ns) / NS_PER_S,
            "order": self._order,
        }
        if (sample := self._sample) is not None:
            row |= {
                "state": STATES.index(sample.state),
                "motor_mm": sample.position_load_mm,
                "reached": sample.target_reached,
                "homed": sample.homed,
                "torque_percent": sample.torque_percent,
            }
        row |= values
        self._file.write(",".join(_cell(row.get(name)) for name in self._names) + "\n")


def _cell(value: float | None) -> str:
    if value is None or math.isnan(value):
        return ""
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))


class RecordedDrive(ServoDrive):
    """An open drive that is recorded. Orders and states are passed to the drive; what cannot be recorded raises CapabilityError."""

    def __init__(self, drive: ServoDrive, recorder: MachineRecorder) -> None:
        super().__init__(drive.name, drive.scaling, drive.limits, drive.clock)
        self.notes = drive.notes
        self._drive = drive
        self._recorder = recorder

    def open(self) -> None:
        self._drive.open()

    def close(self) -> None:
        self._drive.close()

    @property
    def capabilities(self) -> frozenset[Capability]:
        return self._drive.capabilities & {Capability.PROFILE_POSITION, Capability.HOMING}

    @property
    def correction_table(self) -> CorrectionTable | None:
        """The drive's own table, so that a second correction is refused; access to it is not recorded."""
        return self._drive.correction_table

    def sample(self) -> DriveSample:
        sample = self._drive.sample()
        self._recorder.sampled(sample)
        return sample

    def homing_speeds(self) -> HomingSpeeds:
        return self._drive.homing_speeds()

    def zero(self) -> DriveZero:
        """The drive's own zero; reading it is not recorded."""
        return self._drive.zero()

    def unit_parameters(self) -> Mapping[str, int | float]:
        """The drive's own units; reading them is not recorded."""
        return self._drive.unit_parameters()

    def read_number(self, name: str) -> tuple[str, int | float]:
        """A parameter of the drive; reading it is not recorded."""
        return self._drive.read_number(name)

    def says_homed(self) -> bool | None:
        return self._drive.says_homed()

    def _enable(self) -> None:
        self._drive.enable()

    def disable(self) -> None:
        self._drive.disable()

    def send_stop(self) -> None:
        self._drive.send_stop()

    def quick_stop(self) -> None:
        self._drive.quick_stop()

    def reset_fault(self) -> None:
        self._drive.reset_fault()

    def _start_homing(self) -> None:
        self._recorder.ordered(HOME, math.nan, math.nan, self._drive.start_homing)

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        def give() -> None:
            self._drive.start_move(position_load_mm, velocity_mm_s)

        self._recorder.ordered(MOVE, position_load_mm, velocity_mm_s, give)


class RecordedInstrument(DistanceInstrument):
    """An open instrument that is recorded."""

    def __init__(self, instrument: DistanceInstrument, recorder: MachineRecorder) -> None:
        self.name = instrument.name
        self.answers_when_asked = instrument.answers_when_asked
        self.numbers_samples = instrument.numbers_samples
        self._instrument = instrument
        self._recorder = recorder

    def open(self) -> None:
        self._instrument.open()

    def close(self) -> None:
        self._instrument.close()

    def poll(self) -> Sequence[Reading]:
        readings = self._instrument.poll()
        self._recorder.looked(readings, self.sample_rate_hz, self.environment())
        return readings

    def acknowledge_loss(self) -> bool:
        return self._instrument.acknowledge_loss()

    def environment(self) -> Environment:
        return self._instrument.environment()

    @property
    def sample_rate_hz(self) -> float | None:
        return self._instrument.sample_rate_hz
