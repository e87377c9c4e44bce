"""Builds the instrument of an axis file's [instrument] section. No other module names concrete instruments, and a job loads only its
own."""

# ruff: noqa: PLC0415

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.clock import Clock
from drivers.instrument import DistanceInstrument
from drivers.instruments.link import PatientLink
from drivers.instruments.serial_link import SerialLink
from hil.axis.axis_file import DisplayConfig, InstrumentConfig

if TYPE_CHECKING:
    from drivers.instruments.values import ValueProtocol


def build_instrument(config: InstrumentConfig, port: str, clock: Clock) -> DistanceInstrument:
    """The instrument, not opened. port: of the axis file, or of the bench. The link opens a port again that disappears.

    Raises InputError for a file that is no recording, or for a wrong pattern.
    """
    if config.replay is not None:
        from drivers.instruments.replay import Recording, ReplayInstrument, ReplaySettings

        settings = ReplaySettings(config.replay.column, config.direction, config.replay.speed)
        return ReplayInstrument(Recording.read(config.replay.file), clock, settings)
    if config.display is not None:
        return _gauge(config.display, config, port, clock)
    return _umd(config, port, clock)


def _gauge(display: DisplayConfig, config: InstrumentConfig, port: str, clock: Clock) -> DistanceInstrument:
    from drivers.instruments.ascii_values import AsciiDecoder, AsciiSettings
    from drivers.instruments.gauge import Gauge
    from drivers.instruments.nd2xx import Nd2xxDecoder

    line = SerialLink(
        port, baudrate=display.baud, bytesize=display.data_bits, parity=display.parity, stopbits=display.stop_bits
    )
    protocol: ValueProtocol
    if config.kind == "nd2xx":
        protocol = Nd2xxDecoder(display.count_mm, pulsed=display.pulsed)
    else:
        request = display.request.encode("ascii")
        protocol = AsciiDecoder(AsciiSettings(display.pattern, display.fault, display.unit, display.decimals, request))
    return Gauge(PatientLink(line, clock), clock, protocol, direction=config.direction, name=config.kind)


def _umd(config: InstrumentConfig, port: str, clock: Clock) -> DistanceInstrument:
    from drivers import ciddor
    from drivers import edlen as air
    from drivers.instruments.umd_laser import BesideOptics, FixedAir, Optics, UmdLaser, UmdSettings

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
        beside={column: BesideOptics(*optics) for column, optics in (config.beside or {}).items()},
        air_equation=ciddor.refractive_index if config.air_equation == "ciddor" else air.refractive_index,
    )
    return UmdLaser(PatientLink(SerialLink(port), clock), clock, settings)
