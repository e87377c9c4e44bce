"""The [instrument] section of an axis file: what measures the axis, how it is reached, and how it stands.

What may go in: data and its checks, by kind. Concrete instruments are made from it by `hil.machine.instruments` alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.axis import reader
from hil.axis.reader import Table
from hil.figures.alignment import Alignment
from hil.figures.material import Material
from hil.machine.agreement import WITHIN_UM

KINDS = ("umd", "nd2xx", "ascii", "replay")
THERMOMETERS = (3, 4)
"""Temperature channels of a µMD display."""


@dataclass(frozen=True)
class FixedAirConfig:
    """Air values that no sensor delivers; None: the instrument's own."""

    temp_c: float | None = None
    pressure_hpa: float | None = None
    humidity_percent: float | None = None


@dataclass(frozen=True)
class DisplayConfig:
    """A display or gauge that sends a value in a line (kinds nd2xx and ascii), and its serial line.

    count_mm: of nd2xx, one step of the count that is asked for, None for the value displayed; pulsed: of nd2xx, it stores and sends a
    value at each pulse on its external input and is not asked; the others are of ascii (see `drivers.instruments.ascii_values`).
    """

    baud: int
    data_bits: int
    parity: str
    stop_bits: int
    count_mm: float | None = None
    pulsed: bool = False
    pattern: str = ""
    fault: str = ""
    unit: str = "mm"
    decimals: int | None = None
    request: str = ""


@dataclass(frozen=True)
class ReplayConfig:
    """A recording that is played. file: absolute; column: the one that is the position; speed: of playing."""

    file: str
    column: str
    speed: float


@dataclass(frozen=True)
class InstrumentConfig:
    """How to reach the instrument, and how it stands. kind: umd | nd2xx | ascii | replay.

    agrees_within_um: with the travel of the motor, besides reversal and a share of the travel (`hil.machine.agreement`).
    resume_within_s: after a lost signal the axis, stopped, waits so long for it and goes on by itself; None: the job ends.
    latency_s: from a sample to its arrival, None where nobody knows; trigger_input: of the drive's touch-probe inputs, the one that
    shares a line with the instrument, an edge with each sample.
    Of umd: wavelength_fraction, the optics, one count is λ/2, λ/4 or λ/8; place_temps, place -> temperature channel;
    air_temp_channel None, the air's temperature is fixed_air's; axis, 1 to 3 of a display with several; air_equation, ciddor, None
    for the modified Edlén equation; beside, record column -> axis and what one unit of it is. alignment: how the beam was found to
    lie; material: lengths are brought to 20 °C by it.
    """

    kind: str
    port: str
    direction: int
    stale_after_s: float
    agrees_within_um: float = WITHIN_UM
    resume_within_s: float | None = None
    latency_s: float | None = None
    trigger_input: int | None = None
    display: DisplayConfig | None = None
    replay: ReplayConfig | None = None
    wavelength_fraction: int = 2
    compensate_air: bool = False
    place_temps: dict[str, int] = field(default_factory=dict)
    vacuum_wavelength_nm: float = 632.9912
    axis: int = 1
    phase_sign: int = 1
    dead_path_mm: float = 0.0
    air_temp_channel: int | None = None
    fixed_air: FixedAirConfig = FixedAirConfig()
    air_equation: str | None = None
    beside: dict[str, tuple[int, float]] | None = None
    alignment: Alignment | None = None
    material: Material | None = None


def read_instrument(table: Table, *, has_port: bool) -> InstrumentConfig:
    """[instrument]; has_port False: the bench brings its own. Keys are those of the kind; another kind's are unknown."""
    kind = table.take("kind", reader.choice(*KINDS), " or ".join(KINDS), "umd")
    port = "" if kind == "replay" else "bench"
    if kind != "replay":
        port = table.take("port", reader.text, "a serial port", reader.REQUIRED if has_port else port)
    common: dict[str, Any] = {
        "kind": kind,
        "port": port,
        "direction": table.take("direction", reader.choice(1, -1), "1 or -1", 1),
        "stale_after_s": table.take("stale_after_s", reader.positive, "a number > 0 in s", 0.5),
        "agrees_within_um": table.take("instrument_agrees_within_um", reader.positive, "a number > 0 in µm", WITHIN_UM),
        "resume_within_s": table.take("resume_within_s", reader.between(1.0, 86_400.0), "seconds, 1 to 86400", None),
        "latency_s": table.take("latency_s", reader.between(-1.0, 10.0), "seconds, -1 to 10", None),
        "trigger_input": table.take("trigger_input", reader.choice(1, 2), "1 or 2", None),
    }
    config = {"umd": _umd, "nd2xx": _nd2xx, "ascii": _ascii, "replay": _replay}[kind](table, common)
    table.finish()
    return config


def _umd(table: Table, common: dict[str, Any]) -> InstrumentConfig:
    air_channel = table.take("air_temp_channel", reader.choice(0, *THERMOMETERS), "3, 4, or 0 for none", 3)
    config = InstrumentConfig(
        **common,
        wavelength_fraction=table.take("wavelength_fraction", reader.choice(2, 4, 8), "2, 4 or 8", 2),
        compensate_air=table.take("compensate_air", reader.flag, "true or false", True),
        fixed_air=_fixed_air(table),
        place_temps=table.take("place_temps", _channels, "a table of place = channel, 3 or 4", {}),
        vacuum_wavelength_nm=table.take(
            "vacuum_wavelength_nm", reader.between(101.0, 1999.0), "nm, 101 to 1999", 632.9912
        ),
        axis=table.take("axis", reader.choice(1, 2, 3), "1, 2 or 3", 1),
        phase_sign=table.take("phase_sign", reader.choice(1, -1), "1 or -1", 1),
        dead_path_mm=table.take("dead_path_mm", reader.between(-10_000.0, 10_000.0), "mm, -10000 to 10000", 0.0),
        air_temp_channel=air_channel or None,
        air_equation=table.take("air_equation", _air_equation, "edlen or ciddor", None),
        beside=table.take("beside", _beside, "a table of column = { axis = 1 to 3, per_unit = a number }", None),
        alignment=_alignment(table),
        material=_material(table),
    )
    _check_thermometers(table, config)
    return config


def _nd2xx(table: Table, common: dict[str, Any]) -> InstrumentConfig:
    count_mm = table.take("count_mm", reader.between(1e-6, 1.0), "mm, 0.000001 to 1", None)
    pulsed = table.take("pulsed", reader.flag, "true or false", False)
    if pulsed and count_mm is not None:
        raise table.fail("count_mm", "is for a count that is asked for, and a pulsed display sends what it shows")
    return InstrumentConfig(
        **common, display=DisplayConfig(**_line(table, 7, "E", 2), count_mm=count_mm, pulsed=pulsed)
    )


def _ascii(table: Table, common: dict[str, Any]) -> InstrumentConfig:
    config = DisplayConfig(
        **_line(table, 8, "N", 1),
        pattern=table.take("pattern", reader.text, "number, mitutoyo, or a regular expression", "number"),
        fault=table.take("fault", reader.text, "a regular expression", ""),
        unit=table.take("unit", reader.choice("mm", "um", "in"), "mm, um or in", "mm"),
        decimals=table.take("decimals", reader.whole(0, 9), "a whole number, 0 to 9", None),
        request=table.take("request", _short_text, "what asks for a value, up to 40 characters", ""),
    )
    return InstrumentConfig(**common, display=config)


def _line(table: Table, data_bits: int, parity: str, stop_bits: int) -> dict[str, Any]:
    return {
        "baud": table.take("baud", reader.whole(300, 4_000_000), "baud, 300 to 4000000", 9600),
        "data_bits": table.take("data_bits", reader.choice(7, 8), "7 or 8", data_bits),
        "parity": table.take("parity", reader.choice("N", "E", "O"), "N, E or O", parity),
        "stop_bits": table.take("stop_bits", reader.choice(1, 2), "1 or 2", stop_bits),
    }


def _replay(table: Table, common: dict[str, Any]) -> InstrumentConfig:
    base = table.path.resolve().parent

    def place(value: Any) -> str:
        return str(Path(base / reader.text(value)))

    config = ReplayConfig(
        file=table.take("file", place, "a recording, .csv or .csv.gz"),
        column=table.take("column", reader.text, "the column that is the position", "laser_mm"),
        speed=table.take("speed", reader.between(1e-3, 1e6), "a number, 0.001 to 1000000", 1.0),
    )
    return InstrumentConfig(**common, replay=config)


def _short_text(value: Any) -> str:
    """Control characters too: a request usually ends in one."""
    if not isinstance(value, str) or not 0 < len(value) <= 40 or not value.isascii():
        raise ValueError
    return value


def _fixed_air(table: Table) -> FixedAirConfig:
    air = table.child("fixed_air", required=False)
    config = FixedAirConfig(
        temp_c=air.take("temp_c", reader.between(-20.0, 60.0), "°C, -20 to 60", None),
        pressure_hpa=air.take("pressure_hpa", reader.between(500.0, 1200.0), "hPa, 500 to 1200", None),
        humidity_percent=air.take("humidity_percent", reader.between(0.0, 100.0), "%, 0 to 100", None),
    )
    air.finish()
    return config


def _air_equation(value: Any) -> str | None:
    chosen: str = reader.choice("edlen", "ciddor")(value)
    return None if chosen == "edlen" else chosen


def _beside(value: Any) -> dict[str, tuple[int, float]]:
    if not isinstance(value, dict):
        raise TypeError
    found = {}
    for column, optics in value.items():
        if set(optics) != {"axis", "per_unit"}:
            raise ValueError
        found[reader.name(column)] = (reader.choice(1, 2, 3)(optics["axis"]), reader.finite(optics["per_unit"]))
    return found


def _alignment(table: Table) -> Alignment | None:
    if "alignment" not in table.keys_left():
        return None
    part = table.child("alignment")
    near, far = "near_mm", "far_mm"
    config = Alignment(
        part.take(near, reader.finite, "a position in mm"),
        part.take(far, reader.finite, "a position in mm, 10 mm or more from near_mm"),
        part.take("height_mm", _near_and_far, "[near, far] in mm"),
        part.take("side_mm", _near_and_far, "[near, far] in mm"),
        part.take("read_within_mm", reader.positive, "a number > 0 in mm", 0.5),
        part.take("returning", reader.flag, "true or false", False),
    )
    part.finish()
    return config


def _near_and_far(value: Any) -> tuple[float, float]:
    near, far = reader.numbers(value)
    return near, far


def _material(table: Table) -> Material | None:
    if "material" not in table.keys_left():
        return None
    part = table.child("material")
    config = Material(
        part.take("expansion_ppm_per_k", reader.between(0.0, 100.0), "ppm/K, 0 to 100"),
        part.take("place", reader.name, 'a place of place_temps, or "air"'),
    )
    part.finish()
    return config


def _channels(value: Any) -> dict[str, int]:
    if not isinstance(value, dict):
        raise TypeError
    return {reader.name(place): reader.choice(*THERMOMETERS)(channel) for place, channel in value.items()}


def _check_thermometers(table: Table, config: InstrumentConfig) -> None:
    """One thermometer is in one place, one axis has one optics; air that is compensated must have a temperature from somewhere."""
    for place, channel in config.place_temps.items():
        if channel == config.air_temp_channel:
            raise table.fail("place_temps", f"gives {place} channel {channel}, which is the air's (air_temp_channel)")
    axes = [config.axis, *(axis for axis, _ in (config.beside or {}).values())]
    if len(set(axes)) != len(axes):
        raise table.fail("beside", f"gives an axis twice, or the position's own, {config.axis}")
    if config.material is not None and config.material.place not in ("air", *config.place_temps):
        raise table.fail(
            "material", f"is by the temperature of {config.material.place}, expected a place of place_temps"
        )
    if config.compensate_air and config.air_temp_channel is None and config.fixed_air.temp_c is None:
        raise table.fail("air_temp_channel", "is 0 and fixed_air has no temp_c, expected one of them to compensate air")
