"""What a length measured now would be at 20 °C: the expansion of what is measured, apart from the air's. Pure.

For comparing an axis with a drawing. An axis that is to be good at its working temperature is measured without it: its expansion is
then an error like any other, found and corrected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from drivers.errors import MeasurementLostError
from drivers.instrument import Environment
from drivers.toml_types import Limits, Name

REFERENCE_C = 20.0


@dataclass(frozen=True)
class Material:
    """expansion_ppm_per_k: of the scale or work; place: whose temperature ("air": the air's), one of the instrument's"""

    expansion_ppm_per_k: Annotated[float, Limits(ge=0.0, le=100.0)]
    place: Name

    def temperature_c(self, environment: Environment) -> float:
        """Raises MeasurementLostError while the place's temperature has not been heard."""
        temperature_c = environment.air_temp_c if self.place == "air" else environment.place_temps_c.get(self.place)
        if temperature_c is None:
            raise MeasurementLostError(f"no temperature of {self.place}, by which lengths are brought to 20 °C")
        return temperature_c

    def at_reference_mm(self, length_mm: float, environment: Environment) -> float:
        """A length (signed, from the datum) as it would be at 20 °C."""
        expansion = self.expansion_ppm_per_k * 1e-6 * (self.temperature_c(environment) - REFERENCE_C)
        return length_mm / (1.0 + expansion)
