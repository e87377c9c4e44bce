"""The refractive index of air from sensor columns, for the effects of an interferometer without compensation for it.

The modified Edlén equation of `drivers.edlen`, at the vacuum wavelength of a helium-neon laser.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.edlen import refractivity
from hil.effects.survey import Survey

Floats = NDArray[np.float64]

SENSORS = ("air_temp_c", "air_pressure_hpa", "air_humidity_percent")
STANDARD = {"air_temp_c": 20.0, "air_pressure_hpa": 1013.25, "air_humidity_percent": 50.0}
"""Air for a sensor that is not among the columns: °C, hPa, %."""


def refractivity_ppm(temp_c: Floats, pressure_hpa: Floats, humidity_percent: Floats) -> Floats:
    """(n - 1)·10⁶ of air at °C, hPa and % relative humidity, shape of the inputs. Source: modified Edlén, see
    `drivers.edlen`.
    """
    return np.asarray(refractivity(temp_c, pressure_hpa, humidity_percent) * 1e6)


def air_inputs(survey: Survey) -> tuple[tuple[str, ...], dict[str, float]]:
    """The columns of the air sensors that vary, and a constant for each other sensor: its mean, or `STANDARD` where it
    is missing.
    """
    inputs = tuple(name for name in SENSORS if survey.has(name))
    constants = {name: survey.mean.get(name, STANDARD[name]) for name in SENSORS if name not in inputs}
    return inputs, constants


def excess_ppm(inputs: tuple[str, ...], constants: Mapping[str, float], columns: Mapping[str, Floats]) -> Floats:
    """Refractivity above that of standard air (20 °C, 1013.25 hPa, 50 %), ppm, shape (n,).

    inputs: sensors read from `columns`; constants: °C, hPa, % of the other sensors. Raises KeyError for a sensor in
    neither.
    """
    values = [columns[name] if name in inputs else np.full(1, constants[name]) for name in SENSORS]
    standard = refractivity_ppm(*(np.full(1, STANDARD[name]) for name in SENSORS))
    return np.asarray(refractivity_ppm(*values) - standard)
