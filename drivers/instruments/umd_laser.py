"""A µMD laser interferometer as a `DistanceInstrument`: port + protocol + clock + wavelength in air.

The display sends raw counts; wavelength, air index, direction and dead path are applied here. It counts increments, so after a lost
beam or port the zero is invalid: with `latch_loss` positions are withheld until `acknowledge_loss()`, whatever the signal does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from drivers.clock import Clock
from drivers.edlen import HELIUM_NEON_VACUUM_NM, refractive_index
from drivers.errors import InputError, LinkLostError
from drivers.instrument import DistanceInstrument, Environment, Reading, ReadingStatus
from drivers.instruments.lines import BadLine
from drivers.instruments.link import ByteLink
from drivers.instruments.umd import SLOW_SCALE, SampleState, SlowCode, UmdDecoder, UmdSample, lost_between

NM_PER_MM = 1e6


AirEquation = Callable[[float, float, float, float], float]
"""Index of air from °C, hPa, % and the vacuum wavelength in nm; raises InputError for air that cannot be."""


class Optics(IntEnum):
    """Units of displacement per wavelength, by the interferometer's optics."""

    LINEAR = 2  # retroreflector: λ/2
    PLANE_MIRROR = 4  # beam goes twice: λ/4
    HIGH_RESOLUTION = 8  # four times: λ/8


@dataclass(frozen=True)
class FixedAir:
    """Air values in °C, hPa, % that no sensor delivers, or that override a sensor; None means 'from the instrument'."""

    temp_c: float | None = None
    pressure_hpa: float | None = None
    humidity_percent: float | None = None


@dataclass(frozen=True)
class BesideOptics:
    """Angle or straightness optics on another axis of the display, 1 to 3. per_unit: its quantity per unit of displacement, signed."""

    axis: int
    per_unit: float


@dataclass(frozen=True)
class UmdSettings:
    """Set-up of the instrument. Raises InputError for values that cannot work.

    direction: +1 or −1, load motion for rising counts; phase_sign: +1 adds the phase's fraction, −1 subtracts it (firmware differs);
    axis: 1 to 3; places: name of a material thermometer -> slow code (3 or 4); dead_path_mm: length of air between the fixed optics
    and the zero, compensated from the first reading on; compensate_air False gives vacuum wavelengths; beside: record column -> optics
    on another axis.
    """

    optics: Optics = Optics.LINEAR
    vacuum_wavelength_nm: float = HELIUM_NEON_VACUUM_NM
    direction: int = 1
    phase_sign: int = 1
    axis: int = 1
    compensate_air: bool = True
    fixed_air: FixedAir = FixedAir()
    air_temp_code: int | None = SlowCode.TEMPERATURE_1
    places: Mapping[str, int] = field(default_factory=dict)
    dead_path_mm: float = 0.0
    latch_loss: bool = True
    air_equation: AirEquation = refractive_index
    beside: Mapping[str, BesideOptics] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("direction", self.direction, (1, -1)),
            ("phase_sign", self.phase_sign, (1, -1)),
            ("axis", self.axis, (1, 2, 3)),
        ):
            if value not in allowed:
                raise InputError(f"µMD {name} is {value}, expected one of {', '.join(map(str, allowed))}")
        if not 100.0 < self.vacuum_wavelength_nm < 2000.0:
            raise InputError(f"µMD vacuum_wavelength_nm is {self.vacuum_wavelength_nm:g}, expected 100 to 2000")
        for column, optics in self.beside.items():
            if optics.axis not in (1, 2, 3) or optics.axis == self.axis:
                raise InputError(
                    f"µMD axis of {column} is {optics.axis}, expected another of 1, 2, 3 than the position's"
                )
        thermometers = (SlowCode.TEMPERATURE_1, SlowCode.TEMPERATURE_2)
        for place, code in self.places.items():
            if code not in thermometers:
                raise InputError(f"µMD channel of {place} is {code}, expected 3 or 4")
            if code == self.air_temp_code:
                raise InputError(f"µMD channel {code} is named for the air and for {place}, expected one place each")


_STATUS = {
    SampleState.GOOD: ReadingStatus.GOOD,
    SampleState.HEAD_ERROR: ReadingStatus.HEAD_ERROR,
    SampleState.BEAM_LOST: ReadingStatus.BEAM_LOST,
    SampleState.OVERSPEED: ReadingStatus.OVERSPEED,
}


class UmdLaser(DistanceInstrument):
    """The instrument. `poll` returns the readings received and never waits; there is no thread.

    With `compensate_air`, good readings are withheld until the air's index is known.
    """

    name = "umd"
    numbers_samples = True

    def __init__(self, link: ByteLink, clock: Clock, settings: UmdSettings | None = None) -> None:
        self.settings = settings or UmdSettings()
        self._link = link
        self._clock = clock
        self._decoder = UmdDecoder()
        self._looked_ns = clock.now_ns()
        self._slow: dict[int, float] = {}
        self._slow_ns = 0
        self._beside: dict[str, float] = {}
        self._sequence: int | None = None
        self._latched: ReadingStatus | None = None
        self._unit_mm: float | None = None
        self._index_at_zero: float | None = None
        self._dead_path_shift_mm = 0.0
        self.bad_lines = 0
        self._update_unit()

    def open(self) -> None:
        self._link.open()
        self._start_anew()

    def _start_anew(self) -> None:
        self._decoder = UmdDecoder()
        self._looked_ns = self._clock.now_ns()

    def close(self) -> None:
        self._link.close()

    # -- readings ----------------------------------------------------------------------------------------------------
    def poll(self) -> list[Reading]:
        readings: list[Reading] = []
        began_ns = self._clock.now_ns()
        try:
            data = self._link.read_waiting()
        except LinkLostError:
            self._start_anew()
            if self.settings.latch_loss:
                self._latched = ReadingStatus.HEAD_ERROR
            raise
        now_ns = self._clock.now_ns()  # after it: the kernel may take its time to hand on what has arrived
        since_ns, self._looked_ns = self._looked_ns, began_ns
        if not data:
            return readings
        for event in self._decoder.feed(data):
            if isinstance(event, BadLine):
                self.bad_lines += 1
            else:
                reading = self._reading(event, now_ns, since_ns)
                if reading is not None:
                    readings.append(reading)
        return readings

    def _reading(self, sample: UmdSample, now_ns: int, since_ns: int) -> Reading | None:
        if sample.slow_code in SLOW_SCALE:
            self._hear(sample.slow_code, sample.slow_data, now_ns)
        lost = 0
        restarted = False
        if self._sequence is not None:
            between = lost_between(self._sequence, sample.sequence)
            restarted = between is None
            lost = between or 0
        self._sequence = sample.sequence
        if self.settings.beside:
            self._hear_beside(sample)
        axis = sample.axis(self.settings.axis)
        status = ReadingStatus.HEAD_ERROR if axis is None else _STATUS[axis.state]
        if restarted and status is ReadingStatus.GOOD:
            status = ReadingStatus.HEAD_ERROR  # it counts from another zero
        if self._latched is not None and status is ReadingStatus.GOOD:
            status = ReadingStatus.LOST_BEFORE
        elif status is not ReadingStatus.GOOD and self.settings.latch_loss:
            self._latched = status
        if status is not ReadingStatus.GOOD or axis is None:
            return Reading(now_ns, status, None, sample.sequence, lost, since_ns)
        if self._unit_mm is None:
            return None
        settings = self.settings
        phase = axis.units - axis.displacement
        units = axis.displacement + settings.phase_sign * phase
        position_mm = settings.direction * (units * self._unit_mm - self._dead_path_shift_mm)
        return Reading(now_ns, status, position_mm, sample.sequence, lost, since_ns)

    def acknowledge_loss(self) -> bool:
        """Allow positions again; their zero is another one."""
        latched, self._latched = self._latched, None
        return latched is not None

    # -- environment -------------------------------------------------------------------------------------------------
    def _hear(self, code: int, data: int, now_ns: int) -> None:
        if data < 0:
            self._slow.pop(code, None)  # the sensor is not fitted, or failed
        else:
            self._slow[code] = data * SLOW_SCALE[code]
        self._slow_ns = now_ns
        if code != SlowCode.SAMPLE_RATE:
            self._update_unit()

    def _hear_beside(self, sample: UmdSample) -> None:
        """A channel without a good signal gets no value."""
        for column, optics in self.settings.beside.items():
            axis = sample.axis(optics.axis)
            if axis is None or axis.state is not SampleState.GOOD:
                self._beside.pop(column, None)
            else:
                phase = axis.units - axis.displacement
                self._beside[column] = optics.per_unit * (axis.displacement + self.settings.phase_sign * phase)

    def _air(self) -> tuple[float | None, float | None, float | None]:
        fixed, slow, code = self.settings.fixed_air, self._slow, self.settings.air_temp_code
        return (
            fixed.temp_c if fixed.temp_c is not None else None if code is None else slow.get(code),
            fixed.pressure_hpa if fixed.pressure_hpa is not None else slow.get(SlowCode.PRESSURE),
            fixed.humidity_percent if fixed.humidity_percent is not None else slow.get(SlowCode.HUMIDITY),
        )

    def _update_unit(self) -> None:
        settings = self.settings
        vacuum_mm = settings.vacuum_wavelength_nm / NM_PER_MM / settings.optics
        if not settings.compensate_air:
            self._unit_mm = vacuum_mm
            return
        temp_c, pressure_hpa, humidity = self._air()
        if temp_c is None or pressure_hpa is None or humidity is None:
            return
        try:
            index = settings.air_equation(temp_c, pressure_hpa, humidity, settings.vacuum_wavelength_nm)
        except InputError:
            return  # an implausible sensor value changes nothing; it shows in environment()
        self._unit_mm = vacuum_mm / index
        if settings.dead_path_mm:
            if self._index_at_zero is None:
                self._index_at_zero = index
            self._dead_path_shift_mm = settings.dead_path_mm * (index - self._index_at_zero) / index

    def environment(self) -> Environment:
        temp_c, pressure_hpa, humidity = self._air()
        return Environment(
            time_ns=self._slow_ns,
            air_temp_c=temp_c,
            air_pressure_hpa=pressure_hpa,
            air_humidity_percent=humidity,
            place_temps_c={p: self._slow[code] for p, code in self.settings.places.items() if code in self._slow},
            beside=dict(self._beside),
        )

    @property
    def sample_rate_hz(self) -> float | None:
        return self._slow.get(SlowCode.SAMPLE_RATE)
