"""Builds the instrument of an axis file's [instrument] section. No other module names concrete instruments."""

from __future__ import annotations

from dataclasses import replace

from drivers import ciddor
from drivers import edlen as air
from drivers.clock import Clock
from drivers.errors import InputError
from drivers.instrument import DistanceInstrument
from drivers.instruments.ascii_values import AsciiDecoder, AsciiSettings
from drivers.instruments.gauge import Gauge
from drivers.instruments.link import PatientLink
from drivers.instruments.nd2xx import Nd2xxDecoder
from drivers.instruments.replay import Recording, ReplayInstrument, ReplaySettings
from drivers.instruments.serial_link import SerialLink
from drivers.instruments.umd_laser import Beside, FixedAir, Optics, UmdLaser, UmdSettings
from drivers.instruments.values import ValueProtocol
from hil.axis.axis_file import DisplayConfig, InstrumentConfig
from sim_backends.bench import BenchParameters
from sim_backends.gauge import GaugeParameters

PULSES_HZ = 10.0
"""Rate of the bench's pulse generator on the external input of a display, Hz."""

STRAIGHTNESS = "straightness_um"
"""The column of [instrument] beside for which the bench has straightness optics, on axis 2 of its display."""


def build_instrument(config: InstrumentConfig, port: str, clock: Clock) -> DistanceInstrument:
    """The instrument, not opened. port: of the axis file, or of the bench. The link opens a port again that disappears.

    Raises InputError for a file that is no recording, or for a wrong pattern.
    """
    if config.replay is not None:
        settings = ReplaySettings(config.replay.column, config.direction, config.replay.speed)
        return ReplayInstrument(Recording.read(config.replay.file), clock, settings)
    if config.display is not None:
        return _gauge(config.display, config, port, clock)
    return _umd(config, port, clock)


def _gauge(display: DisplayConfig, config: InstrumentConfig, port: str, clock: Clock) -> Gauge:
    line = SerialLink(
        port,
        baudrate=display.baud,
        bytesize=display.data_bits,
        parity=display.parity,
        stopbits=display.stop_bits,
    )
    protocol: ValueProtocol
    if config.kind == "nd2xx":
        protocol = Nd2xxDecoder(display.count_mm, pulsed=display.pulsed)
    else:
        request = display.request.encode("ascii")
        protocol = AsciiDecoder(AsciiSettings(display.pattern, display.fault, display.unit, display.decimals, request))
    return Gauge(PatientLink(line, clock), clock, protocol, direction=config.direction, name=config.kind)


def _umd(config: InstrumentConfig, port: str, clock: Clock) -> UmdLaser:
    fixed = config.fixed_air
    settings = UmdSettings(
        optics=Optics(config.wavelength_fraction),
        vacuum_wavelength_nm=config.vacuum_wavelength_nm,
        direction=config.direction,
        phase_sign=config.phase_sign,
        axis=config.axis,
        compensate_air=config.compensate_air,
        fixed_air=FixedAir(fixed.temp_c, fixed.pressure_hpa, fixed.humidity_percent),
        air_temp_code=config.air_temp_channel,
        places=config.place_temps,
        dead_path_mm=config.dead_path_mm,
        beside={column: Beside(*optics) for column, optics in (config.beside or {}).items()},
        air_equation=ciddor.refractive_index if config.air_equation == "ciddor" else air.refractive_index,
    )
    return UmdLaser(PatientLink(SerialLink(port), clock), clock, settings)


def with_instrument(parameters: BenchParameters, config: InstrumentConfig) -> BenchParameters:
    """The bench's parameters with the instrument of the axis file. Raises InputError for an instrument that the bench cannot
    simulate."""
    if config.trigger_input is not None:
        parameters = replace(parameters, trigger_input=config.trigger_input)
    if (beside := (config.beside or {}).get(STRAIGHTNESS)) is not None:
        laser = replace(parameters.laser, straightness_um_per_unit=beside[1])
        parameters = replace(parameters, laser=laser)
    display = config.display
    if display is None:
        return parameters
    kind = "mitutoyo" if display.pattern == "mitutoyo" else config.kind
    if kind == "ascii" and (display.pattern != "number" or display.unit != "mm" or display.request):
        raise InputError("[instrument] the bench writes patterns number (in mm, without a request) and mitutoyo")
    pulse_hz = PULSES_HZ if display.pulsed else None
    gauge = parameters.gauge or GaugeParameters()
    resolution_mm = display.count_mm or gauge.resolution_mm
    return replace(parameters, gauge=replace(gauge, kind=kind, pulse_hz=pulse_hz, resolution_mm=resolution_mm))
