"""The [instrument] section of an axis file: what measures the axis, how it is reached, and how it stands.

What may go in: data and its checks, by kind. Concrete instruments are made from it by `hil.machine.instruments` alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from drivers.toml_schema import Document
from drivers.toml_types import File, Key, Limits, Name, Number, Positive, SchemaError, Text, Via, one_of
from drivers.value_pattern import EXPECTED, MM, fault_pattern, value_pattern
from hil.axis.agreement import WITHIN_UM
from hil.figures.alignment import Alignment
from hil.figures.material import Material

KINDS = ("umd", "nd2xx", "ascii", "replay")
THERMOMETERS = (3, 4)
"""Temperature channels of a µMD display."""

_COMMON = "kind direction stale_after_s instrument_agrees_within_um resume_within_s latency_s trigger_input port"
_LINE = "baud data_bits parity stop_bits"
_KEYS = {
    "umd": f"{_COMMON} wavelength_fraction compensate_air place_temps vacuum_wavelength_nm axis phase_sign dead_path_mm"
    " air_temp_channel fixed_air air_equation beside alignment material",
    "nd2xx": f"{_COMMON} {_LINE} count_mm pulsed",
    "ascii": f"{_COMMON} {_LINE} pattern fault unit decimals request",
    "replay": f"{_COMMON.removesuffix(' port')} file column speed",
}
_LINES: dict[str, dict[str, Any]] = {
    "nd2xx": {"baud": 9600, "data_bits": 7, "parity": "E", "stop_bits": 2},
    "ascii": {"baud": 9600, "data_bits": 8, "parity": "N", "stop_bits": 1},
}


@dataclass(frozen=True)
class _Beside:
    """Optics on another axis of the display."""

    axis: Annotated[int, one_of(1, 2, 3)]
    per_unit: Number


AirChannel = Annotated[int | None, Via(Literal[0, 3, 4], lambda channel, _: channel or None)]
AirEquation = Annotated[str | None, Via(Literal["edlen", "ciddor"], lambda name, _: None if name == "edlen" else name)]
Recording = Annotated[str, Via(File, lambda path, _: str(path), "a recording, .csv or .csv.gz")]


def _optics(beside: dict[str, _Beside], _: Document) -> dict[str, tuple[int, float]]:
    return {column: (optics.axis, optics.per_unit) for column, optics in beside.items()}


@dataclass(frozen=True)
class FixedAirConfig:
    """Air values that no sensor delivers; None: the instrument's own."""

    temp_c: Annotated[float, Limits(ge=-20.0, le=60.0)] | None = None
    pressure_hpa: Annotated[float, Limits(ge=500.0, le=1200.0)] | None = None
    humidity_percent: Annotated[float, Limits(ge=0.0, le=100.0)] | None = None


def _length_unit(value: str, _: Any) -> str:
    if value.casefold() not in MM:
        raise ValueError
    return value.casefold()


@dataclass(frozen=True)
class DisplayConfig:
    """A display or gauge that sends a value in a line (kinds nd2xx and ascii), and its serial line.

    count_mm: of nd2xx, one step of the count that is asked for, None for the value displayed; pulsed: of nd2xx, it stores and sends a
    value at each pulse on its external input and is not asked; the others are of ascii (see `drivers.instruments.ascii_values`).
    """

    baud: Annotated[int, Limits(ge=300, le=4_000_000)]
    data_bits: Annotated[int, one_of(7, 8)]
    parity: Annotated[str, one_of("N", "E", "O")]
    stop_bits: Annotated[int, one_of(1, 2)]
    count_mm: Annotated[float, Limits(ge=1e-6, le=1.0)] | None = None
    pulsed: bool = False
    pattern: Annotated[Text, Limits(description=EXPECTED)] = ""
    fault: Annotated[Text, Limits(description="a regular expression")] = ""
    unit: Annotated[str, Via(Text, _length_unit, "mm, um or in, small or capital")] = "mm"
    decimals: Annotated[int, Limits(ge=0, le=9)] | None = None
    request: Annotated[
        str, Limits(pattern=r"\A[\x00-\x7f]{1,40}\Z", description="ASCII text of up to 40 characters")
    ] = ""

    def __post_init__(self) -> None:
        if self.pulsed and self.count_mm is not None:
            raise SchemaError("count_mm", "is for a count that is asked for, and a pulsed display sends what it shows")
        if self.pattern:
            value_pattern(self.pattern)
        fault_pattern(self.fault)


@dataclass(frozen=True)
class ReplayConfig:
    """A recording that is played. file: absolute; column: the one that is the position; speed: of playing."""

    file: Recording
    column: Annotated[Text, Limits(description="the column that is the position")] = "laser_mm"
    speed: Annotated[float, Limits(ge=1e-3, le=1e6)] = 1.0


@dataclass(frozen=True)
class InstrumentConfig:
    """How to reach the instrument, and how it stands. kind: umd | nd2xx | ascii | replay.

    agrees_within_um: with the travel of the motor, besides reversal and a share of the travel (`hil.axis.agreement`).
    resume_within_s: after a lost signal the axis, stopped, waits so long for it and goes on by itself; None: the job ends.
    latency_s: from a sample to its arrival, None where nobody knows; trigger_input: of the drive's touch-probe inputs, the one that
    shares a line with the instrument, an edge with each sample.
    Of umd: wavelength_fraction, the optics, one count is λ/2, λ/4 or λ/8; place_temps, place -> temperature channel;
    air_temp_channel None, the air's temperature is fixed_air's; axis, 1 to 3 of a display with several; air_equation, ciddor, None
    for the modified Edlén equation; beside, record column -> axis and what one unit of it is. alignment: how the beam was found to
    lie; material: lengths are brought to 20 °C by it.
    """

    kind: Annotated[str, one_of(*KINDS)]
    port: Annotated[Text, Limits(description="a serial port")]
    direction: Annotated[int, one_of(1, -1)]
    stale_after_s: Positive
    agrees_within_um: Annotated[Positive, Key("instrument_agrees_within_um")] = WITHIN_UM
    resume_within_s: Annotated[float, Limits(ge=1.0, le=86_400.0)] | None = None
    latency_s: Annotated[float, Limits(ge=-1.0, le=10.0)] | None = None
    trigger_input: Annotated[int, one_of(1, 2)] | None = None
    display: Annotated[DisplayConfig | None, Key("")] = None
    replay: Annotated[ReplayConfig | None, Key("")] = None
    wavelength_fraction: Annotated[int, one_of(2, 4, 8)] = 2
    compensate_air: bool = False
    place_temps: dict[Name, Annotated[int, one_of(*THERMOMETERS)]] = field(default_factory=dict)
    vacuum_wavelength_nm: Annotated[float, Limits(ge=101.0, le=1999.0)] = 632.9912
    axis: Annotated[int, one_of(1, 2, 3)] = 1
    phase_sign: Annotated[int, one_of(1, -1)] = 1
    dead_path_mm: Annotated[float, Limits(ge=-10_000.0, le=10_000.0)] = 0.0
    air_temp_channel: AirChannel = None
    fixed_air: FixedAirConfig = FixedAirConfig()
    air_equation: AirEquation = None
    beside: Annotated[dict[str, tuple[int, float]] | None, Via(dict[Name, _Beside], _optics)] = None
    alignment: Alignment | None = None
    material: Material | None = None

    def __post_init__(self) -> None:
        """One thermometer is in one place, one axis has one optics; air that is compensated must have a temperature from somewhere."""
        for place, channel in self.place_temps.items():
            if channel == self.air_temp_channel:
                raise SchemaError(
                    "place_temps", f"gives {place} channel {channel}, which is the air's (air_temp_channel)"
                )
        axes = [self.axis, *(axis for axis, _ in (self.beside or {}).values())]
        if len(set(axes)) != len(axes):
            raise SchemaError("beside", f"gives an axis twice, or the position's own, {self.axis}")
        if self.material is not None and self.material.place not in ("air", *self.place_temps):
            raise SchemaError(
                "material", f"is by the temperature of {self.material.place}, expected a place of place_temps"
            )
        if self.compensate_air and self.air_temp_channel is None and self.fixed_air.temp_c is None:
            raise SchemaError(
                "air_temp_channel", "is 0 and fixed_air has no temp_c, expected one of them to compensate air"
            )


def read_instrument(document: Document, *, has_port: bool) -> InstrumentConfig:
    """[instrument]; has_port False: the bench brings its own. Keys are those of the kind; another kind's are unknown."""
    kind = str(document.table("instrument").get("kind", "umd"))
    only = _KEYS[kind].split() if kind in _KEYS else None
    usual: dict[str, Any] = {"kind": "umd", "direction": 1, "stale_after_s": 0.5}
    if kind == "replay":
        usual["port"] = ""
    elif not has_port:
        usual["port"] = "bench"
    beside: tuple[type, ...] = (InstrumentConfig, DisplayConfig, ReplayConfig)
    if kind == "umd":
        usual |= {"compensate_air": True, "air_temp_channel": THERMOMETERS[0]}
    elif kind in _LINES:
        needs = ("pattern",) if kind == "ascii" else ()
        display = document.load(DisplayConfig, "instrument", only=only, needs=needs, beside=beside, usual=_LINES[kind])
        usual["display"] = display
    elif kind == "replay":
        usual["replay"] = document.load(ReplayConfig, "instrument", only=only, beside=beside)
    return document.load(InstrumentConfig, "instrument", only=only, beside=beside, usual=usual)
