"""The refractive index of air from what sensors say, for the effects of an interferometer that is not compensated for it.

Modified Edlén equation (Birch & Downs, Metrologia 30 (1993) 155 and 31 (1994) 315) at 632.9912 nm vacuum wavelength; water
vapour pressure from relative humidity after Magnus.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hil.effects.survey import Survey

Floats = NDArray[np.float64]

SENSORS = ("air_temp_c", "air_pressure_hpa", "air_humidity_percent")
STANDARD = {"air_temp_c": 20.0, "air_pressure_hpa": 1013.25, "air_humidity_percent": 50.0}
WAVELENGTH_UM = 0.6329912


def refractivity_ppm(temp_c: Floats, pressure_hpa: Floats, humidity_percent: Floats) -> Floats:
    """(n - 1)·10⁶, shape of the inputs."""
    s2 = WAVELENGTH_UM**-2
    standard = 8342.54 + 2406147.0 / (130.0 - s2) + 15998.0 / (38.9 - s2)  # (n - 1)·10⁸ of standard air
    pascal = pressure_hpa * 100.0
    dry = pascal * standard / 96095.43
    dry = dry * (1.0 + 1e-8 * (0.601 - 0.00972 * temp_c) * pascal) / (1.0 + 0.0036610 * temp_c)
    saturated = 611.2 * np.exp(17.62 * temp_c / (243.12 + temp_c))
    vapour = humidity_percent / 100.0 * saturated
    return np.asarray((dry - vapour * (3.7345 - 0.0401 * s2) * 1e-2) * 1e-2)


def air_inputs(survey: Survey) -> tuple[tuple[str, ...], dict[str, float]]:
    """The air sensors that vary, and the constants that stand for the others (their mean, or standard air)."""
    inputs = tuple(name for name in SENSORS if survey.has(name))
    constants = {name: survey.mean.get(name, STANDARD[name]) for name in SENSORS if name not in inputs}
    return inputs, constants


def excess_ppm(inputs: tuple[str, ...], constants: Mapping[str, float], columns: Mapping[str, Floats]) -> Floats:
    """Refractivity above that of standard air (20 °C, 1013.25 hPa, 50 %), ppm, shape (n,)."""
    values = [columns[name] if name in inputs else np.full(1, constants[name]) for name in SENSORS]
    standard = refractivity_ppm(*(np.full(1, STANDARD[name]) for name in SENSORS))
    return np.asarray(refractivity_ppm(*values) - standard)
