"""The length at 20 °C of what was measured: its own expansion, separate from that of the air. No I/O.

For comparing an axis with a drawing. An axis that is to be accurate at its working temperature is measured without it:
its expansion is then an error like any other, measured and corrected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from drivers.errors import MeasurementLostError
from drivers.instrument import Environment
from drivers.toml_types import Limits, Name

REFERENCE_C = 20.0
"""Reference temperature, ISO 1."""


@dataclass(frozen=True)
class Material:
    """expansion_ppm_per_k: of the scale or workpiece; place: where its temperature is measured, one of the instrument's
    ("air": of the air).
    """

    expansion_ppm_per_k: Annotated[float, Limits(ge=0.0, le=100.0)]
    place: Name

    def temperature_c(self, environment: Environment) -> float:
        """The temperature of the place. Raises MeasurementLostError while none has been received."""
        temperature_c = environment.air_temp_c if self.place == "air" else environment.place_temps_c.get(self.place)
        if temperature_c is None:
            raise MeasurementLostError(f"no temperature of {self.place}, by which lengths are brought to 20 °C")
        return temperature_c

    def at_reference_mm(self, length_mm: float, environment: Environment) -> float:
        """A length (signed, from the datum) at 20 °C. Raises MeasurementLostError as `temperature_c`."""
        expansion = self.expansion_ppm_per_k * 1e-6 * (self.temperature_c(environment) - REFERENCE_C)
        return length_mm / (1.0 + expansion)
